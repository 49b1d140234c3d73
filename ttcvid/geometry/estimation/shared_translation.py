"""The velocity that the points of a thing have in common, over its depth, and how surely they tell it.

A point at (x, y, 1) now, of relative depth 1 / rho in the thing, was at (x + rho a t, y + rho b t, 1 + rho c t), up to
its depth, when the thing moves by (a, b, c) = V / Z: the state of DESIGN section 3, of a whole thing.
"""

from __future__ import annotations

import numpy as np

from ttcvid.compiled import compiled_for
from ttcvid.geometry.estimation.rigid_motion import Points
from ttcvid.geometry.kernels.normal_equations import add_equations
from ttcvid.geometry.kernels.path_point import LEAST_DEPTH_RATIO, LEAST_FORWARD, ROBUST_SIGMAS
from ttcvid.geometry.kernels.solve import eliminate
from ttcvid.model import Floats, Ints

# Things are about so many times as deep as they are wide in the picture, root mean square of both: depths of their
# points, as a part of the depth.
_DEPTH_OF_WIDTH, _LEAST_DEPTH = 2.0, 0.01


def common_velocities(points: Points, cam_R_past: Floats, start_hz: Floats, n_steps: int) -> tuple[Floats, Floats]:
    """V / Z of each of K things, 1/s, and its information matrix: ``(K, 3)`` and ``(K, 3, 3)``.

    Gauss-Newton with Huber's weights on where the points were seen; place and depth of each point are unknown, too.

    Parameters
    ----------
    cam_R_past : (L, 3, 3) turns a ray of each view into the present camera.
    start_hz : (K, 3) V / Z to start from.
    """
    velocity, info = start_hz.copy(), np.zeros((len(start_hz), 3, 3))
    last = points.rays[points.track, :, -1]
    is_used = last[:, 2] > LEAST_FORWARD
    track, thing, place = points.track[is_used], points.thing[is_used], last[is_used, :2] / last[is_used, 2:]
    precision, rotations = _depth_precisions(place, thing, len(start_hz)), np.ascontiguousarray(cam_R_past)
    for _ in range(n_steps):
        info, score = np.zeros_like(info), np.zeros_like(velocity)
        of_points = points.rays, points.sigma_norm, track, thing, place
        _add_points(of_points, rotations, points.since_s, velocity, precision, info, score)
        info += np.tril(info, -1).transpose(0, 2, 1)
        is_told = np.linalg.det(info) > 0.0
        velocity[is_told] += np.linalg.solve(info[is_told], score[is_told, :, None])[..., 0]
    return velocity, info


@compiled_for(
    "(Tuple((f8[:, :, ::1], f8[::1], i8[::1], i8[::1], f8[:, ::1])), f8[:, :, ::1], f8[::1], f8[:, ::1], f8[::1], "
    "f8[:, :, ::1], f8[:, ::1])"
)
def _add_points(
    points: tuple[Floats, Floats, Ints, Ints, Floats],
    rotations: Floats,
    t_s: Floats,
    velocity_hz: Floats,
    precision: Floats,
    info: Floats,
    score: Floats,
) -> None:
    """Add to ``info (K, 3, 3)``, its lower half, and ``score (K, 3)`` what points say of the velocity of their thing.

    ``points``: rays and noise of tracks as in `rigid_motion.Points`, track, thing (M,) and place (M, 2) of each;
    ``rotations (L, 3, 3)`` of the last L views, ``precision (K,)`` of depths.
    """
    rays, sigmas, track, thing, place = points
    rows, equations, kept = np.empty((7, 2 * len(t_s))), np.empty((7, 6)), np.empty((3, 7))
    for i in range(len(thing)):
        along_x, along_y, ahead = velocity_hz[thing[i], 0], velocity_hz[thing[i], 1], velocity_hz[thing[i], 2]
        n, m, first, sigma = 0, track[i], rays.shape[2] - len(t_s), sigmas[track[i]]
        for k in range(len(t_s)):
            p, q, r = rays[m, 0, first + k], rays[m, 1, first + k], rays[m, 2, first + k]
            deep = rotations[k, 2, 0] * p + rotations[k, 2, 1] * q + rotations[k, 2, 2] * r
            # Where it was not seen it is NaN, and no comparison holds.
            if not deep > LEAST_FORWARD:
                continue
            t, h = t_s[k], 1.0 / max(1.0 + ahead * t_s[k], LEAST_DEPTH_RATIO)
            x, y = (place[i, 0] + along_x * t) * h, (place[i, 1] + along_y * t) * h
            rx = (rotations[k, 0, 0] * p + rotations[k, 0, 1] * q + rotations[k, 0, 2] * r) / deep - x
            ry = (rotations[k, 1, 0] * p + rotations[k, 1, 1] * q + rotations[k, 1, 2] * r) / deep - y
            root = np.sqrt(ROBUST_SIGMAS / max(np.sqrt(rx * rx + ry * ry) / sigma, ROBUST_SIGMAS)) / sigma
            g, other = root * h, n + 1
            rows[0, n], rows[0, other], rows[1, n], rows[1, other] = g, 0.0, 0.0, g
            rows[2, n], rows[2, other] = (along_x - x * ahead) * t * g, (along_y - y * ahead) * t * g
            rows[3, n], rows[3, other], rows[4, n], rows[4, other] = t * g, 0.0, 0.0, t * g
            rows[5, n], rows[5, other], rows[6, n], rows[6, other] = -x * t * g, -y * t * g, root * rx, root * ry
            n += 2
        equations[:] = 0.0
        add_equations(rows, n, equations, equations[6])
        equations[2, 2] += precision[thing[i]]
        eliminate(equations, kept, info[thing[i]], score[thing[i]])


def _depth_precisions(place: Floats, thing: Ints, n_things: int) -> Floats:
    """How surely the relative depths of a thing's points ``place (M, 2)`` are 1, by its width in the picture: (K,)."""
    n = np.maximum(np.bincount(thing, minlength=n_things), 1)
    mean, square = (
        np.stack([np.bincount(thing, column, n_things) for column in each.T], axis=1) / n[:, None]
        for each in (place, place**2)
    )
    width2 = np.maximum(np.sum(square - mean**2, axis=1), 0.0)
    return np.asarray(1.0 / (_DEPTH_OF_WIDTH**2 * width2 + _LEAST_DEPTH**2))
