"""One clip followed from end to end for a horizon calibration: its motions, and whether the camera rests."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from ttcvid.config import PipelineConfig
from ttcvid.jobs.clip import Calibration
from ttcvid.jobs.processes.side_by_side import ReadAhead, map_ahead
from ttcvid.model import Frame, FrameStatus, Picture, Platform, PointSet
from ttcvid.pipeline import analyze_frames
from ttcvid.sources import Source
from ttcvid.stages.egomotion.rest import Look, compare_looks, complaint_about_motion
from ttcvid.stages.horizon.driving import own_motions, own_step
from ttcvid.stages.horizon.straight_motion import Motion
from ttcvid.stages.horizon.straight_motions import find_motions
from ttcvid.stages.horizon.whole_tracks import Observations, joined, observations_of, recentred, without_ended_at_rest
from ttcvid.stages.tracking.content import content_offsets
from ttcvid.stages.tracking.moving_parts import (
    Background,
    StreetSample,
    background_of,
    moving_part,
    street_sample,
)
from ttcvid.stages.tracking.silhouettes import Silhouettes
from ttcvid.stages.tracking.tracked_frames import TrackedFrame, track_frames

OnFrame = Callable[[int, int | None], None]
OpenSource = Callable[[], Source]

# Two frames are compared for rest this far apart, s.
_LOOK_S = 0.4
# Tracks that ended at rest are forgotten every so many frames.
_CLEANING_FRAMES = 250
# The background is the median of at least so many pictures, spread over the clip (all of a shorter one).
_BACKGROUND_PICTURES = 30
# Where the content of the windows lies is looked for in every such frame: it stays the same for a track's life.
_CENTRE_FRAMES = 3


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

    @property
    def has_pictures(self) -> bool:
        """Whether it is a clip of pictures, not a table of tracks."""
        return self.background is not None


@dataclass(frozen=True)
class _FirstLook:
    """A clip looked through: how still it is, pictures spread over it, its first one, and a table's tracks."""

    looks: list[Look]
    samples: list[StreetSample]
    picture: Picture | None
    rows: Observations


def watch_resting_clip(
    open_again: OpenSource, calibration: Calibration, config: PipelineConfig, number: int, on_frame: OnFrame | None
) -> WatchedClip:
    """Find the straight motions before a camera that has to rest.

    Pictures are gone through twice: to see whether the camera rests and what the background looks like, and to follow
    what moves before it. A table of tracks is read once.
    """
    with open_again() as source:
        first = _look_through(source, calibration, config, on_frame)
        path, files, report = source.info.path, source.files, source.report
    complaint, warnings = complaint_about_motion(first.looks), report.warnings
    if complaint and config.egomotion.platform == Platform.static:
        warnings, complaint = (*warnings, f"{path}: {complaint}; believed at rest, as --platform says"), ""
    rows, camera, limits = first.rows, calibration.camera, config.horizon_calibration
    if complaint:
        return WatchedClip(path, files, [], complaint, warnings, rows, first.picture)
    silhouettes: Silhouettes | None = None
    if first.samples:
        with open_again() as source:
            rows, silhouettes = _moving_content(source, background_of(first.samples), calibration, config, on_frame)
    motions = find_motions(rows, camera, limits, number, silhouettes)
    return WatchedClip(path, files, motions, complaint, warnings, rows, first.picture)


def _look_through(
    source: Source, calibration: Calibration, config: PipelineConfig, on_frame: OnFrame | None
) -> _FirstLook:
    """Follow the points of the whole picture; of the tracks only those of a table are kept."""
    parts: list[Observations] = []
    looks: list[Look] = []
    samples: list[StreetSample] = []
    every = 1
    recent: deque[TrackedFrame] = deque(maxlen=1 + max(1, round(_LOOK_S / source.info.nominal_dt_s)))
    picture: Picture | None = None
    with ReadAhead(source) as frames:
        for n_done, tracked in enumerate(track_frames(frames, config.tracking, calibration.mask, map_ahead), 1):
            frame, points = tracked.frame, tracked.points
            if on_frame is not None:
                on_frame(n_done, source.info.n_frames)
            if tracked.status not in (FrameStatus.ok, FrameStatus.first, FrameStatus.cut):
                continue
            picture = frame.grey if picture is None else picture
            if tracked.status == FrameStatus.cut:
                recent.clear()
            recent.append(TrackedFrame(frame, points, tracked.status))
            if len(recent) == recent.maxlen:
                look = compare_looks(recent[0].points, points, frame.t_s, source.info.image_size)
                looks += [] if look is None else [look]
            if frame.grey is None:
                parts = _with_points(parts, points, frame)
            elif n_done % every == 0 and len(recent) == recent.maxlen:
                before, now, after = (recent[place].frame.grey for place in (0, len(recent) // 2, -1))
                if before is not None and now is not None and after is not None:
                    samples.append(street_sample(before, now, after))
                if len(samples) >= 2 * _BACKGROUND_PICTURES:
                    samples, every = samples[1::2], 2 * every
    return _FirstLook(looks, samples, picture, joined(parts))


def _moving_content(
    source: Source, background: Background, calibration: Calibration, config: PipelineConfig, on_frame: OnFrame | None
) -> tuple[Observations, Silhouettes]:
    """Tracks of what moves before the background, each where the content of its window lies, and its outlines."""
    parts: list[Observations] = []
    centres: list[Observations] = []
    silhouettes = Silhouettes()

    def cut_out(frame: Frame) -> Frame:
        if frame.grey is None:
            return frame
        mask, grey = moving_part(frame.grey, background)
        silhouettes.put(frame.index, mask)
        return replace(frame, grey=grey)

    with ReadAhead(source) as frames:
        moving = map_ahead(cut_out, frames)
        for n_done, tracked in enumerate(track_frames(moving, config.tracking, calibration.mask), 1):
            frame, points = tracked.frame, tracked.points
            if on_frame is not None:
                on_frame(n_done, source.info.n_frames)
            if frame.grey is None or not len(points.track_id):
                continue
            parts = _with_points(parts, points, frame)
            if frame.index % _CENTRE_FRAMES == 0:
                windows_px = points.windows_px
                found = windows_px + content_offsets(frame.grey, windows_px, config.tracking.window_px)
                centres.append(observations_of(PointSet(points.track_id, found), frame.index, frame.t_s))
    return recentred(joined(parts), joined(centres)), silhouettes


def _with_points(parts: list[Observations], points: PointSet, frame: Frame) -> list[Observations]:
    """The observations of a clip with those of one more frame."""
    parts = [*parts, observations_of(points, frame.index, frame.t_s)]
    return [without_ended_at_rest(joined(parts), frame.index)] if len(parts) > _CLEANING_FRAMES else parts


def watch_driving_clip(
    open_again: OpenSource, calibration: Calibration, config: PipelineConfig, number: int, on_frame: OnFrame | None
) -> WatchedClip:
    """Analyse a drive, and take the directions of own motion from it."""
    with open_again() as source:
        return _driving_clip(source, calibration, config, number, on_frame)


def _driving_clip(
    source: Source, calibration: Calibration, config: PipelineConfig, number: int, on_frame: OnFrame | None
) -> WatchedClip:
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
