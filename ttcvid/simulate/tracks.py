"""Point tracks with truth, without pictures: points of visible surfaces followed along their exact paths."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from ttcvid.geometry.camera.pinhole import pixels_from_rays, rays_from_pixels
from ttcvid.model import Bools, Floats, Ints
from ttcvid.simulate.casting import NOTHING, FaceStack, cast, face_stack, points_in_camera
from ttcvid.simulate.scene import Scene
from ttcvid.simulate.truth import TrueTimes, true_times
from ttcvid.simulate.world import STATIC_LABEL, World, build_world

HIDDEN_SHARE = 1e-6
"""A point is hidden where something lies in front of it by more than this share of its depth."""
OUTLIER_PX = 12.0
"""Largest displacement of an outlier, per axis."""


@dataclass(frozen=True)
class TrackOptions:
    """How tracks are made.

    ``n_tracks`` points are alive at a time, at least ``min_per_object`` of them on each visible object if room can
    be found; each observation has Gaussian noise of ``sigma_px`` per axis, and with probability
    ``outlier_fraction`` is displaced by up to 12 px; a track ends by chance with probability ``death_rate`` per
    frame, or when its point leaves the picture or is hidden. With ``births`` off no track starts after frame 0.
    """

    n_tracks: int = 400
    min_per_object: int = 15
    sigma_px: float = 0.2
    outlier_fraction: float = 0.0
    death_rate: float = 0.01
    births: bool = True


@dataclass(frozen=True)
class SimulatedTracks:
    """Observations of all tracks, sorted by (frame, track_id), each array with one row per observation.

    ``frame, t_s, track_id, object_id, is_outlier (N,)``; ``xy_px, true_xy_px (N, 2)`` distorted pixels;
    ``position_m, velocity_m_s (N, 3)`` P and V in the camera of the frame; ``times`` of that P and V.
    """

    frame: Ints
    t_s: Floats
    track_id: Ints
    object_id: Ints
    is_outlier: Bools
    xy_px: Floats
    true_xy_px: Floats
    position_m: Floats
    velocity_m_s: Floats
    times: TrueTimes


@dataclass(frozen=True)
class _Alive:
    """Points under way: number, surface they are on (actor index, or GROUND), place in its axes (N, 3)."""

    track_id: Ints
    actor: Ints
    place_m: Floats

    def keep(self, mask: Bools) -> _Alive:
        return _Alive(self.track_id[mask], self.actor[mask], self.place_m[mask])


def simulate_tracks(scene: Scene, options: TrackOptions | None = None, seed: int | None = None) -> SimulatedTracks:
    """Tracks of a scene; ``seed`` (default: the scene's) fixes noise, births and deaths, never the scene itself."""
    return tracks_of(build_world(scene), options, seed)


def tracks_of(world: World, options: TrackOptions | None = None, seed: int | None = None) -> SimulatedTracks:
    """Tracks of a world; ``seed`` as in `simulate_tracks`."""
    chosen = options or TrackOptions()
    alive = _Alive(np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 3)))
    next_id, rows = 0, list[dict[str, np.ndarray]]()
    for frame in range(world.n_frames):
        rng = np.random.default_rng([world.scene.seed if seed is None else seed, 6, frame])
        stack = face_stack(world, frame)
        alive = alive.keep(rng.random(len(alive.track_id)) >= chosen.death_rate)
        alive = alive.keep(_is_visible(world, stack, alive))
        if chosen.births or frame == 0:
            alive, next_id = _with_births(world, stack, alive, next_id, chosen, rng)
        rows.append(_observe(world, stack, frame, alive, chosen, rng))
    return _joined(rows)


def _is_visible(world: World, stack: FaceStack, alive: _Alive) -> Bools:
    """Whether points are inside the picture and nothing lies in front of them."""
    point = points_in_camera(stack, alive.actor, alive.place_m)
    xy = pixels_from_rays(world.camera, point)
    size = world.camera.image_size
    with np.errstate(invalid="ignore"):
        inside = np.all((xy >= 0) & (xy <= (size.width_px - 1, size.height_px - 1)), axis=1) & (point[:, 2] > 0)
    result: Bools = inside.copy()
    rays = point[inside] / point[inside, 2:]
    hit = cast(stack, rays)
    result[inside] = hit.depth_m >= point[inside, 2] * (1 - HIDDEN_SHARE)
    return result


def _with_births(
    world: World, stack: FaceStack, alive: _Alive, next_id: int, options: TrackOptions, rng: Generator
) -> tuple[_Alive, int]:
    """Fill up the points alive: first the objects that have few, then the whole picture at random."""
    size = np.array([world.camera.image_size.width_px - 1, world.camera.image_size.height_px - 1])
    for box in _boxes_of_poor_objects(world, stack, alive, options.min_per_object):
        actor, low, high = box
        wanted = options.min_per_object - int((alive.actor == actor).sum())
        low, high = np.maximum(low, 0), np.minimum(high, size)
        if np.all(high > low):
            xy = rng.uniform(low, high, (4 * wanted, 2))
            alive, next_id = _born(world, stack, alive, next_id, xy, (actor, wanted))
    missing = options.n_tracks - len(alive.track_id)
    if missing > 0:
        alive, next_id = _born(world, stack, alive, next_id, rng.uniform(0, size, (missing, 2)), None)
    return alive, next_id


def _boxes_of_poor_objects(
    world: World, stack: FaceStack, alive: _Alive, min_per_object: int
) -> list[tuple[int, Floats, Floats]]:
    """Actor index and the box in the picture of each object in front that has too few points."""
    boxes = []
    for index, actor in enumerate(world.actors):
        if actor.object_id == STATIC_LABEL or (alive.actor == index).sum() >= min_per_object:
            continue
        points = actor.corners_m @ stack.poses.cam_R_body[index].T + stack.poses.position_m[index]
        if np.all(points[:, 2] > 0.5):
            xy = pixels_from_rays(world.camera, points)
            boxes.append((index, xy.min(axis=0), xy.max(axis=0)))
    return boxes


def _born(
    world: World,
    stack: FaceStack,
    alive: _Alive,
    next_id: int,
    xy_px: Floats,
    only: tuple[int, int] | None,
) -> tuple[_Alive, int]:
    """Start tracks at the surfaces seen at pixels ``(N, 2)``; ``only`` (actor, count) takes just those of one actor."""
    hit = cast(stack, rays_from_pixels(world.camera, xy_px))
    taken = np.flatnonzero(hit.actor != NOTHING if only is None else hit.actor == only[0])
    taken = taken if only is None else taken[: only[1]]
    track_id = next_id + np.arange(len(taken))
    joined = _Alive(
        np.concatenate([alive.track_id, track_id]),
        np.concatenate([alive.actor, hit.actor[taken]]),
        np.concatenate([alive.place_m, hit.place_m[taken]]),
    )
    return joined, next_id + len(taken)


def _observe(
    world: World, stack: FaceStack, frame: int, alive: _Alive, options: TrackOptions, rng: Generator
) -> dict[str, np.ndarray]:
    """What `SimulatedTracks` has of one picture, its times left out."""
    poses = stack.poses.take(alive.actor)
    position = poses.point_of(alive.place_m)
    true_xy = pixels_from_rays(world.camera, position)
    n = len(position)
    is_outlier = rng.random(n) < options.outlier_fraction
    noise = options.sigma_px * rng.standard_normal((n, 2))
    noise[is_outlier] = rng.uniform(-OUTLIER_PX, OUTLIER_PX, (int(is_outlier.sum()), 2))
    return {
        "frame": np.full(n, frame),
        "t_s": np.full(n, world.path.t_s[frame]),
        "track_id": alive.track_id,
        "object_id": world.object_ids[alive.actor],
        "is_outlier": is_outlier,
        "xy_px": true_xy + noise,
        "true_xy_px": true_xy,
        "position_m": position,
        "velocity_m_s": poses.velocity_of(position),
    }


def _joined(rows: list[dict[str, np.ndarray]]) -> SimulatedTracks:
    """All frames in one."""
    arrays = {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}
    return SimulatedTracks(**arrays, times=true_times(arrays["position_m"], arrays["velocity_m_s"]))
