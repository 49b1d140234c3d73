"""The annotated picture of one frame."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ttcvid.draw.boxes import draw_box, draw_dashed_box
from ttcvid.draw.directions import draw_directions, draw_epipoles, draw_horizon
from ttcvid.draw.lettering import Lettering, cap_height_px
from ttcvid.draw.palette import WHITE
from ttcvid.draw.panels import Panels
from ttcvid.draw.shown import Shown, ShownObjects
from ttcvid.draw.trails import Trails
from ttcvid.model import SCENE_CLUSTER, Camera, ClusterRow, FrameResult, ImageSize, Picture

# More epipoles and arrows than this cannot be told apart at a glance; the most urgent objects keep theirs.
MAX_DIRECTIONS = 6


class OverlayPainter:
    """Draws results into the pictures they belong to; keeps the last positions of the tracks for their trails.

    Parameters
    ----------
    camera : Projects epipoles, arrows and the horizon into the (distorted) picture.
    image_size : Size of all pictures; letters and strokes follow it.
    trail_frames : Length of the trails in frames.
    is_smooth : Whether estimates use later frames too: said beside the clock.
    told_platform : What carries the camera, decided from the clip: shown beside the clock; empty where it was given.
    """

    def __init__(
        self,
        camera: Camera,
        image_size: ImageSize,
        trail_frames: int,
        is_smooth: bool = False,
        told_platform: str = "",
    ) -> None:
        self._camera = camera
        self._image_size = image_size
        self._trails = Trails(trail_frames)
        self._objects = ShownObjects()
        self._letters = Lettering(cap_height_px(image_size))
        self._panels = Panels(self._letters)
        self._notes = ["smooth"] * is_smooth + [f"{told_platform}, told by the clip"] * bool(told_platform)

    def paint(self, bgr: Picture, result: FrameResult) -> Picture:
        """Draw ``result`` into ``bgr`` ``(H, W, 3)`` uint8, in place, and return it. Frames have to come in order."""
        size = self._image_size
        if bgr.shape != (size.height_px, size.width_px, 3):
            raise ValueError(f"expected a picture of {size} with 3 channels, got shape {bgr.shape}")
        unit_px = self._letters.cap_px
        objects = self._objects.follow(result)
        self._trails.follow(result.tracks)
        self._trails.draw(bgr, result.tracks, self._objects.colours, stroke_px=max(1, unit_px // 8))
        if result.horizon_px is not None and np.all(np.isfinite(result.horizon_px)):
            draw_horizon(bgr, self._camera, result.horizon_px, unit_px)
        stroke_px = max(2, unit_px // 6)
        for one in reversed(objects):
            if one.is_in_view:
                draw_box(bgr, one.box, one.colour, one.urgency, stroke_px)
            else:
                draw_dashed_box(bgr, one.box, stroke_px)
        self._draw_motions(bgr, result, [one.row for one in objects if one.is_in_view])
        self._write(bgr, result, objects)
        return bgr

    def _draw_motions(self, bgr: Picture, result: FrameResult, objects: Sequence[ClusterRow]) -> None:
        """One epipole for all clusters that share a motion, that of the scene first among them, and the arrows."""
        unit_px, shown = self._letters.cap_px, objects[:MAX_DIRECTIONS]
        colours = {**self._objects.colours, SCENE_CLUSTER: WHITE}
        scene = [cluster for cluster in result.clusters if cluster.role == "scene"]
        of_motion: dict[int, ClusterRow] = {}
        for cluster in (*scene, *shown):
            of_motion.setdefault(cluster.motion_id, cluster)
        draw_epipoles(bgr, self._camera, list(of_motion.values()), colours, unit_px)
        draw_directions(bgr, self._camera, shown, colours, unit_px)

    def _write(self, bgr: Picture, result: FrameResult, objects: Sequence[Shown]) -> None:
        panels = self._panels
        panels.begin()
        panels.clock(bgr, result, self._notes)
        panels.camera_note(bgr, self._camera)
        panels.banner(bgr, result, objects)
        panels.legend(bgr, objects)
        panels.labels(bgr, objects)
