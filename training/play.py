"""`jink play`: watch an episode in a window, or write it to a file."""

from __future__ import annotations

import os
import secrets
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from rich.console import Console

from jink.envs.registration import ENVIRONMENTS
from jink.envs.rendering import Renderer
from jink.envs.task import Picture
from jink.estimators.agent.policy import Policy
from jink.training.console import check_writable, progress, say_when_compiling
from jink.training.players import default_player, find_agent, make_agent_player, make_player
from jink.training.recording import SUFFIXES, best_suffix, record

__all__ = ["PlayRequest", "Played", "has_display", "make_environment", "play", "print_played"]

_SIZE = (960, 640)
_WATCH_S = 20.0
"""An episode is shown in about this time, whatever its steps last."""


@dataclass(frozen=True)
class PlayRequest:
    """What was asked for; None means "not given".

    Args:
        env: id of an environment, with or without "jink/".
        scenario: name of a scenario; None: the environment's own.
        policy: who plays (see `jink.training.players`; a folder of jink train agent too); None: the usual one.
        seed: of the episode; None: a new one every time.
        out: .mp4, .gif (all frames) or .png (the last); None: a window where there is a display, else a file.
        steps: decisions at most; None: until the episode ends.
    """

    env: str
    scenario: str | None = None
    policy: str | None = None
    seed: int | None = None
    out: Path | None = None
    steps: int | None = None


class Played(NamedTuple):
    """What happened."""

    env: str
    scenario: str
    policy: str
    seed: int
    steps: int
    score: float
    ending: str
    out: Path | None  # None: shown in a window
    picture: Picture  # the last


class _Episode:
    """One episode, picture by picture."""

    def __init__(self, request: PlayRequest, seed: int, advance: Any) -> None:
        agent = find_agent(request.policy)
        self.env = make_environment(request.env, request.scenario, agent)
        self.policy = request.policy or default_player(self.env)
        self.player = make_agent_player(agent, self.env) if agent else make_player(self.policy, self.env, seed)
        self.rollout: Any = self.env.unwrapped.rollout  # type: ignore[attr-defined]
        most = self.rollout.source.steps - 1
        self.most = most if request.steps is None else min(request.steps, most)
        self.seed, self.advance = seed, advance
        self.steps, self.score, self.ending = 0, 0.0, "stopped"
        self.picture: Picture | None = None

    def pictures(self) -> Iterator[Picture]:
        """The first observation, then one picture per decision."""
        observation, _ = self.env.reset(seed=self.seed)
        yield self._look()
        while self.steps < self.most:
            observation, reward, terminated, truncated, _ = self.env.step(self.player(observation))
            self.steps += 1
            self.score += float(reward)
            self.advance()
            if terminated or truncated:
                self.ending = "track lost" if terminated else "time up"
            yield self._look()
            if terminated or truncated:
                break

    def _look(self) -> Picture:
        self.picture = self.rollout.task.picture(0, int(self.rollout.k[0]))
        return self.picture


def play(request: PlayRequest) -> Played:
    """Play one episode and show or write it.

    Args:
        request: what was asked for.

    Returns:
        what happened, and where it was written.

    Raises:
        ValueError: an unknown name, or an option out of range.
        DependencyNotInstalled: pygame, or what writes the file, is not there.
        OSError: the file cannot be written.
    """
    if request.seed is not None and request.seed < 0:
        raise ValueError(f"--seed: value must be >= 0; got {request.seed}. Use for example --seed 1.")
    if request.steps is not None and request.steps < 1:
        raise ValueError(f"--steps: value must be >= 1; got {request.steps}. Leave it out for the whole episode.")
    check_writable(request.out, "--out", SUFFIXES)
    seed = secrets.randbelow(100_000) if request.seed is None else request.seed
    window = request.out is None and has_display()
    with say_when_compiling(), progress(f"playing {request.env}", request.steps) as advance:
        episode = _Episode(request, seed, advance)
        out = None if window else request.out or _default_name(episode)
        check_writable(out, "--out", SUFFIXES)
        fps = float(np.clip(episode.most / _WATCH_S, 4.0, 30.0))
        renderer = Renderer(_SIZE, "human" if window else "rgb_array", fps)
        try:
            if out is None:
                _show(renderer, episode)
            elif out.suffix.lower() == ".png":
                *_, last = episode.pictures()
                record(out, iter([renderer.frame(last)]), fps)
            else:
                record(out, map(renderer.frame, episode.pictures()), fps)
        finally:
            renderer.close()
            episode.env.close()
    assert episode.picture is not None
    return Played(
        env=_full_id(request.env),
        scenario=episode.rollout.source.id,
        policy=episode.policy,
        seed=seed,
        steps=episode.steps,
        score=episode.score,
        ending=episode.ending,
        out=out,
        picture=episode.picture,
    )


def print_played(console: Console, played: Played) -> None:
    """Say in a line or two what happened."""
    console.print(
        f"{played.env} on {played.scenario}, policy {played.policy}, seed {played.seed}: "
        f"{played.steps} decisions, score {played.score:.6g}, {played.ending}",
        markup=False,
    )
    if played.out is not None:
        console.print(f"wrote {played.out}", markup=False)


def _show(renderer: Renderer, episode: _Episode) -> None:
    """Play in the window; the last picture stays until the window is closed."""
    for picture in episode.pictures():
        if not renderer.show(picture):
            return
    from pygame.display import get_driver

    # The dummy driver has nobody who could close it.
    while get_driver() != "dummy" and episode.picture is not None and renderer.show(episode.picture):
        pass


def has_display() -> bool:
    """Whether a window can be expected to open."""
    named = os.environ.get("SDL_VIDEODRIVER")
    if named:
        return named != "offscreen"
    return sys.platform in ("win32", "darwin") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def make_environment(name: str, scenario: str | None = None, agent: Policy | None = None) -> gymnasium.Env[Any, Any]:
    """An environment of Jink by its id, with or without "jink/", with the options that an agent was trained with.

    Raises:
        ValueError: no such environment or scenario.
    """
    options: dict[str, Any] = {} if scenario is None else {"scenario": scenario}
    full = _full_id(name)
    if agent is not None and full.startswith("jink/AdaptiveFactor"):
        options |= agent.environment()
        if full.startswith("jink/AdaptiveFactorContinuous"):
            options.pop("factors", None)
    return gymnasium.make(full, disable_env_checker=True, **options)


def _full_id(name: str) -> str:
    short = name.removeprefix("jink.envs:").removeprefix("jink/").lower()
    for known in ENVIRONMENTS:
        plain = known.removeprefix("jink/").lower()
        if short in (plain, plain.removesuffix("-v0")):
            return known
    raise ValueError(f"play: environment must be one of {', '.join(ENVIRONMENTS)}; got '{name}'. Choose one of them.")


def _default_name(episode: _Episode) -> Path:
    """A name in the current folder that says what it holds."""
    return Path(f"{episode.rollout.source.id}-{Path(episode.policy).name}-{episode.seed}{best_suffix()}")
