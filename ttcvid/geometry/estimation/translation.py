"""The direction of a moving body (`estimation.moving_body`) by maximum likelihood, from whole point tracks."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ttcvid.geometry.estimation.moving_body import (
    DRIFT,
    N_OWN,
    N_SHARED,
    RATE,
    BodyTracks,
    Unknowns,
    across_lines,
    first_unknowns,
    linearised,
    residuals,
)
from ttcvid.geometry.medians import MEDIAN_RAYLEIGH
from ttcvid.geometry.rotation import normalize
from ttcvid.model import Floats

_MAX_ITERATIONS = 40
# The search ends when a step lowers the cost by less than this, in units of chi-square: a tenth of a sigma.
_CONVERGED_CHI2 = 1e-2
_LONGEST_STEP = 0.3
_DAMPING_START, _DAMPING_END = 1e-3, 1e6
# Scale of the Cauchy weights of an observation, in sigmas of its two coordinates.
_CAUCHY_SIGMAS = 3.0
_LEAST_NOISE = 1e-3
_TINY = 1e-12
# The drift is estimated so often: first about a direction that it may have misled.
_DRIFT_ROUNDS = 2
# Drifts are at most this part of the points' speed: more is no body.
_MOST_DRIFT = 0.1
# Median of the square of a standard normal variable.
_MEDIAN_CHI2_1 = 0.455


@dataclass(frozen=True)
class Translation:
    """A body's direction of motion.

    ``direction (3,)`` is ``dir`` = V / |V| with ``covariance (3, 3)`` in its tangent plane, rad^2, which includes
    errors that last over several frames and are common to the tracks. ``turn_rad_s`` is w of `estimation.moving_body`,
    with the standard deviation ``turn_sigma_rad_s``. ``noise`` is the estimated noise in units of the assumed one;
    ``correlation`` the factor of the variance over that of independent errors; ``rate_hz (M,)`` is s of each track,
    ``residual (M,)`` its root mean square residual in sigmas of the estimated noise.
    """

    direction: Floats
    covariance: Floats
    turn_rad_s: float
    turn_sigma_rad_s: float
    noise: float
    correlation: float
    rate_hz: Floats
    residual: Floats


@dataclass(frozen=True)
class _Prior:
    """Inverse variances: ``shared (4,)`` of the body's unknowns, ``drift`` of a point's drift."""

    shared: Floats
    drift: float


@dataclass(frozen=True)
class _Equations:
    """Normal equations of one linearisation, the own unknowns eliminated.

    ``own, shared (N, 2, 4)`` are the derivatives of the predicted positions by the unknowns. ``own_inverse, gain (M, 4,
    4)``: a step of the shared unknowns changes the own by ``-gain @ step``.
    """

    own: Floats
    shared: Floats
    basis: Floats
    weight: Floats
    noise: float
    own_inverse: Floats
    gain: Floats
    information: Floats


def fit_translation(
    tracks: BodyTracks, start: Floats, speed_change_sigma_hz: float, turn_sigma_rad_s: float, memory_s: float
) -> Translation | None:
    """Maximum likelihood estimate of the direction of a body; None where the search does not converge.

    Gauss-Newton on the reprojection error with Cauchy weights; the unknowns of each point are eliminated. The drift of
    points is estimated from the scatter of their lines about a first direction found without drift.

    Parameters
    ----------
    tracks : The body's tracks.
    start : ``(3,)`` start direction, its sign along the motion.
    speed_change_sigma_hz, turn_sigma_rad_s : Standard deviations of the priors of the nuisance parameters.
    memory_s : Correlation time of errors: those farther apart are independent, nearer ones are used as they are found.
    """
    shared = 1.0 / np.array([np.inf, np.inf, speed_change_sigma_hz, turn_sigma_rad_s]) ** 2
    prior = _Prior(shared, 1.0 / _TINY)
    unknowns = _converged(tracks, first_unknowns(tracks, start), prior)
    if unknowns is None:
        return None
    for _ in range(_DRIFT_ROUNDS):
        drift_sigma = _drift_sigma(tracks, unknowns)
        if drift_sigma == 0.0:
            break
        prior = _Prior(shared, 1.0 / drift_sigma**2)
        unknowns = _converged(tracks, unknowns, prior)
        if unknowns is None:
            return None
    return _result(tracks, unknowns, prior, memory_s)


def _drift_sigma(tracks: BodyTracks, unknowns: Unknowns) -> float:
    """Standard deviation of the drifts of the points about their lines, less what noise alone makes; 0: none."""
    own = unknowns.own.copy()
    own[:, DRIFT] = 0.0
    unknowns = replace(unknowns, own=own)
    residual, across = residuals(tracks, unknowns), across_lines(tracks, unknowns)
    lever = np.maximum(tracks.sums(np.sum(across**2, axis=1)), _TINY)
    drift = tracks.sums(np.sum(across * residual, axis=1)) / lever
    by_noise = _noise(np.linalg.norm(residual, axis=1)) ** 2 / lever
    # The direction has followed two of the drifts.
    few = tracks.n_tracks / max(tracks.n_tracks - 2.0, 0.5)
    excess = few * float(np.median(drift**2)) / _MEDIAN_CHI2_1 - float(np.median(by_noise))
    towards = unknowns.direction[:2] - unknowns.own[:, :2] * unknowns.direction[2]
    speed = np.abs(unknowns.own[:, RATE]) * np.linalg.norm(towards, axis=1) / tracks.sigma
    return float(min(np.sqrt(max(excess, 0.0)), _MOST_DRIFT * np.median(speed)))


def _noise(size: Floats) -> float:
    """Noise of a coordinate by the lengths ``(N,)`` of the residuals."""
    return max(float(np.median(size)) / MEDIAN_RAYLEIGH, _LEAST_NOISE)


def _converged(tracks: BodyTracks, unknowns: Unknowns, prior: _Prior) -> Unknowns | None:
    """Levenberg and Marquardt's way to the least cost; None where it leads nowhere."""
    damping = _DAMPING_START
    for _ in range(_MAX_ITERATIONS):
        residual = residuals(tracks, unknowns)
        equations = _equations(tracks, unknowns, residual, prior, damping)
        step_shared, step_own = _step(tracks, unknowns, residual, equations, prior, damping)
        if not (np.isfinite(step_shared).all() and np.isfinite(step_own).all()):
            return None
        direction = normalize(unknowns.direction + equations.basis @ step_shared[:2])
        trial = Unknowns(direction, unknowns.change + step_shared[2:], unknowns.own + step_own)
        cost, trial_cost = (_cost(tracks, one, equations.noise, prior) for one in (unknowns, trial))
        if trial_cost <= cost:
            unknowns, damping = trial, max(damping * 0.1, 1e-9)
            if cost - trial_cost < _CONVERGED_CHI2:
                break
        else:
            damping *= 8.0
            if damping > _DAMPING_END:
                break
    return unknowns


def _cost(tracks: BodyTracks, unknowns: Unknowns, noise: float, prior: _Prior) -> float:
    square = np.sum(residuals(tracks, unknowns) ** 2, axis=1) / (noise * _CAUCHY_SIGMAS) ** 2
    held = prior.shared[2:] @ unknowns.change**2 + prior.drift * np.sum(unknowns.own[:, DRIFT] ** 2)
    return float(_CAUCHY_SIGMAS**2 * np.log1p(square).sum() + held)


def _equations(tracks: BodyTracks, unknowns: Unknowns, residual: Floats, prior: _Prior, damping: float) -> _Equations:
    jacobian, basis = linearised(tracks, unknowns)
    size = np.linalg.norm(residual, axis=1)
    noise = _noise(size)
    weight = 1.0 / (1.0 + (size / (noise * _CAUCHY_SIGMAS)) ** 2) / noise**2
    own, shared = jacobian[:, :, :N_OWN], jacobian[:, :, N_OWN:]
    block = tracks.sums(np.einsum("nki,nkj,n->nij", own, own, weight))
    mixed = tracks.sums(np.einsum("nki,nkj,n->nij", own, shared, weight))
    diagonal = np.einsum("mii->mi", block)
    diagonal[:, DRIFT] += prior.drift
    diagonal *= 1.0 + damping
    diagonal += _TINY
    own_inverse = np.asarray(np.linalg.inv(block), dtype=np.float64)
    gain = own_inverse @ mixed
    information = np.einsum("nki,nkj,n->ij", shared, shared, weight) - np.einsum("mij,mik->jk", mixed, gain)
    return _Equations(own, shared, basis, weight, noise, own_inverse, gain, information)


def _step(
    tracks: BodyTracks, unknowns: Unknowns, residual: Floats, equations: _Equations, prior: _Prior, damping: float
) -> tuple[Floats, Floats]:
    """Gauss-Newton step of the shared ``(4,)`` and own ``(M, 4)`` unknowns."""
    own_side = tracks.sums(np.einsum("nki,nk,n->ni", equations.own, residual, equations.weight))
    own_side[:, DRIFT] -= prior.drift * unknowns.own[:, DRIFT]
    side = np.einsum("nki,nk,n->i", equations.shared, residual, equations.weight)
    side -= np.einsum("mik,mi->k", equations.gain, own_side)
    side[2:] -= prior.shared[2:] * unknowns.change
    matrix = equations.information + np.diag(prior.shared)
    matrix += np.diag(damping * np.diag(matrix) + _TINY)
    step: Floats = np.linalg.solve(matrix, side)
    step *= min(1.0, _LONGEST_STEP / max(float(np.abs(step).max()), _TINY))
    return step, np.einsum("mij,mj->mi", equations.own_inverse, own_side) - equations.gain @ step


def _result(tracks: BodyTracks, unknowns: Unknowns, prior: _Prior, memory_s: float) -> Translation | None:
    """Direction, its covariance and what goes with it at the minimum; None where that covariance is not finite."""
    residual = residuals(tracks, unknowns)
    equations = _equations(tracks, unknowns, residual, prior, 0.0)
    # Derivative of each observation by the shared unknowns once the own ones have followed.
    free = equations.shared - np.einsum("nki,nij->nkj", equations.own, equations.gain[tracks.track])
    scores = np.einsum("nki,nk,n->ni", free, residual, equations.weight)
    spread, correlation = _inflated(tracks, scores, equations.information, memory_s)
    posterior = np.linalg.inv(equations.information + np.diag(prior.shared) + _TINY * np.eye(N_SHARED))
    covariance = posterior @ (spread + np.diag(prior.shared)) @ posterior
    if not np.isfinite(covariance).all():
        return None
    return Translation(
        direction=unknowns.direction,
        covariance=equations.basis @ covariance[:2, :2] @ equations.basis.T,
        turn_rad_s=float(unknowns.change[1]),
        turn_sigma_rad_s=float(np.sqrt(covariance[3, 3])),
        noise=equations.noise,
        correlation=correlation,
        rate_hz=unknowns.own[:, RATE],
        residual=np.sqrt(tracks.sums(np.sum(residual**2, axis=1)) / (2 * tracks.counts)) / equations.noise,
    )


def _inflated(tracks: BodyTracks, scores: Floats, information: Floats, memory_s: float) -> tuple[Floats, float]:
    """Covariance ``(4, 4)`` of the scores' sum, at least what independent errors give it; and by how much it is larger.

    Errors hang together in two ways: what all tracks have in common at a time (a walker's bob), up to ``memory_s``
    apart with triangular weights (Newey and West, Econometrica 1987), and what one track has all its life (a sleeve
    that swings, a rim that slides). Both are taken from the scores, their overlap once (Cameron, Gelbach and Miller,
    JBES 2011). Directions of the unknowns in which the scores scatter less than expected keep what is expected.
    """
    frame_t_s, frame = np.unique(tracks.t_s, return_inverse=True)
    by_frame = np.zeros((len(frame_t_s), scores.shape[1]))
    np.add.at(by_frame, frame, scores)
    apart_s = np.abs(frame_t_s[:, None] - frame_t_s[None, :])
    memory_s = min(memory_s, 0.25 * float(frame_t_s[-1] - frame_t_s[0]))
    kernel = np.maximum(1.0 - apart_s / max(memory_s, _TINY), 0.0)
    by_track = tracks.sums(scores)
    few = tracks.n_tracks / max(tracks.n_tracks - 2.0, 0.5)
    spread = by_frame.T @ kernel @ by_frame + few * (by_track.T @ by_track) - scores.T @ scores
    scale = np.sqrt(np.maximum(np.diag(information), _TINY))
    root = np.linalg.cholesky(information / np.outer(scale, scale) + 1e-9 * np.eye(N_SHARED)) * scale[:, None]
    inverse = np.linalg.inv(root)
    values, vectors = np.linalg.eigh(inverse @ spread @ inverse.T)
    values = np.maximum(values, 1.0)
    return root @ vectors @ np.diag(values) @ vectors.T @ root.T, float(values.mean())
