"""Write the tables of README.md and docs/recorded.md from the committed rows.

    python benchmarks/update_readme.py

The rows come from `jink bench`; the commands stand in both pages. A test compares the pages with the rows.
"""

import json
import re
from pathlib import Path

import pandas as pd

ROOT = Path(__file__).resolve().parent.parent
ROWS = ROOT / "docs" / "results"
ESTIMATORS = ("raw", "kf-cv", "imm", "intent-imm")
SHOWN = (
    ("Air traffic, two turns, m", "Kalman filter", "b2-atc-turns-v0", "kf-1", "position_rms"),
    ("", "IMM, two noise levels", "b2-atc-turns-v0", "imm-cv-cv", "position_rms"),
    ("", "IMM, straight and turns", "b2-atc-turns-v0", "imm-cv-ct", "position_rms"),
    ("Acceleration that jumps, SI", "oracle: told the mode", "n1-jump-linear-v0", "oracle", "rmse"),
    ("", "IMM", "n1-jump-linear-v0", "imm", "rmse"),
)
MIXING = ("mixing-study-v0", "position_rms")


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


def results_block(rows):
    """The README's table: six lines of numbers and the command that makes them."""
    found = latest(rows).set_index(["scenario", "estimator", "metric"])
    lines = ["| scenario, root mean square error | estimator | published | Jink [95 %] |", "|---|---|---|---|"]
    for scenario, estimator, *key in SHOWN:
        row = found.loc[tuple(key)]
        lines.append(f"| {scenario} | {estimator} | {row['published']:.4g} | {with_interval(row)} |")
    jet, none = (found.loc[(MIXING[0], rule, MIXING[1])] for rule in ("jet", "none"))
    lines.append(
        f"| Unlike motions, m | `jet` interaction (`none`) | {number(jet['published'], 3)} "
        f"({number(none['published'], 3)})* | {with_interval(jet, 3)} ({with_interval(none, 3)}) |"
    )
    lines += [
        "",
        "`jink bench --suite published --out docs/results/published.parquet` makes these and "
        f"{int(found['published'].notna().sum()) - len(SHOWN) - 2} more; *plain numpy, not a publication.",
    ]
    return "\n".join(lines) + "\n"


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
    blocks = {
        ROOT / "README.md": {"results": results_block(pd.read_parquet(ROWS / "published.parquet"))},
        ROOT / "docs" / "recorded.md": recorded_tables(pd.read_parquet(ROWS / "recorded.parquet")),
    }
    for page, found in blocks.items():
        text = page.read_text(encoding="utf-8")
        for marker, block in found.items():
            text = replace_block(text, marker, block)
        page.write_text(text, encoding="utf-8")
        print(f"wrote {page.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
