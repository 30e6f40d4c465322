"""Rows of a full run of `jink bench` to the small files of docs/results, one for each suite.

    jink bench --suite switch --out rows.parquet     (and so on, or --suite all)
    python benchmarks/commit_rows.py rows.parquet

Every number stays with its interval and its command. Runs stay of what pages and reports compare (`COMPARED`);
curves and the one track stay of the first scenario of each suite. The full file has all of them for all scenarios.
"""

import argparse
from pathlib import Path

from jink.envs.scenarios import SUITES
from jink.training.bench_jobs import SIMULATED
from jink.training.rows import Cell, read_rows, write_rows

PLACE = Path(__file__).resolve().parent.parent / "docs" / "results"
COMPARED = ("position_rmse", "velocity_rmse")


def shortened(rows, suite):
    """What is committed of a suite: of cells computed twice, the last."""
    mine = rows[rows["suite"] == suite].sort_values("started", kind="stable")
    keys = [name for name in Cell._fields if name not in ("commit", "data")]
    last = mine.groupby(keys, sort=False)["commit"].transform("last")
    mine = mine[mine["commit"] == last].copy()
    order = {name: place for place, name in enumerate(SUITES[suite])}
    mine = mine.iloc[mine["scenario"].map(order).argsort(kind="stable")]
    mine = mine[(mine["kind"] == "number") | (mine["scenario"] == SUITES[suite][0])]
    long = (mine["kind"] == "number") & ~mine["metric"].isin(COMPARED)
    mine["samples"] = [None if drop else samples for drop, samples in zip(long, mine["samples"], strict=True)]
    return mine


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rows", type=Path, help="file of jink bench")
    given = parser.parse_args()
    rows = read_rows(given.rows)
    for suite in SIMULATED:
        mine = shortened(rows, suite)
        if len(mine):
            path = PLACE / f"{suite.replace('-', '_')}.parquet"
            write_rows(path, mine)
            print(f"{path.name}: {len(mine)} rows, {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
