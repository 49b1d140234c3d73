"""What is fixed to the camera: dirt on the lens, a reflection in the windscreen, blocks that a codec copies.

It stays on its pixels while the world passes by. So does a car ahead at our own speed; but every bump and every stroke
of the wheel turns the camera, and that moves the car in the picture. Of a camera that does not turn nobody can tell.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.rotation import turned_into_plane
from ttcvid.model import Bools, Floats
from ttcvid.stages.segmentation.body_views import BodyViews
from ttcvid.stages.tracking.tracker import COMMON_ERROR_PX

FOLLOWS = 1.0
"""A track that stays on its pixel can be of a mover if it follows the turns of the camera at these log odds."""
# Least number of views of a track that stays.
_LEAST_VIEWS = 3
# Keeps the fit of a parabola to three views regular.
_TINY = 1e-9


def ride_odds(views: BodyViews, cam_R_past: Floats) -> Floats:
    """Log odds ``(N,)`` that each track is fixed to the camera, which has turned by ``cam_R_past (L, 3, 3)`` since each
    view.

    Minus infinity for tracks that leave their pixel: their places scatter about the mean by more than tracks err by in
    common (`COMMON_ERROR_PX`, root mean square of a coordinate). Of the others, the places as seen and the places
    without the rotations of the camera are compared: those that scatter less about a parabola over time are the
    smoother ones, and tell which of the two does not move. Without turns, or with three views, the odds are 0.
    """
    xy = views.rays[:, :, :2] / views.rays[:, :, 2:]
    is_seen = np.isfinite(xy[:, :, 0])
    n_views = is_seen.sum(axis=0)
    off = _without_mean(xy, is_seen)
    variance = (off * off).sum(axis=(0, 2)) / np.maximum(2 * (n_views - 1), 1)
    stays = (n_views >= _LEAST_VIEWS) & (variance < (COMMON_ERROR_PX * views.plane_per_px) ** 2)
    odds, some = np.full(len(stays), -np.inf), np.flatnonzero(stays)
    if len(some):
        is_seen = is_seen[:, some]
        turned = _without_mean(turned_into_plane(views.rays[:, some], cam_R_past), is_seen)
        as_seen, as_turned = (_about_parabola(places, is_seen, views.since_s) for places in (off[:, some], turned))
        odds[some] = 0.5 * (as_turned - as_seen) / views.sigma_norm[some] ** 2
    return odds


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
