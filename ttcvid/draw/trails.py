"""Tracks with the way that they have come, coloured by cluster."""

from __future__ import annotations

import cv2
import numpy as np

from ttcvid.draw.palette import SCENE, UNASSIGNED, Colour, object_colour, object_colours
from ttcvid.geometry.compiled import compiled
from ttcvid.model import NO_CLUSTER, SCENE_CLUSTER, Floats, Ints, Picture, TrackRows

_SUBPIXEL_BITS = 3  # OpenCV draws between pixels when coordinates are shifted
_UNASSIGNED_POSITIONS = 2  # tracks of no cluster show their last step only
# Lines go through every second position: paths are smooth, and thick lines are most of what a picture takes to draw.
_LINE_STEP = 2


class Trails:
    """The last positions of the live tracks.

    ``positions_px`` is ``(N, trail_frames + 1, 2)``, the newest first; a young track repeats its oldest position.
    """

    def __init__(self, trail_frames: int) -> None:
        self._n_positions = trail_frames + 1
        self._track_id: Ints = np.zeros(0, dtype=np.int64)
        self.positions_px: Floats = np.zeros((0, self._n_positions, 2))

    def follow(self, tracks: TrackRows) -> None:
        """Take in the tracks of the next frame."""
        positions = np.repeat(tracks.xy_px[:, None, :], self._n_positions, axis=1)
        if len(self._track_id):
            place = np.minimum(np.searchsorted(self._track_id, tracks.track_id), len(self._track_id) - 1)
            is_old = self._track_id[place] == tracks.track_id
            positions[is_old, 1:] = self.positions_px[place[is_old], :-1]
        self._track_id, self.positions_px = tracks.track_id, positions

    def draw(self, bgr: Picture, tracks: TrackRows, stroke_px: int) -> None:
        """Draw all tracks, objects last and with the full trail, so that they stand out from the scene."""
        fixed_point = np.round(self.positions_px * (1 << _SUBPIXEL_BITS)).astype(np.int32)
        is_loose = tracks.cluster_id == NO_CLUSTER
        _draw_lines(bgr, fixed_point[is_loose, :_UNASSIGNED_POSITIONS], UNASSIGNED, 1)
        is_scene = tracks.cluster_id == SCENE_CLUSTER
        _draw_lines(bgr, fixed_point[is_scene, : (self._n_positions + 1) // 2 : _LINE_STEP], SCENE, 1)
        is_object = ~is_loose & ~is_scene
        for cluster_id in np.unique(tracks.cluster_id[is_object]).tolist():
            way = fixed_point[tracks.cluster_id == cluster_id, ::_LINE_STEP]
            _draw_lines(bgr, way, object_colour(cluster_id), stroke_px)
        _draw_dots(bgr, tracks.xy_px[is_object], tracks.cluster_id[is_object], stroke_px + 1)


def _draw_lines(bgr: Picture, fixed_point: np.ndarray, colour: Colour, stroke_px: int) -> None:
    if len(fixed_point):
        cv2.polylines(
            bgr, list(np.ascontiguousarray(fixed_point)), False, colour, stroke_px, cv2.LINE_8, _SUBPIXEL_BITS
        )


def _draw_dots(bgr: Picture, xy_px: Floats, cluster_id: Ints, side_px: int) -> None:
    """Squares of ``side_px`` in the colours of their objects, all at once."""
    corner = np.round(xy_px).astype(np.int64) - side_px // 2
    _fill_squares(bgr, corner, object_colours(cluster_id), side_px)


@compiled
def _fill_squares(bgr: Picture, corner: Ints, colour: Picture, side_px: int) -> None:
    """Fills squares from their upper left corners ``(N, 2)`` on, as far as they lie in the picture."""
    height, width = bgr.shape[:2]
    for i in range(len(corner)):
        for y in range(max(corner[i, 1], 0), min(corner[i, 1] + side_px, height)):
            for x in range(max(corner[i, 0], 0), min(corner[i, 0] + side_px, width)):
                for channel in range(3):
                    bgr[y, x, channel] = colour[i, channel]
