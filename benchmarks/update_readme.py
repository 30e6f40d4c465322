"""Write the table and the figure of README.md and the tables of docs/recorded.md from the committed rows.

    python benchmarks/update_readme.py

The rows come from `jink bench`; the commands stand in both pages. A test compares the pages with the rows.
"""

import hashlib
import json
import re
from pathlib import Path

import pandas as pd

ROOT = Path(__file__).resolve().parent.parent
ROWS = ROOT / "docs" / "results"
ESTIMATORS = ("raw", "kf-cv", "imm", "intent-imm")
SCENES = ("switch-v0", "surge-v0", "joint-v0")
"""Columns of the README's table and panels of its figure, where there are rows."""
LINES = {
    "kf-cv": "Kalman filter, constant velocity",
    "imm": "IMM: straight, accelerate, turn",
    "robust-imm": "IMM over adaptive factors",
    "joint-imm": "intents x noise levels (`joint-imm`)",
    "agent": "filter with an RL agent (`agent`)",
    "oracle": "told intent and noise",
}
"""Rows of the table; the agent takes the place of `robust-imm` once there are rows of it."""
BEST = "best of 13 tuned filters, after the fact"
CLASSICAL = ("kf-cv", "kf-ca", "singer", "ukf-ct", "mr", "huber", "rma", "mahalanobis", "imm", "student-t-imm",
             "robust-imm", "sage-husa", "vb-noise")  # fmt: skip
"""What `BEST` is chosen from: all that neither has intents of its own nor an agent nor is told more."""
PICTURE = ROOT / "docs" / "pictures" / "ladder.png"


def latest(rows):
    """One row per number: the last one computed."""
    return rows.sort_values("started", kind="stable").drop_duplicates(["scenario", "estimator", "metric"], keep="last")


def number(value, digits=4):
    return f"{value:#.{digits}g}" if abs(value) < 10 ** (digits - 1) else f"{value:.0f}"


def with_interval(row, digits=4):
    """Value and interval, as the tables show them; without brackets where a row has no interval."""
    shown = number(row["value"], digits)
    if pd.notna(row["low"]):
        shown += f" [{number(row['low'], digits)}, {number(row['high'], digits)}]"
    return shown


def ladder_rows():
    """Rows of the suites that have some, as one table."""
    files = [ROWS / f"{suite}.parquet" for suite in ("switch", "surge", "joint")]
    return pd.concat([pd.read_parquet(file) for file in files if file.is_file()], ignore_index=True)


def compared(rows, base="imm"):
    """Scenario -> estimator -> `Comparison`, for the scenes that have rows."""
    from jink.training.ladder.pairing import compare

    found = {}
    for one in compare(rows[rows["scenario"].isin(SCENES)], base=base):
        found.setdefault(one.scenario, {})[one.estimator] = one
    return {scene: found[scene] for scene in SCENES if scene in found}


def results_block(rows):
    """The README's table: five rows of numbers, the figure, and the commands that make both."""
    found = compared(rows)
    everywhere = [name for name in LINES if all(name in some for some in found.values())]
    shown = [name for name in everywhere if not (name == "robust-imm" and "agent" in everywhere)]
    lines = [
        "| position error, m [95 %] | " + " | ".join(f"`{scene}`" for scene in found) + " |",
        "|---" * (len(found) + 1) + "|",
    ]
    best = {scene: min(CLASSICAL, key=lambda name: some[name].value.value) for scene, some in found.items()}
    against = {scene: compared(rows[rows["scenario"] == scene], name)[scene] for scene, name in best.items()}

    def cell(scene, name):
        value, gap, other = found[scene][name].value, found[scene][name].difference, against[scene][name].difference
        mark = "" if gap is None else " ▼" if gap.high < 0 else " ▲" if gap.low > 0 else " ="
        if name not in CLASSICAL and mark == " ▼" and other is not None and other.high < 0:
            mark = " ▼▼"
        return f"{number(value.value, 3)} [{number(value.low, 3)}, {number(value.high, 3)}]{mark}"

    for name in shown:
        lines.append(f"| {LINES[name]} | " + " | ".join(cell(scene, name) for scene in found) + " |")
        if name == "imm":
            cells = (f"{cell(scene, best[scene])} `{best[scene]}`" for scene in found)
            lines.append(f"| {BEST} | " + " | ".join(cells) + " |")
    diverged = rows[(rows["estimator"] == "imm") & (rows["metric"] == "diverged")].set_index("scenario")["value"]
    lost = ", ".join(f"{100 * diverged[scene]:.0f} % (`{scene}`)" for scene in found if diverged[scene] > 0.05)
    suites = ", ".join(f"`{scene.removesuffix('-v0')}`" for scene in found)
    runs = min(one.runs for some in found.values() for one in some.values())
    lines += [
        "",
        f"Root mean square of {runs} held-out runs; by paired intervals ▼ better, ▲ worse, = level with `imm`,",
        "and ▼▼ better than the best tuned filter too. All are tuned by one search; `imm`, without surges, still calls",
        f"{lost} of its own steps diverged. `jink bench --suite NAME --runs {runs} --out rows.parquet`,",
        f"with NAME {suites}, then `python benchmarks/commit_rows.py rows.parquet` make the rows.",
        "Every estimator with its interval; dotted is the oracle, a reference and no bound:",
        "",
        "![Ladder of estimators with intervals, from the measurement to the bound](docs/pictures/ladder.png)",
    ]
    return "\n".join(lines) + "\n"


def plotted(rows):
    """Scenario -> estimator -> value and ends of its interval: what the figure shows."""
    return {
        scene: {name: [float(f"{v:.6g}") for v in one.value[:1] + one.value[2:4]] for name, one in some.items()}
        for scene, some in compared(rows).items()
    }


def digest(numbers):
    """Says which numbers a figure was drawn from; kept in the picture."""
    return hashlib.sha256(json.dumps(numbers, sort_keys=True).encode()).hexdigest()[:16]


def draw(numbers, path):
    """The figure: one panel for each scene, the ladder from the measurement at the top to the bound."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

    from jink.training.ladder.rungs import LADDER
    from jink.training.report.scenes import FAMILIES

    looks = {
        "measurement": ("#6b6b6b", "x"), "single filter": ("#0072B2", "o"), "adaptive filter": ("#00795a", "s"),
        "bank": ("#b84700", "D"), "Jink": ("#8f3f78", "*"), "limit": ("#16191d", "|"), "other": ("#8a6a00", "^"),
    }  # fmt: skip
    names = [name for name in LADDER if any(name in some for some in numbers.values())]
    size = (9.6, 1.3 + 0.25 * len(names))
    figure, axes = plt.subplots(
        1, len(numbers), sharey=True, figsize=size, dpi=100, layout="constrained", squeeze=False
    )
    for axis, (scene, some) in zip(axes[0], numbers.items(), strict=True):
        for row, name in enumerate(names):
            if name not in some:
                continue
            value, low, high = some[name]
            family = FAMILIES.get(name.partition("@")[0], "other")
            colour, marker = looks[family]
            axis.plot([low, high], [row, row], color=colour, linewidth=2, solid_capstyle="butt")
            big = 13 if marker in "*|" else 7
            axis.plot(
                [value], [row], color=colour, marker=marker, markersize=big, markeredgewidth=2 if marker == "|" else 1
            )
        if "oracle" in some:
            axis.axvline(some["oracle"][0], color="#6b6b6b", linewidth=1, linestyle=":")
        axis.set_xscale("log")
        axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.xaxis.set_major_formatter(ScalarFormatter())
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.set_title(scene, fontsize=11)
        axis.set_xlabel("position error, m")
        axis.grid(axis="x", which="both", color="#d9dde1", linewidth=0.6)
        axis.set_axisbelow(True)
        for side in ("top", "right"):
            axis.spines[side].set_visible(False)
    axes[0][0].set_yticks(range(len(names)), names)
    axes[0][0].invert_yaxis()
    shown = dict.fromkeys(FAMILIES.get(name.partition("@")[0], "other") for name in names)
    handles = [
        plt.Line2D(
            [], [], color=looks[f][0], marker=looks[f][1], markersize=11 if looks[f][1] in "*|" else 7, linewidth=2
        )
        for f in shown
    ]
    figure.legend(handles, shown, loc="outside upper center", ncols=len(shown), frameon=False, fontsize=9)
    figure.savefig(path, metadata={"Description": digest(numbers), "Software": None})
    plt.close(figure)


def recorded_tables(rows):
    """The tables of docs/recorded.md by marker: truth, predictions, commands."""
    found = latest(rows[rows["status"].isin(["ok", "diverged"])])
    numbers = found.set_index(["scenario", "estimator", "metric"])
    with_truth = set(found.loc[found["metric"] == "position_rmse", "scenario"])
    files = list(dict.fromkeys(rows.loc[rows["scenario"].isin(set(found["scenario"])), "scenario"]))

    def cell(scenario, estimator, first, second):
        key = (scenario, estimator)
        if (*key, first) not in numbers.index:
            return "-"
        row = numbers.loc[(*key, first)]
        star = " †" if row["status"] == "diverged" else ""
        return f"{with_interval(row, 3)}; {number(numbers.loc[(*key, second)]['value'], 3)}{star}"

    def grid(scenarios, estimators, first, second):
        lines = ["| file | " + " | ".join(estimators) + " |", "|---" * (len(estimators) + 1) + "|"]
        for scenario in scenarios:
            shown = (cell(scenario, estimator, first, second) for estimator in estimators)
            lines.append(f"| {scenario} | " + " | ".join(shown) + " |")
        return "\n".join(lines) + "\n"

    commands = []
    for scenario in files:
        flags = json.loads(found.loc[found["scenario"] == scenario, "parameters"].iloc[0])["flags"]
        commands.append(" ".join(["jink track", scenario.partition(" ")[0], *([flags] if flags else [])]))
    return {
        "truth": grid([f for f in files if f in with_truth], ESTIMATORS, "position_rmse", "position_median"),
        "predictions": grid(
            [f for f in files if f not in with_truth], ESTIMATORS[1:], "log_likelihood_trimmed", "nis_inside"
        ),
        "commands": "```text\n" + "\n".join(commands) + "\n```\n",
    }


def replace_block(text, marker, block):
    """The page with what stands between two markers replaced."""
    pattern = rf"(<!-- {marker}:start -->\n).*?(<!-- {marker}:end -->)"
    found, count = re.subn(pattern, lambda match: match[1] + block + match[2], text, flags=re.S)
    if count != 1:
        raise SystemExit(f"update_readme: page must hold the marker '{marker}' once; got {count}. Add it.")
    return found


def main():
    rows = ladder_rows()
    blocks = {
        ROOT / "README.md": {"results": results_block(rows)},
        ROOT / "docs" / "recorded.md": recorded_tables(pd.read_parquet(ROWS / "recorded.parquet")),
    }
    for page, found in blocks.items():
        text = page.read_text(encoding="utf-8")
        for marker, block in found.items():
            text = replace_block(text, marker, block)
        page.write_text(text, encoding="utf-8")
        print(f"wrote {page.relative_to(ROOT)}")
    draw(plotted(rows), PICTURE)
    print(f"wrote {PICTURE.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
