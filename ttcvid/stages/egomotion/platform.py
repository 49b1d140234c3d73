"""What carries the camera, decided from the clip: whether it rests, drives along its view, or moves freely.

Short samples are spread over the whole clip, so that a drive that begins at a red light is a drive. A camera rests
where the picture stays in place, within the samples and from one to the next. It drives where translation within some
degrees of the optical axis explains the flow as well as any other direction, over a ground that moves as it does below
a car. Otherwise it moves freely, and there is no prior on its direction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from itertools import pairwise

import numpy as np

from ttcvid.geometry.camera.pinhole import rays_from_pixels
from ttcvid.geometry.estimation.relative_pose import TwoViewFit
from ttcvid.geometry.rotation import normalize, vector_from_rotation
from ttcvid.model import Bools, Camera, Floats, ImageSize, Platform, PointSet
from ttcvid.stages.egomotion.relative_pose import (
    FORWARD_DIR,
    MOTION_PRIORS,
    EgomotionMemory,
    estimate_egomotion,
    region_side_of,
)
from ttcvid.stages.egomotion.rest import RESTING_SHARE, share_of_parts
from ttcvid.stages.tracking.groups import in_common

# A stretch tells something with so many points that are seen all through it, and from frame to frame.
_LEAST_POINTS, _LEAST_STEP_POINTS = 40, 12
# Noise of a point, px: that of a codec, since it is not estimated here; and flow that is not taken for translation.
_SIGMA_PX, _LEAST_PARALLAX_PX = 0.3, 0.25
# A point that stays within this while most others move by more than that is on the bonnet, or text, px.
_STUCK_PX, _MOVING_PX = 0.7, 3.0
# A part of the picture stays within this over a stretch, once the rotation is taken out, px.
_STAYS_PX = 1.0
# A motion explains a point that it misses by less than this, px.
_EXPLAINED_PX = 1.5
# A camera on a mast turns by less than this in a stretch: four standard deviations of what it shakes by.
_SHAKEN_RAD = 4.0 * MOTION_PRIORS[Platform.static].rotation_sigma_rad
# A car goes where its camera looks within this, also in a bend and with a camera that is mounted askew, and that
# explains so many of the parts of the picture: others drive, too. It goes elsewhere where another direction explains
# nearly all, and so many more.
_AHEAD_RAD, _LEAST_EXPLAINED, _NEARLY_ALL, _WORSE_BY = float(np.radians(20.0)), 0.4, 0.85, 0.15
# The ground is told by so many points so far below the horizon (tangent), of a rate known to this part.
_LEAST_GROUND_POINTS, _BELOW, _KNOWN_PART = 10, 0.05, 0.5
# A camera drives over its ground with more than so many of its own heights a second (a car creeps at 0.7, an aircraft
# has 0.1 to 0.35), in the quarter of the stretches with most: cars slow down.
_LEAST_GROUND_HZ, _FASTEST_QUANTILE = 0.4, 0.75
# Who walks, or hovers ahead, goes no faster than this, and not as straight as a car that creeps.
_WALKING_HZ, _STRAIGHT_RAD = 2.0, float(np.radians(2.5))
# Of the glances that tell something at least so many, and of those these shares, have to say the same; more where no
# ground confirms a drive.
_LEAST_GLANCES, _RESTING_GLANCES, _DRIVING_GLANCES, _WITHOUT_GROUND = 2, 0.75, 0.6, 4


class Verdict(StrEnum):
    """What a sample shows of the camera."""

    rests = "rests"
    drives = "drives"
    moves = "moves"


@dataclass(frozen=True)
class Glance:
    """A short sample of a clip.

    ``still_share`` of the picture's cells stay in place once the rotation ``turned_rad`` is removed. ``travel (3,)`` is
    the line of travel as a unit vector pointing ahead, None where no translation is observed; it explains
    ``explained_share`` of the cells, the best of all directions ``best_share``. ``ground_hz`` is the speed of the
    ground below the horizon in camera heights per second; None where it is not observed.
    """

    t_s: float
    still_share: float
    turned_rad: float
    travel: Floats | None
    explained_share: float
    best_share: float
    ground_hz: float | None

    @property
    def off_axis_rad(self) -> float | None:
        """Angle between the line of travel and the optical axis."""
        return None if self.travel is None else float(np.arccos(min(self.travel[2], 1.0)))

    @property
    def verdict(self) -> Verdict:
        """Whether the camera rests, travels along its optical axis, or neither."""
        off_axis_rad = self.off_axis_rad
        if off_axis_rad is None:
            is_resting = self.still_share > RESTING_SHARE and self.turned_rad < _SHAKEN_RAD
            return Verdict.rests if is_resting else Verdict.moves
        is_elsewhere = self.best_share > _NEARLY_ALL and self.explained_share < self.best_share - _WORSE_BY
        is_ahead = off_axis_rad < _AHEAD_RAD and self.explained_share > _LEAST_EXPLAINED
        return Verdict.drives if is_ahead and not is_elsewhere else Verdict.moves


@dataclass(frozen=True)
class ToldPlatform:
    """What carries the camera, the ``reason`` in words, and the samples behind it."""

    platform: Platform
    reason: str
    glances: tuple[Glance, ...]


def told_platform(glances: Sequence[Glance], between: Sequence[float]) -> ToldPlatform:
    """What carries the camera, from samples of its clip.

    ``between`` are the shares of the picture's cells that are in the same place in one sample and in the next, where
    they are known.
    """
    told, glances = partial(ToldPlatform, glances=tuple(glances)), list(glances)
    drives = [glance for glance in glances if glance.verdict == Verdict.drives]
    n, n_drive, n_rest = len(glances), len(drives), sum(glance.verdict == Verdict.rests for glance in glances)
    if n < _LEAST_GLANCES:
        return told(Platform.free, "too little is seen to tell")
    stays = len(between) > 0 and all(share > RESTING_SHARE for share in between)
    if n_drive == 0 and n_rest >= _RESTING_GLANCES * n and stays:
        return told(Platform.static, f"the picture stays in its place in {n_rest} of {n} looks")
    ground_hz = [glance.ground_hz for glance in glances if glance.ground_hz is not None]
    fastest_hz = float(np.quantile(ground_hz, _FASTEST_QUANTILE)) if len(ground_hz) >= _LEAST_GLANCES else None
    ahead = f"travel along the optical axis in {n_drive} of {n} looks"
    least = _WITHOUT_GROUND if fastest_hz is None else _LEAST_GLANCES
    if n_drive < max(least, _DRIVING_GLANCES * (n - n_rest)):
        return told(Platform.free, f"{ahead}, rest in {n_rest}")
    if fastest_hz is None:
        return told(Platform.vehicle, ahead)
    ground = f"the ground goes by with {fastest_hz:.2g} camera heights a second"
    if fastest_hz < _LEAST_GROUND_HZ:
        return told(Platform.free, f"{ahead}, but {ground}: far above it")
    ways = np.array([glance.travel for glance in drives])
    wavers_rad = np.median(np.arccos(np.clip(ways @ normalize(ways.mean(axis=0)), -1.0, 1.0)))
    if fastest_hz < _WALKING_HZ and wavers_rad > _STRAIGHT_RAD:
        return told(Platform.free, f"{ahead}, but {ground}, and the way wavers")
    return told(Platform.vehicle, f"{ahead}, {ground}")


def glance_at(stretch: Sequence[PointSet], times_s: Sequence[float], camera: Camera) -> Glance | None:
    """What a sample of at least two frames, their points and times, shows; None with too few points.

    The prior of a vehicle finds the direction ahead where there is one: among many movers or with few points, a search
    without it fails. Whether another direction explains more is tested afterwards.
    """
    stretch = _without_stuck(stretch, camera.image_size)
    before, now = in_common(stretch[0], stretch[-1])
    if len(before) < _LEAST_POINTS or not times_s[-1] > times_s[0]:
        return None
    memory = EgomotionMemory(np.zeros(3), FORWARD_DIR)
    cam_R_first = np.eye(3)
    for one, other in pairwise(stretch):
        pair = in_common(one, other)
        if len(pair[0]) < _LEAST_STEP_POINTS:
            return None
        step = _egomotion(*pair, camera, memory, Platform.vehicle)
        memory = memory.after(step)
        cam_R_first = step.cam_R_prev @ cam_R_first
    memory = EgomotionMemory(vector_from_rotation(cam_R_first), FORWARD_DIR)
    ahead = _egomotion(before, now, camera, memory, Platform.vehicle)
    still, explained = _shares(before, now, camera, ahead)
    turned_rad = float(np.linalg.norm(vector_from_rotation(ahead.cam_R_prev)))
    if ahead.direction is None:
        return Glance(times_s[-1], still, turned_rad, None, explained, explained, None)
    anywhere = _egomotion(before, now, camera, memory, Platform.free)
    best = max(explained, _shares(before, now, camera, anywhere)[1])
    travel = ahead.direction * (1.0 if ahead.direction[2] > 0.0 else -1.0)
    ground_hz = _ground_hz(before, now, camera, ahead, times_s[-1] - times_s[0])
    return Glance(times_s[-1], still, turned_rad, travel, explained, best, ground_hz)


def share_in_place(one: PointSet, other: PointSet, size: ImageSize) -> float | None:
    """Share of the picture's cells that are in place in both frames; None with too few points in common."""
    before, now = in_common(one, other)
    if len(before) < _LEAST_POINTS:
        return None
    return share_of_parts(now, np.linalg.norm(now - before, axis=1) < _STAYS_PX, size)


def _without_stuck(stretch: Sequence[PointSet], size: ImageSize) -> Sequence[PointSet]:
    """The points of all frames without those that stay on their pixel while others move: bonnet, text, reflections."""
    first, last = stretch[0], stretch[-1]
    track_id, i, j = np.intersect1d(first.track_id, last.track_id, assume_unique=True, return_indices=True)
    moved_px = np.linalg.norm(last.xy_px[j] - first.xy_px[i], axis=1)
    is_stuck: Bools = moved_px < _STUCK_PX
    if is_stuck.all() or np.median(moved_px[~is_stuck]) < _MOVING_PX:
        return stretch
    if share_of_parts(last.xy_px[j], is_stuck, size) > _RESTING_GLANCES:
        return stretch  # some movers before a camera that rests
    return [points.take(np.isin(points.track_id, track_id[is_stuck], invert=True)) for points in stretch]


def _egomotion(
    before_px: Floats, now_px: Floats, camera: Camera, memory: EgomotionMemory, platform: Platform
) -> TwoViewFit:
    before, now = (normalize(rays_from_pixels(camera, xy_px)) for xy_px in (before_px, now_px))
    is_seen = np.isfinite(before + now).all(axis=1)
    sigma_rad = np.full(np.count_nonzero(is_seen), _SIGMA_PX / camera.fx_px)
    parallax_rad = _LEAST_PARALLAX_PX / camera.fx_px
    rays = before[is_seen], now[is_seen]
    return estimate_egomotion(*rays, sigma_rad, parallax_rad, memory, platform, region_side_of(camera))


def _flow(before_px: Floats, now_px: Floats, camera: Camera, motion: TwoViewFit) -> tuple[Floats, Floats]:
    """Rays (M, 3) before, turned into the camera of now, and now, in the plane z = 1."""
    before, now = (rays_from_pixels(camera, xy_px) for xy_px in (before_px, now_px))
    return normalize(before) @ motion.cam_R_prev.T, now / now[:, 2:]


def _shares(before_px: Floats, now_px: Floats, camera: Camera, motion: TwoViewFit) -> tuple[float, float]:
    """The shares of the picture's parts that stay in their place, and that a motion explains."""
    turned, now = _flow(before_px, now_px, camera, motion)
    moved_px = np.linalg.norm(normalize(now) - turned, axis=1) * camera.fx_px
    size = camera.image_size
    still = share_of_parts(now_px, moved_px < _STAYS_PX, size)
    if motion.direction is None:
        return still, still
    normal = normalize(np.cross(turned, motion.direction))
    off_px = np.abs(np.sum(normal * normalize(now), axis=1)) * camera.fx_px
    rate, _ = _rates(turned, now, motion.direction)
    explained = (off_px < _EXPLAINED_PX) & ((rate > 0.0) | (moved_px < _EXPLAINED_PX))
    return still, share_of_parts(now_px, explained, size)


def _rates(turned: Floats, now: Floats, direction: Floats) -> tuple[Floats, Floats]:
    """Travel over the depth of each point (M,), and how a noise of its ray of one rad errs in it.

    A point at P = (x, y, 1) Z was at P - s dir: its ray before is along (x, y, 1) - (s / Z) dir.
    """
    across = np.cross(turned, direction)
    square = np.maximum(np.sum(across * across, axis=1), np.finfo(float).tiny)
    rate = np.sum(np.cross(turned, now) * across, axis=1) / square
    return rate, np.linalg.norm(now, axis=1) * np.sqrt(2.0 / square)


def _ground_hz(before_px: Floats, now_px: Floats, camera: Camera, motion: TwoViewFit, dt_s: float) -> float | None:
    """How fast the ground goes by: a low quantile over what lies below the horizon, which stands on it or is it."""
    direction = motion.direction
    if direction is None or abs(direction[2]) < np.cos(_AHEAD_RAD):
        return None
    turned, now = _flow(before_px, now_px, camera, motion)
    rate, per_rad = _rates(turned, now, direction)
    below = now[:, 1] - direction[1] / direction[2]
    is_known = (below > _BELOW) & (per_rad * _SIGMA_PX / camera.fx_px < _KNOWN_PART * rate)
    if np.count_nonzero(is_known) < _LEAST_GROUND_POINTS:
        return None
    return float(np.quantile(rate[is_known] / below[is_known], 0.25)) / dt_s
