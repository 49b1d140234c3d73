"""What makes pictures and tracks worse than they could be, each drawn for every scene and each a sweep of its own."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from scenario_suite.scenario import Family, Kind, NuisanceValue, Values
from ttcvid.simulate import Scene

CLEAN_SHARE = 0.25
"""Share of scenes in which every nuisance stands at its baseline."""
_FASTEST_HZ = {960: 30.0, 1280: 20.0, 1920: 15.0}
"""Large pictures come slower, and without motion blur: they are what drawing costs."""
_RATE_JITTER = 0.4
_DROPPED_SHARE, _DOUBLED_SHARE = 0.1, 0.08


@dataclass(frozen=True)
class Nuisance:
    """One nuisance: its ``baseline``, the values of its sweep, and how often a scene has another than the baseline.

    ``draw`` gives the value of such a scene; without it one of ``sweep`` is taken.
    """

    name: str
    baseline: NuisanceValue
    sweep: tuple[NuisanceValue, ...]
    share: float
    draw: Callable[[Generator, Family], NuisanceValue] | None = None


def _focal(rng: Generator, family: Family) -> NuisanceValue:
    """Unknown, or off by 2 or 5 % to either side."""
    return "unknown" if rng.random() < 0.4 else float(rng.choice([-0.05, -0.02, 0.02, 0.05]))


def _hfov_deg(rng: Generator, family: Family) -> NuisanceValue:
    return round(float(rng.uniform(*family.hfov_deg)), 1)


def _frame_rate_hz(rng: Generator, family: Family) -> NuisanceValue:
    """Masts have 7-30 frames/s; the others seldom less than 10."""
    if family.group == "static":
        return float(rng.choice([7.0, 10.0, 12.5, 15.0, 25.0, 30.0]))
    return float(rng.choice([7.0, 10.0, 15.0, 25.0, 30.0, 60.0], p=[0.05, 0.2, 0.2, 0.25, 0.25, 0.05]))


def _width_px(rng: Generator, family: Family) -> NuisanceValue:
    return float(rng.choice([480, 960, 1280, 1920], p=[0.5, 0.37, 0.1, 0.03]))


_FOCAL = Nuisance("focal", 0.0, (-0.05, -0.02, 0.0, 0.02, 0.05, "unknown"), 0.4, _focal)
_HFOV = Nuisance("hfov_deg", None, (35.0, 50.0, 65.0, 80.0, 95.0, 110.0), 0.6, _hfov_deg)
_DISTORTION = Nuisance("distortion", 0.0, (-0.2, -0.1, 0.0, 0.05), 0.2)
_SHAKE = Nuisance("shake_deg", 0.0, (0.0, 0.05, 0.1, 0.3), 0.25)
_VIDEO = (
    Nuisance("sensor_noise_grey", 1.0, (0.0, 1.0, 2.0, 4.0), 0.6),
    Nuisance("codec_crf", 18.0, ("none", 18.0, 28.0, 35.0), 0.5),
    Nuisance("frame_rate_hz", 20.0, (7.0, 10.0, 15.0, 20.0, 30.0, 60.0), 0.6, _frame_rate_hz),
    Nuisance("frame_times", "steady", ("steady", "variable", "doubled", "dropped"), 0.2),
    Nuisance("width_px", 640.0, (480.0, 640.0, 960.0, 1280.0, 1920.0), 0.5, _width_px),
    _HFOV,
    _DISTORTION,
    _FOCAL,
    _SHAKE,
    Nuisance("texture", 1.0, (0.15, 0.3, 0.6, 1.0), 0.15),
    Nuisance("contrast", 1.0, (0.15, 0.3, 0.6, 1.0), 0.15),
    Nuisance("vignetting", 0.0, (0.0, 0.3, 0.6), 0.2),
    Nuisance("exposure_step", 0.0, (0.0, 0.1, 0.3), 0.15),
    Nuisance("motion_blur_s", 0.0, (0.0, 0.008, 0.016, 0.033), 0.1),
    Nuisance("rolling_shutter_s", 0.0, (0.0, 0.01, 0.02, 0.03), 0.12),
    Nuisance("spots", 0.0, (0.0, 10.0, 40.0), 0.12),
)
_TRACKS = (
    Nuisance("outlier_share", 0.0, (0.0, 0.05, 0.1, 0.2, 0.3), 0.5),
    Nuisance("track_noise_px", 0.2, (0.0, 0.1, 0.2, 0.5, 1.0), 0.6),
    Nuisance("track_length_frames", 100.0, (8.0, 15.0, 30.0, 100.0), 0.3),
    Nuisance("frame_rate_hz", 10.0, (7.0, 10.0, 15.0, 20.0, 30.0), 0.3),
    Nuisance("frame_times", "steady", ("steady", "variable", "dropped"), 0.2),
    Nuisance("width_px", 640.0, (480.0, 640.0, 960.0, 1280.0), 0.4),
    _HFOV,
    _DISTORTION,
    _FOCAL,
    _SHAKE,
)
NUISANCES: dict[Kind, dict[str, Nuisance]] = {
    "video": {nuisance.name: nuisance for nuisance in _VIDEO},
    "tracks": {nuisance.name: nuisance for nuisance in _TRACKS},
}
"""What there is, by kind of input and name. The units:

sensor_noise_grey, standard deviation; codec_crf of H.264, "none": nothing lost; hfov_deg None: the family's own;
distortion, how much the corners are displaced, as a share of their distance from the middle; focal, relative error of
the focal length that is given, or "unknown"; shake_deg, standard deviation at 4-9 Hz; texture and contrast, 1 as it is;
vignetting, light lost in the corners; exposure_step, relative; motion_blur_s, exposure; rolling_shutter_s, readout of a
picture; spots, how many; track_length_frames, mean until a track ends by chance.
"""


def baselines(kind: Kind) -> dict[str, NuisanceValue]:
    """The baseline of every nuisance of a kind of scene."""
    return {name: nuisance.baseline for name, nuisance in NUISANCES[kind].items()}


def drawn_nuisances(rng: Generator, family: Family, kind: Kind) -> dict[str, NuisanceValue]:
    """The value of every nuisance of a kind of scene, by name."""
    values = baselines(kind)
    if rng.random() < CLEAN_SHARE:
        return values
    for name in values:
        nuisance = NUISANCES[kind][name]
        # Both are drawn always: whether a scene has one nuisance does not change the value of the next.
        is_on = rng.random() < nuisance.share
        others = [value for value in nuisance.sweep if value != nuisance.baseline]
        value = nuisance.draw(rng, family) if nuisance.draw else others[int(rng.integers(len(others)))]
        if is_on:
            values[name] = value
    if kind == "video" and values["width_px"] in _FASTEST_HZ:
        values["frame_rate_hz"] = min(_number(values["frame_rate_hz"]), _FASTEST_HZ[int(_number(values["width_px"]))])
        values["motion_blur_s"] = 0.0
    return values


def conditioned(scene: Scene, nuisances: dict[str, NuisanceValue], rng: Generator) -> Scene:
    """A scene under its nuisances: the same motions, seen by a worse camera."""
    content = scene.model_dump(exclude_none=True)
    picture, camera, own = content["picture"], content["camera"], content["own_motion"]
    values = {name: _number(value) for name, value in nuisances.items() if isinstance(value, float)}
    duration_s = float(scene.camera.frame_times_s()[-1])
    times_s, repeated = _times_s(rng, duration_s, values["frame_rate_hz"], str(nuisances["frame_times"]))
    camera.pop("fps", None)
    camera.pop("n_frames", None)
    width_px = int(values["width_px"])
    camera |= {"times_s": times_s, "image_size": [width_px, 2 * round(width_px * 9 / 32)]}
    if "hfov_deg" in values:
        camera["hfov_deg"] = values["hfov_deg"]
    camera |= _lens(camera, values["distortion"])
    own["shake_deg"] = values["shake_deg"]
    shortest_s = float(np.diff(times_s).min())
    picture |= {
        "noise_grey": values.get("sensor_noise_grey", 0.0),
        "codec_crf": 0 if nuisances.get("codec_crf") == "none" else int(values.get("codec_crf", 0)),
        "texture": values.get("texture", 1.0),
        "contrast": values.get("contrast", 1.0),
        "vignetting": values.get("vignetting", 0.0),
        "gain_steps": picture["gain_steps"] or _gain_steps(rng, duration_s, values.get("exposure_step", 0.0)),
        "exposure_s": min(values.get("motion_blur_s", 0.0), shortest_s),
        "readout_s": min(values.get("rolling_shutter_s", 0.0), shortest_s),
        "n_spots": int(values.get("spots", 0)),
        "repeated_frames": repeated,
    }
    return Scene.model_validate(content)


def _times_s(rng: Generator, duration_s: float, rate_hz: float, kind: str) -> tuple[list[float], list[int]]:
    """Times of the pictures, and which of them show the one before once more."""
    steady = np.arange(math.floor(duration_s * rate_hz + 1e-6) + 1) / rate_hz
    n = len(steady)
    inner = np.arange(2, n - 1)
    if kind == "variable":
        steps = rng.uniform(1 - _RATE_JITTER, 1 + _RATE_JITTER, n - 1) / rate_hz
        times = np.concatenate([[0.0], np.cumsum(steps)])
        return times[times <= duration_s].round(6).tolist(), []
    if kind == "dropped":
        first = int(rng.integers(2, max(3, n - 4)))
        lost = {*inner[rng.random(len(inner)) < _DROPPED_SHARE].tolist(), *range(first, min(first + 3, n - 1))}
        return [float(t) for k, t in enumerate(steady.round(6)) if k not in lost], []
    if kind == "doubled":
        return steady.round(6).tolist(), inner[rng.random(len(inner)) < _DOUBLED_SHARE].tolist()
    return steady.round(6).tolist(), []


def _lens(camera: Values, displaced: float) -> Values:
    """Radial distortion that displaces the corners by a share of their distance from the middle."""
    if displaced == 0:
        return {}
    width, height = camera["image_size"]
    corner = math.tan(math.radians(camera["hfov_deg"] / 2)) * math.hypot(1.0, height / width)
    k1 = displaced / (corner / (1.0 + displaced)) ** 2
    return {"distortion_model": "plumb_bob", "distortion": [k1, 0.0, 0.0, 0.0, 0.0]}


def _gain_steps(rng: Generator, duration_s: float, step: float) -> list[list[float]]:
    """Darker, and brighter again."""
    if step == 0:
        return []
    first_s, second_s = sorted(rng.uniform(0.15, 0.9, 2) * duration_s)
    return [[float(first_s), 1.0 - step], [float(second_s), 1.0]]


def _number(value: NuisanceValue) -> float:
    assert isinstance(value, float)
    return value
