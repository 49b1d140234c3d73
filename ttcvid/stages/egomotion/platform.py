"""What carries the camera, decided from the clip: whether it rests, drives along its view, or moves freely.

Short samples are spread over the whole clip, so that a drive that begins at a red light is a drive. A camera rests
where the picture stays in place from one sample to the next, and few of them show a drive. It drives where translation
within some degrees of the optical axis explains the flow as well as one elsewhere, over a ground that moves as it does
below a car; a sample in which the camera only turns says nothing. Otherwise it moves freely: no prior on its direction.
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
from ttcvid.stages.egomotion.motion_prior import FORWARD_DIR, MOTION_PRIORS, EgomotionMemory
from ttcvid.stages.egomotion.relative_pose import RayPairs, estimate_egomotion, picture_region, region_side_of
from ttcvid.stages.egomotion.rest import RESTING_SHARE, share_of_parts
from ttcvid.stages.tracking.groups import in_common

# A stretch tells something with so many points that are seen all through it, and from frame to frame. It is as long as
# there are so many, of at least so many frames: tracks may be short.
_LEAST_POINTS, _LEAST_STEP_POINTS, _LEAST_FRAMES = 40, 12, 3
# Least noise of a point, px: that of a codec; the most that is believed; and flow that is not taken for translation.
_SIGMA_PX, _MOST_SIGMA_PX, _LEAST_PARALLAX_PX = 0.3, 2.0, 0.25
# The noise is told by those that bend least, since displaced ones bend more: this quantile, and what it is of sigma.
_LOW_QUANTILE, _LOW_SIGMAS = 0.2, 0.2533
# A limit below holds for points of the least noise, and is at least so many times the noise.
_NOISES = 3.0
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
_WALKING_HZ, _STRAIGHT_RAD = 3.0, float(np.radians(2.5))
# So many glances have to tell something. A camera drives in more than this share of those that do, and is at rest with
# less than this share of drives.
_LEAST_GLANCES, _MAJORITY, _FEW = 2, 0.5, 0.25
# What is stuck in more than this share of the picture is not a bonnet: the camera rests.
_RESTING_PARTS = 0.75


class Verdict(StrEnum):
    """What a sample shows of the camera."""

    rests = "rests"
    drives = "drives"
    moves = "moves"
    turns = "turns"


@dataclass(frozen=True)
class Glance:
    """A short sample of a clip.

    ``still_share`` of the picture's cells stay in place once the rotation ``turned_rad`` is removed. ``travel (3,)`` is
    the line of travel as a unit vector pointing ahead, None where no translation is observed; it explains
    ``explained_share`` of the cells, and ``best_share`` is the most that it or a direction elsewhere explains.
    ``ground_hz`` is the speed of the ground below the horizon in camera heights per second; None where it is not
    observed. ``sigma_px`` is the noise of the points.
    """

    t_s: float
    still_share: float
    turned_rad: float
    travel: Floats | None
    explained_share: float
    best_share: float
    ground_hz: float | None
    sigma_px: float = _SIGMA_PX

    @property
    def off_axis_rad(self) -> float | None:
        """Angle between the line of travel and the optical axis."""
        return None if self.travel is None else float(np.arccos(min(self.travel[2], 1.0)))

    @property
    def verdict(self) -> Verdict:
        """Whether the camera rests, travels along its optical axis or elsewhere, or no travel is seen as it turns."""
        off_axis_rad = self.off_axis_rad
        if off_axis_rad is None and self.still_share > RESTING_SHARE and self.turned_rad < _SHAKEN_RAD:
            return Verdict.rests
        if self.best_share > _NEARLY_ALL and self.explained_share < self.best_share - _WORSE_BY:
            return Verdict.moves
        if off_axis_rad is None:
            return Verdict.turns
        is_ahead = off_axis_rad < _AHEAD_RAD and self.explained_share > _LEAST_EXPLAINED
        return Verdict.drives if is_ahead else Verdict.moves


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
    told = partial(ToldPlatform, glances=tuple(glances))
    drives = [glance for glance in glances if glance.verdict == Verdict.drives]
    verdicts = [glance.verdict for glance in glances]
    n, n_drive, n_rest, n_turn = len(glances), len(drives), verdicts.count(Verdict.rests), verdicts.count(Verdict.turns)
    if n < _LEAST_GLANCES:
        return told(Platform.free, "too little is seen to tell")
    if len(between) >= n - 1 and min(between) > RESTING_SHARE and n_rest > 0 and n_drive < _FEW * n:
        return told(Platform.static, f"the picture stays in its place from look to look, rest in {n_rest} of {n}")
    ground_hz = [glance.ground_hz for glance in glances if glance.ground_hz is not None]
    fastest_hz = float(np.quantile(ground_hz, _FASTEST_QUANTILE)) if len(ground_hz) >= _LEAST_GLANCES else None
    ahead = f"travel along the optical axis in {n_drive} of {n} looks"
    if n_drive < _LEAST_GLANCES or n_drive <= _MAJORITY * (n - n_rest - n_turn):
        return told(Platform.free, f"{ahead}, rest in {n_rest}, no travel seen in {n_turn}")
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
    """What a sample of at least three frames, their points and times, shows; None with too few points.

    The prior of a vehicle finds the direction ahead where there is one: among many movers or with few points, a search
    without it fails. Whether another direction explains more is tested afterwards.
    """
    ends = [n for n in range(_LEAST_FRAMES, len(stretch) + 1) if _is_long_enough(stretch[:n])]
    if not ends:
        return None
    stretch, times_s = _without_stuck(stretch[: ends[-1]], camera.image_size), times_s[: ends[-1]]
    sigma_px = _noise_px(stretch)
    if sigma_px is None or not _is_long_enough(stretch) or not times_s[-1] > times_s[0]:
        return None
    before, now = in_common(stretch[0], stretch[-1])
    memory = EgomotionMemory(np.zeros(3), FORWARD_DIR)
    cam_R_first = np.eye(3)
    for one, other in pairwise(stretch):
        pair = in_common(one, other)
        if len(pair[0]) < _LEAST_STEP_POINTS:
            return None
        step = _egomotion(*pair, camera, memory, Platform.vehicle, sigma_px)
        memory = memory.after(step)
        cam_R_first = step.cam_R_prev @ cam_R_first
    memory = EgomotionMemory(vector_from_rotation(cam_R_first), FORWARD_DIR)
    ahead = _egomotion(before, now, camera, memory, Platform.vehicle, sigma_px)
    still, explained = _shares(before, now, camera, ahead, sigma_px)
    turned_rad = float(np.linalg.norm(vector_from_rotation(ahead.cam_R_prev)))
    anywhere, best = _egomotion(before, now, camera, memory, Platform.free, sigma_px), explained
    if anywhere.direction is not None and abs(anywhere.direction[2]) < np.cos(_AHEAD_RAD):
        best = max(explained, _shares(before, now, camera, anywhere, sigma_px)[1])
    travel = None if ahead.direction is None else ahead.direction * (1.0 if ahead.direction[2] > 0.0 else -1.0)
    ground_hz = _ground_hz(before, now, camera, ahead, times_s[-1] - times_s[0], sigma_px)
    return Glance(times_s[-1], still, turned_rad, travel, explained, best, ground_hz, sigma_px)


def share_in_place(one: PointSet, other: PointSet, size: ImageSize, sigma_px: float) -> float | None:
    """Share of the picture's cells that are in place in both frames; None with too few points in common."""
    before, now = in_common(one, other)
    if len(before) < _LEAST_POINTS:
        return None
    return share_of_parts(now, np.linalg.norm(now - before, axis=1) < max(_STAYS_PX, _NOISES * sigma_px), size)


def _is_long_enough(stretch: Sequence[PointSet]) -> bool:
    return len(in_common(stretch[0], stretch[-1])[0]) >= _LEAST_POINTS


def _noise_px(stretch: Sequence[PointSet]) -> float | None:
    """Noise of the points, by their second differences over three frames less what they share: the camera's shake.
    None where too few are seen so often.
    """
    bends = []
    for one, two, three in zip(stretch, stretch[1:], stretch[2:], strict=False):
        ids = np.intersect1d(np.intersect1d(one.track_id, two.track_id), three.track_id)
        if len(ids) < _LEAST_STEP_POINTS:
            return None
        first, middle, last = (points.take(np.isin(points.track_id, ids)).xy_px for points in (one, two, three))
        bend = first - 2.0 * middle + last
        bends.append(np.abs(bend - np.median(bend, axis=0)).ravel())
    sigma_px = np.quantile(np.concatenate(bends), _LOW_QUANTILE) / (_LOW_SIGMAS * np.sqrt(6.0))
    return float(np.clip(sigma_px, _SIGMA_PX, _MOST_SIGMA_PX))


def _without_stuck(stretch: Sequence[PointSet], size: ImageSize) -> Sequence[PointSet]:
    """The points of all frames without those that stay on their pixel while others move: bonnet, text, reflections."""
    first, last = stretch[0], stretch[-1]
    track_id, i, j = np.intersect1d(first.track_id, last.track_id, assume_unique=True, return_indices=True)
    moved_px = np.linalg.norm(last.xy_px[j] - first.xy_px[i], axis=1)
    is_stuck: Bools = moved_px < _STUCK_PX
    if is_stuck.all() or np.median(moved_px[~is_stuck]) < _MOVING_PX:
        return stretch
    if share_of_parts(last.xy_px[j], is_stuck, size) > _RESTING_PARTS:
        return stretch  # some movers before a camera that rests
    return [points.take(np.isin(points.track_id, track_id[is_stuck], invert=True)) for points in stretch]


def _egomotion(
    before_px: Floats, now_px: Floats, camera: Camera, memory: EgomotionMemory, platform: Platform, sigma_px: float
) -> TwoViewFit:
    before, now = (normalize(rays_from_pixels(camera, xy_px)) for xy_px in (before_px, now_px))
    is_seen = np.isfinite(before + now).all(axis=1)
    sigma_rad = np.full(np.count_nonzero(is_seen), sigma_px / camera.fx_px)
    parallax_rad = _LEAST_PARALLAX_PX / camera.fx_px
    region = picture_region(now[is_seen], region_side_of(camera))
    pairs = RayPairs(before[is_seen], now[is_seen], sigma_rad, region)
    return estimate_egomotion(pairs, parallax_rad, memory, platform)


def _flow(before_px: Floats, now_px: Floats, camera: Camera, motion: TwoViewFit) -> tuple[Floats, Floats]:
    """Rays (M, 3) before, turned into the camera of now, and now, in the plane z = 1."""
    before, now = (rays_from_pixels(camera, xy_px) for xy_px in (before_px, now_px))
    return normalize(before) @ motion.cam_R_prev.T, now / now[:, 2:]


def _shares(
    before_px: Floats, now_px: Floats, camera: Camera, motion: TwoViewFit, sigma_px: float
) -> tuple[float, float]:
    """The shares of the picture's parts that stay in their place, and that a motion explains."""
    turned, now = _flow(before_px, now_px, camera, motion)
    moved_px = np.linalg.norm(normalize(now) - turned, axis=1) * camera.fx_px
    size = camera.image_size
    still = share_of_parts(now_px, moved_px < max(_STAYS_PX, _NOISES * sigma_px), size)
    if motion.direction is None:
        return still, still
    normal = normalize(np.cross(turned, motion.direction))
    off_px = np.abs(np.sum(normal * normalize(now), axis=1)) * camera.fx_px
    rate, _ = _rates(turned, now, motion.direction)
    limit_px = max(_EXPLAINED_PX, _NOISES * sigma_px)
    explained = (off_px < limit_px) & ((rate > 0.0) | (moved_px < limit_px))
    return still, share_of_parts(now_px, explained, size)


def _rates(turned: Floats, now: Floats, direction: Floats) -> tuple[Floats, Floats]:
    """Travel over the depth of each point (M,), and how a noise of its ray of one rad errs in it.

    A point at P = (x, y, 1) Z was at P - s dir: its ray before is along (x, y, 1) - (s / Z) dir.
    """
    across = np.cross(turned, direction)
    square = np.maximum(np.sum(across * across, axis=1), np.finfo(float).tiny)
    rate = np.sum(np.cross(turned, now) * across, axis=1) / square
    return rate, np.linalg.norm(now, axis=1) * np.sqrt(2.0 / square)


def _ground_hz(
    before_px: Floats, now_px: Floats, camera: Camera, motion: TwoViewFit, dt_s: float, sigma_px: float
) -> float | None:
    """How fast the ground goes by: a low quantile over what lies below the horizon, which stands on it or is it."""
    direction = motion.direction
    if direction is None or abs(direction[2]) < np.cos(_AHEAD_RAD):
        return None
    turned, now = _flow(before_px, now_px, camera, motion)
    rate, per_rad = _rates(turned, now, direction)
    below = now[:, 1] - direction[1] / direction[2]
    is_known = (below > _BELOW) & (per_rad * sigma_px / camera.fx_px < _KNOWN_PART * rate)
    if np.count_nonzero(is_known) < _LEAST_GROUND_POINTS:
        return None
    return float(np.quantile(rate[is_known] / below[is_known], 0.25)) / dt_s
