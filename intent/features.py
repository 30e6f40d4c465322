"""What each row of a track says about position, velocity and shape parameters, before any filter has run.

In a window around time t a path is ``p(s) = p + v s + a s^2 / 2``, and with weights ``W_k = R_k^-1`` generalised least
squares gives ``(p, v, a)`` and their covariance ``(sum_k B_k' W_k B_k)^-1``, ``B_k = [1, s_k, s_k^2 / 2]``. The shape
parameters ``eta = (g, w)`` of the law ``v' = g v + w x v`` follow,

    g = v . a / |v|^2      (growth rate, 1/s),      w = v x a / |v|^2      (turn rate, rad/s),

with covariance ``J P J'`` of the Jacobian J (delta method). A law with constant eta is no parabola, so Gauss-Newton
steps refit the window along the exact arc ``p + v (e^(lambda s) - 1) / lambda``, lambda = g + i |w| in the plane of v
and a, where the velocity is known well enough to have a direction. Near the ends of a track a row lies outside the
middle of its window and is reached along the arc.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.estimators.tracks import Tracks
from jink.intent.arcs import arc, carried, shape_of
from jink.intent.located import information, locate
from jink.intent.spans import windows

__all__ = ["Features", "encode", "eta_labels"]

Floats = NDArray[np.float64]
_REFITS = 8
_CONVERGED = 1e-4  # fall of chi-square per step
_CERTAIN = 4.0  # standard deviations of speed before an arc is tried
_SINGULAR = 1e9  # variance of a jet over that of a mean: fewer than three different times
_RUNAWAY = 20.0  # chi-square above the parabola's at which Gauss-Newton must have failed
_LARGEST_ANGLE = 3.0  # rad, of lambda times half the window: a parabola is no start for more than a full turn


class Features(NamedTuple):
    """Position, velocity and shape parameters of each row; B tracks, T rows, A axes.

    mean: ``p (A), v (A), g, w`` (w scalar in 2-D, vector in 3-D); (B, T, N); m, m/s, 1/s, rad/s.
    cov: its covariance; (B, T, N, N). In 3-D, w is perpendicular to v: turning about v itself does not show.
    misfit: chi-square of the window over its degrees of freedom: 1 where the law fits and the noise is right; (B, T).
    dof: degrees of freedom of the window; 0 where too little was measured; (B, T).
    window: length of the window, s.
    times: (B, T), s.
    valid: rows with an estimate, `dof` > 0; (B, T).
    """

    mean: Floats
    cov: Floats
    misfit: Floats
    dof: NDArray[np.int64]
    window: float
    times: Floats
    valid: NDArray[np.bool_]

    @property
    def axes(self) -> int:
        """Space dimensions A."""
        return 2 if self.mean.shape[2] == 6 else 3

    @property
    def eta(self) -> Floats:
        """Shape parameters (g, w); (B, T, E) with E = 2 in the plane, 4 in space."""
        return self.mean[..., 2 * self.axes :]

    @property
    def eta_cov(self) -> Floats:
        """Covariance of `eta`; (B, T, E, E)."""
        return self.cov[..., 2 * self.axes :, 2 * self.axes :]

    @property
    def velocity(self) -> Floats:
        """(B, T, A), m/s."""
        return self.mean[..., self.axes : 2 * self.axes]

    @property
    def velocity_cov(self) -> Floats:
        """(B, T, A, A)."""
        A = self.axes
        return self.cov[..., A : 2 * A, A : 2 * A]

    @property
    def speed_ratio(self) -> Floats:
        """Speed over its standard deviation: below about 3 the shape parameters mean little; (B, T)."""
        spread = np.trace(self.velocity_cov, axis1=-2, axis2=-1) / self.axes
        speed = np.sqrt(np.sum(self.velocity**2, axis=-1))
        return np.asarray(speed / np.sqrt(np.where(spread > 0.0, spread, np.nan)))


def eta_labels(axes: int) -> tuple[str, ...]:
    """Names of the shape parameters: ``g w`` in the plane, ``g wx wy wz`` in space."""
    return ("g", "w") if axes == 2 else ("g", "wx", "wy", "wz")


def encode(
    tracks: Tracks, window: float, noise_sd: float | None = None, rows: NDArray[np.bool_] | None = None
) -> Features:
    """Windowed generalised least squares: (p, v, eta) with covariance at every row.

    A window is ``window`` seconds long and centred on the row, shifted inwards at the ends of the track and widened to
    the five nearest measured rows where it holds fewer. Rows without a measurement get an estimate too. Covariances
    hold the measurement noise only; where the law changes inside a window, `Features.misfit` says so.

    Args:
        tracks: positions, or measurements of a sensor that locates the target alone; 2 or 3 axes; times may be
            irregular and every row may have its own covariance.
        window: s; see `jink.intent.window.choose_window`.
        noise_sd: standard deviation of a position per axis, m; None: the noise of the tracks, or an estimate from them.
        rows: where an estimate is wanted, (B, T); None: everywhere.

    Returns:
        the features; rows of tracks with fewer than five measured rows, and padding, are not valid.

    Raises:
        ValueError: one axis, a window that is not positive, a sensor that does not locate, or a noise that is no
            covariance.

    Source: weighted least squares; the law is that of Jink's intents. Differs: refitting along the exact arc.
    """
    if tracks.axes not in (2, 3):
        raise ValueError(f"encode: tracks must have 2 or 3 axes; got {tracks.axes}. Directions need a plane.")
    if not 0.0 < window < np.inf:
        raise ValueError(f"encode: window must be > 0 s and finite; got {window}. Use choose_window(tracks).")
    positions, covs = locate(tracks, noise_sd)
    (B, T), A = tracks.times.shape, tracks.axes
    N = 2 * A + len(eta_labels(A))
    mean, cov = np.full((B, T, N), np.nan), np.full((B, T, N, N), np.nan)
    misfit, dof = np.full((B, T), np.nan), np.zeros((B, T), dtype=np.int64)
    given = np.where(tracks.used[..., None], positions, np.nan)
    weights = information(given, covs)
    present = np.asarray(np.isfinite(given).any(axis=2))
    wanted = np.asarray(tracks.used if rows is None else tracks.used & rows)
    centre = np.nanmean(given, axis=(0, 1)) if present.any() else np.zeros(A)  # far origins cost digits
    values = np.where(np.isfinite(given), given - centre, 0.0)
    for at, middle, index, inside in windows(tracks.times, wanted, present, window):
        b, t = at
        s = np.where(inside, tracks.times[b[:, None], index] - middle[:, None], 0.0)
        W = weights[b[:, None], index] * inside[..., None, None]
        z = values[b[:, None], index]
        jet, jet_cov, chi2, curved = _fit(s, z, W)
        measured = (np.trace(W, axis1=-2, axis2=-1) > 0).sum(axis=1) * A
        free = np.maximum(measured - 3 * A, 0)
        mean[b, t], cov[b, t] = _shape(jet, jet_cov, tracks.times[b, t] - middle, curved)
        mean[b, t, :A] += centre
        misfit[b, t], dof[b, t] = chi2 / np.maximum(free, 1), free
    valid = (dof > 0) & np.isfinite(misfit) & np.isfinite(cov).all(axis=(2, 3)) & np.isfinite(mean).all(axis=2)
    return Features(mean, cov, misfit, np.where(valid, dof, 0), float(window), tracks.times, valid)


def _fit(s: Floats, z: Floats, W: Floats) -> tuple[Floats, Floats, Floats, NDArray[np.bool_]]:
    """Jets (K, 3 A) of windows, covariances, chi-square, and which are arcs; ``s`` (K, W), ``z`` (K, W, A), ``W``.

    First the parabola, then Gauss-Newton on the arc, which is refused only where the steps ran away: to choose the
    better of the two fits would bias both.
    """
    K, _, A = z.shape
    unit = np.maximum(np.abs(s).max(axis=1), 1e-12)  # windows in units of their own reach: well-conditioned
    x = s / unit[:, None]
    eye = np.broadcast_to(np.eye(A), (*x.shape, A, A))
    parabola = np.concatenate([eye, x[..., None, None] * eye, (0.5 * x**2)[..., None, None] * eye], axis=3)
    jet, cov, gain = _solve(parabola, z, W)
    information = np.trace(W.sum(axis=1), axis1=1, axis2=2)
    chi2 = _chi_square(z, W) - gain
    v = jet[:, A : 2 * A]
    certain = np.sum(v * v, axis=1) > _CERTAIN**2 * np.trace(cov[:, A : 2 * A, A : 2 * A], axis1=1, axis2=2)
    moving = np.flatnonzero(certain & _gentle(jet))
    bent = (jet.copy(), cov.copy(), np.full(K, np.inf))
    for _ in range(_REFITS):
        if not moving.size:
            break
        start = bent[0][moving]
        d, by_v, by_a = arc(start[:, A : 2 * A], start[:, 2 * A :], x[moving])
        residual = z[moving] - start[:, None, :A] - d
        step, bent[1][moving], gain = _solve(np.concatenate([eye[moving], by_v, by_a], axis=3), residual, W[moving])
        bent[0][moving], bent[2][moving] = start + step, _chi_square(residual, W[moving]) - gain
        gentle = _gentle(bent[0][moving])
        bent[2][moving[~gentle]] = np.inf
        moving = moving[gentle & (gain > _CONVERGED)]
    sound = bent[2] <= 2.0 * chi2 + _RUNAWAY
    sound &= np.isfinite(bent[0]).all(axis=1)
    for plain, refined in zip((jet, cov, chi2), bent, strict=True):
        plain[sound] = refined[sound]
    singular = np.max(cov[:, range(3 * A), range(3 * A)], axis=1) * information > _SINGULAR
    jet[singular], chi2[singular] = 0.0, np.nan
    units = np.repeat(np.stack([np.ones(K), 1.0 / unit, 1.0 / unit**2], axis=1), A, axis=1)
    return np.asarray(jet * units), cov * units[:, :, None] * units[:, None, :], chi2, sound & ~singular


def _gentle(jet: Floats) -> NDArray[np.bool_]:
    """Jets in units of half a window that turn or grow little enough for an arc."""
    A = jet.shape[1] // 3
    v, a = jet[:, A : 2 * A], jet[:, 2 * A :]
    return np.asarray(np.sum(a * a, axis=1) < _LARGEST_ANGLE**2 * np.sum(v * v, axis=1))


def _solve(design: Floats, residual: Floats, W: Floats) -> tuple[Floats, Floats, Floats]:
    """Weighted least squares of windows: solution (K, P), covariance (K, P, P), fall of chi-square (K,)."""
    K, width, A, P = design.shape
    weighted = np.zeros_like(design)
    for i in range(A):
        for j in range(A):
            weighted[:, :, i] += W[:, :, i, j, None] * design[:, :, j]
    flat = np.ascontiguousarray(weighted.reshape(K, width * A, P).swapaxes(1, 2))
    normal = flat @ design.reshape(K, width * A, P)
    right = (flat @ residual.reshape(K, width * A, 1))[..., 0]
    level = np.trace(normal, axis1=1, axis2=2)[:, None, None]
    cov = np.linalg.inv(normal + np.where(level > 0.0, 1e-13 * level, 1.0) * np.eye(P))
    found = (cov @ right[..., None])[..., 0]
    return found, np.asarray(cov, dtype=np.float64), np.asarray(np.sum(found * right, axis=1))


def _chi_square(residual: Floats, W: Floats) -> Floats:
    return np.asarray(np.einsum("kwa,kwab,kwb->k", residual, W, residual, optimize=True))


def _shape(jet: Floats, jet_cov: Floats, ahead: Floats, curved: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """(p, v, eta) and covariance of jets (K, 3 A), ``ahead`` (K,) seconds on, along arcs or parabolas."""
    K, A = jet.shape[0], jet.shape[1] // 3
    s = np.where(curved, 0.0, ahead)[:, None, None] * np.eye(A)
    J = np.zeros((K, 2 * A, 3 * A))
    J[:, range(2 * A), range(2 * A)] = 1.0
    J[:, :A, A : 2 * A], J[:, :A, 2 * A :], J[:, A:, 2 * A :] = s, 0.5 * s @ s, s
    place = (J @ jet[..., None])[..., 0]
    moved = np.flatnonzero(curved & (ahead != 0.0))
    place[moved], J[moved] = carried(jet[moved], ahead[moved])
    eta, J_eta = shape_of(jet[:, A : 2 * A], jet[:, 2 * A :])
    J = np.concatenate([J, np.concatenate([np.zeros((*eta.shape, A)), J_eta], axis=2)], axis=1)
    with np.errstate(over="ignore", invalid="ignore"):  # a target at rest has no eta: its row is not valid
        return np.concatenate([place, eta], axis=1), J @ jet_cov @ J.swapaxes(-1, -2)
