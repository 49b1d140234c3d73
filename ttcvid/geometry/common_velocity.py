"""The velocity that the points of a thing have in common, over its depth, and how surely they tell it.

A point at (x, y, 1) now, of relative depth 1 / rho in the thing, was at (x + rho a t, y + rho b t, 1 + rho c t), up to
its depth, when the thing moves by (a, b, c) = V / Z: the state of DESIGN section 3, of a whole thing.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled_for
from ttcvid.geometry.rigid_path import Points
from ttcvid.model import Floats, Ints

# Things are about so many times as deep as they are wide in the picture, root mean square of both: depths of their
# points, as a part of the depth.
_DEPTH_OF_WIDTH, _LEAST_DEPTH = 2.0, 0.01
# As in `kernels.path_point`: residuals beyond this, in sigmas, count by their length; least depth of a point over that
# at time 0, and least z of a turned ray.
_ROBUST_SIGMAS, _LEAST_DEPTH_RATIO, _LEAST_FORWARD = 3.0, 0.05, 0.05
# Numbers of a view: its rotation (9) and time; 0 of one that is not looked at.
_N_WAY, _TIME = 10, 9


def common_velocities(points: Points, cam_R_past: Floats, start_hz: Floats, n_steps: int) -> tuple[Floats, Floats]:
    """V / Z of each of K things, 1/s, and its information matrix: ``(K, 3)`` and ``(K, 3, 3)``.

    Gauss-Newton with robust weights on where the points were seen; place and depth of each point are unknown, too.

    Parameters
    ----------
    cam_R_past : (L, 3, 3) turns a ray of each view into the present camera.
    start_hz : (K, 3) V / Z to start from.
    """
    velocity, info = start_hz.copy(), np.zeros((len(start_hz), 3, 3))
    score, cam_R_past = np.zeros((len(start_hz), 3)), np.ascontiguousarray(cam_R_past)
    for _ in range(n_steps):
        info[:], score[:] = 0.0, 0.0
        _add_points(
            points.rays,
            points.track,
            points.thing,
            points.sigma_norm,
            points.since_s,
            cam_R_past,
            velocity,
            info,
            score,
        )
        _step(info, score, velocity)
    return velocity, info


@compiled_for("(f8[:, :, ::1], f8[:, ::1], f8[:, ::1])")
def _step(info: Floats, score: Floats, velocity: Floats) -> None:
    """Move each ``velocity (K, 3)`` by what its normal equations say, if these say all of it."""
    for k in range(len(velocity)):
        if np.linalg.det(info[k]) > 0.0:
            velocity[k] += np.linalg.solve(info[k], score[k])


@compiled_for(
    "(f8[:, :, ::1], i8[::1], i8[::1], f8[::1], f8[::1], f8[:, :, ::1], f8[:, ::1], f8[:, :, ::1], f8[:, ::1])"
)
def _add_points(
    rays: Floats,
    track: Ints,
    thing: Ints,
    sigma: Floats,
    since_s: Floats,
    rotations: Floats,
    velocity: Floats,
    info: Floats,
    score: Floats,
) -> None:
    """Add to ``info (K, 3, 3)`` and ``score (K, 3)`` what each point says of the velocity of its thing."""
    n_views, n_things = len(since_s), len(velocity)
    before, last = rays.shape[2] - n_views, rays.shape[2] - 1
    sums = np.zeros((n_things, 4))
    for m in range(len(track)):
        i, k = track[m], thing[m]
        if rays[i, 2, last] > _LEAST_FORWARD:
            x, y = rays[i, 0, last] / rays[i, 2, last], rays[i, 1, last] / rays[i, 2, last]
            sums[k, 0] += 1.0
            sums[k, 1] += x
            sums[k, 2] += y
            sums[k, 3] += x * x + y * y
    a, b, ways = np.empty((6, 6)), np.empty(6), np.zeros((_N_WAY, rays.shape[2]))
    for v in range(n_views):
        ways[_TIME, before + v] = since_s[v]
        for j in range(3):
            for c in range(3):
                ways[3 * j + c, before + v] = rotations[v, j, c]
    for m in range(len(track)):
        i, k = track[m], thing[m]
        if not rays[i, 2, last] > _LEAST_FORWARD:
            continue
        n, x, y = sums[k, 0], rays[i, 0, last] / rays[i, 2, last], rays[i, 1, last] / rays[i, 2, last]
        width2 = max(sums[k, 3] / n - (sums[k, 1] * sums[k, 1] + sums[k, 2] * sums[k, 2]) / (n * n), 0.0)
        vx, vy, vz, inverse = velocity[k, 0], velocity[k, 1], velocity[k, 2], 1.0 / sigma[i]
        hh = hx = hy = dd = ht = tx = ty = tt = hu = hv = du = tu = tv = uu = 0.0
        b0 = b1 = b2 = b3 = b4 = b5 = 0.0
        # Without a branch, and by an index without a sign, several views are worked at side by side.
        for v in range(np.uint64(rays.shape[2])):
            t, p, q, s = ways[_TIME, v], rays[i, 0, v], rays[i, 1, v], rays[i, 2, v]
            ahead = ways[6, v] * p + ways[7, v] * q + ways[8, v] * s
            is_seen = ahead > _LEAST_FORWARD
            ahead = ahead if is_seen else 1.0
            h = 1.0 / max(1.0 + vz * t, _LEAST_DEPTH_RATIO)
            was_x, was_y = (x + vx * t) * h, (y + vy * t) * h
            off_x = (ways[0, v] * p + ways[1, v] * q + ways[2, v] * s) / ahead - was_x if is_seen else 0.0
            off_y = (ways[3, v] * p + ways[4, v] * q + ways[5, v] * s) / ahead - was_y if is_seen else 0.0
            length = np.sqrt(off_x * off_x + off_y * off_y) * inverse
            w = inverse * inverse * _ROBUST_SIGMAS / max(length, _ROBUST_SIGMAS) if is_seen else 0.0
            # Rows of x and y: (h, 0, d_x, th, 0, by_x) and (0, h, d_y, 0, th, by_y).
            th = t * h
            d_x, d_y, by_x, by_y = (vx - was_x * vz) * th, (vy - was_y * vz) * th, -was_x * th, -was_y * th
            wh, wt = w * h, w * th
            hh, hx, hy, dd = hh + wh * h, hx + wh * d_x, hy + wh * d_y, dd + w * (d_x * d_x + d_y * d_y)
            ht, tx, ty, tt = ht + wh * th, tx + wt * d_x, ty + wt * d_y, tt + wt * th
            hu, hv, du = hu + wh * by_x, hv + wh * by_y, du + w * (d_x * by_x + d_y * by_y)
            tu, tv, uu = tu + wt * by_x, tv + wt * by_y, uu + w * (by_x * by_x + by_y * by_y)
            b0, b1, b2 = b0 + wh * off_x, b1 + wh * off_y, b2 + w * (d_x * off_x + d_y * off_y)
            b3, b4, b5 = b3 + wt * off_x, b4 + wt * off_y, b5 + w * (by_x * off_x + by_y * off_y)
        # Place, depth, velocity, the lower half; the relative depth is 1 within what is usual.
        usual = 1.0 / (_DEPTH_OF_WIDTH * _DEPTH_OF_WIDTH * width2 + _LEAST_DEPTH * _LEAST_DEPTH)
        a[0, 0], a[1, 0], a[1, 1], a[2, 0], a[2, 1], a[2, 2] = hh, 0.0, hh, hx, hy, dd + usual
        a[3, 0], a[3, 1], a[3, 2], a[3, 3] = ht, 0.0, tx, tt
        a[4, 0], a[4, 1], a[4, 2], a[4, 3], a[4, 4] = 0.0, ht, ty, 0.0, tt
        a[5, 0], a[5, 1], a[5, 2], a[5, 3], a[5, 4], a[5, 5] = hu, hv, du, tu, tv, uu
        b[0], b[1], b[2], b[3], b[4], b[5] = b0, b1, b2, b3, b4, b5
        # What place and depth explain is taken away, one unknown after the other.
        for r in range(3):
            for q2 in range(r + 1, 6):
                part = a[q2, r] / a[r, r]
                b[q2] -= part * b[r]
                for c in range(r + 1, q2 + 1):
                    a[q2, c] -= part * a[c, r]
        for r in range(3):
            score[k, r] += b[3 + r]
            for c in range(3):
                info[k, r, c] += a[3 + max(r, c), 3 + min(r, c)]
