"""Frames of environments: `Frames` opens a renderer when the first picture is wanted, and only then."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium

from jink.envs.rollout import Rollout

if TYPE_CHECKING:
    from jink.envs.rendering import Renderer

__all__ = ["FPS", "RENDER_MODES", "Frames"]

RENDER_MODES = ("human", "rgb_array")
FPS = 30


class Frames:
    """Pictures of one environment.

    Args:
        mode: "human", "rgb_array" or None.

    Raises:
        ValueError: another mode.
    """

    def __init__(self, mode: str | None) -> None:
        if mode is not None and mode not in RENDER_MODES:
            raise ValueError(f"make: render_mode must be {' or '.join(RENDER_MODES)}; got {mode!r}. Leave it out.")
        self.mode = mode
        self._renderer: Renderer | None = None

    def __getstate__(self) -> dict[str, Any]:
        """A window belongs to one process."""
        return {"mode": self.mode, "_renderer": None}

    def _opened(self) -> Renderer:
        if self._renderer is None:
            from jink.envs.rendering import Renderer

            self._renderer = Renderer(mode=self.mode or "rgb_array", fps=FPS)
        return self._renderer

    def show(self, rollout: Rollout, row: int) -> None:
        """Put one target into the window."""
        self._opened().show(rollout.task.picture(row, int(rollout.k[row])))

    def frame(self, rollout: Rollout, row: int) -> Any:
        """One target as an array (H, W, 3) of uint8."""
        return self._opened().frame(rollout.task.picture(row, int(rollout.k[row])))

    def render(self, env: Any, rollout: Rollout, row: int) -> Any:
        """What ``env.render()`` gives for one target."""
        if self.mode is None:
            gymnasium.logger.warn(
                f"render: render_mode must be chosen in make; {env} has none. Use for example render_mode='rgb_array'."
            )
            return None
        rollout.need_begun("render")
        return self.show(rollout, row) if self.mode == "human" else self.frame(rollout, row)

    def close(self) -> None:
        """Close the window, if any."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
