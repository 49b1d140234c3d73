"""The derotated flow of every track over a frame gap that grows until the flow is long enough.

The paper calls it the flexible baseline: the second picture is taken later when the flow is short.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.geometry.rotation import normalize
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

    That is ``max_gap_frames`` views of the history at most. Source: the paper's flexible baseline.
    """
    n = history.n_tracks
    first, gap_frames, square = np.full((n, 3), np.nan), np.zeros(n, dtype=np.int64), np.zeros(n)
    asks = np.isfinite(history.rays[-1, :, 0])
    for gap in range(1, min(max_gap_frames, len(history.frame) - 1) + 1):
        track = np.flatnonzero(asks & np.isfinite(history.rays[-1 - gap, :, 0]))
        first[track] = history.rays[-1 - gap, track] @ history.cam_R_past[-1 - gap].T
        gap_frames[track] = gap
        square[track] = ((history.rays[-1, track] - first[track]) ** 2).sum(axis=1)
        asks &= square < (target_flow_px / history.focal_px) ** 2
    # The rotation's error moves one end of the flow; it is shared out to both.
    sigma_rad = np.sqrt(history.sigma_rad**2 + _ERROR_PER_FLOW**2 * square + 0.5 * history.rotation_sigma_rad**2)
    gap_s = history.t_s[-1] - history.t_s[len(history.frame) - 1 - gap_frames]
    rotation_error_rad: Floats = ROTATION_DRIFT_RAD * gap_frames.astype(np.float64)
    return Flows(first, history.rays[-1], gap_frames, gap_s, sigma_rad, rotation_error_rad)


def scene_directions(history: TrackHistory, flows: Flows) -> Floats:
    """``dir`` of the static scene over each track's own gap, in the present camera: ``(N, 3)``, NaN where unknown.

    The mean of the directions of the single steps, each rotated into the present camera. Own speed is assumed constant
    over the gap, own direction is not.
    """
    steps = np.einsum("lij,lj->li", history.cam_R_past, history.scene_direction)[::-1]
    means = normalize(np.cumsum(np.nan_to_num(steps), axis=0))
    return np.asarray(means[np.maximum(flows.gap_frames - 1, 0)])
