"""`jink check FILE.py:NAME`: the contract that every estimator keeps, as a command."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Literal, NamedTuple

import numpy as np
from rich.console import Console
from rich.text import Text

from jink.estimators.recipes import RECIPES
from jink.training.console import progress
from jink.training.contract.checks import CHECKS
from jink.training.contract.subject import SPEED, Broken, NotAsked, Subject, checked_sensor, make_case
from jink.training.loading import is_spec, load_maker, make_named
from jink.training.outside import OutsideEstimator
from jink.training.summary import plain_table

__all__ = ["EstimatorReport", "check_estimator", "print_estimator_report"]

Status = Literal["passed", "failed", "skipped"]


_EVERYWHERE = "Do without the exception; it comes in all of these checks, so mend it first and check again."


class Finding(NamedTuple):
    """One check: what came of it, and how to mend what failed."""

    name: str
    status: Status
    found: str
    remedy: str = ""


class EstimatorReport(NamedTuple):
    """All checks of one estimator."""

    name: str
    sensor: str
    findings: tuple[Finding, ...]

    @property
    def ok(self) -> bool:
        """Whether nothing failed."""
        return not self.of("failed")

    def of(self, status: Status) -> tuple[Finding, ...]:
        """The checks with this outcome."""
        return tuple(finding for finding in self.findings if finding.status == status)


def check_estimator(name: str, sensor: str = "position", axes: int = 2, seed: int = 0) -> EstimatorReport:
    """Examine an estimator: shapes, values, inputs, determinism, batches, gaps, times, steps, state.

    Args:
        name: a recipe's, or ``path/to/mine.py:make``.
        sensor: what it is put behind: position, range-bearing, range-bearing-elevation, range-bearing-rate.
        axes: of the sensor position; 2 or 3.
        seed: of the tracks.

    Returns:
        one finding for each check; an exception inside a check is a failure.

    Raises:
        ValueError: an unknown name or sensor, or a file that cannot be imported.
    """
    if is_spec(name):
        label = load_maker(name).label
    elif name in RECIPES:
        label = name
    else:
        raise ValueError(
            f"check: estimator must be one of {', '.join(RECIPES)}, or FILE.py:NAME; got '{name}'. See jink list."
        )
    if seed < 0:
        raise ValueError(f"--seed: value must be >= 0; got {seed}. Use for example --seed 1.")
    seen = checked_sensor(sensor, axes)
    options: dict[str, Any] = {"acceleration": 2.0, "speed": SPEED, "turn_rate": 0.1, "sojourn": 10.0}

    def make() -> Any:
        return make_named(name, seen, **options)

    subject = Subject(label, make, seen, make_case(seen, seed))
    findings = [_judge("makes an estimator", lambda: _form(make()))]
    if findings[0].status == "passed":
        with progress(f"checking {label}", len(CHECKS)) as advance:
            for title, check in CHECKS.items():
                findings.append(_judge(title, partial(check, subject)))
                advance(1)
    return EstimatorReport(label, f"{sensor} in {seen.axes} axes", tuple(findings))


def print_estimator_report(report: EstimatorReport, console: Console) -> None:
    """A table of the checks, then what failed and how to mend it, then the verdict."""
    table = plain_table("check", "", "what was found", words=3, title=f"{report.name} behind {report.sensor}")
    colours = {"passed": "green", "failed": "bold red", "skipped": "dim"}
    for finding in report.findings:
        table.add_row(finding.name, Text(finding.status, colours[finding.status]), Text(_cut(finding.found)))
    console.print(table)
    causes: dict[str, list[Finding]] = {}
    for finding in report.of("failed"):
        causes.setdefault(finding.found, []).append(finding)
    for found, same in causes.items():
        once = same[0].remedy if len({finding.remedy for finding in same}) == 1 else _EVERYWHERE
        console.print(Text(f"{', '.join(finding.name for finding in same)}: {found}."))
        console.print(Text(f"  to mend it: {once}"))
    counts = ", ".join(f"{len(report.of(s))} {s}" for s in ("passed", "failed", "skipped"))
    console.print(f"{report.name}: {counts}", markup=False)


def _form(made: Any) -> str:
    if not isinstance(made, OutsideEstimator):
        return "a bank of filters"
    forms = {"streams": "takes one row at a time", "batches": "takes many tracks at once"}
    return " and ".join(text for name, text in forms.items() if getattr(made, name)) or "takes one whole track"


def _cut(text: str, most: int = 70) -> str:
    return text if len(text) <= most else text[: most - 3] + "..."


def _judge(name: str, check: Callable[[], str]) -> Finding:
    try:
        with np.errstate(all="ignore"):
            return Finding(name, "passed", check())
    except NotAsked as outcome:
        return Finding(name, "skipped", str(outcome))
    except Broken as outcome:
        return Finding(name, "failed", str(outcome), outcome.remedy)
    except ValueError as error:  # a sentence of ours, which ends in its own remedy
        found, _, remedy = " ".join(str(error).split()).rpartition(". ")
        if remedy == "Mend it.":
            asked = (getattr(check, "func", check).__doc__ or "").partition("\n")[0]
            remedy = f"Do without the exception; what this check asks: {asked}"
        return Finding(name, "failed", found or str(error), remedy)
    except (Exception, SystemExit) as error:
        return Finding(name, "failed", f"raised {type(error).__name__}: {error}", "Return a status instead of raising.")
