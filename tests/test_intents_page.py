"""The page on intents: its code runs, its table is that of the models that ship, its pictures are there."""

import importlib.util
import re
import shlex
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from jink.training.cli import main

ROOT = Path(__file__).resolve().parent.parent
PAGE = (ROOT / "docs" / "intents.md").read_text(encoding="utf-8")


def load_script():
    spec = importlib.util.spec_from_file_location("page", ROOT / "benchmarks" / "update_intents_page.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_table_is_that_of_the_models():
    script = load_script()
    assert f"<!-- models:start -->\n{script.table()}<!-- models:end -->" in PAGE, (
        "run benchmarks/update_intents_page.py"
    )
    assert script.put(PAGE, "models", "x\n") != PAGE


def test_pictures_are_there():
    names = re.findall(r"\(pictures/([^)]+)\)", PAGE)
    assert len(names) == 3
    for name in names:
        assert (ROOT / "docs" / "pictures" / name).read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def test_the_tutorial_runs(tmp_path, monkeypatch, capsys):
    """All Python blocks are one script; the commands then run in the same folder."""
    pytest.importorskip("torch")
    monkeypatch.chdir(tmp_path)
    names = {}
    for number, block in enumerate(re.findall(r"^```python\n(.*?)^```$", PAGE, re.S | re.M)):
        exec(compile(block, f"intents.md, block {number}", "exec"), names)
    out = capsys.readouterr().out
    assert re.search(r"intent \d \(straight\): straight", out) and re.search(r"turn, .* deg/s either way", out)
    learned, textbook = (float(re.search(rf"^{name}: ([\d.]+) m$", out, re.M).group(1)) for name in ("learned", "imm"))
    assert learned < 0.9 * textbook
    nats = [float(re.search(rf"^{name}: ([\d.]+) nats", out, re.M).group(1)) for name in ("learned", "imm")]
    assert nats[0] < nats[1] - 0.5
    z, times = names["measured"], names["times"]
    rows = [pd.DataFrame({"track": f"{b}", "t": times, "x": one[:, 0], "y": one[:, 1]}) for b, one in enumerate(z[12:])]
    pd.concat(rows).to_csv("flights.csv", index=False)
    (commands,) = re.findall(r"^```bash\n(.*?)^```$", PAGE, re.S | re.M)
    for line in commands.splitlines():
        assert main(shlex.split(line)[1:]) == 0, line
    labels = pd.read_csv("labels.csv")
    assert len(labels) == 400 and set(labels["intent"]) == {"straight", "turn"}
    true = np.tile(np.where(times % 20 < 10, "straight", "turn"), 4)
    assert (labels["intent"] == true).mean() > 0.8
    assert {"intents.png", "labels.png"} <= {path.name for path in tmp_path.iterdir()}
