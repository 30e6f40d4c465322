"""What `jink bench` was asked for."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from jink.training.catalogue import SUITES
from jink.training.console import check_writable
from jink.training.ladder.backends import Place, check_place

__all__ = ["ALL", "LADDER_SUITES", "BenchRequest", "check_request"]

ALL = "all"
LADDER_SUITES = ("switch", "surge", "joint")
"""What `jink bench` shows without being told anything."""
_RUNS_LIMIT, _SEED_LIMIT = 10**9, 2**31


@dataclass(frozen=True)
class BenchRequest:
    """What the command line asked for; None means the suite's own choice, no suite the quick ladder."""

    suite: str | None = None
    quick: bool = False
    out: Path | None = None
    data: Path | None = None
    runs: int | None = None
    seed: int | None = None
    scenarios: tuple[str, ...] = ()
    estimators: tuple[str, ...] = ()
    place: Place = field(default_factory=Place)
    report: Path | None = None

    @property
    def suites(self) -> tuple[str, ...]:
        """The suites to run, in order."""
        if self.suite is None:
            return LADDER_SUITES
        if self.suite != ALL:
            return (self.suite,)
        return tuple(name for name in SUITES if name not in (ALL, "recorded") or (name != ALL and self.data))


def check_request(request: BenchRequest) -> None:
    """Refuse what cannot be done, before anything is computed.

    Raises:
        ValueError: an unknown suite, a value out of range, an option that the suite would not look at, or a file that
            cannot be written.
    """
    if request.suite is not None and request.suite not in SUITES:
        raise ValueError(f"--suite: name must be one of {', '.join(SUITES)}; got '{request.suite}'. See jink list.")
    if request.runs is not None and not 1 <= request.runs <= _RUNS_LIMIT:
        raise ValueError(f"--runs: value must be >= 1; got {request.runs}. Leave it out for the suite's own number.")
    if request.seed is not None and not 0 <= request.seed <= _SEED_LIMIT:
        raise ValueError(f"--seed: value must be >= 0 and below 2^31; got {request.seed}. Use for example --seed 1.")
    if request.suite == "recorded" and request.data is None:
        raise ValueError("--data: folder must be given for the suite recorded; got none. Add --data DIR.")
    check_place(request.place)
    given = {
        "--data": request.data,
        "--quick": request.quick or None,
        "--runs": request.runs,
        "--seed": request.seed,
        "--scenario": ", ".join(request.scenarios) or None,
        "--estimator": ", ".join(request.estimators) or None,
    }
    unused: tuple[str, ...] = ("--data",)
    if request.suite == "recorded":
        unused = ("--quick", "--runs", "--seed")
    elif request.suite == ALL:
        unused = ("--scenario", "--estimator")
    elif request.suite is None:
        unused = ("--data", "--scenario")
    for option in unused:
        if given[option] is not None:
            raise ValueError(
                f"{option}: option must be left out of the suite {request.suite or 'ladder'}, which does not use it; "
                f"got {given[option]}. Leave it out, or name a suite with --suite."
            )
    check_writable(request.out, "--out", (".parquet",))
    check_writable(request.report, "--report", (".html", ".htm"))
