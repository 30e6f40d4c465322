"""Targets that change their mind, by what they are: vehicles, drones, aircraft, a ship, a robot."""

from __future__ import annotations

from jink.envs.flight.dwells import Dwell
from jink.envs.flight.limits import Limits, Start
from jink.envs.intents import Accelerate, Climb, Helix, Jink, Orbit, StopAndGo, Straight, Turn, Weave
from jink.envs.manoeuvres import Manoeuvres

__all__ = ["AIRCRAFT", "AIRLINER", "CAR", "DRONE", "FIGHTER", "LOITERER", "RACER", "ROBOT", "SHIP"]

DRONE = Manoeuvres(
    behaviours=(
        Straight(dwell=Dwell(4.0, 1.0)),
        Turn(dwell=Dwell(3.0, 1.0), rate=(0.2, 0.8)),
        Weave(dwell=Dwell(6.0, 3.0), amplitude=(0.3, 0.8), period=(2.5, 5.0)),
        Accelerate(dwell=Dwell(2.0, 0.5), acceleration=(2.0, 6.0)),
        Jink(dwell=Dwell(3.0, 1.0), lateral=(1.0, 2.5), turn_time=(0.5, 1.5)),
    ),
    limits=Limits(speed=(3.0, 30.0), lateral=3.0),
    start=Start(speed=(8.0, 20.0), x=(-200.0, 200.0), y=(-200.0, 200.0)),
)
"""A multicopter some hundred metres away: up to 30 m/s and 3 g."""

CAR = Manoeuvres(
    behaviours=(
        Straight(dwell=Dwell(8.0, 2.0)),
        Turn(dwell=Dwell(4.0, 2.0), rate=(0.15, 0.5)),
        Accelerate(dwell=Dwell(3.0, 1.0), acceleration=(0.5, 2.5)),
        StopAndGo(dwell=Dwell(14.0, 8.0), braking=(1.5, 4.0), starting=(1.0, 2.5)),
    ),
    limits=Limits(speed=(0.0, 20.0), lateral=0.5),
    start=Start(speed=(5.0, 15.0), x=(-300.0, 300.0), y=(-300.0, 300.0)),
)
"""A car in a town: corners, traffic lights, half a g."""

AIRLINER = Manoeuvres(
    behaviours=(
        Straight(dwell=Dwell(40.0, 15.0)),
        Turn(dwell=Dwell(30.0, 10.0), rate=(0.017, 0.052)),
        Accelerate(dwell=Dwell(20.0, 8.0), acceleration=(0.5, 1.5)),
    ),
    limits=Limits(speed=(80.0, 240.0), lateral=1.2),
    start=Start(speed=(100.0, 200.0), x=(-2e4, 2e4), y=(-2e4, 2e4)),
)
"""Traffic in a terminal area: turns of one to three degrees per second."""

LOITERER = Manoeuvres(
    behaviours=(
        Straight(dwell=Dwell(12.0, 4.0)),
        Orbit(dwell=Dwell(30.0, 12.0), radius=(80.0, 250.0)),
        Weave(dwell=Dwell(20.0, 8.0), amplitude=(0.3, 0.9), period=(8.0, 16.0)),
    ),
    limits=Limits(speed=(18.0, 35.0), lateral=2.0),
    start=Start(speed=(20.0, 32.0), x=(-1000.0, 1000.0), y=(-1000.0, 1000.0)),
)
"""A small fixed wing that loiters, searches and moves on."""

FIGHTER = Manoeuvres(
    behaviours=(
        Straight(dwell=Dwell(4.0, 1.5)),
        Turn(dwell=Dwell(5.0, 2.0), rate=(0.05, 0.2)),
        Jink(dwell=Dwell(5.0, 2.0), lateral=(2.0, 6.0), turn_time=(0.7, 2.0)),
    ),
    limits=Limits(speed=(150.0, 320.0), lateral=7.0),
    start=Start(speed=(180.0, 280.0), x=(-5000.0, 5000.0), y=(-5000.0, 5000.0)),
)
"""A combat aircraft that does not want to be hit."""

RACER = Manoeuvres(
    behaviours=(
        Straight(dwell=Dwell(3.0, 1.0)),
        Turn(dwell=Dwell(3.0, 1.0), rate=(0.2, 0.6)),
        Jink(dwell=Dwell(4.0, 2.0), lateral=(1.5, 5.0), turn_time=(0.4, 1.2)),
    ),
    limits=Limits(speed=(10.0, 45.0), lateral=5.0),
    start=Start(speed=(20.0, 40.0), x=(-500.0, 500.0), y=(-500.0, 500.0)),
)
"""A racing drone that does not want to be hit: 5 g."""

AIRCRAFT = Manoeuvres(
    axes=3,
    behaviours=(
        Straight(dwell=Dwell(8.0, 3.0)),
        Turn(dwell=Dwell(10.0, 4.0), rate=(0.05, 0.2)),
        Climb(dwell=Dwell(10.0, 5.0), angle=(0.1, 0.4)),
        Helix(dwell=Dwell(15.0, 6.0), rate=(0.08, 0.2), angle=(0.1, 0.3)),
        Jink(dwell=Dwell(4.0, 2.0), lateral=(2.0, 4.0), turn_time=(0.7, 2.0)),
        Accelerate(dwell=Dwell(5.0, 2.0), acceleration=(2.0, 6.0)),
    ),
    limits=Limits(speed=(90.0, 250.0), lateral=4.0, climb=0.5, altitude=(300.0, 9000.0)),
    start=Start(speed=(120.0, 200.0), x=(2000.0, 15000.0), y=(-8000.0, 8000.0), z=(1500.0, 5000.0)),
)
"""An agile aircraft in space, some ten kilometres from the sensor."""

SHIP = Manoeuvres(
    behaviours=(
        Straight(dwell=Dwell(240.0, 90.0)),
        Turn(dwell=Dwell(60.0, 20.0), rate=(0.005, 0.02)),
    ),
    limits=Limits(speed=(3.0, 12.0), lateral=0.05),
    start=Start(speed=(4.0, 10.0), x=(3000.0, 8000.0), y=(-4000.0, 4000.0)),
)
"""A ship at some kilometres."""

ROBOT = Manoeuvres(
    behaviours=(
        Straight(dwell=Dwell(3.0, 1.0)),
        Turn(dwell=Dwell(2.0, 0.8), rate=(0.3, 1.2)),
        StopAndGo(dwell=Dwell(6.0, 3.0), braking=(0.5, 1.0), starting=(0.3, 0.8)),
    ),
    limits=Limits(speed=(0.0, 1.5), lateral=0.2),
    start=Start(speed=(0.3, 1.2), x=(-10.0, 10.0), y=(-10.0, 10.0)),
)
"""A robot in a hall."""
