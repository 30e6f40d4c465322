"""Position and velocity of a state, whatever its components."""

from __future__ import annotations

from jink.estimators.compiled import call_kinematics, inner_kernel

__all__ = ["kinematics_of"]


@inner_kernel
def kinematics_of(program, j, x, out):
    """Position and velocity (2A,) of a state of mode ``j``."""
    index = program.kin_index[j]
    if index[0] >= 0:
        for i in range(out.size):
            out[i] = x[index[i]]
    else:
        call_kinematics(program.kinematics[j], x[: program.sizes[j]], program.params[j, : program.param_counts[j]], out)
