"""What the points of bodies say of the velocity that they have in common, over its depth."""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled, compiled_for
from ttcvid.geometry.kernels import path_point
from ttcvid.geometry.kernels.normal_equations import add_equations
from ttcvid.geometry.kernels.path_point import LEAST_DEPTH_RATIO, LEAST_FORWARD, ROBUST_SIGMAS, list_turned
from ttcvid.geometry.kernels.solve import eliminate
from ttcvid.model import Floats, Ints

# Bodies are about so many times as deep as they are wide in the picture, root mean square of both: depths of their
# points, as a part of the depth.
_DEPTH_OF_WIDTH, _LEAST_DEPTH = 2.0, 0.01
_X, _Y, _INVERSE, _N_ROWS = path_point.X, path_point.Y, path_point.INVERSE, path_point.N_ROWS


@compiled_for(
    "(f8[:, :, ::1], i8[::1], i8[::1], f8[::1], f8[::1], f8[:, :, ::1], f8[:, ::1], f8[:, :, ::1], f8[:, ::1])"
)
def add_velocities(
    rays: Floats,
    track: Ints,
    body: Ints,
    sigma: Floats,
    time: Floats,
    ways: Floats,
    velocity: Floats,
    info: Floats,
    score: Floats,
) -> None:
    """Add to ``info (K, 3, 3)`` and ``score (K, 3)`` what each point says of the ``velocity (K, 3)`` of its body.

    ``ways (1, 12, M)`` are the rotations of the views, ``time (M,)`` their times. Huber's weights.
    """
    last, depth_precision = rays.shape[2] - 1, _depth_precisions(rays, track, body, len(velocity))
    views, rows = np.empty((_N_ROWS, last + 1)), np.empty((7, 2 * (last + 1)))
    matrix, right = np.empty((6, 6)), np.empty(6)
    for m in range(len(track)):
        i, b = track[m], body[m]
        if not rays[i, 2, last] > LEAST_FORWARD:
            continue
        x, y = rays[i, 0, last] / rays[i, 2, last], rays[i, 1, last] / rays[i, 2, last]
        vx, vy, vz = velocity[b, 0], velocity[b, 1], velocity[b, 2]
        list_turned(rays, i, ways, 0, 1.0 / sigma[i], views)
        for k in range(np.uint64(last + 1)):
            other, t = k + np.uint64(last + 1), time[k]
            h = 1.0 / max(1.0 + vz * t, LEAST_DEPTH_RATIO)
            was_x, was_y = (x + vx * t) * h, (y + vy * t) * h
            rx, ry = (views[_X, k] - was_x) * views[_INVERSE, k], (views[_Y, k] - was_y) * views[_INVERSE, k]
            root = np.sqrt(ROBUST_SIGMAS / max(np.sqrt(rx * rx + ry * ry), ROBUST_SIGMAS))
            w = root * views[_INVERSE, k] * h
            wt = w * t
            rows[0, k], rows[1, k], rows[2, k], rows[3, k] = w, 0.0, wt * (vx - was_x * vz), wt
            rows[4, k], rows[5, k], rows[6, k] = 0.0, -wt * was_x, root * rx
            rows[0, other], rows[1, other], rows[2, other], rows[3, other] = 0.0, w, wt * (vy - was_y * vz), 0.0
            rows[4, other], rows[5, other], rows[6, other] = wt, -wt * was_y, root * ry
        matrix[:], right[:] = 0.0, 0.0
        add_equations(rows, rows.shape[1], matrix, right)
        # The relative depth is 1 within what is usual.
        matrix[2, 2] += depth_precision[b]
        eliminate(matrix, right, 3)
        for r in range(3):
            score[b, r] += right[3 + r]
            for c in range(3):
                info[b, r, c] += matrix[3 + max(r, c), 3 + min(r, c)]


@compiled
def _depth_precisions(rays: Floats, track: Ints, body: Ints, n_bodies: int) -> Floats:
    """How surely the relative depths of a body's points are 1, by its width in the picture: (K,)."""
    last, sums = rays.shape[2] - 1, np.zeros((n_bodies, 4))
    for m in range(len(track)):
        z = rays[track[m], 2, last]
        if z > LEAST_FORWARD:
            x, y = rays[track[m], 0, last] / z, rays[track[m], 1, last] / z
            sums[body[m], 0] += 1.0
            sums[body[m], 1] += x
            sums[body[m], 2] += y
            sums[body[m], 3] += x * x + y * y
    precision = np.empty(n_bodies)
    for b in range(n_bodies):
        n = max(sums[b, 0], 1.0)
        width2 = max(sums[b, 3] / n - (sums[b, 1] * sums[b, 1] + sums[b, 2] * sums[b, 2]) / (n * n), 0.0)
        precision[b] = 1.0 / (_DEPTH_OF_WIDTH * _DEPTH_OF_WIDTH * width2 + _LEAST_DEPTH * _LEAST_DEPTH)
    return precision
