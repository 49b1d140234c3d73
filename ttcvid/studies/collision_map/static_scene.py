"""The static scene as obstacles: points seen now, and those seen before that we have not left behind."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.spatial import cKDTree

from ttcvid.model import SCENE_CLUSTER, Bools, Floats, Ints
from ttcvid.studies.collision_map.contacts import AHEAD, DOWN, RIGHT
from ttcvid.studies.collision_map.hazards import Hazards, OwnBody, joined, one_object, turned_right

SCENE_NAME = "static scene"
_BEHIND_M, _FAR_M = 12.0, 120.0
"""What lies farther behind us, or farther away, is forgotten."""
_CUBE_M, _HALF_M = 1.0, 0.1
"""Of the points in a cube of this side the best known one is kept, as a thin post: we do not fit between two."""
BORDER_SHARE = 0.1
"""What we would only graze, by less than this share of our own width, is no obstacle: the line beside our lane, a
kerb. Courses are not known better than that."""
_MIN_FRAMES, _MIN_AGE_S, _AGREES_SIGMAS = 4, 0.4, 3.0
"""A track is believed to be at rest where it has stood at one place, to so many sigmas, for so long and so often: that
of a moving object wanders, for it is taken to be nearer or farther than it is."""
OBSTACLE_SIGMA = 0.07
"""Relative error of distance up to which a point at rest is an obstacle. What is known worse is far off, or may be an
oncoming car, which looks like a nearer object at rest."""
_LEAST_POINTS = 3
"""So many points within the side of a cube, seen from above, make an obstacle."""
_UNSEEN_S = 0.5
"""What ought to be seen, and has not been for so long, is not there."""
_OVER_ROAD_M, _ROAD_SIGMAS, _LEVEL_RAD = 0.5, 3.0, 0.005
"""Points this much over the road, and by so many sigmas, are obstacles, which reach down to it. Of their heights the
second part of the error is that of the level: own direction and horizon are known to about 0.3 deg."""
_OVER_US_M = 1.0
"""Points higher than this over our own outline hang over the road: bridges, signs, trees."""
_PLACE_FLOOR_M = 0.1
"""Error of a place that its interval does not know."""


@dataclass(frozen=True)
class StaticPoints:
    """Where M tracks of the static scene are, in level axes.

    ``track_id (M,)`` ascending; ``place_m (M, 3)`` from us, ``spread_m (M, 3)`` one standard deviation along the ray on
    which it was seen; ``n_frames (M,)`` and ``age_s (M,)`` how often and since when it has been seen at that place, and
    ``unseen_s (M,)`` for how long it has not been seen.
    """

    track_id: Ints
    place_m: Floats
    spread_m: Floats
    n_frames: Ints
    age_s: Floats
    unseen_s: Floats

    def take(self, chosen: Bools | Ints) -> StaticPoints:
        """Some of them."""
        return StaticPoints(*(values[chosen] for values in _arrays(self)))


def seen_now(track_id: Ints, place_m: Floats, spread_m: Floats) -> StaticPoints:
    """Points ``(M, 3)`` that are seen for the first time."""
    n, order = len(track_id), np.argsort(track_id)
    return StaticPoints(
        track_id[order], place_m[order], spread_m[order], np.ones(n, np.int64), np.zeros(n), np.zeros(n)
    )


def no_points() -> StaticPoints:
    """Nothing seen yet."""
    return seen_now(np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3)))


def carried(before: StaticPoints, moved_m: Floats, turned_rad: float, gap_s: float) -> StaticPoints:
    """The points where they are from a later place of ours.

    ``moved_m`` (3,) is how far we have come in the former level axes, ``turned_rad`` how far we have turned to the
    right, in ``gap_s``.
    """
    return StaticPoints(
        before.track_id,
        turned_right(before.place_m - moved_m, -turned_rad),
        turned_right(before.spread_m, -turned_rad),
        before.n_frames,
        before.age_s + gap_s,
        before.unseen_s + gap_s,
    )


def remembered(before: StaticPoints, seen: StaticPoints, is_in_view: Callable[[Floats], Bools]) -> StaticPoints:
    """What is known after a frame: the points before, carried along, and those seen now, which stand for their tracks.

    Forgotten is what we have left behind, and what has not been seen for a while though its place is in view.
    ``is_in_view`` says of positions ``(M, 3)`` whether they are.
    """
    _, old, new = np.intersect1d(before.track_id, seen.track_id, assume_unique=True, return_indices=True)
    off_m = np.linalg.norm(seen.place_m[new] - before.place_m[old], axis=1)
    spread_m = np.hypot(np.linalg.norm(seen.spread_m[new], axis=1), np.linalg.norm(before.spread_m[old], axis=1))
    agrees = off_m <= _AGREES_SIGMAS * np.hypot(spread_m, _PLACE_FLOOR_M)
    n_frames, age_s = seen.n_frames.copy(), seen.age_s.copy()
    n_frames[new] += np.where(agrees, before.n_frames[old], 0)
    age_s[new] = np.where(agrees, before.age_s[old], 0.0)
    is_gone = np.ones(len(before.track_id), bool)
    is_gone[old] = False
    parts = before.take(is_gone), replace(seen, n_frames=n_frames, age_s=age_s)
    known = StaticPoints(*(np.concatenate(pair) for pair in zip(*map(_arrays, parts), strict=True)))
    distance = np.hypot(known.place_m[:, RIGHT], known.place_m[:, AHEAD])
    is_near = (known.place_m[:, AHEAD] > -_BEHIND_M) & (distance < _FAR_M)
    known = known.take(is_near & ~((known.unseen_s > _UNSEEN_S) & is_in_view(known.place_m)))
    return known.take(np.argsort(known.track_id))


def _arrays(points: StaticPoints) -> tuple[np.ndarray, ...]:
    return tuple(getattr(points, field.name) for field in fields(StaticPoints))


def _believed(points: StaticPoints) -> StaticPoints:
    """The points that have stood still for long enough, are known well enough, and do not stand alone.

    One track in a hundred follows nothing, or has the label of another thing: as of an object, three have to agree.
    """
    sigma = np.linalg.norm(points.spread_m, axis=1) / np.maximum(np.linalg.norm(points.place_m, axis=1), _PLACE_FLOOR_M)
    is_steady = (points.n_frames >= _MIN_FRAMES) & (points.age_s >= _MIN_AGE_S) & (sigma < OBSTACLE_SIGMA)
    points = points.take(is_steady)
    place_m = points.place_m[:, [RIGHT, AHEAD]]
    tree = cKDTree(place_m)
    return points.take(tree.query_ball_point(place_m, _CUBE_M, return_length=True) >= _LEAST_POINTS)


def _best_of_each_cube(points: StaticPoints) -> StaticPoints:
    """The best known point of each cubic metre."""
    order = np.argsort(np.linalg.norm(points.spread_m, axis=1), kind="stable")
    cubes = np.floor(points.place_m[order] / _CUBE_M).astype(np.int64)
    _, first = np.unique(cubes, axis=0, return_index=True)
    return points.take(order[first])


def obstacles(points: StaticPoints, own: OwnBody, own_velocity_m_s: Floats, height_m: float | None) -> Hazards:
    """Points as thin posts of one object, the static scene; over a road ``height_m`` under the camera they stand on it.

    What lies inside our own outline is none: we would have hit it. Without a road, a point is as high as it is thick.
    """
    points = _best_of_each_cube(_believed(points))
    place, half_down = points.place_m.copy(), np.full(len(points.place_m), _HALF_M)
    if height_m is None:
        chosen = (np.abs(place - own.middle_m) >= own.half_m).any(axis=1)
    else:
        # A point of the road at a wrong distance lies off the road by the same share.
        range_m = np.maximum(np.linalg.norm(place, axis=1), _PLACE_FLOOR_M)
        sigma_m = np.hypot(np.linalg.norm(points.spread_m, axis=1) / range_m * height_m, _LEVEL_RAD * range_m)
        over_m = height_m - place[:, DOWN]
        chosen = (over_m > _OVER_ROAD_M) & (over_m > _ROAD_SIGMAS * sigma_m) & (over_m < own.height_m + _OVER_US_M)
        chosen &= (np.abs(place) >= own.half_m)[:, [RIGHT, AHEAD]].any(axis=1)
        half_down = 0.5 * over_m
        place[:, DOWN] += half_down
    if not chosen.any():
        return joined([])
    n = int(chosen.sum())
    spread = points.spread_m[chosen]
    covariance = np.zeros((n, 6, 6))
    covariance[:, :3, :3] = spread[:, :, None] * spread[:, None, :] + _PLACE_FLOOR_M**2 * np.eye(3)
    # A post with less than no width is hit only by what reaches beyond it.
    half = np.column_stack([np.full(n, -BORDER_SHARE * own.width_m), half_down[chosen], np.full(n, _HALF_M)])
    velocity = np.tile(-own_velocity_m_s, (n, 1))
    return one_object(SCENE_NAME, SCENE_CLUSTER, place[chosen], velocity, half, covariance=covariance)
