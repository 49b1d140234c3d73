"""A camera among static points and rigid movers: exact tracks, frame by frame, and the bodies that are found in them.

World: x to the right, y down, z ahead, in m; the camera is at the origin in frame 0 and looks along z.
"""

from dataclasses import dataclass, replace

import numpy as np
from relative_motion import CAMERA, FOCAL_PX, box_of_points, pixels

from ttcvid.config import BodiesConfig
from ttcvid.geometry.rotation import normalize, rotation_from_vector
from ttcvid.model import Platform, PointSet
from ttcvid.stages.egomotion.relative_pose import Egomotion
from ttcvid.stages.segmentation.body_views import body_views
from ttcvid.stages.segmentation.labels import BodyMemory, find_bodies
from ttcvid.stages.tracking.history import empty_history, extended, with_egomotion

DT_S, MAX_FRAMES = 0.1, 20
LINK_PX = 32.0
CAR_M = (4.0, 1.4, 1.8)
NOTHING_KNOWN = BodyMemory()


@dataclass(frozen=True)
class Thing:
    """Points (N, 3) at frame 0 that move, speed up and turn about the vertical through their centre; none: static.

    What `rides` is fixed to the camera: its points are those of the camera's frame at any time.
    """

    points: np.ndarray
    velocity_m_s: tuple = (0.0, 0.0, 0.0)
    acceleration_m_s2: tuple = (0.0, 0.0, 0.0)
    yaw_rad_s: float = 0.0
    frames: tuple = (0, 10**9)
    hidden: range = range(0)
    rides: bool = False

    def at(self, t_s):
        centre = self.points.mean(axis=0)
        heading = rotation_from_vector(np.array([0.0, self.yaw_rad_s, 0.0]) * t_s)
        steps = np.linspace(0.0, t_s, 50)
        turned = rotation_from_vector(steps[:, None] * np.array([0.0, self.yaw_rad_s, 0.0])) @ self.velocity_m_s
        moved = t_s * turned.mean(axis=0) + 0.5 * t_s**2 * np.array(self.acceleration_m_s2)
        return (self.points - centre) @ heading.T + centre + moved


@dataclass(frozen=True)
class Frame:
    """What was found in a frame, `truth` (N,) the number of each track's thing, 0 the static points."""

    t_s: float
    found: object
    memory: BodyMemory
    track_id: np.ndarray
    truth: np.ndarray

    @property
    def key(self):
        return self.found.key

    def keys_of(self, number):
        """Most frequent key of a thing's tracks, and the part of them that has it."""
        keys, counts = np.unique(self.key[self.truth == number], return_counts=True)
        return int(keys[counts.argmax()]), counts.max() / counts.sum()

    @property
    def mover_keys(self):
        return set(self.key.tolist()) - {0}

    @property
    def cluster_ids(self):
        movers = self.found.movers
        return dict(zip(movers.key.tolist(), movers.cluster_id.tolist(), strict=True))


def car(rng, centre_m, velocity_m_s, n=30, size_m=CAR_M, **options):
    return Thing(box_of_points(rng, n, centre_m, size_m), velocity_m_s, **options)


def static_points(rng, camera_m_s, n_frames, movers=(), n=260, depth_m=(10.0, 60.0)):
    """Points all over the last picture, without those that a mover hides in any frame."""
    z = 1.0 / rng.uniform(1.0 / depth_m[1], 1.0 / depth_m[0], n)
    size = CAMERA.image_size
    xy = rng.uniform(-0.5, 0.5, (n, 2)) * (size.width_px, size.height_px) / FOCAL_PX
    last_s = DT_S * (n_frames - 1)
    points = np.column_stack([xy * z[:, None], z]) + np.asarray(camera_m_s) * last_s
    for frame in range(n_frames):
        seen = pixels(points - np.asarray(camera_m_s) * frame * DT_S)
        for mover in movers:
            box = pixels(mover.at(frame * DT_S) - np.asarray(camera_m_s) * frame * DT_S)
            inside = np.all((seen > box.min(axis=0) - 4.0) & (seen < box.max(axis=0) + 4.0), axis=1)
            points, seen = points[~inside], seen[~inside]
    return Thing(points)


def world(rng, camera_m_s, n_frames, *movers, **options):
    return [static_points(rng, camera_m_s, n_frames, movers, **options), *movers]


def is_behind_another(position_m, xy_px, numbers):
    """Which points lie behind a thing and within the box around it in the picture: (N,); thing 0 hides nothing."""
    is_hidden = np.zeros(len(position_m), dtype=bool)
    for number in range(1, numbers.max() + 1):
        box, nearest_m = xy_px[numbers == number], position_m[numbers == number, 2].min()
        is_within = np.all((xy_px > box.min(axis=0)) & (xy_px < box.max(axis=0)), axis=1)
        is_hidden |= is_within & (numbers != number) & (position_m[:, 2] > nearest_m)
    return is_hidden


def bodies_of(
    things,
    n_frames,
    camera_m_s=(0.0, 0.0, 10.0),
    yaw_rad_s=0.0,
    sigma_px=0.1,
    seed=0,
    platform=Platform.vehicle,
    order=None,
    memory=NOTHING_KNOWN,
    stop_s=np.inf,
    opaque=False,
    shake_rad=0.0,
    common_error_px=0.0,
):
    """The bodies of each frame from the second on; own motion is known exactly.

    At each frame the camera is off its course by random turns of `shake_rad` about each axis. Until `stop_s` it brakes
    from its speed to rest. Things that are opaque hide what is behind them.
    `order` is a permutation of the track numbers: the same tracks with other identities, hence in another order.
    """
    rng, speed = np.random.default_rng(seed), np.linalg.norm(camera_m_s)
    on_course, shake = np.eye(3), np.random.default_rng(seed + 1).normal(scale=shake_rad, size=(n_frames, 3))
    history, world_to_cam, frames = empty_history(CAMERA, max(sigma_px, 0.05)), rotation_from_vector(shake[0]), []
    for frame in range(n_frames):
        t_s = frame * DT_S
        alive = [thing.frames[0] <= frame < thing.frames[1] and frame not in thing.hidden for thing in things]
        numbers = np.repeat(np.arange(len(things)), [len(t.points) for t in things])
        is_seen = np.repeat(alive, [len(t.points) for t in things])
        driven_s = min(t_s, stop_s) - 0.5 * min(t_s, stop_s) ** 2 / stop_s
        position = np.concatenate([thing.at(t_s) for thing in things]) - np.asarray(camera_m_s) * driven_s
        before = world_to_cam
        if frame:
            on_course = rotation_from_vector(np.array([0.0, yaw_rad_s * DT_S, 0.0])) @ on_course
            world_to_cam = rotation_from_vector(shake[frame]) @ on_course
        step = world_to_cam @ before.T
        position = position @ world_to_cam.T
        for number, thing in enumerate(things):
            if thing.rides:
                position[numbers == number] = thing.points
        is_seen &= position[:, 2] > 1.0
        xy_px = pixels(np.where(is_seen[:, None], position, (0.0, 0.0, 1.0)))
        if opaque:
            is_seen &= ~is_behind_another(position, xy_px, numbers)
        xy_px += sigma_px * rng.normal(size=xy_px.shape)
        names = np.arange(len(position)) if order is None else order
        shown = np.argsort(names)
        shown = shown[is_seen[shown]]
        rays = normalize(np.column_stack([(xy_px - (CAMERA.cx_px, CAMERA.cy_px)) / FOCAL_PX, np.ones(len(xy_px))]))
        points = PointSet(names[shown], xy_px[shown], common_error_px=common_error_px)
        history = extended(history, frame, t_s, points, rays[shown], MAX_FRAMES)
        if not frame:
            continue
        moves = speed > 0.0 and t_s < stop_s
        direction = world_to_cam @ (-np.asarray(camera_m_s) / speed) if moves else None
        history = with_egomotion(history, step, direction, 1e-5)
        cov = 1e-8 * np.eye(3)
        egomotion = Egomotion(step, cov, direction, None if direction is None else cov, np.zeros(len(shown)))
        every = np.ones(len(shown), dtype=bool)
        views = body_views(history, every, LINK_PX, can_translate=True)
        found, memory = find_bodies(history, views, egomotion, platform, every, memory, BodiesConfig())
        history = replace(history, cam_R_past=found.seen.scene.cam_R_past[0])
        frames.append(Frame(t_s, found, memory, names[shown], numbers[shown]))
    return frames
