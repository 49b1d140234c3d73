"""A scene made ready: camera and bodies with their places at every picture."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from ttcvid.model import Camera, Floats, Ints
from ttcvid.simulate.poses import BodyPath, CameraPath, body_motion, body_path, camera_path
from ttcvid.simulate.scene import Body, Scene, camera_of
from ttcvid.simulate.shapes import Face, FaceArrays, Part, face_arrays, faces_of, parts_of

STATIC_LABEL = 0
SKY_LABEL = 65535


@dataclass(frozen=True)
class Actor:
    """A body with its shape and its path; ``object_id`` is ``STATIC_LABEL`` where it belongs to the static scene."""

    name: str
    body: Body
    object_id: int
    is_moving: bool
    parts: list[Part]
    faces: list[Face]
    path: BodyPath

    @cached_property
    def corners_m(self) -> Floats:
        """The corners ``(4 F, 3)`` of its F faces, in its own axes."""
        return np.concatenate([face.corners_m for face in self.faces])


@dataclass(frozen=True)
class World:
    """Camera and actors of a scene at N times."""

    scene: Scene
    camera: Camera
    path: CameraPath
    actors: tuple[Actor, ...]

    @property
    def n_frames(self) -> int:
        """Number of pictures."""
        return len(self.path.t_s)

    @cached_property
    def object_ids(self) -> Ints:
        """Those of the A actors and, last, the ground: ``(A + 1,)``."""
        return np.array([*(actor.object_id for actor in self.actors), STATIC_LABEL], np.int64)

    @cached_property
    def faces(self) -> FaceArrays:
        """The faces of all actors."""
        return face_arrays([actor.faces for actor in self.actors])

    @cached_property
    def body_paths(self) -> BodyPath:
        """Those of the A actors and, last, the ground, stacked: ``road_R_body (A + 1, N, 3, 3)``, the others alike."""
        at_rest = np.zeros((self.n_frames, 3))
        ground = BodyPath(np.tile(np.eye(3), (self.n_frames, 1, 1)), at_rest, at_rest, at_rest)
        paths = [*(actor.path for actor in self.actors), ground]
        return BodyPath(*(np.stack([getattr(path, field.name) for path in paths]) for field in fields(BodyPath)))


@dataclass(frozen=True)
class Pose:
    """An actor in the camera of one picture: ``cam_R_body (3, 3)``, position and relative velocity ``(3,)``.

    ``turn_rad_s`` (3,) is the body's own rate of turning, in the camera's axes. Several are stacked along a first axis.
    """

    cam_R_body: Floats
    position_m: Floats
    velocity_m_s: Floats
    turn_rad_s: Floats

    def take(self, index: Ints) -> Pose:
        """Of stacked poses those of an index array."""
        return Pose(*(getattr(self, field.name)[index] for field in fields(Pose)))

    def point_of(self, place_m: Floats) -> Floats:
        """Points ``(N, 3)`` in the camera, from their places in the axes of their bodies, of N stacked poses."""
        return np.asarray(np.einsum("nij,nj->ni", self.cam_R_body, place_m) + self.position_m)

    def place_of(self, point_m: Floats) -> Floats:
        """The inverse of `point_of`."""
        return np.asarray(np.einsum("nji,nj->ni", self.cam_R_body, point_m - self.position_m))

    def velocity_of(self, point_m: Floats) -> Floats:
        """Relative velocity ``(N, 3)`` of points of the bodies at ``point_m (N, 3)`` in the camera."""
        return self.velocity_m_s + np.cross(self.turn_rad_s, point_m - self.position_m)


def build_world(scene: Scene, t_s: Floats | None = None) -> World:
    """A scene at its pictures' times, or at times ``(N,)`` of the caller's choice."""
    times = scene.camera.frame_times_s() if t_s is None else t_s
    actors: list[Actor] = []
    n_objects = 0
    for name, body in _copies(scene):
        n_objects += is_object(body)
        parts = parts_of(body)
        object_id = n_objects if is_object(body) else STATIC_LABEL
        is_moving = body_motion(body).is_moving
        actors.append(Actor(name, body, object_id, is_moving, parts, faces_of(parts), body_path(body, times)))
    return World(scene, camera_of(scene), camera_path(scene, times), tuple(actors))


def is_object(body: Body) -> bool:
    """Whether a body is an object of the truth; else it belongs to the static scene."""
    return body_motion(body).is_moving if body.is_object is None else body.is_object


def pose_of(world: World, actor: Actor, frame: int) -> Pose:
    """An actor as the camera of picture ``frame`` sees it: V = v_body - v_camera, no rotation of the camera in it."""
    cam_R_road = world.path.cam_R_road[frame]
    position = actor.path.position_m[frame] - world.path.position_m[frame]
    velocity = actor.path.velocity_m_s[frame] - world.path.velocity_m_s[frame]
    turn = actor.path.turn_rad_s[frame]
    return Pose(
        cam_R_road @ actor.path.road_R_body[frame], cam_R_road @ position, cam_R_road @ velocity, cam_R_road @ turn
    )


def poses_of(world: World, frame: int) -> Pose:
    """As `pose_of`, of all A actors and, last (index -1), of the ground: ``cam_R_body (A + 1, 3, 3)``."""
    bodies, path = world.body_paths, world.path
    road_R_cam = path.cam_R_road[frame].T
    return Pose(
        path.cam_R_road[frame] @ bodies.road_R_body[:, frame],
        (bodies.position_m[:, frame] - path.position_m[frame]) @ road_R_cam,
        (bodies.velocity_m_s[:, frame] - path.velocity_m_s[frame]) @ road_R_cam,
        bodies.turn_rad_s[:, frame] @ road_R_cam,
    )


def _copies(scene: Scene) -> list[tuple[str, Body]]:
    """Every body by name, repeated ones numbered from 1."""
    copies: list[tuple[str, Body]] = []
    for body in scene.bodies:
        if body.repeat is None:
            copies.append((body.name, body))
            continue
        for k in range(body.repeat.count):
            place = np.asarray(body.at_m) + k * np.asarray(body.repeat.step_m)
            copies.append((f"{body.name} {k + 1}", body.model_copy(update={"at_m": tuple(place.tolist())})))
    return copies
