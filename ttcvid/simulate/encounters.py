"""Who comes close to the camera, when, and whether that is a collision: from the paths themselves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.simulate.scene import Scene
from ttcvid.simulate.shapes import distance_to_parts_m
from ttcvid.simulate.world import STATIC_LABEL, Actor, World, build_world, is_object

STEP_S = 0.005
"""Grid of times on which distances are taken: at 30 m/s closing speed 15 cm apart."""
LOOK_AHEAD_S = 6.0
"""How far beyond the last picture the paths are followed: a clip may well end before the contact."""


@dataclass(frozen=True)
class Encounter:
    """The closest approach of one object; ``t_contact_s`` is NaN where there is no collision."""

    object_id: int
    name: str
    t_min_s: float
    min_distance_m: float
    is_collision: bool
    t_contact_s: float


def encounters(scene: Scene) -> list[Encounter]:
    """The closest approach of every object of a scene, from the first picture until 6 s after the last."""
    times = scene.camera.frame_times_s()
    grid = np.arange(times[0], times[-1] + LOOK_AHEAD_S, STEP_S)
    # Objects are numbered among themselves: without static bodies, of which there are many, they keep their numbers.
    objects = tuple(body for body in scene.bodies if is_object(body))
    return encounters_in(build_world(scene.model_copy(update={"bodies": objects}), grid))


def encounters_in(world: World) -> list[Encounter]:
    """The closest approach of every object of a world over its times, which should lie ``STEP_S`` apart."""
    return [_encounter(world, actor) for actor in world.actors if actor.object_id != STATIC_LABEL]


def _encounter(world: World, actor: Actor) -> Encounter:
    offset = world.path.position_m - actor.path.position_m
    inside = np.einsum("nji,nj->ni", actor.path.road_R_body, offset)
    distance = distance_to_parts_m(actor.parts, inside)
    nearest = int(distance.argmin())
    touching = np.flatnonzero(distance < world.scene.own_motion.radius_m)
    contact = float(world.path.t_s[touching[0]]) if len(touching) else float("nan")
    return Encounter(
        actor.object_id,
        actor.name,
        float(world.path.t_s[nearest]),
        float(distance[nearest]),
        bool(len(touching)),
        contact,
    )
