"""The annotated picture of one frame."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from ttcvid.draw.directions import draw_directions, draw_epipoles, draw_horizon
from ttcvid.draw.lettering import Lettering, cap_height_px
from ttcvid.draw.palette import BLACK, WARNING, object_colour
from ttcvid.draw.panels import Panels, box_in_pixels
from ttcvid.draw.trails import Trails
from ttcvid.draw.wording import Urgency, by_urgency, urgency_of
from ttcvid.model import Camera, ClusterRow, FrameResult, ImageSize, Picture

# More epipoles and arrows than this cannot be told apart at a glance; the most urgent objects keep theirs.
MAX_DIRECTIONS = 6


class OverlayPainter:
    """Draws results into the pictures they belong to; keeps the last positions of the tracks for their trails.

    Parameters
    ----------
    camera
        Projects epipoles, arrows and the horizon into the (distorted) picture.
    image_size
        Size of all pictures; letters and strokes follow it.
    trail_frames
        Length of the trails in frames.
    is_smooth
        Whether estimates use later frames too: said beside the clock.
    """

    def __init__(self, camera: Camera, image_size: ImageSize, trail_frames: int, is_smooth: bool = False) -> None:
        self._camera = camera
        self._image_size = image_size
        self._trails = Trails(trail_frames)
        self._letters = Lettering(cap_height_px(image_size))
        self._panels = Panels(self._letters)
        self._is_smooth = is_smooth

    def paint(self, bgr: Picture, result: FrameResult) -> Picture:
        """Draw ``result`` into ``bgr`` ``(H, W, 3)`` uint8, in place, and return it. Frames have to come in order."""
        size = self._image_size
        if bgr.shape != (size.height_px, size.width_px, 3):
            raise ValueError(f"expected a picture of {size} with 3 channels, got shape {bgr.shape}")
        unit_px = self._letters.cap_px
        self._trails.follow(result.tracks)
        self._trails.draw(bgr, result.tracks, stroke_px=max(1, unit_px // 8))
        if result.horizon_px is not None and np.all(np.isfinite(result.horizon_px)):
            draw_horizon(bgr, self._camera, result.horizon_px, unit_px)
        objects = [cluster for cluster in by_urgency(result) if np.all(np.isfinite(cluster.box_px))]
        for cluster in reversed(objects):
            _draw_box(bgr, cluster, urgency_of(cluster, result.events), max(2, unit_px // 6))
        self._draw_motions(bgr, result, objects)
        self._write(bgr, result, objects)
        return bgr

    def _draw_motions(self, bgr: Picture, result: FrameResult, objects: Sequence[ClusterRow]) -> None:
        """One epipole for all clusters that share a motion, that of the scene first among them, and the arrows."""
        unit_px, shown = self._letters.cap_px, objects[:MAX_DIRECTIONS]
        scene = [cluster for cluster in result.clusters if cluster.role == "scene"]
        of_motion: dict[int, ClusterRow] = {}
        for cluster in (*scene, *shown):
            of_motion.setdefault(cluster.motion_id, cluster)
        draw_epipoles(bgr, self._camera, list(of_motion.values()), unit_px)
        draw_directions(bgr, self._camera, shown, unit_px)

    def _write(self, bgr: Picture, result: FrameResult, objects: Sequence[ClusterRow]) -> None:
        panels = self._panels
        panels.begin()
        panels.legend(bgr, result, objects)
        panels.clock(bgr, result, self._is_smooth)
        panels.camera_note(bgr, self._camera)
        panels.banner(bgr, result, objects)
        panels.labels(bgr, result, objects)


def _draw_box(bgr: Picture, cluster: ClusterRow, urgency: Urgency, stroke_px: int) -> None:
    x0, y0, x1, y1 = box_in_pixels(cluster)
    if urgency is Urgency.warned:
        cv2.rectangle(bgr, (x0 - stroke_px, y0 - stroke_px), (x1 + stroke_px, y1 + stroke_px), WARNING, 2 * stroke_px)
    else:
        cv2.rectangle(bgr, (x0, y0), (x1, y1), BLACK, stroke_px + 2)
    cv2.rectangle(bgr, (x0, y0), (x1, y1), object_colour(cluster.cluster_id), stroke_px)
