"""Where modes meet: position and velocity carry over, shape parameters stay or are born anew; and back."""

from __future__ import annotations

from jink.estimators.compiled import kernel

__all__ = ["mix", "mix_adjoint"]


@kernel
def mix(modes, n, kin, chain, probs, mean, cov, birth_mean, birth_var, weights, prior, m_out, P_out):
    """Prior probabilities, weights (from, to) and the moments every mode starts from."""
    for p in range(modes):
        total = 0.0
        for q in range(modes):
            weights[q, p] = chain[q, p] * probs[q]
            total += weights[q, p]
        prior[p] = total
        if not total > 0.0:
            for q in range(modes):
                weights[q, p] = 1.0 if q == p else 0.0
        else:
            for q in range(modes):
                weights[q, p] /= total
        for i in range(kin):
            total = 0.0
            for q in range(modes):
                total += weights[q, p] * mean[q, i]
            m_out[p, i] = total
        for i in range(kin):
            for j in range(i, kin):
                total = 0.0
                for q in range(modes):
                    away = (mean[q, i] - m_out[p, i]) * (mean[q, j] - m_out[p, j])
                    total += weights[q, p] * (cov[q, i, j] + away)
                P_out[p, i, j] = total
                P_out[p, j, i] = total
        stay = weights[p, p]
        for i in range(kin, n):
            novel = mean[p, i] - birth_mean[p, i - kin]
            m_out[p, i] = birth_mean[p, i - kin] + stay * novel
            for j in range(kin):
                value = stay * (cov[p, j, i] + (mean[p, j] - m_out[p, j]) * novel)
                P_out[p, i, j] = value
                P_out[p, j, i] = value
            for j in range(kin, i + 1):
                other = mean[p, j] - birth_mean[p, j - kin]
                value = stay * cov[p, i, j] + (1.0 - stay) * stay * novel * other
                if i == j:
                    value += (1.0 - stay) * birth_var[p, i - kin]
                P_out[p, i, j] = value
                P_out[p, j, i] = value


@kernel
def mix_adjoint(
    modes, n, kin, chain, probs, mean, cov, birth_mean, birth_var, weights, prior, mixed,
    prior_bar, mixed_bar, mixed_cov_bar, chain_bar, probs_bar, mean_bar, cov_bar, birth_mean_bar, birth_var_bar, share,
):  # fmt: skip
    """From derivatives by priors and mixed moments, those by everything mixed.

    Overwrites ``probs_bar``, ``mean_bar``, ``cov_bar``; adds to the others; ``mixed_bar`` is used up; ``share`` (M,).
    """
    for p in range(modes):
        probs_bar[p] = 0.0
        for i in range(n):
            mean_bar[p, i] = 0.0
            for j in range(n):
                cov_bar[p, i, j] = 0.0
    for p in range(modes):
        stay = weights[p, p]
        stay_bar = 0.0
        for i in range(kin, n):
            k = i - kin
            novel = mean[p, i] - birth_mean[p, k]
            novel_bar = stay * mixed_bar[p, i]
            stay_bar += mixed_bar[p, i] * novel
            for j in range(kin, n):
                bar = mixed_cov_bar[p, i, j]
                other = mean[p, j] - birth_mean[p, j - kin]
                stay_bar += bar * (cov[p, i, j] + (1.0 - 2.0 * stay) * novel * other)
                novel_bar += 2.0 * stay * (1.0 - stay) * bar * other
                cov_bar[p, i, j] += stay * bar
            bar = mixed_cov_bar[p, i, i]
            stay_bar -= bar * birth_var[p, k]
            birth_var_bar[p, k] += (1.0 - stay) * bar
            for j in range(kin):
                bar = 2.0 * mixed_cov_bar[p, i, j]
                away = mean[p, j] - mixed[p, j]
                stay_bar += bar * (cov[p, j, i] + away * novel)
                novel_bar += stay * bar * away
                cov_bar[p, i, j] += 0.5 * stay * bar
                cov_bar[p, j, i] += 0.5 * stay * bar
                away_bar = stay * bar * novel
                mean_bar[p, j] += away_bar
                mixed_bar[p, j] -= away_bar
            mean_bar[p, i] += novel_bar
            birth_mean_bar[p, k] += mixed_bar[p, i] - novel_bar
        average = 0.0
        for q in range(modes):
            weight = weights[q, p]
            bar = stay_bar if q == p else 0.0
            if weight > 0.0 or prior[p] > 0.0:
                for i in range(kin):
                    away = mean[q, i] - mixed[p, i]
                    through = 0.0
                    for j in range(kin):
                        entry = mixed_cov_bar[p, i, j]
                        through += entry * (mean[q, j] - mixed[p, j])
                        bar += entry * cov[q, i, j]
                        cov_bar[q, i, j] += weight * entry
                    bar += away * (mixed_bar[p, i] + through)
                    mean_bar[q, i] += weight * (mixed_bar[p, i] + 2.0 * through)
            share[q] = bar
            average += bar * weight
        for q in range(modes):
            joint_bar = prior_bar[p]
            if prior[p] > 0.0:
                joint_bar += (share[q] - average) / prior[p]
            chain_bar[q, p] += joint_bar * probs[q]
            probs_bar[q] += joint_bar * chain[q, p]
