"""Bundle adjustment of a static scene whose camera has an unknown focal length.

Everything at once by maximum likelihood: how the camera turned and moved from frame to frame, where the points are, and
the focal length that makes all views agree. Own motion from two views knows next to nothing of the focal length when
it goes along the optical axis, which is what cars do; over many frames the depths of the points have to agree as well.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ttcvid.geometry.bundle_normals import N_POSE, N_SHARED, bundle_cost, bundle_normals, carry
from ttcvid.geometry.rotation import normalize, rotation_from_vector, tangent_basis
from ttcvid.model import Bools, Floats, Ints

# Levenberg and Marquardt's damping: at first, its change after a good and after a bad step, and where it gives up.
_DAMPING, _LESS, _MORE, _MOST_DAMPING = 1e-3, 0.125, 6.0, 1e6
# A step that lowers the cost by less than this part is the last one.
_CONVERGED = 1e-6
# Longest step of log f.
_LONGEST_STEP = 0.2
# Added to what the observations do not tell: the scale, a point seen in one direction only.
_TINY, _TINIEST = 1e-9, 1e-12
# A distance may be negative by noise: so many px of displacement over the typical translation.
_BEHIND_PX = 1.0
# Median length of a 2-D Gaussian vector in sigmas.
_MEDIAN_RAYLEIGH = 1.1774


@dataclass(frozen=True)
class Views:
    """M observations of N points in J frames: ``xy_px (M, 2)`` from the centre of the picture, ``frame, point (M,)``.

    ``region (N,)`` numbers the parts of the picture whose points err together.
    """

    xy_px: Floats
    frame: Ints
    point: Ints
    region: Ints

    @property
    def n_frames(self) -> int:
        """Number of frames."""
        return int(self.frame.max()) + 1

    @property
    def n_points(self) -> int:
        """Number of points."""
        return len(self.region)


@dataclass(frozen=True)
class Bundle:
    """Frames and points: ``rotation (J, 3, 3)``, ``translation (J, 3)``, unit ``ray (N, 3)``, ``inverse (N,)``
    distance over the typical translation, and ``shared (4,)``: log focal length in px, principal point from the centre
    in px, radial distortion.
    """

    rotation: Floats
    translation: Floats
    ray: Floats
    inverse: Floats
    shared: Floats


@dataclass(frozen=True)
class BundleFit:
    """``cost`` in sigmas squared of ``sigma_px``; ``residual (M, 2)`` likewise, inf for what lies behind a camera.

    ``log_focal_sigma`` is the standard deviation of log f with everything else unknown, from the scatter between parts
    of the picture and never below what independent noise gives; ``behind (N,)`` marks points that are significantly
    behind all cameras, which cannot be.
    """

    bundle: Bundle
    cost: float
    residual: Floats
    log_focal_sigma: float
    behind: Bools

    @property
    def spread(self) -> float:
        """Robust standard deviation of a coordinate, in sigmas."""
        length = np.hypot(self.residual[:, 0], self.residual[:, 1])
        return float(np.median(length)) / _MEDIAN_RAYLEIGH


@dataclass(frozen=True)
class _Equations:
    """Gauss-Newton's equations as `bundle_normals` fills them."""

    pose_hessian: Floats
    pose_gradient: Floats
    mixed: Floats
    point_hessian: Floats
    point_gradient: Floats
    score: Floats


def adjust_bundle(
    views: Views,
    start: Bundle,
    sigma_px: float,
    shared_mean: Floats,
    shared_sigma: Floats,
    n_steps: int,
    *,
    can_move: bool = True,
) -> BundleFit:
    """Robust Gauss-Newton with Levenberg-Marquardt damping from ``start``.

    Parameters
    ----------
    sigma_px : noise of a coordinate.
    shared_mean, shared_sigma : (4,) Gaussian prior of `Bundle.shared`; a sigma of zero holds the value.
    can_move : False for a camera that only turns; ``start`` then has neither translations nor inverse distances.
    """
    bundle = _scaled(start)
    reference = views.n_frames // 2
    is_free = np.ones(N_POSE * views.n_frames + N_SHARED, dtype=bool)
    is_free[N_POSE * reference : N_POSE * (reference + 1)] = False
    is_free[:-N_SHARED].reshape(-1, N_POSE)[:, 3:] &= can_move
    is_free[-N_SHARED:] = shared_sigma > 0.0
    precision = np.divide(1.0, shared_sigma**2, out=np.zeros(N_SHARED), where=shared_sigma > 0.0)

    def cost_of(candidate: Bundle) -> tuple[float, Floats]:
        cost, residual = _cost(views, candidate, sigma_px)
        return cost + float(precision @ (candidate.shared - shared_mean) ** 2), residual

    cost, residual = cost_of(bundle)
    damping, is_done = _DAMPING, False
    for _ in range(n_steps):
        equations = _equations(views, bundle, sigma_px, residual, shared_mean, precision)
        while True:
            candidate = _stepped(bundle, equations, damping, is_free)
            lower = cost_of(candidate)[0]
            if lower < cost or damping > _MOST_DAMPING:
                break
            damping *= _MORE
        if not lower < cost:
            break
        is_done = cost - lower < _CONVERGED * cost
        bundle = _scaled(candidate)
        cost, residual = cost_of(bundle)
        damping = max(damping * _LESS, _TINY)
        if is_done:
            break
    equations = _equations(views, bundle, sigma_px, residual, shared_mean, precision)
    log_focal_sigma, behind = _uncertainty(views, bundle, equations, is_free)
    return BundleFit(bundle, cost, residual, log_focal_sigma, behind)


def _cost(views: Views, bundle: Bundle, sigma_px: float) -> tuple[float, Floats]:
    residual = np.empty((len(views.frame), 2))
    cost = bundle_cost(
        views.xy_px,
        views.frame,
        views.point,
        bundle.rotation,
        bundle.translation,
        bundle.ray,
        bundle.inverse,
        bundle.shared,
        sigma_px,
        _inverse_sigma(bundle),
        residual,
    )
    return cost, residual


def _inverse_sigma(bundle: Bundle) -> float:
    """The translations are of length one: what displaces a point by some px."""
    return _BEHIND_PX / float(np.exp(bundle.shared[0]))


def _equations(
    views: Views, bundle: Bundle, sigma_px: float, residual: Floats, shared_mean: Floats, precision: Floats
) -> _Equations:
    """The normal equations of all unknowns at a bundle, with the prior of the shared ones."""
    n, k = views.n_points, N_POSE * views.n_frames + N_SHARED
    equations = _Equations(
        np.empty((k, k)), np.empty(k), np.empty((k, n, 3)), np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, k))
    )
    bundle_normals(
        views.frame,
        views.point,
        bundle.rotation,
        bundle.translation,
        bundle.ray,
        tangent_basis(bundle.ray),
        bundle.inverse,
        bundle.shared,
        sigma_px,
        _inverse_sigma(bundle),
        residual,
        equations.pose_hessian,
        equations.pose_gradient,
        equations.mixed,
        equations.point_hessian,
        equations.point_gradient,
        equations.score,
    )
    shared = np.arange(k - N_SHARED, k)
    equations.pose_hessian[shared, shared] += precision
    equations.pose_gradient[shared] -= precision * (bundle.shared - shared_mean)
    return equations


def _reduced(equations: _Equations, damping: float) -> tuple[Floats, Floats, Floats]:
    """The Schur complement (K, K) of the points, ``mixed`` times their inverse (K, N, 3), and that inverse."""
    diagonal = np.arange(3)
    hessian = equations.point_hessian.copy()
    hessian[:, diagonal, diagonal] *= 1.0 + damping + _TINY
    hessian[:, diagonal, diagonal] += _TINY
    inverse: Floats = np.linalg.inv(hessian).astype(np.float64)
    carried = np.empty_like(equations.mixed)
    carry(equations.mixed, inverse, carried)
    n_unknowns = len(carried)
    schur: Floats = equations.pose_hessian - carried.reshape(n_unknowns, -1) @ equations.mixed.reshape(n_unknowns, -1).T
    return schur, carried, inverse


def _stepped(bundle: Bundle, equations: _Equations, damping: float, is_free: Bools) -> Bundle:
    """The bundle after one damped (Levenberg-Marquardt) step; poses and shared unknowns that are not free stay."""
    schur, carried, inverse = _reduced(equations, damping)
    gradient = equations.pose_gradient - np.einsum("kna,na->k", carried, equations.point_gradient)
    damped = schur + np.diag(damping * np.diag(equations.pose_hessian) + _TINY)
    step = np.zeros(len(gradient))
    step[is_free] = np.linalg.solve(damped[np.ix_(is_free, is_free)], gradient[is_free])
    towards = equations.point_gradient - np.einsum("kna,k->na", equations.mixed, step)
    by_point = np.einsum("nab,nb->na", inverse, towards)
    by_frame = step[:-N_SHARED].reshape(-1, N_POSE)
    by_shared = step[-N_SHARED:]
    by_shared[0] = np.clip(by_shared[0], -_LONGEST_STEP, _LONGEST_STEP)
    turned = np.einsum("nab,nb->na", tangent_basis(bundle.ray), by_point[:, :2])
    return Bundle(
        rotation_from_vector(by_frame[:, :3]) @ bundle.rotation,
        bundle.translation + by_frame[:, 3:],
        normalize(bundle.ray + turned),
        bundle.inverse + by_point[:, 2],
        bundle.shared + by_shared,
    )


def _scaled(bundle: Bundle) -> Bundle:
    """The same with translations of length one in the mean: nothing tells the scale."""
    length = float(np.sqrt(np.mean(np.sum(bundle.translation**2, axis=1))))
    if length < _TINY:
        return bundle
    return replace(bundle, translation=bundle.translation / length, inverse=bundle.inverse * length)


def _uncertainty(views: Views, bundle: Bundle, equations: _Equations, is_free: Bools) -> tuple[float, Bools]:
    """Standard deviation of log f, and the points that are behind by more than three sigmas.

    The scores of log f, freed of what all other unknowns explain of them, are summed within a part of the picture
    before they are squared (a cluster-robust "sandwich"): neighbouring points err together, and a track errs the same
    way for long.
    """
    schur, carried, inverse = _reduced(equations, 0.0)
    behind = np.asarray(bundle.inverse < -3.0 * np.sqrt(inverse[:, 2, 2]))
    focal = len(schur) - N_SHARED
    others = np.flatnonzero(is_free & (np.arange(len(schur)) != focal))
    # The scale stays undetermined: the shortest of all solutions.
    explained = np.linalg.lstsq(schur[np.ix_(others, others)], schur[others, focal], rcond=_TINIEST)[0]
    information = float(schur[focal, focal] - explained @ schur[others, focal])
    if not (is_free[focal] and information > 0.0):
        return np.inf, behind
    scores = equations.score - np.einsum("kna,na->nk", carried, equations.point_gradient)
    scores = scores[:, focal] - scores[:, others] @ explained
    sums = np.bincount(views.region, scores)
    n_regions = len(np.unique(views.region))
    if n_regions < 2:
        return np.inf, behind
    sandwich = float(np.sum(sums**2)) * n_regions / (n_regions - 1) / information**2
    return float(np.sqrt(max(sandwich, 1.0 / information))), behind
