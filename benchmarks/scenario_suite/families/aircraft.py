"""Another aircraft, head-on, crossing, converging or overtaken by us, over ground and before sky; with near misses."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from numpy.random import Generator

from scenario_suite.families.streets import colour, mirrored, side
from scenario_suite.scenario import Family, Values

_RADIUS_M = 6.0
_PASSES_M = (25.0, 90.0)
"""How far off a near miss passes."""
_BEYOND_CLIP_S = (0.4, 5.0)
"""How long after the clip the closest approach is: the intruder is 8-80 px wide."""


def _encounter(
    rng: Generator,
    collides: bool,
    *,
    own_m_s: tuple[float, float],
    other_m_s: tuple[float, float],
    course_deg: tuple[float, float],
    hfov_deg: tuple[float, float],
) -> Values:
    """Two straight flights; the intruder climbs or descends, so that it stands before the ground or the sky."""
    own, other = float(rng.uniform(*own_m_s)), float(rng.uniform(*other_m_s))
    course, climb = math.radians(float(rng.uniform(*course_deg))), float(rng.uniform(-4.0, 4.0))
    velocity = np.array([other * math.cos(course), other * math.sin(course), climb])
    relative = velocity - [own, 0.0, 0.0]
    lasts_s, altitude_m = float(rng.uniform(3.6, 5.0)), float(rng.uniform(150.0, 700.0))
    at_s = lasts_s + float(rng.uniform(*_BEYOND_CLIP_S))
    miss = np.zeros(3)
    if not collides:
        # Anywhere in the plane normal to the relative motion.
        aside = np.cross(relative, [0.0, 0.0, 1.0])
        above = np.cross(aside, relative)
        angle = float(rng.uniform(-math.pi, math.pi))
        unit = math.cos(angle) * aside / np.linalg.norm(aside) + math.sin(angle) * above / np.linalg.norm(above)
        miss = float(rng.uniform(*_PASSES_M)) * unit
    wings = float(rng.uniform(8.0, 16.0))
    size = [wings * float(rng.uniform(0.7, 0.95)), wings, wings * 0.27]
    start = miss - relative * at_s + [0.0, 0.0, altitude_m - size[2] / 2]
    intruder = {
        "name": "intruder",
        "kind": "aircraft",
        "size_m": size,
        "at_m": start.tolist(),
        "velocity_m_s": velocity.tolist(),
        "heading_deg": math.degrees(course),
        "bank_deg": float(rng.uniform(-8.0, 8.0)),
        "colour_rgb": colour(rng),
    }
    values: Values = {
        "camera": {
            "image_size": [640, 360],
            "hfov_deg": float(rng.uniform(*hfov_deg)),
            "height_m": altitude_m,
            "pitch_deg": float(rng.uniform(0.0, 5.0)),
            "roll_deg": float(rng.uniform(-3.0, 3.0)),
            "fps": 20.0,
            "n_frames": int(lasts_s * 20.0) + 1,
        },
        "own_motion": {"speed_m_s": own, "pitch_jitter_deg": 0.05, "radius_m": _RADIUS_M},
        "ground": {"kind": "fields"},
        "picture": {"sky": str(rng.choice(["clouds", "clear"]))},
        "bodies": [intruder],
    }
    return mirrored(values) if side(rng) > 0 else values


_G = "aircraft"
_LENS_DEG = (35.0, 60.0)
_WIDE_DEG = (65.0, 95.0)
_HEAD_ON = partial(_encounter, own_m_s=(30, 60), other_m_s=(30, 60), course_deg=(168, 192), hfov_deg=_LENS_DEG)
_CROSSING = partial(_encounter, own_m_s=(40, 60), other_m_s=(18, 32), course_deg=(70, 120), hfov_deg=_WIDE_DEG)
_CONVERGING = partial(_encounter, own_m_s=(45, 65), other_m_s=(20, 32), course_deg=(15, 50), hfov_deg=_WIDE_DEG)
_OVERTAKING = partial(_encounter, own_m_s=(50, 65), other_m_s=(20, 32), course_deg=(-10, 10), hfov_deg=_LENS_DEG)
FAMILIES = tuple(
    Family(name, _G, title, draw, platform="aircraft", hfov_deg=hfov_deg)
    for name, title, draw, hfov_deg in (
        ("air-head-on", "another aircraft head-on, 30-60 m/s each", _HEAD_ON, _LENS_DEG),
        ("air-crossing", "another aircraft from the side", _CROSSING, _WIDE_DEG),
        ("air-converging", "another aircraft converges with our course", _CONVERGING, _WIDE_DEG),
        ("air-overtaking", "we overtake a slower aircraft", _OVERTAKING, _LENS_DEG),
    )
)
