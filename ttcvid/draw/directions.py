"""Directions of motion in the picture: epipoles with their uncertainty, arrows, the horizon."""

from __future__ import annotations

import cv2
import numpy as np

from ttcvid.draw.palette import BLACK, HORIZON, Colour
from ttcvid.geometry.camera import pixels_from_rays, rays_from_pixels
from ttcvid.model import Camera, ClusterRow, Floats, Picture

# Square root of the 90 % quantile of chi-square with two degrees of freedom: the ellipse holds 90 %.
_SIGMAS_OF_90_PERCENT = 2.146
_ELLIPSE_POINTS = 36
# An ellipse that reaches further out than this many picture sides says no more than "somewhere".
_ELLIPSE_REACH = 1.0
# Below this sine of the angle between ray and motion a thing moves along the line of sight: no arrow can show it.
_MIN_SIDEWAYS = 0.06
_HORIZON_POINTS = 24
_DASH = 2  # every second piece of the horizon is drawn


def draw_epipole(bgr: Picture, camera: Camera, cluster: ClusterRow, colour: Colour, unit_px: int) -> None:
    """A cross at the epipole with its 90 % ellipse; where it lies outside, an arrow at the edge that points there."""
    if cluster.direction is None or not np.all(np.isfinite(cluster.direction)):
        return
    height, width = bgr.shape[:2]
    if cluster.epipole_px is None:
        _draw_edge_arrow(bgr, cluster.direction[:2], colour, unit_px)
        return
    x, y = cluster.epipole_px
    if not (-0.5 <= x <= width - 0.5 and -0.5 <= y <= height - 0.5):
        _draw_edge_arrow(bgr, np.array([x - width / 2, y - height / 2]), colour, unit_px)
        return
    ellipse = epipole_ellipse_px(camera, cluster)
    if ellipse is not None and np.all(np.abs(ellipse - [width / 2, height / 2]) < (0.5 + _ELLIPSE_REACH) * width):
        outline = np.round(ellipse).astype(np.int32)
        cv2.polylines(bgr, [outline], True, BLACK, 3, cv2.LINE_AA)
        cv2.polylines(bgr, [outline], True, colour, 1, cv2.LINE_AA)
    _draw_cross(bgr, (round(float(x)), round(float(y))), colour, unit_px)


def epipole_ellipse_px(camera: Camera, cluster: ClusterRow) -> Floats | None:
    """The 90 % region of an epipole, ``(N, 2)`` pixels; None where unknown or reaching behind the camera."""
    direction, covariance = cluster.direction, cluster.direction_cov
    if direction is None or covariance is None or not np.all(np.isfinite(covariance)):
        return None
    variances, axes = np.linalg.eigh(covariance)
    half_axes = _SIGMAS_OF_90_PERCENT * np.sqrt(np.maximum(variances[1:], 0.0)) * axes[:, 1:]
    turn = np.linspace(0, 2 * np.pi, _ELLIPSE_POINTS, endpoint=False)
    rays = direction + np.cos(turn)[:, None] * half_axes[:, 0] + np.sin(turn)[:, None] * half_axes[:, 1]
    ellipse = pixels_from_rays(camera, rays * np.sign(direction[2]))
    return ellipse if np.all(np.isfinite(ellipse)) else None


def draw_direction(bgr: Picture, camera: Camera, cluster: ClusterRow, colour: Colour, unit_px: int) -> None:
    """Where a cluster's picture moves, from its reference point.

    Motion along the line of sight is drawn as physicists do: a ring with a dot comes, a ring with a cross goes.
    """
    if cluster.direction is None or not np.all(np.isfinite(cluster.direction)):
        return
    start = _reference_px(cluster)
    ray = rays_from_pixels(camera, start[None])[0]
    sideways = np.linalg.norm(np.cross(ray, cluster.direction)) / np.linalg.norm(ray)
    flow_px = _flow_direction_px(camera, start, ray, cluster.direction)
    tail = (round(start[0]), round(start[1]))
    if sideways < _MIN_SIDEWAYS or flow_px is None:
        _draw_ring(bgr, tail, bool(ray @ cluster.direction < 0), colour, unit_px)
        return
    x0, y0, x1, y1 = cluster.box_px
    longest_px = np.clip(np.hypot(x1 - x0, y1 - y0), 2.5 * unit_px, 6 * unit_px)
    head = start + flow_px * max(longest_px * sideways, 1.5 * unit_px)
    _draw_arrow(bgr, tail, (round(head[0]), round(head[1])), colour, max(2, unit_px // 6))


def draw_top_view(bgr: Picture, direction: Floats, centre: tuple[int, int], colour: Colour, unit_px: int) -> None:
    """A small arrow that shows a direction from above: up is away from the camera, down is towards it."""
    sideways, away = float(direction[0]), float(direction[2])
    length = max(float(np.hypot(sideways, away)), 1e-9)
    step = np.array([sideways, -away]) / length * unit_px * 0.6
    tail, head = np.round(np.array(centre) - step), np.round(np.array(centre) + step)
    stroke_px = max(1, unit_px // 7)
    cv2.arrowedLine(bgr, _point(tail), _point(head), colour, stroke_px, cv2.LINE_AA, tipLength=0.45)


def draw_horizon(bgr: Picture, camera: Camera, horizon_px: tuple[float, float], unit_px: int) -> None:
    """The horizon, dashed; it is a line in undistorted pixels and bends with the lens."""
    width = bgr.shape[1]
    x = np.linspace(-0.5 * width, 1.5 * width, 4 * _HORIZON_POINTS + 1)
    y = horizon_px[0] + (horizon_px[1] - horizon_px[0]) * x / max(width - 1, 1)
    rays = np.stack([(x - camera.cx_px) / camera.fx_px, (y - camera.cy_px) / camera.fy_px, np.ones_like(x)], axis=1)
    line = pixels_from_rays(camera, rays)
    pieces = np.stack([line[:-1], line[1:]], axis=1)[::_DASH]
    is_near = np.all(np.isfinite(pieces) & (np.abs(pieces) < 4 * width), axis=(1, 2))
    cv2.polylines(
        bgr, list(np.round(pieces[is_near]).astype(np.int32)), False, HORIZON, max(1, unit_px // 7), cv2.LINE_AA
    )


def _reference_px(cluster: ClusterRow) -> Floats:
    if cluster.ref_px is not None:
        return np.array(cluster.ref_px)
    x0, y0, x1, y1 = cluster.box_px
    return np.array([(x0 + x1) / 2, (y0 + y1) / 2])


def _flow_direction_px(camera: Camera, start_px: Floats, ray: Floats, direction: Floats) -> Floats | None:
    """Unit vector in the picture along which a point on ``ray`` moves when it goes in ``direction``."""
    flow = direction[:2] - ray[:2] * direction[2]
    small_step = 1e-3 * flow / max(float(np.linalg.norm(flow)), 1e-12)
    ahead_px = pixels_from_rays(camera, np.append(ray[:2] + small_step, 1.0)[None])[0]
    length = float(np.linalg.norm(ahead_px - start_px))
    return (ahead_px - start_px) / length if np.isfinite(length) and length > 0 else None


def _draw_cross(bgr: Picture, centre: tuple[int, int], colour: Colour, unit_px: int) -> None:
    size, stroke_px = round(1.6 * unit_px), max(2, unit_px // 7)
    cv2.drawMarker(bgr, centre, BLACK, cv2.MARKER_CROSS, size + 4, stroke_px + 2)
    cv2.drawMarker(bgr, centre, colour, cv2.MARKER_CROSS, size, stroke_px)


def _draw_ring(bgr: Picture, centre: tuple[int, int], is_coming: bool, colour: Colour, unit_px: int) -> None:
    radius, stroke_px = round(0.8 * unit_px), max(2, unit_px // 7)
    for ink, extra_px in ((BLACK, 2), (colour, 0)):
        cv2.circle(bgr, centre, radius, ink, stroke_px + extra_px, cv2.LINE_AA)
        if is_coming:
            cv2.circle(bgr, centre, radius // 3 + extra_px // 2, ink, cv2.FILLED, cv2.LINE_AA)
        else:
            cv2.drawMarker(bgr, centre, ink, cv2.MARKER_TILTED_CROSS, radius, stroke_px + extra_px)


def _draw_arrow(bgr: Picture, tail: tuple[int, int], head: tuple[int, int], colour: Colour, stroke_px: int) -> None:
    cv2.arrowedLine(bgr, tail, head, BLACK, stroke_px + 2, cv2.LINE_AA, tipLength=0.35)
    cv2.arrowedLine(bgr, tail, head, colour, stroke_px, cv2.LINE_AA, tipLength=0.35)


def _draw_edge_arrow(bgr: Picture, towards: Floats, colour: Colour, unit_px: int) -> None:
    """A triangle where the line from the middle of the picture in a direction leaves it."""
    height, width = bgr.shape[:2]
    length = float(np.linalg.norm(towards))
    if not length > 0:
        return
    unit = towards / length
    half = np.array([width, height]) / 2
    with np.errstate(divide="ignore"):
        reach = float(np.min(half / np.abs(unit)))
    tip = half + unit * (reach - 2)
    across = np.array([-unit[1], unit[0]])
    base = tip - unit * 1.3 * unit_px
    triangle = np.round([tip, base + across * 0.7 * unit_px, base - across * 0.7 * unit_px]).astype(np.int32)
    cv2.fillPoly(bgr, [triangle], colour, cv2.LINE_AA)
    cv2.polylines(bgr, [triangle], True, BLACK, 1, cv2.LINE_AA)


def _point(values: np.ndarray) -> tuple[int, int]:
    return int(values[0]), int(values[1])
