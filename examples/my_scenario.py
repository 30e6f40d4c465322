"""A scenario of one's own: a delivery drone between houses, whose fixes get worse beside walls.

    python examples/my_scenario.py

What the target does, when it is looked at, how it is seen and what goes wrong are one object each; the environments and
every estimator take the result.
"""

import gymnasium

import jink.envs
from jink.envs.flight.dwells import Dwell
from jink.envs.intents import StopAndGo, Straight, Turn
from jink.envs.manoeuvres import Limits, Manoeuvres, Start
from jink.envs.sampling import Regular
from jink.envs.scenario import Scenario
from jink.envs.sensing import Sensing
from jink.envs.simulate import simulate_tracks
from jink.envs.surges import MarkovBursts
from jink.estimators.metrics import summary
from jink.estimators.recipes import make_estimator
from jink.estimators.sensors import position

delivery = Scenario(
    "delivery-v0",
    "Drone that delivers between houses",
    "mine",
    motion=Manoeuvres(
        behaviours=(Straight(dwell=Dwell(6.0)), Turn(rate=(0.3, 0.9), dwell=Dwell(2.0)), StopAndGo(dwell=Dwell(8.0))),
        limits=Limits(speed=(0.0, 15.0), lateral=0.8),
        start=Start(speed=(5.0, 10.0)),
    ),
    sensing=Sensing(position(axes=2, sigma=1.5), detection_probability=0.9),
    sampling=Regular(200, 0.2),
    surges=(MarkovBursts(on=(1.0, 4.0), off=(3.0, 10.0), scale=(10.0, 400.0)),),
    filter_noise=4.0,
)

if __name__ == "__main__":
    tracks = simulate_tracks(delivery, count=20, seed=0)
    for name in ("kf-cv", "joint-imm"):
        estimator = make_estimator(name, delivery.sensor, acceleration=2.0, speed=8.0, sojourn=5.0)
        found = estimator.run(tracks.measurements, tracks.times, lengths=tracks.lengths)
        print(f"{name}: {summary(found, tracks.truth, lengths=tracks.lengths)['position_rmse_m']:.2f} m")
    gymnasium.register_envs(jink.envs)
    env = gymnasium.make("jink/AdaptiveFactor-v0", scenario=delivery)
    observation, info = env.reset(seed=1)
    print("an environment of it:", env.spec.id, observation.shape)
