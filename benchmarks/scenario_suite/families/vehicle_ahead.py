"""What is ahead in our own direction: Euro NCAP 2026 (Crash Avoidance, Frontal Collisions), NHTSA's three, cut-in.

A near miss differs by where the other one is (beside us when we pass) or by what we do, never by the scene's looks.
"""

from __future__ import annotations

from functools import partial

from numpy.random import Generator

from scenario_suite.families.encountering import (
    BEFORE_CONTACT_S,
    across_m,
    catching_up_s,
    contact_s,
    travelled_m,
)
from scenario_suite.families.streets import KM_H, LANE_M, OWN_RADIUS_M, SHOULDER_M, drive, km_h, thing
from scenario_suite.scenario import Family, Values

MPH = 0.44704
G_M_S2 = 9.81
_VIEW_M = 80.0
"""How far the scenery goes beyond what happens."""
_LONGEST_S = 5.5
CAR_IMPACT, RIDER_IMPACT = (-0.25, 1.25), (0.25, 0.75)
"""Impact locations over our width."""


def _standing(
    rng: Generator, collides: bool, *, kind: str, own_km_h: tuple[float, float], impact: tuple[float, float]
) -> Values:
    """The other one stands in our lane, its rear towards us."""
    own, at_s = km_h(rng, *own_km_h), contact_s(rng)
    other = {"is_object": True, "heading_deg": 0.0}
    return _followed(rng, kind, {"speed_m_s": own}, own * at_s + OWN_RADIUS_M, other, at_s, impact, collides)


def _moving(rng: Generator, collides: bool) -> Values:
    """CCRm: we are faster."""
    slow = rng.random() < 0.5
    own, other = (km_h(rng, 30, 80), 20 * KM_H) if slow else (km_h(rng, 90, 130), km_h(rng, 30, 70))
    return _slower(rng, collides, own, other)


def _slower(rng: Generator, collides: bool, own: float, other: float) -> Values:
    at_s = contact_s(rng)
    gap_m = (own - other) * at_s + OWN_RADIUS_M
    moving = {"speed_m_s": other, "heading_deg": 0.0}
    return _followed(rng, "car", {"speed_m_s": own}, gap_m, moving, at_s, CAR_IMPACT, collides)


def _braking(rng: Generator, collides: bool, *, kind: str, impact: tuple[float, float]) -> Values:
    """CCRb and CMRb of 2026: both at one speed, headway 1.0 s, -4 m/s2."""
    own = km_h(rng, 30, 130)
    return _brakes(rng, collides, kind, own, 1.0 * own, 4.0, impact)


def _braking_2023(rng: Generator, collides: bool) -> Values:
    """CCRb of 2023: 50 km/h, 12 or 40 m, -2 or -6 m/s2."""
    gap_m, braking_m_s2 = float(rng.choice([12.0, 40.0])), float(rng.choice([2.0, 6.0]))
    return _brakes(rng, collides, "car", 50 * KM_H, gap_m, braking_m_s2, CAR_IMPACT)


def _nhtsa_braking(rng: Generator, collides: bool) -> Values:
    return _brakes(rng, collides, "car", 45 * MPH, 30.0, 0.3 * G_M_S2, (0.4, 0.6))


def _brakes(
    rng: Generator,
    collides: bool,
    kind: str,
    own: float,
    gap_m: float,
    braking_m_s2: float,
    impact: tuple[float, float],
) -> Values:
    """The one ahead brakes to a stop; in a near miss we brake as well, soon enough, or drive past in the next lane."""
    from_s = float(rng.uniform(0.5, 1.0))
    ours: Values = {"speed_m_s": own}
    brakes = {"acceleration_m_s2": -braking_m_s2, "acceleration_from_s": from_s}
    other = {"speed_m_s": own, "heading_deg": 0.0, **brakes}
    at_s = catching_up_s(ours, gap_m, other)
    passes = collides
    if not collides and rng.random() < 0.5:
        # Reaction in less than the time that the gap gives: what stays of it is more than half.
        reaction_s = float(rng.uniform(0.2, 0.45)) * gap_m / own
        ours |= {**brakes, "acceleration_from_s": from_s + reaction_s}
        passes = True
    return _followed(rng, kind, ours, gap_m, other, at_s, impact, passes)


def _followed(
    rng: Generator,
    kind: str,
    own: Values,
    gap_m: float,
    other_motion: Values,
    at_s: float,
    impact: tuple[float, float],
    is_in_lane: bool,
) -> Values:
    """A drive behind somebody whose rear is ``gap_m`` ahead and whom we would reach at ``at_s``."""
    place_m = across_m(rng, kind, impact, collides=is_in_lane)
    other = thing(rng, "target", kind, (0.0, place_m), **other_motion)
    other["at_m"][0] = gap_m + other["size_m"][0] / 2
    duration_s = min(at_s - BEFORE_CONTACT_S, _LONGEST_S + 1.5)
    fast = max(own["speed_m_s"], other_motion.get("speed_m_s", 0.0)) > 90 * KM_H
    setting = "motorway" if fast else None
    reach_m = max(travelled_m(own, duration_s), gap_m) + _VIEW_M
    shoulder_m = SHOULDER_M if place_m < -LANE_M / 2 else None
    return drive(
        rng,
        own,
        [other],
        duration_s=duration_s,
        reach_m=reach_m,
        setting=setting,
        n_lanes=2 + fast,
        shoulder_m=shoulder_m,
    )


def _cut_in(rng: Generator, collides: bool) -> Values:
    """A slower car changes from the next lane into ours; in a near miss it keeps up, or stays in its lane."""
    own, from_s, lasts_s = km_h(rng, 50, 120), float(rng.uniform(0.4, 1.0)), float(rng.uniform(2.0, 3.0))
    closing = km_h(rng, 15, 40)
    at_s = from_s + lasts_s + float(rng.uniform(0.6, 1.4))
    gap_m = closing * at_s + OWN_RADIUS_M
    change: Values = {"lane_change_m": -LANE_M, "lane_change_from_s": from_s}
    if not collides:
        if rng.random() < 0.5:
            closing, gap_m = -km_h(rng, 0, 10), float(rng.uniform(8.0, 25.0))
        else:
            change["lane_change_m"] *= float(rng.uniform(0.0, 0.1))
    other = thing(rng, "cutting in", "car", (0.0, LANE_M), speed_m_s=own - closing, heading_deg=0.0)
    other |= {**change, "lane_change_duration_s": lasts_s}
    other["at_m"][0] = gap_m + other["size_m"][0] / 2
    duration_s = at_s - BEFORE_CONTACT_S
    reach_m = own * duration_s + gap_m + _VIEW_M
    return drive(
        rng, {"speed_m_s": own}, [other], duration_s=duration_s, reach_m=reach_m, setting="motorway", n_lanes=3
    )


def _nhtsa_stopped(rng: Generator, collides: bool) -> Values:
    return _standing(rng, collides, kind="car", own_km_h=(45 * MPH / KM_H,) * 2, impact=(0.4, 0.6))


def _nhtsa_slower(rng: Generator, collides: bool) -> Values:
    return _slower(rng, collides, 45 * MPH, 20 * MPH)


_G = "vehicle_ahead"
_CCRS = partial(_standing, kind="car", own_km_h=(10, 80), impact=CAR_IMPACT)
_CMRS = partial(_standing, kind="motorcycle", own_km_h=(10, 80), impact=RIDER_IMPACT)
_CCRB = partial(_braking, kind="car", impact=CAR_IMPACT)
_CMRB = partial(_braking, kind="motorcycle", impact=RIDER_IMPACT)
FAMILIES = (
    Family("CCRs", _G, "car to car, rear: stands; we 10-80 km/h", _CCRS),
    Family("CCRm", _G, "car to car, rear: 30-80 towards 20 km/h, 90-130 towards 30-70", _moving),
    Family(
        "CCRb",
        _G,
        "car to car, rear: brakes at 4 m/s2, headway 1.0 s",
        _CCRB,
    ),
    Family("CCRb-2023", _G, "car to car, rear: 50 km/h, 12 or 40 m, brakes at 2 or 6 m/s2", _braking_2023),
    Family("CMRs", _G, "car to motorcycle, rear: stands; we 10-80 km/h", _CMRS),
    Family(
        "CMRb",
        _G,
        "car to motorcycle, rear: brakes at 4 m/s2",
        _CMRB,
    ),
    Family("NHTSA-stopped", _G, "45 mph towards a stopped car", _nhtsa_stopped, warn_by_s=2.1),
    Family("NHTSA-braking", _G, "45 mph, 30 m behind one that brakes at 0.3 g", _nhtsa_braking, warn_by_s=2.4),
    Family("NHTSA-slower", _G, "45 mph towards 20 mph", _nhtsa_slower),
    Family("cut-in", _G, "a slower car changes into our lane", _cut_in),
)
