"""The aperture problem: windows on an edge, which slip along it.

Where the picture has gradients in one direction only, a tracker's window is located across the edge, and along it only
by what else it contains: the leaves behind a railing, the next of many equal bars. Neighbours on the same edge slip
alike, at a velocity of none of the surfaces there.
"""

from __future__ import annotations

import numpy as np

from ttcvid.model import Bools, Floats

# A window is on an edge where its gradients along it (r.m.s.) are less than this part of those across it: its
# position along the edge is that much less certain.
_ALONG_PART = 0.5
# The same as length of `PointSet.edge`.
_LEAST_EDGE = (1.0 - _ALONG_PART**2) / (1.0 + _ALONG_PART**2)


def may_slip(edge: Floats, xy: Floats, path: Floats, sigma_norm: Floats, gate: float) -> Bools:
    """Which tracks ``(M,)`` may be points of the static scene that slip along their edges.

    They are on an edge, some depth explains their motion across it, and along it they move the way of the scene, at any
    speed: whatever else the window contains is static too, at another depth. What moves the other way moves by itself.

    Parameters
    ----------
    edge : ``(M, 2)`` as in `PointSet`.
    xy : ``(L, M, 2)`` positions in the plane z = 1 of the present camera, in at least three views, NaN in others.
    path : ``(L, 3)`` of the scene, as in `RigidPaths`.
    sigma_norm : ``(M,)`` standard deviation of one coordinate of a position.
    gate : reduced chi-square below which a depth explains a track.
    """
    angle = 0.5 * np.arctan2(edge[:, 1], edge[:, 0])
    across = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    variance, _ = _one_coordinate(xy, path, across)
    _, is_with_scene = _one_coordinate(xy, path, np.stack([-across[:, 1], across[:, 0]], axis=-1))
    is_edge = np.hypot(edge[:, 0], edge[:, 1]) > _LEAST_EDGE
    return np.asarray(is_edge & (variance < gate * sigma_norm**2) & is_with_scene)


def _one_coordinate(xy: Floats, path: Floats, axis: Floats) -> tuple[Floats, Bools]:
    """Tracks (M,) along their axes (M, 2): variance about their best place and rate, and whether that rate is positive.

    A point at (x, y, 1) now was at ``s = (s0 + rho T_s) / (1 + rho T_z)`` on an axis: ``s = s0 + rho (T_s - s T_z)``.
    """
    place = np.einsum("lma,ma->lm", xy, axis)
    lever = path[:, :2] @ axis.T - place * path[:, 2:]
    is_seen = np.isfinite(place)
    n_views = is_seen.sum(axis=0)
    place, lever = (np.where(is_seen, values, 0.0) for values in (place, lever))
    place, lever = (np.where(is_seen, values - values.sum(axis=0) / n_views, 0.0) for values in (place, lever))
    along, lever2 = (place * lever).sum(axis=0), (lever * lever).sum(axis=0)
    rate = np.maximum(along, 0.0) / np.maximum(lever2, np.finfo(np.float64).tiny)
    variance = ((place - rate * lever) ** 2).sum(axis=0) / np.maximum(n_views - 2, 1)
    return variance, along > 0.0
