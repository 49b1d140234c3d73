"""Bundle adjustment of a rigid body over a window of views: every view's rotation and place, and every point.

Two views tell the direction of a short step badly, and a mean over longer gaps is not that of the last step of a camera
that sways. All views together give each step its own direction, with its own covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.geometry.estimation.rigid_motion import RigidPaths
from ttcvid.geometry.estimation.schur import EliminatedPoints, cross_of_rows, eliminated
from ttcvid.geometry.medians import median
from ttcvid.geometry.rotation import rotation_from_vector, skew, tangent_basis
from ttcvid.model import Bools, Floats, Ints

# Geman and McClure's cost: that of an outlier is limited to so many sigmas squared.
_CAP = 16.0
# Levenberg and Marquardt's damping: at first, its change after a good and after a bad step.
_DAMPING, _LESS, _MORE = 1e-6, 0.1, 100.0
# A step that lowers the cost by less than this part is the last one.
_CONVERGED = 1e-3
# A point nearer to the picture plane, or behind it, is not seen there.
_LEAST_DEPTH = 1e-3
# Added to what the observations do not tell.
_TINY = 1e-9
# Steps of the fit of a plane.
_PLANE_STEPS = 5
# Numbers of the unknowns of a view and of a point.
_N_POSE, _N_POINT = 6, 3


@dataclass(frozen=True)
class WindowFit:
    """A body over L views: its ``paths`` (one body), and how well the last step of them is known.

    ``direction_cov (3, 3)`` of the direction of that step in the present camera's axes, rad^2, and ``rotation_cov (3,
    3)`` of the rotation in it. ``point (N, 3)`` places and inverse depths now, ``cost`` the sum of capped squares.
    """

    paths: RigidPaths
    direction_cov: Floats
    rotation_cov: Floats
    point: Floats
    cost: float


@dataclass(frozen=True)
class _State:
    """Poses that take a point of the present camera to each view, points (x, y, inverse depth), and their residuals.

    ``rotation (L, 3, 3)``, ``place (L, 3)``, ``point (3, N)``; ``turned (L, 3, N)`` rays of the points in each view,
    ``depth (L, N)`` over that of the present, ``off (L, 2, N)`` in sigmas, 0 where not ``seen``.
    """

    rotation: Floats
    place: Floats
    point: Floats
    turned: Floats
    depth: Floats
    off: Floats
    seen: Bools
    cost: float


def adjust_window(
    xy: Floats, sigma_norm: Floats, region: Ints, paths: RigidPaths, point: Floats, n_steps: int
) -> WindowFit:
    """Robust least squares with Levenberg-Marquardt damping from a start; the length of the path is kept.

    Parameters
    ----------
    xy : (L, N, 2) places in the plane z = 1 of each view's own camera, the present one last; NaN where not seen.
    sigma_norm, region : (N,) noise of one coordinate, and the part of the picture that each point lies in.
    paths : of the body over these views, a start.
    point : (N, 3) present place in the plane z = 1 and inverse depth of each point, a start.
    n_steps : at most so many steps.

    Source: Triggs et al., "Bundle adjustment: a modern synthesis", 2000; the points are eliminated (Schur complement).
    """
    rotation = paths.cam_R_past[0].transpose(0, 2, 1)
    place = np.einsum("lij,lj->li", rotation, paths.path[0])
    xy = np.ascontiguousarray(xy.transpose(0, 2, 1))
    state, damping = _state(xy, sigma_norm, rotation, place, point.T), _DAMPING
    for _ in range(n_steps):
        found = _stepped(xy, sigma_norm, state, damping)
        if not found.cost < state.cost:
            damping *= _MORE
            continue
        is_done = state.cost - found.cost < _CONVERGED * state.cost
        state, damping = found, damping * _LESS
        if is_done:
            break
    # The other way past points behind the camera looks the same: most of them lie ahead.
    if float(np.sign(state.point[2]).sum()) < 0.0:
        state = _state(xy, sigma_norm, state.rotation, -state.place, state.point * [[1.0], [1.0], [-1.0]])
    return _fit(sigma_norm, region, state)


def planar_dual(fit: WindowFit) -> tuple[RigidPaths, Floats] | None:
    """The other motion that explains points on a plane about as well, a start; None where there is none.

    On a plane the inverse depth of the point p = (x, y, 1) is rho = n . p, and (n . p) T = (T . p) n - w x p with
    w = T x n: a shift by T past the plane n looks like one along n past the plane T, turned by -w, to first order.
    (A homography has two such decompositions: Ma, Soatto, Kosecka and Sastry, An Invitation to 3-D Vision, 2004,
    section 5.3.) A drone that drifts over flat ground seems to climb. What stands on the ground, and turns that add up,
    tell the two apart.

    Returns
    -------
    The paths, straight along n, and the points (N, 3) as of `WindowFit`, those of the dual motion.
    """
    path, rho = fit.paths.path[0], fit.point[:, 2]
    x = np.column_stack([fit.point[:, :2], np.ones(len(rho))])
    length = np.sqrt((path * path).sum(axis=1))
    normal, _ = fitted_robustly(x[:, None], rho[:, None], _PLANE_STEPS)
    steepness = float(np.linalg.norm(normal))
    if min(float(length.max()), steepness) < _TINY:
        return None
    way = path[length.argmax()] / length.max()
    along = (path @ way)[:, None]
    cam_R_past = rotation_from_vector(np.cross(along * way, normal)) @ fit.paths.cam_R_past[0]
    place, rate = along * normal / steepness, steepness * (x @ way)
    depth = np.einsum("lnj,lj->ln", x + rate[:, None] * place[:, None], cam_R_past[:, :, 2])
    if not (depth > _LEAST_DEPTH).any(axis=1).all():
        return None
    return RigidPaths(cam_R_past[None], place[None]), np.column_stack([x[:, :2], rate])


def fitted_robustly(design: Floats, values: Floats, n_steps: int) -> tuple[Floats, Floats]:
    """Robust linear fit (K,) of ``values (N, R)`` by ``design (N, R, K)``, and how far off each point is, (N,)."""
    found, off, weight = np.zeros(design.shape[2]), np.zeros(len(values)), np.ones(len(values))
    for _ in range(n_steps):
        rows, value = design * weight[:, None, None], values * weight[:, None]
        found = np.asarray(np.linalg.lstsq(rows.reshape(-1, len(found)), value.ravel())[0], dtype=np.float64)
        off = np.linalg.norm(values - design @ found, axis=1)
        weight = 1.0 / np.sqrt(1.0 + (off / (median(off) + _TINY)) ** 2)
    return found, off


def _state(xy: Floats, sigma: Floats, rotation: Floats, place: Floats, point: Floats) -> _State:
    turned = rotation @ np.vstack([point[:2], np.ones((1, len(sigma)))])
    there = turned + point[2] * place[..., None]
    is_observed = np.isfinite(xy[:, 0])
    seen = is_observed & (there[:, 2] > _LEAST_DEPTH)
    depth = np.where(seen, there[:, 2], 1.0)
    off = np.where(seen[:, None], (there[:, :2] / depth[:, None] - xy) / sigma, 0.0)
    square = (off * off).sum(axis=1)
    cost = float((square / (1.0 + square / _CAP) + _CAP * (is_observed & ~seen)).sum())
    return _State(rotation, place, point, turned, depth, off, seen, cost)


def _equations(sigma: Floats, state: _State) -> tuple[Floats, Floats, Floats]:
    """Information of each view ``(L - 1, 6, 6)``, that and score of each point ``(3, 4, N)``, and what couples them
    beside each point's part in the scores of the views, ``(L - 1, 6, 4, N)``.
    """
    n_views, n = state.depth.shape
    turned, there = state.turned, state.turned + state.point[2] * state.place[..., None]
    root = state.seen / (1.0 + (state.off * state.off).sum(axis=1) / _CAP)
    by_there = np.zeros((n_views, 3, 2, n))
    scale = root / (state.depth * sigma)
    by_there[:, 0, 0] = by_there[:, 1, 1] = scale
    by_there[:, 2] = -(scale / state.depth)[:, None] * there[:, :2]
    rows = np.empty((n_views, _N_POSE + _N_POINT + 1, 2, n))
    rows[:, :3] = cross_of_rows(turned[:, :, None], by_there)
    rows[:, 3:6] = state.point[2] * by_there
    columns = np.concatenate([state.rotation[:, :, :2], state.place[:, :, None]], axis=2)
    rows[:, 6:9] = (columns.transpose(0, 2, 1) @ by_there.reshape(n_views, 3, -1)).reshape(n_views, 3, 2, n)
    rows[:, 9] = -root[:, None] * state.off
    by_point = np.einsum("lacn,lbcn->abn", rows[:, 6:9], rows[:, 6:])
    poses = rows[:-1, :6].reshape(n_views - 1, _N_POSE, -1)
    mixed = np.einsum("lacn,lbcn->labn", rows[:-1, :6], rows[:-1, 6:])
    return poses @ poses.transpose(0, 2, 1), by_point, mixed


def _reduced(sigma: Floats, state: _State, damping: float) -> tuple[Floats, Floats, EliminatedPoints]:
    """Information (K, K) of the views without the points, each point's part in their score (K, N), and the points."""
    by_pose, by_point, mixed = _equations(sigma, state)
    n_past, n = len(mixed), mixed.shape[-1]
    size, diagonal = _N_POSE * n_past, np.arange(_N_POINT)
    of_points = by_point[:, :_N_POINT].copy()
    of_points[diagonal, diagonal] *= 1.0 + damping
    of_points[diagonal, diagonal] += _TINY + _TINY * np.trace(of_points)
    of_each = mixed.reshape(size, _N_POINT + 1, n)
    points = eliminated(of_points, by_point[:, _N_POINT], of_each[:, :_N_POINT])
    information = -points.information
    blocks = information.reshape(n_past, _N_POSE, n_past, _N_POSE)
    blocks[np.arange(n_past), :, np.arange(n_past)] += by_pose
    # The scale is free: the path keeps its length.
    scale = np.zeros((n_past, _N_POSE))
    scale[:, 3:] = state.place[:-1] / max(float(np.linalg.norm(state.place)), _TINY)
    most = float(information.diagonal().max())
    information += most * np.outer(scale, scale)
    every = np.arange(size)
    information[every, every] += damping * np.abs(information.diagonal()) + _TINY * most
    return information, of_each[:, _N_POINT] - points.scores, points


def _stepped(xy: Floats, sigma: Floats, state: _State, damping: float) -> _State:
    """The state after one damped step."""
    information, score, points = _reduced(sigma, state, damping)
    change = np.asarray(np.linalg.solve(information, score.sum(axis=1)), dtype=np.float64)
    by_view = change.reshape(-1, _N_POSE)
    rotation, place = state.rotation.copy(), state.place.copy()
    rotation[:-1] = rotation_from_vector(by_view[:, :3]) @ rotation[:-1]
    place[:-1] += by_view[:, 3:]
    return _state(xy, sigma, rotation, place, state.point + points.steps(change))


def _fit(sigma: Floats, region: Ints, state: _State) -> WindowFit:
    """The fit with the covariance of its last step.

    Points of one part of the picture err together, and a track errs the same way for long: the influences of a part's
    points on the direction are summed before they are squared (a cluster-robust "sandwich"), and the covariance is no
    smaller than they say. Six unknowns of a view are fitted to the parts.
    """
    information, score, _ = _reduced(sigma, state, 0.0)
    of_step = np.linalg.inv(information)[:, -_N_POSE:]
    cov = of_step[-_N_POSE:]
    back = state.rotation.transpose(0, 2, 1)
    path = np.einsum("lij,lj->li", back, state.place)
    length = max(float(np.linalg.norm(path[-2])), _TINY)
    across = tangent_basis(path[-2] / length)
    by_step = across.T @ back[-2] @ np.concatenate([skew(state.place[-2]), np.eye(3)], axis=1) / length
    parts = np.stack([np.bincount(region, influence) for influence in by_step @ of_step.T @ score])
    n_parts = np.count_nonzero(np.bincount(region))
    plain = by_step @ cov @ by_step.T
    more = 1.0
    if n_parts > 2 * _N_POSE:
        together = parts @ parts.T * n_parts / (n_parts - _N_POSE)
        more = max(1.0, 0.5 * float(np.trace(np.linalg.solve(plain, together))))
    turn = back[-2] @ cov[:3, :3] @ back[-2].T
    return WindowFit(
        RigidPaths(back[None], path[None]),
        np.asarray(more * across @ plain @ across.T),
        np.asarray(more * turn),
        state.point.T.copy(),
        state.cost,
    )
