"""Which surface a ray meets first, in double precision: the reference for tracks and tests, no textures involved.

Cut-outs (walkers, leaves) count as full rectangles here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.model import Floats, Ints
from ttcvid.simulate.world import World, pose_of

NOTHING = -2
GROUND = -1
"""Actor numbers of the sky and of the ground."""


@dataclass(frozen=True)
class FaceStack:
    """All faces in the camera of one picture: ``corner_m, along_u, along_v, normal (F, 3)``, ``size_m (F, 2)``.

    ``actor (F,)``; ``ground_up`` (3,) and ``height_m`` describe the ground (None: there is none); ``to_body`` turns
    a point in the camera into the axes of what it lies on.
    """

    corner_m: Floats
    along_u: Floats
    along_v: Floats
    normal: Floats
    size_m: Floats
    actor: Ints
    ground_up: Floats | None
    height_m: float
    to_body: dict[int, tuple[Floats, Floats]]


@dataclass(frozen=True)
class Hit:
    """What rays meet: ``depth_m (N,)`` (infinite: nothing), ``actor (N,)``, ``place_m (N, 3)`` in its own axes."""

    depth_m: Floats
    actor: Ints
    place_m: Floats


def face_stack(world: World, frame: int) -> FaceStack:
    """The faces of a world in the camera of one picture."""
    corner, along_u, along_v, size, numbers = [], [], [], [], []
    cam_R_road = world.path.cam_R_road[frame]
    to_body = {GROUND: (cam_R_road, -cam_R_road @ world.path.position_m[frame])}
    for index, actor in enumerate(world.actors):
        pose = pose_of(world, actor, frame)
        to_body[index] = (pose.cam_R_body, pose.position_m)
        for face in actor.faces:
            corner.append(pose.cam_R_body @ face.origin_m + pose.position_m)
            along_u.append(pose.cam_R_body @ face.along_u)
            along_v.append(pose.cam_R_body @ face.along_v)
            size.append(face.size_m)
            numbers.append(index)
    u, v = np.array(along_u).reshape(-1, 3), np.array(along_v).reshape(-1, 3)
    return FaceStack(
        np.array(corner).reshape(-1, 3),
        u,
        v,
        np.cross(u, v),
        np.array(size).reshape(-1, 2),
        np.array(numbers, np.int64),
        None if world.scene.ground.kind == "none" else cam_R_road[:, 2],
        float(world.path.position_m[frame, 2]),
        to_body,
    )


def cast(stack: FaceStack, rays: Floats) -> Hit:
    """The nearest surface along rays (x, y, 1) ``(N, 3)``, seen from outside."""
    depth = np.full(len(rays), np.inf)
    actor = np.full(len(rays), NOTHING)
    if stack.ground_up is not None:
        towards = rays @ stack.ground_up
        below = towards < 0
        depth[below] = -stack.height_m / towards[below]
        actor[below] = GROUND
    distance = np.sum(stack.normal * stack.corner_m, axis=1)
    for face in np.flatnonzero(distance > 0):
        inverse = rays @ stack.normal[face] / distance[face]
        at = np.where(inverse > 0, 1 / np.where(inverse > 0, inverse, 1.0), np.inf)
        nearer = np.flatnonzero(at < depth)
        offset = rays[nearer] * at[nearer, None] - stack.corner_m[face]
        u, v = offset @ stack.along_u[face], offset @ stack.along_v[face]
        inside = (u >= 0) & (u <= stack.size_m[face, 0]) & (v >= 0) & (v <= stack.size_m[face, 1])
        depth[nearer[inside]] = at[nearer[inside]]
        actor[nearer[inside]] = stack.actor[face]
    place = np.full((len(rays), 3), np.nan)
    for index in np.unique(actor[actor != NOTHING]):
        cam_R_body, origin = stack.to_body[int(index)]
        on_it = actor == index
        place[on_it] = (rays[on_it] * depth[on_it, None] - origin) @ cam_R_body
    return Hit(depth, actor, place)


def points_in_camera(world: World, frame: int, actor: Ints, place_m: Floats) -> Floats:
    """Points ``(N, 3)`` given in the axes of their actors (GROUND: the road frame), in the camera of one picture."""
    cam_R_road = world.path.cam_R_road[frame]
    points: Floats = (place_m - world.path.position_m[frame]) @ cam_R_road.T
    for index in np.unique(actor[actor != GROUND]):
        pose = pose_of(world, world.actors[index], frame)
        points[actor == index] = place_m[actor == index] @ pose.cam_R_body.T + pose.position_m
    return points
