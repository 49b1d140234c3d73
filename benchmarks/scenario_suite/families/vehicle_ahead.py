"""What is ahead in our own direction: Euro NCAP 2026 (Crash Avoidance, Frontal Collisions), NHTSA's three, cut-in.

A near miss differs by where the other one is (beside us when we pass) or by what we do, never by the scene's looks.
"""

from __future__ import annotations

from numpy.random import Generator

from scenario_suite.families.streets import OWN_RADIUS_M, SIZES_M, drive, km_h, side, thing
from scenario_suite.scenario import Family, Values

_BEFORE_CONTACT_S = 0.3
"""A clip ends so long before the contact: the camera must not enter the other one."""
_CLEARANCE_M = (0.5, 2.0)
"""Room between us and what a near miss passes, m."""


def beside_m(rng: Generator, kind: str, impact: tuple[float, float], *, collides: bool) -> float:
    """Place of the other one's middle across our lane: an impact location (fractions of our width), or clear of us."""
    if collides:
        return (float(rng.uniform(*impact)) - 0.5) * SIZES_M["car"][1]
    return side(rng) * (SIZES_M[kind][1] / 2 + OWN_RADIUS_M + float(rng.uniform(*_CLEARANCE_M)))


def _ccrs(rng: Generator, collides: bool) -> Values:
    return _standing(rng, collides, "car", km_h(rng, 10.0, 80.0), (-0.25, 1.25))


def _standing(rng: Generator, collides: bool, kind: str, own: float, impact: tuple[float, float]) -> Values:
    """The other one stands in our lane, its rear towards us."""
    contact_s = float(rng.uniform(3.6, 4.8))
    gap_m = own * contact_s + OWN_RADIUS_M
    other = thing(rng, "target", kind, (0.0, beside_m(rng, kind, impact, collides=collides)), is_object=True)
    other["at_m"][0] = gap_m + other["size_m"][0] / 2
    other["heading_deg"] = 0.0
    return drive(rng, {"speed_m_s": own}, [other], duration_s=contact_s - _BEFORE_CONTACT_S, reach_m=gap_m + 70.0)


FAMILIES = (Family("CCRs", "vehicle_ahead", "car to car, rear, stationary; we 10-80 km/h", _ccrs),)
