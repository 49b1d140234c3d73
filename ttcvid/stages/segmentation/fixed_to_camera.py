"""What is fixed to the camera: dirt on the lens, a reflection in the windscreen, blocks that a codec copies.

It stays on its pixels while the world passes by. So does a car ahead at our own speed: but the turns of the camera,
of every bump and every stroke of the wheel, move that in the picture.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.rotation import turned_into_plane
from ttcvid.model import Bools, Floats
from ttcvid.stages.segmentation.body_views import BodyViews
from ttcvid.stages.tracking.tracker import COMMON_ERROR_PX

# Least number of views that tell.
_LEAST_VIEWS = 3
# A track follows the turns of the camera if that is likelier than that it stays by this log odds.
_FOLLOWS = 1.0
# Keeps the fit of a parabola to few views regular.
_TINY = 1e-9


def ride_along(views: BodyViews, cam_R_past: Floats) -> Bools:
    """Which tracks ``(N,)`` are fixed to the camera, by its rotations ``cam_R_past (L, 3, 3)`` since each view.

    Their places scatter about a pixel by less than tracks err by in common (`COMMON_ERROR_PX`, root mean square of a
    coordinate), and follow no turn: of the two, the places and the places without the rotations of the camera, those
    that scatter less about a parabola over time are the smooth ones.
    """
    xy = views.rays[:, :, :2] / views.rays[:, :, 2:]
    is_seen = np.isfinite(xy[:, :, 0])
    n_views = is_seen.sum(axis=0)
    off = _without_mean(xy, is_seen)
    variance = (off * off).sum(axis=(0, 2)) / np.maximum(2 * (n_views - 1), 1)
    rides = (n_views >= _LEAST_VIEWS) & (variance < (COMMON_ERROR_PX / views.focal_px) ** 2)
    some = np.flatnonzero(rides)
    if len(some):
        is_seen = is_seen[:, some]
        turned = _without_mean(turned_into_plane(views.rays[:, some], cam_R_past), is_seen)
        scatter = [_about_parabola(places, is_seen, views.since_s) for places in (off[:, some], turned)]
        rides[some] = scatter[0] - scatter[1] < 2.0 * _FOLLOWS * views.sigma_norm[some] ** 2
    return np.asarray(rides)


def _without_mean(xy: Floats, is_seen: Bools) -> Floats:
    """Places ``(L, N, 2)`` less the mean of each track over the views in which it ``is_seen (L, N)``; 0 elsewhere."""
    xy = np.where(is_seen[:, :, None], xy, 0.0)
    mean = xy.sum(axis=0) / np.maximum(is_seen.sum(axis=0), 1)[:, None]
    return np.where(is_seen[:, :, None], xy - mean, 0.0)


def _about_parabola(xy: Floats, is_seen: Bools, since_s: Floats) -> Floats:
    """Sum of squares ``(N,)`` of places ``(L, N, 2)`` about a parabola over the times ``since_s (L,)``."""
    powers = np.vander(2.0 * since_s / min(float(since_s[0]), -_TINY) - 1.0, 3)
    normal = np.einsum("li,ln,lj->nij", powers, is_seen.astype(float), powers) + _TINY * np.eye(3)
    terms = np.linalg.solve(normal, np.einsum("li,lnk->nik", powers, xy))
    left = np.where(is_seen[:, :, None], xy - np.einsum("li,nik->lnk", powers, terms), 0.0)
    return np.asarray((left * left).sum(axis=(0, 2)))
