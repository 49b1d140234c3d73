"""A drive in a simulated scene that follows the advice of the collision map, step by step, with true states."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from brute_force import distance_of, ways_m

from ttcvid.jobs.collision_map.true_hazards import level_axes, own_body_of, true_situation
from ttcvid.simulate import Scene, World, build_world
from ttcvid.studies.collision_map.evasion import Evasion, EvasionLimits, EvasionStatus, evade, needed_s

SUBSTEPS = 5
"""Steps of motion and of looking for a contact, between two advices."""


@dataclass(frozen=True)
class Drive:
    """How it went: when what was touched (infinite: nothing), the nearest anything came, when the first advice came."""

    contact_s: float
    touched: str
    nearest_m: float
    first_advice_s: float
    n_advices: int
    end_speed_m_s: float


def drive(scene: Scene, end_s: float, step_s: float, limits: EvasionLimits | None = None) -> Drive:
    """Drive as the scene does until the first advice; from then on keep the velocity but for what is advised.

    An advice is asked for every ``step_s`` and followed until the next one, within the limits of acceleration.
    """
    chosen = limits or EvasionLimits()
    start = build_world(scene, np.zeros(1))
    place, velocity = start.path.position_m[0], start.path.velocity_m_s[0]
    turn = np.radians(scene.own_motion.yaw_rate_deg_s)
    first, n_advices, nearest = np.inf, 0, np.inf
    for t in np.arange(0.0, end_s, step_s):
        world = build_world(scene, t + step_s * np.arange(SUBSTEPS + 1) / SUBSTEPS)
        if not np.isfinite(first):
            place, velocity = world.path.position_m[0], world.path.velocity_m_s[0]
        advice = evade(true_situation(_with_us(world, place, velocity), 0, own_body_of(world)), chosen)
        if advice.status in (EvasionStatus.advice, EvasionStatus.no_escape):
            first, n_advices = min(first, float(t)), n_advices + 1
        followed = np.isfinite(first)
        push = _acceleration(advice, velocity, world, chosen, step_s) if followed else np.zeros(3)
        for k in range(1, SUBSTEPS + 1):
            sub_s = step_s / SUBSTEPS
            if followed:
                mean = velocity + 0.5 * sub_s * push
                place = place + ways_m(mean[None], turn, np.array([sub_s]))[0, 0]
                velocity = _turned_left(velocity + sub_s * push, turn * sub_s)
                push = _turned_left(push, turn * sub_s)
            else:
                place = world.path.position_m[k]
            distance, name = distance_of(world, k, place)
            nearest = min(nearest, distance)
            if distance < scene.own_motion.radius_m:
                return Drive(
                    float(world.path.t_s[k]), name, distance, first, n_advices, float(np.linalg.norm(velocity))
                )
    return Drive(np.inf, "", nearest, first, n_advices, float(np.linalg.norm(velocity)))


def _with_us(world: World, place_m: np.ndarray, velocity_m_s: np.ndarray) -> World:
    """The world with us elsewhere, at its first time."""
    path = world.path
    places, velocities = path.position_m.copy(), path.velocity_m_s.copy()
    places[0], velocities[0] = place_m, velocity_m_s
    return replace(world, path=replace(path, position_m=places, velocity_m_s=velocities))


def _acceleration(
    advice: Evasion, velocity_m_s: np.ndarray, world: World, limits: EvasionLimits, step_s: float
) -> np.ndarray:
    """What we do until the next advice: both parts of the change take the same time, as fast as the limits allow."""
    forward, right = advice.forward_m_s, advice.right_m_s
    own_m_s = float(np.hypot(*velocity_m_s[:2]))
    speed_m_s, course_rad = np.hypot(own_m_s + forward, right), np.arctan2(right, own_m_s + forward)
    needs_s = max(float(needed_s(own_m_s, speed_m_s[None], course_rad[None], limits)[0]), step_s)
    level_R_road = level_axes(velocity_m_s, world.path.cam_R_road[0].T)
    return np.array([right, 0.0, forward]) / needs_s @ level_R_road


def _turned_left(vector: np.ndarray, angle_rad: float) -> np.ndarray:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1], vector[2]])
