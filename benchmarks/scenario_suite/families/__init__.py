"""All families by name, and the scenario that a family and a seed draw."""

from __future__ import annotations

from typing import Any

import numpy as np

from scenario_suite.families import vehicle_ahead
from scenario_suite.nuisances import baselines, conditioned, drawn_nuisances
from scenario_suite.scenario import Family, Kind, NuisanceValue, Scenario
from scenario_suite.seeds import generator
from ttcvid.simulate import Scene

FAMILIES: dict[str, Family] = {family.name: family for module in (vehicle_ahead,) for family in module.FAMILIES}


def scenario(
    family_name: str, seed: int, kind: Kind | None = None, nuisances: dict[str, NuisanceValue] | None = None
) -> Scenario:
    """The scenario of a family and a seed; ``kind`` instead of the family's own.

    ``nuisances`` instead of the drawn ones: those that are left out stand at their baselines. The scene below them
    stays the same.
    """
    family = FAMILIES[family_name]
    kind = kind or family.kind
    rng = generator(family_name, seed, "scene")
    collides = bool(rng.random() < 0.5) if family.collides is None else family.collides
    values = {"name": f"{family_name} {seed}", "seed": int(rng.integers(1, 2**31)), **family.draw(rng, collides)}
    if nuisances is None:
        chosen = drawn_nuisances(generator(family_name, seed, "nuisances"), family, kind)
    else:
        chosen = baselines(kind) | nuisances
    scene = conditioned(Scene.model_validate(_plain(values)), chosen, generator(family_name, seed, "conditions"))
    focal = chosen["focal"]
    return Scenario(
        family=family_name,
        seed=seed,
        group=family.group,
        scene=scene,
        kind=kind,
        platform=family.platform,
        camera_known=focal != "unknown",
        focal_error=float(focal) if isinstance(focal, float) else 0.0,
        is_collision=collides,
        expected_status=family.expected_status,
        warn_by_s=family.warn_by_s,
        nuisances=chosen,
    )


def _plain(value: Any) -> Any:
    """Numbers and lists as a scene file has them, to a tenth of a millimetre."""
    if isinstance(value, dict):
        return {key: _plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    return round(float(value), 4) if isinstance(value, float | np.floating) else value
