"""Recorded ultra-wideband fixes with bursts of gross errors: every robust recipe beside a plain Kalman filter.

Least-squares fixes of two walks with GNSS truth (`uwb_outdoor/*_lsq_position.csv`), read as
`jink track FILE --truth TRUTH --truth-columns t=time_aligned --axes 2` reads them; scales are chosen from each file
without its truth and are the same for all. `student-t` is one constant-velocity mode with heavy tails. RMS position in
metres over all rows with truth; differences are of the same rows, with the 95 % interval of a bootstrap of blocks of
time, because neighbouring errors are alike: it lies below zero just where the one of mean squares does.

python benchmarks/recorded_bursts.py --data DIR --seed 0 --out recorded_bursts.json
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from _paired import Floats, minus, parser, save, short, show, shown

from jink.estimators.api import BankEstimator
from jink.estimators.bank import Mode
from jink.estimators.metrics import errors
from jink.estimators.recipes import Scales, kf_cv, make_estimator
from jink.estimators.tracks import Tracks
from jink.estimators.treatments import BoundedTails, HeavyTails
from jink.training.console import progress
from jink.training.intervals import Measured, Score, measure, resample_blocks
from jink.training.running import raw_positions, run_tracks
from jink.training.track import Choice, TrackRequest, choose, read
from jink.training.weighted import root_mean

FOLDER = "uwb_outdoor"
SINGLES = {"student-t": HeavyTails(3.0), "bounded-tails": BoundedTails(3.0)}
NAMES = (
    "kf-cv",
    "student-t",
    "bounded-tails",
    "imm",
    "intent-imm",
    "student-t-imm",
    "robust-imm",
    "joint-imm",
    "sage-husa",
    "vb-noise",
    "agent",
)
BASES = ("kf-cv", "student-t", "student-t-imm")


def make(name: str, choice: Choice) -> BankEstimator:
    """A recipe, or a single filter with a treatment, at the scales of the file."""
    if name not in SINGLES:
        return make_estimator(name, choice.sensor, **choice.options)
    bank = kf_cv(choice.sensor, Scales(**choice.options))
    return BankEstimator(bank.with_(modes=(Mode("cv", bank.modes[0].motion, SINGLES[name]),)), name=name)


def squares(place: Floats, tracks: Tracks) -> Floats:
    """Squared position errors of all rows, NaN without truth; m^2."""
    return errors(place, tracks.truth, None, tracks.used)[tracks.used] ** 2


def numbers_of(request: TrackRequest, seed: int) -> tuple[dict[str, Measured], Choice, str]:
    """RMS of each estimator, differences to each base, the scales, and how intervals were found."""
    tracks = read(request)
    choice = choose(request, tracks)
    found = {"measured": squares(raw_positions(tracks), tracks)}
    with progress(request.file.stem, len(NAMES)) as advance:
        for name in NAMES:
            estimates = run_tracks(make(name, choice), tracks, use_noise=choice.use_noise)
            found[name] = squares(np.asarray(estimates.position), tracks)
            advance()
    unknown = np.any([np.isnan(values) for values in found.values()], axis=0)
    rms = {name: root_mean(np.where(unknown, np.nan, values)) for name, values in found.items()}
    scores = {name: Score(statistic, "m") for name, statistic in rms.items()}
    for base in BASES:
        scores |= {f"{name} - {base}": Score(minus(value, rms[base]), "m") for name, value in rms.items()}
    numbers = measure(scores, resample_blocks(tracks.times, tracks.lengths, seed))
    return numbers, choice, f"{(~unknown).sum()} rows; {numbers['kf-cv'].interval}"


def main() -> None:
    """Read, run, print, save."""
    options = parser(__doc__, None)
    options.add_argument("--data", type=Path, help=f"folder that holds {FOLDER}/ (default: $JINK_DATA)")
    given = options.parse_args()
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = (given.data or Path(os.environ.get("JINK_DATA", beside))) / FOLDER
    files = sorted(folder.glob("*_lsq_position.csv"))
    if not files:
        print(
            f"recorded_bursts: --data must hold {FOLDER}/*_lsq_position.csv; nothing done. Name the folder of tracks."
        )
        return
    saved: dict[str, Measured] = {}
    for file in files:
        run = file.name.removesuffix("_lsq_position.csv")
        truth = file.with_name(f"{run}_truth.csv")
        request = TrackRequest(file, axes=2, truth=truth, truth_columns="t=time_aligned")
        numbers, choice, words = numbers_of(request, given.seed)
        saved |= {f"{run}/{name}": number for name, number in numbers.items()}
        rows = []
        for name in ("measured", *NAMES):
            gaps = ("" if name == base else shown(numbers[f"{name} - {base}"], "+", 2) for base in BASES)
            rows.append([name, short(numbers[name].value), *gaps])
        scales = ", ".join(f"{p.name} {p.value:.3g} ({p.origin})" for p in choice.parameters if p.value is not None)
        header = ["estimator", "RMS m", *(f"more than {base} [95 %]" for base in BASES)]
        show(f"{run}: {words}\n{scales}", header, rows, given.markdown)
    save(given.out, saved, seed=given.seed)


if __name__ == "__main__":
    main()
