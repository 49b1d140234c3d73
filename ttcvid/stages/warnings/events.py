"""Warnings of objects on collision course: they start after a persistence and end with hysteresis."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from scipy.special import logit, ndtr, stdtrit

from ttcvid.config import EventsConfig
from ttcvid.model import ClusterRow, Event, MotionState
from ttcvid.stages.warnings.course import Course, Viewpoint, course_of, surety

# A hidden object, or one whose course is open, is still there: its warning, or its watch, lasts this many times as long
# as that of an object whose condition no longer holds.
_HIDDEN = 3.0
# An object is re-identified with a lost one if their boxes overlap by this share of the smaller one.
_SAME_PLACE = 0.3
# Up to an even chance there are no odds to add up.
_EVEN = 0.5
# A step between frames this many times as long as the usual one is a gap.
_STALLED = 1.5
# Presentation times are rounded to the clock of their container: tolerance of a comparison of durations, s.
_ROUNDING_S = 1e-3
# A shorter miss vector has no direction, widths.
_TINY = 1e-9
# Probabilities are capped at this many standard deviations, 99.99 %: matching errors have heavier tails than a normal.
_SIGMAS_BELIEVED = 3.719


@dataclass(frozen=True)
class WatchedObject:
    """An object that meets the looser condition of a warning, and its warning.

    Attributes
    ----------
    since_s, last_s : presentation times at which the condition began to hold and held last.
    seen_s : when the object was last seen; after ``last_s`` its course is open.
    box_px : its box at ``last_s``: left, top, right, bottom.
    near_s : for how long the condition of a warning has held, weighted by `_worth`; None where it does not hold.
    recent : ``(t_s, tcpa_s, *miss_widths)`` of each frame of the last ``persistence_s``.
    event : its warning; None before it starts.
    """

    since_s: float
    seen_s: float
    last_s: float
    box_px: tuple[float, float, float, float]
    near_s: float | None = None
    recent: tuple[tuple[float, ...], ...] = ()
    event: Event | None = None


@dataclass(frozen=True)
class EventMemory:
    """Objects under watch by ``cluster_id``, and the number of the next warning."""

    watched: dict[int, WatchedObject] = field(default_factory=dict)
    next_event_id: int = 1


def update_events(
    memory: EventMemory,
    frame: int,
    t_s: float,
    clusters: tuple[ClusterRow, ...],
    view: Viewpoint,
    config: EventsConfig,
    *,
    step_s: float = 0.0,
) -> tuple[tuple[Event, ...], EventMemory]:
    """Warnings active in this frame, and the memory for the next one.

    A warning starts when an object meets the condition (`course_of`) and has either

    - met it for ``persistence_s``, where time at a higher confidence counts more (`_worth`), or
    - met the looser condition for ``persistence_s`` while its time ran down below the limit (`_has_run_down`).

    Each frame counts for the time since the frame before. A frame in which the course is open, or the object has no
    value, counts for nothing, but is no interruption. A warning ends when the object has not met the looser condition
    for ``persistence_s``, or has been hidden or open for `_HIDDEN` times as long. A warned object that reappears under
    another ``cluster_id`` is warned of at once.

    Parameters
    ----------
    frame, t_s : index and presentation time of the frame.
    clusters : rows of the frame.
    step_s : usual time between frames; where it exceeds the persistence, a single step is no gap.
    view : as in `course_of`.
    """
    gone_s = _gone_s(config)
    longest_step_s = max(gone_s, _STALLED * step_s)
    rows = {row.cluster_id: row for row in clusters}
    watched: dict[int, WatchedObject] = {}
    next_event_id = memory.next_event_id
    # Lost objects first: an object of this frame may be one of them.
    for cluster_id in sorted(set(rows) | set(memory.watched), key=lambda number: (number in rows, number)):
        before = memory.watched.get(cluster_id)
        warned = before is not None and before.event is not None
        row = rows.get(cluster_id)
        if before is not None and not warned and t_s - before.seen_s > longest_step_s:
            # Frames without an analysis (dark, duplicate) interrupt the persistence.
            before = None
        if row is None:
            if before is not None and t_s - before.last_s <= _HIDDEN * gone_s:
                watched[cluster_id] = before
            continue
        course = partial(course_of, row, view, config)
        seen = course(is_warned=warned, is_watched=True)
        if seen is None or not seen.is_sure:
            left_s = gone_s * (float(warned) if seen is None else _HIDDEN)
            if before is not None and t_s - before.last_s <= left_s:
                watched[cluster_id] = before if seen is None else replace(before, seen_s=t_s)
            continue
        if before is None:
            lost_id = _lost_at(row.box_px, watched, rows)
            before = None if lost_id is None else _under_new_number(watched.pop(lost_id), t_s, config)
        if before is not None:
            before = _paused(before, before.seen_s)
            before = _paused(before, t_s) if t_s - before.last_s > longest_step_s else before
        now = _watched(before, row, seen.miss_widths, t_s, config)
        if now.event is not None:
            now = replace(now, event=_continued(now.event, row, frame, t_s))
        else:
            now = replace(now, near_s=_near_s(before, course(), t_s, config))
            lasts = now.near_s is not None and (_lasts(now.near_s, config) or _has_run_down(now, t_s, config))
            if lasts and not _turns_away(now, t_s, config):
                now = replace(now, event=_started(next_event_id, row, frame, t_s))
                next_event_id += 1
        watched[cluster_id] = now
    active = tuple(one.event for _, one in sorted(watched.items()) if one.event is not None)
    return active, EventMemory(watched, next_event_id)


def _watched(
    before: WatchedObject | None, row: ClusterRow, miss_widths: tuple[float, ...], t_s: float, config: EventsConfig
) -> WatchedObject:
    """The object with this frame added; its warning is not touched."""
    known = (t_s, float(row.times.tcpa_s[0]), *miss_widths)
    if before is None:
        return WatchedObject(t_s, t_s, t_s, row.box_px, recent=(known,))
    # After a gap, the last frame before it is kept.
    first_s = min(t_s - _gone_s(config), before.recent[-1][0])
    recent = (*(one for one in before.recent if one[0] >= first_s), known)
    return replace(before, seen_s=t_s, last_s=t_s, box_px=row.box_px, recent=recent)


def _paused(one: WatchedObject, until_s: float) -> WatchedObject:
    """The object with the time from ``last_s`` to ``until_s`` left out of its persistence."""
    return replace(one, since_s=one.since_s + until_s - one.last_s, last_s=until_s)


def _near_s(before: WatchedObject | None, course: Course | None, t_s: float, config: EventsConfig) -> float | None:
    """For how long the condition of a warning has held, s, weighted by `_worth`; None where it does not hold."""
    if course is None or not course.is_sure:
        return None
    if before is None or before.near_s is None:
        return 0.0
    return before.near_s + _worth(course.sigmas, config) * (t_s - before.last_s)


def _under_new_number(lost: WatchedObject, t_s: float, config: EventsConfig) -> WatchedObject:
    """A lost object re-identified under another ``cluster_id``: one with a warning gets its persistence for free."""
    if lost.event is None:
        return lost
    warned_s = t_s - config.persistence_s
    return replace(lost, since_s=min(lost.since_s, warned_s), near_s=config.persistence_s, event=None)


def _lasts(lasted_s: float, config: EventsConfig) -> bool:
    """Whether a duration reaches the persistence."""
    return lasted_s >= config.persistence_s - _ROUNDING_S


def _worth(sigmas: float, config: EventsConfig) -> float:
    """Factor (at least 1) by which time counts towards the persistence, for a condition met by so many sigmas.

    Log odds add up as in Wald's sequential test. Enough is the configured confidence during the persistence: errors of
    neighbouring frames are correlated, so that odds count per time and not per frame.
    """
    asked, sure = config.confidence, float(ndtr(min(sigmas, _SIGMAS_BELIEVED)))
    return float(max(logit(sure) / logit(asked), 1.0)) if asked > _EVEN else 1.0


def _has_run_down(one: WatchedObject, t_s: float, config: EventsConfig) -> bool:
    """Whether an object has met the looser condition for the persistence, and its recent times, run down, are short.

    The median of the recent ``tcpa_s``, each less the time since, has to be within the limit: one of them may err.
    """
    left_s = [tcpa_s - (t_s - then_s) for then_s, tcpa_s, *_ in one.recent]
    return _lasts(t_s - one.since_s, config) and float(np.median(left_s)) <= config.max_ttc_s


def _turns_away(one: WatchedObject, t_s: float, config: EventsConfig) -> bool:
    """Whether an object on a bend surely misses us, although it heads at us at this moment (a bus on a roundabout).

    Under a transverse acceleration a the miss distance of the present velocity grows by a times the time left, per
    second, and by half that rate times the time left until the closest approach. The rate and its standard deviation
    come from a straight line through the miss distances of the persistence, along their present direction, with their
    own scatter as noise. The time left is capped at the limit: a braking object is reached long before its time at
    constant velocity.
    """
    times_s, tcpa_s, *off_widths = np.array(one.recent).T
    off, ago_s = np.array(off_widths).T, times_s - t_s
    miss_widths = off @ off[-1] / max(float(np.linalg.norm(off[-1])), _TINY)
    free = len(ago_s) - 2
    if free < 1:
        return False
    columns = np.column_stack([np.ones(len(ago_s)), ago_s])
    cov = np.linalg.inv(columns.T @ columns)
    line = cov @ (columns.T @ miss_widths)
    left = miss_widths - columns @ line
    then = np.array([1.0, 0.5 * min(tcpa_s[-1], config.max_ttc_s)])
    sigma = math.sqrt(float(then @ cov @ then) * float(left @ left) / free)
    surely = float(stdtrit(free, max(config.confidence, _EVEN)))
    return bool(then @ line - surely * sigma > config.max_miss_widths)


def _lost_at(
    box_px: tuple[float, float, float, float], watched: dict[int, WatchedObject], rows: dict[int, ClusterRow]
) -> int | None:
    """``cluster_id`` of a watched object that is lost and whose last box overlaps this one; None: there is none."""
    for cluster_id, one in watched.items():
        if cluster_id not in rows and _common_part(box_px, one.box_px) > _SAME_PLACE:
            return cluster_id
    return None


def _common_part(one: tuple[float, float, float, float], other: tuple[float, float, float, float]) -> float:
    """Area of the intersection of two boxes over that of the smaller one."""
    width = min(one[2], other[2]) - max(one[0], other[0])
    height = min(one[3], other[3]) - max(one[1], other[1])
    smaller = min((box[2] - box[0]) * (box[3] - box[1]) for box in (one, other))
    return max(width, 0.0) * max(height, 0.0) / smaller if smaller > 0.0 else 0.0


def _gone_s(config: EventsConfig) -> float:
    """Longest interruption of a condition that is not its end, s."""
    return config.persistence_s + _ROUNDING_S


def standing_events(memory: EventMemory, t_s: float, config: EventsConfig) -> tuple[Event, ...]:
    """Warnings still active in a frame without an analysis; each ends as if its object were hidden."""
    recent = [watched for watched in memory.watched.values() if t_s - watched.last_s <= _HIDDEN * _gone_s(config)]
    return tuple(watched.event for watched in recent if watched.event is not None)


def restarted_events(memory: EventMemory) -> EventMemory:
    """Memory without watched objects; event numbers go on."""
    return EventMemory(next_event_id=memory.next_event_id)


def _started(event_id: int, row: ClusterRow, frame: int, t_s: float) -> Event:
    kind = "constant_bearing" if row.motion_state == MotionState.constant_bearing else "collision_course"
    event = Event(
        event_id,
        kind,
        row.cluster_id,
        frame,
        frame,
        t_s,
        t_s,
        None,
        None,
        None,
        surety(row.state_abc_hz, row.state_cov),
    )
    return _continued(event, row, frame, t_s)


def _continued(event: Event, row: ClusterRow, frame: int, t_s: float) -> Event:
    tcpa_s, ttc_z_s = float(row.times.tcpa_s[0]), float(row.times.ttc_z_s[0])
    is_nearer = event.min_tcpa_s is None or tcpa_s < event.min_tcpa_s
    ahead = [t for t in (event.min_ttc_z_s, ttc_z_s) if t is not None and t > 0.0]
    return replace(
        event,
        end_frame=frame,
        end_s=t_s,
        min_ttc_z_s=min(ahead) if ahead else None,
        min_tcpa_s=tcpa_s if is_nearer else event.min_tcpa_s,
        miss_s=float(row.times.miss_s[0]) if is_nearer else event.miss_s,
        confidence=surety(row.state_abc_hz, row.state_cov) if is_nearer else event.confidence,
    )
