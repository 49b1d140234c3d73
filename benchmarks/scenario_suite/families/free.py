"""Hand-held and hovering cameras among movers in six degrees of freedom, as clips and as tables of point tracks."""

from __future__ import annotations

import math

import numpy as np
from numpy.random import Generator

from scenario_suite.families.streets import km_h, row, thing
from scenario_suite.scenario import Family, Values


def _hand_held(rng: Generator, collides: bool) -> Values:
    """Somebody holds the camera, stands or walks slowly, and pans."""
    own = {
        "speed_m_s": float(rng.choice([0.0, rng.uniform(0.4, 1.5)])),
        "heading_deg": 0.0,
        "yaw_rate_deg_s": float(rng.uniform(-8.0, 8.0)),
        "sway_m": [float(rng.uniform(0.02, 0.15)) for _ in range(3)],
        "sway_period_s": float(rng.uniform(2.0, 5.0)),
        "swing_deg": [float(rng.uniform(0.5, 5.0)), float(rng.uniform(0.3, 3.0)), float(rng.uniform(0.2, 2.0))],
        "swing_period_s": float(rng.uniform(2.5, 6.0)),
        "shake_deg": float(rng.uniform(0.02, 0.12)),
        "radius_m": 0.4,
    }
    return _scene(
        rng, own, height_m=float(rng.uniform(1.3, 1.8)), pitch_deg=float(rng.uniform(-5.0, 8.0)), away_m=(4.0, 22.0)
    )


def _hovering(rng: Generator, collides: bool) -> Values:
    """A drone that hovers or drifts, climbs, pans and tilts."""
    own = {
        "speed_m_s": float(rng.choice([0.0, rng.uniform(0.5, 5.0)])),
        "climb_m_s": float(rng.uniform(-0.5, 1.2)),
        "yaw_rate_deg_s": float(rng.uniform(-10.0, 10.0)),
        "sway_m": [float(rng.uniform(0.05, 0.4)) for _ in range(3)],
        "sway_period_s": float(rng.uniform(3.0, 6.0)),
        "swing_deg": [float(rng.uniform(0.3, 3.0)), float(rng.uniform(0.3, 3.0)), float(rng.uniform(0.1, 1.5))],
        "swing_period_s": float(rng.uniform(3.0, 6.0)),
        "shake_deg": float(rng.uniform(0.0, 0.06)),
        "radius_m": 0.4,
    }
    height_m = float(rng.uniform(4.0, 25.0))
    return _scene(rng, own, height_m=height_m, pitch_deg=float(rng.uniform(8.0, 35.0)), away_m=(8.0, 30.0))


def _scene(rng: Generator, own: Values, *, height_m: float, pitch_deg: float, away_m: tuple[float, float]) -> Values:
    hfov_deg, lasts_s = float(rng.uniform(50.0, 80.0)), float(rng.uniform(3.2, 4.6))
    look_m = away_m[1] if pitch_deg < 5 else min(60.0, height_m / math.tan(math.radians(pitch_deg)))
    movers = [
        _mover(rng, number + 1, height_m, pitch_deg, hfov_deg, away_m, lasts_s, own)
        for number in range(int(rng.integers(1, 6)))
    ]
    return {
        "camera": {
            "image_size": [640, 360],
            "hfov_deg": hfov_deg,
            "height_m": height_m,
            "pitch_deg": pitch_deg,
            "fps": 20.0,
            "n_frames": int(lasts_s * 20.0) + 1,
        },
        "own_motion": own,
        "ground": {"kind": str(rng.choice(["square", "street"]))},
        "picture": {"sky": str(rng.choice(["clear", "clouds"]))},
        "bodies": [*movers, *surroundings(rng, max(look_m, 14.0))],
    }


def _mover(
    rng: Generator,
    number: int,
    height_m: float,
    pitch_deg: float,
    hfov_deg: float,
    away_m: tuple[float, float],
    lasts_s: float,
    own: Values,
) -> Values:
    """One that is before the camera in the middle of the clip: in the air with spin, or on the ground."""
    at_s = lasts_s / 2
    kind = str(rng.choice(["drone", "drone", "box", "walker", "cyclist", "car"]))
    # Where the camera looks by then, its swings left out.
    pan = math.radians(own["yaw_rate_deg_s"] * at_s + hfov_deg * float(rng.uniform(-0.35, 0.35)))
    tilt = math.radians(-pitch_deg + float(rng.uniform(-10.0, 10.0)))
    away = float(rng.uniform(*away_m))
    eye_m = height_m + own.get("climb_m_s", 0.0) * at_s
    there = np.array([away * math.cos(pan), away * math.sin(pan), eye_m + away * math.tan(tilt)])
    there[0] += own["speed_m_s"] * at_s
    if kind in ("walker", "cyclist", "car"):
        ground_m = max(away, 5.0 if kind == "walker" else 9.0)
        if pitch_deg > 5:
            ground_m = eye_m / math.tan(math.radians(min(80.0, max(4.0, -math.degrees(tilt)))))
        place = np.array([ground_m * math.cos(pan) + own["speed_m_s"] * at_s, ground_m * math.sin(pan)])
        way = float(rng.uniform(-180.0, 180.0))
        pace = {"walker": km_h(rng, 3, 8), "cyclist": km_h(rng, 8, 20), "car": km_h(rng, 15, 45)}[kind]
        velocity = pace * np.array([math.cos(math.radians(way)), math.sin(math.radians(way))])
        start = place - velocity * at_s
        body = thing(rng, f"{kind} {number}", kind, (float(start[0]), float(start[1])))
        facing = 180.0 if kind == "walker" else way
        return {**body, "velocity_m_s": [*velocity.tolist(), 0.0], "heading_deg": facing}
    velocity = rng.uniform((-3.0, -3.0, -1.2), (3.0, 3.0, 1.2))
    there[2] = max(there[2], 0.6 + abs(float(velocity[2])) * at_s)
    size = float(rng.uniform(0.5, 1.4)) * (1.0 + away / 20.0)
    body = thing(rng, f"{kind} {number}", kind, (0.0, 0.0))
    body["at_m"] = (there - velocity * at_s).tolist()
    body["size_m"] = [size, size, size * (0.4 if kind == "drone" else 0.8)]
    body["velocity_m_s"] = velocity.tolist()
    body["heading_deg"] = float(rng.uniform(-180.0, 180.0))
    if rng.random() < 0.7:
        body["spin_deg_s"] = rng.uniform(-40.0, 40.0, 3).tolist()
    return body


def surroundings(rng: Generator, look_m: float) -> list[Values]:
    """Houses, trees, posts and crates all around the middle of the picture."""
    bodies = [
        row(
            f"house {k + 1}",
            "house",
            [look_m + 22.0 + 3.0 * (k % 2), (k - 3) * 14.0, 0.0],
            [9.0, 12.0, 5.0 + 2.0 * (k % 3)],
        )
        for k in range(7)
    ]
    sizes: dict[str, list[float] | None] = {"tree": None, "post": [0.25, 0.25, 3.0], "box": [1.2, 1.2, 1.2]}
    for number in range(int(rng.integers(6, 14))):
        kind = str(rng.choice(list(sizes)))
        place = [float(rng.uniform(0.4, 1.3)) * look_m + 3.0, float(rng.uniform(-0.9, 0.9)) * look_m, 0.0]
        bodies.append(
            {**row(f"static {kind} {number + 1}", kind, place, sizes[kind]), "heading_deg": float(rng.uniform(0, 90))}
        )
    return bodies


_G, _DEG, _TRACKS = "free", (45.0, 90.0), ("tracks",)
_TITLE = "1-5 movers, as a table of point tracks"
FAMILIES = (
    Family("hand-held", _G, "hand-held camera, 1-5 movers", _hand_held, "free", hfov_deg=_DEG, collides=False),
    Family("hovering", _G, "hovering camera, 1-5 movers", _hovering, "free", hfov_deg=_DEG, collides=False),
    Family("hand-held-tracks", _G, f"hand-held camera, {_TITLE}", _hand_held, "free", _TRACKS, _DEG, collides=False),
    Family("hovering-tracks", _G, f"hovering camera, {_TITLE}", _hovering, "free", _TRACKS, _DEG, collides=False),
)
