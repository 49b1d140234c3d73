"""Where we and another one meet: places and times from the paths themselves."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from scenario_suite.families.streets import OWN_RADIUS_M, SIZES_M, side
from scenario_suite.scenario import Values
from ttcvid.simulate.motion import Motion, heading_at, position_at

BEFORE_CONTACT_S = 0.3
"""A clip ends so long before the contact: the camera must not enter the other one."""
CONTACT_S = (3.6, 4.8)
"""When we meet: as long is there to see it coming."""
CLEARANCE_M = (0.5, 2.0)
"""Room between us and what a near miss passes."""
_GRID_S = np.arange(0.0, 12.0, 0.005)


def contact_s(rng: Generator) -> float:
    """Time of a meeting."""
    return float(rng.uniform(*CONTACT_S))


def clear_m(rng: Generator) -> float:
    """Distance of the camera from what it passes in a near miss."""
    return OWN_RADIUS_M + float(rng.uniform(*CLEARANCE_M))


def across_m(rng: Generator, kind: str, impact: tuple[float, float], *, collides: bool) -> float:
    """Place of the other one's middle across our lane: an impact location (fractions of our width), or clear of us."""
    if collides:
        return (float(rng.uniform(*impact)) - 0.5) * SIZES_M["car"][1]
    return side(rng) * (SIZES_M[kind][1] / 2 + clear_m(rng))


def motion_along(values: Values, from_m: float = 0.0) -> Motion:
    """Our motion, or a body's, in the plane from (``from_m``, 0)."""
    until_s, yaw_until_s = values.get("acceleration_until_s"), values.get("yaw_until_s")
    return Motion(
        (from_m, 0.0, 0.0),
        np.radians(values.get("heading_deg", 0.0)),
        values["speed_m_s"],
        values.get("acceleration_m_s2", 0.0),
        values.get("acceleration_from_s", 0.0),
        np.inf if until_s is None else until_s,
        np.radians(values.get("yaw_rate_deg_s", 0.0)),
        values.get("yaw_from_s", 0.0),
        np.inf if yaw_until_s is None else yaw_until_s,
    )


def place_and_heading(own: Values, t_s: float) -> tuple[np.ndarray, float]:
    """Where we are (x, y) in m at a time, and our heading in rad."""
    motion, at = motion_along(own), np.array([t_s])
    return position_at(motion, at)[0, :2], float(heading_at(motion, at)[0])


def catching_up_s(own: Values, gap_m: float, other: Values) -> float:
    """When we reach what drives before us in our direction, its rear ``gap_m`` away at time 0; infinite if never."""
    ours = position_at(motion_along(own), _GRID_S)[:, 0]
    theirs = position_at(motion_along(other, gap_m), _GRID_S)[:, 0]
    touching = np.flatnonzero(theirs - ours < OWN_RADIUS_M)
    return float(_GRID_S[touching[0]]) if len(touching) else np.inf


def travelled_m(own: Values, duration_s: float) -> float:
    """How far ahead we come."""
    return float(position_at(motion_along(own), np.array([duration_s]))[0, 0])
