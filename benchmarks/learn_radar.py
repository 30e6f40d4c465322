"""Learn intents in space from simulated radar scenes, and track the other scenes with them.

python benchmarks/learn_radar.py --data DIR --model OUT [--scenes 128]

DIR holds OneManeuveringTarget3D/train_first1000.npz. Scenes 0 to 299 may be learnt from, 300 to 999 are tracked: RMSE
of position over all scenes and frames, beside the Singer filter and the library's bank whose scales were fitted by
likelihood on scenes 0-299 (see radar_births.py); differences with 95 % bootstrap intervals over scenes. No labels.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from radar_births import ENTRIES, FITTED_ON, estimate, interval, load, scene_errors

from jink.estimators.api import BankEstimator
from jink.estimators.sensors import position
from jink.estimators.tracks import Tracks
from jink.intent.learner import IntentLearner
from jink.intent.model_file import load_model, save_model
from jink.intent.progress import Progress


def main() -> int:
    """Learn, unless the model is there, and compare."""
    import torch

    torch.set_num_threads(1)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder of recorded data")
    parser.add_argument("--model", type=Path, required=True, help="folder of the model")
    parser.add_argument("--scenes", type=int, default=128, help="scenes to learn from, evenly from 0-299")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    everything = load(options.data)
    chosen = np.linspace(0, FITTED_ON - 1, options.scenes).astype(int)
    tracks = Tracks.from_arrays(
        everything.detections[chosen],
        everything.times,
        noise=None,
        source="OneManeuveringTarget3D",
    )
    tracks = Tracks(**{**vars(tracks), "noise": everything.noise[chosen]})
    if not (options.model / "intents.json").is_file():
        cpu, wall = time.process_time(), time.perf_counter()
        last = [""]

        def say(report: Progress) -> None:
            if report.held_out or report.stage != last[0]:
                print(f"{time.process_time() - cpu:.0f} s {report}", flush=True)
                last[0] = report.stage

        learner = IntentLearner(axes=3, seed=options.seed, progress=say, checkpoint=options.model / "checkpoint").fit(
            tracks
        )
        print(f"processor time {time.process_time() - cpu:.0f} s, wall {time.perf_counter() - wall:.0f} s")
        save_model(learner.model_, options.model)
    model = load_model(options.model)
    print(model.describe())
    for row in model.about.get("curve", ()):  # type: ignore[attr-defined]
        print("intents {:.0f}: {:.4f} [{:.4f}, {:.4f}] nats per row held out".format(*row))
    radar = everything.part(FITTED_ON, len(everything.truth))
    found = BankEstimator(model.bank(position(3, sigma=70.0)), threads=2).run(
        radar.detections, radar.times, radar.noise
    )
    errors = {"learnt": scene_errors(found.position, radar)}
    nats = {"learnt": float(found.log_likelihood[:, 1:].mean())}
    nis = {"learnt": float(found.nis[:, 1:].mean() / 3)}
    for name in ("singer", "birth"):
        other = estimate(ENTRIES[name], radar)
        errors[name] = scene_errors(other.position, radar)
        nats[name], nis[name] = float(other.log_likelihood[:, 1:].mean()), float(other.nis[:, 1:].mean() / 3)
    print("| estimator | RMSE m [95 %] | minus singer m [95 %] | nats/step | NIS/3 |\n|---|---|---|---|---|")
    base = errors["singer"]
    for name, squares in errors.items():
        low, high = interval(squares)
        rmse = float(np.sqrt(squares.mean()))
        gap = ""
        if name != "singer":
            below, above = interval(squares, base)
            gap = f"{rmse - float(np.sqrt(base.mean())):+.1f} [{below:+.1f}, {above:+.1f}]"
        print(f"| {name} | {rmse:.1f} [{low:.1f}, {high:.1f}] | {gap} | {nats[name]:.3f} | {nis[name]:.2f} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
