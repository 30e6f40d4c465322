"""Settings of the ladder, chosen for each suite and estimator on training episodes: see `jink bench --help`."""

from __future__ import annotations

import functools
import json
from pathlib import Path
from typing import NamedTuple

__all__ = ["SETTINGS_FILE", "Settings", "settings_of"]

SETTINGS_FILE = Path(__file__).resolve().parent / "settings.json"


class Settings(NamedTuple):
    """Factors on what `typical_scales` says, and options of single estimators.

    acceleration, sojourn, surge_every, surge_for: factors on the scales of a recipe.
    noise: factor on the nominal R that the estimator is told.
    tail: factor on the share of good measurements that an adaptive factor distrusts.
    dof: of Student-t banks.
    forgetting: of estimators that learn their noise.
    """

    acceleration: float = 1.0
    sojourn: float = 1.0
    noise: float = 1.0
    surge_every: float = 1.0
    surge_for: float = 1.0
    tail: float = 1.0
    dof: float = 5.0
    forgetting: float = 0.9


@functools.cache
def _table() -> dict[str, dict[str, dict[str, float]]]:
    if not SETTINGS_FILE.exists():
        return {}
    return dict(json.loads(SETTINGS_FILE.read_text(encoding="utf-8"))["settings"])


def settings_of(suite: str, estimator: str) -> Settings:
    """What was chosen for an estimator in a suite; the recipe's own choice where nothing was."""
    return Settings(**_table().get(suite, {}).get(estimator, {}))
