"""Scenes in which nothing can be told, and that has to be said: by its status, not by a number."""

from __future__ import annotations

from numpy.random import Generator

from scenario_suite.families.free import surroundings
from scenario_suite.families.streets import drive, km_h
from scenario_suite.scenario import Family, Values

_LASTS_S = (2.5, 3.5)
_DARK_GAIN = (0.005, 0.03)
"""Share of the light that a covered lens or a tunnel without lamps leaves."""


def _camera(rng: Generator, height_m: float, pitch_deg: float) -> Values:
    return {
        "image_size": [640, 360],
        "hfov_deg": float(rng.uniform(50.0, 80.0)),
        "height_m": height_m,
        "pitch_deg": pitch_deg,
        "fps": 20.0,
        "n_frames": int(rng.uniform(*_LASTS_S) * 20.0) + 1,
    }


def _panning(rng: Generator, collides: bool) -> Values:
    """A tripod: the camera turns on the spot, nothing moves."""
    swing_deg = [float(rng.uniform(3.0, 10.0)), float(rng.uniform(0.5, 3.0)), 0.0]
    return {
        "camera": _camera(rng, float(rng.uniform(1.4, 3.0)), float(rng.uniform(-3.0, 8.0))),
        "own_motion": {"swing_deg": swing_deg, "swing_period_s": float(rng.uniform(3.0, 6.0))},
        "ground": {"kind": "square"},
        "bodies": surroundings(rng, float(rng.uniform(18.0, 30.0))),
    }


def _resting(rng: Generator, collides: bool) -> Values:
    """A camera at rest, and nobody there."""
    return {
        "camera": _camera(rng, float(rng.uniform(3.0, 10.0)), float(rng.uniform(5.0, 20.0))),
        "ground": {"kind": "square"},
        "bodies": surroundings(rng, float(rng.uniform(18.0, 30.0))),
    }


def _clear_sky(rng: Generator, collides: bool) -> Values:
    """An aircraft that looks into a sky without clouds."""
    return {
        "camera": _camera(rng, 300.0, -45.0),
        "own_motion": {"speed_m_s": float(rng.uniform(30.0, 60.0)), "pitch_jitter_deg": 0.05},
        "ground": {"kind": "none"},
        "picture": {"sky": "clear"},
    }


def _dark(rng: Generator, collides: bool) -> Values:
    """A drive through the dark."""
    own = km_h(rng, 30, 80)
    values = drive(rng, {"speed_m_s": own}, [], duration_s=float(rng.uniform(*_LASTS_S)), reach_m=own * 3.5 + 80.0)
    values["picture"]["gain_steps"] = [[0.0, float(rng.uniform(*_DARK_GAIN))]]
    return values


_VIDEO = ("video",)
FAMILIES = tuple(
    Family(name, group, title, draw, platform, kinds, collides=False, expected_status=status)
    for name, group, title, draw, platform, kinds, status in (
        ("panning", "free", "camera turns on the spot", _panning, "free", ("video", "tracks"), "rotation_only"),
        ("resting", "static", "camera at rest, nobody there", _resting, "static", ("video", "tracks"), "static"),
        ("clear-sky", "aircraft", "nothing but sky", _clear_sky, "aircraft", _VIDEO, "few_tracks"),
        ("dark", "vehicle_other", "a drive through the dark", _dark, "vehicle", _VIDEO, "dark"),
    )
)
