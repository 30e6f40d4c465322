"""A conformance test of vector environments, which Gymnasium lacks: `check_vector_env`."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import gymnasium
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv

from jink.envs.conformance.mode_checks import MODE_CHECKS
from jink.envs.conformance.playing import Failed, Skipped, Subject
from jink.envs.conformance.vector_checks import CHECKS

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["Check", "Report", "check_vector_env", "print_check"]

Status = Literal["passed", "failed", "skipped"]


class Check(NamedTuple):
    """One check and what came of it."""

    name: str
    mode: str  # autoreset mode; "" where it does not matter
    status: Status
    sentence: str


class Report(NamedTuple):
    """All checks of one environment."""

    env: str
    checks: tuple[Check, ...]

    @property
    def ok(self) -> bool:
        """Whether nothing failed."""
        return all(check.status != "failed" for check in self.checks)

    def of(self, status: Status) -> tuple[Check, ...]:
        """The checks with this outcome."""
        return tuple(check for check in self.checks if check.status == status)


def check_vector_env(
    env: str | Callable[..., VectorEnv[Any, Any, Any]],
    num_envs: int = 3,
    seed: int = 0,
    random_steps: int = 300,
    *,
    single: Callable[[], gymnasium.Env[Any, Any]] | None = None,
    **kwargs: Any,
) -> Report:
    """Examine a vector environment: spaces, seeds, fresh arrays, infos, autoreset, equality with single environments.

    Args:
        env: an id that `gymnasium.make_vec` knows, or a function ``(num_envs, **kwargs)`` that makes one.
        num_envs: how many environments.
        seed: of the first one.
        random_steps: of a comparison; enough for some episodes to end.
        single: for a function ``env``: makes the single environment to compare with; None: not compared.
        kwargs: options of the environment.

    Returns:
        named checks, each passed, failed or skipped with one sentence; an exception inside a check is a failure.

    Raises:
        ValueError: ``num_envs`` or ``random_steps`` is not an integer >= 1.
        gymnasium.error.Error: an unknown id.
    """
    for name, value in (("num_envs", num_envs), ("random_steps", random_steps)):
        if not isinstance(value, int) or isinstance(value, bool) or value < 1:
            raise ValueError(f"check_vector_env: {name} must be an integer >= 1; got {value!r}. Use a small number.")

    def make(mode: AutoresetMode | None) -> VectorEnv[Any, Any, Any]:
        options = kwargs if mode is None else {**kwargs, "autoreset_mode": mode}
        return gymnasium.make_vec(env, num_envs, **options) if isinstance(env, str) else env(num_envs, **options)

    def make_sync(mode: AutoresetMode | None) -> VectorEnv[Any, Any, Any]:
        chosen = mode or AutoresetMode.NEXT_STEP
        if isinstance(env, str):
            options = {"autoreset_mode": chosen}
            return gymnasium.make_vec(env, num_envs, vectorization_mode="sync", vector_kwargs=options, **kwargs)
        if single is None:
            raise Skipped("no single environment was given to compare with")
        return SyncVectorEnv([single] * num_envs, autoreset_mode=chosen)

    first = make(None)
    if isinstance(first, SyncVectorEnv):
        make = make_sync
    default = first.metadata.get("autoreset_mode")
    subject = Subject(make, make_sync, seed, random_steps)
    checks = [_run(name, "", partial(check, subject)) for name, check in CHECKS.items()]
    for mode in AutoresetMode:
        try:
            make(mode)
            chosen: AutoresetMode | None = mode
        except (TypeError, ValueError) as error:
            if mode is not default:
                checks.append(Check("autoreset mode", mode.value, "skipped", f"Cannot be chosen: {error}"))
                continue
            chosen = None
        checks += [_run(name, mode.value, partial(check, subject, chosen)) for name, check in MODE_CHECKS.items()]
    return Report(env if isinstance(env, str) else getattr(env, "__name__", repr(env)), tuple(checks))


def _run(name: str, mode: str, check: Callable[[], str]) -> Check:
    try:
        said = check()
    except Skipped as outcome:
        return Check(name, mode, "skipped", _sentence(str(outcome)))
    except Failed as outcome:
        return Check(name, mode, "failed", _sentence(str(outcome)))
    except Exception as error:
        return Check(name, mode, "failed", _sentence(f"raised {type(error).__name__}: {error}"))
    return Check(name, mode, "passed", _sentence(said))


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:].rstrip(".") + "."


def print_check(report: Report, console: Console) -> None:
    """A table of the checks and a last line with the verdict."""
    from rich.table import Table
    from rich.text import Text

    table = Table("check", "autoreset", "", "what was found", title=report.env, title_justify="left", box=None)
    colours = {"passed": "green", "failed": "bold red", "skipped": "dim"}
    for check in report.checks:
        table.add_row(check.name, check.mode, Text(check.status, colours[check.status]), Text(check.sentence))
    console.print(table)
    counts = ", ".join(f"{len(report.of(status))} {status}" for status in ("passed", "failed", "skipped"))
    console.print(f"{report.env}: {counts}")
