"""Which surface a ray meets first, in double precision: the reference for tracks and tests, no textures involved.

Cut-outs (walkers, leaves) count as full rectangles here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.model import Floats, Ints
from ttcvid.simulate.world import Pose, World, poses_of

NOTHING = -2
GROUND = -1
"""Actor numbers of the sky and of the ground."""
RAYS_AT_ONCE = 256
"""Arrays of rays times faces stay in the processor's cache."""


@dataclass(frozen=True)
class FaceStack:
    """The faces that turn their outside to the camera of one picture and reach before it.

    ``corner_m, along_u, along_v, normal (F, 3)``, ``size_m (F, 2)``, ``actor (F,)``; ``ground_up`` (3,) and
    ``height_m`` describe the ground (None: there is none); ``poses`` are those of all actors and the ground.
    """

    corner_m: Floats
    along_u: Floats
    along_v: Floats
    normal: Floats
    size_m: Floats
    actor: Ints
    ground_up: Floats | None
    height_m: float
    poses: Pose


@dataclass(frozen=True)
class Hit:
    """What rays meet: ``depth_m (N,)`` (infinite: nothing), ``actor (N,)``, ``place_m (N, 3)`` in its own axes."""

    depth_m: Floats
    actor: Ints
    place_m: Floats


def face_stack(world: World, frame: int) -> FaceStack:
    """The faces of a world in the camera of one picture."""
    poses, faces = poses_of(world, frame), world.faces
    of_face = poses.take(faces.body)
    corner = of_face.point_of(faces.origin_m)
    along_u = np.einsum("fij,fj->fi", of_face.cam_R_body, faces.along_u)
    along_v = np.einsum("fij,fj->fi", of_face.cam_R_body, faces.along_v)
    normal = np.cross(along_u, along_v)
    farthest_m = corner[:, 2] + np.sum(np.maximum(faces.size_m * np.stack([along_u, along_v], 1)[:, :, 2], 0.0), axis=1)
    seen = np.flatnonzero((np.sum(normal * corner, axis=1) > 0) & (farthest_m > 0))
    return FaceStack(
        corner[seen],
        along_u[seen],
        along_v[seen],
        normal[seen],
        faces.size_m[seen],
        faces.body[seen],
        None if world.scene.ground.kind == "none" else world.path.cam_R_road[frame, :, 2],
        float(world.path.position_m[frame, 2]),
        poses,
    )


def cast(stack: FaceStack, rays: Floats) -> Hit:
    """The nearest surface along rays (x, y, 1) ``(N, 3)``, seen from outside."""
    blocks = [_nearest(stack, rays[start : start + RAYS_AT_ONCE]) for start in range(0, len(rays), RAYS_AT_ONCE)]
    depth = np.concatenate([np.empty(0), *(depth for depth, _ in blocks)])
    actor = np.concatenate([np.empty(0, np.int64), *(actor for _, actor in blocks)])
    place, is_hit = np.full((len(rays), 3), np.nan), actor != NOTHING
    place[is_hit] = stack.poses.take(actor[is_hit]).place_of(rays[is_hit] * depth[is_hit, None])
    return Hit(depth, actor, place)


def _nearest(stack: FaceStack, rays: Floats) -> tuple[Floats, Ints]:
    """Depth and actor ``(N,)`` of the nearest surface along rays ``(N, 3)``; infinite depth: nothing."""
    corner, along_u, along_v = stack.corner_m, stack.along_u, stack.along_v
    inverse = rays @ stack.normal.T / np.sum(stack.normal * corner, axis=1)
    # A column for the ground, then one for each face.
    depth = np.full((len(rays), 1 + len(corner)), np.inf)
    np.divide(1.0, inverse, out=depth[:, 1:], where=inverse > 0)
    if stack.ground_up is not None:
        towards = rays @ stack.ground_up
        np.divide(-stack.height_m, towards, out=depth[:, 0], where=towards < 0)
    at = np.where(inverse > 0, depth[:, 1:], 0.0)
    u = at * (rays @ along_u.T) - np.sum(corner * along_u, axis=1)
    v = at * (rays @ along_v.T) - np.sum(corner * along_v, axis=1)
    width_m, height_m = stack.size_m.T
    is_inside = (u >= 0) & (u <= width_m) & (v >= 0) & (v <= height_m)
    depth[:, 1:][~is_inside] = np.inf
    first = depth.argmin(axis=1)
    nearest = depth[np.arange(len(rays)), first]
    actors = np.concatenate([[GROUND], stack.actor])
    return nearest, np.where(np.isfinite(nearest), actors[first], NOTHING)


def points_in_camera(stack: FaceStack, actor: Ints, place_m: Floats) -> Floats:
    """Points ``(N, 3)`` given in the axes of their actors (GROUND: the road frame), in the camera of one picture."""
    return stack.poses.take(actor).point_of(place_m)
