"""Scenes by name. `get_scene("crossing-v0")`; anything that can move a number bumps the version in the id.

Unless a scene says otherwise its numbers are our choice: two radars 4 km apart look at the same 10 km, the second a
second later, sigma 50 m and 10 mrad, P_D 0.9, false alarms uniform in range and bearing. Clutter is named by how much
of it falls into a 3 sigma gate of one measurement (area 9 pi sigma_r sigma_b): low 0.006, medium 0.03, high 0.12.
"""

from __future__ import annotations

import difflib
import math
from dataclasses import replace

from jink.envs.flight.dwells import Dwell
from jink.envs.flight.limits import Limits, Start
from jink.envs.intents import Straight, Turn, Weave
from jink.envs.literature.published_legs import Leg
from jink.envs.manoeuvres import Manoeuvres
from jink.envs.networks import consensus_network, geometric
from jink.envs.plants import LinearPlant
from jink.envs.published import ATC_TURNS, DEGREE
from jink.envs.scenery.paths import Path
from jink.envs.scenery.regions import Box, Sector
from jink.envs.scenery.scene_sensors import SceneSensor
from jink.envs.scenes import Scene, SceneTarget

__all__ = ["CLUTTER_LEVELS", "SCENES", "get_scene"]

OURS = "Our choice"
CLUTTER_LEVELS = {"low": 5.0, "medium": 25.0, "high": 100.0}
"""Expected false alarms per scan of one of the two radars, 12 000 m rad each."""
SPEED = 50.0
"""Of the targets of our scenes, m/s."""
SECTOR = Sector(range_max=15_000.0, range_min=5_000.0, boresight=math.pi / 2, width=1.2)


def make_radars(clutter: float, detection: float = 0.9) -> tuple[SceneSensor, ...]:
    """The two radars, scanning every 2 s in turn; ``clutter`` false alarms per scan."""
    left = SceneSensor(
        "range-bearing", (50.0, 0.01), SECTOR, (-2000.0, 0.0), period=2.0, detection=detection, clutter=clutter
    )
    return left, replace(left, place=(2000.0, 0.0), offset=1.0)


def fly(x: float, y: float, course: float, *legs: Leg) -> Path:
    """A path from (x, y), m, on a course, degrees counter-clockwise from +x."""
    turn = course * DEGREE
    velocity = (SPEED * math.cos(turn), SPEED * math.sin(turn))
    return Path((x, y), velocity, legs or (Leg(1.0, "straight"),))


def cross(angle: float, middle: tuple[float, float], seconds: float) -> tuple[SceneTarget, SceneTarget]:
    """Two straight targets that meet in the middle, their courses ``angle`` degrees apart, after ``seconds``."""
    targets = []
    for course in (angle / 2, -angle / 2):
        start = fly(0.0, 0.0, course)
        x, y = (m - seconds * v for m, v in zip(middle, start.velocity, strict=True))
        targets.append(SceneTarget(replace(start, position=(x, y))))
    return targets[0], targets[1]


CROSSING = Scene(
    id="crossing-v0",
    title="Two targets cross at 40 degrees, low clutter",
    source=OURS,
    duration=80.0,
    targets=cross(40.0, (0.0, 10_000.0), 40.0),
    sensors=make_radars(CLUTTER_LEVELS["low"]),
)

PARALLEL = Scene(
    id="parallel-v0",
    title="Three targets abreast, 100 m apart, two standard deviations of the range",
    source=OURS,
    duration=80.0,
    targets=tuple(SceneTarget(fly(-2000.0, 10_000.0 + 100.0 * k, 0.0)) for k in (-1, 0, 1)),
    sensors=make_radars(CLUTTER_LEVELS["low"]),
)


def turn_off(rate: float) -> tuple[Leg, ...]:
    """Straight for 30 s, turn by 30 degrees within 10 s, straight again; ``rate`` in degrees/s."""
    straight = (Leg(30.0, "straight"), Leg(1.0, "straight"))
    return (straight[0], Leg(10.0, "turn", rate * DEGREE), straight[1]) if rate else straight


SPLIT = Scene(
    id="formation-split-v0",
    title="Three targets 60 m apart, unresolved, part by turns of 30 degrees to both sides at 30 s",
    source=OURS,
    duration=80.0,
    targets=tuple(SceneTarget(fly(-2000.0, 10_000.0 + 60.0 * k, 0.0, *turn_off(3.0 * k))) for k in (-1, 0, 1)),
    sensors=make_radars(CLUTTER_LEVELS["low"]),
)

BIRTHS = Scene(
    id="births-v0",
    title="Five targets, born at 0, 0, 20, 40 and 55 s, dead at the end, 50, the end, 70 s and the end",
    source=OURS,
    duration=80.0,
    targets=(
        SceneTarget(fly(-2000.0, 9_000.0, 0.0)),
        SceneTarget(fly(-2000.0, 11_000.0, 0.0), death=50.0),
        SceneTarget(fly(2000.0, 10_000.0, 180.0), birth=20.0),
        SceneTarget(fly(0.0, 8_000.0, 90.0), birth=40.0, death=70.0),
        SceneTarget(fly(1000.0, 12_000.0, -90.0), birth=55.0),
    ),
    sensors=make_radars(CLUTTER_LEVELS["low"]),
)


def mirror(legs: tuple[Leg, ...]) -> tuple[Leg, ...]:
    """The same legs seen in a mirror: left turns become right turns."""
    return tuple(replace(leg, turn_rate=-leg.turn_rate) for leg in legs)


# Per m rad times the watched range and bearing: 24.5 false alarms per scan.
PUBLISHED_CLUTTER = 1e-4 * (40_000.0 - 1_000.0) * 2 * math.pi
THREE_TARGETS = Scene(
    id="three-targets-v0",
    title="Published: two air-traffic turns, one mirrored, and a straight target between them, in clutter",
    source="Air-traffic example of Bar-Shalom, Li, Kirubarajan (2001), section 11.7, made a scene of three in "
    "demo2DDataAssociation.m of the Tracker Component Library, U.S. Naval Research Laboratory (public domain): paths, "
    "radar at (-7000, 0) m, sigma 10 m and 0.2 degrees, P_D 0.8, 1e-4 false alarms per m rad from 1 to 40 km all "
    "around, T = 5 s. Differs: the source detects every target at its first two scans to start tracks",
    duration=495.0,
    targets=(
        SceneTarget(Path((25_000.0, 10_000.0), (-120.0, 0.0), ATC_TURNS.legs)),
        SceneTarget(Path((6_500.0 - 25_000.0, 10_000.0), (120.0, 0.0), mirror(ATC_TURNS.legs))),
        SceneTarget(Path((3124.50645843013 - 250.0, 28_924.50645843013), (0.0, -120.0))),
    ),
    sensors=(
        SceneSensor(
            "range-bearing",
            (10.0, 0.2 * DEGREE),
            Sector(range_max=40_000.0, range_min=1_000.0),
            (-7_000.0, 0.0),
            period=5.0,
            detection=0.8,
            clutter=PUBLISHED_CLUTTER,
        ),
    ),
)


def make_network_scene() -> Scene:
    """Radars on every third node of a geometric network of 18 around two crossing targets and one beside them."""
    network = geometric(18, 7_000.0, 20_000.0, seed=1, sensing=range(0, 18, 3))
    places = [network.positions[node] for node in network.sensing]
    radar = SceneSensor("range-bearing", (50.0, 0.01), Sector(18_000.0, 200.0), period=2.0, detection=0.9, clutter=10.0)
    return Scene(
        id="sensor-network-v0",
        title="Six radars on a network of 18 nodes, two crossing targets and one beside them",
        source=OURS,
        duration=80.0,
        targets=(*cross(40.0, (10_000.0, 10_000.0), 40.0), SceneTarget(fly(8_000.0, 12_000.0, 0.0))),
        sensors=tuple(replace(radar, place=place) for place in places),
        network=network,
    )


MANOEUVRING = Manoeuvres(
    behaviours=(
        Straight(dwell=Dwell(10.0, 4.0)),
        Turn(dwell=Dwell(8.0, 3.0), rate=(0.03, 0.12)),
        Weave(dwell=Dwell(12.0, 5.0), amplitude=(0.2, 0.5), period=(6.0, 12.0)),
    ),
    initial=(1.0, 0.0, 0.0),
    limits=Limits(speed=(40.0, 60.0), lateral=1.0),
    start=Start(speed=(45.0, 55.0), heading=(-0.15, 0.15), x=(-1600.0, -1400.0), y=(-100.0, 100.0)),
)
"""From about 1500 m west of its frame's origin towards it, then as it likes."""


def make_manoeuvring_scene() -> Scene:
    """Three manoeuvring targets that meet around one point, each after about 30 s."""
    all_around = Sector(range_max=18_000.0, range_min=500.0)
    return Scene(
        id="manoeuvring-crossing-v0",
        title="Three targets meet after about 30 s and turn, weave and go on as they like",
        source=OURS,
        duration=80.0,
        targets=tuple(
            SceneTarget(MANOEUVRING, place=(0.0, 10_000.0), heading=heading * DEGREE) for heading in (0.0, 180.0, 90.0)
        ),
        sensors=tuple(replace(radar, region=all_around) for radar in make_radars(50.0)),
    )


def make_consensus_scene() -> Scene:
    """The linear position variant of the 50-node network: one target, ten position sensors, nothing missed."""
    network = consensus_network()
    everywhere = Box((-1e6, -1e6), (1e6, 1e6))
    seer = SceneSensor("position", (100.0, 100.0), everywhere, period=2.0)
    # Start positions are correlated by 0.6: in axes turned by 45 degrees they are not, and nothing else notices.
    root = math.sqrt(0.5)
    mean = (root * (4000.0 + 2000.0), root * (5.0 + 15.0), root * (4000.0 - 2000.0), root * (5.0 - 15.0))
    sigma = (1500.0 * math.sqrt(1.6), 2.0, 1500.0 * math.sqrt(0.4), 2.0)
    return Scene(
        id="consensus-network-v0",
        title="Published parameters: one nearly straight target, 50 nodes of which 10 see positions",
        source="Garcia-Fernandez, Battistelli (2025), companion code: T = 2 s, 50 steps, white acceleration of 16 "
        "m^2/s^3, start mean (2000, 4000) m and (15, 5) m/s, sigma 1500 m with correlation 0.6 and 2 m/s, sensing "
        "nodes. Linear variant with R = 100^2 I. Differs: places and links are ours, see consensus_network",
        duration=98.0,
        targets=(SceneTarget(LinearPlant(density=16.0, start_mean=mean, start_sigma=sigma), heading=math.pi / 4),),
        sensors=tuple(replace(seer, place=network.positions[node]) for node in network.sensing),
        network=network,
    )


SCENES: dict[str, Scene] = {
    scene.id: scene
    for scene in (
        CROSSING,
        *(
            replace(
                CROSSING,
                id=f"crossing-{level}-clutter-v0",
                title=f"Two targets cross at 40 degrees, {level} clutter",
                sensors=make_radars(CLUTTER_LEVELS[level]),
            )
            for level in ("medium", "high")
        ),
        PARALLEL,
        SPLIT,
        BIRTHS,
        make_manoeuvring_scene(),
        THREE_TARGETS,
        make_network_scene(),
        make_consensus_scene(),
    )
}
"""All scenes by id."""


def get_scene(name: str) -> Scene:
    """A scene by name.

    Raises:
        ValueError: an unknown name.
    """
    if name not in SCENES:
        near = difflib.get_close_matches(str(name), SCENES, n=1)
        raise ValueError(
            f"get_scene: name must be one of {', '.join(SCENES)}; got {name!r}. "
            + (f"Did you mean {near[0]!r}?" if near else "Choose one.")
        )
    return SCENES[name]
