"""Directions of motion in the picture: epipoles with their uncertainty, arrows, the horizon."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from ttcvid.draw.palette import BLACK, HORIZON, Colour
from ttcvid.draw.signs import Point, draw_arrow, draw_cross, draw_edge_arrow, draw_ring
from ttcvid.geometry.camera.pinhole import pixels_from_rays, rays_from_pixels
from ttcvid.geometry.rotation import cross
from ttcvid.model import Bools, Camera, ClusterRow, Floats, Picture

# Square root of the 90 % quantile of chi-square with two degrees of freedom: the ellipse holds 90 %.
_SIGMAS_OF_90_PERCENT = 2.146
_ELLIPSE_POINTS = 36
_TURN_RAD = np.linspace(0, 2 * np.pi, _ELLIPSE_POINTS, endpoint=False)
# The least of the three variances belongs to the direction itself, along which nothing is uncertain.
_CIRCLE = np.stack([np.zeros_like(_TURN_RAD), np.cos(_TURN_RAD), np.sin(_TURN_RAD)])
# An ellipse that is longer than this many picture widths says no more than "somewhere".
_LONGEST_ELLIPSE = 0.4
# Below this sine of the angle between ray and motion an object moves along the line of sight: no arrow can show it.
_MIN_SIDEWAYS = 0.06
_SMALL_STEP = 1e-3  # in units of the focal length: over it, the lens does not bend
_HORIZON_PIECES = 60
_HORIZON_REACH = 4.0  # picture widths beyond which a bent horizon is not drawn


def draw_epipoles(
    bgr: Picture, camera: Camera, clusters: Sequence[ClusterRow], colours: Mapping[int, Colour], unit_px: int
) -> None:
    """A cross at each epipole with its 90 % ellipse; where it lies outside, an arrow at the edge that points there.

    The first of ``clusters`` is drawn last, on top. An epipole at infinity is pointed to along the motion. One that
    lies in the picture, but is not known to better than `_LONGEST_ELLIPSE`, is left out.
    """
    height, width = bgr.shape[:2]
    shown = [cluster for cluster in clusters if _has_direction(cluster)][::-1]
    for cluster, ellipse_px in zip(shown, epipole_ellipses_px(camera, shown), strict=True):
        colour = colours[cluster.cluster_id]
        if cluster.epipole_px is None:
            draw_edge_arrow(bgr, _direction_of(cluster)[:2], colour, unit_px)
            continue
        x, y = cluster.epipole_px
        if not (-0.5 <= x <= width - 0.5 and -0.5 <= y <= height - 0.5):
            draw_edge_arrow(bgr, np.array([x - width / 2, y - height / 2]), colour, unit_px)
            continue
        if np.isfinite(ellipse_px).any():
            # Some points of a still longer one lie behind the camera, and are NaN.
            if not np.linalg.norm(np.ptp(ellipse_px, axis=0)) <= _LONGEST_ELLIPSE * width:
                continue
            outline = np.round(ellipse_px).astype(np.int32)
            cv2.polylines(bgr, [outline], True, BLACK, 3, cv2.LINE_AA)
            cv2.polylines(bgr, [outline], True, colour, 1, cv2.LINE_AA)
        draw_cross(bgr, _point(cluster.epipole_px), colour, unit_px)


def epipole_ellipses_px(camera: Camera, clusters: Sequence[ClusterRow]) -> Floats:
    """The 90 % regions of the epipoles of N clusters, ``(N, points, 2)`` pixels.

    NaN where there is no covariance, and for points behind the camera.
    """
    if not clusters:
        return np.zeros((0, _ELLIPSE_POINTS, 2))
    directions = np.array([_direction_of(cluster) for cluster in clusters])
    covariances = np.array([_covariance_of(cluster) for cluster in clusters])
    is_known = np.isfinite(covariances).all(axis=(1, 2))
    variances, axes = np.linalg.eigh(np.where(is_known[:, None, None], covariances, 0.0))
    half_axes = _SIGMAS_OF_90_PERCENT * np.sqrt(np.maximum(variances, 0.0))[:, None, :] * axes
    rays = directions[:, None, :] + (half_axes @ _CIRCLE).transpose(0, 2, 1)
    rays *= np.sign(directions[:, 2])[:, None, None]
    ellipses_px = pixels_from_rays(camera, rays.reshape(-1, 3)).reshape(-1, _ELLIPSE_POINTS, 2)
    ellipses_px[~is_known] = np.nan
    return ellipses_px


def draw_directions(
    bgr: Picture, camera: Camera, clusters: Sequence[ClusterRow], colours: Mapping[int, Colour], unit_px: int
) -> None:
    """Where the picture of each cluster moves, from its reference point; the first of ``clusters`` on top.

    Motion along the line of sight is drawn as physicists do: a ring with a dot comes, a ring with a cross goes.
    """
    shown = [cluster for cluster in clusters if _has_direction(cluster)][::-1]
    if not shown:
        return
    starts_px = np.array([_reference_px(cluster) for cluster in shown])
    directions = np.array([_direction_of(cluster) for cluster in shown])
    flows_px, sideways, is_coming = _flows(camera, starts_px, directions)
    for i, cluster in enumerate(shown):
        colour = colours[cluster.cluster_id]
        if sideways[i] >= _MIN_SIDEWAYS and np.all(np.isfinite(flows_px[i])):
            x0, y0, x1, y1 = cluster.box_px
            longest_px = np.clip(np.hypot(x1 - x0, y1 - y0), 2.5 * unit_px, 6 * unit_px)
            head_px = starts_px[i] + flows_px[i] * max(longest_px * sideways[i], 1.5 * unit_px)
            draw_arrow(bgr, _point(starts_px[i]), _point(head_px), colour, max(2, unit_px // 6))
        elif sideways[i] < _MIN_SIDEWAYS:
            draw_ring(bgr, _point(starts_px[i]), bool(is_coming[i]), colour, unit_px)


def draw_horizon(bgr: Picture, camera: Camera, horizon_px: tuple[float, float], unit_px: int) -> None:
    """The horizon, dashed; it is a line in undistorted pixels and bends with the lens."""
    width = bgr.shape[1]
    x = np.linspace(-0.5 * width, 1.5 * width, _HORIZON_PIECES + 1)
    y = horizon_px[0] + (horizon_px[1] - horizon_px[0]) * x / max(width - 1, 1)
    rays = np.stack([(x - camera.cx_px) / camera.fx_px, (y - camera.cy_px) / camera.fy_px, np.ones_like(x)], axis=1)
    line_px = pixels_from_rays(camera, rays)
    dashes = np.stack([line_px[:-1], line_px[1:]], axis=1)[::2]
    is_near = np.all(np.abs(dashes) < _HORIZON_REACH * width, axis=(1, 2))
    pieces = list(np.round(dashes[is_near]).astype(np.int32))
    cv2.polylines(bgr, pieces, False, HORIZON, max(1, unit_px // 7))


def _flows(camera: Camera, starts_px: Floats, directions: Floats) -> tuple[Floats, Floats, Bools]:
    """Unit vectors ``(N, 2)`` along which points move in the picture, how much of their motion goes across the line
    of sight ``(N,)`` (sine of the angle), and whether they approach ``(N,)``.
    """
    rays = rays_from_pixels(camera, starts_px)
    flows = directions[:, :2] - rays[:, :2] * directions[:, 2:]
    sideways = np.linalg.norm(cross(rays, directions), axis=1) / np.linalg.norm(rays, axis=1)
    ahead = rays.copy()
    ahead[:, :2] += _SMALL_STEP * flows / np.maximum(np.linalg.norm(flows, axis=1, keepdims=True), 1e-12)
    ahead_px = pixels_from_rays(camera, ahead)
    flows_px = ahead_px - starts_px
    lengths_px = np.linalg.norm(flows_px, axis=1, keepdims=True)
    unit_flows = np.divide(flows_px, lengths_px, out=np.full_like(flows_px, np.nan), where=lengths_px > 0)
    return unit_flows, sideways, np.sum(rays * directions, axis=1) < 0


def _has_direction(cluster: ClusterRow) -> bool:
    return cluster.direction is not None and all(map(math.isfinite, cluster.direction))


def _direction_of(cluster: ClusterRow) -> Floats:
    return np.full(3, np.nan) if cluster.direction is None else cluster.direction


def _covariance_of(cluster: ClusterRow) -> Floats:
    return np.full((3, 3), np.nan) if cluster.direction_cov is None else cluster.direction_cov


def _reference_px(cluster: ClusterRow) -> tuple[float, float]:
    if cluster.ref_px is not None and np.all(np.isfinite(cluster.ref_px)):
        return cluster.ref_px
    x0, y0, x1, y1 = cluster.box_px
    return (x0 + x1) / 2, (y0 + y1) / 2


def _point(xy_px: Floats) -> Point:
    return round(float(xy_px[0])), round(float(xy_px[1]))
