"""The static scene as obstacles: points seen now, and those seen before that we have not left behind."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ttcvid.model import SCENE_CLUSTER, Bools, Floats, Ints
from ttcvid.studies.contacts import AHEAD, DOWN, RIGHT
from ttcvid.studies.hazards import Hazards, joined, one_object, turned_right

SCENE_NAME = "static scene"
_BEHIND_M, _FAR_M = 12.0, 120.0
"""What lies farther behind us, or farther away, is forgotten."""
_CUBE_M, _HALF_M = 1.0, 0.4
"""Of the points in a cube of this side the best known one is kept, as a box that covers most of it."""
_MIN_FRAMES = 4
"""Less often seen points are not believed: those of moving things wander through the cubes."""
_OVER_ROAD_M, _OVERHEAD_M, _ROAD_SIGMAS = 0.5, 4.0, 3.0
"""Points this much over the road, and by so many sigmas, are obstacles, which reach down to it; what is higher over the
camera than the second is a bridge."""
_PLACE_FLOOR_M = 0.1
"""Error of a place that its interval does not know."""


@dataclass(frozen=True)
class StaticPoints:
    """Points at rest, in level axes.

    ``place_m (M, 3)`` from us, ``spread_m (M, 3)`` one standard deviation along the ray on which it was seen,
    ``n_frames (M,)`` in how many frames something was seen there.
    """

    place_m: Floats
    spread_m: Floats
    n_frames: Ints

    def take(self, chosen: Bools | Ints) -> StaticPoints:
        """Some of them."""
        return StaticPoints(self.place_m[chosen], self.spread_m[chosen], self.n_frames[chosen])


def no_points() -> StaticPoints:
    """Nothing seen yet."""
    return StaticPoints(np.empty((0, 3)), np.empty((0, 3)), np.empty(0, np.int64))


def remembered(before: StaticPoints, seen: StaticPoints, moved_m: Floats, turned_rad: float) -> StaticPoints:
    """What is known after a frame: the points before, carried along, and those seen now; the best of each cubic metre.

    ``moved_m`` (3,) is how far we have come in the former level axes, ``turned_rad`` how far we have turned to the
    right.
    """
    carried = StaticPoints(
        turned_right(before.place_m - moved_m, -turned_rad), turned_right(before.spread_m, -turned_rad), before.n_frames
    )
    old, new = _best_of_each_cube(carried), _best_of_each_cube(seen)
    new = replace(new, n_frames=np.ones(len(new.n_frames), np.int64))
    both = StaticPoints(*(np.concatenate(pair) for pair in zip(_arrays(old), _arrays(new), strict=True)))
    distance = np.hypot(both.place_m[:, RIGHT], both.place_m[:, AHEAD])
    return _best_of_each_cube(both.take((both.place_m[:, AHEAD] > -_BEHIND_M) & (distance < _FAR_M)))


def _arrays(points: StaticPoints) -> tuple[np.ndarray, ...]:
    return points.place_m, points.spread_m, points.n_frames


def _best_of_each_cube(points: StaticPoints) -> StaticPoints:
    """The best known point of each cubic metre; it has been seen in as many frames as all there together."""
    order = np.argsort(np.linalg.norm(points.spread_m, axis=1), kind="stable")
    cubes = np.floor(points.place_m[order] / _CUBE_M).astype(np.int64)
    _, first, group = np.unique(cubes, axis=0, return_index=True, return_inverse=True)
    best = points.take(order[first])
    return replace(best, n_frames=np.bincount(group.ravel(), points.n_frames[order], len(first)).astype(np.int64))


def obstacles(points: StaticPoints, own_velocity_m_s: Floats, height_m: float | None) -> Hazards:
    """Points as boxes of one object, the static scene; over a road ``height_m`` under the camera they stand on it."""
    place, half_down = points.place_m.copy(), np.zeros(len(points.place_m))
    chosen = points.n_frames >= min(_MIN_FRAMES, int(points.n_frames.max(initial=0)))
    if height_m is not None:
        # A point of the road at a wrong distance lies off the road by the same share.
        sigma = np.linalg.norm(points.spread_m, axis=1) / np.maximum(np.linalg.norm(place, axis=1), _PLACE_FLOOR_M)
        over_m = height_m - place[:, DOWN]
        chosen &= (over_m > _OVER_ROAD_M) & (over_m > _ROAD_SIGMAS * sigma * height_m)
        chosen &= place[:, DOWN] > -_OVERHEAD_M
        half_down = 0.5 * over_m
        place[:, DOWN] += half_down
    if not chosen.any():
        return joined([])
    n = int(chosen.sum())
    spread = points.spread_m[chosen]
    covariance = np.zeros((n, 6, 6))
    covariance[:, :3, :3] = spread[:, :, None] * spread[:, None, :] + _PLACE_FLOOR_M**2 * np.eye(3)
    half = np.column_stack([np.full(n, _HALF_M), half_down[chosen], np.full(n, _HALF_M)])
    velocity = np.tile(-own_velocity_m_s, (n, 1))
    return one_object(SCENE_NAME, SCENE_CLUSTER, place[chosen], velocity, half, covariance=covariance)
