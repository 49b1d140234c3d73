"""The direction of motion shared by the points of one translating object, from the states of whole tracks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.geometry.medians import medians
from ttcvid.geometry.rotation import cross, tangent_basis
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
# The inverse of a symmetric 2 x 2 matrix is this, times it turned by 180 deg, over its determinant.
_ADJUGATE_SIGNS = np.array([[1.0, -1.0], [-1.0, 1.0]])


@dataclass(frozen=True)
class _Points:
    """M points that say something, those of each of K things side by side: ``first (K,)`` is the first of each.

    ``w (M, 3)`` and ``info (M, 3, 3)`` as of `shared_directions`, ``thing (M,)`` from 0 to K - 1.
    """

    w: Floats
    info: Floats
    thing: Ints
    first: Ints

    def sums(self, values: Floats) -> Floats:
        """Sums (K, ...) of ``values (M, ...)`` over the points of each thing."""
        return np.asarray(np.add.reduceat(values, self.first, axis=0))


@dataclass(frozen=True)
class _Misfit:
    """How M points fit the direction of their thing, and how that follows two tangent coordinates of it.

    ``rate (M,)`` with its inverse standard deviation ``root_info (M,)``, ``chi2 (M,)``; ``off (M, 3)`` information
    times residual; ``weighted (M,)`` the rate times the robust weight; ``by_tangent (M, 3, 2)`` the information that
    is left of w where the rate follows, times each tangent.
    """

    rate: Floats
    root_info: Floats
    chi2: Floats
    off: Floats
    weighted: Floats
    by_tangent: Floats


def shared_directions(
    xy: Floats, velocity_hz: Floats, info_w: Floats, thing: Ints, n_things: int, by_shared: Floats | None = None
) -> tuple[Floats, Floats, Floats]:
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

    Source: DESIGN section 3 (w_i = s_i e with one shared e).

    >>> xy, w = np.array([[0.1, 0.0], [0.0, 0.2]]), np.array([[0.0, 0.0, -1.0], [0.0, 0.0, -0.5]])
    >>> shared_directions(xy, w, np.broadcast_to(np.eye(3) * 1e4, (2, 3, 3)), np.array([0, 0]), 1)[0].round(9) + 0.0
    array([[ 0.,  0., -1.]])
    """
    direction, covariance = np.full((n_things, 3), np.nan), np.full((n_things, 3, 3), np.nan)
    chi2 = np.zeros(len(velocity_hz))
    is_usable = np.isfinite(velocity_hz).all(axis=1) & (np.trace(info_w, axis1=1, axis2=2) > 0.0)
    usable = np.flatnonzero(is_usable)
    usable = usable[np.argsort(thing[usable], kind="stable")]
    if not len(usable):
        return direction, covariance, chi2
    told, first, of_told, count = np.unique(thing[usable], return_index=True, return_inverse=True, return_counts=True)
    points = _Points(velocity_hz[usable], info_w[usable], of_told, first)
    errors = np.zeros((len(usable), 3, 0)) if by_shared is None else by_shared[usable]
    # Where points say nothing across the direction, what is divided by is zero, and the covariance is not finite.
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        e, basis, misfit, adjugate, determinant = _descend(points, _start(points, xy[usable]))
        off = points.sums(np.minimum(misfit.chi2, _CAUCHY_SIGMAS**2))
        widened = np.maximum(off / np.maximum(2 * count - 2, 1), 1.0) / determinant
        mixed = points.sums(misfit.weighted[:, None, None] * (misfit.by_tangent.transpose(0, 2, 1) @ errors))
        by_errors = basis @ adjugate @ mixed / determinant[:, None, None]
        spread = widened[:, None, None] * (basis @ adjugate @ basis.transpose(0, 2, 1))
        covariance[told] = spread + by_errors @ by_errors.transpose(0, 2, 1)
    # The fit knows a line; in which sense the points move along it, they vote.
    votes = points.sums(np.clip(misfit.rate * misfit.root_info, -_MAX_VOTE_SIGMAS, _MAX_VOTE_SIGMAS))
    direction[told] = np.where(votes < 0.0, -1.0, 1.0)[:, None] * e
    chi2[usable] = misfit.chi2
    return direction, covariance, chi2


def _descend(points: _Points, e: Floats) -> tuple[Floats, Floats, _Misfit, Floats, Floats]:
    """Gauss-Newton from ``e (K, 3)``: where it ends, its tangents, the points there, and its normal matrices.

    Of these (K, 2, 2), the inverse is adjugate over determinant.
    """
    is_converged = np.zeros(len(e), dtype=bool)
    for step in range(_MAX_STEPS + 1):
        basis = tangent_basis(e)
        misfit = _misfit(points, e, basis)
        towards = np.concatenate([misfit.rate[:, None, None] * misfit.by_tangent, misfit.off[..., None]], axis=2)
        towards = basis[points.thing].transpose(0, 2, 1) @ towards
        equations = points.sums(misfit.weighted[:, None, None] * towards)
        normal, score = equations[..., :2], equations[..., 2]
        normal[:, [0, 1], [0, 1]] += _RIDGE * (normal[:, 0, :1] + normal[:, 1, 1:] + 1e-300)
        adjugate = normal[:, ::-1, ::-1] * _ADJUGATE_SIGNS
        determinant = normal[:, 0, 0] * normal[:, 1, 1] - normal[:, 0, 1] ** 2
        if is_converged.all() or step == _MAX_STEPS:
            break
        change = (adjugate @ score[..., None])[..., 0] / determinant[:, None]
        change[is_converged] = 0.0
        is_converged |= np.sum(change * score, axis=1) < _CONVERGED_CHI2
        length = np.sqrt(np.sum(change**2, axis=1, keepdims=True))
        change *= np.minimum(_LONGEST_STEP_RAD / np.maximum(length, 1e-300), 1.0)
        e = e + (basis @ change[..., None])[..., 0]
        e /= np.sqrt(np.sum(e**2, axis=1, keepdims=True))
    return e, basis, misfit, adjugate, determinant


def _misfit(points: _Points, e: Floats, basis: Floats) -> _Misfit:
    """The points with the directions ``e (K, 3)`` and tangents ``basis (K, 3, 2)`` of their things.

    The best rate of a point is ``s = e' info w / e' info e``. Its residual r = w - s e follows e by
    ``-s (I - e e' info / e' info e)``: with info e r = 0, the score along a tangent b is s b' info r, and the
    information on two tangents b, c is s^2 (b' info c - (b' info e)(c' info e) / e' info e).
    """
    e, basis = e[points.thing], basis[points.thing]
    pull = (points.info @ e[..., None])[..., 0]
    info_rate = np.sum(pull * e, axis=1)
    # Where a point says nothing of its rate, it says nothing.
    is_told = info_rate > 0.0
    inverse = np.divide(1.0, info_rate, out=np.zeros(len(e)), where=is_told)
    rate = np.sum(pull * points.w, axis=1) * inverse
    residual = points.w - rate[:, None] * e
    off = (points.info @ residual[..., None])[..., 0]
    chi2 = np.where(is_told, np.sum(residual * off, axis=1), 0.0)
    by_tangent = points.info @ basis - pull[..., None] * (inverse[:, None, None] * (pull[:, None] @ basis))
    weighted = rate / (1.0 + chi2 / _CAUCHY_SIGMAS**2)
    return _Misfit(rate, np.sqrt(np.maximum(info_rate, 0.0)), chi2, off, weighted, by_tangent)


def _start(points: _Points, xy: Floats) -> Floats:
    """The better of two guesses for each thing, ``(K, 3)``, by the median misfit of its points.

    The main axis of their velocities, each counted by how well it is known; and where the lines meet along which they
    move in the picture. Of single tracks the former knows little: brakes are taken for depth, which turns the velocity
    of each point towards its own ray, so that the descent ended in a minimum near the thing itself. The lines stay.
    """
    # The line is normal to the ray of the point and to its velocity.
    across = cross(np.column_stack([xy, np.ones(len(xy))]), points.w)
    lines, spread = (
        points.sums(weight[:, None, None] * v[:, :, None] * v[:, None])
        for v in (across, points.w)
        for weight in [np.einsum("ni,nij,nj->n", v, points.info, v) / np.maximum(np.sum(v * v, axis=1), 1e-300)]
    )
    guesses = np.linalg.eigh(lines)[1][..., 0], np.linalg.eigh(spread)[1][..., 2]
    by_lines, by_velocity = (
        medians(_misfit(points, guess, tangent_basis(guess)).chi2, points.thing, len(points.first)) for guess in guesses
    )
    return np.where((by_velocity <= by_lines)[:, None], guesses[1], guesses[0])
