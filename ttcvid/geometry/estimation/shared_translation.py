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
from ttcvid.geometry.kernels.solve import eliminate, solve
from ttcvid.model import Floats, Ints

# Things are about so many times as deep as they are wide in the picture, root mean square of both: depths of their
# points, as a part of the depth.
_DEPTH_OF_WIDTH, _LEAST_DEPTH = 2.0, 0.01


def common_velocities(
    points: Points, cam_R_past: Floats, start_hz: Floats, n_steps: int, ahead_sigma_hz: Floats | float = np.inf
) -> tuple[Floats, Floats]:
    """V / Z of each of K things, 1/s, and its information matrix: ``(K, 3)`` and ``(K, 3, 3)``.

    Gauss-Newton with Huber's weights on where the points were seen; place and depth of each point are unknown, too. The
    information includes what is believed.

    Parameters
    ----------
    points : The present view, at the time 0, need not be the last.
    cam_R_past : (L, 3, 3) turns a ray of each view into the present camera.
    start_hz : (K, 3) V / Z to start from.
    ahead_sigma_hz : (K,) the third component is believed to be 0 with this standard deviation, 1/s; infinite: nothing
        is believed of it.
    """
    velocity, info = start_hz.copy(), np.zeros((len(start_hz), 3, 3))
    of_points = points.rays, points.sigma_norm, points.track, points.thing
    believed = np.full(len(info), ahead_sigma_hz) ** -2.0
    _fit_each(of_points, np.ascontiguousarray(cam_R_past), points.since_s, n_steps, believed, velocity, info)
    return velocity, info


@compiled_for(
    "(Tuple((f8[:, :, ::1], f8[::1], i8[::1], i8[::1])), f8[:, :, ::1], f8[::1], i8, f8[::1], f8[:, ::1], "
    "f8[:, :, ::1])"
)
def _fit_each(
    points: tuple[Floats, Floats, Ints, Ints],
    rotations: Floats,
    t_s: Floats,
    n_steps: int,
    believed: Floats,
    velocity_hz: Floats,
    info: Floats,
) -> None:
    """Take the steps of `common_velocities`: ``velocity_hz (K, 3)`` in and out, ``info (K, 3, 3)`` filled.

    ``points``: rays and noise of tracks as in `rigid_motion.Points`, track and thing (M,) of each; ``rotations (L, 3,
    3)`` of the last L views, ``believed (K,)`` information that the third component is 0.
    """
    rays, sigmas, track, thing = points
    rows, equations, kept = np.empty((7, 2 * len(t_s))), np.empty((7, 6)), np.empty((3, 7))
    sums, precision = np.zeros((4, len(info))), np.empty(len(info))
    score, left = np.empty_like(velocity_hz), np.empty((3, 3))
    place, first = np.full((len(thing), 2), np.nan), rays.shape[2] - len(t_s)
    now = first + np.argmin(np.abs(t_s))
    for i in range(len(thing)):
        x, y, z = rays[track[i], 0, now], rays[track[i], 1, now], rays[track[i], 2, now]
        if z > LEAST_FORWARD:
            place[i, 0], place[i, 1], b = x / z, y / z, thing[i]
            sums[0, b] += 1.0
            sums[1, b] += place[i, 0]
            sums[2, b] += place[i, 1]
            sums[3, b] += place[i, 0] ** 2 + place[i, 1] ** 2
    # How surely the relative depths of the points of a thing are 1, by its width in the picture.
    for b in range(len(info)):
        count = max(sums[0, b], 1.0)
        width2 = max(sums[3, b] / count - (sums[1, b] ** 2 + sums[2, b] ** 2) / count**2, 0.0)
        precision[b] = 1.0 / (_DEPTH_OF_WIDTH**2 * width2 + _LEAST_DEPTH**2)
    for _ in range(n_steps):
        info[:], score[:] = 0.0, 0.0
        for i in range(len(thing)):
            if np.isnan(place[i, 0]):
                continue
            along_x, along_y, ahead = velocity_hz[thing[i], 0], velocity_hz[thing[i], 1], velocity_hz[thing[i], 2]
            n, m, sigma = 0, track[i], sigmas[track[i]]
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
        for b in range(len(info)):
            info[b, 2, 2] += believed[b]
            score[b, 2] -= believed[b] * velocity_hz[b, 2]
            for c in range(3):
                for d in range(c):
                    info[b, d, c] = info[b, c, d]
            left[:] = info[b]
            # NaN where nothing is told.
            if solve(left, score[b]) >= 0.0:
                velocity_hz[b] += score[b]
