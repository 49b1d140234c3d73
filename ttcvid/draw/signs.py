"""The signs of the annotated picture: each in its colour on a black outline, so that it shows on any ground."""

from __future__ import annotations

import cv2
import numpy as np

from ttcvid.draw.palette import BLACK, Colour
from ttcvid.model import Floats, Picture

Point = tuple[int, int]


def draw_cross(bgr: Picture, centre: Point, colour: Colour, unit_px: int) -> None:
    """An epipole."""
    size, stroke_px = round(1.6 * unit_px), max(2, unit_px // 7)
    cv2.drawMarker(bgr, centre, BLACK, cv2.MARKER_CROSS, size + 4, stroke_px + 2)
    cv2.drawMarker(bgr, centre, colour, cv2.MARKER_CROSS, size, stroke_px)


def draw_ring(bgr: Picture, centre: Point, is_coming: bool, colour: Colour, unit_px: int) -> None:
    """Motion along the line of sight: the tip of an arrow that comes, or the feathers of one that goes."""
    radius, stroke_px = round(0.8 * unit_px), max(2, unit_px // 7)
    for ink, extra_px in ((BLACK, 2), (colour, 0)):
        cv2.circle(bgr, centre, radius, ink, stroke_px + extra_px, cv2.LINE_AA)
        if is_coming:
            cv2.circle(bgr, centre, radius // 3 + extra_px // 2, ink, cv2.FILLED, cv2.LINE_AA)
        else:
            cv2.drawMarker(bgr, centre, ink, cv2.MARKER_TILTED_CROSS, radius, stroke_px + extra_px)


def draw_arrow(bgr: Picture, tail: Point, head: Point, colour: Colour, stroke_px: int) -> None:
    """Motion across the picture."""
    cv2.arrowedLine(bgr, tail, head, BLACK, stroke_px + 2, cv2.LINE_AA, tipLength=0.35)
    cv2.arrowedLine(bgr, tail, head, colour, stroke_px, cv2.LINE_AA, tipLength=0.35)


def draw_top_view(bgr: Picture, direction: Floats, centre: Point, colour: Colour, unit_px: int) -> None:
    """A direction ``(3,)`` seen from above: up is away from the camera, down is towards it."""
    sideways, away = float(direction[0]), float(direction[2])
    scale = 0.6 * unit_px / max(float(np.hypot(sideways, away)), 1e-9)
    dx, dy = round(sideways * scale), round(-away * scale)
    tail, head = (centre[0] - dx, centre[1] - dy), (centre[0] + dx, centre[1] + dy)
    cv2.arrowedLine(bgr, tail, head, colour, max(1, unit_px // 7), cv2.LINE_AA, tipLength=0.45)


def draw_edge_arrow(bgr: Picture, towards: Floats, colour: Colour, unit_px: int) -> None:
    """A triangle where the line from the middle of the picture in a direction ``(2,)`` leaves it."""
    height, width = bgr.shape[:2]
    length = float(np.linalg.norm(towards))
    if not (np.isfinite(length) and length > 0):
        return
    unit = towards / length
    half = np.array([width, height]) / 2
    reach = float(np.min(half / np.maximum(np.abs(unit), 1e-9)))
    tip = half + unit * (reach - 2)
    across = np.array([-unit[1], unit[0]]) * 0.7 * unit_px
    base = tip - unit * 1.3 * unit_px
    triangle = np.round([tip, base + across, base - across]).astype(np.int32)
    cv2.fillPoly(bgr, [triangle], colour, cv2.LINE_AA)
    cv2.polylines(bgr, [triangle], True, BLACK, 1, cv2.LINE_AA)
