"""Warnings of objects on collision course: the probability of one frame, filtered over frames by a two-state model."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import expit, logit, stdtrit

from ttcvid.config import EventsConfig
from ttcvid.model import ClusterRow, Event, Floats, MotionState
from ttcvid.stages.segmentation.bodies import ROUNDING_S
from ttcvid.stages.warnings.course import Course, Viewpoint, approach_probability, course_of

# A hidden object, or one whose course is open, is still there: it is forgotten after this many times the persistence.
_HIDDEN = 3.0
# Probability that a course changes within a persistence, over that of a wrong warning (one less the confidence), and
# the most that it may be: more would keep what is surely on collision course from ever being warned of.
_CHANGES, _MOST_CHANGES = 2.5, 0.25
# The time that is left falls by a second each second, and by half of one under brakes that stop just before the object
# (Lee 1976, tau-dot): what surely falls more slowly than this, over this time, is not reached.
_LEAST_FALL, _TREND_S, _SURELY = 0.5, 1.0, 0.95
# An object is re-identified with a lost one if their boxes overlap by this share of the smaller one.
_SAME_PLACE = 0.3
# A warning asks for at least this probability: below it nothing would have to be gathered.
_LEAST_ASKED = 0.6
# Even odds.
_EVEN = 0.5
# A step between frames this many times as long as the usual one is a gap.
_STALLED = 1.5
# A shorter miss vector has no direction, widths.
_TINY = 1e-9
# Log odds grow to this many times those that a warning asks for: what ends has to be told in time.
_HIGHEST = 1.6


@dataclass(frozen=True)
class WatchedObject:
    """An object whose course has been known, and its warning.

    log_odds : of a collision course, by all frames so far.
    last_s : presentation time at which its course was known last.
    box_px : its box at ``last_s``: left, top, right, bottom.
    recent : ``(t_s, tcpa_s, *miss_widths)`` of each frame of the last ``persistence_s`` in which it was probable.
    times_left : ``(t_s, tcpa_s)`` of each frame of the last `_TREND_S` in which it approached.
    event : its warning; None before it starts.
    """

    log_odds: float
    last_s: float
    box_px: tuple[float, float, float, float]
    recent: tuple[tuple[float, ...], ...] = ()
    times_left: tuple[tuple[float, float], ...] = ()
    event: Event | None = None


@dataclass(frozen=True)
class EventMemory:
    """Objects under watch by ``cluster_id``, the number of the next warning, and the time of the last frame, s."""

    watched: dict[int, WatchedObject] = field(default_factory=dict)
    next_event_id: int = 1
    t_s: float | None = None


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

    An object is on collision course or not, and changes between the two now and then (`_CHANGES`). Log odds of the
    probabilities of its frames (`course_of`) add up; errors of neighbouring frames are correlated, so that they count
    per ``persistence_s`` and not per frame, and that time is needed however sure the frames are. At first it is none
    with a probability of ``confidence``. A warning starts where the object is on collision course with this
    probability, soon by this frame, unless the last ones contradict it (`_turns_away`, `_stays_ahead`); it ends where
    it is none with the same probability. A frame in which the course is open, or the object has no value, counts for
    nothing. A warned object that reappears under another ``cluster_id`` is warned of at once.

    Where ``step_s``, the usual time between frames, exceeds the persistence, a single step is no gap.
    """
    since_s = 0.0 if memory.t_s is None else t_s - memory.t_s
    # Frames without an analysis (dark, duplicate) tell nothing.
    looked_s = since_s if since_s <= max(_gone_s(config), _STALLED * step_s) else 0.0
    rows = {row.cluster_id: row for row in clusters}
    watched: dict[int, WatchedObject] = {}
    next_event_id = memory.next_event_id
    # Lost objects first: an object of this frame may be one of them.
    for cluster_id in sorted(set(rows) | set(memory.watched), key=lambda number: (number in rows, number)):
        before, row = memory.watched.get(cluster_id), rows.get(cluster_id)
        if before is not None and t_s - before.last_s > max(_HIDDEN * _gone_s(config), _STALLED * step_s):
            before = None
        course = None if row is None else course_of(row, view, config)
        if row is None or course is None:
            if before is not None:
                watched[cluster_id] = before
            continue
        if before is None:
            # It may be one that is lost, whose last box overlaps this one.
            lost = (number for number in watched if number not in rows)
            lost = (number for number in lost if _common_part(row.box_px, watched[number].box_px) > _SAME_PLACE)
            lost_id = next(lost, None)
            before = None if lost_id is None else replace(watched.pop(lost_id), event=None, times_left=())
        now = _watched(before, course, row, t_s, looked_s, config)
        is_probable = course.probability > _EVEN
        is_sure = is_probable and course.is_soon and now.log_odds >= _asked(config)
        if now.event is not None:
            ends = now.log_odds <= -_asked(config)
            event = _continued(now.event, row, frame, t_s) if is_probable else now.event
            now = replace(now, event=None if ends else event)
        elif is_sure and not _turns_away(now, t_s, config) and not _stays_ahead(now):
            now = replace(now, event=_started(next_event_id, row, frame, t_s))
            next_event_id += 1
        watched[cluster_id] = now
    active = tuple(one.event for _, one in sorted(watched.items()) if one.event is not None)
    return active, EventMemory(watched, next_event_id, t_s)


def _watched(
    before: WatchedObject | None, course: Course, row: ClusterRow, t_s: float, looked_s: float, config: EventsConfig
) -> WatchedObject:
    """The object with this frame added; its warning is not touched."""
    asked = _asked(config)
    recent = () if before is None else tuple(one for one in before.recent if one[0] >= t_s - _gone_s(config))
    since_s = t_s - _TREND_S - ROUNDING_S
    times_left = () if before is None else tuple(one for one in before.times_left if one[0] >= since_s)
    tcpa_s = float(row.times.tcpa_s[0])
    if 0.0 < tcpa_s < math.inf:
        times_left = (*times_left, (t_s, tcpa_s))
    if course.probability > _EVEN:
        recent = (*recent, (t_s, tcpa_s, *course.miss_widths))
    if before is None:
        return WatchedObject(-asked, t_s, row.box_px, recent, times_left)
    at_first = float(expit(-asked))
    changes = min(_CHANGES * at_first, _MOST_CHANGES) / config.persistence_s
    lasts = math.exp(changes * (before.last_s - t_s))
    odds = float(logit(at_first + lasts * (float(expit(before.log_odds)) - at_first)))
    # However sure its frames are, a warning takes the persistence: their errors are common to neighbouring frames.
    told = float(np.clip(logit(course.probability), -2.0 * asked, 2.0 * asked))
    odds = float(np.clip(odds + told * looked_s / config.persistence_s, -asked, _HIGHEST * asked))
    return replace(before, log_odds=odds, last_s=t_s, box_px=row.box_px, recent=recent, times_left=times_left)


def _asked(config: EventsConfig) -> float:
    """Log odds that a warning starts at; those of none at its end."""
    return float(logit(max(config.confidence, _LEAST_ASKED)))


def _turns_away(one: WatchedObject, t_s: float, config: EventsConfig) -> bool:
    """Whether an object on a bend surely misses us (a bus on a roundabout).

    Under a transverse acceleration a the miss distance of the present velocity grows by a times the time left, per
    second, and by half that rate times the time left until the closest approach. The rate and its standard deviation
    come from a straight line through the miss distances of the persistence, along their present direction, with their
    own scatter as noise. The time left is capped at the limit: a braking object is reached long before its time at
    constant velocity.
    """
    times_s, tcpa_s, *off_widths = np.array(one.recent).T
    off, ago_s = np.array(off_widths).T, times_s - t_s
    miss_widths = off @ off[-1] / max(float(np.linalg.norm(off[-1])), _TINY)
    then = np.array([1.0, 0.5 * min(tcpa_s[-1], config.max_ttc_s)])
    return _lower_bound(ago_s, miss_widths, then, max(config.confidence, _EVEN)) > config.max_miss_widths


def _stays_ahead(one: WatchedObject) -> bool:
    """Whether the time that is left surely falls too slowly for an object to be reached (`_LEAST_FALL`).

    By a straight line through the times of the last `_TREND_S`. A piece of roadside that is taken for one object stays
    as far away as it is: new parts come as others pass.
    """
    times_s, tcpa_s = np.array(one.times_left).T
    return _lower_bound(times_s - times_s[-1], tcpa_s, np.array([0.0, 1.0]), _SURELY) > -_LEAST_FALL


def _lower_bound(ago_s: Floats, values: Floats, of_line: Floats, surely: float) -> float:
    """Lower bound of a combination ``of_line (2,)`` of offset and slope of a line through values ``(N,)``.

    By their own scatter, with the probability ``surely``; minus infinity with fewer than three values.
    """
    free = len(ago_s) - 2
    if free < 1:
        return -math.inf
    columns = np.column_stack([np.ones(len(ago_s)), ago_s])
    cov = np.linalg.inv(columns.T @ columns)
    line = cov @ (columns.T @ values)
    left = values - columns @ line
    sigma = math.sqrt(float(of_line @ cov @ of_line) * float(left @ left) / free)
    return float(of_line @ line) - float(stdtrit(free, surely)) * sigma


def _common_part(one: tuple[float, float, float, float], other: tuple[float, float, float, float]) -> float:
    """Area of the intersection of two boxes over that of the smaller one."""
    width = min(one[2], other[2]) - max(one[0], other[0])
    height = min(one[3], other[3]) - max(one[1], other[1])
    smaller = min((box[2] - box[0]) * (box[3] - box[1]) for box in (one, other))
    return max(width, 0.0) * max(height, 0.0) / smaller if smaller > 0.0 else 0.0


def _gone_s(config: EventsConfig) -> float:
    """Longest interruption of a condition that is not its end, s."""
    return config.persistence_s + ROUNDING_S


def standing_events(memory: EventMemory, t_s: float, config: EventsConfig) -> tuple[Event, ...]:
    """Warnings still active in a frame without an analysis; each ends as if its object were hidden."""
    recent = [watched for watched in memory.watched.values() if t_s - watched.last_s <= _HIDDEN * _gone_s(config)]
    return tuple(watched.event for watched in recent if watched.event is not None)


def _started(event_id: int, row: ClusterRow, frame: int, t_s: float) -> Event:
    kind = "constant_bearing" if row.motion_state == MotionState.constant_bearing else "collision_course"
    event = Event(event_id, kind, row.cluster_id, frame, frame, t_s, t_s, None, None, None, 0.0)
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
        confidence=approach_probability(row.state_abc_hz, row.state_cov) if is_nearer else event.confidence,
    )
