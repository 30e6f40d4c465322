"""Labels found without supervision in recorded tracks, against given ones.

Methods: intents (IntentLearner and its smoother), segment-cluster, sticky AR-HMM, mixture of regressions; given labels
are looked at after training only. Accuracy is under one naming pooled over all tracks of a data set; `segment-cluster`
and the others choose their number of labels by BIC, the learner by held-out likelihood; `--intents K` gives it to all.
Beside them: one label for everything, and `told`, which was fitted with the labels (a Gaussian of the encoder's shape
parameters for each, and their Markov chain). Columns that begin with "merged": found labels are first merged into the
given label they mostly go with, so that finding more of them costs nothing.

python benchmarks/label_recorded.py --data DIR --seeds 3 --out labels.json --models DIR
python benchmarks/label_recorded.py --table labels.json
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from jink.envs.recorded import read_tracks
from jink.estimators.tracks import Tracks
from jink.intent.baselines.autoregressive import StickyRegression
from jink.intent.baselines.regressions import RegressionMixture
from jink.intent.baselines.segment_cluster import SegmentCluster
from jink.intent.features import encode
from jink.intent.headings import heading_tracks
from jink.intent.hidden_chain import smooth_labels
from jink.intent.model import IntentModel
from jink.intent.model_file import save_model
from jink.intent.segmentation import Segmentation, segment
from jink.intent.segmentation_scores import score_segmentation
from jink.intent.window import choose_window

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


def unit_directions(components: Floats) -> Floats:
    """Direction components (T, 2) that a source has shifted and scaled, back on the unit circle.

    They lie on an ellipse, exactly; labels are not needed. Without it angles are bent by up to half a radian.
    """
    x, y = components.T
    squares = np.stack([x * x, x, y * y, y], axis=1)
    a, b, c, d = np.linalg.lstsq(squares, np.ones(len(x)), rcond=None)[0]
    middle = np.array([-0.5 * b / a, -0.5 * d / c])
    size = np.array([a, c]) / (1.0 + a * middle[0] ** 2 + c * middle[1] ** 2)
    return np.asarray((components - middle) * np.sqrt(size))


def dancing_bees(folder: Path) -> Recording:
    """Sequence 4; the head gives the body frame.

    AR-HMM: frame-to-frame change of the head's direction. The others see the path of a point that follows the head at
    one unit per second: a turn of the body is an arc of it, a waggle a rapid change of its turn rate.
    """
    table = np.loadtxt(folder / "dancing_bees" / "seq4_labelled.csv", delimiter=",", skiprows=1)
    along, across = unit_directions(table[:, 2:4]).T
    head = np.arctan2(across, along)
    turned = np.angle(np.exp(1j * np.diff(head)))
    tracks = heading_tracks(head, np.arange(len(table)) * FRAME_S)
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
    made = _cut_files(folder / "gliders_igc", ("napret", "new_zealand"), {})
    labels = _words(made)
    return Recording(made, np.where(labels == "ground", "", labels), 8.0, noise_sd=2.0)


def aircraft_adsb(folder: Path) -> Recording:
    """Aircraft in the plane; straight, left, right: the first letter of the labels.

    Without the two files of stale and jumping positions, and the five hours of `belevingsvlucht`, which would outweigh
    the rest.
    """
    names = ("anzac_day", "franconia", "kiwi", "munich", "pixair_toulouse", "rega_sg")
    made = _cut_files(folder / "aircraft_adsb", names, {"fresh": "1"})
    return Recording(made, _words(made).astype("<U1"), 20.0, noise_sd=30.0)


def _cut_files(folder: Path, names: Sequence[str], where: dict[str, str]) -> Tracks:
    """Stretches of several files as one container, labels from the column `label`."""
    parts, times, words = [], [], []
    for name in names:
        found = read_tracks(folder / f"{name}.csv", {"intent": "label"}, axes=2, where=where)
        made, labels = cut(found, _words(found))
        for b, track in enumerate(made):
            parts.append(track.measurements)
            times.append(track.times)
            words.append(labels[b, : len(track.times)])
    return Tracks.from_arrays(parts, times, intents=words)


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
    LAST[:] = [learner.model_]
    return segment(learner.model_, tracks, handed=True), learner.model_.describe()


LAST: list[IntentModel] = []
"""What `by_intents` learnt last."""


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


def told(recording: Recording, count: int | None, seed: int, seconds: float) -> tuple[Segmentation, str]:
    """Fitted with the labels: a Gaussian of the shape parameters for each label, and the rates between them."""
    tracks, labels = with_noise(recording), recording.labels
    series, space = recording.series, np.array([], dtype=np.float64)
    if series is None:
        sigma = None if recording.noise_sd is None else recording.noise_sd
        features = encode(tracks, choose_window(tracks, sigma), sigma)
        eta = features.eta
        turn = eta[..., 1:] if tracks.axes == 2 else np.linalg.norm(eta[..., 1:], axis=2, keepdims=True)
        space = np.concatenate([eta[..., :1], turn], axis=2)
        # where it hardly moves a turn rate means nothing, but the speed does
        speed = np.log(np.maximum(np.linalg.norm(features.velocity, axis=2, keepdims=True), 0.1))
        limits = np.nanquantile(np.where(features.valid[..., None], space, np.nan), (0.005, 0.995), axis=(0, 1))
        space = np.concatenate([np.clip(space, *limits), speed], axis=2)
        space = np.where(features.valid[..., None], space, np.nan)
    else:
        space = series
    words = sorted(set(np.unique(labels[tracks.used]).tolist()) - {""})
    K, known = len(words), np.isfinite(space).all(axis=2) & tracks.used
    rows = np.zeros((*labels.shape, K))
    for k, word in enumerate(words):
        mine = space[known & (labels == word)]
        cov = np.cov(mine.T).reshape(space.shape[2], -1) + 1e-9 * np.eye(space.shape[2])
        away = np.where(known[..., None], space - mine.mean(axis=0), 0.0)
        squares = np.einsum("bti,ij,btj->bt", away, np.linalg.inv(cov), away)
        rows[..., k] = np.where(known, -0.5 * squares - 0.5 * np.linalg.slogdet(cov)[1], 0.0)
    counts = np.ones((K, K))
    for b, length in enumerate(tracks.lengths):
        for before, after in zip(labels[b, : length - 1], labels[b, 1:length], strict=True):
            if before and after:
                counts[words.index(before), words.index(after)] += 1.0
    chain = counts / counts.sum(axis=1, keepdims=True)
    probs, evidence = np.zeros(rows.shape), np.zeros(len(rows))
    steps = np.diff(tracks.times, axis=1, prepend=tracks.times[:, :1])
    initial = np.full(K, 1.0 / K)
    smooth_labels(rows, steps, tracks.lengths, chain, False, initial, probs, np.zeros((K, K)), evidence)
    return Segmentation.of_probs(probs, tracks.times, tracks.lengths, names=tuple(words)), ""


def merged(found: Segmentation, labels: NDArray[np.str_]) -> Segmentation:
    """Found labels merged into the given label they mostly go with."""
    known = (found.labels >= 0) & (labels != "")
    words = sorted(set(np.unique(labels[known]).tolist()))
    member = np.zeros((found.probs.shape[2], len(words)))
    for p in range(len(member)):
        beside = labels[known & (found.labels == p)]
        counts = [np.count_nonzero(beside == word) for word in words]
        member[p, int(np.argmax(counts))] = 1.0
    into = member.argmax(axis=1)
    label = np.where(found.labels >= 0, into[np.maximum(found.labels, 0)], -1)
    return Segmentation(label, found.probs @ member, found.times, found.lengths, tuple(words), window=found.window)


METHODS: dict[str, Callable[[Recording, int | None, int, float], tuple[Segmentation, str]]] = {
    "intents": by_intents,
    "segment-cluster": by_clusters,
    "ar-hmm": by_regression,
    "regressions": by_curves,
    "told": told,
}
SEEDLESS = ("told",)


def main() -> None:
    """Run, print, save; or make the table of saved rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path)
    parser.add_argument("--only", default=",".join(RECORDINGS))
    parser.add_argument("--methods", default=",".join(METHODS))
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--intents", type=int)
    parser.add_argument("--seconds", type=float, default=300.0, help="budget of the learner for one training")
    parser.add_argument("--out", type=Path, help="rows are appended; what is in it is not run again")
    parser.add_argument("--models", type=Path, help="folder for the models of the intent learner, seed 0")
    parser.add_argument("--table", type=Path, help="print the table of these rows in Markdown and end")
    options = parser.parse_args()
    if options.table:
        print_table(json.loads(options.table.read_text()))
        return
    rows: list[dict[str, Any]] = json.loads(options.out.read_text()) if options.out and options.out.exists() else []
    done = {(row["data"], row["method"], row["seed"]) for row in rows}
    for name in options.only.split(","):
        recording = RECORDINGS[name](options.data)
        for method in options.methods.split(","):
            for seed in range(1 if method in SEEDLESS else options.seeds):
                if (name, method, seed) in done:
                    continue
                rows.append(_one(name, method, seed, recording, options.intents, options.seconds))
                print({k: v for k, v in rows[-1].items() if k not in ("described", "naming")}, flush=True)
                print(rows[-1].get("described", ""), flush=True)
                if options.models and method == "intents" and seed == 0 and LAST:
                    save_model(LAST[0], options.models / name)
                if options.out:
                    options.out.write_text(json.dumps(rows, indent=1) + "\n")
    print_table(rows)


def _one(name: str, method: str, seed: int, recording: Recording, count: int | None, seconds: float) -> dict[str, Any]:
    """One row; a refusal is one too."""
    began, spent = time.perf_counter(), time.process_time()
    try:
        found, words = METHODS[method](recording, count, seed, seconds)
    except ValueError as refusal:
        return {"data": name, "method": method, "seed": seed, "status": f"refused: {refusal}"}
    took = {"seconds": round(time.perf_counter() - began, 1), "cpu_s": round(time.process_time() - spent, 1)}
    score = score_segmentation(found, recording.labels, recording.tolerance_s)
    fewer = score_segmentation(merged(found, recording.labels), recording.labels, recording.tolerance_s)
    return {
        "data": name, "method": method, "seed": seed, "status": "ok", "labels": found.probs.shape[2], **took,
        "described": words, **score._asdict(), **{f"merged_{key}": getattr(fewer, key) for key in _MERGED},
        "tolerance_s": recording.tolerance_s,
    }  # fmt: skip


_MERGED = ("accuracy", "nmi", "ari", "f1")
_SHOWN = ("accuracy", "nmi", "ari", "f1", "purity", "merged_nmi", "merged_ari", "merged_f1")


def print_table(rows: list[dict[str, Any]]) -> None:
    """Mean over seeds, and the smallest and largest where they differ."""
    header = ["data", "method", "seeds", "labels", "accuracy", "NMI", "ARI", "change-point F1", "purity",
              "merged NMI", "merged ARI", "merged F1"]  # fmt: skip
    print("| " + " | ".join(header) + " |", "|" + "---|" * len(header), sep="\n")
    for name in dict.fromkeys(row["data"] for row in rows):
        mine = [row for row in rows if row["data"] == name]
        fine = [row for row in mine if row["status"] == "ok"]
        if fine:
            most = f"{fine[0]['majority']:.3f}"
            print("| " + " | ".join([name, "one label", "", "1", most, "0", "0", "0", most, "0", "0", "0"]) + " |")
        for method in dict.fromkeys(row["method"] for row in mine):
            some = [row for row in fine if row["method"] == method]
            if not some:
                said = next(row["status"] for row in mine if row["method"] == method)
                print(f"| {name} | {method} | | {said} | | | | | | | | |")
                continue
            counts = sorted({row["labels"] for row in some})
            cells = [_spread([row[key] for row in some]) for key in _SHOWN]
            words = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]}-{counts[-1]}"
            print("| " + " | ".join([name, method, f"{len(some)}", words, *cells]) + " |")


def _spread(values: list[float]) -> str:
    low, high = min(values), max(values)
    middle = f"{np.mean(values):.3f}".replace("0.", ".", 1)
    return middle if high - low < 5e-4 else f"{middle} ({low:.2f}-{high:.2f})".replace("0.", ".")


if __name__ == "__main__":
    main()
