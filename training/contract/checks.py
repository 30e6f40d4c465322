"""All checks of an estimator; each passes and says what it saw, or raises what it found and how to mend it."""

from __future__ import annotations

from collections.abc import Callable

from jink.training.contract.independence_checks import (
    check_causal,
    check_deterministic,
    check_inputs_untouched,
    check_neighbours,
    check_padding,
    check_singles,
)
from jink.training.contract.prior_checks import check_prior
from jink.training.contract.step_checks import check_state, check_steps
from jink.training.contract.subject import Subject
from jink.training.contract.trouble_checks import check_missing, check_outliers, check_times
from jink.training.contract.value_checks import check_follows, check_shapes, check_values

__all__ = ["CHECKS"]

CHECKS: dict[str, Callable[[Subject], str]] = {
    "shapes and numbers": check_shapes,
    "values": check_values,
    "follows": check_follows,
    "inputs untouched": check_inputs_untouched,
    "determinism": check_deterministic,
    "batch equals singles": check_singles,
    "neighbours": check_neighbours,
    "padding": check_padding,
    "causality": check_causal,
    "prior": check_prior,
    "missing data": check_missing,
    "times": check_times,
    "outliers": check_outliers,
    "run equals steps": check_steps,
    "state is a value": check_state,
}
"""Name -> check, in the order of the report."""
