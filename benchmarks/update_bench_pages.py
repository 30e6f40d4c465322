"""Write the tables of the benchmark into docs/results.md, from the committed rows.

    python benchmarks/update_bench_pages.py

The rows come from `jink bench`, shortened by commit_rows.py. A test compares the pages with the rows.
"""

import math
from pathlib import Path

import numpy as np
import pandas as pd
from update_readme import number, replace_block

from jink.envs.scenarios import SUITES
from jink.training.bench_jobs import SIMULATED
from jink.training.intervals import Score, measure, resample_runs
from jink.training.ladder.pairing import compare, compare_suites, in_order, pool_runs
from jink.training.ladder.rungs import FACTORS, LADDER
from jink.training.rows import read_rows
from jink.training.weighted import interquartile_mean

ROOT = Path(__file__).resolve().parent.parent
ROWS = ROOT / "docs" / "results"
WIDE = ("raw", "kf-cv", "mahalanobis", "imm", "student-t-imm", "robust-imm", "sage-husa", "intent-imm", "joint-imm",
        "agent", "oracle", "bound")  # fmt: skip
FIXED, CLOSERS = ("kf-cv", *FACTORS), ("joint-imm", "agent")
MEANS = ("nees_inside", "lost", "diverged", "microseconds_per_step")


def committed():
    """The committed rows of all simulated suites."""
    files = [ROWS / f"{suite.replace('-', '_')}.parquet" for suite in SIMULATED]
    return pd.concat([read_rows(file) for file in files if file.exists()], ignore_index=True)


def with_interval(value, digits=3):
    if value is None:
        return "-"
    return f"{number(value.value, digits)} [{number(value.low, digits)}, {number(value.high, digits)}]"


def table(heading, rows):
    """A table in Markdown."""
    return ["| " + " | ".join(row) + " |" for row in (heading, ["---"] * len(heading), *rows)]


def shown_share(value):
    return "-" if math.isnan(value) else f"{100 * value:.3g} %"


def with_half(value):
    half = (value.high - value.low) / 2
    return number(value.value, 3) + (f" ±{half:.2g}" if half > 1e-6 * value.value else "")


def suite_block(rows, suite):
    """The ladder of a suite, then its scenarios."""
    mine = rows[rows["suite"] == suite]
    means = mine[mine["metric"].isin(MEANS)].groupby(["estimator", "metric"])["value"].mean()
    found = compare(mine)
    first = found[0].scenario
    in_first = {each.estimator: each for each in found if each.scenario == first}
    lines = []
    for each in in_order(compare_suites(mine), LADDER):
        one = in_first.get(each.estimator)
        nees, lost, diverged, cost = (means.get((each.estimator, name), math.nan) for name in MEANS)
        lines.append(
            [
                f"`{each.estimator}`",
                with_interval(each.ratio) + (f" ({each.scenarios} scenarios)" if each.missing else ""),
                with_interval(one and one.value),
                with_interval(one and one.iqm),
                with_interval(one and one.difference),
                *map(shown_share, (nees, lost, diverged)),
                "-" if math.isnan(cost) else f"{cost:.3g}",
            ]
        )
    heading = [suite, "over `imm`", f"{first.removesuffix('-v0')}: RMS m", "IQM m", "minus `imm` m"]
    text = table([*heading, "NEES in band", "lost", "diverged", "us/step"], lines)
    values = {(each.scenario, each.estimator): each.value for each in found}
    shown = [name for name in WIDE if any(key[1] == name for key in values)]
    lines = []
    for scenario in dict.fromkeys(each.scenario for each in found):
        numbers = [values.get((scenario, name)) for name in shown]
        cells = ["-" if n is None else with_half(n) for n in numbers]
        lines.append([scenario.removesuffix("-v0"), *cells])
    text += ["", *table(["RMS position, m", *(f"`{name}`" for name in shown)], lines)]
    return "\n".join(text) + "\n"


def gap_block(rows):
    """How much of the way from the best fixed factor to the oracle the agent and the joint bank go; by IQM."""
    pooled = pool_runs(rows, "position_rmse")
    lines = []
    for suite in ("surge", "joint"):
        for scenario in SUITES[suite]:
            seeds = pooled[suite, scenario, "oracle"].seeds
            runs = {name: pooled[suite, scenario, name].values for name in (*FIXED, "robust-imm", *CLOSERS, "oracle")}
            middle = {name: interquartile_mean(values) for name, values in runs.items()}
            count = len(runs["oracle"])
            plain = {name: float(statistic(np.ones((1, count)))[0]) for name, statistic in middle.items()}
            best = min(FIXED, key=plain.__getitem__)
            scores = {name: Score(closed(middle[best], middle[name], middle["oracle"]), "") for name in CLOSERS}
            numbers = measure(scores, resample_runs(count, int(seeds[0])))
            cells = [
                f"{number(plain[best], 3)} (`{best}`)",
                *(number(plain[n], 3) for n in ("robust-imm", *CLOSERS, "oracle")),
            ]
            cells += [f"{100 * n.value:.0f} % [{100 * n.low:.0f}, {100 * n.high:.0f}]" for n in numbers.values()]
            lines.append([scenario.removesuffix("-v0"), *cells])
    heading = ["IQM of RMS position, m", "best fixed", *(f"`{n}`" for n in ("robust-imm", *CLOSERS, "oracle"))]
    return "\n".join(table([*heading, *(f"`{name}` closes" for name in CLOSERS)], lines)) + "\n"


def closed(start, reached, goal):
    return lambda weights: (start(weights) - reached(weights)) / (start(weights) - goal(weights))


def blocks(rows):
    """Page and marker -> text."""
    found = {("docs/results.md", "bench-gap"): gap_block(rows)}
    return found | {("docs/results.md", f"bench-{suite}"): suite_block(rows, suite) for suite in SIMULATED}


def main():
    for (page, marker), block in blocks(committed()).items():
        path = ROOT / page
        path.write_text(replace_block(path.read_text(encoding="utf-8"), marker, block), encoding="utf-8")


if __name__ == "__main__":
    main()
