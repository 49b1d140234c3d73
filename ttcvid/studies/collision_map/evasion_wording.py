"""An advice in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ttcvid.studies.collision_map.evasion import Evasion, EvasionStatus
from ttcvid.studies.collision_map.picture import KM_H, MapCaption
from ttcvid.studies.collision_map.velocity_map import NO_OBJECT

_LEAST_SHOWN_M_S = 0.05 / KM_H


def caption_of(
    source: str,
    frame: int,
    t_s: float,
    own_speed_m_s: float,
    advice: Evasion,
    names: Sequence[str],
    notes: Sequence[str],
) -> MapCaption:
    """What stands over and under the picture of a map."""
    moment = f"{source}, frame {frame} ({t_s:.2f} s), own speed {own_speed_m_s * KM_H:.0f} km/h"
    return MapCaption(f"{moment}\n{describe_advice(advice, names)}", notes)


def describe_advice(advice: Evasion, names: Sequence[str]) -> str:
    """One sentence: what is ahead, and what to do.

    >>> describe_advice(Evasion(EvasionStatus.advice, -2.0, 0.0, 0.98, 0.03, 1.9, 0), ["lorry"])
    'lorry in 1.9 s (98 %): brake by 7.2 km/h (then 3 %)'
    """
    who = "" if advice.object_index == NO_OBJECT else names[advice.object_index]
    ahead = f"{who} in {advice.time_s:.1f} s ({_percent(advice.probability_now)})" if who else "nothing in the way"
    match advice.status:
        case EvasionStatus.no_danger:
            return f"no danger: {ahead}"
        case EvasionStatus.advice:
            return f"{ahead}: {describe_change(advice)} (then {_percent(advice.probability_after)})"
        case EvasionStatus.no_escape:
            change, after = describe_change(advice), _percent(advice.probability_after)
            return f"{ahead}: no way out within the limits, least bad: {change} (then {after})"
        case EvasionStatus.unknown:
            return f"unknown whether there is a danger: {ahead if who else 'nothing known to be in the way'}"
        case EvasionStatus.no_scale:
            return "no scale: nothing has a distance in metres"
        case EvasionStatus.no_result:
            return "no result for this frame"


def describe_change(advice: Evasion) -> str:
    """The change of velocity in words, in km/h."""
    parts = []
    if advice.forward_m_s < -_LEAST_SHOWN_M_S:
        parts.append(f"brake by {-advice.forward_m_s * KM_H:.1f} km/h")
    if advice.forward_m_s > _LEAST_SHOWN_M_S:
        parts.append(f"speed up by {advice.forward_m_s * KM_H:.1f} km/h")
    if abs(advice.right_m_s) > _LEAST_SHOWN_M_S:
        side = "right" if advice.right_m_s > 0 else "left"
        parts.append(f"{abs(advice.right_m_s) * KM_H:.1f} km/h to the {side}")
    return " and ".join(parts) if parts else "nothing helps more than to go on"


def _percent(probability: float) -> str:
    return f"{100 * np.floor(probability * 100 + 0.5) / 100:.0f} %"
