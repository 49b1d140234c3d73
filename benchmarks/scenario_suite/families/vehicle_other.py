"""What comes the other way, across, or onto the road (Euro NCAP 2026), and the traffic in which nothing happens.

Crossing traffic is drawn slow enough against us to lie in the picture: at constant bearing it is seen at
arctan(its speed / ours). A near miss has the same actors, too early, too late, beside us, or stopping at the kerb.
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from numpy.random import Generator

from scenario_suite.families.encountering import (
    BEFORE_CONTACT_S,
    across_m,
    clear_m,
    contact_s,
    place_and_heading,
)
from scenario_suite.families.streets import (
    KM_H,
    LANE_M,
    OWN_RADIUS_M,
    SHOULDER_M,
    SIZES_M,
    drive,
    km_h,
    row,
    side,
    thing,
)
from scenario_suite.scenario import Family, Values

_VIEW_M = 80.0
_WIDE_DEG, _WALKER_DEG = (70.0, 100.0), (50.0, 110.0)
_CROSSING_DEG, _AS_FAST_DEG = (70.0, 110.0), (100.0, 110.0)
_FASTER, _NO_SLOWER = 1.7, 1.0
"""We are so much faster than what crosses: it is seen 30 deg from our direction, or less; 45 deg of what is as fast."""
_WHOLE_IMPACT = (0.1, 0.9)
_MOST_PARKED = 14
_CHILD_M = (0.1, 0.45, 1.15)


def _head_on(rng: Generator, collides: bool) -> Values:
    """CCFhos: 30-100 km/h towards 50-100 in our lane; else it keeps its own."""
    own, other, at_s = km_h(rng, 30, 100), km_h(rng, 50, 100), contact_s(rng)
    place_m = across_m(rng, "car", (-0.2, 1.2), collides=True) if collides else LANE_M + float(rng.uniform(-0.4, 0.6))
    return _oncoming(rng, own, at_s, [place_m], speed_m_s=other)


def _head_on_lane_change(rng: Generator, collides: bool) -> Values:
    """CCFhol: it changes into our lane and is there 1.5 s before the contact; else it only drifts in its own."""
    own, other, at_s = km_h(rng, 30, 100), km_h(rng, 50, 100), contact_s(rng)
    lasts_s = min(float(rng.uniform(1.6, 2.2)), at_s - 1.5)
    aside_m = LANE_M if collides else float(rng.uniform(0.0, 0.5))
    # Its left is our right.
    change = {"lane_change_m": aside_m, "lane_change_from_s": at_s - 1.5 - lasts_s, "lane_change_duration_s": lasts_s}
    return _oncoming(rng, own, at_s, [LANE_M + float(rng.uniform(-0.3, 0.3))], speed_m_s=other, **change)


def _oncoming(rng: Generator, own: float, at_s: float, places_m: list[float], **motion: float) -> Values:
    kind = str(rng.choice(["car", "car", "car", "lorry"]))
    bodies = []
    for number, place_m in enumerate(places_m):
        other = thing(rng, f"oncoming {number + 1}", kind, (0.0, place_m), heading_deg=180.0, **motion)
        gap_m = (own + motion["speed_m_s"]) * at_s + OWN_RADIUS_M
        other["at_m"][0] = gap_m + other["size_m"][0] / 2
        bodies.append(other)
    return drive(
        rng, {"speed_m_s": own}, bodies, duration_s=at_s - BEFORE_CONTACT_S, reach_m=own * at_s + _VIEW_M + 60.0
    )


def _crossing(
    rng: Generator,
    collides: bool,
    *,
    kind: str,
    own_km_h: tuple[float, float],
    other_km_h: tuple[float, float],
    impact: tuple[float, float],
    from_side: float | None = None,
    is_hidden: bool = False,
    size_m: tuple[float, float, float] | None = None,
    faster: float = _FASTER,
) -> Values:
    """Somebody crosses our path: at our front when we are there, before or after, or stops at the kerb."""
    at_s, from_side = contact_s(rng), side(rng) if from_side is None else from_side
    other = min(km_h(rng, *other_km_h), own_km_h[1] * KM_H / faster)
    own = max(km_h(rng, *own_km_h), faster * other)
    is_vehicle = kind in ("car", "lorry", "motorcycle")
    length_m = SIZES_M["walker"][1] if kind == "walker" else SIZES_M[kind][0]
    course_deg = -from_side * float(rng.uniform(82.0, 98.0) if is_vehicle else 90.0)
    ahead = np.array([math.cos(math.radians(course_deg)), math.sin(math.radians(course_deg))])
    along_m = (float(rng.uniform(*impact)) - 0.5) * (0.8 * length_m if is_vehicle else SIZES_M["car"][1])
    width_m = SIZES_M[kind][1] if is_vehicle else 0.0
    meeting = np.array([own * at_s + OWN_RADIUS_M + width_m / 2, -from_side * along_m])
    motion: Values = {}
    off_s = 0.0
    if not collides:
        off_m = length_m / 2 + width_m / 2 + clear_m(rng)
        if not is_vehicle and rng.random() < 0.5:
            stop_m, braking_m_s2 = off_m, float(rng.uniform(1.0, 2.5))
            # Stops with its front at the kerb: clear of us by off_m.
            from_s = at_s - (stop_m + abs(along_m)) / other - other / (2 * braking_m_s2)
            motion = {"acceleration_m_s2": -braking_m_s2, "acceleration_from_s": max(0.0, from_s)}
        else:
            off_s = side(rng) * off_m * math.hypot(own, other) / (own * other)
    start = meeting - other * ahead * (at_s + off_s)
    body = thing(rng, "crossing", kind, (0.0, 0.0), **motion)
    body["at_m"] = [*start.tolist(), 0.0]
    if kind == "walker":
        body |= {"velocity_m_s": [*(other * ahead).tolist(), 0.0], "heading_deg": 180.0}
        if size_m is not None:
            body["size_m"] = list(size_m)
    else:
        body |= {"speed_m_s": other, "heading_deg": course_deg}
    bodies = [body]
    # Nobody walks through what stands beside the road.
    gaps = tuple((meeting[0] - 2.5, meeting[0] + 2.5, at_side) for at_side in (-1.0, 1.0))
    if is_hidden:
        bodies += _hiding(rng, meeting[0], from_side, is_vehicle)
        gaps = (*gaps, (-5.0, meeting[0] + 6.0, from_side))
    return drive(
        rng,
        {"speed_m_s": own},
        bodies,
        duration_s=at_s - BEFORE_CONTACT_S,
        reach_m=own * at_s + _VIEW_M,
        gaps_m=gaps,
        hfov_deg=float(rng.uniform(*(_WIDE_DEG if faster > 1.0 else _AS_FAST_DEG))) if other > 0.35 * own else None,
        side_road_m=meeting[0] if is_vehicle else None,
        setting=str(rng.choice(["town", "avenue"])) if is_hidden else None,
        shoulder_m=0.0 if is_hidden else None,
    )


def _hiding(rng: Generator, meeting_m: float, from_side: float, is_vehicle: bool) -> list[Values]:
    """Parked cars and a van beside our lane, up to where the other one comes out."""
    beside_m = from_side * ((LANE_M / 2 + 0.4 if from_side < 0 else 1.5 * LANE_M + 0.3) + 1.0)
    end_m, gap_m = meeting_m - (3.6 if is_vehicle else 1.2), float(rng.uniform(0.6, 1.6))
    bodies: list[Values] = []
    while end_m > 7.0 and len(bodies) < _MOST_PARKED:
        kind = "lorry" if rng.random() < 0.2 and end_m > 15.0 else "car"
        length_m, width_m, height_m = SIZES_M[kind]
        place = [end_m - length_m / 2, beside_m, 0.0]
        bodies.append(row(f"parked {len(bodies) + 1}", kind, place, [length_m, width_m, height_m]))
        end_m -= length_m + gap_m
    return bodies


def _along(
    rng: Generator,
    collides: bool,
    *,
    kind: str,
    own_km_h: tuple[float, float],
    other_km_h: tuple[float, float],
    impact: tuple[float, float],
) -> Values:
    """CPLA, CBLA: somebody walks or rides ahead of us in our lane, or beside our path."""
    own, other, at_s = km_h(rng, *own_km_h), km_h(rng, *other_km_h), contact_s(rng)
    gap_m = (own - other) * at_s + OWN_RADIUS_M
    place_m = across_m(rng, kind, impact, collides=collides)
    if not collides:
        place_m = -abs(place_m)
    body = thing(rng, "ahead", kind, (gap_m, place_m), heading_deg=0.0, speed_m_s=other)
    body["at_m"][0] += 0.0 if kind == "walker" else body["size_m"][0] / 2
    duration_s = at_s - BEFORE_CONTACT_S
    shoulder_m = SHOULDER_M if place_m < -1.0 else None
    reach_m = own * at_s + _VIEW_M
    return drive(rng, {"speed_m_s": own}, [body], duration_s=duration_s, reach_m=reach_m, shoulder_m=shoulder_m)


def _turn_across(rng: Generator, collides: bool, *, kind: str) -> Values:
    """CCFtap, CMFtap: we turn to the left at 10-25 km/h across one who comes at 30-80."""
    own, other = km_h(rng, 10, 25), km_h(rng, 30, 80)
    radius_m, from_s = float(rng.uniform(9.0, 13.0)), float(rng.uniform(1.8, 2.6))
    ours = _turn(own, radius_m, from_s, 1.0)
    # We meet where our path crosses the middle of its lane.
    times = np.arange(from_s, from_s + 6.0, 0.01)
    at_s = next(t for t in times if place_and_heading(ours, t)[0][1] > LANE_M - 0.9 - OWN_RADIUS_M / 2)
    (x_m, _), _ = place_and_heading(ours, at_s)
    length_m = SIZES_M[kind][0]
    off_m = (float(rng.uniform(-0.4, 0.4))) * length_m
    if not collides:
        early = (own / other) * 0.0 + length_m / 2 + LANE_M + clear_m(rng)
        # Past us before we come, or so late that we are through.
        off_m = -early if rng.random() < 0.5 else other * (LANE_M + 4.0) / own + clear_m(rng)
    body = thing(rng, "oncoming", kind, (0.0, LANE_M), heading_deg=180.0, speed_m_s=other)
    body["at_m"][0] = x_m + off_m + other * at_s
    return _turning_drive(rng, ours, [body], at_s, radius_m, 1.0)


def _turning(
    rng: Generator, collides: bool, *, kind: str, other_km_h: tuple[float, float], impact: tuple[float, float]
) -> Values:
    """CPTA, CBTA: we turn at 10-20 km/h into a road that somebody crosses, in or against our former direction."""
    own, other = km_h(rng, 10, 20), km_h(rng, *other_km_h)
    to_side = side(rng)
    radius_m = float(rng.uniform(9.0, 13.0)) if to_side > 0 else float(rng.uniform(7.0, 9.0))
    from_s = float(rng.uniform(1.4, 2.2))
    ours = _turn(own, radius_m, from_s, to_side)
    at_s = from_s + math.radians(float(rng.uniform(60.0, 85.0))) * radius_m / own
    place, heading = place_and_heading(ours, at_s)
    ahead, left = np.array([math.cos(heading), math.sin(heading)]), np.array([-math.sin(heading), math.cos(heading)])
    aside_m = (float(rng.uniform(*impact)) - 0.5) * SIZES_M["car"][1]
    course = float(rng.choice([-1.0, 1.0]))
    length_m = 0.6 if kind == "walker" else SIZES_M[kind][0]
    off_s = 0.0
    if not collides:
        off_s = side(rng) * (length_m / 2 + clear_m(rng)) * math.hypot(own, other) / (own * other)
    meeting = place + OWN_RADIUS_M * 0.8 * ahead + aside_m * left
    start = meeting - np.array([course * other, 0.0]) * (at_s + off_s)
    body = thing(rng, "crossing", kind, (float(start[0]), float(start[1])))
    if kind == "walker":
        body |= {"velocity_m_s": [course * other, 0.0, 0.0], "heading_deg": math.degrees(heading) + 180.0}
    else:
        body |= {"speed_m_s": other, "heading_deg": 0.0 if course > 0 else 180.0}
    return _turning_drive(rng, ours, [body], at_s, radius_m, to_side)


def _turn(own: float, radius_m: float, from_s: float, to_side: float) -> Values:
    """A quarter turn at constant speed."""
    quarter_s = math.pi / 2 * radius_m / own
    rate_deg_s = to_side * math.degrees(own / radius_m)
    return {"speed_m_s": own, "yaw_rate_deg_s": rate_deg_s, "yaw_from_s": from_s, "yaw_until_s": from_s + quarter_s}


def _turning_drive(
    rng: Generator, ours: Values, bodies: list[Values], at_s: float, radius_m: float, to_side: float
) -> Values:
    x_m = ours["speed_m_s"] * ours["yaw_from_s"] + radius_m
    gap = (x_m - radius_m - 3.0, x_m + 9.0, to_side)
    return drive(
        rng,
        {**ours, "pitch_jitter_deg": 0.04},
        bodies,
        duration_s=at_s - BEFORE_CONTACT_S,
        reach_m=x_m + _VIEW_M,
        gaps_m=(gap,),
        side_road_m=x_m,
        hfov_deg=float(rng.uniform(*_WIDE_DEG)),
    )


_G = "vehicle_other"
_CROSSING_CAR = {"own_km_h": (20, 80), "other_km_h": (20, 80), "impact": _WHOLE_IMPACT, "faster": _NO_SLOWER}
_URBAN_KM_H = (12, 60)
_CCFTAP, _CMFTAP = (partial(_turn_across, kind=kind) for kind in ("car", "motorcycle"))
_TURNING = {
    "CCFtap": ("car to car, we turn across: 10-25 km/h against 30-80", _CCFTAP),
    "CMFtap": ("car to motorcycle, we turn across: 10-25 km/h against 30-80", _CMFTAP),
}
_CROSSING = {
    "CCCscp": ("car to car, crossing: 20-80 km/h", partial(_crossing, kind="car", **_CROSSING_CAR)),
    "CCCscp-hidden": (
        "car to car, crossing, from behind parked cars",
        partial(_crossing, kind="car", is_hidden=True, **_CROSSING_CAR),
    ),
    "CMCscp": ("car to motorcycle, crossing: 20-80 km/h", partial(_crossing, kind="motorcycle", **_CROSSING_CAR)),
    "CMCscp-hidden": (
        "car to motorcycle, crossing, from behind parked cars",
        partial(_crossing, kind="motorcycle", is_hidden=True, **_CROSSING_CAR),
    ),
}


def _walker_or_rider(name: str, title: str, kind: str, other: tuple[float, float], **more: object) -> Family:
    """A family of crossing walkers or riders; the number in the name is the impact location in per cent."""
    impact = int(name.rsplit("-", 1)[1]) / 100
    near = (max(0.1, impact - 0.12), min(0.9, impact + 0.12))
    draw = partial(_crossing, kind=kind, own_km_h=_URBAN_KM_H, other_km_h=other, impact=near, **more)
    return Family(name, _G, title, draw, hfov_deg=_WALKER_DEG if kind == "walker" else _CROSSING_DEG)


def _ahead(name: str, title: str, kind: str, own: tuple[float, float], other: tuple[float, float]) -> Family:
    impact = int(name.rsplit("-", 1)[1]) / 100
    near = (max(0.1, impact - 0.12), min(0.9, impact + 0.12))
    return Family(name, _G, title, partial(_along, kind=kind, own_km_h=own, other_km_h=other, impact=near))


FAMILIES = (
    Family("CCFhos", _G, "car to car, head-on: 30-100 km/h towards 50-100", _head_on),
    Family("CCFhol", _G, "car to car, head-on: lane change that ends 1.5 s before contact", _head_on_lane_change),
    *(Family(name, _G, title, draw, hfov_deg=_CROSSING_DEG) for name, (title, draw) in _TURNING.items()),
    *(Family(name, _G, title, draw, hfov_deg=_AS_FAST_DEG) for name, (title, draw) in _CROSSING.items()),
    _walker_or_rider("CPNA-25", "car to walker, nearside, 5 km/h", "walker", (5, 5), from_side=-1.0),
    _walker_or_rider("CPNA-75", "car to walker, nearside, 5 km/h", "walker", (5, 5), from_side=-1.0),
    _walker_or_rider("CPFA-50", "car to runner, farside, 8 km/h", "walker", (8, 8), from_side=1.0),
    _walker_or_rider(
        "CPNCO-50",
        "car to child, nearside, from behind parked cars, 5 km/h",
        "walker",
        (5, 5),
        from_side=-1.0,
        is_hidden=True,
        size_m=_CHILD_M,
    ),
    _walker_or_rider("CBNA-50", "car to cyclist, nearside, 10-20 km/h", "cyclist", (10, 20), from_side=-1.0),
    _walker_or_rider(
        "CBNAO-50",
        "car to cyclist, nearside, from behind parked cars, 10 km/h",
        "cyclist",
        (10, 10),
        from_side=-1.0,
        is_hidden=True,
    ),
    _walker_or_rider("CBFA-50", "car to cyclist, farside, 20 km/h", "cyclist", (20, 20), from_side=1.0),
    _ahead("CPLA-25", "car to walker, ahead in our direction, 5 km/h", "walker", (20, 80), (5, 5)),
    _ahead("CPLA-50", "car to walker, ahead in our direction, 5 km/h", "walker", (20, 60), (5, 5)),
    _ahead("CBLA-25", "car to cyclist, ahead in our direction, 20 km/h", "cyclist", (50, 80), (20, 20)),
    _ahead("CBLA-50", "car to cyclist, ahead in our direction, 15 km/h", "cyclist", (25, 80), (15, 15)),
    Family(
        "CPTA-50",
        _G,
        "car to walker, we turn, 5 km/h",
        partial(_turning, kind="walker", other_km_h=(5, 8), impact=_WHOLE_IMPACT),
        hfov_deg=_CROSSING_DEG,
    ),
    Family(
        "CBTA-50",
        _G,
        "car to cyclist, we turn, 10-15 km/h",
        partial(_turning, kind="cyclist", other_km_h=(10, 15), impact=_WHOLE_IMPACT),
        hfov_deg=_CROSSING_DEG,
    ),
)
