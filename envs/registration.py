"""The environments Gymnasium knows: ids and tasks by name; everything they need is imported when one is made."""

from __future__ import annotations

import gymnasium

__all__ = ["ENVIRONMENTS", "TASKS", "full_id", "register"]

TASKS: dict[str, tuple[str, str]] = {
    "manoeuvring-target": ("jink.envs.manoeuvring_target:ManoeuvringTargetTask", "switch-v0"),
    "adaptive-factor": ("jink.envs.adaptive_factor:AdaptiveFactorTask", "surge-v0"),
}
"""Name -> where the task is, and the scenario it runs where none is chosen."""

ENVIRONMENTS: dict[str, dict[str, object]] = {
    "jink/ManoeuvringTarget-v0": {"task": "manoeuvring-target"},
    "jink/AdaptiveFactor-v0": {"task": "adaptive-factor"},
    "jink/AdaptiveFactorContinuous-v0": {"task": "adaptive-factor", "continuous": True},
}
"""Id -> keywords of `TargetEnv` and `TargetVectorEnv`."""


def full_id(name: str) -> str:
    """The id of one of our environments given with or without "jink/"; any other name as it is."""
    return f"jink/{name}" if f"jink/{name}" in ENVIRONMENTS else name


def register() -> None:
    """Tell Gymnasium about every environment it does not know yet."""
    for name, options in ENVIRONMENTS.items():
        if name not in gymnasium.registry:
            gymnasium.register(
                name,
                entry_point="jink.envs.single:TargetEnv",
                vector_entry_point="jink.envs.vector:TargetVectorEnv",
                kwargs=dict(options),
            )
