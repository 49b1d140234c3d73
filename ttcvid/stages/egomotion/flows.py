"""The derotated flow of every track over a frame gap that grows until the flow is long enough.

The paper calls it the flexible baseline: the second picture is taken later when the flow is short.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.geometry.compiled import compiled_for
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.tracking.history import ROTATION_DRIFT_RAD, TrackHistory

# Error of a matched position per pixel of flow: the patch changes its scale and slant on the way. Measured on
# kitti_odom_straight50: residual 0.07 px at flows under 2 px, 0.16 px at 45 px.
_ERROR_PER_FLOW = 0.0035


@dataclass(frozen=True)
class Flows:
    """Flow of N tracks up to the present frame, with the camera's rotation removed.

    ``first, second (N, 3)`` unit rays in the present camera: ``first`` is NaN for a track of one observation, both
    where the present position lies outside of what the lens model maps; ``gap_frames (N,)`` steps of the history
    between them (0: none); ``gap_s (N,)``; ``sigma_rad (N,)`` noise of one coordinate of a ray, including the error of
    the last rotation, NaN without a present ray; ``rotation_error_rad (N,)`` error of the rotation over the gap, per
    axis and common to all tracks of one gap.
    """

    first: Floats
    second: Floats
    gap_frames: Ints
    gap_s: Floats
    sigma_rad: Floats
    rotation_error_rad: Floats

    @property
    def has_flow(self) -> Bools:
        """Tracks with two rays, one of them the present one: (N,)."""
        return self.gap_frames > 0


def select_flows(history: TrackHistory, max_gap_frames: int, target_flow_px: float) -> Flows:
    """Flow of each track over the smallest gap with ``target_flow_px`` of it, else over the largest available gap.

    Parameters
    ----------
    history
        Views of the tracks.
    max_gap_frames
        Largest gap, in views of the history.
    target_flow_px
        Length of flow that ends the search.

    Source: the paper's flexible baseline.
    """
    n = history.n_tracks
    first, gap_frames, sigma_rad = np.full((n, 3), np.nan), np.zeros(n, dtype=np.int64), np.empty(n)
    max_gap = min(max_gap_frames, len(history.frame) - 1)
    target_rad = target_flow_px / history.focal_px
    # The rotation's error moves one end of the flow; it is shared out to both.
    turn_rad = history.rotation_sigma_rad / np.sqrt(2.0)
    _select(
        history.rays,
        history.cam_R_past,
        max_gap,
        target_rad,
        turn_rad,
        history.sigma_rad,
        first,
        gap_frames,
        sigma_rad,
    )
    gap_s = history.t_s[-1] - history.t_s[len(history.frame) - 1 - gap_frames]
    rotation_error_rad: Floats = ROTATION_DRIFT_RAD * gap_frames.astype(np.float64)
    return Flows(first, history.rays[-1], gap_frames, gap_s, sigma_rad, rotation_error_rad)


def scene_directions(history: TrackHistory, flows: Flows) -> Floats:
    """``dir`` of the static scene over each track's own gap, in the present camera: ``(N, 3)``, NaN where unknown.

    The mean of the directions of the single steps, each rotated into the present camera. Own speed is assumed constant
    over the gap, own direction is not.
    """
    chosen = np.empty((len(flows.gap_frames), 3))
    _follow_scene(history.cam_R_past, history.scene_direction, flows.gap_frames, chosen)
    return chosen


@compiled_for("(f8[:, :, ::1], f8[:, ::1], i8[::1], f8[:, ::1])")
def _follow_scene(cam_R_past: Floats, direction: Floats, gap_frames: Ints, chosen: Floats) -> None:
    """Fill ``chosen (N, 3)`` of `scene_directions`."""
    n_views = len(direction)
    means, total = np.full((n_views, 3), np.nan), np.zeros(3)
    for gap in range(n_views):
        r, step = cam_R_past[n_views - 1 - gap], direction[n_views - 1 - gap]
        if np.isfinite(step[0] + step[1] + step[2]):
            for a in range(3):
                total[a] += r[a, 0] * step[0] + r[a, 1] * step[1] + r[a, 2] * step[2]
        length = np.sqrt(total[0] * total[0] + total[1] * total[1] + total[2] * total[2])
        if length > 0.0:
            for a in range(3):
                means[gap, a] = total[a] / length
    for i in range(len(gap_frames)):
        for a in range(3):
            chosen[i, a] = means[max(gap_frames[i] - 1, 0), a]


@compiled_for("(f8[:, :, ::1], f8[:, :, ::1], i8, f8, f8, f8[::1], f8[:, ::1], i8[::1], f8[::1])")
def _select(
    rays: Floats,
    cam_R_past: Floats,
    max_gap: int,
    target_rad: float,
    turn_rad: float,
    noise_rad: Floats,
    first: Floats,
    gap_frames: Ints,
    sigma_rad: Floats,
) -> None:
    """Fill ``first (N, 3)``, ``gap_frames (N,)`` and ``sigma_rad (N,)`` of `select_flows`."""
    last = len(rays) - 1
    for i in range(rays.shape[1]):
        square = 0.0
        for gap in range(1, max_gap + 1 if np.isfinite(rays[last, i, 0]) else 1):
            r, ray = cam_R_past[last - gap], rays[last - gap, i]
            if not np.isfinite(ray[0]):
                continue
            square = 0.0
            for a in range(3):
                first[i, a] = r[a, 0] * ray[0] + r[a, 1] * ray[1] + r[a, 2] * ray[2]
                square += (rays[last, i, a] - first[i, a]) ** 2
            gap_frames[i] = gap
            if square >= target_rad * target_rad:
                break
        by_flow = _ERROR_PER_FLOW * _ERROR_PER_FLOW * square
        sigma_rad[i] = np.sqrt(noise_rad[i] * noise_rad[i] + by_flow + turn_rad * turn_rad)
