"""What carries the camera, told from the clip that is to be analysed (``--platform auto``)."""

from __future__ import annotations

import logging
import math
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from ttcvid.config import PipelineConfig
from ttcvid.errors import InputError
from ttcvid.jobs.clip import Calibration, open_clip
from ttcvid.jobs.processes.threads import one_opencv_thread
from ttcvid.jobs.settings.configuration import TOLD_BY_CLIP, Configuration
from ttcvid.jobs.settings.options import AnalyzeOptions
from ttcvid.model import Frame, FrameStatus, Platform, PointSet
from ttcvid.sources import Source
from ttcvid.stages.egomotion.platform import Glance, ToldPlatform, glance_at, share_in_place, told_platform
from ttcvid.stages.tracking.tracked_frames import track_frames

_LOG = logging.getLogger(__name__)

N_STRETCHES = 9
"""So many stretches of a clip are looked at, from its beginning to its end."""
# A stretch takes so long, s, in so many frames; of a faster clip than this, frames are left out.
_STRETCH_S, _LEAST_FRAMES, _MOST_FRAMES, _FULL_RATE_HZ = 0.2, 4, 8, 30.0
# A video of up to so many frames is decoded from its beginning; in a longer one each stretch is gone to, which takes as
# many frames in all: some 125 from a keyframe to it.
_READ_THROUGH = 1000
# Points that are followed, and their least distance in picture widths: all over the picture.
_MAX_TRACKS, _LEAST_DISTANCE = 900, 0.01


def with_told_platform(
    input_: str, calibration: Calibration, configuration: Configuration
) -> tuple[Configuration, ToldPlatform | None]:
    """The configuration with what carries the camera, and what tells it; as it was, and None, where that is given.

    The whole clip is looked at, whatever part of it is to be analysed: the same clip tells the same.
    """
    if configuration.pipeline.egomotion.platform != Platform.auto:
        return configuration, None
    with one_opencv_thread():
        told = _told(input_, calibration, configuration)
    _LOG.info("%s: platform %s, told by the clip: %s", input_, told.platform.value, told.reason)
    egomotion = configuration.pipeline.egomotion.model_copy(update={"platform": told.platform})
    pipeline = configuration.pipeline.model_copy(update={"egomotion": egomotion})
    origins = configuration.origins | {"egomotion.platform": TOLD_BY_CLIP}
    return replace(configuration, pipeline=pipeline, origins=origins), told


def describe_platform(configuration: Configuration, told: ToldPlatform | None) -> dict[str, Any]:
    """The platform as the manifest has it, with the evidence where the clip told it."""
    value = configuration.pipeline.egomotion.platform.value
    if told is None:
        return {"value": value, "is_told_by_clip": False, "reason": "given", "glances": []}
    glances = [_described(glance) for glance in told.glances]
    return {"value": value, "is_told_by_clip": True, "reason": told.reason, "glances": glances}


def _described(glance: Glance) -> dict[str, Any]:
    off_axis_rad = glance.off_axis_rad
    return {
        "t_s": round(glance.t_s, 3),
        "verdict": glance.verdict.value,
        "still_share": round(glance.still_share, 3),
        "turned_deg": round(math.degrees(glance.turned_rad), 3),
        "off_axis_deg": None if off_axis_rad is None else round(math.degrees(off_axis_rad), 2),
        "explained_share": round(glance.explained_share, 3),
        "best_share": round(glance.best_share, 3),
        "ground_hz": None if glance.ground_hz is None else round(glance.ground_hz, 3),
        "sigma_px": round(glance.sigma_px, 2),
    }


def _told(input_: str, calibration: Calibration, configuration: Configuration) -> ToldPlatform:
    camera, size = calibration.camera, calibration.camera.image_size
    glances, first_frames = [], []
    for frames in _stretches(input_, configuration.options):
        first_frames.append(frames[0])
        seen = _seen(frames, calibration, configuration.pipeline)
        glance = glance_at([points for _, points in seen], [t_s for t_s, _ in seen], camera) if len(seen) > 1 else None
        glances += [glance] if glance is not None else []
    places = [points for _, points in _seen(first_frames, calibration, configuration.pipeline)]
    sigma_px = float(np.median([glance.sigma_px for glance in glances])) if glances else math.nan
    between = [share_in_place(one, other, size, sigma_px) for one, other in pairwise(places)]
    return told_platform(glances, [share for share in between if share is not None])


def _stretches(input_: str, options: AnalyzeOptions) -> Iterator[list[Frame]]:
    """Some frames at a time, from the beginning of the clip to its end."""
    whole = options.model_copy(update={"start": None, "end": None, "stride": 1})
    with open_clip(input_, whole) as source:
        info = source.info
        n_frames = info.n_frames or 0
        stride = max(1, round(1.0 / (_FULL_RATE_HZ * info.nominal_dt_s)))
        step_s = info.nominal_dt_s * stride
        length = stride * min(max(math.ceil(_STRETCH_S / step_s) + 1, _LEAST_FRAMES), _MOST_FRAMES)
        n = min(N_STRETCHES, n_frames // length)
        starts = [round(k * (n_frames - length) / max(n - 1, 1)) for k in range(n)]
        if info.kind == "tracks" or (info.kind == "video" and n_frames <= _READ_THROUGH):
            yield from _read_through(source, starts, length, stride)
            return
    for start in starts:
        part = {"start": str(start), "end": str(start + length), "stride": stride}
        try:
            with open_clip(input_, whole.model_copy(update=part)) as source:
                frames = list(source)
        except InputError:
            continue  # a damaged part of a clip tells nothing here; the analysis says so when it comes there
        if frames:
            yield frames


def _read_through(source: Source, starts: list[int], length: int, stride: int) -> Iterator[list[Frame]]:
    """The stretches that begin at the ``starts``, of a source that is read from its beginning."""
    waiting, stretch = deque(starts), list[Frame]()
    for place, frame in enumerate(source):
        if not waiting:
            return
        if place >= waiting[0] and (place - waiting[0]) % stride == 0:
            stretch.append(frame)
        if place == waiting[0] + length - 1:
            waiting.popleft()
            yield stretch
            stretch = []


def _seen(frames: list[Frame], calibration: Calibration, pipeline: PipelineConfig) -> list[tuple[float, PointSet]]:
    """Times and points of frames, by the tracker that is configured, from the last cut on."""
    tracking = pipeline.tracking
    tracking = tracking.model_copy(
        update={
            "max_tracks": min(tracking.max_tracks, _MAX_TRACKS),
            "min_distance_px": max(tracking.min_distance_px, _LEAST_DISTANCE * calibration.camera.image_size.width_px),
            # Our own way is told by what is near.
            "far_share": 0.0,
        }
    )
    seen: list[tuple[float, PointSet]] = []
    for tracked in track_frames(frames, tracking, calibration.mask):
        if tracked.status == FrameStatus.cut:
            seen = []
        if tracked.status in (FrameStatus.first, FrameStatus.ok, FrameStatus.cut):
            seen.append((tracked.frame.t_s, tracked.points))
    return seen
