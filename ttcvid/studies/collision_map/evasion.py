"""The smallest change of own velocity that keeps a collision improbable, within what brakes and tyres can do."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from ttcvid.model import Floats
from ttcvid.studies.collision_map.contacts import AHEAD, RIGHT
from ttcvid.studies.collision_map.hazards import Situation
from ttcvid.studies.collision_map.velocity_map import Outcomes, outcomes, ways

_N_SPEEDS, _N_COURSES = 21, 31
"""Changes tried at a time."""
_N_ZOOMS = 3
"""How often the search is repeated among the changes that are smaller than the best one so far."""
_PROBABILITY_DIGITS = 3
_TIE = 1.05
"""Changes whose sizes differ by less than this factor count as equally small: the one least to the side is taken."""
_FARTHEST_TURN_RAD = 0.5 * np.pi


class EvasionStatus(StrEnum):
    """What is to be done."""

    no_danger = "no_danger"
    advice = "advice"
    no_escape = "no_escape"
    """No change within the limits suffices; the best one is given."""
    unknown = "unknown"
    """No danger is known of, but what could be hit is not known well enough to say that there is none."""
    no_scale = "no_scale"
    """Nothing of the frame has metres."""
    no_result = "no_result"
    """The frame has no motion to judge."""


@dataclass(frozen=True)
class EvasionLimits:
    """What we can do and what we want: accelerations (``forward_m_s2``: speeding up), times, and a probability.

    Braking and steering share what the tyres hold: together they stay within an ellipse of both limits. At low speed it
    is the narrowest turn, ``turning_radius_m``, that limits the change of course. ``course_rad`` are the courses, from
    ahead to the right, that may be advised: where the camera looks.
    A contact within ``warn_s`` that is more probable than ``max_probability`` asks for an evasion; an evasion is good
    when a contact within ``look_ahead_s`` is no more probable than that. With one time for both, an evasion would
    first be one that puts the contact off by a blink.
    """

    braking_m_s2: float = 6.0
    sideways_m_s2: float = 3.0
    forward_m_s2: float = 0.0
    turning_radius_m: float = 5.5
    warn_s: float = 3.5
    look_ahead_s: float = 5.0
    max_probability: float = 0.1
    course_rad: tuple[float, float] = (-np.pi, np.pi)


@dataclass(frozen=True)
class Evasion:
    """An advice: a change of own velocity in m/s.

    ``probability_now`` is that of a collision within the time of warning without it, ``probability_after`` within the
    look-ahead with it; ``time_s`` (NaN: never) and ``object_index`` say when and with what we collide without.
    """

    status: EvasionStatus
    forward_m_s: float
    right_m_s: float
    probability_now: float
    probability_after: float
    time_s: float
    object_index: int


def evade(situation: Situation, limits: EvasionLimits) -> Evasion:
    """The smallest change of velocity after which a collision within the look-ahead is improbable enough.

    It is looked for where a collision within the time of warning is too probable, among the speeds and courses that we
    are able to reach. A change takes its time: it is reached at constant acceleration. Braking ends at standstill. Of
    changes of nearly one size, the one that goes least to the side is taken, and of those the one that brakes.
    """
    own_m_s = situation.own_speed_m_s
    now = _outcomes(situation, limits, limits.warn_s, np.array([own_m_s]), np.zeros(1))
    before, time_s, who = float(now.probability[0]), float(now.time_s[0]), int(now.object_index[0])
    if before <= limits.max_probability:
        return Evasion(EvasionStatus.no_danger, 0.0, 0.0, before, before, time_s, who)
    slowest = max(own_m_s - limits.braking_m_s2 * limits.look_ahead_s, 0.0)
    fastest = own_m_s + limits.forward_m_s2 * limits.look_ahead_s
    left, right = np.clip(limits.course_rad, -_FARTHEST_TURN_RAD, _FARTHEST_TURN_RAD).tolist()
    best = _best(situation, limits, (slowest, fastest), (left, right))
    for _ in range(_N_ZOOMS if best.is_enough else 0):
        # Whatever is smaller lies within a circle about the present velocity.
        size = float(np.hypot(best.forward_m_s, best.right_m_s))
        turn_rad = float(np.arcsin(size / own_m_s)) if size < own_m_s else _FARTHEST_TURN_RAD
        speeds_m_s = max(own_m_s - size, slowest), min(own_m_s + size, fastest)
        smaller = _best(situation, limits, speeds_m_s, (max(-turn_rad, left), min(turn_rad, right)))
        best = smaller if smaller.is_enough else best
    if best.is_enough and best.forward_m_s == best.right_m_s == 0.0:
        return Evasion(EvasionStatus.no_danger, 0.0, 0.0, before, best.probability, time_s, who)
    status = EvasionStatus.advice if best.is_enough else EvasionStatus.no_escape
    return Evasion(status, best.forward_m_s, best.right_m_s, before, best.probability, time_s, who)


def needed_s(own_m_s: float, speed_m_s: Floats, course_rad: Floats, limits: EvasionLimits) -> Floats:
    """How long it takes until changes to other speeds and courses ``(C,)`` are complete; infinite: they cannot be.

    Both parts take the same time and share the ellipse of friction. To turn by an angle at a mean speed v takes a
    velocity of v times the angle across it, at an acceleration across of at most v^2 / ``turning_radius_m``.
    """
    change = np.abs(speed_m_s - own_m_s)
    along_m_s2 = np.where(speed_m_s < own_m_s, limits.braking_m_s2, limits.forward_m_s2)
    mean_m_s = 0.5 * (own_m_s + speed_m_s)
    across_m_s2 = np.full_like(mean_m_s, limits.sideways_m_s2)
    if limits.turning_radius_m > 0.0:
        across_m_s2 = np.minimum(across_m_s2, mean_m_s**2 / limits.turning_radius_m)
    parts_s = [
        np.divide(part, limit, out=np.where(part > 0.0, np.inf, 0.0), where=limit > 0.0)
        for part, limit in ((change, along_m_s2), (mean_m_s * np.abs(course_rad), across_m_s2))
    ]
    return np.asarray(np.hypot(*parts_s))


@dataclass(frozen=True)
class _Choice:
    forward_m_s: float
    right_m_s: float
    probability: float
    is_enough: bool


def _best(
    situation: Situation, limits: EvasionLimits, speeds_m_s: tuple[float, float], courses_rad: tuple[float, float]
) -> _Choice:
    """The smallest change of a grid that is enough; where none is, the one that is least probable to collide."""
    own_m_s = situation.own_speed_m_s
    grid = np.meshgrid(np.linspace(*speeds_m_s, _N_SPEEDS), _courses(*courses_rad), indexing="ij")
    speed, course = (values.ravel() for values in grid)
    can_be = needed_s(own_m_s, speed, course, limits) <= limits.look_ahead_s
    # What we do now can always be gone on with.
    speed, course = np.append(speed[can_be], own_m_s), np.append(course[can_be], 0.0)
    outcome = _outcomes(situation, limits, limits.look_ahead_s, speed, course)
    forward, right = speed * np.cos(course) - own_m_s, speed * np.sin(course)
    size = np.hypot(forward, right)
    is_enough = outcome.probability <= limits.max_probability
    if is_enough.any():
        smallest = np.flatnonzero(is_enough & (size <= _TIE * size[is_enough].min()))
        choice = int(smallest[np.lexsort((size[smallest], forward[smallest], np.abs(right[smallest])))[0]])
    else:
        later_s = np.nan_to_num(outcome.time_s, nan=limits.look_ahead_s)
        choice = int(np.lexsort((forward, -later_s, outcome.probability.round(_PROBABILITY_DIGITS)))[0])
    return _Choice(
        float(forward[choice]), float(right[choice]), float(outcome.probability[choice]), bool(is_enough.any())
    )


def _courses(left_rad: float, right_rad: float) -> Floats:
    """Courses from left to right, straight on among them."""
    courses = np.linspace(left_rad, right_rad, _N_COURSES)
    courses[np.abs(courses).argmin()] = 0.0
    return courses


def _outcomes(
    situation: Situation, limits: EvasionLimits, horizon_s: float, speed_m_s: Floats, course_rad: Floats
) -> Outcomes:
    """Outcomes of other speeds and courses ``(C,)``, each reached as fast as we are able to."""
    own_m_s = situation.own_speed_m_s
    change = np.zeros((len(speed_m_s), 3))
    change[:, AHEAD] = speed_m_s * np.cos(course_rad) - own_m_s
    change[:, RIGHT] = speed_m_s * np.sin(course_rad)
    legs = ways(situation, change, horizon_s, needed_s(own_m_s, speed_m_s, course_rad, limits))
    return outcomes(situation, legs, horizon_s)
