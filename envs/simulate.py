"""Episodes from a scenario and its streams."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from gymnasium.utils import seeding
from numpy.typing import NDArray

from jink.envs.episodes import Episodes, Source
from jink.envs.sampling import TICK
from jink.envs.sensing_laws import merge, pick
from jink.envs.streams import STREAMS, Streams, draw, make_streams
from jink.envs.truth import Truth
from jink.estimators.tracks import Tracks

if TYPE_CHECKING:
    from jink.envs.scenario import Scenario

__all__ = ["simulate", "simulate_tracks"]

Array = NDArray[np.float64]
_MOTION, _TIMES, _SURGE, _SENSOR = (STREAMS.index(name) for name in ("motion", "times", "surge", "sensor"))
_ROOM = 1.0  # s beyond the last sample that every motion has draws for, so that a usual latency asks for no more


def simulate(scenario: Scenario, streams: Sequence[Streams]) -> Episodes:
    """One episode per entry of ``streams``, which advance by the same amount every time.

    Row b depends on ``streams[b]`` alone, bit for bit. Sensor and surges draw from streams of their own, so changing
    them moves neither these trajectories nor those of later episodes. A latency asks for the truth at more times:
    that leaves a `Manoeuvres` as it is, but a `LinearPlant`, whose noise is drawn per sample, takes another path.

    Args:
        scenario: motion, sampling, surges, sensing.
        streams: B entries, each from `make_streams`.

    Returns:
        the episodes.
    """
    sampling, sensing = scenario.sampling, scenario.sensing
    T, D = sampling.steps, sensing.sensor.size
    by_stream = list(zip(*streams, strict=True)) or [()] * len(STREAMS)
    times = sampling.times(draw(by_stream[_TIMES], sampling.need()))
    latency = _latency(scenario)
    truth, delivered = _move(scenario, times, latency, by_stream[_MOTION])
    scale, bias = np.ones(times.shape), np.zeros((*times.shape, D))
    detected = np.ones(times.shape, dtype=np.bool_)
    for surge in scenario.surges:
        surge.apply(times, draw(by_stream[_SURGE], surge.need(T, sampling.duration, D)), scale, bias, detected)
    draws = draw(by_stream[_SENSOR], sensing.need(T))
    prior_mean, prior_cov = sensing.prior(truth, draws, scenario.start_sigma)
    sight = sensing.look(times, truth, draws, scale, bias, detected)
    return Episodes(
        times,
        times + latency,
        truth,
        delivered,
        sight.measurements,
        detected,
        scale,
        bias,
        sight.noise,
        sensing.sensor.noise,
        sight.sensor_states,
        prior_mean,
        prior_cov,
    )


def _latency(scenario: Scenario) -> float:
    """In whole ticks, as all times are."""
    return round(scenario.sensing.latency / TICK) * TICK


def _move(
    scenario: Scenario, times: Array, latency: float, generators: Sequence[np.random.Generator]
) -> tuple[Truth, Truth]:
    """Truth at the times of the samples and of their delivery, both from one path."""
    motion, duration = scenario.motion, scenario.sampling.duration
    T = times.shape[1]
    longest = duration + max(latency, _ROOM)
    if latency == 0.0:
        truth = motion.simulate(times, draw(generators, motion.need(T, longest)))
        return truth, truth
    B, A = len(times), motion.axes
    both = np.empty((B, 2 * T))
    columns = np.empty((2, B, T), dtype=np.int64)
    merge(times, latency, both, columns[0], columns[1])
    path = motion.simulate(both, draw(generators, motion.need(2 * T, longest)))
    parts = []
    for at, late in zip(columns, (0.0, latency), strict=True):
        position, velocity, acceleration = (np.empty((B, T, A)) for _ in range(3))
        intent = np.empty((B, T), dtype=np.int8)
        taken = (position, velocity, acceleration, intent)
        pick(at, path.position, path.velocity, path.acceleration, path.intent, taken)
        last = times[:, -1:] + late
        parts.append(Truth(*taken, np.where(path.switch_times <= last, path.switch_times, np.nan)))
    return parts[0], parts[1]


def simulate_tracks(source: Source, count: int, seed: int) -> Tracks:
    """Tracks of a scenario: what estimators, learners and benchmarks take.

    Track i comes from the generator of ``seed + i``, exactly as the first episode of environment i does that is reset
    with ``seed``. Each measurement carries the nominal noise, which is all that a filter is told.

    Args:
        source: a scenario or recorded tracks.
        count: tracks, >= 1.
        seed: >= 0.

    Returns:
        tracks named by their seeds, with true positions, velocities and intents.

    Raises:
        ValueError: ``count`` or ``seed`` out of range.
    """
    for name, value, low in (("count", count, 1), ("seed", seed, 0)):
        if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < low:
            raise ValueError(
                f"simulate_tracks: {name} must be an integer >= {low}; got {value!r}. Give a whole number."
            )
    seeds = range(int(seed), int(seed) + int(count))
    episodes = source.simulate([make_streams(seeding.np_random(number)[0]) for number in seeds])
    B, T = episodes.times.shape
    return Tracks(
        ids=tuple(str(number) for number in seeds),
        times=episodes.times,
        measurements=episodes.measurements,
        sensor=source.sensor.name,
        lengths=np.full(B, T),
        axes=source.axes,
        noise=np.broadcast_to(episodes.nominal_noise, (B, T, *episodes.nominal_noise.shape)),
        sensor_states=episodes.sensor_states,
        truth=episodes.truth.position,
        truth_velocity=episodes.truth.velocity,
        intents=np.asarray(source.intents, dtype=np.str_)[episodes.truth.intent],
        source=source.id,
    )
