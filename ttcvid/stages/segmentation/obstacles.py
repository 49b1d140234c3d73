"""What stands in our own path: upright surfaces of the scene that our way leads through.

A stopped car ahead moves with the scene, and so does, to all appearance, what comes along our own direction (an
aircraft head-on looks like a static one that is nearer): for safety it is the same, it closes. Such a thing is an
object that shares the scene's motion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ttcvid.config import BodiesConfig
from ttcvid.geometry.along_bend import BEND_ENDS, share_of_bend
from ttcvid.geometry.estimation.rigid_motion import PathFit
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.segmentation.road import OWN_HALF_WIDTH, Road
from ttcvid.stages.segmentation.surface_memory import Obstacle, remembered, tracks_of
from ttcvid.stages.tracking.neighbours import connected_parts, linked_pairs

REACHED_WITHIN_S = 6.0
"""What we reach later than this is no obstacle yet, s: half as long again as a warning looks ahead."""
# A track counts from so many views on, with an inverse depth known to this part of that of its surface; a surface whose
# own is known to the second part. Near our heading no single track tells much, those of a surface together do.
_LEAST_VIEWS, _TOLD_PART, _KNOWN_PART = 4, 0.6, 0.15
# Only what is known to this part puts a surface into our way. Without a road to give things a size, nothing else does.
_WELL_TOLD = 0.25
# Tracks of one surface have inverse depths within this part of its own, and so many of their standard deviations.
_ONE_SURFACE, _SURFACE_SIGMAS = 0.12, 2.0
# A surface is followed so often, with the depth of what was found before.
_ROUNDS = 2
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
# What stands on the road reaches this part of the camera height below the camera; otherwise it is suspended.
_BELOW_CAMERA = 0.15
# Heights above the road, in camera heights: what ends below the first is driven over, what begins above the second is
# driven under; so many tracks of an object lie above the first.
_LEAST_HEIGHT, _MOST_HEIGHT, _LEAST_STANDING = 0.2, 1.1, 2
# A road is no plane, and its horizon is not known exactly: a point surely stands if it also would with the horizon this
# tangent higher, as where the grade changes by 1 % over 30 m.
_MOST_RISE = 0.008
# The deck of a bridge is higher than this over the road, and the low edge of what stands in our way is not.
_LEAST_DECK = 1.75
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
    turn_hz = float((late[0] / late[2] - early[0] / early[2]) / (-0.5 * since_s[0]))
    length, aim = math.sqrt(late @ late), np.array([late[0] / late[2], path[0, 1] / path[0, 2]])
    took_s = float(-since_s[middle])
    return OwnPath(aim, turn_hz, length / took_s, float(late[2]) / length, 0.5 * took_s)


def find_obstacles(
    before: tuple[Obstacle, ...],
    points: StaticPoints,
    way: OwnPath | None,
    road: Road | None,
    next_cluster_id: int,
    config: BodiesConfig,
    *,
    on_ground: bool,
) -> tuple[dict[int, Ints], tuple[Obstacle, ...], int]:
    """Tracks (M,) of every public obstacle by its number; what to remember; the next number.

    Parameters
    ----------
    way : None where we do not move ahead: nothing is in our way, but what was is known again for a while.
    road : as from `road.find_road`, or None.
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
    points: StaticPoints, is_known: Bools, is_confirmed: Bools, way: OwnPath, road: Road | None, *, on_ground: bool
) -> list[Ints]:
    """Upright surfaces that our way leads through, tracks (M,) of each.

    ``is_known, is_confirmed (N,)`` are tracks of obstacles found before, and of those that are public by now.
    """
    index, off = _within_reach(points, way)
    depths = _Depths(points.fit.take(index), road, on_ground=on_ground)
    is_ahead = off < _LOOK
    if on_ground and road is not None:
        is_ahead |= off < OWN_HALF_WIDTH * depths.rate_hz / road.slope_hz
    asked = depths.are_told(depths.rate_hz) & depths.stand(slice(None), depths.rate_hz) & is_ahead
    if len(index) < _LEAST_TRACKS or not asked.any():
        return []
    pairs = linked_pairs(points.xy_px[index], (_LINKS if road is None else 1.0) * points.link_px)
    found, is_taken = list[_Surface](), np.zeros(len(index), dtype=bool)
    for _ in range(_MOST_SURFACES):
        if not asked.any():
            break
        seed = int(np.argmin(np.where(asked, off, np.inf)))
        whole = _surface_of(seed, depths, pairs)
        asked[whole.members] = asked[seed] = False
        left = whole.members[~is_taken[whole.members]]
        left = depths.without_road_beside(left, whole.rate_hz, _OFF_LINK * points.link)
        surface = _surface_at(depths, left, whole.rate_hz)
        if not (surface.is_known and way.reached_s(surface.rate_hz) < REACHED_WITHIN_S):
            continue
        if not depths.can_be_hit(surface, way):
            continue
        is_again = is_known[index[surface.members]].mean() > 0.5
        if not is_again and _goes_on(surface, depths, pairs):
            continue
        has_come = is_confirmed[index[surface.members]].mean() > 0.5
        if not (has_come or depths.reaches_down(surface)):
            continue
        link = points.link * (_KEPT if is_again else 1.0)
        if _is_in_the_way(depths, surface, way, link):
            is_taken[surface.members] = True
            found = _with_surface(found, surface, whole)
    return [index[np.sort(surface.members)] for surface in found]


def _within_reach(points: StaticPoints, way: OwnPath) -> tuple[Ints, Floats]:
    """Tracks of the scene (M,) that may be reached soon, near enough to our heading, and how far off it each is."""
    fit = points.fit
    seen = np.flatnonzero(points.in_scene & (fit.n_views >= _LEAST_VIEWS) & np.isfinite(fit.rate_sigma_hz))
    nearest_hz = fit.rate_hz[seen] + _SURFACE_SIGMAS * fit.rate_sigma_hz[seen]
    # What looks farther by its noise is looked for where we are by then.
    reached_s = np.minimum(way.reached_s(fit.rate_hz[seen]), REACHED_WITHIN_S)
    off = np.linalg.norm(fit.place[seen] - way.aim_at(reached_s), axis=1)
    is_near = (way.reached_s(nearest_hz) < REACHED_WITHIN_S) & (off < _FOLLOWED)
    return seen[is_near], off[is_near]


@dataclass(frozen=True)
class _Surface:
    """Tracks ``members (M,)`` of one depth: their common inverse depth, 1/s, and its standard deviation."""

    members: Ints
    rate_hz: Floats
    sigma_hz: float

    @property
    def is_known(self) -> bool:
        """Whether it has enough tracks, which together determine its depth."""
        return len(self.members) >= _LEAST_TRACKS and self.sigma_hz < _KNOWN_PART * float(self.rate_hz)

    def has_depth_of(self, other: _Surface) -> bool:
        """Whether both may have one depth."""
        sigma_hz = np.hypot(self.sigma_hz, other.sigma_hz)
        return bool(abs(self.rate_hz - other.rate_hz) < _ONE_SURFACE * self.rate_hz + _SURFACE_SIGMAS * sigma_hz)


class _Depths:
    """Places and inverse depths of K tracks, each with its standard deviation.

    The ``road`` goes on to the depth of each (None: there is none).
    """

    def __init__(self, fit: PathFit, road: Road | None, *, on_ground: bool) -> None:
        self.road, self.on_ground = road, on_ground
        self.place, self.rate_hz, self.sigma_hz = fit.place, fit.rate_hz, fit.rate_sigma_hz

    def heights(self, index: Ints | slice, rate_hz: Floats) -> Floats:
        """Heights over the road, in heights of the camera, of tracks on a surface of inverse depth ``rate_hz``.

        That of a track that tells its own depth well is its own: else the road a little farther would seem to stand.
        """
        assert self.road is not None
        own, of_surface = self.sigma_hz[index] ** -2.0, np.maximum(_ONE_SURFACE * rate_hz, _TINY_HZ) ** -2.0
        rate_hz = (own * self.rate_hz[index] + of_surface * rate_hz) / (own + of_surface)
        return self.road.heights(self.place[index], rate_hz)

    def stand(self, index: Ints | slice, rate_hz: Floats, *, surely: bool = False) -> Bools:
        """Which tracks do not lie on the road, on a surface of that depth; ``surely`` also where the road rises."""
        if self.road is None:
            return np.ones(len(self.place[index]), dtype=bool)
        rise = _MOST_RISE * self.road.slope_hz / np.maximum(rate_hz, _TINY_HZ) if surely else 0.0
        return np.asarray(self.heights(index, rate_hz) > _LEAST_HEIGHT + rise)

    def are_told(self, rate_hz: Floats) -> Bools:
        """Which tracks say anything of a depth; without a road, on which a thing has a size, more."""
        return np.asarray(self.sigma_hz < (_WELL_TOLD if self.road is None else _TOLD_PART) * rate_hz)

    def are_beside(self, pairs: Ints, rate_hz: Floats) -> Bools:
        """Which pairs (M, 2) are parts of one thing of that depth: one of them surely stands, the other is near.

        Without this all that has one depth on both sides of a road would be one thing.
        """
        if self.road is None:
            return np.ones(len(pairs), dtype=bool)
        stands = self.stand(slice(None), rate_hz, surely=True)
        apart = np.linalg.norm(self.place[pairs[:, 0]] - self.place[pairs[:, 1]], axis=1)
        return np.asarray(stands[pairs].any(axis=1) & (apart < _BESIDE * rate_hz / self.road.slope_hz))

    def without_road_beside(self, members: Ints, rate_hz: Floats, reach: float) -> Ints:
        """A surface without the points of the road that lie beside what stands there."""
        upright = self.place[members[self.stand(members, rate_hz)], 0]
        if not len(upright):
            return members[:0]
        x = self.place[members, 0]
        return np.asarray(members[(x > upright.min() - reach) & (x < upright.max() + reach)])

    def can_be_hit(self, surface: _Surface, way: OwnPath) -> bool:
        """Whether a thing is neither driven over nor driven under."""
        if self.on_ground:
            top, bottom = self.place[surface.members, 1].min(), self.place[surface.members, 1].max()
            if bottom - way.aim[1] < _BELOW_CAMERA * (bottom - top):
                return False
        if self.road is None:
            return True
        is_low_enough = self.heights(surface.members, surface.rate_hz).min() < _MOST_HEIGHT
        n_standing = np.count_nonzero(self.stand(surface.members, surface.rate_hz))
        return bool(is_low_enough and n_standing >= _LEAST_STANDING)

    def reaches_down(self, surface: _Surface) -> bool:
        """Whether two tracks of a thing, of which one may be an error, are as low as what stands on the road."""
        if self.road is None or not self.on_ground:
            return True
        return bool(np.sort(self.heights(surface.members, surface.rate_hz))[1] < _MOST_FOOT)


def _surface_of(seed: int, depths: _Depths, pairs: Ints) -> _Surface:
    """Tracks that tell depths, hang together with a seed and have its depth, then the depth of them all."""
    surface = _Surface(np.array([seed]), depths.rate_hz[seed], np.inf)
    for _ in range(_ROUNDS):
        apart_hz = np.abs(depths.rate_hz - surface.rate_hz)
        is_alike = apart_hz < _ONE_SURFACE * surface.rate_hz + _SURFACE_SIGMAS * depths.sigma_hz
        is_alike &= depths.are_told(surface.rate_hz)
        is_alike[seed] = True
        label = connected_parts(is_alike, pairs[depths.are_beside(pairs, surface.rate_hz)])
        surface = _surface_at(depths, np.flatnonzero(label == label[seed]), surface.rate_hz)
    return surface


def _surface_at(depths: _Depths, members: Ints, rate_hz: Floats) -> _Surface:
    """Tracks ``(M,)`` of about the inverse depth ``rate_hz``, with the mean of those that stand; not known without."""
    upright = members[depths.stand(members, rate_hz)]
    if not len(upright):
        return _Surface(members, rate_hz, np.inf)
    # Parts of a surface lie before and behind its middle: those known best must not decide alone.
    weight = 1.0 / (depths.sigma_hz[upright] ** 2 + (_ONE_SURFACE * rate_hz) ** 2)
    mean_hz = weight @ depths.rate_hz[upright] / weight.sum()
    return _Surface(members, mean_hz, float(1.0 / np.sqrt(weight.sum())))


def _with_surface(found: list[_Surface], surface: _Surface, whole: _Surface) -> list[_Surface]:
    """The surfaces in our way with another one, and with their parts joined.

    Our way leads through them all: those of its depth are parts of it, and those whose tracks may mostly have its depth
    (near our way tracks tell depths worst). ``whole`` is the surface with the tracks that others have.
    """
    is_part = [
        other.has_depth_of(surface) or 2 * np.isin(other.members, whole.members).sum() > len(other.members)
        for other in found
    ]
    parts = (other.members for other, joins in zip(found, is_part, strict=True) if joins)
    others = (other for other, joins in zip(found, is_part, strict=True) if not joins)
    return [*others, replace(surface, members=np.concatenate([surface.members, *parts]))]


def _goes_on(surface: _Surface, depths: _Depths, pairs: Ints) -> bool:
    """Whether what stands beside a surface is nearer: then it is a part of something that leads up to us.

    The ground before it is nearer, too, and lies below its foot.
    """
    is_own = np.zeros(len(depths.rate_hz), dtype=bool)
    is_own[surface.members] = True
    pairs = pairs[depths.are_beside(pairs, surface.rate_hz)]
    crosses = is_own[pairs[:, 0]] != is_own[pairs[:, 1]]
    beside = np.unique(np.where(is_own[pairs[crosses, 0]], pairs[crosses, 1], pairs[crosses, 0]))
    is_ground = ~depths.stand(beside, depths.rate_hz[beside])
    if depths.road is None and not depths.on_ground:
        is_ground = depths.place[beside, 1] > depths.place[surface.members, 1].max()
    beside = beside[~is_ground]
    farthest_hz = depths.rate_hz[beside] - _SURFACE_SIGMAS * depths.sigma_hz[beside]
    n_nearer = np.count_nonzero(farthest_hz > (1.0 + _ONE_SURFACE) * surface.rate_hz)
    return bool(n_nearer > max(_LEAST_GOES_ON, _GOES_ON * len(surface.members)))


def _is_in_the_way(depths: _Depths, surface: _Surface, way: OwnPath, link: float) -> bool:
    """Whether the box of a surface covers, or nearly covers, the place where we cross it, and has tracks near there.

    Going on to turn as we do, and going on straight: nobody knows how long a bend is. While one that ends before, as it
    well may, leads to the same place but for the height of the camera, half a lane, it only has to cover that. What
    stands on the road that we drive on, and can be hit, only has to be there sideways, within half of our width.
    """
    rate_hz = surface.rate_hz
    straight_on, aim = way.aim_at(np.append(0.0, way.reached_s(rate_hz)))
    road, goes_on = depths.road, 0.0
    if road is not None and BEND_ENDS * abs(aim[0] - straight_on[0]) < rate_hz / road.slope_hz:
        goes_on = (1.0 - BEND_ENDS) * share_of_bend(way.turn_hz)
    aims = np.stack([straight_on + goes_on * (aim - straight_on), aim])
    own_hz, sigma_hz = depths.rate_hz[surface.members], depths.sigma_hz[surface.members]
    tells = depths.stand(surface.members, rate_hz) & (sigma_hz < _WELL_TOLD * np.minimum(own_hz, rate_hz))
    axes, covered, near = slice(2), _OFF_LINK * link, _LINKS * link
    if depths.on_ground and road is not None:
        # We drive through under the deck of a bridge, and between things that leave us twice our width.
        tells &= depths.heights(surface.members, rate_hz) < _LEAST_DECK
        half_width = float(OWN_HALF_WIDTH * rate_hz / road.slope_hz)
        axes, covered, near = slice(1), max(covered, half_width), covered + half_width
    place, aims = depths.place[surface.members[tells], axes], aims[:, axes]
    if not len(place):
        return False
    gap = np.maximum(np.maximum(place.min(axis=0) - aims, aims - place.max(axis=0)), 0.0)
    is_covered = np.all(gap <= covered, axis=1)
    is_near = np.linalg.norm(place[:, None] - aims, axis=2).min(axis=0) <= near
    return bool(np.all(is_covered & is_near))
