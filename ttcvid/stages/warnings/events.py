"""Warnings: objects that will come close soon, with persistence before and hysteresis after."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from scipy.special import logit, ndtr, stdtrit

from ttcvid.config import EventsConfig
from ttcvid.model import ClusterRow, Event, MotionState
from ttcvid.stages.warnings.course import Course, Viewpoint, course_of, surety

# A warning of what is hidden, or of which it is open where it goes, stands so many times as long as one that is over:
# it is still there. So long is waited, too, for what was on its way to a warning.
_HIDDEN = 3.0
# What appears where something under watch was lost, with this part of the smaller box in common, is the same thing.
_SAME_PLACE = 0.3
# An even chance: less than this asked for is nothing to be surer than.
_EVEN = 0.5
# A step so many times as long as usual is a gap.
_STALLED = 1.5
# Times of pictures are rounded to the clock of their container, and differences of them once more: what has lasted as
# long as the persistence within this, s, has lasted as long.
_ROUNDING_S = 1e-3
# A miss distance without a side, in widths.
_TINY = 1e-9
# No tail is believed beyond this many standard deviations, 99.99 %: matching errors are not normal that far out.
_SIGMAS_BELIEVED = 3.719


@dataclass(frozen=True)
class WatchedObject:
    """An object under watch, and its warning.

    Its condition holds since ``since_s``, last at ``last_s`` in the box ``box_px``; seen later, at ``seen_s``, it has
    been open since then.
    ``near_s`` is for how long it would be warned of, as far as that is worth (`_worth`), None where it would not;
    ``recent`` what was known of it at the times of the last ``persistence_s``: (t_s, tcpa_s, *miss_widths).
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
    """Warnings active in this frame, and what to remember.

    A warning starts when an object has met the condition for ``persistence_s`` without a gap, in which what is surer
    than asked for counts for more (`_worth`); or, after having come at us for as long but a little later, when it meets
    it and what its time was by then has run down below the limit (`_has_run_down`). A look counts for the time since
    the look before; one at which it is open where the object goes, as without any value, is no gap, but counts for
    nothing. It ends when the object has not met the looser condition for as long, or has been hidden, or open, for
    `_HIDDEN` times as long. An object that gets another number behind what hid it is warned of at once.

    Parameters
    ----------
    step_s : usual time between frames; what is looked at so seldom that this is longer than the persistence has no gap.
    """
    gone_s = _gone_s(config)
    longest_step_s = max(gone_s, _STALLED * step_s)
    rows = {row.cluster_id: row for row in clusters}
    watched: dict[int, WatchedObject] = {}
    next_event_id = memory.next_event_id
    # What is lost first, whatever its number: something else may turn out to be it.
    for cluster_id in sorted(set(rows) | set(memory.watched), key=lambda number: (number in rows, number)):
        before = memory.watched.get(cluster_id)
        warned = before is not None and before.event is not None
        row = rows.get(cluster_id)
        if before is not None and not warned and t_s - before.seen_s > longest_step_s:
            # Not looked at in between (dark or doubled pictures): that is no persistence.
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
    """An object whose condition holds now, its warning as before."""
    known = (t_s, float(row.times.tcpa_s[0]), *miss_widths)
    if before is None:
        return WatchedObject(t_s, t_s, t_s, row.box_px, recent=(known,))
    # After a gap what was before it.
    first_s = min(t_s - _gone_s(config), before.recent[-1][0])
    recent = (*(one for one in before.recent if one[0] >= first_s), known)
    return replace(before, seen_s=t_s, last_s=t_s, box_px=row.box_px, recent=recent)


def _paused(one: WatchedObject, until_s: float) -> WatchedObject:
    """The same, the time since its condition held last left out, up to this one."""
    return replace(one, since_s=one.since_s + until_s - one.last_s, last_s=until_s)


def _near_s(before: WatchedObject | None, course: Course | None, t_s: float, config: EventsConfig) -> float | None:
    """For how long an object would have been warned of by now; None where it would not be."""
    if course is None or not course.is_sure:
        return None
    if before is None or before.near_s is None:
        return 0.0
    return before.near_s + _worth(course.sigmas, config) * (t_s - before.last_s)


def _under_new_number(lost: WatchedObject, t_s: float, config: EventsConfig) -> WatchedObject:
    """What was under watch and has another number now: if it was warned of, it is to be warned of at once."""
    if lost.event is None:
        return lost
    warned_s = t_s - config.persistence_s
    return replace(lost, since_s=min(lost.since_s, warned_s), near_s=config.persistence_s, event=None)


def _lasts(lasted_s: float, config: EventsConfig) -> bool:
    """Whether what has held for so long has held for the persistence."""
    return lasted_s >= config.persistence_s - _ROUNDING_S


def _worth(sigmas: float, config: EventsConfig) -> float:
    """How many times as long as it lasts a condition counts that holds by so many standard deviations.

    As in Wald's sequential test, where log odds add up until they are enough: enough is the confidence for the
    persistence, over which errors of neighbouring frames hang together, so that odds count by the time.
    """
    asked, sure = config.confidence, float(ndtr(min(sigmas, _SIGMAS_BELIEVED)))
    return float(max(logit(sure) / logit(asked), 1.0)) if asked > _EVEN else 1.0


def _has_run_down(one: WatchedObject, t_s: float, config: EventsConfig) -> bool:
    """Whether a thing is near in time by most of what its time was lately, and has come at us for as long.

    That a time runs down needs no proof, but a single one of them may err.
    """
    left_s = [tcpa_s - (t_s - then_s) for then_s, tcpa_s, *_ in one.recent]
    return _lasts(t_s - one.since_s, config) and float(np.median(left_s)) <= config.max_ttc_s


def _turns_away(one: WatchedObject, t_s: float, config: EventsConfig) -> bool:
    """Whether a thing that heads at us now surely will not do so by its closest approach, as its way bends.

    A bus on a roundabout heads at us for a moment. What accelerates across its way by a goes on to miss us by more: by
    a times the time that is left in each second, and by half of that rate times this time until then. The rate is that
    of a straight line through the miss distances of the persistence, to the side on which it is now, as unsure as they
    scatter about it. (Who brakes is reached by the limit, long before the time at constant velocity.)
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
    """Number of an object under watch that is not there any more and was last where this box is; None: none."""
    for cluster_id, one in watched.items():
        if cluster_id not in rows and _common_part(box_px, one.box_px) > _SAME_PLACE:
            return cluster_id
    return None


def _common_part(one: tuple[float, float, float, float], other: tuple[float, float, float, float]) -> float:
    """Area that two boxes have in common over that of the smaller one."""
    width = min(one[2], other[2]) - max(one[0], other[0])
    height = min(one[3], other[3]) - max(one[1], other[1])
    smaller = min((box[2] - box[0]) * (box[3] - box[1]) for box in (one, other))
    return max(width, 0.0) * max(height, 0.0) / smaller if smaller > 0.0 else 0.0


def _gone_s(config: EventsConfig) -> float:
    """What is gone for longer has gone."""
    return config.persistence_s + _ROUNDING_S


def standing_events(memory: EventMemory, t_s: float, config: EventsConfig) -> tuple[Event, ...]:
    """Warnings that stand in a frame in which nothing is looked at: as they were, until that has lasted too long."""
    recent = [watched for watched in memory.watched.values() if t_s - watched.last_s <= _HIDDEN * _gone_s(config)]
    return tuple(watched.event for watched in recent if watched.event is not None)


def restarted_events(memory: EventMemory) -> EventMemory:
    """Nothing under watch any more, but no number given out twice."""
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
