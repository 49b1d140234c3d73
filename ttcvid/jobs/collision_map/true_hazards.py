"""The situation of a moment from a simulated scene's own truth: every body's true boxes, places and velocities."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ttcvid.config import CollisionMapConfig
from ttcvid.errors import UsageError
from ttcvid.jobs.collision_map.moments import Clip, Moment, own_body
from ttcvid.model import Floats
from ttcvid.simulate import World, build_world, load_scene
from ttcvid.simulate.motion import turn_rate_at
from ttcvid.simulate.poses import body_motion, own_motion
from ttcvid.simulate.world import Actor
from ttcvid.studies.collision_map.hazards import Hazards, OwnBody, Situation, joined, one_object

_RESTING_M_S = 1e-6
"""Below this horizontal speed, ahead is where the camera looks."""


def scene_clip(path: Path, config: CollisionMapConfig) -> Clip:
    """The frames of a scene file; UsageError where it is not valid or an option says what a scene knows by itself."""
    for name in ("ego_speed", "camera_height_m", "object_width_m"):
        if getattr(config, name) is not None:
            raise UsageError(f"--{name.replace('_', '-')}: {path} is a scene, which knows it by itself: leave it out")
    scene = load_scene(path)
    world = build_world(scene)
    own = own_body(config, own_body_of(world))
    note = f"From the true places, sizes and motions of scene {scene.name}."

    def moment(n: int) -> Moment:
        return Moment(true_situation(world, n, own), notes=(note,))

    return Clip(scene.name, np.arange(world.n_frames), world.path.t_s, moment, (path,))


def own_body_of(world: World) -> OwnBody:
    """The scene's own outline: round, with the radius that decides what the scene calls a collision."""
    size_m = 2.0 * world.scene.own_motion.radius_m
    return OwnBody(size_m, size_m, size_m, is_round=True)


def true_situation(world: World, frame: int, own: OwnBody) -> Situation:
    """What a scene holds at one of its pictures, moving bodies and static ones alike, known exactly."""
    velocity = world.path.velocity_m_s[frame]
    level_R_road = level_axes(velocity, world.path.cam_R_road[frame].T)
    hazards = joined([_body_hazards(world, actor, frame, level_R_road) for actor in world.actors])
    # Yaw rates of a scene count to the left.
    turn_rad_s = float(turn_rate_at(own_motion(world.scene), world.path.t_s[frame : frame + 1])[0])
    return Situation(hazards, own, level_R_road @ velocity, -turn_rad_s)


def level_axes(own_velocity_m_s: Floats, road_R_cam: Floats) -> Floats:
    """``level_R_road (3, 3)``: right, down and ahead, where ahead is the direction of travel over the ground."""
    ahead = own_velocity_m_s if np.hypot(*own_velocity_m_s[:2]) > _RESTING_M_S else road_R_cam[:, 2]
    ahead = np.array([ahead[0], ahead[1], 0.0]) / np.hypot(ahead[0], ahead[1])
    down = np.array([0.0, 0.0, -1.0])
    return np.stack([np.cross(down, ahead), down, ahead])


def _body_hazards(world: World, actor: Actor, frame: int, level_R_road: Floats) -> Hazards:
    """The parts of a body, each as the upright box around it that is turned as the body is."""
    road_R_body = actor.path.road_R_body[frame]
    nose = level_R_road @ road_R_body[:, 0]
    yaw = float(np.arctan2(nose[0], nose[2]))
    c, s = np.cos(yaw), np.sin(yaw)
    box_R_level = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
    box_R_body = box_R_level @ level_R_road @ road_R_body
    low = np.array([part.low_m for part in actor.parts])
    high = np.array([part.high_m for part in actor.parts])
    offset = 0.5 * (low + high) @ road_R_body.T
    turn = actor.path.turn_rad_s[frame]
    motion, t_s = body_motion(actor.body), world.path.t_s[frame]
    is_pushed = motion.acceleration_from_s <= t_s < motion.acceleration_until_s
    box = one_object(
        actor.name,
        actor.object_id,
        (actor.path.position_m[frame] + offset - world.path.position_m[frame]) @ level_R_road.T,
        (actor.path.velocity_m_s[frame] + np.cross(turn, offset) - world.path.velocity_m_s[frame]) @ level_R_road.T,
        0.5 * (high - low) @ np.abs(box_R_body).T,
        yaw,
    )
    acceleration = np.full(len(box), motion.acceleration_m_s2 if is_pushed else 0.0)
    return replace(box, turn_rad_s=np.full(len(box), -turn[2]), acceleration_m_s2=acceleration)
