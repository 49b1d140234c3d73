"""How the errors of direction and time grow: each method over a varied quantity, by three ways, and how far it reaches.

The paper's section 3.1, with the methods that it names and those that came after.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from ttcvid.config import SensitivityConfig
from ttcvid.model import Floats
from ttcvid.studies.sensitivity import bounds, formulas, trials
from ttcvid.studies.sensitivity.case import KM_H, Case, Errors

SMALL = 0.1
"""Closed forms hold while the errors of direction (rad) and ttc_z are below this: then second-order terms are some
percent."""
_SMALL_SQUARE = 0.05
"""tcpa has no first-order term by the direction for motion at 45 deg off the ray: so the square of the direction's
error must stay below this share of the error of tcpa."""
_REACH_M = (0.5, 20000.0)
_REACH_STEPS = 1200


@dataclass(frozen=True)
class Method:
    """One way to direction and time: its name in tables, its pictures, and its errors by formula, bound and trials."""

    name: str
    n_frames: int
    label: str
    formula: Callable[[Case], Errors]
    bound: Callable[[Case], Errors]
    trials: Callable[[Case, int, np.random.Generator], trials.Trials]


@dataclass(frozen=True)
class Point:
    """The errors of one method at one value of what is varied."""

    value: float
    method: Method
    case: Case
    formula: Errors
    bound: Errors
    trials: Errors


@dataclass(frozen=True)
class Varied:
    """What can be varied: words with its unit, whether in equal ratios, and how it changes a case."""

    label: str
    is_geometric: bool
    apply: Callable[[Case, float], Case]


def varied(config: SensitivityConfig) -> Varied:
    """What the configuration varies."""
    pitch_mm = 1e-3 * config.pixel_pitch_um
    return {
        "distance": Varied("distance, m", True, lambda case, v: case.with_(distance_m=v)),
        "angle": Varied("angle with the optical axis, deg", False, _at_angle),
        "focal": Varied("focal length, mm", True, lambda case, v: case.with_(focal_px=v / pitch_mm)),
        "noise": Varied("noise of a coordinate, px", True, lambda case, v: case.with_(sigma_px=v)),
        "rate": Varied("pictures a second", True, lambda case, v: case.with_(step_s=1.0 / v)),
        "height": Varied("height off the horizon's plane, m", True, lambda case, v: case.with_(height_m=v)),
    }[config.over]


def base_case(config: SensitivityConfig) -> Case:
    """The case of which one quantity is varied."""
    return Case(
        distance_m=config.distance_m,
        height_m=config.height_m,
        speed_m_s=config.speed_km_h / KM_H,
        angle_rad=float(np.radians(config.angle_deg)),
        focal_px=config.focal_mm / (1e-3 * config.pixel_pitch_um),
        sigma_px=config.sigma_px,
        step_s=1.0 / config.frame_rate_hz,
        baseline_m=config.baseline_m,
    )


def values_of(config: SensitivityConfig) -> Floats:
    """The values ``(N,)`` that are tried."""
    return (np.geomspace if varied(config).is_geometric else np.linspace)(*config.span, config.steps)


def methods(lengths: Iterable[int]) -> list[Method]:
    """The paper's two methods, whole tracks of given lengths, and a stereo pair."""
    paper = [
        Method(
            "planar_two_frame",
            2,
            "planar, 2 frames",
            formulas.planar_two_frame,
            lambda case: bounds.bound(case, 2, is_planar=True),
            trials.planar_two_frame,
        ),
        Method(
            "three_frame",
            3,
            "general, 3 frames",
            lambda case: formulas.general(case, 3),
            lambda case: bounds.bound(case, 3, is_planar=False),
            trials.three_frame,
        ),
    ]
    stereo = Method("stereo", 2, "stereo pair", formulas.stereo, bounds.stereo_bound, trials.stereo)
    return [*paper, *map(_whole_track, lengths), stereo]


def sensitivity(config: SensitivityConfig) -> Iterator[Point]:
    """All points of the study: over the values, and at each over the methods."""
    case, what = base_case(config), varied(config)
    for k, value in enumerate(values_of(config).tolist()):
        here = what.apply(case, value)
        for m, method in enumerate(methods(lengths_of(config))):
            rng = np.random.default_rng([config.seed, k, m])
            tried = trials.errors_of(here, method.trials(here, config.trials, rng))
            yield Point(value, method, here, method.formula(here), method.bound(here), tried)


def is_small(errors: Errors) -> dict[str, bool]:
    """Where the closed forms hold, by quantity."""
    is_first_order = errors.direction_rad <= SMALL and errors.ttc_z <= SMALL
    return {
        "direction": is_first_order,
        "ttc_z": is_first_order,
        "tcpa": is_first_order and errors.direction_rad**2 <= _SMALL_SQUARE * errors.tcpa,
    }


def reach_m(case: Case, method: Method, within: float, quantity: str = "ttc_z") -> float:
    """Distance up to which a method's error of a quantity stays within a limit, by its closed form; 0 where nowhere."""
    distances = np.geomspace(*_REACH_M, _REACH_STEPS)
    errors = np.array([getattr(method.formula(case.with_(distance_m=d)), quantity) for d in distances.tolist()])
    is_within = errors <= within
    if not is_within.any():
        return 0.0
    beyond = np.flatnonzero(~is_within[is_within.argmax() :])
    return float(distances[is_within.argmax() + beyond[0] - 1]) if len(beyond) else float(distances[-1])


def reaches_m(config: SensitivityConfig) -> dict[str, float]:
    """Up to which distance each method, by its label, stays within the limit."""
    case = base_case(config)
    return {method.label: reach_m(case, method, config.within) for method in methods(lengths_of(config))}


def summary(config: SensitivityConfig, reaches: dict[str, float]) -> str:
    """What `reaches_m` says, in one sentence."""
    parts = [f"{label} up to {distance:.3g} m" for label, distance in reaches.items()]
    return f"time to collision within {100 * config.within:g} %: {', '.join(parts)}"


def lengths_of(config: SensitivityConfig) -> list[int]:
    """Lengths of the whole tracks, in pictures."""
    return [int(part) for part in config.frames.split(",")]


def _at_angle(case: Case, angle_deg: float) -> Case:
    return case.with_(angle_rad=float(np.radians(angle_deg)))


def _whole_track(n_frames: int) -> Method:
    return Method(
        "whole_track",
        n_frames,
        f"whole track, {n_frames} frames",
        lambda case: formulas.general(case, n_frames),
        lambda case: bounds.bound(case, n_frames, is_planar=False),
        trials.whole_track(n_frames),
    )
