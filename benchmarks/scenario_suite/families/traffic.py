"""Traffic in which nothing happens: everybody keeps lane, distance or turn. Every warning is a false one."""

from __future__ import annotations

import math

import numpy as np
from numpy.random import Generator

from scenario_suite.families.streets import (
    KM_H,
    LANE_M,
    drive,
    km_h,
    mirrored,
    row,
    side,
    thing,
)
from scenario_suite.scenario import Family, Values

_VIEW_M = 90.0
_MOST_IN_ROW = 22
_LASTS_S = (3.2, 4.6)


def _lasts_s(rng: Generator) -> float:
    return float(rng.uniform(*_LASTS_S))


def _overtaken(rng: Generator, collides: bool) -> Values:
    """Somebody faster passes us on the left, and perhaps a second one."""
    own, lasts_s = km_h(rng, 60, 120), _lasts_s(rng)
    bodies = []
    for number in range(int(rng.integers(1, 3))):
        faster, beside_s = km_h(rng, 8, 35), float(rng.uniform(0.0, 1.8)) + 1.6 * number
        kind = str(rng.choice(["car", "car", "lorry"]))
        other = thing(rng, f"overtaking {number + 1}", kind, (-faster * beside_s, LANE_M), speed_m_s=own + faster)
        bodies.append({**other, "heading_deg": 0.0})
    reach_m = own * lasts_s + _VIEW_M
    return drive(rng, {"speed_m_s": own}, bodies, duration_s=lasts_s, reach_m=reach_m, setting="motorway", n_lanes=3)


def _own_lanes(rng: Generator, collides: bool) -> Values:
    """Parked cars beside our lane, oncoming traffic in its own."""
    own, lasts_s = km_h(rng, 25, 60), _lasts_s(rng)
    bodies, x_m = [], float(rng.uniform(25.0, 60.0))
    other = km_h(rng, 25, 60)
    for number in range(int(rng.integers(1, 4))):
        kind = str(rng.choice(["car", "car", "lorry", "motorcycle"]))
        place = (x_m, LANE_M + float(rng.uniform(-0.3, 0.3)))
        bodies.append(thing(rng, f"oncoming {number + 1}", kind, place, speed_m_s=other, heading_deg=180.0))
        x_m += float(rng.uniform(15.0, 45.0))
    n = int(rng.integers(3, 9))
    place = [float(rng.uniform(8.0, 20.0)), -LANE_M / 2 - 1.2, 0.0]
    bodies.append(row("parked", "car", place, None, n, float(rng.uniform(5.5, 11.0))))
    gaps = ((-10.0, 400.0, -1.0),) if rng.random() < 0.5 else ()
    reach_m = own * lasts_s + _VIEW_M
    return drive(rng, {"speed_m_s": own}, bodies, duration_s=lasts_s, reach_m=reach_m, setting="town", gaps_m=gaps)


def _lead_at_distance(rng: Generator, collides: bool) -> Values:
    """Somebody ahead at our own speed."""
    own, lasts_s = km_h(rng, 30, 120), _lasts_s(rng)
    kind = str(rng.choice(["car", "car", "lorry", "motorcycle"]))
    lead = thing(rng, "lead", kind, (0.0, float(rng.uniform(-0.4, 0.4))), speed_m_s=own, heading_deg=0.0)
    lead["at_m"][0] = max(6.0, own * float(rng.uniform(0.6, 1.8))) + lead["size_m"][0] / 2
    setting = "motorway" if own > 80 * KM_H else None
    return drive(
        rng, {"speed_m_s": own}, [lead], duration_s=lasts_s, reach_m=own * lasts_s + _VIEW_M + 30.0, setting=setting
    )


def _empty_road(rng: Generator, collides: bool) -> Values:
    """Rails, bridges, trees, houses; nobody else."""
    setting = str(rng.choice(["town", "avenue", "country", "motorway"]))
    own = km_h(rng, 80, 130) if setting == "motorway" else km_h(rng, 30, 90)
    lasts_s = _lasts_s(rng)
    n_lanes = 3 if setting == "motorway" else 2
    reach_m = own * lasts_s + _VIEW_M
    return drive(rng, {"speed_m_s": own}, [], duration_s=lasts_s, reach_m=reach_m, setting=setting, n_lanes=n_lanes)


def _waiting(rng: Generator, collides: bool) -> Values:
    """We stand at a junction; cars cross in both lanes, and walkers before us."""
    lasts_s, x_m = _lasts_s(rng), float(rng.uniform(8.0, 13.0))
    bodies = []
    for number in range(int(rng.integers(2, 5))):
        kind, towards = str(rng.choice(["car", "car", "lorry", "bus", "motorcycle", "cyclist"])), side(rng)
        speed = km_h(rng, 10, 20) if kind == "cyclist" else km_h(rng, 15, 50)
        y_m = -towards * speed * float(rng.uniform(-0.5, lasts_s)) - towards * 14.0 * number
        place = (x_m - towards * LANE_M / 2, y_m)
        bodies.append(thing(rng, f"crossing {number + 1}", kind, place, speed_m_s=speed, heading_deg=towards * 90.0))
    for number in range(int(rng.integers(0, 3))):
        pace, towards = km_h(rng, 3, 7), side(rng)
        y_m = -towards * pace * float(rng.uniform(0.0, lasts_s))
        walker = thing(rng, f"walker {number + 1}", "walker", (float(rng.uniform(3.5, 5.5)), y_m))
        bodies.append({**walker, "velocity_m_s": [0.0, towards * pace, 0.0], "heading_deg": 180.0})
    ours = {"speed_m_s": 0.0, "pitch_jitter_deg": 0.0}
    hfov_deg = float(rng.uniform(60.0, 100.0))
    return drive(rng, ours, bodies, duration_s=lasts_s, reach_m=_VIEW_M, side_road_m=x_m, hfov_deg=hfov_deg)


def _bend(rng: Generator, collides: bool) -> Values:
    """A bend with somebody ahead at our speed and somebody who comes round it in his own lane."""
    return _around(rng, radius_m=float(rng.uniform(60.0, 250.0)), own=km_h(rng, 40, 80), oncoming=True)


def _roundabout(rng: Generator, collides: bool) -> Values:
    """We are on a circle, others as well; one has left it."""
    values = _around(rng, radius_m=float(rng.uniform(13.0, 20.0)), own=km_h(rng, 15, 28), oncoming=False)
    centre = values["ground"]["centre_m"]
    values["bodies"].append(row("middle", "island", [*centre, 0.0], [9.0, 9.0, float(rng.uniform(0.5, 1.2))]))
    return values


def _around(rng: Generator, *, radius_m: float, own: float, oncoming: bool) -> Values:
    """A drive round a bend to the left (to the right in half of all)."""
    lasts_s, turn = _lasts_s(rng), math.degrees(own / radius_m)
    bends_right = rng.random() < 0.5 and oncoming
    # Right of a left bend is outside: our lane is the outer one, and the inner one where it bends to the right.
    other_m = radius_m + (LANE_M if bends_right else -LANE_M)
    middle_m = (radius_m + other_m) / 2
    bodies = []

    def on_arc(name: str, kind: str, at_m: float, along_deg: float, back: bool, speed: float) -> Values:
        place, heading_deg = _arc(radius_m, at_m, along_deg)
        body = thing(rng, name, kind, place, speed_m_s=speed, heading_deg=heading_deg + 180.0 * back)
        return {**body, "yaw_rate_deg_s": (-1 if back else 1) * math.degrees(speed / at_m)}

    ahead_deg = math.degrees(max(9.0, own * float(rng.uniform(0.8, 1.8))) / radius_m)
    kind = str(rng.choice(["car", "car", "lorry", "motorcycle"]))
    bodies.append(on_arc("ahead", kind, radius_m, ahead_deg, False, own * float(rng.uniform(0.97, 1.03))))
    if oncoming:
        speed = km_h(rng, 40, 70)
        along_deg = math.degrees((own + speed) * float(rng.uniform(1.5, lasts_s)) / radius_m)
        bodies.append(on_arc("oncoming", "car", other_m, along_deg, True, speed))
    else:
        bodies.append(on_arc("across", "car", radius_m, 160.0 + float(rng.uniform(-20.0, 20.0)), False, own))
        place, heading_deg = _arc(radius_m, radius_m + 14.0, float(rng.uniform(70.0, 110.0)))
        leaving = thing(rng, "leaving", "car", place, speed_m_s=km_h(rng, 20, 35), heading_deg=heading_deg - 70.0)
        bodies.append(leaving)
    bodies += _scenery_of_bend(rng, radius_m, middle_m, own * lasts_s)
    values: Values = {
        "camera": {
            "image_size": [640, 360],
            "hfov_deg": float(rng.uniform(60.0, 90.0)),
            "height_m": float(rng.uniform(1.2, 1.55)),
            "pitch_deg": float(rng.uniform(0.0, 4.0)),
            "fps": 20.0,
            "n_frames": int(lasts_s * 20.0) + 1,
        },
        "own_motion": {"speed_m_s": own, "yaw_rate_deg_s": turn, "pitch_jitter_deg": 0.04},
        "ground": {
            "kind": "street",
            "road_width_m": 2 * LANE_M + 0.6,
            "pavement_width_m": 1.0,
            "centre_m": [0.0, radius_m],
            "bend_radius_m": middle_m,
        },
        "picture": {"sky": str(rng.choice(["clear", "clouds"]))},
        "bodies": bodies,
    }
    return mirrored(values) if bends_right else values


def _arc(radius_m: float, at_m: float, along_deg: float) -> tuple[tuple[float, float], float]:
    """A place on a circle about the centre of our bend, and the heading along it in deg."""
    angle = math.radians(along_deg)
    return (at_m * math.sin(angle), radius_m - at_m * math.cos(angle)), along_deg


def _scenery_of_bend(rng: Generator, radius_m: float, middle_m: float, travelled_m: float) -> list[Values]:
    """Posts or rails, trees and houses along both sides, as far as one sees."""
    bodies: list[Values] = []
    most_deg = min(300.0, math.degrees((travelled_m + 110.0) / radius_m))
    has_rail = rng.random() < 0.5
    for name, at_side in (("in", -1.0), ("out", 1.0)):
        edge_m = middle_m + at_side * (LANE_M + 0.4)
        things = [("post", at_side * 1.0, 14.0, [0.14, 0.14, 1.1]), ("tree", at_side * 5.5, 17.0, [4.0, 4.0, 6.5])]
        if has_rail and at_side > 0:
            things.append(("wall", at_side * 0.7, 6.0, [6.0, 0.1, 0.8]))
        if at_side > 0:
            things.append(("house", at_side * 17.0, 24.0, [12.0, 9.0, 8.0]))
        for kind, aside_m, step_m, size in things:
            at_m = edge_m + aside_m
            if at_m < 3.0:
                continue
            first_m = float(rng.uniform(4.0, 12.0))
            for number, along_deg in enumerate(
                np.arange(math.degrees(first_m / at_m), most_deg, math.degrees(step_m / at_m))
            ):
                if number > 22:
                    break
                place, heading_deg = _arc(radius_m, at_m, float(along_deg))
                body = row(f"{kind} {name} {number + 1}", kind, [*place, 0.0], size)
                bodies.append({**body, "heading_deg": heading_deg})
    return bodies


_G = "vehicle_other"
FAMILIES = (
    Family("overtaken", _G, "somebody faster passes us on a motorway", _overtaken, collides=False),
    Family("own-lanes", _G, "parked cars and oncoming traffic, each in its own lane", _own_lanes, collides=False),
    Family("lead-at-distance", _G, "somebody ahead at our own speed", _lead_at_distance, collides=False),
    Family("empty-road", _G, "rails, bridges, trees and houses close by, nobody else", _empty_road, collides=False),
    Family("waiting", _G, "we stand at a junction, others cross", _waiting, collides=False, hfov_deg=(60.0, 110.0)),
    Family("bend", _G, "a bend with traffic in its lanes", _bend, collides=False, hfov_deg=(50.0, 100.0)),
    Family("roundabout", _G, "a roundabout with others on it", _roundabout, collides=False, hfov_deg=(60.0, 110.0)),
)
