"""Whether the calibrated horizon still fits: epipoles lie beside it by chance, but not on one side, nor wandering."""

from __future__ import annotations

import numpy as np

from ttcvid.model import SCENE_CLUSTER, Floats, FrameResult

# The clip is looked at in so many parts, each with at least so many frames that have an offset: own motion misled by a
# bus before the camera for a second is no drift.
_PARTS, _LEAST_FRAMES = 4, 25
# Errors of epipoles hang together over about so many frames.
_FRAMES_TOGETHER = 10
# An offset or a drift is believed from so many standard deviations on.
_SURE_SIGMAS = 4.0
# Median of the absolute value of a standard normal variable.
_MEDIAN_NORMAL = 0.6745


def horizon_offset_of(result: FrameResult) -> float | None:
    """How far off the horizon a frame's epipoles were found, px: own motion's, else the median of the objects'."""
    offsets = {row.cluster_id: row.horizon_offset_px for row in result.clusters if row.horizon_offset_px is not None}
    if SCENE_CLUSTER in offsets:
        return offsets[SCENE_CLUSTER]
    return float(np.median(list(offsets.values()))) if offsets else None


def complaint_about_horizon(offset_px: Floats, tolerance_px: float) -> str:
    """What to say where the offsets of a clip's frames ``(N,)`` do not fit the calibration; empty where they do.

    Parameters
    ----------
    offset_px : positive below the horizon, in the order of the frames.
    tolerance_px : offsets that the calibration's own error explains.
    """
    parts = np.array_split(offset_px, _PARTS)
    if len(parts[-1]) < _LEAST_FRAMES:
        return ""
    middle = np.array([np.median(part) for part in parts])
    spread = np.array([np.median(np.abs(part - np.median(part))) for part in parts]) / _MEDIAN_NORMAL
    error = spread / np.sqrt([max(1.0, len(part) / _FRAMES_TOGETHER) for part in parts])
    remedy = "the calibration no longer fits, calibrate the horizon again"
    drift_px = float(middle[-1] - middle[0])
    is_steady = bool((np.diff(middle) > 0).all() or (np.diff(middle) < 0).all())
    if is_steady and abs(drift_px) > tolerance_px + _SURE_SIGMAS * float(np.hypot(error[0], error[-1])):
        return f"epipoles drift by {drift_px:+.0f} px across the horizon over the clip: {remedy}"
    overall_px = float(np.median(offset_px))
    is_one_sided = bool((middle > 0).all() or (middle < 0).all())
    if is_one_sided and abs(overall_px) > tolerance_px + _SURE_SIGMAS * float(np.sqrt(np.mean(error**2) / _PARTS)):
        side = "below" if overall_px > 0 else "above"
        return f"epipoles lie {abs(overall_px):.0f} px {side} the horizon: {remedy}"
    return ""
