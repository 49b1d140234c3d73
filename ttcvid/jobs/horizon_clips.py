"""One clip followed from end to end for a horizon calibration: its motions, and whether the camera rests."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ttcvid.config import PipelineConfig
from ttcvid.jobs.clip import Calibration
from ttcvid.jobs.side_by_side import ReadAhead, map_ahead
from ttcvid.model import FrameStatus, Picture, Platform
from ttcvid.pipeline import TrackedFrame, analyze_frames, track_frames
from ttcvid.sources import Source
from ttcvid.stages.horizon_driving import own_motions, own_step
from ttcvid.stages.horizon_motions import Motion, find_motions
from ttcvid.stages.rest import Look, compare_looks, complaint_about_motion
from ttcvid.stages.whole_tracks import Observations, joined, observations_of, without_ended_at_rest

OnFrame = Callable[[int, int | None], None]

# Two frames are compared for rest this far apart, s.
_LOOK_S = 0.4
# Tracks that ended at rest are forgotten every so many frames.
_CLEANING_FRAMES = 250


@dataclass(frozen=True)
class WatchedClip:
    """What a clip gives to a calibration; ``complaint`` says why it cannot be used, empty where it can.

    ``rows`` are the observations of its moving tracks, ``background`` (H, W) its first picture.
    """

    path: str
    files: tuple[Path, ...]
    motions: list[Motion]
    complaint: str
    warnings: tuple[str, ...]
    rows: Observations
    background: Picture | None


def watch_resting_clip(
    source: Source, calibration: Calibration, config: PipelineConfig, number: int, on_frame: OnFrame | None
) -> WatchedClip:
    """Follow the points of a camera that has to rest, and find the straight motions before it."""
    parts: list[Observations] = []
    looks: list[Look] = []
    recent: deque[TrackedFrame] = deque(maxlen=1 + max(1, round(_LOOK_S / source.info.nominal_dt_s)))
    background: Picture | None = None
    with ReadAhead(source) as frames:
        for n_done, tracked in enumerate(track_frames(frames, config.tracking, calibration.mask, map_ahead), 1):
            frame, points = tracked.frame, tracked.points
            if on_frame is not None:
                on_frame(n_done, source.info.n_frames)
            if tracked.status not in (FrameStatus.ok, FrameStatus.first, FrameStatus.cut):
                continue
            if background is None:
                background = frame.grey
            if tracked.status == FrameStatus.cut:
                recent.clear()
            recent.append(TrackedFrame(frame, points, tracked.status))
            if len(recent) == recent.maxlen:
                look = compare_looks(recent[0].points, points, frame.t_s, source.info.image_size)
                looks += [] if look is None else [look]
            parts.append(observations_of(points, frame.index, frame.t_s))
            if len(parts) > _CLEANING_FRAMES:
                parts = [without_ended_at_rest(joined(parts), frame.index)]
    rows = joined(parts)
    complaint = complaint_about_motion(looks)
    warnings = source.report.warnings
    if complaint and config.egomotion.platform == Platform.static:
        warnings, complaint = (*warnings, f"{source.info.path}: {complaint}; believed at rest, as --platform says"), ""
    motions = (
        []
        if complaint
        else find_motions(rows, calibration.camera, source.info.nominal_dt_s, config.horizon_calibration, number)
    )
    return WatchedClip(source.info.path, source.files, motions, complaint, warnings, rows, background)


def watch_driving_clip(
    source: Source, calibration: Calibration, config: PipelineConfig, number: int, on_frame: OnFrame | None
) -> WatchedClip:
    """Analyse a drive, and take the directions of own motion from it."""
    background: Picture | None = None
    steps = []
    with ReadAhead(source) as frames:
        results = analyze_frames(frames, calibration.camera, config, None, calibration.mask, map_ahead=map_ahead)
        for n_done, (frame, result) in enumerate(results, 1):
            if on_frame is not None:
                on_frame(n_done, source.info.n_frames)
            if background is None:
                background = frame.grey
            if result.status not in (FrameStatus.bad_dt, FrameStatus.dark, FrameStatus.duplicate):
                steps.append(own_step(result))
    motions = own_motions(steps, number)
    return WatchedClip(source.info.path, source.files, motions, "", source.report.warnings, joined([]), background)
