"""The smallest change of own velocity that keeps a collision improbable, within what brakes and tyres can do."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from ttcvid.model import Floats
from ttcvid.studies.collision_map import Outcomes, outcomes, ways
from ttcvid.studies.hazards import AHEAD, RIGHT, Situation

_N_FORWARD, _N_RIGHT = 21, 31
"""Changes tried first; the best place is then searched again, so many times finer."""
_FINER, _N_REFINEMENTS = 5, 2
_PROBABILITY_DIGITS = 3
_TIE = 1.05
"""Changes whose sizes differ by less than this factor count as equally small: then the one that brakes most is taken."""


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
class Ability:
    """Limits of what we can do: accelerations in m/s^2, all >= 0; ``forward_m_s2`` is that of speeding up."""

    braking_m_s2: float
    sideways_m_s2: float
    forward_m_s2: float = 0.0


@dataclass(frozen=True)
class Evasion:
    """An advice: change of own velocity, in m/s, and probabilities of a collision without and with it.

    ``time_s`` (NaN: none) and ``object_index`` say when and with what we collide without.
    """

    status: EvasionStatus
    forward_m_s: float
    right_m_s: float
    probability_now: float
    probability_after: float
    time_s: float
    object_index: int


def evade(situation: Situation, ability: Ability, horizon_s: float, max_probability: float) -> Evasion:
    """The smallest change of velocity after which a collision until ``horizon_s`` is improbable enough.

    A change takes its time: it is reached at constant acceleration within ``ability``. Braking ends at standstill. Of
    changes of nearly one size, the one that brakes most is taken.

    Parameters
    ----------
    max_probability
        What the probability of a collision has to be brought to, or below. Where it is already, nothing is advised.
    """
    now = _outcomes(situation, ability, horizon_s, np.zeros(1), np.zeros(1))
    before, time_s, who = float(now.probability[0]), float(now.time_s[0]), int(now.object_index[0])
    if before <= max_probability:
        return Evasion(EvasionStatus.no_danger, 0.0, 0.0, before, before, time_s, who)
    slowest = -min(max(float(situation.own_velocity_m_s[AHEAD]), 0.0), ability.braking_m_s2 * horizon_s)
    fastest, side = ability.forward_m_s2 * horizon_s, ability.sideways_m_s2 * horizon_s
    forward, right = np.linspace(slowest, fastest, _N_FORWARD), np.linspace(-side, side, _N_RIGHT)
    best = _best(situation, ability, horizon_s, forward, right, max_probability)
    for _ in range(_N_REFINEMENTS if best.is_enough else 0):
        forward = _around(best.forward_m_s, forward, slowest, fastest)
        right = _around(best.right_m_s, right, -side, side)
        best = _best(situation, ability, horizon_s, forward, right, max_probability)
    status = EvasionStatus.advice if best.is_enough else EvasionStatus.no_escape
    return Evasion(status, best.forward_m_s, best.right_m_s, before, best.probability, time_s, who)


@dataclass(frozen=True)
class _Choice:
    forward_m_s: float
    right_m_s: float
    probability: float
    is_enough: bool


def _best(
    situation: Situation,
    ability: Ability,
    horizon_s: float,
    forward_m_s: Floats,
    right_m_s: Floats,
    max_probability: float,
) -> _Choice:
    """The smallest change of a grid that is enough; where none is, the one that is least probable to collide."""
    forward, right = (v.ravel() for v in np.meshgrid(forward_m_s, right_m_s, indexing="ij"))
    outcome = _outcomes(situation, ability, horizon_s, forward, right)
    size = np.hypot(forward, right)
    is_enough = outcome.probability <= max_probability
    if is_enough.any():
        is_smallest = is_enough & (size <= _TIE * size[is_enough].min())
        choice = int(np.flatnonzero(is_smallest)[forward[is_smallest].argmin()])
    else:
        later_s = np.nan_to_num(outcome.time_s, nan=horizon_s)
        choice = int(np.lexsort((forward, -later_s, outcome.probability.round(_PROBABILITY_DIGITS)))[0])
    return _Choice(
        float(forward[choice]), float(right[choice]), float(outcome.probability[choice]), bool(is_enough.any())
    )


def _outcomes(
    situation: Situation, ability: Ability, horizon_s: float, forward_m_s: Floats, right_m_s: Floats
) -> Outcomes:
    """Outcomes of changes ``(C,)``, each reached as fast as we are able to."""
    change = np.zeros((len(forward_m_s), 3))
    change[:, AHEAD], change[:, RIGHT] = forward_m_s, right_m_s
    ahead_m_s2 = np.where(forward_m_s < 0.0, ability.braking_m_s2, ability.forward_m_s2)
    needs_s = [
        np.divide(np.abs(change_m_s), limit_m_s2, out=np.zeros_like(change_m_s), where=change_m_s != 0.0)
        for change_m_s, limit_m_s2 in ((forward_m_s, ahead_m_s2), (right_m_s, ability.sideways_m_s2))
    ]
    legs = ways(situation, change, horizon_s, np.maximum(*needs_s))
    return outcomes(situation, legs, horizon_s)


def _around(best: float, grid: Floats, low: float, high: float) -> Floats:
    """A finer grid around the best value of a coarse one, inside the limits."""
    step = float(np.ptp(grid)) / max(len(grid) - 1, 1)
    return np.unique(np.clip(best + step * np.linspace(-1.0, 1.0, 2 * _FINER + 1), low, high))
