"""What an estimator reports of easy tracks: shapes, kinds, sound values, a target that it follows."""

from __future__ import annotations

import numpy as np

from jink.estimators.status import DIVERGED
from jink.training.contract.subject import Broken, Subject, finite_of, must_be_known

__all__ = ["check_follows", "check_shapes", "check_values"]

_STRAIGHT = 0.66
"""Share of the case in which the targets fly straight."""


def check_shapes(subject: Subject) -> str:
    """Every column has its shape and its kind of number."""
    e = subject.run()
    B, T, A = *subject.case.times.shape, subject.sensor.axes
    M = len(subject.make().modes)
    wanted = {
        "times": (B, T), "position": (B, T, A), "velocity": (B, T, A), "covariance": (B, T, 2 * A, 2 * A),
        "mode_probs": (B, T, M), "log_likelihood": (B, T), "nis": (B, T), "nis_dof": (B, T), "status": (B, T),
    }  # fmt: skip
    kinds = {"nis_dof": "i", "status": "i"}
    for name, shape in wanted.items():
        value = np.asarray(getattr(e, name))
        if value.shape != shape:
            raise Broken(f"{name} has shape {value.shape}, not {shape}", "Return one value for each row.")
        if value.dtype.kind != kinds.get(name, "f"):
            raise Broken(f"{name} has dtype {value.dtype}", "Use float64; integers for nis_dof and status.")
    if not np.array_equal(e.times, subject.case.times):
        raise Broken("times are not those of the measurements", "Return the times as they were given.")
    return f"{B} tracks, {T} rows, {A} axes, {M} mode{'s' if M > 1 else ''}"


def check_values(subject: Subject) -> str:
    """Nothing is NaN, covariances are covariances, probabilities sum to one, statuses are known."""
    e = subject.run()
    if text := finite_of(e):
        raise Broken(text, "Guard divisions and square roots; return the last good estimate where there is none.")
    must_be_known(e)
    if (e.status == DIVERGED).any():
        raise Broken(
            f"{int((e.status == DIVERGED).sum())} rows are diverged on an easy track",
            "A position or velocity was NaN or infinite there; look at the first.",
        )
    sums = np.asarray(e.mode_probs).sum(axis=-1)
    if (np.abs(sums - 1.0) > 1e-9).any() or (np.asarray(e.mode_probs) < 0).any():
        raise Broken(f"mode_probs sum to {sums.ravel()[0]:.6g} or are negative", "Normalise them in each row.")
    P = np.asarray(e.covariance)
    P = P if np.isfinite(P).all() else P[..., : subject.sensor.axes, : subject.sensor.axes]
    if np.isfinite(P).all():
        scale = np.sqrt(np.maximum(np.diagonal(P, axis1=-2, axis2=-1), 1e-300))
        scaled = P / scale[..., :, None] / scale[..., None, :]
        if np.abs(scaled - np.swapaxes(scaled, -1, -2)).max() > 1e-6 or np.linalg.eigvalsh(scaled).min() < -1e-6:
            raise Broken("covariance is not symmetric and positive", "Use (P + P.T) / 2 and the Joseph form.")
    told = [n for n in ("velocity", "covariance") if np.isfinite(getattr(e, n)).any()]
    told += ["nis"] if (e.nis_dof > 0).any() else []
    left_out = [name for name in ("velocity", "covariance", "nis") if name not in told]
    return f"finite; not reported, so not scored: {', '.join(left_out)}" if left_out else "finite and consistent"


def check_follows(subject: Subject) -> str:
    """It follows a target that flies straight: errors no larger than a few standard deviations of the sensor."""
    case = subject.case
    rows = int(_STRAIGHT * case.times.shape[1])
    half = slice(rows // 2, rows)
    error = np.linalg.norm(subject.run().position[:, half] - case.truth[:, half], axis=-1)
    typical = float(np.sqrt(np.mean(error**2)))
    sigma = _sigma_m(subject)
    if not typical < 3.0 * sigma:
        raise Broken(
            f"straight targets are missed by {typical:.3g} m, the sensor by {sigma:.3g} m",
            "Look at the order of the axes, the units, and whether the time step is used.",
        )
    return f"error {typical:.3g} m, the sensor's {sigma:.3g} m"


def _sigma_m(subject: Subject) -> float:
    """Root mean square of the measured position's error; m."""
    sensor, distance = subject.sensor, float(np.linalg.norm(subject.case.truth, axis=-1).mean())
    parts = [s * (distance if u == "rad" else 1.0) for s, u in zip(sensor.sigma, sensor.units) if u in ("m", "rad")]
    return float(np.linalg.norm(parts))
