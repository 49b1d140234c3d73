"""What makes pictures and tracks worse than they could be, each drawn for every scene and each a sweep of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from numpy.random import Generator

from scenario_suite.scenario import Family, Kind, NuisanceValue
from ttcvid.simulate import Scene

CLEAN_SHARE = 0.25
"""Share of scenes in which every nuisance stands at its baseline."""


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
    """Unknown, or off by up to 5 % to either side."""
    return "unknown" if rng.random() < 0.4 else round(float(rng.choice([-1, 1]) * rng.choice([0.02, 0.05])), 3)


_FOCAL = Nuisance("focal", 0.0, (0.0, 0.02, 0.05, "unknown"), 0.4, _focal)
_VIDEO = (
    Nuisance("sensor_noise_grey", 1.0, (0.0, 1.0, 2.0, 4.0), 0.6),
    _FOCAL,
)
_TRACKS = (
    Nuisance("outlier_share", 0.0, (0.0, 0.05, 0.1, 0.2, 0.3), 0.5),
    _FOCAL,
)
NUISANCES: dict[Kind, dict[str, Nuisance]] = {
    "video": {nuisance.name: nuisance for nuisance in _VIDEO},
    "tracks": {nuisance.name: nuisance for nuisance in _TRACKS},
}


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
    return values


def conditioned(scene: Scene, nuisances: dict[str, NuisanceValue], rng: Generator) -> Scene:
    """A scene under its nuisances."""
    picture = scene.picture.model_dump() | {"noise_grey": nuisances.get("sensor_noise_grey", 0.0)}
    return Scene.model_validate(scene.model_dump() | {"picture": picture})
