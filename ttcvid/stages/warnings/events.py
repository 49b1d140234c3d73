"""Warnings of objects on collision course: the probability of one frame, filtered over frames by a two-state model."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import expit, logit

from ttcvid.config import EventsConfig
from ttcvid.model import ClusterRow, Event, MotionState
from ttcvid.stages.segmentation.bodies import ROUNDING_S
from ttcvid.stages.warnings.course import Course, Viewpoint, approach_probability, course_of, has_course

# A hidden object, or one whose course is open, is still there: it is forgotten after this many times the persistence.
_HIDDEN = 3.0
# Probability that a course changes within a persistence, over that of a wrong warning (one less the confidence), and
# the most that it may be: more would keep what is surely on collision course from ever being warned of.
_CHANGES, _MOST_CHANGES = 2.5, 0.25
# An object is re-identified with a lost one if their boxes overlap by this share of the smaller one.
_SAME_PLACE = 0.3
# A warning asks for at least this probability: below it nothing would have to be gathered.
_LEAST_ASKED = 0.6
# Even odds.
_EVEN = 0.5
# A step between frames this many times as long as the usual one is a gap.
_STALLED = 1.5
# A state rests on the views of the last frames, open ones too: it speaks for so much time, its own included, in
# persistences.
_MOST_OPEN = 0.5
# Log odds grow to this many times those that a warning asks for: what ends has to be told in time.
_HIGHEST = 1.6


@dataclass(frozen=True)
class WatchedObject:
    """An object whose course has been known, and its warning.

    log_odds : of a collision course, by all frames so far.
    last_s : presentation time at which its course was known last.
    box_px : its box at ``last_s``: left, top, right, bottom.
    open_s : time since then in which it was seen and its course was open, less that in which it was not.
    event : its warning; None before it starts.
    """

    log_odds: float
    last_s: float
    box_px: tuple[float, float, float, float]
    open_s: float = 0.0
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
    probability, soon by this frame; it ends where it is none with the same probability. A frame in which the course is
    open counts for nothing by itself, but the next one speaks for it, too (`_MOST_OPEN`). A warned object that
    reappears under another ``cluster_id`` is warned of at once.

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
                is_open = row is not None and not has_course(row) and looked_s > 0.0
                # While it is not seen, the views of open frames leave the window of its next state.
                open_s = before.open_s + looked_s if is_open else max(before.open_s - since_s, 0.0)
                watched[cluster_id] = replace(before, open_s=open_s)
            continue
        if before is None:
            # It may be one that is lost, whose last box overlaps this one.
            lost = (number for number in watched if number not in rows)
            lost = (number for number in lost if _common_part(row.box_px, watched[number].box_px) > _SAME_PLACE)
            lost_id = next(lost, None)
            before = None if lost_id is None else replace(watched.pop(lost_id), event=None)
        now = _watched(before, course, row, t_s, looked_s, config)
        is_probable = course.probability > _EVEN
        is_sure = is_probable and course.is_soon and now.log_odds >= _asked(config)
        if now.event is not None:
            ends = now.log_odds <= -_asked(config)
            event = _continued(now.event, row, frame, t_s) if is_probable else now.event
            now = replace(now, event=None if ends else event)
        elif is_sure:
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
    if before is None:
        return WatchedObject(-asked, t_s, row.box_px)
    at_first = float(expit(-asked))
    changes = min(_CHANGES * at_first, _MOST_CHANGES) / config.persistence_s
    lasts = math.exp(changes * (before.last_s - t_s))
    odds = float(logit(at_first + lasts * (float(expit(before.log_odds)) - at_first)))
    # However sure its frames are, a warning takes the persistence, open frames included: errors of neighbouring frames
    # are correlated.
    told = float(np.clip(logit(course.probability), -2.0 * asked, 2.0 * asked))
    if looked_s > 0.0:
        looked_s = max(looked_s, min(looked_s + before.open_s, _MOST_OPEN * config.persistence_s))
    odds = float(np.clip(odds + told * looked_s / config.persistence_s, -asked, _HIGHEST * asked))
    return replace(before, log_odds=odds, last_s=t_s, box_px=row.box_px, open_s=0.0)


def _asked(config: EventsConfig) -> float:
    """Log odds that a warning starts at; those of none at its end."""
    return float(logit(max(config.confidence, _LEAST_ASKED)))


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
