"""Cameras on masts over junctions and squares: movers that cross, meet, stop, turn and hide each other."""

from __future__ import annotations

import math

import numpy as np
from numpy.random import Generator

from scenario_suite.families.streets import SIZES_M, km_h, row, thing
from scenario_suite.scenario import Family, Values
from ttcvid.simulate.motion import position_at
from ttcvid.simulate.poses import body_motion
from ttcvid.simulate.scene import Body

_ROOM_M = 0.6
"""Room between two that pass each other."""
_MOST_TRIES = 40


def _mast(rng: Generator, n_movers: tuple[int, int], kinds: list[str], headings_deg: list[float]) -> Values:
    """A resting camera over a place with movers; ``headings_deg`` are the ways they go, spread by 12 deg."""
    height_m, look_m = float(rng.uniform(3.0, 12.0)), float(rng.uniform(16.0, 34.0))
    hfov_deg, lasts_s = float(rng.uniform(45.0, 85.0)), float(rng.uniform(4.0, 6.0))
    pitch_deg = math.degrees(math.atan(height_m / look_m))
    movers: list[Values] = []
    wanted = int(rng.integers(n_movers[0], n_movers[1] + 1))
    for _ in range(_MOST_TRIES * wanted):
        mover = _mover(rng, len(movers) + 1, kinds, headings_deg, look_m, hfov_deg, lasts_s)
        if all(_keep_apart(mover, other, lasts_s) for other in movers):
            movers.append(mover)
        if len(movers) == wanted:
            break
    return {
        "camera": {
            "image_size": [640, 360],
            "hfov_deg": hfov_deg,
            "height_m": height_m,
            "pitch_deg": pitch_deg,
            "roll_deg": float(rng.uniform(-2.0, 2.0)),
            "fps": 20.0,
            "n_frames": int(lasts_s * 20.0) + 1,
        },
        "ground": {"kind": "square"}
        if rng.random() < 0.5
        else {"kind": "street", "road_width_m": 9.0, "road_offset_m": float(rng.uniform(-6.0, 6.0))},
        "picture": {"sky": str(rng.choice(["clear", "clouds"]))},
        "bodies": [*movers, *_surroundings(rng, look_m)],
    }


def _mover(
    rng: Generator,
    number: int,
    kinds: list[str],
    headings_deg: list[float],
    look_m: float,
    hfov_deg: float,
    lasts_s: float,
) -> Values:
    """Somebody who is in the picture at some time: goes on, stops, sets off, or turns."""
    kind = str(rng.choice(kinds))
    speed = {"walker": (3, 7), "cyclist": (10, 22)}.get(kind, (12, 50))
    pace, heading_deg = km_h(rng, *speed), float(rng.choice(headings_deg) + rng.uniform(-12.0, 12.0))
    x_m = look_m * float(rng.uniform(0.65, 1.9))
    there = np.array([x_m, x_m * math.tan(math.radians(hfov_deg / 2)) * float(rng.uniform(-0.75, 0.75))])
    at_s = float(rng.uniform(0.2, 0.8)) * lasts_s
    way = np.array([math.cos(math.radians(heading_deg)), math.sin(math.radians(heading_deg))])
    start = there - pace * at_s * way
    body = thing(rng, f"{kind} {number}", kind, (float(start[0]), float(start[1])))
    does = str(rng.choice(["goes on", "goes on", "stops", "sets off", "turns"]))
    if kind == "walker":
        body |= {"velocity_m_s": [*(pace * way).tolist(), 0.0], "heading_deg": 180.0}
    else:
        body |= {"heading_deg": heading_deg, "speed_m_s": pace}
    if does == "stops":
        rate = float(rng.uniform(1.0, 3.0))
        body |= {"acceleration_m_s2": -rate, "acceleration_from_s": max(0.0, at_s - pace / (2 * rate))}
    elif does == "sets off" and kind != "walker":
        body |= {"speed_m_s": 0.0, "at_m": [*there.tolist(), 0.0]}
        body |= {"acceleration_m_s2": float(rng.uniform(1.0, 2.5)), "acceleration_from_s": 0.3 * at_s}
    elif does == "turns" and kind != "walker":
        radius_m = float(rng.uniform(7.0, 15.0))
        rate_deg_s = float(rng.choice([-1.0, 1.0])) * math.degrees(min(pace, 9.0) / radius_m)
        body |= {
            "yaw_rate_deg_s": rate_deg_s,
            "yaw_from_s": at_s - 0.5,
            "yaw_until_s": at_s - 0.5 + 90 / abs(rate_deg_s),
        }
        body["yaw_from_s"] = max(0.0, body["yaw_from_s"])
    return body


def _keep_apart(one: Values, other: Values, lasts_s: float) -> bool:
    """Whether two bodies never touch while they are seen."""
    times = np.arange(-0.0, lasts_s + 0.3, 0.1)
    places = [position_at(body_motion(Body.model_validate(body)), times)[:, :2] for body in (one, other)]
    sizes = [SIZES_M[body["kind"]] for body in (one, other)]
    least_m = sum(max(length, width) / 2 for length, width, _ in sizes) + _ROOM_M
    return bool(np.linalg.norm(places[0] - places[1], axis=1).min() > least_m)


def _surroundings(rng: Generator, look_m: float) -> list[Values]:
    """Houses behind, trees and posts beside."""
    bodies = []
    far_m = look_m * 2.2 + 15.0
    for number in range(5):
        size = [10.0, 15.0, float(rng.uniform(6.0, 13.0))]
        bodies.append(row(f"house {number + 1}", "house", [far_m, (number - 2) * 17.0, 0.0], size))
    for number in range(int(rng.integers(2, 7))):
        kind = str(rng.choice(["tree", "post"]))
        x_m, at_side = float(rng.uniform(0.7, 1.8)) * look_m, float(rng.choice([-1.0, 1.0]))
        size = [0.2, 0.2, float(rng.uniform(2.0, 5.0))] if kind == "post" else None
        place = [x_m, at_side * x_m * float(rng.uniform(0.35, 0.8)), 0.0]
        bodies.append(row(f"{kind} {number + 1}", kind, place, size))
    return bodies


_VEHICLES = ["car", "car", "car", "lorry", "bus", "motorcycle"]


def _crossing_traffic(rng: Generator, collides: bool) -> Values:
    return _mast(rng, (2, 6), _VEHICLES, [-90.0, 90.0])


def _along(rng: Generator, collides: bool) -> Values:
    return _mast(rng, (2, 6), _VEHICLES, [0.0, 180.0])


def _junction(rng: Generator, collides: bool) -> Values:
    return _mast(rng, (4, 10), [*_VEHICLES, "walker", "cyclist"], [0.0, 180.0, -90.0, 90.0])


def _walkers(rng: Generator, collides: bool) -> Values:
    return _mast(rng, (2, 10), ["walker", "walker", "walker", "cyclist"], [0.0, 180.0, -90.0, 90.0, 45.0, -135.0])


_G = "static"
FAMILIES = tuple(
    Family(name, _G, title, draw, platform="static", collides=False, hfov_deg=(40.0, 100.0))
    for name, title, draw in (
        ("mast-crossing", "camera on a mast, vehicles cross and hide each other", _crossing_traffic),
        ("mast-along", "camera on a mast, vehicles come and go", _along),
        ("mast-junction", "camera on a mast over a junction: vehicles, cyclists and walkers", _junction),
        ("mast-walkers", "camera on a mast over a square with walkers and cyclists", _walkers),
    )
)
