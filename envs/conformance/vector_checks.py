"""Checks of vector environments that do not depend on the autoreset mode; each passes, or raises what it found."""

from __future__ import annotations

import copy
from collections.abc import Callable
from multiprocessing.reduction import ForkingPickler

from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from jink.envs.conformance.comparing import difference, rows_of
from jink.envs.conformance.playing import Failed, Skipped, Subject, batch_actions, mode_of, play, same_play

__all__ = ["CHECKS"]


def check_spaces(subject: Subject) -> str:
    """Batched spaces are those of one environment, as many times."""
    env = subject.make(None)
    for name in ("observation", "action"):
        single, batched = getattr(env, f"single_{name}_space"), getattr(env, f"{name}_space")
        if batched != batch_space(single, env.num_envs):
            raise Failed(f"{name}_space must be the batch of single_{name}_space; got {batched} for {single}.")
    if not isinstance(env.metadata.get("autoreset_mode"), AutoresetMode):
        raise Failed(
            f"metadata['autoreset_mode'] must be an AutoresetMode; got {env.metadata.get('autoreset_mode')!r}."
        )
    return f"{env.num_envs} environments, {mode_of(env).value} by default"


def check_seeding(subject: Subject) -> str:
    """Same seed, same play; another seed, another; reset without a seed goes on."""
    same_play(subject.make(None), subject.make(None), subject, "two environments with the same seed")
    plays = [
        [copy.deepcopy(result) for _, result in play(subject.make(None), seed, 20)]
        for seed in (subject.seed, subject.seed + 1000)
    ]
    env = subject.make(None)
    first, again = copy.deepcopy(env.reset(seed=subject.seed)), env.reset()
    if not difference(plays[0][0], plays[1][0]) and not difference(first, again):
        raise Skipped("every episode starts alike, so nothing shows which seed it had")
    if not difference(plays[0], plays[1]):
        raise Failed("other seeds must give other episodes; they gave the same.")
    if not difference(first[0], again[0]):
        raise Failed("reset without a seed must start another episode; it repeated the first observation.")
    if difference(first, copy.deepcopy(env.reset(seed=subject.seed))):
        raise Failed("reset with the same seed must give the same observation and info; it gave others.")
    return "same seed same bits, other seed other bits"


def check_rows(subject: Subject) -> str:
    """Row i of seed s is row 0 of seed s + i: no row depends on its neighbours."""
    left, right = subject.make(None), subject.make(None)
    n = left.num_envs
    if n < 2:
        raise Skipped("one environment has no neighbours")
    starts = [rows_of(env.reset(seed=subject.seed + i), 1 - i, n) for i, env in enumerate((left, right))]
    if not difference(rows_of(left.reset(seed=subject.seed), 0, n), starts[0]):
        raise Skipped("neighbours start alike")
    for (call, x), (_, y) in zip(play(left, subject.seed, subject.steps), play(right, subject.seed + 1, subject.steps)):
        if "before" in call:
            raise Skipped("episodes must be reset by hand")
        if text := difference(rows_of(x, 1, n), rows_of(y, 0, n), "result"):
            raise Failed(f"row 1 of seed s must be row 0 of seed s + 1; at {call}, {text}.")
    return "row i of seed s is row 0 of seed s + i"


def check_interleaving(subject: Subject) -> str:
    """Two environments stepped in turn behave as each alone."""
    alone = [copy.deepcopy(result) for _, result in play(subject.make(None), subject.seed, subject.steps)]
    a, b = subject.make(None), subject.make(None)
    both = zip(play(a, subject.seed, subject.steps), play(b, subject.seed + 7, subject.steps))
    for want, ((call, got), _) in zip(alone, both):
        if text := difference(want, got, "result"):
            raise Failed(f"another environment beside it must change nothing; at {call}, {text}.")
    return "another environment beside it changes nothing"


def check_pickling(subject: Subject) -> str:
    """A pickled copy goes on as the original does."""
    env = subject.make(None)
    steps = iter(play(env, subject.seed, subject.steps))
    for _ in range(max(2, subject.steps // 3)):
        next(steps)
    try:
        twin = ForkingPickler.loads(ForkingPickler.dumps(env))
    except Exception as error:
        raise Failed(f"must be fit for another process; pickle said {type(error).__name__}: {error}.") from error
    if mode_of(env) is AutoresetMode.DISABLED:
        raise Skipped("episodes must be reset by hand")
    for t in range(20):
        actions = batch_actions(env, [env.single_action_space.sample() for _ in range(env.num_envs)])
        if text := difference(env.step(copy.deepcopy(actions)), twin.step(copy.deepcopy(actions)), "result"):
            raise Failed(f"a pickled copy must go on as the original; {t} steps later, {text}.")
    return "a pickled copy goes on as the original"


def check_closing(subject: Subject) -> str:
    """Close may be called again."""
    env = subject.make(None)
    env.reset(seed=subject.seed)
    env.close()
    env.close()
    return "close may be called again"


CHECKS: dict[str, Callable[[Subject], str]] = {
    "spaces": check_spaces,
    "seeding": check_seeding,
    "rows": check_rows,
    "interleaving": check_interleaving,
    "pickling": check_pickling,
    "closing": check_closing,
}
"""Name -> check."""
