"""The direction of motion that the points of one translating thing share, from the states of their whole tracks."""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled
from ttcvid.model import Floats, Ints

# A point off by more sigmas than this loses weight (Cauchy).
_CAUCHY_SIGMAS = 3.0
# Gauss-Newton ends after so many steps, or after one shorter than this (squared, in sigmas of the direction).
_MAX_STEPS, _CONVERGED_CHI2 = 12, 1e-3
# In the vote on the sense a point counts at most this many sigmas.
_MAX_VOTE_SIGMAS = 3.0
# A step is cut to this length.
_LONGEST_STEP_RAD = 0.3
# What keeps the normal matrix of points that say nothing from being singular, as a part of its trace.
_RIDGE = 1e-12
# The main axis is the first column of the matrix to the power of 2 to this.
_SQUARINGS = 6


def shared_directions(
    velocity_hz: Floats, info_w: Floats, thing: Ints, n_things: int, by_shared: Floats | None = None
) -> tuple[Floats, Floats, Floats]:
    """Maximum-likelihood ``dir`` of K things whose points move alike, each at its own rate: w_i = s_i e.

    Minimises ``sum rho(min_s (w_i - s e)' info_i (w_i - s e))`` over the sphere, Cauchy's rho; chi-square with two
    degrees of freedom a point. Where the points fit worse than their noise allows, the covariance is widened by that.

    Parameters
    ----------
    velocity_hz, info_w : (N, 3) and (N, 3, 3) of `whole_track.WholeTracks`: (a, b, c) and its information, in s^2.
    thing : (N,) which of the ``n_things`` K each point belongs to, from 0.
    by_shared : (N, 3, E) what one standard deviation of each of E errors that all points share does to w; None: none.

    Returns
    -------
    direction : (K, 3) unit vectors, NaN where no point says anything.
    covariance : (K, 3, 3) in the tangent plane of each, rad^2.
    chi2 : (N,) of each point.

    Source: DESIGN section 3 (w_i = s_i e with one shared e).

    >>> w = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, -0.5]])
    >>> shared_directions(w, np.broadcast_to(np.eye(3) * 1e4, (2, 3, 3)), np.array([0, 0]), 1)[0].round(9) + 0.0
    array([[ 0.,  0., -1.]])
    """
    n = len(velocity_hz)
    direction, covariance = np.full((n_things, 3), np.nan), np.full((n_things, 3, 3), np.nan)
    chi2 = np.zeros(n)
    order = np.argsort(thing, kind="stable")
    _fit_each(
        np.ascontiguousarray(velocity_hz),
        np.ascontiguousarray(info_w),
        np.zeros((n, 3, 0)) if by_shared is None else np.ascontiguousarray(by_shared),
        order,
        np.searchsorted(thing[order], np.arange(n_things + 1)),
        direction,
        covariance,
        chi2,
    )
    return direction, covariance, chi2


@compiled
def _fit_each(
    w: Floats,
    info: Floats,
    shared: Floats,
    order: Ints,
    start: Ints,
    direction: Floats,
    covariance: Floats,
    chi2: Floats,
) -> None:
    """Fill the results of `shared_directions`; the points of thing k are ``order[start[k] : start[k + 1]]``."""
    e, basis, errors = np.empty(3), np.empty((3, 2)), np.empty((3, shared.shape[2]))
    normal, score, mixed = np.empty((2, 2)), np.empty(2), np.empty((2, shared.shape[2]))
    for number in range(len(direction)):
        members = order[start[number] : start[number + 1]]
        if not _main_axis(w, info, members, e):
            continue
        votes, one, other, both, determinant, is_converged = 0.0, 0.0, 0.0, 0.0, 0.0, False
        for step in range(_MAX_STEPS + 1):
            _tangents(e, basis)
            n_shared = shared.shape[2] if is_converged or step == _MAX_STEPS else 0
            votes = _add_up(w, info, shared, n_shared, members, e, basis, normal, score, mixed, chi2)
            ridge = _RIDGE * (normal[0, 0] + normal[1, 1] + 1e-300)
            one, other, both = normal[0, 0] + ridge, normal[1, 1] + ridge, normal[0, 1]
            determinant = one * other - both * both
            if is_converged or step == _MAX_STEPS:
                break
            p = (other * score[0] - both * score[1]) / determinant
            q = (one * score[1] - both * score[0]) / determinant
            is_converged = p * score[0] + q * score[1] < _CONVERGED_CHI2
            cut = min(1.0, _LONGEST_STEP_RAD / max(np.sqrt(p * p + q * q), 1e-300))
            for a in range(3):
                e[a] += cut * (p * basis[a, 0] + q * basis[a, 1])
            length = np.sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2])
            for a in range(3):
                e[a] /= length
        off, n_usable = 0.0, 0
        for i in members:
            if _is_usable(w, info, i):
                off += min(chi2[i], _CAUCHY_SIGMAS * _CAUCHY_SIGMAS)
                n_usable += 1
        widened = max(off / max(2 * n_usable - 2, 1), 1.0) / determinant
        for a in range(3):
            to_p = (basis[a, 0] * other - basis[a, 1] * both) / determinant
            to_q = (basis[a, 1] * one - basis[a, 0] * both) / determinant
            for k in range(shared.shape[2]):
                errors[a, k] = to_p * mixed[0, k] + to_q * mixed[1, k]
        for a in range(3):
            for b in range(3):
                value = widened * (
                    other * basis[a, 0] * basis[b, 0]
                    + one * basis[a, 1] * basis[b, 1]
                    - both * (basis[a, 0] * basis[b, 1] + basis[a, 1] * basis[b, 0])
                )
                for k in range(shared.shape[2]):
                    value += errors[a, k] * errors[b, k]
                covariance[number, a, b] = value
        for a in range(3):
            # The fit knows a line; in which sense the points move along it, they vote.
            direction[number, a] = -e[a] if votes < 0.0 else e[a]


@compiled
def _is_usable(w: Floats, info: Floats, i: int) -> bool:
    """Whether a point says anything."""
    # A sum is finite where all of its terms are.
    has_velocity: bool = np.isfinite(w[i, 0] + w[i, 1] + w[i, 2])
    return has_velocity and info[i, 0, 0] + info[i, 1, 1] + info[i, 2, 2] > 0.0


@compiled
def _main_axis(w: Floats, info: Floats, members: Ints, e: Floats) -> bool:
    """Fill ``e`` with the main axis of the velocities, each counted by how well it is known; False without any."""
    spread, square, found = np.zeros((3, 3)), np.empty((3, 3)), False
    for i in members:
        if not _is_usable(w, info, i):
            continue
        found = True
        known, length2 = 0.0, 1e-300
        for a in range(3):
            length2 += w[i, a] * w[i, a]
            for b in range(3):
                known += w[i, a] * info[i, a, b] * w[i, b]
        for a in range(3):
            for b in range(3):
                spread[a, b] += known / length2 * w[i, a] * w[i, b]
    for _ in range(_SQUARINGS):
        scale = 1.0 / max(spread[0, 0] + spread[1, 1] + spread[2, 2], 1e-300)
        for a in range(3):
            for b in range(3):
                square[a, b] = (
                    spread[a, 0] * spread[0, b] + spread[a, 1] * spread[1, b] + spread[a, 2] * spread[2, b]
                ) * (scale * scale)
        spread, square = square, spread
    best = 0
    for a in range(1, 3):
        best = a if spread[a, a] > spread[best, best] else best
    x, y, z = spread[best, 0], spread[best, 1], spread[best, 2]
    length = np.sqrt(x * x + y * y + z * z)
    if length > 0.0:
        e[0], e[1], e[2] = x / length, y / length, z / length
    else:
        e[0], e[1], e[2] = 0.0, 0.0, 1.0
    return found


@compiled
def _tangents(e: Floats, basis: Floats) -> None:
    """Fill ``basis (3, 2)`` with two unit vectors normal to ``e`` and to each other.

    Not those of `rotation.tangent_basis`: any will do here, and `_add_up` and `_fit_each` use one and the same.
    """
    least = 0
    for a in range(1, 3):
        least = a if abs(e[a]) < abs(e[least]) else least
    after, last = (least + 1) % 3, (least + 2) % 3
    length = np.sqrt(e[after] * e[after] + e[last] * e[last])
    basis[least, 0], basis[after, 0], basis[last, 0] = 0.0, -e[last] / length, e[after] / length
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        basis[a, 1] = e[b] * basis[c, 0] - e[c] * basis[b, 0]


@compiled
def _add_up(
    w: Floats,
    info: Floats,
    shared: Floats,
    n_shared: int,
    members: Ints,
    e: Floats,
    basis: Floats,
    normal: Floats,
    score: Floats,
    mixed: Floats,
    chi2: Floats,
) -> float:
    """Fill normal matrix (2, 2), score (2,), its change by the first ``n_shared`` errors, ``chi2``; returns the vote.

    The best rate of a point is ``s = e' info w / e' info e``. Its residual r = w - s e follows e by
    ``-s (I - e e' info / e' info e)``: with info e r = 0, the score along a tangent b is s b' info r, and the
    information on two tangents b, c is s^2 (b' info c - (b' info e)(c' info e) / e' info e).
    """
    normal[:] = 0.0
    score[:] = 0.0
    mixed[:] = 0.0
    votes = 0.0
    along, off, pull = np.empty(3), np.empty(3), np.empty((2, 3))
    for i in members:
        chi2[i] = 0.0
        if not _is_usable(w, info, i):
            continue
        for a in range(3):
            along[a] = info[i, a, 0] * e[0] + info[i, a, 1] * e[1] + info[i, a, 2] * e[2]
        square = along[0] * e[0] + along[1] * e[1] + along[2] * e[2]
        if not square > 0.0:
            continue
        rate = (along[0] * w[i, 0] + along[1] * w[i, 1] + along[2] * w[i, 2]) / square
        votes += min(max(rate * np.sqrt(square), -_MAX_VOTE_SIGMAS), _MAX_VOTE_SIGMAS)
        x, y, z = w[i, 0] - rate * e[0], w[i, 1] - rate * e[1], w[i, 2] - rate * e[2]
        for a in range(3):
            off[a] = info[i, a, 0] * x + info[i, a, 1] * y + info[i, a, 2] * z
        chi2[i] = x * off[0] + y * off[1] + z * off[2]
        weight = 1.0 / (1.0 + chi2[i] / (_CAUCHY_SIGMAS * _CAUCHY_SIGMAS))
        for j in range(2):
            mean = (along[0] * basis[0, j] + along[1] * basis[1, j] + along[2] * basis[2, j]) / square
            for a in range(3):
                pull[j, a] = (
                    info[i, a, 0] * basis[0, j] + info[i, a, 1] * basis[1, j] + info[i, a, 2] * basis[2, j]
                ) - mean * along[a]
            score[j] += weight * rate * (off[0] * basis[0, j] + off[1] * basis[1, j] + off[2] * basis[2, j])
            for k in range(n_shared):
                mixed[j, k] += (
                    weight
                    * rate
                    * (pull[j, 0] * shared[i, 0, k] + pull[j, 1] * shared[i, 1, k] + pull[j, 2] * shared[i, 2, k])
                )
            for k in range(j + 1):
                normal[j, k] += (
                    weight
                    * rate
                    * rate
                    * (pull[j, 0] * basis[0, k] + pull[j, 1] * basis[1, k] + pull[j, 2] * basis[2, k])
                )
    normal[0, 1] = normal[1, 0]
    return votes
