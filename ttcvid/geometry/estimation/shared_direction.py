"""The direction of motion shared by the points of one translating object, from the states of whole tracks."""

from __future__ import annotations

import numpy as np

from ttcvid.compiled import compiled_for
from ttcvid.geometry.kernels.medians import median
from ttcvid.geometry.kernels.rotations import fill_tangents
from ttcvid.geometry.rotation import cross
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


def shared_directions(
    xy: Floats, velocity_hz: Floats, info_w: Floats, thing: Ints, n_things: int, by_shared: Floats | None = None
) -> tuple[Floats, Floats, Floats, Floats]:
    """Maximum-likelihood ``dir`` of K things whose points move alike, each at its own rate: w_i = s_i e.

    Minimises ``sum rho(min_s (w_i - s e)' info_i (w_i - s e))`` over the sphere, Cauchy's rho; chi-square with two
    degrees of freedom a point. Where the points fit worse than their noise allows, the covariance is widened by that.

    Parameters
    ----------
    xy : (N, 2) where the points are: the lines along which they move say where to begin.
    velocity_hz, info_w : (N, 3) and (N, 3, 3) of `track_state.WholeTracks`: (a, b, c) and its information, in s^2.
    thing : (N,) which of the ``n_things`` K each point belongs to, from 0.
    by_shared : (N, 3, E) what one standard deviation of each of E errors that all points share does to w; None: none.

    Returns
    -------
    direction : (K, 3) unit vectors, NaN where no point says anything.
    covariance : (K, 3, 3) in the tangent plane of each, rad^2.
    chi2 : (N,) of each point.
    by_errors : (K, 3, E) what one standard deviation of each error does to the direction, part of its covariance.

    Source: DESIGN section 3 (w_i = s_i e with one shared e).

    >>> xy, w = np.array([[0.1, 0.0], [0.0, 0.2]]), np.array([[0.0, 0.0, -1.0], [0.0, 0.0, -0.5]])
    >>> shared_directions(xy, w, np.broadcast_to(np.eye(3) * 1e4, (2, 3, 3)), np.array([0, 0]), 1)[0].round(9) + 0.0
    array([[ 0.,  0., -1.]])
    """
    n_errors = 0 if by_shared is None else by_shared.shape[2]
    direction, told_of = np.full((n_things, 3), np.nan), np.full((n_things, 3, 3 + n_errors), np.nan)
    covariance, by_errors, chi2 = told_of[..., :3], told_of[..., 3:], np.zeros(len(velocity_hz))
    is_usable = np.isfinite(velocity_hz).all(axis=1) & (np.einsum("nii->n", info_w) > 0.0)
    usable = np.flatnonzero(is_usable)
    usable = usable[np.argsort(thing[usable], kind="stable")]
    if not len(usable):
        return direction, covariance, chi2, by_errors
    n_points = np.bincount(thing[usable], minlength=n_things)
    told = np.flatnonzero(n_points)
    first = np.append(0, np.cumsum(n_points[told]))
    w, info, of_each = velocity_hz[usable], info_w[usable], np.empty(len(usable))
    errors = np.zeros((len(usable), 3, 0)) if by_shared is None else by_shared[usable]
    found, spread = np.empty((len(told), 3)), np.empty((len(told), 3, 3 + n_errors))
    _fit_each((w, info, errors), first, _guesses(xy[usable], w, info, first[:-1]), found, spread, of_each)
    direction[told], told_of[told], chi2[usable] = found, spread, of_each
    return direction, covariance, chi2, by_errors


def _guesses(xy: Floats, w: Floats, info: Floats, first: Ints) -> Floats:
    """Two guesses for each thing, ``(K, 2, 3)``: where the lines meet along which its points move in the picture, and
    the main axis of their velocities, each counted by how well it is known.

    Of single tracks the latter knows little: brakes are taken for depth, which turns the velocity of each point towards
    its own ray, so that the descent ended in a minimum near the thing itself. The lines stay.
    """
    # The line is normal to the ray of the point and to its velocity.
    v = np.stack([cross(np.column_stack([xy, np.ones(len(xy))]), w), w])
    weight = np.einsum("vni,nij,vnj->vn", v, info, v) / np.maximum(np.einsum("vni,vni->vn", v, v), 1e-300)
    sums = np.add.reduceat(weight[..., None, None] * v[..., None] * v[:, :, None], first, axis=1)
    lines, spread = np.linalg.eigh(sums)[1]
    return np.stack([lines[..., 0], spread[..., 2]], axis=1)


@compiled_for(
    "(Tuple((f8[:, ::1], f8[:, :, ::1], f8[:, :, ::1])), i8[::1], f8[:, :, ::1], f8[:, ::1], f8[:, :, ::1], f8[::1])"
)
def _fit_each(
    points: tuple[Floats, Floats, Floats], first: Ints, guesses: Floats, found: Floats, spread: Floats, chi2: Floats
) -> None:
    """Gauss-Newton from the better of two ``guesses (K, 2, 3)``, by the median misfit of each thing's points.

    Fills ``found (K, 3)``, ``spread (K, 3, 3 + E)``, covariance and by_errors, and ``chi2 (M,)`` of
    `shared_directions`, for M ``points``, w, info_w and by_shared, those of each thing side by side from
    ``first (K + 1,)``.

    The best rate of a point is ``s = e' info w / e' info e``. Its residual r = w - s e follows e by
    ``-s (I - e e' info / e' info e)``: with info e r = 0, the score along a tangent b is s b' info r, and the
    information on two tangents b, c is s^2 (b' info c - (b' info e)(c' info e) / e' info e).
    """
    w, info, errors = points
    e, pull, median_chi2, half = np.empty(3), np.empty(3), np.empty(2), np.empty((3, 2))
    # Two tangents and the residual, and the information on them that is left where the rate follows.
    n_columns = 3 + errors.shape[2]
    columns, told, equations = np.empty((3, 3)), np.empty((3, 3)), np.empty((2, n_columns))
    for k in range(len(found)):
        is_converged = False
        for step in range(-2, _MAX_STEPS + 1):
            if step <= 0:
                start = step + 2 if step < 0 else int(median_chi2[1] <= median_chi2[0])
                for a in range(3):
                    e[a] = guesses[k, start, a]
            fill_tangents(e[0], e[1], e[2], columns)
            votes, off = 0.0, 0.0
            for j in range(2):
                for c in range(n_columns):
                    equations[j, c] = 0.0
            for i in range(first[k], first[k + 1]):
                info_rate, rate = 0.0, 0.0
                for a in range(3):
                    pull[a] = info[i, a, 0] * e[0] + info[i, a, 1] * e[1] + info[i, a, 2] * e[2]
                    info_rate += pull[a] * e[a]
                    rate += pull[a] * w[i, a]
                # Where a point says nothing of its rate, it says nothing.
                is_told = info_rate > 0.0
                inverse = 1.0 / info_rate if is_told else 0.0
                rate *= inverse
                for a in range(3):
                    columns[a, 2] = w[i, a] - rate * e[a]
                chi2[i] = 0.0
                for a in range(3):
                    for c in range(3):
                        told[a, c] = 0.0
                        for b in range(3):
                            told[a, c] += (info[i, a, b] - inverse * pull[a] * pull[b]) * columns[b, c]
                    chi2[i] += columns[a, 2] * told[a, 2] if is_told else 0.0
                weighted = rate / (1.0 + chi2[i] / _CAUCHY_SIGMAS**2)
                for a in range(3):
                    for j in range(2):
                        for c in range(3):
                            equations[j, c] += weighted * (rate if c < 2 else 1.0) * columns[a, j] * told[a, c]
                        for c in range(3, n_columns):
                            equations[j, c] += weighted * told[a, j] * errors[i, a, c - 3]
                votes += min(max(rate * np.sqrt(max(info_rate, 0.0)), -_MAX_VOTE_SIGMAS), _MAX_VOTE_SIGMAS)
                off += min(chi2[i], _CAUCHY_SIGMAS**2)
            if step < 0:
                median_chi2[step + 2] = median(chi2[first[k] : first[k + 1]])
                continue
            ridge = _RIDGE * (equations[0, 0] + equations[1, 1] + 1e-300)
            n00, n01, n11 = equations[0, 0] + ridge, equations[0, 1], equations[1, 1] + ridge
            determinant = n00 * n11 - n01 * n01
            if is_converged or step == _MAX_STEPS:
                break
            one = (n11 * equations[0, 2] - n01 * equations[1, 2]) / determinant
            other = (n00 * equations[1, 2] - n01 * equations[0, 2]) / determinant
            is_converged = one * equations[0, 2] + other * equations[1, 2] < _CONVERGED_CHI2
            part = min(_LONGEST_STEP_RAD / max(np.sqrt(one * one + other * other), 1e-300), 1.0)
            for a in range(3):
                e[a] += part * (columns[a, 0] * one + columns[a, 1] * other)
            length = np.sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2])
            for a in range(3):
                e[a] /= length
        # Where points say nothing across the direction, what is divided by is zero, and the covariance is not finite.
        widened = max(off / max(2 * (first[k + 1] - first[k]) - 2, 1), 1.0)
        for a in range(3):
            # The fit knows a line; in which sense the points move along it, they vote.
            found[k, a] = -e[a] if votes < 0.0 else e[a]
            half[a, 0] = (columns[a, 0] * n11 - columns[a, 1] * n01) / determinant
            half[a, 1] = (columns[a, 1] * n00 - columns[a, 0] * n01) / determinant
        for a in range(3):
            for c in range(3, n_columns):
                spread[k, a, c] = half[a, 0] * equations[0, c] + half[a, 1] * equations[1, c]
        for a in range(3):
            for b in range(3):
                spread[k, a, b] = widened * (half[a, 0] * columns[b, 0] + half[a, 1] * columns[b, 1])
                for c in range(3, n_columns):
                    spread[k, a, b] += spread[k, a, c] * spread[k, b, c]
