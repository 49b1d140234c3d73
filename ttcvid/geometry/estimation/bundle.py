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

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ttcvid.geometry.estimation.schur import EliminatedPoints, cross_of_rows, eliminated
from ttcvid.geometry.medians import MEDIAN_RAYLEIGH
from ttcvid.geometry.rotation import normalize, rotation_from_vector, tangent_basis
from ttcvid.model import Bools, Floats, Ints

N_SHARED, N_POSE = 4, 6
"""Numbers of the unknowns that all frames share, and of those of a frame."""
_N_VIEW, _N_POINT = N_POSE + N_SHARED, 3

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


@dataclass(frozen=True)
class Views:
    """M observations of N points in J frames: ``xy_px (M, 2)`` from the centre of the picture, ``frame, point (M,)``.

    ``region (N,)`` numbers the parts of the picture, two at least, whose points err together.
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
class _Equations:
    """Gauss-Newton's equations: ``pose_hessian (K, K)``, ``pose_gradient (K,)``, downhill, of what frames hold.

    ``mixed (K, 3, N)`` couples it with the points, of which ``point_hessian (3, 3, N)`` and ``point_gradient (3, N)``
    are; ``score (K, N)`` is the part of each point in the pose gradient.
    """

    pose_hessian: Floats
    pose_gradient: Floats
    mixed: Floats
    point_hessian: Floats
    point_gradient: Floats
    score: Floats

    def without_points(self, damping: float) -> EliminatedPoints:
        """The points eliminated."""
        diagonal, hessian = np.arange(_N_POINT), self.point_hessian.copy()
        hessian[diagonal, diagonal] *= 1.0 + damping + _TINY
        hessian[diagonal, diagonal] += _TINY
        return eliminated(hessian, self.point_gradient, self.mixed)


@dataclass(frozen=True)
class BundleFit:
    """``cost`` in sigmas squared; ``residual (J, 2, N)`` likewise, NaN where not observed, inf behind a camera.

    ``equations`` gives those at the end, of which the unknowns that ``is_free (K,)`` marks were searched; ``region
    (N,)`` as of the views.
    """

    bundle: Bundle
    cost: float
    residual: Floats
    equations: Callable[[], _Equations]
    is_free: Bools
    region: Ints

    @property
    def spread(self) -> float:
        """Robust standard deviation of a coordinate, in sigmas."""
        length = np.hypot(self.residual[:, 0], self.residual[:, 1])
        return float(np.nanmedian(length)) / MEDIAN_RAYLEIGH

    @property
    def behind(self) -> Bools:
        """Points (N,) that are behind all cameras by more than three sigmas, which cannot be."""
        return np.asarray(self.bundle.inverse < -3.0 / self.equations().without_points(0.0).root[2, 2])

    @property
    def log_focal_sigma(self) -> float:
        """Standard deviation of log f, which has to be free, with everything else unknown; infinite: nothing tells it.

        The scores of log f, freed of what all other unknowns explain of them, are summed within a part of the picture
        before they are squared (a cluster-robust "sandwich"): neighbouring points err together, and a track errs the
        same way for long. Never below what independent noise gives.
        """
        n_regions = len(np.unique(self.region))
        equations = self.equations()
        points = equations.without_points(0.0)
        matrix, scores = equations.pose_hessian - points.information, equations.score - points.scores
        focal = len(matrix) - N_SHARED
        others = np.flatnonzero(self.is_free & (np.arange(len(matrix)) != focal))
        # The scale stays undetermined: the shortest of all solutions.
        explained = np.linalg.lstsq(matrix[np.ix_(others, others)], matrix[others, focal], rcond=_TINIEST)[0]
        information = float(matrix[focal, focal] - explained @ matrix[others, focal])
        if not information > 0.0:
            return np.inf
        sums = np.bincount(self.region, scores[focal] - explained @ scores[others])
        sandwich = float(np.sum(sums**2)) * n_regions / (n_regions - 1) / information**2
        return float(np.sqrt(max(sandwich, 1.0 / information)))


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

    Source: Triggs et al., "Bundle adjustment: a modern synthesis", 2000; the points are eliminated (Schur complement).
    """
    xy_px = np.full((views.n_frames, 2, views.n_points), np.nan)
    xy_px[views.frame, :, views.point] = views.xy_px
    bundle, reference = _scaled(start), views.n_frames // 2
    is_free = np.ones(N_POSE * views.n_frames + N_SHARED, dtype=bool)
    is_free[N_POSE * reference : N_POSE * (reference + 1)] = False
    is_free[:-N_SHARED].reshape(-1, N_POSE)[:, 3:] &= can_move
    is_free[-N_SHARED:] = shared_sigma > 0.0
    precision = np.divide(1.0, shared_sigma**2, out=np.zeros(N_SHARED), where=shared_sigma > 0.0)

    def prior_cost(candidate: Bundle) -> float:
        prior = float(precision @ (candidate.shared - shared_mean) ** 2)
        return prior + float(_capped(_behind(candidate)[0] ** 2).sum())

    def equations() -> _Equations:
        return _equations(bundle, sigma_px, residual, shared_mean, precision)

    seen_cost, residual = _cost(xy_px, bundle, sigma_px)
    cost, damping = seen_cost + prior_cost(bundle), _DAMPING
    for _ in range(n_steps):
        around = equations()
        while True:
            candidate = _stepped(bundle, around, damping, is_free)
            seen_cost, found = _cost(xy_px, candidate, sigma_px)
            lower = seen_cost + prior_cost(candidate)
            if lower < cost or damping > _MOST_DAMPING:
                break
            damping *= _MORE
        if not lower < cost:
            break
        is_done = cost - lower < _CONVERGED * cost
        # Scaled, the same points are seen at the same places.
        bundle, residual = _scaled(candidate), found
        cost = seen_cost + prior_cost(bundle)
        damping = max(damping * _LESS, _TINY)
        if is_done:
            break
    return BundleFit(bundle, cost, residual, equations, is_free, views.region)


def _seen(bundle: Bundle) -> tuple[Floats, Floats]:
    """The points' rays in the axes of each frame, and where they are seen from it: (J, 3, N) each."""
    turned = bundle.rotation @ bundle.ray.T
    return turned, turned + bundle.inverse * bundle.translation[..., None]


def _cost(xy_px: Floats, bundle: Bundle, sigma_px: float) -> tuple[float, Floats]:
    """Robust cost of all observations ``xy_px (J, 2, N)``; `BundleFit.residual`."""
    seen = _seen(bundle)[1]
    is_ahead = seen[:, 2] >= _LEAST_DEPTH
    x = seen[:, :2] / np.where(is_ahead, seen[:, 2], 1.0)[:, None]
    bend = np.exp(bundle.shared[0]) * (1.0 + bundle.shared[3] * (x * x).sum(axis=1))
    residual = (bend[:, None] * x + bundle.shared[1:3, None] - xy_px) / sigma_px
    square, is_observed = (residual * residual).sum(axis=1), np.isfinite(xy_px[:, 0])
    is_missed = is_observed & ~is_ahead
    residual.transpose(0, 2, 1)[is_missed] = np.inf
    cost = float(_capped(square[is_observed & is_ahead]).sum())
    return cost + _CAP * np.count_nonzero(is_missed), residual


def _capped(square: Floats) -> Floats:
    """Geman and McClure's cost of squared residuals in sigmas."""
    return square / (1.0 + square / _CAP)


def _behind(bundle: Bundle) -> tuple[Floats, float]:
    """By how many sigmas each distance is negative, (N,), 0 if not; and that sigma, the translations being one long."""
    sigma = _BEHIND_PX / float(np.exp(bundle.shared[0]))
    return np.asarray(np.minimum(bundle.inverse / sigma, 0.0)), sigma


def _equations(bundle: Bundle, sigma_px: float, residual: Floats, shared_mean: Floats, precision: Floats) -> _Equations:
    """The normal equations of all unknowns at a bundle and the robust weights, with the prior of the shared ones."""
    n_frames, _, n = residual.shape
    is_seen = np.isfinite(residual[:, 0])
    left = np.where(is_seen[:, None], residual, 0.0)
    rows = _derivatives(bundle, sigma_px, is_seen)
    rows[:, -1] = -left
    rows *= (is_seen / (1.0 + (left * left).sum(axis=1) / _CAP))[:, None, None]
    by_pose, by_shared, by_point = rows[:, :N_POSE], rows[:, N_POSE:_N_VIEW], rows[:, _N_VIEW:]
    flat = rows[:, :_N_VIEW].reshape(n_frames, _N_VIEW, -1)
    held = flat @ flat.transpose(0, 2, 1)
    of_points = np.einsum("jacn,jbcn->abn", by_point[:, :_N_POINT], by_point)
    n_poses, place = N_POSE * n_frames, np.arange(N_POSE * n_frames).reshape(n_frames, N_POSE)
    hessian = np.zeros((n_poses + N_SHARED, n_poses + N_SHARED))
    hessian[place[:, :, None], place[:, None]] = held[:, :N_POSE, :N_POSE]
    hessian[:n_poses, n_poses:] = held[:, :N_POSE, N_POSE:].reshape(n_poses, N_SHARED)
    hessian[n_poses:, :n_poses] = hessian[:n_poses, n_poses:].T
    hessian[n_poses:, n_poses:] = held[:, N_POSE:, N_POSE:].sum(axis=0) + np.diag(precision)
    both = np.empty((n_poses + N_SHARED, _N_POINT + 1, n))
    np.einsum("jacn,jbcn->jabn", by_pose, by_point, out=both[:n_poses].reshape(n_frames, N_POSE, _N_POINT + 1, n))
    np.einsum("jacn,jbcn->abn", by_shared, by_point, out=both[n_poses:])
    mixed, score = np.ascontiguousarray(both[:, :_N_POINT]), both[:, _N_POINT]
    gradient = score.sum(axis=1)
    gradient[n_poses:] -= precision * (bundle.shared - shared_mean)
    behind, behind_sigma = _behind(bundle)
    weight = np.where(behind < 0.0, (1.0 + behind**2 / _CAP) ** -2.0, 0.0) / behind_sigma
    of_points[2, 2] += weight / behind_sigma
    of_points[2, 3] -= weight * behind
    return _Equations(hessian, gradient, mixed, of_points[:, :_N_POINT], of_points[:, _N_POINT], score)


def _derivatives(bundle: Bundle, sigma_px: float, is_seen: Bools) -> Floats:
    """How points move in the picture, in sigmas, by the unknowns of the frame, by the shared ones and by their own.

    ``(J, 10 + 3 + 1, 2, N)``, the own ones along the tangents of their rays; the last row is left empty. Where not
    seen, anything finite.
    """
    focal, distortion = float(np.exp(bundle.shared[0])), bundle.shared[3]
    turned, seen = _seen(bundle)
    depth = np.where(is_seen, seen[:, 2], 1.0)
    x = seen[:, :2] / depth[:, None]
    square, scale = (x * x).sum(axis=1), focal / (sigma_px * depth)
    bend = 1.0 + distortion * square
    by_seen, rows = np.empty((len(x), 3, *x.shape[1:])), np.zeros((len(x), _N_VIEW + _N_POINT + 1, *x.shape[1:]))
    by_seen[:, :2] = x[:, :, None] * (2.0 * distortion * scale[:, None] * x)[:, None]
    by_seen[:, 0, 0] += bend * scale
    by_seen[:, 1, 1] += bend * scale
    by_seen[:, 2] = -(scale * (bend + 2.0 * distortion * square))[:, None] * x
    rows[:, :3] = cross_of_rows(turned[:, :, None], by_seen)
    rows[:, 3:6] = by_seen * bundle.inverse
    rows[:, 6], rows[:, 9] = (focal / sigma_px * each[:, None] * x for each in (bend, square))
    rows[:, 7, 0] = rows[:, 8, 1] = 1.0 / sigma_px
    columns = np.concatenate([bundle.rotation, bundle.translation[..., None]], axis=2)
    moves = (columns.transpose(0, 2, 1) @ by_seen.reshape(len(x), 3, -1)).reshape(len(x), 4, *x.shape[1:])
    tangents = np.ascontiguousarray(tangent_basis(bundle.ray).transpose(1, 2, 0))
    rows[:, 10:12] = np.einsum("jbcn,ban->jacn", moves[:, :3], tangents)
    rows[:, 12] = moves[:, 3]
    return rows


def _stepped(bundle: Bundle, equations: _Equations, damping: float, is_free: Bools) -> Bundle:
    """The bundle after one damped (Levenberg-Marquardt) step; poses and shared unknowns that are not free stay."""
    points = equations.without_points(damping)
    gradient = equations.pose_gradient - points.pull
    damped = equations.pose_hessian - points.information
    damped += np.diag(damping * np.diag(equations.pose_hessian) + _TINY)
    step = np.zeros(len(gradient))
    step[is_free] = np.linalg.solve(damped[np.ix_(is_free, is_free)], gradient[is_free])
    by_point = points.steps(step)
    by_frame = step[:-N_SHARED].reshape(-1, N_POSE)
    by_shared = step[-N_SHARED:]
    by_shared[0] = np.clip(by_shared[0], -_LONGEST_STEP, _LONGEST_STEP)
    turned = np.einsum("nab,bn->na", tangent_basis(bundle.ray), by_point[:2])
    return Bundle(
        rotation_from_vector(by_frame[:, :3]) @ bundle.rotation,
        bundle.translation + by_frame[:, 3:],
        normalize(bundle.ray + turned),
        bundle.inverse + by_point[2],
        bundle.shared + by_shared,
    )


def _scaled(bundle: Bundle) -> Bundle:
    """The same with translations of length one in the mean: nothing tells the scale."""
    length = float(np.sqrt(np.mean(np.sum(bundle.translation**2, axis=1))))
    if length < _TINY:
        return bundle
    return replace(bundle, translation=bundle.translation / length, inverse=bundle.inverse * length)
