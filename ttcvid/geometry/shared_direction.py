"""The direction of motion that the points of one translating thing share, from the states of their whole tracks."""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled
from ttcvid.geometry.rotation import normalize, tangent_basis
from ttcvid.model import Floats

# A point off by more sigmas than this loses weight (Cauchy).
_CAUCHY_SIGMAS = 3.0
_MAX_STEPS = 12
# In the vote on the sense a point counts at most this many sigmas.
_MAX_VOTE_SIGMAS = 3.0
_CONVERGED_RAD = 1e-6
# A step is cut to this length.
_LONGEST_STEP_RAD = 0.3


def shared_direction(
    velocity_hz: Floats, info_w: Floats, by_shared: Floats | None = None
) -> tuple[Floats, Floats, Floats]:
    """Maximum-likelihood ``dir`` of N points that move alike, each at its own rate: w_i = s_i e.

    Minimises ``sum rho(min_s (w_i - s e)' info_i (w_i - s e))`` over the sphere, Cauchy's rho; chi-square with two
    degrees of freedom a point. Where the points fit worse than their noise allows, the covariance is widened by that.

    Parameters
    ----------
    velocity_hz, info_w : (N, 3) and (N, 3, 3) of `whole_track.WholeTracks`: (a, b, c) and its information, in s^2.
    by_shared : (N, 3, K) what one standard deviation of each of K errors that all points share does to w; None: none.

    Returns
    -------
    direction : (3,) unit vector, NaN where no point says anything.
    covariance : (3, 3) in its tangent plane, rad^2.
    chi2 : (N,) of each point.

    Source: DESIGN section 3 (w_i = s_i e with one shared e).

    >>> w = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, -0.5]])
    >>> shared_direction(w, np.broadcast_to(np.eye(3) * 1e4, (2, 3, 3)))[0].round(9) + 0.0
    array([ 0.,  0., -1.])
    """
    n = len(velocity_hz)
    usable = np.isfinite(velocity_hz).all(axis=1) & (np.trace(info_w, axis1=1, axis2=2) > 0.0)
    if not usable.any():
        return np.full(3, np.nan), np.full((3, 3), np.nan), np.zeros(n)
    w, info = np.where(usable[:, None], velocity_hz, 0.0), np.where(usable[:, None, None], info_w, 0.0)
    shared = np.zeros((n, 3, 0)) if by_shared is None else by_shared
    e = _start(w, info)
    for _ in range(_MAX_STEPS):
        basis = tangent_basis(e)
        normal, score, _, _, _ = _sums(w, info, shared, e, basis)
        step = -np.linalg.solve(normal + 1e-12 * (np.trace(normal) + 1e-300) * np.eye(2), score)
        length = float(np.linalg.norm(step))
        e = normalize(e + basis @ (step * min(1.0, _LONGEST_STEP_RAD / max(length, 1e-300))))
        if length < _CONVERGED_RAD:
            break
    basis = tangent_basis(e)
    normal, _, mixed, chi2, forwards = _sums(w, info, shared, e, basis)
    if np.sum(np.clip(forwards, -_MAX_VOTE_SIGMAS, _MAX_VOTE_SIGMAS)) < 0.0:
        # The fit knows a line; in which sense the points move along it, they vote.
        e, basis, mixed = -e, -basis, -mixed
    inverse = np.linalg.inv(normal + 1e-12 * (np.trace(normal) + 1e-300) * np.eye(2))
    dof = max(2 * int(np.count_nonzero(usable)) - 2, 1)
    widened = max(float(np.sum(np.minimum(chi2, _CAUCHY_SIGMAS**2))) / dof, 1.0)
    by_errors = inverse @ mixed
    covariance = basis @ (widened * inverse + by_errors @ by_errors.T) @ basis.T
    return e, covariance, chi2


def _start(w: Floats, info: Floats) -> Floats:
    """The main axis of the velocities, each weighted by how well it is known, in the sense that most of them have."""
    known = np.sqrt(np.einsum("ni,nij,nj->n", w, info, w)) / np.maximum(np.linalg.norm(w, axis=1), 1e-300)
    weighted = w * known[:, None]
    axis = np.linalg.eigh(weighted.T @ weighted)[1][:, -1]
    return np.asarray(axis if np.sum(weighted @ axis) >= 0.0 else -axis)


@compiled
def _sums(
    w: Floats, info: Floats, shared: Floats, e: Floats, basis: Floats
) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Normal matrix (2, 2), score (2,), its change by shared errors (2, K); chi-square and rate of each, in sigmas."""
    n_shared = shared.shape[2]
    normal, score, mixed = np.zeros((2, 2)), np.zeros(2), np.zeros((2, n_shared))
    chi2, forwards = np.zeros(len(w)), np.zeros(len(w))
    along, rest, row = np.zeros(3), np.zeros(3), np.zeros((2, 3))
    for i in range(len(w)):
        square = 0.0
        for a in range(3):
            along[a] = info[i, a, 0] * e[0] + info[i, a, 1] * e[1] + info[i, a, 2] * e[2]
        square = along[0] * e[0] + along[1] * e[1] + along[2] * e[2]
        if not square > 0.0:
            continue
        rate = (along[0] * w[i, 0] + along[1] * w[i, 1] + along[2] * w[i, 2]) / square
        forwards[i] = rate * np.sqrt(square)
        for a in range(3):
            rest[a] = w[i, a] - rate * e[a]
        for a in range(3):
            chi2[i] += rest[a] * (info[i, a, 0] * rest[0] + info[i, a, 1] * rest[1] + info[i, a, 2] * rest[2])
        weight = 1.0 / (1.0 + chi2[i] / (_CAUCHY_SIGMAS * _CAUCHY_SIGMAS))
        # The residual rest follows e by -rate (I - e along' / square): its information, projected onto the tangents.
        for j in range(2):
            mean = (along[0] * basis[0, j] + along[1] * basis[1, j] + along[2] * basis[2, j]) / square
            for a in range(3):
                row[j, a] = -rate * (basis[a, j] - e[a] * mean)
        for j in range(2):
            for a in range(3):
                pull = info[i, a, 0] * row[j, 0] + info[i, a, 1] * row[j, 1] + info[i, a, 2] * row[j, 2]
                score[j] += weight * pull * rest[a]
                for k in range(2):
                    normal[j, k] += weight * pull * row[k, a]
                for k in range(n_shared):
                    mixed[j, k] += weight * pull * shared[i, a, k]
    return normal, score, mixed, chi2, forwards
