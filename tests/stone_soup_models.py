"""The few lines that dress a plain function as a Stone Soup model."""

import numpy as np
from stonesoup.base import Property
from stonesoup.models.measurement.base import MeasurementModel
from stonesoup.models.measurement.nonlinear import NonLinearGaussianMeasurement
from stonesoup.models.transition.nonlinear import GaussianTransitionModel
from stonesoup.types.array import StateVector, StateVectors
from stonesoup.types.state import GaussianState


class _Transition(GaussianTransitionModel):
    f: object = Property()
    Q: np.ndarray = Property()

    @property
    def ndim_state(self):
        return len(self.Q)

    def function(self, state, noise=False, **_):
        return StateVectors([StateVector(self.f(column)) for column in np.asarray(state.state_vector, float).T])

    def covar(self, **_):
        return self.Q


class _Measurement(NonLinearGaussianMeasurement):
    h: object = Property()

    @property
    def ndim_meas(self):
        return len(self.noise_covar)

    def function(self, state, noise=False, **_):
        images = [StateVector(self.h(column)) for column in np.asarray(state.state_vector, float).T]
        return StateVectors(images) if len(images) > 1 else images[0]


def transition_model(f, Q):
    return _Transition(f=f, Q=Q)


def measurement_model(h, R, n):
    assert issubclass(_Measurement, MeasurementModel)
    return _Measurement(ndim_state=n, mapping=tuple(range(n)), noise_covar=R, h=h)


def start_state(mean, cov, time):
    return GaussianState(StateVector(mean), cov, timestamp=time)
