"""Where the target will be: every mode extrapolated, then fused."""

from __future__ import annotations

import numpy as np

from jink.estimators.compiled import entry_kernel
from jink.estimators.fusion import fuse
from jink.estimators.linalg import copy_matrix, copy_rows, copy_vector
from jink.estimators.markov import transition_matrix
from jink.estimators.modes import predict_mode
from jink.estimators.program import program_at, work_at

__all__ = ["forecast_states"]


@entry_kernel
def forecast_states(program_handle, work_handle, state, dt, steps, marginal, kin_mean, kin_cov):
    """Position and velocity ``steps`` times ``dt`` seconds ahead of each of B states.

    Model: each mode repeats its prediction (points redrawn and noise added every step); weights are today's mode
    probabilities (W1: the intent persists), or with ``marginal`` those of the chain at the horizon (W2).
    Source: CN202211553542 claim 3, step A12. Differs: the patent names no weights; both are offered.
    """
    program, work = program_at(program_handle), work_at(work_handle)
    modes = state.mean.shape[1]
    probs = work.weights
    for b in range(state.mean.shape[0]):
        copy_vector(state.mode_probs[b], probs)
        for j in range(modes):
            copy_vector(state.mean[b, j], work.mixed_mean[j])
            copy_rows(state.cov[b, j], work.mixed_cov[j], program.sizes[j])
        for _ in range(steps):
            for j in range(modes):
                predict_mode(
                    program, work, j, work.mixed_mean[j], work.mixed_cov[j], dt,
                    work.predicted_mean[j], work.predicted_cov[j],
                )  # fmt: skip
                copy_vector(work.predicted_mean[j], work.mixed_mean[j])
                copy_rows(work.predicted_cov[j], work.mixed_cov[j], program.sizes[j])
            if marginal:
                work.cached_dt[modes] = np.nan
                if program.per_step:
                    copy_matrix(program.chain, work.chain, modes)
                else:
                    transition_matrix(program.chain, dt, modes, work.chain_scratch, work.chain)
                for j in range(modes):
                    work.prior[j] = 0.0
                    for i in range(modes):
                        work.prior[j] += work.chain[i, j] * probs[i]
                copy_vector(work.prior, probs)
        fuse(program, work, work.mixed_mean, work.mixed_cov, probs, kin_mean[b], kin_cov[b])
