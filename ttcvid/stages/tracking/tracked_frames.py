"""Frames with the points found in them: the part of an analysis that looks at pictures."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np

from ttcvid.config import TrackingConfig
from ttcvid.model import NO_POINTS, Frame, FrameStatus, Picture, PointSet
from ttcvid.stages.tracking.tracker import PreparedPicture, TrackerMemory, follow_points, prepare_picture

MapAhead = Callable[[Callable[[Frame], Any], Iterable[Frame]], Iterator[Any]]

# A step so long, s, and so many times as long as the last ones were, is a gap: the clock has jumped, or two clips were
# put together. (On an exact drive 80 % of 90 % intervals or more hold after a jump by up to half a second, and 53 %
# after one by a second.)
_GAP_S, _GAP_STEPS, _LAST_STEPS = 0.7, 10.0, 9


@dataclass(frozen=True)
class TrackedFrame:
    """A frame with the points found in it, and what became of it so far."""

    frame: Frame
    points: PointSet
    status: FrameStatus


def compare_table_points(last: PointSet | None, points: PointSet) -> FrameStatus:
    """Status of a frame of a track table: ``first``, ``cut`` (no track goes on), ``duplicate`` or ``ok``.

    A frame is a duplicate when it has the same tracks in exactly the same places.
    """
    if last is None:
        return FrameStatus.first
    if not len(last.track_id) or not len(points.track_id):
        return FrameStatus.ok
    if np.array_equal(last.track_id, points.track_id) and np.array_equal(last.xy_px, points.xy_px):
        return FrameStatus.duplicate
    goes_on = not {*points.track_id.tolist()}.isdisjoint(last.track_id.tolist())
    return FrameStatus.ok if goes_on else FrameStatus.cut


def track_frames(
    frames: Iterable[Frame],
    config: TrackingConfig,
    mask: Picture | None,
    map_ahead: MapAhead = map,
    *,
    camera_rests: bool = False,
) -> Iterator[TrackedFrame]:
    """Each frame with its points: from the tracker, or from the table that the source reads.

    No motion is estimated over a gap in time: the first frame with content after it is a ``cut``. Where the
    ``camera_rests`` all of the time, new points are looked for where its picture changes.
    """
    memory, last_points = TrackerMemory(), None

    def prepare(frame: Frame) -> tuple[Frame, PreparedPicture | None]:
        return frame, None if frame.grey is None else prepare_picture(frame.grey, mask, config)

    last_t_s, last_steps_s, is_gap = -np.inf, deque[float](maxlen=_LAST_STEPS), False
    for frame, prepared in map_ahead(prepare, frames):
        step_s, last_t_s = frame.t_s - last_t_s, max(frame.t_s, last_t_s)
        if not step_s > 0.0:
            yield TrackedFrame(frame, NO_POINTS, FrameStatus.bad_dt)
            continue
        if last_steps_s:
            is_gap |= step_s > max(_GAP_S, _GAP_STEPS * median(last_steps_s))
        if np.isfinite(step_s):
            last_steps_s.append(step_s)
        if prepared is not None:
            points, status, memory = follow_points(
                memory, prepared, mask, config, camera_rests=camera_rests, t_s=frame.t_s
            )
        elif frame.points is not None:
            points, status = frame.points, compare_table_points(last_points, frame.points)
            last_points = points
        else:
            raise ValueError(f"frame {frame.index}: expected a picture or points, got neither")
        if is_gap and status in (FrameStatus.ok, FrameStatus.cut):
            status, is_gap = FrameStatus.cut, False
        yield TrackedFrame(frame, points, status)
