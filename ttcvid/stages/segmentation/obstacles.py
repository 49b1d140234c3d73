"""What stands in our own path: upright surfaces of the scene that our way leads through.

A stopped car ahead moves with the scene, and so does, to all appearance, what comes along our own direction (an
aircraft head-on looks like a static one that is nearer): for safety it is the same, it closes. Such a thing is an
object that shares the scene's motion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ttcvid.config import BodiesConfig
from ttcvid.geometry.along_bend import BEND_ENDS, share_of_bend
from ttcvid.geometry.estimation.rigid_motion import PathFit
from ttcvid.geometry.medians import median
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.segmentation.surface_memory import Obstacle, remembered, tracks_of
from ttcvid.stages.tracking.neighbours import connected_parts, linked_pairs

REACHED_WITHIN_S = 6.0
"""What we reach later than this is no obstacle yet, s: half as long again as a warning looks ahead."""
# A track counts from so many views on, with a rate known to this part.
_LEAST_VIEWS, _KNOWN_PART = 4, 0.2
# Tracks of one surface have rates within this part of its median (natural logarithm), and two sigmas of their own.
_ONE_SURFACE, _SURFACE_SIGMAS = 0.12, 2.0
# A surface that continues in nearer tracks beside it, more than so many and more than this part of its own, is a
# slope or a wall along our way.
_LEAST_GOES_ON, _GOES_ON = 2.0, 0.25
# Without a road, tracks of one surface may lie this many times as far apart as those of a mover (wing tips and nose
# of an aircraft).
_LINKS = 2.0
# On a road they are at most this many camera heights apart.
_BESIDE = 1.5
# The box of the tracks may miss the aim by `_OFF_LINK` link lengths, since tracks do not reach the rim; by `_KEPT`
# times that for a known obstacle.
_OFF_LINK, _KEPT = 0.33, 1.5
# Minimum number of tracks of an obstacle. Fewer than for a new mover, since its position is known.
_LEAST_TRACKS = 4
# Surfaces are searched around tracks within this angle (tangent) of our heading, and followed up to the second one;
# at most so many.
_LOOK, _FOLLOWED, _MOST_SURFACES = 0.1, 0.5, 6
# Our turn rate is taken from views over at least this time, s.
_LEAST_TURN_S = 0.3
# What stands on the road reaches this part of the camera height below the camera; otherwise it is suspended.
_BELOW_CAMERA = 0.15
# Heights above the road, in camera heights: what ends below the first is driven over, what begins above the second is
# driven under; so many tracks of an object lie above the first.
_LEAST_HEIGHT, _MOST_HEIGHT, _LEAST_STANDING = 0.2, 1.1, 2
# A road is no plane, and its horizon is not known exactly: a point surely stands if it also would with the horizon this
# tangent higher, as where the grade changes by 1 % over 30 m.
_MOST_RISE = 0.008
# Two tracks of what stands on the road were once below this height. A car far ahead on a bend that moves nearly as we
# do looks near by its small sideways motion, and then seems to float at the height of the camera.
_MOST_FOOT = 0.5
_TINY_HZ = 1e-9


@dataclass(frozen=True)
class OwnPath:
    """Where we go: ``aim (2,)`` the point of the plane z = 1 that we headed for ``age_s`` ago, ``turn_hz`` how fast it
    moves to the right.

    ``speed`` is the present one in units of the rates, ``ahead`` the part of it along z.
    """

    aim: Floats
    turn_hz: float
    speed: float
    ahead: float
    age_s: float

    def reached_s(self, rate_hz: Floats) -> Floats:
        """Time until the depth of points with these rates is reached."""
        return np.asarray(1.0 / np.maximum(rate_hz * self.speed * self.ahead, _TINY_HZ))

    def aim_at(self, reached_s: Floats) -> Floats:
        """Where the places lie now (N, 2) that we reach after these times (N,), if we go on to turn as we do."""
        later_s = self.age_s + 0.5 * reached_s
        return np.asarray(self.aim + np.outer(later_s * self.turn_hz, [1.0, 0.0]))


@dataclass(frozen=True)
class StaticPoints:
    """N tracks and their depths on the scene's path: ``track_id (N,)``, ``xy_px (N, 2)``, ``fit``.

    ``in_scene (N,)`` those that move with the scene. Neighbours are nearer than ``link_px``.
    """

    track_id: Ints
    xy_px: Floats
    focal_px: float
    link_px: float
    fit: PathFit
    in_scene: Bools

    @property
    def link(self) -> float:
        """Distance of neighbours in the plane z = 1."""
        return self.link_px / self.focal_px


def own_path(path: Floats, since_s: Floats) -> OwnPath | None:
    """Where we go, by the ``path (L, 3)`` of the scene at the times ``since_s (L,)``; None where we do not move ahead.

    The path is where the scene was relative to the camera, less where it is now, oldest first, in s of a mean speed.
    """
    middle = len(path) // 2
    if middle < 1 or not path[0].any():
        return None
    late, early = path[middle], path[0] - path[middle]
    if not (late[2] > 0.0 and early[2] > 0.0):
        return None
    turn_hz = 0.0
    if -since_s[0] >= _LEAST_TURN_S:
        turn_hz = float((late[0] / late[2] - early[0] / early[2]) / (-0.5 * since_s[0]))
    length, aim = math.sqrt(late @ late), np.array([late[0] / late[2], path[0, 1] / path[0, 2]])
    took_s = float(-since_s[middle])
    return OwnPath(aim, turn_hz, length / took_s, float(late[2]) / length, 0.5 * took_s)


def find_obstacles(
    before: tuple[Obstacle, ...],
    points: StaticPoints,
    way: OwnPath | None,
    road: Floats | None,
    next_cluster_id: int,
    config: BodiesConfig,
    *,
    on_ground: bool,
) -> tuple[dict[int, Ints], tuple[Obstacle, ...], int]:
    """Tracks (M,) of every public obstacle by its number; what to remember; the next number.

    Parameters
    ----------
    way : None where we do not move ahead: nothing is in our way, but what was is known again for a while.
    road : plane of the road, as from `ground_plane.find_road`, or None.
    on_ground : whether we drive.
    """
    track_id = points.track_id
    surfaces = list[Ints]()
    if way is not None:
        is_known = np.isin(track_id, tracks_of(before))
        confirmed = tracks_of([obstacle for obstacle in before if obstacle.cluster_id is not None])
        surfaces = _surfaces(points, is_known, np.isin(track_id, confirmed), way, road, on_ground=on_ground)
    is_free = points.in_scene.copy()
    for surface in surfaces:
        is_free[surface] = False
    return remembered(before, track_id, surfaces, is_free, next_cluster_id, config)


def _surfaces(
    points: StaticPoints, is_known: Bools, is_confirmed: Bools, way: OwnPath, road: Floats | None, *, on_ground: bool
) -> list[Ints]:
    """Upright surfaces that our way leads through, tracks (M,) of each.

    ``is_known, is_confirmed (N,)`` are tracks of obstacles found before, and of those that are public by now.
    """
    index = _within_reach(points, way)
    place, rate_hz = points.fit.place[index], points.fit.rate_hz[index]
    off = np.linalg.norm(place - way.aim_at(way.reached_s(rate_hz)), axis=1)
    index, off = index[off < _FOLLOWED], off[off < _FOLLOWED]
    if len(index) < _LEAST_TRACKS or not off.min() < _LOOK:
        return []
    depths = _Depths(points.fit.take(index), road, on_ground=on_ground)
    asked = depths.stands & (off < _LOOK)
    if not asked.any():
        return []
    pairs = linked_pairs(points.xy_px[index], (_LINKS if road is None else 1.0) * points.link_px)
    pairs = pairs[depths.are_beside(pairs)]
    found, is_taken = list[Ints](), np.zeros(len(index), dtype=bool)
    for _ in range(_MOST_SURFACES):
        if not asked.any():
            break
        seed = int(np.argmin(np.where(asked, off, np.inf)))
        whole = _surface_of(seed, depths, pairs)
        asked[whole] = asked[seed] = False
        surface = depths.without_road_beside(whole[~is_taken[whole]], _OFF_LINK * points.link)
        if len(surface) < _LEAST_TRACKS or not depths.can_be_hit(surface, way):
            continue
        is_again = is_known[index[surface]].mean() > 0.5
        if not is_again and _goes_on(surface, depths, pairs):
            continue
        has_come = is_confirmed[index[surface]].mean() > 0.5
        if not (has_come or depths.reaches_down(surface)):
            continue
        link = points.link * (_KEPT if is_again else 1.0)
        if _is_in_the_way(depths, surface, way, link):
            is_taken[surface] = True
            # Near our way tracks tell depths worst: what was found from one of them may be a part of this.
            is_part = [2 * np.count_nonzero(np.isin(part, whole)) > len(part) for part in found]
            surface = np.concatenate([surface, *(part for part, joins in zip(found, is_part, strict=True) if joins)])
            found = [part for part, joins in zip(found, is_part, strict=True) if not joins]
            found.append(np.sort(surface))
    return [index[surface] for surface in found]


def _within_reach(points: StaticPoints, way: OwnPath) -> Ints:
    """Tracks of the scene whose depth is known, and reached soon."""
    fit = points.fit
    is_rated = points.in_scene & (fit.n_views >= _LEAST_VIEWS) & (fit.rate_sigma_hz < _KNOWN_PART * fit.rate_hz)
    rated = np.flatnonzero(is_rated)
    return rated[way.reached_s(fit.rate_hz[rated]) < REACHED_WITHIN_S]


class _Depths:
    """Depths of K tracks: ``log_rate (K,)`` with the ``tolerance (K,)`` within which another depth is the same one.

    ``height (K,)`` over the road in heights of the camera, if the road goes on to their depth (None: there is no road);
    ``stands (K,)`` tracks that do not lie on it, ``surely_stands (K,)`` also if the road rises.
    """

    def __init__(self, fit: PathFit, road: Floats | None, *, on_ground: bool) -> None:
        self.road, self.on_ground = road, on_ground
        self.place = fit.place
        self.log_rate = np.log(fit.rate_hz)
        self.tolerance = _ONE_SURFACE + _SURFACE_SIGMAS * fit.rate_sigma_hz / fit.rate_hz
        self.height: Floats | None = None
        self.stands = self.surely_stands = np.ones(len(fit.rate_hz), dtype=bool)
        if road is not None:
            x, y = fit.place.T
            horizon = -(road[0] + road[1] * x) / road[2]
            depth = road[2] / fit.rate_hz  # in heights of the camera
            self.height = 1.0 - (y - horizon) * depth
            self.stands = self.height > _LEAST_HEIGHT
            self.surely_stands = self.height > _LEAST_HEIGHT + _MOST_RISE * depth

    def are_beside(self, pairs: Ints) -> Bools:
        """Which pairs (M, 2) are parts of one thing on the road: one of them surely stands, the other is near.

        Without this all that has one depth on both sides of a road would be one thing.
        """
        if self.road is None:
            return np.ones(len(pairs), dtype=bool)
        camera_height = np.exp(self.log_rate[pairs].min(axis=1)) / self.road[2]
        apart = np.linalg.norm(self.place[pairs[:, 0]] - self.place[pairs[:, 1]], axis=1)
        return np.asarray(self.surely_stands[pairs].any(axis=1) & (apart < _BESIDE * camera_height))

    def without_road_beside(self, surface: Ints, reach: float) -> Ints:
        """A surface without the points of the road that lie beside what stands there."""
        upright = self.place[surface[self.stands[surface]], 0]
        if not len(upright):
            return surface[:0]
        x = self.place[surface, 0]
        return np.asarray(surface[(x > upright.min() - reach) & (x < upright.max() + reach)])

    def can_be_hit(self, surface: Ints, way: OwnPath) -> bool:
        """Whether a thing is neither driven over nor driven under."""
        if self.on_ground:
            top, bottom = self.place[surface, 1].min(), self.place[surface, 1].max()
            if bottom - way.aim[1] < _BELOW_CAMERA * (bottom - top):
                return False
        if self.height is None:
            return True
        is_low_enough = self.height[surface].min() < _MOST_HEIGHT
        return bool(is_low_enough and np.count_nonzero(self.stands[surface]) >= _LEAST_STANDING)

    def reaches_down(self, surface: Ints) -> bool:
        """Whether two tracks of a thing, of which one may be an error, are as low as what stands on the road."""
        if self.height is None or not self.on_ground:
            return True
        return bool(np.sort(self.height[surface])[1] < _MOST_FOOT)


def _surface_of(seed: int, depths: _Depths, pairs: Ints) -> Ints:
    """Tracks that hang together with a seed and have its depth, then the median depth of them all."""
    centre, own = depths.log_rate[seed], np.empty(0, dtype=np.int64)
    for _ in range(2):
        is_alike = np.abs(depths.log_rate - centre) < depths.tolerance
        is_alike[seed] = True
        label = connected_parts(is_alike, pairs)
        own = np.flatnonzero(label == label[seed])
        centre = median(depths.log_rate[own])
    return own


def _goes_on(surface: Ints, depths: _Depths, pairs: Ints) -> bool:
    """Whether what stands beside a surface is nearer: then it is a part of something that leads up to us.

    The ground before it is nearer, too, and lies below its foot.
    """
    is_own = np.zeros(len(depths.log_rate), dtype=bool)
    is_own[surface] = True
    crosses = is_own[pairs[:, 0]] != is_own[pairs[:, 1]]
    beside = np.unique(np.where(is_own[pairs[crosses, 0]], pairs[crosses, 1], pairs[crosses, 0]))
    is_ground = ~depths.stands[beside]
    if depths.height is None and not depths.on_ground:
        is_ground = depths.place[beside, 1] > depths.place[surface, 1].max()
    beside = beside[~is_ground]
    nearer = depths.log_rate[beside] > np.median(depths.log_rate[surface]) + depths.tolerance[beside]
    return bool(np.count_nonzero(nearer) > max(_LEAST_GOES_ON, _GOES_ON * len(surface)))


def _is_in_the_way(depths: _Depths, surface: Ints, way: OwnPath, link: float) -> bool:
    """Whether the box of a surface covers, or nearly covers, the place where we cross it, and has tracks near there.

    Going on to turn as we do, and going on straight: nobody knows how long a bend is. While one that ends before, as it
    well may, leads to the same place but for the height of the camera, half a lane, it only has to cover that. What
    stands on the road that we drive on, and can be hit, only has to be there sideways.
    """
    rate_hz = np.exp(np.median(depths.log_rate[surface]))
    straight_on, aim = way.aim_at(np.append(0.0, way.reached_s(rate_hz[None])))
    road, goes_on = depths.road, 0.0
    if road is not None and BEND_ENDS * abs(aim[0] - straight_on[0]) < rate_hz / road[2]:
        goes_on = (1.0 - BEND_ENDS) * share_of_bend(way.turn_hz)
    aims = np.stack([straight_on + goes_on * (aim - straight_on), aim])
    place = depths.place[surface[depths.stands[surface]]]
    if depths.on_ground and depths.height is not None:
        place, aims = place[:, :1], aims[:, :1]
    gap = np.maximum(np.maximum(place.min(axis=0) - aims, aims - place.max(axis=0)), 0.0)
    is_covered = np.all(gap <= _OFF_LINK * link, axis=1)
    is_near = np.linalg.norm(place[:, None] - aims, axis=2).min(axis=0) <= _LINKS * link
    return bool(np.all(is_covered & is_near))
