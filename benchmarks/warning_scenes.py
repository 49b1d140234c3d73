"""Scenes for benchmarks/warnings_ahead.py: encounters of many kinds, drawn by number, half of them collisions.

Each kind of encounter is one function of a random generator and of whether it is to be a collision; what stands around
is drawn too. Number k of a kind is always the same scene.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

Values = dict[str, Any]
Encounter = Callable[[np.random.Generator, bool], Values]

# Length of the pictures' time before the contact (or before the nearest pass), s: what a warning has to find in it.
_AHEAD_S = 4.6
_COLOURS = ([170, 40, 40], [190, 190, 195], [40, 60, 170], [70, 110, 160], [210, 170, 60], [50, 90, 60], [60, 55, 50])
_VEHICLES = {"car": 4.3, "lorry": 9.0, "bus": 11.5}
# A thing that is not hit passes with this much room beyond what makes it touch us, m.
_CLEAR_M = (3.2, 6.0)
_HALF_CAR_M = 0.9


def crossing(rng: np.random.Generator, collides: bool) -> Values:
    """A vehicle out of a side road: its bearing stays, or it passes before or behind us."""
    own = rng.uniform(7.0, 12.0)
    # Slow enough to be in the picture: its bearing is that of the relative velocity.
    other = own * rng.uniform(0.35, 0.65)
    kind = str(rng.choice(["car", "car", "lorry"]))
    side = float(rng.choice([-1.0, 1.0]))
    heading_deg = -side * rng.uniform(75.0, 105.0)
    velocity = other * _along(heading_deg)
    place_m = own * _AHEAD_S
    # Where it is when we reach its path: on it, or before or behind by its half length, our room, and what is clear.
    off_s = 0.0
    if not collides:
        off_m = _VEHICLES[kind] / 2 + rng.uniform(*_CLEAR_M) + 1.0
        off_s = float(rng.choice([-1.0, 1.0])) * off_m * math.hypot(own, other) / (own * other)
    start = np.array([place_m, 0.0]) - velocity * (_AHEAD_S + off_s)
    thing = _vehicle(rng, kind, start, velocity_m_s=[*velocity.tolist(), 0.0])
    return _street(rng, own, [thing], side_road_at_m=place_m, open_side=side, hfov_deg=80.0)


def oncoming(rng: np.random.Generator, collides: bool) -> Values:
    """A vehicle that comes the other way: in our lane, or in its own."""
    own, other = rng.uniform(7.0, 12.0), rng.uniform(6.0, 11.0)
    kind = str(rng.choice(["car", "car", "lorry", "bus"]))
    half_m = _HALF_CAR_M if kind == "car" else 1.3
    beside_m = rng.uniform(-0.5, 0.5) if collides else half_m + rng.uniform(3.1, 3.8)
    start = np.array([(own + other) * _AHEAD_S + _VEHICLES[kind] / 2, beside_m])
    return _street(rng, own, [_vehicle(rng, kind, start, heading_deg=180.0, speed_m_s=other)])


def standing(rng: np.random.Generator, collides: bool) -> Values:
    """A vehicle that stands in our lane, or beside the road."""
    own = rng.uniform(8.0, 13.0)
    kind = str(rng.choice(["car", "car", "lorry"]))
    half_m = _HALF_CAR_M if kind == "car" else 1.25
    beside_m = rng.uniform(-0.6, 0.6) if collides else -(half_m + rng.uniform(3.1, 4.0))
    start = np.array([own * _AHEAD_S + _VEHICLES[kind] / 2, beside_m])
    thing = _vehicle(rng, kind, start, heading_deg=float(rng.choice([0.0, 180.0])), is_object=True)
    return _street(rng, own, [thing], road_width_m=13.0)


def lead(rng: np.random.Generator, collides: bool) -> Values:
    """A slower vehicle ahead of us that we run into, or one at our own speed."""
    own = rng.uniform(9.0, 13.0)
    kind = str(rng.choice(["car", "lorry"]))
    closing = rng.uniform(4.0, 7.0) if collides else 0.0
    gap_m = closing * _AHEAD_S if collides else rng.uniform(14.0, 22.0)
    start = np.array([gap_m + _VEHICLES[kind] / 2, rng.uniform(-0.3, 0.3)])
    return _street(rng, own, [_vehicle(rng, kind, start, heading_deg=0.0, speed_m_s=own - closing)])


def braking(rng: np.random.Generator, collides: bool) -> Values:
    """A car ahead of us that brakes: to a stop, or for a moment, so that we do not reach it."""
    own = rng.uniform(9.0, 12.0)
    braking_m_s2, from_s = rng.uniform(2.0, 3.0), 0.6
    if collides:
        # Contact 4 s after it starts to brake.
        gap_m, until = 0.5 * braking_m_s2 * (_AHEAD_S - from_s) ** 2, {}
    else:
        gap_m, until = rng.uniform(20.0, 26.0), {"acceleration_until_s": from_s + 0.6}
    gap_m = min(gap_m, own**2 / (2 * braking_m_s2) + own * max(0.0, _AHEAD_S - from_s - own / braking_m_s2))
    start = np.array([gap_m + _VEHICLES["car"] / 2, rng.uniform(-0.3, 0.3)])
    brakes = {"acceleration_m_s2": -braking_m_s2, "acceleration_from_s": from_s, **until}
    return _street(rng, own, [_vehicle(rng, "car", start, heading_deg=0.0, speed_m_s=own, **brakes)])


def walker(rng: np.random.Generator, collides: bool) -> Values:
    """Somebody who walks onto the road before us, or stays far enough beside it."""
    own, pace = rng.uniform(6.0, 9.0), rng.uniform(1.1, 1.7)
    side = float(rng.choice([-1.0, 1.0]))
    at_m = own * _AHEAD_S
    if collides:
        start, velocity = [at_m, side * pace * _AHEAD_S, 0.0], [0.0, -side * pace, 0.0]
    else:
        start, velocity = [at_m - 8.0, side * rng.uniform(4.2, 5.2), 0.0], [side * pace, 0.0, 0.0]
    # Flat figures: what faces the way that it walks would show us its edge, and be next to nothing in the picture.
    thing = {"name": "walker", "kind": "walker", "at_m": start, "velocity_m_s": velocity, "colour_rgb": _colour(rng)}
    thing["heading_deg"] = 180.0
    return _street(rng, own, [thing])


def aircraft(rng: np.random.Generator, collides: bool) -> Values:
    """Another aircraft: head-on or from the side, straight at us, or past us by 30 m and more."""
    own, other = rng.uniform(30.0, 45.0), rng.uniform(30.0, 45.0)
    heading_deg = 180.0 + rng.uniform(-30.0, 30.0)
    velocity = np.append(other * _along(heading_deg), 0.0)
    relative = velocity - [own, 0.0, 0.0]
    miss = np.zeros(3)
    if not collides:
        aside = np.cross(relative, [0.0, 0.0, 1.0])
        miss = float(rng.choice([-1.0, 1.0])) * rng.uniform(30.0, 60.0) * aside / np.linalg.norm(aside)
    start = -relative * (_AHEAD_S + 0.3) + miss + [0.0, 0.0, 249.0]
    # The wings of a small aircraft are 11 m wide: big enough to be seen.
    size = [rng.uniform(9.0, 13.0), rng.uniform(11.0, 16.0), rng.uniform(2.8, 4.0)]
    thing = {"name": "aircraft", "kind": "aircraft", "size_m": size, "at_m": start.tolist()}
    thing |= {"velocity_m_s": velocity.tolist(), "heading_deg": heading_deg, "colour_rgb": _colour(rng)}
    return {
        "camera": _camera(40, height_m=250.0, pitch_deg=3.0),
        "own_motion": {"speed_m_s": own, "pitch_jitter_deg": 0.05, "radius_m": 6.0},
        "ground": {"kind": "fields"},
        "picture": {"noise_grey": 1.5, "sky": str(rng.choice(["clouds", "clear"]))},
        "bodies": [thing],
    }


KINDS: dict[str, Encounter] = {
    "crossing": crossing,
    "oncoming": oncoming,
    "standing": standing,
    "lead": lead,
    "braking": braking,
    "walker": walker,
    "aircraft": aircraft,
}
"""What may come towards us."""


def scene_values(kind: str, number: int, *, collides: bool) -> Values:
    """A scene, as its file would have it."""
    rng = np.random.default_rng([list(KINDS).index(kind), number, collides])
    name = f"{kind}_{'collision' if collides else 'clear'}_{number}"
    values = {"name": name, "seed": int(rng.integers(1000, 10**6)), **KINDS[kind](rng, collides)}
    return dict(_plain(values))


def _along(heading_deg: float) -> np.ndarray:
    angle = math.radians(heading_deg)
    return np.array([math.cos(angle), math.sin(angle)])


def _colour(rng: np.random.Generator) -> list[int]:
    return list(_COLOURS[int(rng.integers(len(_COLOURS)))])


def _vehicle(rng: np.random.Generator, kind: str, start_m: np.ndarray, **motion: Any) -> Values:
    place = [*start_m.tolist(), 0.0]
    return {"name": f"other {kind}", "kind": kind, "at_m": place, "colour_rgb": _colour(rng), **motion}


def _camera(hfov_deg: float, *, height_m: float, pitch_deg: float) -> Values:
    return {
        "image_size": [640, 360],
        "hfov_deg": hfov_deg,
        "height_m": height_m,
        "pitch_deg": pitch_deg,
        "fps": 20,
        "n_frames": 84,
    }


def _street(
    rng: np.random.Generator,
    own_m_s: float,
    things: list[Values],
    *,
    side_road_at_m: float | None = None,
    open_side: float = 0.0,
    road_width_m: float = 8.0,
    hfov_deg: float | None = None,
) -> Values:
    """A street with houses, posts and trees; on its open side nothing hides what comes out of the side road."""
    bodies = list(things)
    if side_road_at_m is not None:
        bodies.append(_row("side road", "slab", [side_road_at_m, open_side * 27.0, 0.0], [6.0, 50.0, 0.02]))
        beyond = side_road_at_m + 14.0
        bodies.append(_row("far house", "house", [beyond, open_side * 14.0, 0.0], [14.0, 9.0, 7.0], 4, 16.0))
        bodies.append(_row("back wall", "wall", [side_road_at_m + 40.0, open_side * 48.0, 0.0], [120.0, 0.3, 4.0]))
    step = rng.uniform(12.5, 16.0)
    for side in (-1.0, 1.0):
        if side != open_side:
            size = [12.0, 9.0, rng.uniform(6.0, 10.0)]
            at = [rng.uniform(4.0, 10.0), side * rng.uniform(14.0, 17.0), 0.0]
            bodies.append(_row(f"house {side:+.0f}", "house", at, size, 8, step))
        at = [rng.uniform(8.0, 15.0), side * rng.uniform(7.0, 8.0), 0.0]
        bodies.append(_row(f"post {side:+.0f}", "post", at, [0.16, 0.16, rng.uniform(1.0, 4.5)], 8, step + 1.0))
    tree_side = -open_side if open_side else float(rng.choice([-1.0, 1.0]))
    at = [rng.uniform(12.0, 20.0), tree_side * 9.0, 0.0]
    bodies.append({"name": "tree", "kind": "tree", "at_m": at, "repeat": {"count": 7, "step_m": [16.0, 0.0, 0.0]}})
    bodies.append(_row("end of the street", "house", [190.0, 2.0, 0.0], [10.0, 60.0, 11.0]))
    return {
        "camera": _camera(hfov_deg or float(rng.choice([55.0, 62.0])), height_m=rng.uniform(1.3, 1.6), pitch_deg=2.0),
        "own_motion": {"speed_m_s": own_m_s, "pitch_jitter_deg": 0.05},
        "ground": {"kind": "street", "road_width_m": road_width_m, "road_offset_m": 2.0},
        "picture": {"sky": str(rng.choice(["clear", "clouds"]))},
        "bodies": bodies,
    }


def _row(name: str, kind: str, at_m: list[float], size_m: list[float], count: int = 1, step_m: float = 0.0) -> Values:
    body: Values = {"name": name, "kind": kind, "at_m": at_m, "size_m": size_m}
    return body if count == 1 else {**body, "repeat": {"count": count, "step_m": [step_m, 0.0, 0.0]}}


def _plain(value: Any) -> Any:
    """Numbers and lists as YAML writes them, to the millimetre."""
    if isinstance(value, dict):
        return {key: _plain(part) for key, part in value.items()}
    if isinstance(value, list):
        return [_plain(part) for part in value]
    return round(float(value), 3) if isinstance(value, float | np.floating) else value
