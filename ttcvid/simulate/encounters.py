"""Who comes close to the camera, when, and whether that is a collision: from the paths themselves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.model import Bools, Floats
from ttcvid.simulate.scene import Scene
from ttcvid.simulate.shapes import distance_to_parts_m
from ttcvid.simulate.world import STATIC_LABEL, Actor, World, build_world, is_object

STEP_S = 0.005
"""Grid of times on which distances are taken: at 30 m/s closing speed 15 cm apart."""
LOOK_AHEAD_S = 6.0
"""How far beyond the last picture the paths are followed: a clip may well end before the contact."""
_COARSE, _SPEED_MARGIN_M_S = 20, 5.0
"""Of so many times of the grid one is looked at first. Between them a distance changes no faster than by the largest
relative speed seen there, that of the farthest corner about the middle, and this: speeds change little in 0.1 s."""


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
    if not objects:
        return []
    alone = scene.model_copy(update={"bodies": objects})
    return encounters_in(build_world(alone, grid[_may_matter(build_world(alone, grid[::_COARSE]), len(grid))]))


def encounters_in(world: World) -> list[Encounter]:
    """The closest approach of every object of a world over its times: ``STEP_S`` apart wherever one is close."""
    return [_encounter(world, actor) for actor in world.actors if actor.object_id != STATIC_LABEL]


def _may_matter(coarse: World, n: int) -> Bools:
    """At which of ``n`` times some object may be nearest or touch, by every `_COARSE`-th of them."""
    may_matter = np.zeros(len(coarse.path.t_s), dtype=bool)
    for actor in coarse.actors:
        corner_m, turn_rad_s = (np.linalg.norm(v, axis=1).max() for v in (actor.corners_m, actor.path.turn_rad_s))
        speed_m_s = np.linalg.norm(actor.path.velocity_m_s - coarse.path.velocity_m_s, axis=1).max()
        reached_m = _COARSE * STEP_S * (speed_m_s + corner_m * turn_rad_s + _SPEED_MARGIN_M_S)
        distance = _distance_m(coarse, actor)
        may_matter |= distance - reached_m <= max(float(distance.min()), coarse.scene.own_motion.radius_m)
    # The times after each that is looked at, and those before it.
    return np.repeat(may_matter | np.append(may_matter[1:], may_matter[-1]), _COARSE)[:n]


def _distance_m(world: World, actor: Actor) -> Floats:
    """Distance of the camera from the body at the world's times ``(N,)``."""
    offset = world.path.position_m - actor.path.position_m
    return distance_to_parts_m(actor.parts, np.einsum("nji,nj->ni", actor.path.road_R_body, offset))


def _encounter(world: World, actor: Actor) -> Encounter:
    distance = _distance_m(world, actor)
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
