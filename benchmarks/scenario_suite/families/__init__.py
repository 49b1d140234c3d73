"""All families by name, and the scenario that a family and a seed draw."""

from __future__ import annotations

import zlib
from typing import Any

import numpy as np
from numpy.random import Generator

from scenario_suite.families import (
    aircraft,
    free,
    recorded,
    static,
    traffic,
    undetermined,
    vehicle_ahead,
    vehicle_other,
)
from scenario_suite.nuisances import baselines, conditioned, drawn_nuisances
from scenario_suite.scenario import Family, Kind, NuisanceValue, Recording, Scenario
from scenario_suite.seeds import generator
from ttcvid.simulate import STATIC_LABEL, Scene, build_world, encounters
from ttcvid.simulate.shapes import distance_to_parts_m
from ttcvid.simulate.world import World

_MOST_DRAWS = 60
_TOUCHING, _CLEAR = 0.9, 1.25
"""Shares of our radius: what comes between these two is neither a collision nor a near miss."""
_SEEN_SHARE = 0.4
"""An object is in the picture in this share of the frames."""
_SCENERY_M = 0.4
"""No scene brings the camera nearer to what stands around."""

_MODULES = (vehicle_ahead, vehicle_other, traffic, static, free, aircraft, undetermined, recorded)
FAMILIES: dict[str, Family] = {family.name: family for module in _MODULES for family in module.FAMILIES}


def scenario(
    family_name: str, seed: int, kind: Kind | None = None, nuisances: dict[str, NuisanceValue] | None = None
) -> Scenario:
    """The scenario of a family and a seed; ``kind`` instead of the family's own.

    ``nuisances`` instead of the drawn ones: those that are left out stand at their baselines. The scene below them
    stays the same.
    """
    family = FAMILIES[family_name]
    kind = kind or family.kinds[0]
    rng = generator(family_name, seed, "scene")
    # In turn: of any run of seeds one half ends in a collision.
    collides = (seed + zlib.crc32(family_name.encode())) % 2 == 0 if family.collides is None else family.collides
    texture_seed = int(rng.integers(1, 2**31))
    clean, recording = _drawn(family, rng, f"{family_name} {seed}", texture_seed, collides=collides)
    if nuisances is None:
        chosen = drawn_nuisances(generator(family_name, seed, "nuisances"), family, kind)
    else:
        chosen = baselines(kind) | nuisances
    scene = conditioned(clean, chosen, generator(family_name, seed, "conditions"))
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
        recording=recording,
    )


def in_turn(names: list[str]) -> list[str]:
    """Families with their groups in turn: the first few are of all groups, too."""
    rank = {
        name: sum(FAMILIES[other].group == FAMILIES[name].group for other in names[:k]) for k, name in enumerate(names)
    }
    return sorted(names, key=rank.__getitem__)


def _drawn(family: Family, rng: Generator, name: str, seed: int, *, collides: bool) -> tuple[Scene, Recording | None]:
    """The first scene of a family that is what it is to be: a collision, or clear of one."""
    for _ in range(_MOST_DRAWS):
        values = {"name": name, "seed": seed, **family.draw(rng, collides)}
        recording = values.pop("recording", None)
        scene = Scene.model_validate(_plain(values))
        distance_m = nearest_m(scene)
        radius_m = scene.own_motion.radius_m
        is_right = distance_m < _TOUCHING * radius_m if collides else distance_m > _CLEAR * radius_m
        if not is_right:
            continue
        world = build_world(scene)
        if is_seen(world) and clear_of_scenery_m(world) > _SCENERY_M:
            return scene, recording
    raise RuntimeError(f"{name}: no {'collision' if collides else 'near miss'} in {_MOST_DRAWS} draws: mend the family")


def nearest_m(scene: Scene) -> float:
    """How near an object comes to the camera; infinite without one."""
    return min((encounter.min_distance_m for encounter in encounters(scene)), default=np.inf)


def is_seen(world: World) -> bool:
    """Whether some object is before the camera long enough, what may hide it left out; true without objects."""
    objects = [actor for actor in world.actors if actor.object_id != STATIC_LABEL]
    tangent = np.tan(np.radians((world.scene.camera.hfov_deg or 0.0) / 2))
    shares = []
    for actor in objects:
        place = np.einsum("nij,nj->ni", world.path.cam_R_road, actor.path.position_m - world.path.position_m)
        shares.append(float(np.mean((place[:, 2] > 0) & (np.abs(place[:, 0]) < tangent * place[:, 2]))))
    return not objects or max(shares) >= _SEEN_SHARE


def clear_of_scenery_m(world: World) -> float:
    """Distance of the camera from the nearest static body over all pictures; infinite without one."""
    nearest = np.inf
    for actor in world.actors:
        if actor.object_id == STATIC_LABEL:
            offset = world.path.position_m - actor.path.position_m
            inside = np.einsum("nji,nj->ni", actor.path.road_R_body, offset)
            nearest = min(nearest, float(distance_to_parts_m(actor.parts, inside).min()))
    return nearest


def _plain(value: Any) -> Any:
    """Numbers and lists as a scene file has them, to a tenth of a millimetre."""
    if isinstance(value, dict):
        return {key: _plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    return round(float(value), 4) if isinstance(value, float | np.floating) else value
