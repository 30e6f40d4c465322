"""Scenarios of targets that change their mind, and of the sensors that watch them."""

from __future__ import annotations

from jink.envs.library.named_targets import AIRCRAFT, AIRLINER, CAR, DRONE, FIGHTER, LOITERER, RACER, ROBOT, SHIP
from jink.envs.manoeuvres import Manoeuvres
from jink.envs.sampling import Irregular, Jittered, Regular
from jink.envs.scenario import Scenario
from jink.envs.sensing import Platform, Sensing
from jink.envs.surges import Dropouts, Glint, IsolatedOutliers, MarkovBursts, PlacedBursts, Ramp, Surge
from jink.estimators.sensors import (
    bearing,
    position,
    range_bearing,
    range_bearing_elevation,
    range_bearing_rate,
    ranges,
)

__all__ = ["MANOEUVRING"]

RANDOM_SURGES = MarkovBursts(on=(0.5, 5.0), off=(0.5, 5.0), scale=(4.0, 1e4))
SLOW_SURGES = MarkovBursts(on=(5.0, 30.0), off=(10.0, 60.0), scale=(4.0, 1e3))
ANCHORS = ((-15.0, -15.0), (15.0, -15.0), (15.0, 15.0), (-15.0, 15.0), (0.0, 18.0), (0.0, -18.0))

_METRE = Sensing(position(2, 1.0))
_RADAR = Sensing(range_bearing((15.0, 0.003)), detection_probability=0.95)
_TRACKING_RADAR = Sensing(range_bearing_elevation((10.0, 0.002, 0.002)))


def _switch(name: str, title: str, motion: Manoeuvres, dt: float, filter_noise: float) -> Scenario:
    return Scenario(
        f"switch{name}-v0",
        f"{title}; position",
        "switch",
        motion,
        _METRE,
        Regular(300, dt),
        start_sigma=(1.0, 2.0),
        filter_noise=filter_noise,
    )


def _joint(name: str, title: str, *surges: Surge) -> Scenario:
    return Scenario(
        f"joint{name}-v0",
        f"Drone that changes its mind, {title}",
        "joint",
        DRONE,
        _METRE,
        Regular(300, 0.1),
        surges,
        start_sigma=(1.0, 2.0),
        filter_noise=30.0,
    )


MANOEUVRING: tuple[Scenario, ...] = (
    _switch("", "Drone: straight, turns, weaves, accelerates, jinks", DRONE, 0.1, 30.0),
    _switch("-car", "Car in a town: corners, stops, starts", CAR, 0.2, 3.0),
    _switch("-loiter", "Fixed wing that orbits, weaves and moves on", LOITERER, 0.5, 30.0),
    _switch("-jink", "Fast drone under fire: short hard random turns", RACER, 0.1, 100.0),
    _switch("-slow", "The drone seen every 0.4 s", DRONE, 0.4, 30.0),
    Scenario(
        "switch-irregular-v0",
        "The drone at random moments, one look in five missed, fixes a quarter of a second late; position",
        "switch",
        DRONE,
        Sensing(position(2, 1.0), detection_probability=0.8, latency=0.25),
        Irregular(300, 0.1),
        start_sigma=(1.0, 2.0),
        filter_noise=30.0,
    ),
    _joint("", "random surges", RANDOM_SURGES),
    _joint("-bursts", "a burst of 5 s and one of 1 s at 400 x", PlacedBursts((5.0, 1.0), 400.0)),
    _joint("-outliers", "gross outliers in 5 % of samples", IsolatedOutliers(0.05, 1e4)),
    _joint("-glint", "periodic glint and short dropouts", Glint(4.0, 0.6, (25.0, 400.0)), Dropouts(0.5, 6.0)),
    _joint("-ramp", "noise that swells and fades", Ramp()),
    Scenario(
        "radar-plots-v0",
        "Aircraft in a terminal area: slow turns, speed changes; plots as positions",
        "radar",
        AIRLINER,
        Sensing(position(2, 30.0), detection_probability=0.95),
        Regular(300, 1.0),
        start_sigma=(30.0, 10.0),
        filter_noise=30.0,
    ),
    Scenario(
        "radar-switch-v0",
        "Aircraft before a radar: slow turns, speed changes; range and bearing",
        "radar",
        AIRLINER,
        _RADAR,
        Regular(300, 1.0),
        start_sigma=(60.0, 10.0),
        filter_noise=30.0,
    ),
    Scenario(
        "radar-joint-v0",
        "Aircraft before a radar that is jammed now and then; range and bearing",
        "radar",
        AIRLINER,
        _RADAR,
        Jittered(300, 1.0, 0.2),
        (SLOW_SURGES,),
        start_sigma=(60.0, 10.0),
        filter_noise=30.0,
    ),
    Scenario(
        "radar-doppler-v0",
        "Combat aircraft before a Doppler radar with glint; range, bearing, range rate",
        "radar",
        FIGHTER,
        Sensing(range_bearing_rate((10.0, 0.002, 1.0)), Platform(((-12000.0, 0.0),)), detection_probability=0.95),
        Regular(300, 0.1),
        (IsolatedOutliers(0.05, (25.0, 1e3)),),
        start_sigma=(20.0, 10.0),
        filter_noise=500.0,
    ),
    Scenario(
        "air-switch-v0",
        "Aircraft in space: turns, climbs, dives, helices, jinks; position",
        "air",
        AIRCRAFT,
        Sensing(position(3, 10.0)),
        Regular(300, 0.2),
        start_sigma=(10.0, 10.0),
        filter_noise=200.0,
    ),
    Scenario(
        "air-radar-v0",
        "The same before a tracking radar; range, bearing, elevation",
        "air",
        AIRCRAFT,
        _TRACKING_RADAR,
        Regular(300, 0.2),
        start_sigma=(20.0, 10.0),
        filter_noise=200.0,
    ),
    Scenario(
        "air-joint-v0",
        "The same with random surges; range, bearing, elevation",
        "air",
        AIRCRAFT,
        _TRACKING_RADAR,
        Regular(300, 0.2),
        (RANDOM_SURGES,),
        start_sigma=(20.0, 10.0),
        filter_noise=200.0,
    ),
    Scenario(
        "passive-ship-v0",
        "Ship seen from a ship that weaves to find its range; bearing alone",
        "passive",
        SHIP,
        Sensing(bearing(0.01, (5000.0, 2000.0)), Platform(((0.0, -500.0),), (0.0, 6.0), weave=400.0, period=300.0)),
        Regular(300, 5.0),
        start_sigma=(1000.0, 5.0),
        filter_noise=0.03,
    ),
    Scenario(
        "passive-robot-v0",
        "Robot in a hall between six beacons, some hidden, some reflected; ranges",
        "passive",
        ROBOT,
        Sensing(ranges(ANCHORS, 0.1), component_loss=0.2),
        Regular(300, 0.1),
        (IsolatedOutliers(0.05, (25.0, 400.0)),),
        start_sigma=(0.5, 0.5),
        filter_noise=0.1,
    ),
)
"""Suites switch, joint, radar, air and passive."""
