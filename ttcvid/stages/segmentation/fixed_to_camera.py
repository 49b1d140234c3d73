"""What is fixed to the camera: dirt on the lens, a reflection in the windscreen, blocks that a codec copies.

It stays on its pixels while the world passes by. So does a car ahead at our own speed; but every bump and every stroke
of the wheel turns the camera, and that moves the car in the picture. Of a camera that does not turn nobody can tell.
"""

from __future__ import annotations

import numpy as np

from ttcvid.compiled import ZERO, compiled_for
from ttcvid.geometry.kernels.normal_equations import product
from ttcvid.geometry.kernels.path_point import LEAST_FORWARD
from ttcvid.model import Floats
from ttcvid.stages.segmentation.body_views import BodyViews
from ttcvid.stages.tracking.tracker import COMMON_ERROR_PX

FOLLOWS = 1.0
"""A track that stays on its pixel can be of a mover if it follows the turns of the camera at these log odds."""
# What scatters by less than this about its mean stays on its pixel (root mean square of a coordinate), where the scene
# passes: tracks on the rim of a spot are drawn along by what is behind it, by 0.1 px a frame.
_STAYS_PX = 0.5
# Least number of views of a track that stays.
_LEAST_VIEWS = 3
# Keeps the fit of a parabola to three views regular.
_TINY = 1e-9


def ride_odds(views: BodyViews, cam_R_past: Floats, *, scene_passes: bool = True) -> Floats:
    """Log odds ``(N,)`` that each track is fixed to the camera, turned by ``cam_R_past (L, 3, 3)`` since each view.

    Minus infinity for tracks that leave their pixel: by `_STAYS_PX` where the scene passes, else by what tracks err by
    in common. Of the others, the places as seen and the places without the rotations of the camera are compared: those
    that scatter less about a parabola over time are the smoother ones, and tell which of the two does not move. Without
    turns, or with three views, the odds are 0.
    """
    stays_px = _STAYS_PX if scene_passes else COMMON_ERROR_PX
    odds, scatter = np.full(len(views.sigma_norm), -np.inf), (stays_px * views.plane_per_px) ** 2
    powers = np.vander(2.0 * views.since_s / min(float(views.since_s[0]), -_TINY) - 1.0, 3)
    _fill_odds(views.rays_by_track, np.ascontiguousarray(cam_R_past), powers, scatter, views.sigma_norm, odds)
    return odds


@compiled_for("(f8[:, :, ::1], f8[:, :, ::1], f8[:, ::1], f8[::1], f8[::1], f8[::1])")
def _fill_odds(rays: Floats, rotations: Floats, powers: Floats, scatter: Floats, sigma: Floats, odds: Floats) -> None:
    """Fill ``odds (N,)`` of tracks whose places vary by less than ``scatter (N,)``, the square of a coordinate.

    ``rays (N, 3, M)`` as of `views_by_track`, ``rotations (L, 3, 3)``, ``powers (L, 3)`` of time, ``sigma (N,)``.
    """
    n_views = len(rotations)
    # Rows: three powers of time, places as seen, and turned, both less the mean of those as seen.
    seen, rows, first = np.empty(n_views, dtype=np.int64), np.empty((7, n_views)), rays.shape[2] - n_views
    for i in range(len(odds)):
        n, mean_x, mean_y, square = 0, 0.0, 0.0, 0.0
        for k in range(n_views):
            x, y = rays[i, 0, first + k] / rays[i, 2, first + k], rays[i, 1, first + k] / rays[i, 2, first + k]
            if np.isfinite(x):
                seen[n], rows[3, n], rows[4, n] = k, x, y
                mean_x, mean_y, n = mean_x + x, mean_y + y, n + 1
        mean_x, mean_y = mean_x / max(n, 1), mean_y / max(n, 1)
        for j in range(n):
            rows[3, j], rows[4, j] = rows[3, j] - mean_x, rows[4, j] - mean_y
            square += rows[3, j] ** 2 + rows[4, j] ** 2
        if n < _LEAST_VIEWS or not square < 2 * (n - 1) * scatter[i]:
            continue
        for j in range(n):
            k = seen[j]
            p, q, r = rays[i, 0, first + k], rays[i, 1, first + k], rays[i, 2, first + k]
            depth = rotations[k, 2, 0] * p + rotations[k, 2, 1] * q + rotations[k, 2, 2] * r
            depth = depth if depth > LEAST_FORWARD else np.nan
            rows[5, j] = (rotations[k, 0, 0] * p + rotations[k, 0, 1] * q + rotations[k, 0, 2] * r) / depth - mean_x
            rows[6, j] = (rotations[k, 1, 0] * p + rotations[k, 1, 1] * q + rotations[k, 1, 2] * r) / depth - mean_y
            rows[0, j], rows[1, j], rows[2, j] = powers[k, 0], powers[k, 1], powers[k, 2]
        # Each column takes its part out of those that follow.
        for c in range(3):
            own = _TINY + product(rows, c, c, ZERO, n)
            for d in range(c + 1, 7):
                part = product(rows, c, d, ZERO, n) / own
                for j in range(n):
                    rows[d, j] -= part * rows[c, j]
        as_seen = product(rows, 3, 3, ZERO, n) + product(rows, 4, 4, ZERO, n)
        as_turned = product(rows, 5, 5, ZERO, n) + product(rows, 6, 6, ZERO, n)
        odds[i] = 0.5 * (as_turned - as_seen) / sigma[i] ** 2
