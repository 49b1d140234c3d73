"""Bundle adjustment of a static scene whose camera has an unknown focal length.

Everything at once by maximum likelihood: how the camera turned and moved from frame to frame, where the points are, and
the focal length that makes all views agree. Own motion from two views knows next to nothing of the focal length when
it goes along the optical axis, which is what cars do; over many frames the depths of the points have to agree as well.

A point is a unit ray and an inverse distance in the axes of one frame; frame j sees it along R_j ray + inverse t_j. The
lens is u = f x (1 + k |x|^2) + c with x the point in the plane z = 1. The unknowns that frames hold come as
``K = 6 J + 4``: each frame's rotation vector and translation, then log f, c and k, which all share; those of a point
are two tangent coordinates of its ray and the inverse distance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ttcvid.geometry.rotation import cross, normalize, rotation_from_vector, tangent_basis
from ttcvid.model import Bools, Floats, Ints

N_SHARED, N_POSE = 4, 6
"""Numbers of the unknowns that all frames share, and of those of a frame."""

# Geman and McClure's cost: that of an outlier is limited to so many sigmas squared.
_CAP = 16.0
# A point nearer to the picture plane, or behind it, cannot be seen: it costs what an outlier costs.
_LEAST_DEPTH = 1e-3
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
    """Gauss-Newton's equations: ``pose_hessian (K, K)``, ``pose_gradient (K,)``, downhill, of what frames hold.

    ``mixed (K, N, 3)`` couples it with the points, of which ``point_hessian (N, 3, 3)`` and ``point_gradient (N, 3)``
    are; ``score (N, K)`` is the part of each point in the pose gradient.
    """

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
    """Robust cost of all observations and of negative distances; residuals (M, 2), inf where unseen."""
    seen = np.einsum("mab,mb->ma", bundle.rotation[views.frame], bundle.ray[views.point])
    seen += bundle.inverse[views.point, None] * bundle.translation[views.frame]
    is_ahead = seen[:, 2] >= _LEAST_DEPTH
    x = seen[:, :2] / np.where(is_ahead, seen[:, 2], 1.0)[:, None]
    bend = np.exp(bundle.shared[0]) * (1.0 + bundle.shared[3] * np.sum(x * x, axis=1))
    residual = (bend[:, None] * x + bundle.shared[1:3] - views.xy_px) / sigma_px
    residual[~is_ahead] = np.inf
    squares = np.append(np.sum(residual[is_ahead] ** 2, axis=1), _behind(bundle) ** 2)
    return float(np.sum(squares / (1.0 + squares / _CAP)) + _CAP * np.count_nonzero(~is_ahead)), residual


def _behind(bundle: Bundle) -> Floats:
    """By how many sigmas each distance is negative, (N,); 0 if it is not."""
    return np.asarray(np.minimum(bundle.inverse / _inverse_sigma(bundle), 0.0))


def _inverse_sigma(bundle: Bundle) -> float:
    """The translations are of length one: what displaces a point by some px."""
    return _BEHIND_PX / float(np.exp(bundle.shared[0]))


def _equations(
    views: Views, bundle: Bundle, sigma_px: float, residual: Floats, shared_mean: Floats, precision: Floats
) -> _Equations:
    """The normal equations of all unknowns at a bundle and the robust weights, with the prior of the shared ones."""
    n, k = views.n_points, N_POSE * views.n_frames + N_SHARED
    found = _Equations(
        np.zeros((k, k)), np.zeros(k), np.zeros((k, n, 3)), np.zeros((n, 3, 3)), np.zeros((n, 3)), np.zeros((n, k))
    )
    shared, is_seen, basis = np.arange(k - N_SHARED, k), np.isfinite(residual[:, 0]), tangent_basis(bundle.ray)
    for frame in range(views.n_frames):
        # A point is seen once in a frame.
        of_frame = np.flatnonzero((views.frame == frame) & is_seen)
        point, left = views.point[of_frame], residual[of_frame]
        by_pose, by_point = _derivatives(bundle, frame, point, basis[point], sigma_px)
        weight = (1.0 + np.sum(left**2, axis=1) / _CAP) ** -2.0
        place = np.append(np.arange(N_POSE * frame, N_POSE * (frame + 1)), shared)
        pose, own, pull = weight[:, None, None] * by_pose, weight[:, None, None] * by_point, weight[:, None] * left
        score = -(pull[:, None] @ by_pose)[:, 0]
        found.score[np.ix_(point, place)] += score
        found.pose_gradient[place] += score.sum(axis=0)
        found.pose_hessian[np.ix_(place, place)] += pose.reshape(-1, len(place)).T @ by_pose.reshape(-1, len(place))
        found.mixed[np.ix_(place, point)] += (pose.transpose(0, 2, 1) @ by_point).transpose(1, 0, 2)
        found.point_gradient[point] -= (pull[:, None] @ by_point)[:, 0]
        found.point_hessian[point] += own.transpose(0, 2, 1) @ by_point
    behind, sigma = _behind(bundle), _inverse_sigma(bundle)
    weight = np.where(behind < 0.0, (1.0 + behind**2 / _CAP) ** -2.0, 0.0) / sigma
    found.point_hessian[:, 2, 2] += weight / sigma
    found.point_gradient[:, 2] -= weight * behind
    found.pose_hessian[shared, shared] += precision
    found.pose_gradient[shared] -= precision * (bundle.shared - shared_mean)
    return found


def _derivatives(bundle: Bundle, frame: int, point: Ints, basis: Floats, sigma_px: float) -> tuple[Floats, Floats]:
    """How the m points of a frame move in the picture, in sigmas: by frame and shared ``(m, 2, 10)``, by own unknowns.

    The latter ``(m, 2, 3)``, along ``basis (m, 3, 2)``.
    """
    rotation, translation = bundle.rotation[frame], bundle.translation[frame]
    inverse, focal = bundle.inverse[point], float(np.exp(bundle.shared[0]))
    turned = bundle.ray[point] @ rotation.T
    seen = turned + inverse[:, None] * translation
    x = seen[:, :2] / seen[:, 2:]
    square = np.sum(x * x, axis=1)
    bend = 1.0 + bundle.shared[3] * square
    by_seen, by_pose = np.empty((len(point), 2, 3)), np.zeros((len(point), 2, N_POSE + N_SHARED))
    by_seen[..., :2] = bend[:, None, None] * np.eye(2) + 2.0 * bundle.shared[3] * x[:, :, None] * x[:, None]
    by_seen[..., :2] *= (focal / (seen[:, 2] * sigma_px))[:, None, None]
    by_seen[..., 2] = -np.einsum("mab,mb->ma", by_seen[..., :2], x)
    by_pose[..., :3] = cross(turned[:, None], by_seen)
    by_pose[..., 3:6] = by_seen * inverse[:, None, None]
    by_pose[..., 6], by_pose[..., 9] = (focal * x * each[:, None] / sigma_px for each in (bend, square))
    by_pose[:, 0, 7] = by_pose[:, 1, 8] = 1.0 / sigma_px
    return by_pose, np.concatenate([by_seen @ (rotation @ basis), (by_seen @ translation)[..., None]], axis=2)


def _reduced(equations: _Equations, damping: float) -> tuple[Floats, Floats, Floats]:
    """The Schur complement (K, K) of the points, ``mixed`` times their inverse (K, N, 3), and that inverse."""
    diagonal = np.arange(3)
    hessian = equations.point_hessian.copy()
    hessian[:, diagonal, diagonal] *= 1.0 + damping + _TINY
    hessian[:, diagonal, diagonal] += _TINY
    inverse: Floats = np.linalg.inv(hessian).astype(np.float64)
    carried = np.einsum("kna,nab->knb", equations.mixed, inverse)
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
