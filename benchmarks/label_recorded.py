"""Labels found without supervision in recorded tracks, against given ones.

Methods: intents (IntentLearner and its smoother), segment-cluster, sticky AR-HMM, mixture of regressions; given labels
are looked at after training only. Accuracy is under one naming pooled over all tracks of a data set; `segment-cluster`
and the others choose their number of labels by BIC, the learner by held-out likelihood; `--intents K` gives it to all.

python benchmarks/label_recorded.py --data ../shared/data --only dancing_bees --seeds 3 --out labels.json
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from jink.envs.recorded import read_tracks
from jink.estimators.tracks import Tracks
from jink.intent.baselines.autoregressive import StickyRegression
from jink.intent.baselines.regressions import RegressionMixture
from jink.intent.baselines.segment_cluster import SegmentCluster
from jink.intent.segmentation import Segmentation, segment
from jink.intent.segmentation_scores import SegmentationScore, score_segmentation

Floats = NDArray[np.float64]
FRAME_S = 1.0 / 30.0
STRETCH = 300  # rows: long flights are cut, so that every stretch is a track of its own


@dataclass(frozen=True)
class Recording:
    """Tracks, their labels, how near change points must lie (s), and increments in a given body frame, if any."""

    tracks: Tracks
    labels: NDArray[np.str_]
    tolerance_s: float
    series: Floats | None = None
    noise_sd: float | None = None


def dancing_bees(folder: Path) -> Recording:
    """Sequence 4; the head gives the body frame.

    AR-HMM: frame-to-frame change of the head's direction. The others see the path of a point that follows the head at
    one unit per second: a turn of the body is an arc of it, a waggle a rapid change of its turn rate.
    """
    table = np.loadtxt(folder / "dancing_bees" / "seq4_labelled.csv", delimiter=",", skiprows=1)
    head = np.arctan2(table[:, 3], table[:, 2])
    turned = np.angle(np.exp(1j * np.diff(head)))
    path = np.cumsum(np.stack([np.cos(head), np.sin(head)], axis=1), axis=0) * FRAME_S
    times = np.arange(len(table)) * FRAME_S
    # a head direction is good to about 0.1 rad, so a step of the path to a tenth of its length
    tracks = Tracks.from_arrays(path, times, noise=np.eye(2) * (0.1 * FRAME_S) ** 2)
    names = np.array(["turn+", "turn-", "waggle"])[table[:, 4].astype(int)]
    return Recording(tracks, names[None], 0.2, np.concatenate([[np.nan], turned])[None, :, None])


def cut(tracks: Tracks, labels: NDArray[np.str_], rows: int = STRETCH) -> tuple[Tracks, NDArray[np.str_]]:
    """Stretches of at most ``rows`` rows as tracks of their own."""
    parts, times, words = [], [], []
    for b, track in enumerate(tracks):
        for first in range(0, len(track.times), rows):
            last = min(first + rows, len(track.times))
            if last - first >= 20:
                parts.append(track.measurements[first:last])
                times.append(track.times[first:last] - track.times[first])
                words.append(labels[b, first:last])
    made = Tracks.from_arrays(parts, times, intents=words)
    assert made.intents is not None
    return made, made.intents


def gliders_igc(folder: Path) -> Recording:
    """Two logger flights in the plane; circles to the left and right, straight; the ground is left out."""
    files = [read_tracks(folder / "gliders_igc" / name, {"intent": "label"}, axes=2) for name in ("napret.csv",)]
    tracks, labels = cut(files[0], _words(files[0]))
    return Recording(tracks, np.where(labels == "ground", "", labels), 8.0, noise_sd=2.0)


def aircraft_adsb(folder: Path) -> Recording:
    """Aircraft in the plane; straight, left, right: the first letter of the labels."""
    parts, times, words = [], [], []
    for name in ("anzac_day", "franconia", "munich", "pixair_toulouse", "rega_sg"):
        found = read_tracks(folder / "aircraft_adsb" / f"{name}.csv", {"intent": "label"}, axes=2, where={"fresh": "1"})
        made, labels = cut(found, _words(found))
        for b, track in enumerate(made):
            parts.append(track.measurements)
            times.append(track.times)
            words.append(np.array([word[:1] for word in labels[b, : len(track.times)]]))
    made = Tracks.from_arrays(parts, times, intents=words)
    assert made.intents is not None
    return Recording(made, made.intents, 20.0, noise_sd=30.0)


def rockets(folder: Path) -> Recording:
    """One flight, GNSS at 1 Hz in space; the flight computer's phases."""
    path = folder / "rockets" / "prometheus_telemega.csv"
    columns = {"alt": "gps_altitude", "intent": "state_name"}
    tracks = read_tracks(path, columns, axes=3, where={"gps_new": "1"})
    return Recording(tracks, _words(tracks), 3.0, noise_sd=3.0)


def plaza_range(folder: Path) -> Recording:
    """A mower: positions of its reference receiver; turning where its heading changes by more than 0.15 rad/s."""
    table = pd.read_csv(folder / "plaza_range" / "plaza1_truth.csv")
    clock, heading = table["time"].to_numpy(), np.unwrap(table["heading"].to_numpy())
    span = 4  # rows on either side: two seconds
    rate = np.zeros(len(clock))
    rate[span:-span] = (heading[2 * span :] - heading[: -2 * span]) / (clock[2 * span :] - clock[: -2 * span])
    words = np.where(rate > 0.15, "left", np.where(rate < -0.15, "right", "straight"))
    whole = Tracks.from_arrays(table[["x", "y"]].to_numpy(), clock, intents=words)
    tracks, labels = cut(whole, words[None])
    return Recording(tracks, labels, 2.0, noise_sd=0.05)


def _words(tracks: Tracks) -> NDArray[np.str_]:
    if tracks.intents is None:
        raise SystemExit(f"{tracks.source}: no label column")
    return tracks.intents


RECORDINGS: dict[str, Callable[[Path], Recording]] = {
    "dancing_bees": dancing_bees,
    "gliders_igc": gliders_igc,
    "aircraft_adsb": aircraft_adsb,
    "rockets": rockets,
    "plaza_range": plaza_range,
}


def with_noise(recording: Recording) -> Tracks:
    """The tracks with the noise that the receiver is known for."""
    tracks = recording.tracks
    if recording.noise_sd is None:
        return tracks
    one = np.eye(tracks.axes) * recording.noise_sd**2
    noise = np.broadcast_to(one, (*tracks.times.shape, *one.shape))
    return Tracks(
        tracks.ids, tracks.times, tracks.measurements, tracks.sensor, tracks.lengths, tracks.axes, noise=noise
    )


def by_intents(recording: Recording, count: int | None, seed: int, seconds: float) -> tuple[Segmentation, str]:
    """The learner of intents and its smoother."""
    from jink.intent.learner import IntentLearner

    tracks = with_noise(recording)
    learner = IntentLearner(tracks.axes, count, seed=seed, seconds=seconds).fit(tracks)
    return segment(learner.model_, tracks, handed=True), learner.model_.describe()


def by_clusters(recording: Recording, count: int | None, seed: int, seconds: float) -> tuple[Segmentation, str]:
    """Segment, then cluster; left and right of turning clusters are labels."""
    made = SegmentCluster(count, seed=seed).fit(with_noise(recording))
    mean = made.mean_
    words = "; ".join(f"{100 * g:.1f} %/s, {np.degrees(w):.1f} deg/s" for g, w in mean)
    return made.segment(with_noise(recording), handed=True), words


def by_regression(recording: Recording, count: int | None, seed: int, seconds: float) -> tuple[Segmentation, str]:
    """Sticky AR-HMM; in a given body frame of order 1, as published for these data."""
    tracks = with_noise(recording)
    made = StickyRegression(count, order=0 if recording.series is None else 1, seed=seed)
    made.fit(tracks, recording.series)
    return made.segment(tracks, recording.series), f"order {made.order_}"


def by_curves(recording: Recording, count: int | None, seed: int, seconds: float) -> tuple[Segmentation, str]:
    """Mixture of regressions over pieces."""
    made = RegressionMixture(count, seed=seed).fit(with_noise(recording))
    return made.segment(with_noise(recording)), ""


METHODS: dict[str, Callable[[Recording, int | None, int, float], tuple[Segmentation, str]]] = {
    "intents": by_intents,
    "segment-cluster": by_clusters,
    "ar-hmm": by_regression,
    "regressions": by_curves,
}


def main() -> None:
    """Run, print, save."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--only", default=",".join(RECORDINGS))
    parser.add_argument("--methods", default=",".join(METHODS))
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--intents", type=int)
    parser.add_argument("--seconds", type=float, default=300.0, help="budget of the learner for one training")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    console = Console(width=160)
    for name in options.only.split(","):
        recording = RECORDINGS[name](options.data)
        table = Table(title=f"{name}: {int(recording.tracks.lengths.sum())} rows, tolerance {recording.tolerance_s} s")
        for column in ("method", "seed", "labels", *_SHOWN, "s"):
            table.add_column(column, justify="left" if column == "method" else "right")
        for method in options.methods.split(","):
            for seed in range(options.seeds):
                began = time.perf_counter()
                try:
                    found, words = METHODS[method](recording, options.intents, seed, options.seconds)
                except ValueError as refusal:
                    rows.append({"data": name, "method": method, "seed": seed, "status": f"refused: {refusal}"})
                    console.print(f"{name} {method} {seed}: {refusal}", highlight=False)
                    continue
                spent = time.perf_counter() - began
                score = score_segmentation(found, recording.labels, recording.tolerance_s)
                rows.append(_row(name, method, seed, found, score, words, spent))
                table.add_row(
                    method, str(seed), str(found.probs.shape[2]), *(f"{getattr(score, s):.3f}" for s in _SHOWN),
                    f"{spent:.0f}",
                )  # fmt: skip
                console.print(f"{name} {method} {seed}: {words}", highlight=False)
                if options.out:
                    options.out.write_text(json.dumps(rows, indent=1))
        console.print(table)


_SHOWN = ("accuracy", "purity", "majority", "nmi", "ari", "f1")


def _row(
    name: str, method: str, seed: int, found: Segmentation, score: SegmentationScore, words: str, spent: float
) -> dict[str, Any]:
    return {
        "data": name, "method": method, "seed": seed, "status": "ok",
        "labels": found.probs.shape[2], "seconds": round(spent, 1),
        "described": words, **score._asdict(),
    }  # fmt: skip


if __name__ == "__main__":
    main()
