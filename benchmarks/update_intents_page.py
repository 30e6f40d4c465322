"""Train the models that ship with the package, and write the table and the pictures of the page on intents.

    python benchmarks/update_intents_page.py [--train [NAME ...]] [--durations] [--pictures]

The table stands between markers in docs/intents.md and comes from the models; a test compares them.
"""

import argparse
import contextlib
import re
import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np

from jink.envs.scenarios import make_scenario
from jink.envs.simulate import simulate_tracks
from jink.estimators.recipes import make_estimator
from jink.intent.endings import with_endings
from jink.intent.forecasting import forecast
from jink.intent.model_file import save_model
from jink.intent.pretrained import load_pretrained, pretrained_names
from jink.training.cli import main as jink
from jink.training.forecast_pictures import plot_forecast
from jink.training.intent_pictures import draw_model
from jink.training.pooling import gather
from jink.training.track import TrackRequest

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "intents.md"
PICTURES = ROOT / "docs" / "pictures"
FOLDER = ROOT / "intent" / "pretrained"
TRAININGS = {
    "drone": ("switch-v0", "--tracks", "64", "--steps", "150"),
    "car": ("switch-car-v0", "--tracks", "64", "--steps", "150"),
    "loiterer": ("switch-loiter-v0", "--tracks", "64", "--steps", "150"),
    "racer": ("switch-jink-v0", "--tracks", "64", "--steps", "150"),
    "airliner": ("radar-plots-v0", "--tracks", "64", "--steps", "150"),
    "aircraft": ("air-switch-v0", "--tracks", "64", "--steps", "150"),
}
"""Name -> arguments of `jink train intents`."""
SHOWN, SEED, ROW, AHEAD = "loiterer", 9003, 100, 40
"""The flight of the pictures: the seed is that of no training."""


def table():
    """One row per model: where it comes from, what it found."""
    lines = ["| model | command | intents |", "|---|---|---|"]
    for name in pretrained_names():
        model = load_pretrained(name)
        found = "; ".join(line.partition(": ")[2] for line in model.describe().splitlines())
        lines.append(f"| `{name}` | `{model.about['command']}` | {found} |")
    return "\n".join(lines) + "\n"


def put(page, marker, block):
    """The page with what stands between the markers replaced."""
    pattern = rf"(<!-- {marker}:start -->\n).*?(<!-- {marker}:end -->)"
    return re.sub(pattern, lambda found: found[1] + block + found[2], page, flags=re.S)


def train(names):
    """Train models in a scratch folder and keep what is needed to load them."""
    for name in names:
        with tempfile.TemporaryDirectory() as scratch, contextlib.chdir(scratch):
            sys.argv = ["jink", "train", "intents", *TRAININGS[name], "--out", name]
            if jink():
                raise SystemExit(f"{name}: no model")
            shutil.rmtree(FOLDER / name, ignore_errors=True)
            (FOLDER / name).mkdir()
            for file in Path(name).iterdir():
                if file.name == "intents.json" or file.suffix == ".safetensors":
                    shutil.copy(file, FOLDER / name)


def count_durations():
    """Give models that were trained before durations were counted those of the tracks they learned from."""
    for name in pretrained_names():
        model = load_pretrained(name)
        if not model.endings:
            scenario, *options = TRAININGS[name]
            given = dict(zip(options[::2], map(int, options[1::2]), strict=True))
            tracks = gather(
                (scenario,), TrackRequest(file=Path()), count=given["--tracks"], steps=given["--steps"], seed=0
            )
            save_model(with_endings(model, tracks), FOLDER / name)


def draw():
    """The model, a forecast, and a flight with its labels."""
    model = load_pretrained(SHOWN)
    draw_model(PICTURES / "intents.png", model)
    scenario = make_scenario(TRAININGS[SHOWN][0], steps=300)
    tracks = simulate_tracks(scenario, 1, SEED)
    z, times, truth = tracks.measurements[0], tracks.times[0], tracks.truth[0]
    estimator = make_estimator("intent-imm", scenario.sensor, model=model)
    found = forecast(estimator, estimator.start(z[:ROW], times[:ROW]), times[ROW : ROW + AHEAD] - times[ROW - 1])
    title = f"{SHOWN}, seen for {times[ROW - 1]:g} s"
    plot_forecast(PICTURES / "intents_forecast.png", found, z[:ROW], truth[ROW : ROW + AHEAD], title=title)
    with tempfile.TemporaryDirectory() as scratch:
        file = Path(scratch) / f"{SHOWN}.csv"
        columns = np.column_stack([times, z, truth, np.ones(len(times))])
        header = "t,x,y,true_x,true_y,sigma_x,sigma_y"
        np.savetxt(file, np.column_stack([columns, np.ones(len(times))]), delimiter=",", header=header, comments="")
        sys.argv = ["jink", "segment", str(file), "--model", SHOWN, "--plot", str(PICTURES / "intents_segment.png")]
        if jink():
            raise SystemExit("no picture of the labels")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--train", nargs="*", metavar="NAME", choices=TRAININGS, help="models to train; none: all")
    parser.add_argument("--durations", action="store_true", help="count durations where a model has none")
    parser.add_argument("--pictures", action="store_true", help="draw the pictures")
    given = parser.parse_args()
    if given.train is not None:
        train(given.train or TRAININGS)
    if given.durations:
        count_durations()
    if given.pictures:
        draw()
    PAGE.write_text(put(PAGE.read_text(encoding="utf-8"), "models", table()), encoding="utf-8")
