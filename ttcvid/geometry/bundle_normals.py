"""The inner loops of `bundle`: projection of static points into turning and moving cameras, compiled.

All arrays that a function fills are arguments of it. A point n is the unit ray ``ray[n]`` and the inverse distance
``inverse[n]`` in the axes of one frame; frame j sees it along R_j ray + inverse t_j. The lens is
u = f x (1 + k |x|^2) + c with x the point in the plane z = 1. ``shared`` is (log f, cx, cy, k) beside the centre of the
picture. Everything is in sigmas of an observation.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled, compiled_for
from ttcvid.model import Floats, Ints

N_SHARED = 4
"""Number of the unknowns that all frames share."""
N_POSE = 6
"""Number of the unknowns of a frame: rotation vector and translation."""

# Geman and McClure's cost: that of an outlier is limited to so many sigmas squared.
_CAP = 16.0
# A point nearer to the picture plane, or behind it, cannot be seen: it costs what an outlier costs.
_LEAST_DEPTH = 1e-3


@compiled_for(
    "(f8[:, ::1], i8[::1], i8[::1], f8[:, :, ::1], f8[:, ::1], f8[:, ::1], f8[::1], f8[::1], f8, f8, f8[:, ::1])"
)
def bundle_cost(
    xy_px: Floats,
    frame: Ints,
    point: Ints,
    rotation: Floats,
    translation: Floats,
    ray: Floats,
    inverse: Floats,
    shared: Floats,
    sigma_px: float,
    inverse_sigma: float,
    residual: Floats,
) -> float:
    """Robust cost of all M observations and of negative distances; fills ``residual (M, 2)``, inf where unseen."""
    cost = 0.0
    focal = np.exp(shared[0])
    y = np.empty(3)
    for i in range(len(frame)):
        j, n = frame[i], point[i]
        _place(rotation[j], translation[j], ray[n], inverse[n], y)
        if y[2] < _LEAST_DEPTH:
            residual[i] = np.inf
            cost += _CAP
            continue
        px, py = y[0] / y[2], y[1] / y[2]
        bend = 1.0 + shared[3] * (px * px + py * py)
        residual[i, 0] = (focal * px * bend + shared[1] - xy_px[i, 0]) / sigma_px
        residual[i, 1] = (focal * py * bend + shared[2] - xy_px[i, 1]) / sigma_px
        square = residual[i, 0] ** 2 + residual[i, 1] ** 2
        cost += square / (1.0 + square / _CAP)
    for n in range(len(inverse)):
        square = min(inverse[n] / inverse_sigma, 0.0) ** 2
        cost += square / (1.0 + square / _CAP)
    return cost


@compiled_for(
    "(i8[::1], i8[::1], f8[:, :, ::1], f8[:, ::1], f8[:, ::1], f8[:, :, ::1], f8[::1], f8[::1], f8, f8, "
    "f8[:, ::1], f8[:, ::1], f8[::1], f8[:, :, ::1], f8[:, :, ::1], f8[:, ::1], f8[:, ::1])"
)
def bundle_normals(
    frame: Ints,
    point: Ints,
    rotation: Floats,
    translation: Floats,
    ray: Floats,
    basis: Floats,
    inverse: Floats,
    shared: Floats,
    sigma_px: float,
    inverse_sigma: float,
    residual: Floats,
    pose_hessian: Floats,
    pose_gradient: Floats,
    mixed: Floats,
    point_hessian: Floats,
    point_gradient: Floats,
    score: Floats,
) -> None:
    """Gauss-Newton's equations at the robust weights of ``residual``.

    The unknowns that frames hold come as ``K = 6 J + 4``: each frame's rotation vector and translation, then the
    shared ones; those of a point are two tangent coordinates along ``basis (N, 3, 2)`` and the inverse distance. Fills
    ``pose_hessian (K, K)``, ``pose_gradient (K,)``, ``mixed (K, N, 3)``, ``point_hessian (N, 3, 3)``, ``point_gradient
    (N, 3)`` and ``score (N, K)``, the part of each point in the pose gradient. Gradients point downhill.
    """
    pose_hessian[:] = 0.0
    pose_gradient[:] = 0.0
    mixed[:] = 0.0
    point_hessian[:] = 0.0
    point_gradient[:] = 0.0
    score[:] = 0.0
    focal = np.exp(shared[0])
    n_frames = len(rotation)
    last = N_POSE * n_frames
    y, by_y = np.empty(3), np.empty((2, 3))
    by_pose, by_point = np.zeros((2, N_POSE + N_SHARED)), np.empty((2, 3))
    place = np.empty(N_POSE + N_SHARED, np.int64)
    for i in range(len(frame)):
        if not np.isfinite(residual[i, 0]):
            continue
        j, n = frame[i], point[i]
        _place(rotation[j], translation[j], ray[n], inverse[n], y)
        px, py = y[0] / y[2], y[1] / y[2]
        square = px * px + py * py
        bend = 1.0 + shared[3] * square
        scale = focal / (y[2] * sigma_px)
        twist = 2.0 * shared[3]
        by_y[0, 0], by_y[0, 1] = scale * (bend + twist * px * px), scale * twist * px * py
        by_y[1, 0], by_y[1, 1] = by_y[0, 1], scale * (bend + twist * py * py)
        by_y[0, 2] = -(by_y[0, 0] * px + by_y[0, 1] * py)
        by_y[1, 2] = -(by_y[1, 0] * px + by_y[1, 1] * py)
        # The turned point without its translation: a rotation vector w adds w x v.
        v0 = y[0] - inverse[n] * translation[j, 0]
        v1 = y[1] - inverse[n] * translation[j, 1]
        v2 = y[2] - inverse[n] * translation[j, 2]
        for a in range(2):
            by_pose[a, 0] = by_y[a, 2] * v1 - by_y[a, 1] * v2
            by_pose[a, 1] = by_y[a, 0] * v2 - by_y[a, 2] * v0
            by_pose[a, 2] = by_y[a, 1] * v0 - by_y[a, 0] * v1
            along = 0.0
            for b in range(3):
                by_pose[a, 3 + b] = by_y[a, b] * inverse[n]
                along += by_y[a, b] * translation[j, b]
            for k in range(2):
                total = 0.0
                for b in range(3):
                    for c in range(3):
                        total += by_y[a, b] * rotation[j, b, c] * basis[n, c, k]
                by_point[a, k] = total
            by_point[a, 2] = along
        by_pose[0, 6], by_pose[1, 6] = focal * px * bend / sigma_px, focal * py * bend / sigma_px
        by_pose[0, 7] = by_pose[1, 8] = 1.0 / sigma_px
        by_pose[0, 9], by_pose[1, 9] = focal * px * square / sigma_px, focal * py * square / sigma_px
        for a in range(N_POSE):
            place[a] = N_POSE * j + a
        for a in range(N_SHARED):
            place[N_POSE + a] = last + a
        length = residual[i, 0] ** 2 + residual[i, 1] ** 2
        weight = 1.0 / (1.0 + length / _CAP) ** 2
        for a in range(N_POSE + N_SHARED):
            pull = weight * (by_pose[0, a] * residual[i, 0] + by_pose[1, a] * residual[i, 1])
            score[n, place[a]] -= pull
            pose_gradient[place[a]] -= pull
            for b in range(N_POSE + N_SHARED):
                pose_hessian[place[a], place[b]] += weight * (
                    by_pose[0, a] * by_pose[0, b] + by_pose[1, a] * by_pose[1, b]
                )
            for b in range(3):
                mixed[place[a], n, b] += weight * (by_pose[0, a] * by_point[0, b] + by_pose[1, a] * by_point[1, b])
        for a in range(3):
            point_gradient[n, a] -= weight * (by_point[0, a] * residual[i, 0] + by_point[1, a] * residual[i, 1])
            for b in range(3):
                point_hessian[n, a, b] += weight * (by_point[0, a] * by_point[0, b] + by_point[1, a] * by_point[1, b])
    for n in range(len(inverse)):
        behind = min(inverse[n] / inverse_sigma, 0.0)
        if behind < 0.0:
            weight = 1.0 / (1.0 + behind * behind / _CAP) ** 2 / inverse_sigma
            point_hessian[n, 2, 2] += weight / inverse_sigma
            point_gradient[n, 2] -= weight * behind


@compiled_for("(f8[:, :, ::1], f8[:, :, ::1], f8[:, :, ::1])")
def carry(mixed: Floats, inverse: Floats, carried: Floats) -> None:
    """Fill ``carried (K, N, 3)`` with ``mixed (K, N, 3)`` times ``inverse (N, 3, 3)``, point by point."""
    for k in range(len(mixed)):
        for n in range(len(inverse)):
            for b in range(3):
                carried[k, n, b] = (
                    mixed[k, n, 0] * inverse[n, 0, b]
                    + mixed[k, n, 1] * inverse[n, 1, b]
                    + mixed[k, n, 2] * inverse[n, 2, b]
                )


@compiled
def _place(rotation: Floats, translation: Floats, ray: Floats, inverse: float, y: Floats) -> None:
    """Fill ``y`` with R ray + inverse t."""
    for a in range(3):
        y[a] = rotation[a, 0] * ray[0] + rotation[a, 1] * ray[1] + rotation[a, 2] * ray[2] + inverse * translation[a]
