"""Follow 1000 simulated radar targets and compare what a switch of intent does to a bank: birth, mix, jet, none.

python benchmarks/radar_births.py --data DIR            # scenes 300-999, the table of docs/radar.md
python benchmarks/radar_births.py --data DIR --quick    # 100 scenes, no smoothers
python benchmarks/radar_births.py --data DIR --fit      # first fit the scales again on scenes 0-299 (minutes)

DIR holds OneManeuveringTarget3D/train_first1000.npz. The scales below were fitted by likelihood on scenes 0-299,
each estimator's own; truth took no part in it. Position RMSE is over all scenes and all frames, the first included.
A scene is lost where its RMSE is above that of its own detections.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.optimize import minimize

from jink.estimators.api import BankEstimator
from jink.estimators.bank import Bank, Mode
from jink.estimators.markov import MarkovChain
from jink.estimators.motion import Motion
from jink.estimators.motions import constant_acceleration, constant_velocity, singer, spatial_turn
from jink.estimators.sensors import position, range_bearing_elevation

FILE = Path("OneManeuveringTarget3D") / "train_first1000.npz"
FRAME = 0.4  # s
SIGMA = (20.5, 5.3e-3, 5.4e-3)  # range (m), azimuth, elevation (rad), from the data's description
SPEED = 380.0  # m/s, velocity of a component before anything is known
FITTED_ON = 300
BASELINE = "singer"

Floats = NDArray[np.float64]


class Radar(NamedTuple):
    """Scenes: detections (B, T, 3) m, their covariances (B, T, 3, 3), truth (B, T, 3), spherical (B, T, 3), times."""

    detections: Floats
    noise: Floats
    truth: Floats
    spherical: Floats
    times: Floats

    def part(self, begin: int, end: int, step: int = 1) -> Radar:
        """Some of the scenes."""
        chosen = slice(begin, end, step)
        return Radar(
            self.detections[chosen], self.noise[chosen], self.truth[chosen], self.spherical[chosen], self.times
        )


def load(folder: Path) -> Radar:
    """The scenes in ``folder``; radar at the origin.

    Model: ``R = J diag(sigma^2) J'`` with J the slope of the place against range, azimuth and elevation, taken at
    the detection: an arc of 5 mrad bends by 0.2 m at 15 km, far below the noise.

    Raises:
        SystemExit: no such file.
    """
    path = folder / FILE
    if not path.is_file():
        raise SystemExit(f"radar_births: --data must hold {FILE}; got {folder}. Point it at the recorded data.")
    with np.load(path) as scenes:
        z = scenes["detections"].astype(np.float64)
        truth = scenes["states"][..., [0, 3, 6]].astype(np.float64)
    distance = np.linalg.norm(z, axis=-1)
    ground = np.hypot(z[..., 0], z[..., 1])
    along = z / distance[..., None]
    across = np.stack([-z[..., 1], z[..., 0], np.zeros_like(ground)], axis=-1) / ground[..., None]
    slope = np.stack(
        [
            SIGMA[0] * along,
            SIGMA[1] * ground[..., None] * across,
            SIGMA[2] * distance[..., None] * np.cross(along, across),
        ],
        axis=-1,
    )
    spherical = np.stack([distance, np.arctan2(z[..., 1], z[..., 0]), np.arctan2(z[..., 2], ground)], axis=-1)
    times = FRAME * np.arange(z.shape[1])
    return Radar(z, slope @ slope.swapaxes(-1, -2), truth, spherical, times)


def shared_names(motion: Motion) -> Motion:
    """The motion with its own parameters called c1, c2, c3, so that ``mix`` takes unlike parameters for equal ones."""
    own = {label: f"c{k + 1}" for k, label in enumerate(motion.own_labels)}
    labels = tuple(own.get(label, label) for label in motion.labels)
    return motion.with_(labels=labels, own=tuple(own.values()))


def make_bank(
    scales: Floats, interaction: str, unlike: bool = False, zero: bool = False, polar: bool = False
) -> BankEstimator:
    """Constant velocity, constant acceleration and turn in space, from nine scales.

    In order: acceleration density of cv; jerk density and birth sd of the acceleration of ca; acceleration density,
    rate density and birth sd of the rate of the turn; mean sojourn in each. m, s, rad.
    """
    q, jerk, acceleration_sd, wobble, drift, rate_sd = (float(scale) for scale in scales[:6])
    motions = [
        constant_velocity(3, acceleration_density=q),
        constant_acceleration(3, jerk_density=jerk, acceleration_sd=acceleration_sd),
        spatial_turn(acceleration_density=wobble, rate_density=drift, rate_sd=rate_sd),
    ]
    if unlike:
        motions = [shared_names(motion) for motion in motions]
    if zero:  # a birth without spread is a conversion that fills with zeros
        motions = [motion.with_(birth_sd=(0.0,) * len(motion.own_labels)) for motion in motions]
    return BankEstimator(
        Bank(
            tuple(Mode(name, motion) for name, motion in zip(("cv", "ca", "turn"), motions)),
            range_bearing_elevation(SIGMA) if polar else position(3, sigma=70.0),
            chain=MarkovChain.from_sojourns([float(scale) for scale in scales[6:]]),
            interaction=interaction,
            speed=SPEED,
        ),
        threads=1,
    )


def make_single(motion: Motion) -> BankEstimator:
    """One Kalman filter."""
    return BankEstimator(Bank((Mode(motion.name, motion),), position(3, sigma=70.0), speed=SPEED), threads=1)


@dataclass(frozen=True)
class Entry:
    """One row of the table: how it is built from its scales, the fitted scales, and whose they are."""

    make: Callable[[Floats], BankEstimator]
    scales: tuple[float, ...]
    smoothed: bool = False
    polar: bool = False
    scales_of: str | None = None


START = (50.0, 100.0, 40.0, 50.0, 3e-4, 0.09, 6.0, 6.0, 6.0)  # where every fit of a bank begins
CV = (3016.0,)
CA = (434.6, 5.973)
SINGER = (4.292, 37.94)
BIRTH = (14.79, 204.3, 36.21, 35.85, 6.3e-4, 0.07245, 4.593, 6.746, 9.06)
MIX = (38.14, 390.8, 31.66, 27.23, 1.701e-3, 0.03077, 4.952, 6.513, 8.221)
JET = (17.38, 373.2, 29.79, 34.15, 1.688e-3, 0.04585, 4.239, 5.421, 7.552)
ZERO = (18.89, 476.0, 17.35, 41.97, 1.869e-3, 0.08788, 4.041, 7.612, 8.441)
NONE = (497.4, 380.9, 6.151, 94.84, 1.486e-3, 0.01101, 2.419, 6.046, 9.999)

ENTRIES: dict[str, Entry] = {
    "kf-cv": Entry(lambda s: make_single(constant_velocity(3, acceleration_density=s[0])), CV),
    "kf-ca": Entry(lambda s: make_single(constant_acceleration(3, jerk_density=s[0], acceleration_sd=s[1])), CA),
    "singer": Entry(lambda s: make_single(singer(3, time_constant=s[0], acceleration_sd=s[1])), SINGER),
    "mix, unlike parameters": Entry(lambda s: make_bank(s, "mix", unlike=True), BIRTH, scales_of="birth"),
    "mix, birth's scales": Entry(lambda s: make_bank(s, "mix"), BIRTH, scales_of="birth"),
    "none, birth's scales": Entry(lambda s: make_bank(s, "none"), BIRTH, scales_of="birth"),
    "zero-filled, birth's scales": Entry(lambda s: make_bank(s, "birth", zero=True), BIRTH, scales_of="birth"),
    "none": Entry(lambda s: make_bank(s, "none"), NONE),
    "jet": Entry(lambda s: make_bank(s, "jet"), JET),
    "mix": Entry(lambda s: make_bank(s, "mix"), MIX),
    "zero-filled": Entry(lambda s: make_bank(s, "birth", zero=True), ZERO),
    "birth": Entry(lambda s: make_bank(s, "birth"), BIRTH),
    "birth, spherical": Entry(lambda s: make_bank(s, "birth", polar=True), BIRTH, polar=True, scales_of="birth"),
    "singer, smoothed": Entry(
        lambda s: make_single(singer(3, time_constant=s[0], acceleration_sd=s[1])), SINGER, True, scales_of="singer"
    ),
    "birth, smoothed": Entry(lambda s: make_bank(s, "birth"), BIRTH, True, scales_of="birth"),
}
QUICK = ("kf-cv", "singer", "mix, unlike parameters", "none", "mix", "birth")


def estimate(entry: Entry, radar: Radar, scales: Floats | None = None) -> Any:
    """`Estimates` of one entry on all scenes of ``radar``."""
    estimator = entry.make(np.array(entry.scales if scales is None else scales))
    go = estimator.smooth if entry.smoothed else estimator.run
    if entry.polar:
        return go(radar.spherical, radar.times)
    return go(radar.detections, radar.times, radar.noise)


def scene_errors(found: Floats, radar: Radar) -> Floats:
    """Mean squared position error of each scene; (B,); m^2."""
    return np.square(found - radar.truth).sum(axis=-1).mean(axis=-1)


def fit(name: str, radar: Radar, evaluations: int) -> Floats:
    """Scales of one entry that make the detections likeliest, by Nelder-Mead banks from `START`."""
    written = ENTRIES[name].scales
    start = np.log(START if len(written) == len(START) else written)

    def cost(logs: Floats) -> float:
        return -float(estimate(ENTRIES[name], radar, np.exp(logs)).log_likelihood.sum()) / radar.truth[..., 0].size

    simplex = np.vstack([start, start + 0.5 * np.eye(len(start))])
    options = {"initial_simplex": simplex, "maxfev": evaluations, "xatol": 0.02, "fatol": 2e-5, "adaptive": True}
    return np.exp(minimize(cost, start, method="Nelder-Mead", options=options).x)


def interval(errors: Floats, base: Floats | None = None, draws: int = 2000) -> tuple[float, float]:
    """95 % bootstrap interval over scenes of the RMSE, or of its difference to ``base`` on the same scenes."""
    rng = np.random.default_rng(1)
    chosen = rng.integers(0, len(errors), (draws, len(errors)))
    values = np.sqrt(errors[chosen].mean(axis=1))
    if base is not None:
        values = values - np.sqrt(base[chosen].mean(axis=1))
    low, high = np.quantile(values, (0.025, 0.975))
    return float(low), float(high)


def main() -> int:
    """Run the comparison and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder of recorded data")
    parser.add_argument("--quick", action="store_true", help="scenes 300-399 and no smoothers")
    parser.add_argument("--fit", action="store_true", help="fit the scales on scenes 0-299 first")
    parser.add_argument("--evaluations", type=int, default=110, help="likelihoods per fit")
    parser.add_argument("--markdown", action="store_true", help="print the table as Markdown")
    options = parser.parse_args()
    console = Console(width=140)
    everything = load(options.data)
    radar = everything.part(FITTED_ON, 400 if options.quick else 1000)
    names = QUICK if options.quick else tuple(ENTRIES)
    fitted: dict[str, Floats] = {}
    if options.fit:
        training = everything.part(0, FITTED_ON, 3)
        for name in (n for n in names if ENTRIES[n].scales_of is None):
            fitted[name] = fit(name, training, options.evaluations)
            console.print(f"{name}: {', '.join(f'{scale:.4g}' for scale in fitted[name])}")
    errors = {"detections": scene_errors(radar.detections, radar)}
    other: dict[str, tuple[str, str, str]] = {"detections": ("", "", "")}
    with console.status("tracking (compiles on the first run only)"):
        for name in names:
            entry = ENTRIES[name]
            scales = fitted.get(entry.scales_of or name)
            estimate(entry, radar.part(0, 2), scales)
            begin = time.process_time()
            found = estimate(entry, radar, scales)
            cost = 1e6 * (time.process_time() - begin) / found.nis.size
            errors[name] = scene_errors(found.position, radar)
            # Densities in range and angles are not densities in metres: nats of `spherical` are not comparable.
            nats = "" if entry.smoothed or entry.polar else f"{found.log_likelihood[:, 1:].mean():.3f}"
            nis = "" if entry.smoothed else f"{found.nis[:, 1:].mean() / 3:.2f}"
            other[name] = (nats, nis, f"{cost:.1f}")
    header = (
        "estimator",
        "RMSE m [95 %]",
        f"minus {BASELINE} m [95 %]",
        "median scene m",
        "lost",
        "nats/step",
        "NIS/3",
        "us/step",
    )
    rows = []
    for name, squares in errors.items():
        low, high = interval(squares)
        rmse, base = np.sqrt(squares.mean()), errors[BASELINE]
        below, above = interval(squares, base)
        gap = "" if name == BASELINE else f"{rmse - np.sqrt(base.mean()):+.1f} [{below:+.1f}, {above:+.1f}]"
        median = f"{np.median(np.sqrt(squares)):.1f}"
        lost = f"{int((squares > errors['detections']).sum())}" if name != "detections" else ""
        rows.append((name, f"{rmse:.1f} [{low:.1f}, {high:.1f}]", gap, median, lost, *other[name]))
    if options.markdown:
        for row in (header, ("---",) * len(header), *rows):
            print("| " + " | ".join(row) + " |")
        return 0
    table = Table(title=f"{len(radar.truth)} scenes x {len(radar.times)} frames of {FRAME} s")
    for column in header:
        table.add_column(column, justify="left" if column == "estimator" else "right")
    for row in rows:
        table.add_row(*row)
    console.print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
