"""Whether a scene flows past a camera that much of its picture rides along with.

Bonnet, dashboard and reflections in the windscreen can fill more of a picture than the scene does, and then look like a
scene at rest. What tells: the scene flows out of one point, to all sides of it. Traffic before a camera at rest does
not: a stream of it lies to one side of where it comes from.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.rotation import cross, normalize
from ttcvid.model import Bools, Floats, Platform
from ttcvid.stages.egomotion.frame_gap import paired_rays
from ttcvid.stages.egomotion.motion_prior import EgomotionMemory
from ttcvid.stages.egomotion.relative_pose import estimate_egomotion, picture_region, region_side_of
from ttcvid.stages.tracking.history import TrackHistory

# So many steps are looked back, s: less than a pixel in 0.2 s at 30 frames/s is no flow to speak of.
_STEPS, _LEAST_STEPS = 6, 3
# What moves by more than this over them moves, px; and misses its line by less than this, or this part of its flow.
_MOVES_PX, _ON_LINE_PX, _ON_LINE_PART = 1.0, 1.0, 0.15
# What moves fills this share of the parts of the picture (0.00 to 0.09 before a resting camera over a street), and one
# translation explains this share of that: three times what chance would, since other traffic may fill the rest.
_LEAST_MOVING, _LEAST_EXPLAINED = 0.2, 0.3
# It lies on all sides: the mean of the unit vectors to its parts is no longer than this (0.7 to 1 over that street).
_MOST_ONE_SIDED = 0.6


def flows_out(history: TrackHistory, least_parallax_px: float, min_tracks: int, platform: Platform) -> bool:
    """Whether what does not stay on its pixel flows out of one point ahead, to all sides of it.

    Frozen tracks are asked, too. A flow of one step of ``least_parallax_px`` does not count as translation;
    ``min_tracks`` are needed for a motion of the camera.
    """
    gap = min(_STEPS, len(history.frame) - 1)
    if gap < _LEAST_STEPS:
        return False
    side = region_side_of(history.camera)
    before, now = history.rays[-1 - gap], history.rays[-1]
    moved_px = np.linalg.norm(now - before, axis=1) * history.focal_px
    is_moving: Bools = moved_px > _MOVES_PX
    is_seen = np.isfinite(moved_px)
    if not is_seen.any() or _share_of_regions(now[is_seen], is_moving[is_seen], side) < _LEAST_MOVING:
        return False
    pair = paired_rays(history, is_moving, gap, min_tracks)
    if pair is None:
        return False
    parallax_rad = np.sqrt(gap) * least_parallax_px / history.focal_px
    motion = estimate_egomotion(pair, parallax_rad, EgomotionMemory(np.zeros(3)), platform)
    if motion.direction is None or motion.direction[2] >= 0.0:
        return False
    turned, now = pair.before @ motion.cam_R_prev.T, pair.now
    explained = _is_outflow(turned, now, motion.direction, history.focal_px)
    if not explained.any() or _share_of_regions(now, explained, side) < _LEAST_EXPLAINED:
        return False
    return _one_sided(now[explained], motion.direction, side) < _MOST_ONE_SIDED


def _share_of_regions(rays: Floats, holds: Bools, side: float) -> float:
    """Share of the parts of the picture with rays ``(N, 3)`` in which it ``holds (N,)`` for more than half of them."""
    region = picture_region(rays, side)
    return float(np.mean(np.bincount(region, holds) > 0.5 * np.bincount(region)))


def _is_outflow(turned: Floats, now: Floats, direction: Floats, focal_px: float) -> Bools:
    """Rays ``(N, 3)`` that move along a direction, away from where we go: (N,)."""
    across = cross(turned, direction)
    off_px = np.abs(np.sum(normalize(across) * now, axis=1)) * focal_px
    flow_px = np.linalg.norm(now - turned, axis=1) * focal_px
    goes_out = np.sum(cross(turned, now) * across, axis=1) > 0.0
    return np.asarray(goes_out & (flow_px > _MOVES_PX) & (off_px < np.maximum(_ON_LINE_PX, _ON_LINE_PART * flow_px)))


def _one_sided(rays: Floats, direction: Floats, side: float) -> float:
    """Length of the mean of the unit vectors from where we go to the parts of the picture with rays ``(N, 3)``."""
    region = picture_region(rays, side)
    outwards = rays[:, :2] / rays[:, 2:] - direction[:2] / direction[2]
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    weight = 1.0 / np.bincount(region)[region]
    return float(np.linalg.norm(weight @ outwards) / weight.sum())
