"""One interface to both trackers; cuts, dark and duplicate pictures are distinguished from motion."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from ttcvid.config import TrackingConfig
from ttcvid.geometry.medians import median
from ttcvid.model import NO_POINTS, Floats, FrameStatus, Picture, PointSet
from ttcvid.stages.tracking.akaze import AkazeMemory, Features, detect_features, follow_akaze, start_akaze
from ttcvid.stages.tracking.changes import SAMPLED_PX
from ttcvid.stages.tracking.groups import in_common
from ttcvid.stages.tracking.klt import KltMemory, follow_klt, start_klt

# Size of the thumbnail and bins of its histogram that stand for the look of a picture.
_THUMBNAIL, _BINS = (64, 48), 32
# A cut leaves less than this part of the tracks, and another histogram: at least this part of its mass moved. On the
# real clips a hard cut leaves 0 and moves 0.27 or more, the wildest drive leaves 0.4 and moves 0.14.
_CUT_SURVIVAL, _CUT_HISTOGRAM = 0.15, 0.2
# With hardly a track left (up to 10 % of AKAZE features match anything) everything starts again.
_LOST_SURVIVAL = 0.12
# Lucas-Kanade takes brightness as lasting, and loses most tracks where it changes by a fifth. Below this survival they
# are looked for once more in the picture as bright as the last one, if that is not the same.
_POOR_SURVIVAL, _LEAST_EXPOSURE_CHANGE = 0.5, 0.05
# With so few tracks their survival says nothing, and the histogram has to be surer by itself.
_FEW_TRACKS, _CUT_HISTOGRAM_ALONE = 8, 0.35
# A picture that was sent twice is not the same twice once a codec has been at it, but nearly all of its tracks stand
# still, where the last step of most was longer than this: no camera stops between two pictures. (Doubled pictures of a
# rendered drive moved this part of its tracks by 0.1 to 0.2 px at an H.264 CRF of 14 to 28, others by 3 px at least.)
_LEAST_STEP_PX, _STILL_PART, _STILL_SHARE = 1.0, 0.1, 0.9
_NO_STEPS = (0.0, 0.0)
# So often at most, 5 pictures a second sent as 30: what stands still for longer has stopped.
_MOST_REPEATED = 5
# A picture whose brightest parts stay below this grey level shows nothing; black is 16 in most videos.
_DARK_LEVEL = 24

COMMON_ERROR_PX = 0.25
"""Tracks of a thing drift together by a part of a pixel: standard deviation at its outline."""


@dataclass(frozen=True)
class PreparedPicture:
    """What can be computed from a picture alone, ahead of its turn: its thumbnail, and its features for AKAZE."""

    grey: Picture
    thumbnail: Picture
    features: Features | None


@dataclass(frozen=True)
class TrackerMemory:
    """State of the tracker in use, and the last picture's look; everything None before the first picture.

    ``steps_px`` are the median lengths of the tracks' last two steps, 0 where there was none, and None after pictures
    that were left out; ``n_repeated`` counts the pictures since then in which the tracks stood still. The last picture
    is of ``t_s`` and followed the one before by ``step_s``; NaN where that is not known.
    """

    prepared: PreparedPicture | None = None
    tracks: KltMemory | AkazeMemory | None = None
    steps_px: tuple[float, float] | None = _NO_STEPS
    n_repeated: int = 0
    t_s: float = math.nan
    step_s: float = math.nan


def prepare_picture(grey: Picture, allowed: Picture | None, config: TrackingConfig) -> PreparedPicture:
    """The part of the work that needs no other picture."""
    # The rest would say the same, 15 times as slowly.
    samples = grey[::SAMPLED_PX, ::SAMPLED_PX]
    thumbnail = np.asarray(cv2.resize(samples, _THUMBNAIL, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    is_dark = int(thumbnail.max()) < _DARK_LEVEL
    features = detect_features(grey, allowed, config) if config.tracker == "akaze" and not is_dark else None
    return PreparedPicture(grey, thumbnail, features)


def follow_points(
    memory: TrackerMemory,
    prepared: PreparedPicture,
    allowed: Picture | None,
    config: TrackingConfig,
    *,
    camera_rests: bool = False,
    t_s: float = math.nan,
) -> tuple[PointSet, FrameStatus, TrackerMemory]:
    """Points of this picture with their tracks; of klt, where the ``camera_rests``, more of them on what moves.

    ``t_s`` is the time of the picture; NaN: as long after the last one as that after the one before.

    Returns
    -------
    points : none where the picture is ``dark`` or a ``duplicate`` of the last one, exactly or but for the effect of a
        codec (then the memory of the tracks stays as it was).
    status : ``first``, ``cut`` (all tracks start again), ``dark``, ``duplicate`` or ``ok``.
    memory : for the next picture.
    """
    if int(prepared.thumbnail.max()) < _DARK_LEVEL:
        return NO_POINTS, FrameStatus.dark, replace(memory, steps_px=None)
    last, tracks = memory.prepared, memory.tracks
    if last is None or tracks is None:
        return _started(FrameStatus.first, 0, prepared, allowed, config, t_s)
    if np.array_equal(last.thumbnail, prepared.thumbnail) and np.array_equal(last.grey, prepared.grey):
        return NO_POINTS, FrameStatus.duplicate, replace(memory, steps_px=None)
    step_s = t_s - memory.t_s
    step_part = step_s / memory.step_s if step_s > 0.0 and memory.step_s > 0.0 else 1.0
    followed, survival, n_before = _followed(tracks, last, prepared, allowed, config, camera_rests, step_part)
    if _is_cut(survival, n_before, last.thumbnail, prepared.thumbnail):
        return _started(FrameStatus.cut, tracks.next_track_id, prepared, allowed, config, t_s)
    points = _points(followed)
    before_px, now_px = in_common(_points(tracks), points)
    steps_px = np.linalg.norm(now_px - before_px, axis=1)
    if _stand_still(steps_px, memory):
        return NO_POINTS, FrameStatus.duplicate, replace(memory, n_repeated=memory.n_repeated + 1)
    step_px = median(steps_px) if len(steps_px) >= _FEW_TRACKS else 0.0
    last_steps_px = _NO_STEPS if memory.steps_px is None else (memory.steps_px[1], step_px)
    return points, FrameStatus.ok, TrackerMemory(prepared, followed, last_steps_px, t_s=t_s, step_s=step_s)


def _started(
    status: FrameStatus,
    first_id: int,
    prepared: PreparedPicture,
    allowed: Picture | None,
    config: TrackingConfig,
    t_s: float,
) -> tuple[PointSet, FrameStatus, TrackerMemory]:
    """As `follow_points`, with new tracks, numbered from ``first_id``."""
    if prepared.features is None:
        tracks: KltMemory | AkazeMemory = start_klt(prepared.grey, allowed, config, first_id)
    else:
        tracks = start_akaze(prepared.features, first_id)
    return _points(tracks), status, TrackerMemory(prepared, tracks, t_s=t_s)


def _followed(
    former: KltMemory | AkazeMemory,
    last: PreparedPicture,
    prepared: PreparedPicture,
    allowed: Picture | None,
    config: TrackingConfig,
    camera_rests: bool,
    step_part: float,
) -> tuple[KltMemory | AkazeMemory, float, int]:
    """The tracks after following, the part of them that survived, and how many there were."""
    if isinstance(former, AkazeMemory) and prepared.features is not None:
        akaze, survival = follow_akaze(former, prepared.features, config)
        return akaze, survival, len(former.track_id)
    if not isinstance(former, KltMemory):
        raise ValueError("follow_points: the memory belongs to another tracker than the one configured")
    klt, survival = follow_klt(former, prepared.grey, allowed, config, camera_rests=camera_rests, step_part=step_part)
    # What makes the picture as bright as the last one.
    gain = float(last.thumbnail.mean()) / max(float(prepared.thumbnail.mean()), 1.0)
    if survival < _POOR_SURVIVAL and abs(gain - 1.0) > _LEAST_EXPOSURE_CHANGE:
        exposed = np.asarray(cv2.convertScaleAbs(prepared.grey, alpha=gain), dtype=np.uint8)
        again, survival_exposed = follow_klt(
            former, exposed, allowed, config, camera_rests=camera_rests, step_part=step_part
        )
        if survival_exposed > survival:
            klt, survival = replace(again, grey=prepared.grey), survival_exposed
    return klt, survival, len(former.points.track_id)


def _stand_still(steps_px: Floats, last: TrackerMemory) -> bool:
    """Whether nearly all tracks stand still that moved before, as only a repeated picture has it."""
    if last.steps_px is None or len(steps_px) < _FEW_TRACKS or last.n_repeated >= _MOST_REPEATED:
        return False
    before_px, last_px = last.steps_px
    if last_px < _LEAST_STEP_PX:
        return False
    # A step over a gap in the times is no measure of the next; nor is one to a repeated picture that was not known yet.
    step_px = min(before_px, last_px) if before_px >= _LEAST_STEP_PX else last_px
    return bool(np.mean(steps_px < _STILL_PART * step_px) >= _STILL_SHARE)


def _points(tracks: KltMemory | AkazeMemory) -> PointSet:
    return replace(tracks.seen, common_error_px=COMMON_ERROR_PX)


def _is_cut(survival: float, n_before: int, last: Picture, now: Picture) -> bool:
    if n_before < _FEW_TRACKS:
        return _moved(last, now) > _CUT_HISTOGRAM_ALONE
    return survival < _LOST_SURVIVAL or (survival < _CUT_SURVIVAL and _moved(last, now) > _CUT_HISTOGRAM)


def _moved(last: Picture, now: Picture) -> float:
    """Part of the histogram's mass that differs."""
    before, after = (np.histogram(thumbnail, _BINS, (0, 256))[0] / thumbnail.size for thumbnail in (last, now))
    return 0.5 * float(np.abs(before - after).sum())
