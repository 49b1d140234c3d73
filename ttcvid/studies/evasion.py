"""The smallest change of own velocity that keeps a collision improbable, within what brakes and tyres can do."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from ttcvid.model import Floats
from ttcvid.studies.collision_map import Outcomes, outcomes, ways
from ttcvid.studies.contacts import AHEAD, RIGHT
from ttcvid.studies.hazards import Situation

_N_FORWARD, _N_RIGHT = 21, 31
"""Changes tried at a time."""
_N_ZOOMS = 3
"""How often the search is repeated among the changes that are smaller than the best one so far."""
_PROBABILITY_DIGITS = 3
_TIE = 1.05
"""Changes whose sizes differ by less than this factor count as equally small: the one least to the side is taken."""


class EvasionStatus(StrEnum):
    """What is to be done."""

    no_danger = "no_danger"
    advice = "advice"
    no_escape = "no_escape"
    """No change within the limits suffices; the best one is given."""
    no_scale = "no_scale"
    """Nothing of the frame has metres."""
    no_result = "no_result"
    """The frame has no motion to judge."""


@dataclass(frozen=True)
class EvasionLimits:
    """What we can do and what we want: accelerations (``forward_m_s2``: speeding up), times, and a problimits.

    A contact within ``warn_s`` that is more probable than ``max_probability`` asks for an evasion; an evasion is good
    when a contact within ``look_ahead_s`` is no more probable than that. With one time for both, an evasion would
    first be one that puts the contact off by a blink.
    """

    braking_m_s2: float = 6.0
    sideways_m_s2: float = 3.0
    forward_m_s2: float = 0.0
    warn_s: float = 3.5
    look_ahead_s: float = 5.0
    max_probability: float = 0.1


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

    It is looked for where a collision within the time of warning is too probable. A change takes its time: it is
    reached at constant acceleration. Braking ends at standstill. Of changes of nearly one size, the one that goes
    least to the side is taken, and of those the one that brakes.
    """
    now = _outcomes(situation, limits, limits.warn_s, np.zeros(1), np.zeros(1))
    before, time_s, who = float(now.probability[0]), float(now.time_s[0]), int(now.object_index[0])
    if before <= limits.max_probability:
        return Evasion(EvasionStatus.no_danger, 0.0, 0.0, before, before, time_s, who)
    slowest = -min(max(float(situation.own_velocity_m_s[AHEAD]), 0.0), limits.braking_m_s2 * limits.look_ahead_s)
    fastest, side = (rate * limits.look_ahead_s for rate in (limits.forward_m_s2, limits.sideways_m_s2))
    forward, right = np.linspace(slowest, fastest, _N_FORWARD), np.linspace(-side, side, _N_RIGHT)
    best = _best(situation, limits, forward, right)
    for _ in range(_N_ZOOMS if best.is_enough else 0):
        # Whatever is smaller lies within a circle about zero, in any direction.
        size = float(np.hypot(best.forward_m_s, best.right_m_s))
        forward = np.linspace(max(-size, slowest), min(size, fastest), _N_FORWARD)
        right = np.linspace(-min(size, side), min(size, side), _N_RIGHT)
        smaller = _best(situation, limits, forward, right)
        best = smaller if smaller.is_enough else best
    status = EvasionStatus.advice if best.is_enough else EvasionStatus.no_escape
    return Evasion(status, best.forward_m_s, best.right_m_s, before, best.probability, time_s, who)


@dataclass(frozen=True)
class _Choice:
    forward_m_s: float
    right_m_s: float
    probability: float
    is_enough: bool


def _best(situation: Situation, limits: EvasionLimits, forward_m_s: Floats, right_m_s: Floats) -> _Choice:
    """The smallest change of a grid that is enough; where none is, the one that is least probable to collide."""
    forward, right = (v.ravel() for v in np.meshgrid(forward_m_s, right_m_s, indexing="ij"))
    outcome = _outcomes(situation, limits, limits.look_ahead_s, forward, right)
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


def _outcomes(
    situation: Situation, limits: EvasionLimits, horizon_s: float, forward_m_s: Floats, right_m_s: Floats
) -> Outcomes:
    """Outcomes of changes ``(C,)``, each reached as fast as we are able to."""
    change = np.zeros((len(forward_m_s), 3))
    change[:, AHEAD], change[:, RIGHT] = forward_m_s, right_m_s
    ahead_m_s2 = np.where(forward_m_s < 0.0, limits.braking_m_s2, limits.forward_m_s2)
    needs_s = [
        np.divide(np.abs(change_m_s), limit_m_s2, out=np.zeros_like(change_m_s), where=change_m_s != 0.0)
        for change_m_s, limit_m_s2 in ((forward_m_s, ahead_m_s2), (right_m_s, limits.sideways_m_s2))
    ]
    legs = ways(situation, change, horizon_s, np.maximum(*needs_s))
    return outcomes(situation, legs, horizon_s)
