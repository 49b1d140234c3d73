"""What happens in a simulated scene when our velocity is another one: every way driven in small steps of time.

Nothing of ``ttcvid.studies`` is used: a collision is what the simulator calls one, a body's surface nearer to the
camera than ``radius_m`` of the scene's own motion.
"""

from __future__ import annotations

import numpy as np

from ttcvid.simulate import Scene, World, build_world
from ttcvid.simulate.shapes import distance_to_parts_m

STEP_S = 0.02
"""At 20 m/s against each other, 0.4 m."""


def contact_times_s(
    scene: Scene, start_s: float, velocities_m_s: np.ndarray, turn_left_rad_s: float, look_ahead_s: float
) -> np.ndarray:
    """When each of C ways touches a body ``(C,)``, in s from ``start_s``; infinite: not within the look-ahead.

    ``velocities_m_s (C, 3)`` are own velocities in the road frame at the start, from where the scene has us then; each
    turns to the left all the way. Bodies move as in the scene.
    """
    after_s = np.arange(0.0, look_ahead_s + 1e-9, STEP_S)
    world = build_world(scene, start_s + after_s)
    places = world.path.position_m[0] + ways_m(velocities_m_s, turn_left_rad_s, after_s)
    contact = np.full(len(velocities_m_s), np.inf)
    for actor in world.actors:
        size = max(float(np.abs([part.low_m, part.high_m]).max()) for part in actor.parts) * np.sqrt(3.0)
        for k, at_s in enumerate(after_s):
            offset = places[:, k] - actor.path.position_m[k]
            near = (contact > at_s) & (np.linalg.norm(offset, axis=1) < size + scene.own_motion.radius_m)
            if near.any():
                inside = offset[near] @ actor.path.road_R_body[k]
                touched = distance_to_parts_m(actor.parts, inside) < scene.own_motion.radius_m
                contact[np.flatnonzero(near)[touched]] = at_s
    return contact


def ways_m(velocities_m_s: np.ndarray, turn_left_rad_s: float, after_s: np.ndarray) -> np.ndarray:
    """How far velocities ``(C, 3)`` that turn about the vertical have come after times ``(T,)``: ``(C, T, 3)``."""
    if turn_left_rad_s == 0.0:
        return velocities_m_s[:, None, :] * after_s[None, :, None]
    angle = turn_left_rad_s * after_s
    along, across = np.sin(angle) / turn_left_rad_s, (1.0 - np.cos(angle)) / turn_left_rad_s
    x, y, z = velocities_m_s.T[:, :, None]
    return np.stack([x * along - y * across, x * across + y * along, z * after_s], axis=-1)


def is_inner(is_hit: np.ndarray) -> np.ndarray:
    """Cells ``(F, R)`` all of whose neighbours fare as they do: away from the border."""
    padded = np.pad(is_hit, 1, mode="edge")
    rows, columns = is_hit.shape
    around = [padded[i : i + rows, j : j + columns] for i in range(3) for j in range(3)]
    return np.all([other == is_hit for other in around], axis=0)


def distance_of(world: World, frame: int, place_m: np.ndarray) -> tuple[float, str]:
    """The nearest surface to a place, in m, and whose it is."""
    nearest = (np.inf, "")
    for actor in world.actors:
        inside = (place_m - actor.path.position_m[frame]) @ actor.path.road_R_body[frame]
        nearest = min(nearest, (float(distance_to_parts_m(actor.parts, inside[None])[0]), actor.name))
    return nearest
