"""Ground contact: an object whose foot, at the depth of a static object, is under the road or over it, moves.

A mover along our own direction looks like a static object at another depth. A car ahead that we approach slowly looks
too far away, with its foot under the road; an oncoming one looks too near, and so smaller, with its foot over the road.
(Klappstein et al., 2009: the constraints of positive depth and of positive height.)
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import KDTree

from ttcvid.compiled import compiled_for
from ttcvid.geometry.kernels.medians import median as compiled_median
from ttcvid.geometry.medians import median
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.segmentation.road import Road, may_be_road
from ttcvid.stages.tracking.groups import TrackSets
from ttcvid.stages.tracking.neighbours import connected_parts, linked_pairs

# Points of an object have inverse depths within this share of each other's and so many standard deviations.
_ONE_THING, _SIGMAS = 0.12, 2.0
# Least number of points of an object; its foot is the middle one of so many lowest points, of which one may be wrong.
# Where so many of its points lie under the road, it does.
_LEAST_POINTS, _FOOT, _LEAST_UNDER = 4, 3, 2
# How far a thing reaches beyond its points under the road; a point there with no other one so near is taken for wrong.
# Both in camera heights: 0.5 m and 1.3 m.
_BESIDE, _NOT_ALONE = 0.4, 1.0
# A foot with less than the first share of the road's inverse depth is under the road, with more than the second over
# it: a road is uneven. Both at so many standard deviations, of the inverse depth and of the road's.
_UNDER_PART, _HANGING_PART, _FOOT_SIGMAS = 0.85, 1.4, 3.0
# Radius of a crest, in camera heights (1.6 km); what is seen of it has at least that part of the inverse
# depth that the road seems to have.
_CREST_RADIUS, _SEEN_PART = 1200.0, 0.5
# An object with a closing speed below this share of our speed, and its foot less than so many camera heights ahead, is
# part of our own car: bonnet, dashboard, or their reflection in the windscreen.
_KEEPS_DISTANCE, _OWN_FRONT = 0.2, 3.0
# A suspended object is shorter than so many camera heights, or spans depths by less than the ratio: a row of houses is
# no single object. A vehicle may be higher before a low camera, or wider, but not both: that is a bridge, or a house.
_MOST_SIZE, _MOST_DEPTH_RATIO = 3.0, 1.3
# Evidence of suspension: so many road points, farther than the object by this factor (its foot may be hidden), below
# the lowest share of it (the road is seen below the crown of a tree, beside the trunk).
_SEEN_THROUGH, _FARTHER, _BOTTOM = 2, 1.25, 0.25
# Or it is over our own lane, at most so many camera heights aside (parked cars are farther off). It then lacks so many
# points down to the road, by the density of its points above, and the gap is higher than the lowest share of it.
_OWN_LANE, _MISSING = 1.7, 3.0
# The upper points of an object with its foot under the road may look as far away as the background. Points with at most
# the inverse depth of the road this tangent below the horizon connect nothing. They belong to an object if they are
# above its foot (roof), connected, and at most this share of its width aside (mirrors). If points of more than the last
# share of their number continue beside the object, they are background.
_FAR, _OVERHANG, _MOST_BESIDE = 0.015, 0.1, 0.25


@dataclass(frozen=True)
class Contacts:
    """K objects and their ground contacts.

    thing : ``(N,)`` object of each track, -1 without one.
    contradicts : ``(K,)`` the foot contradicts a static object.
    is_borne : ``(K,)`` the foot is on the ground.
    is_own : ``(N,)`` tracks of our own car's front.
    """

    thing: Ints
    contradicts: Bools
    is_borne: Bools
    is_own: Bools


@dataclass(frozen=True)
class OnGround:
    """N tracks on the trajectory of the scene, and the road.

    place : ``(N, 2)`` in the plane z = 1.
    rate_hz, sigma_hz : ``(N,)`` inverse depth and its standard deviation, 1/s.
    known : ``(N,)`` whether the inverse depth is known.
    aim_x : x of our direction of travel in the plane z = 1.
    """

    place: Floats
    rate_hz: Floats
    sigma_hz: Floats
    road: Road
    known: Bools
    aim_x: float

    @cached_property
    def road_hz(self) -> Floats:
        """Inverse depth ``(N,)`` of the road that is seen there, 1/s."""
        return self.road.rate_hz(self.place)

    @cached_property
    def road_sigma_hz(self) -> Floats:
        """Standard deviation ``(N,)`` of `road_hz`."""
        return self.road.sigma_hz(self.place)

    @cached_property
    def is_road(self) -> Bools:
        """Whether points ``(N,)`` may be on the road."""
        return may_be_road(self.rate_hz, self.road_hz)

    @cached_property
    def is_off_road(self) -> Bools:
        """Whether points ``(N,)`` are known not to be on the road."""
        return np.asarray(self.known & ~self.is_road)

    @cached_property
    def is_under(self) -> Bools:
        """Whether points ``(N,)`` lie significantly under the road, each by itself."""
        return np.asarray(self.known & self.lie_under(slice(None), self.rate_hz, self.sigma_hz))

    @cached_property
    def is_far(self) -> Bools:
        """Whether points ``(N,)`` look far away, and the road behind them, too."""
        return np.asarray(np.maximum(self.rate_hz, self.road_hz) < _FAR * self.road.slope_hz)

    def lie_under(self, index: Ints | slice, rate_hz: Floats, sigma_hz: Floats) -> Bools:
        """Whether points ``index (M,)`` with these inverse depths lie significantly under the road.

        The road may fall away by a further Z^2 / (2 R), in camera heights.
        """
        square_hz2 = rate_hz**2
        part = np.clip(square_hz2 / (square_hz2 + 0.5 / _CREST_RADIUS * self.road.slope_hz**2), _SEEN_PART, _UNDER_PART)
        tolerance_hz = _FOOT_SIGMAS * np.hypot(sigma_hz, part * self.road_sigma_hz[index])
        return np.asarray(part * self.road_hz[index] - rate_hz > tolerance_hz)


def depth_tolerance_hz(rate_hz: Floats, sigma_hz: Floats) -> Floats:
    """Tolerance ``(N,)``, 1/s, within which inverse depths of points belong to one object."""
    return _ONE_THING * np.abs(rate_hz) + _SIGMAS * sigma_hz


def find_contacts(xy_px: Floats, link_px: float, seen: OnGround, key: Ints) -> Contacts:
    """Objects and their ground contacts, by observations ``xy_px (N, 2)`` of bodies ``key (N,)``.

    Points of an object are connected by distances below ``link_px``.
    """
    index = np.flatnonzero(seen.known & ~seen.is_far)
    pairs, own_key = linked_pairs(xy_px[index], link_px), key[index]
    pairs = pairs.take(np.flatnonzero(own_key[pairs[:, 0]] == own_key[pairs[:, 1]]), axis=0)
    tolerance_hz = depth_tolerance_hz(seen.rate_hz[index], seen.sigma_hz[index])
    label, is_off = np.full(len(index), -1), seen.is_off_road[index]
    n_things = _surfaces(seen.rate_hz[index], tolerance_hz, is_off, pairs, label)
    is_part = np.flatnonzero(label >= 0)
    is_part = is_part[np.argsort(label[is_part], kind="stable")]
    things = TrackSets(index[is_part], np.bincount(label[is_part], minlength=n_things))
    upright, _ = things.where(is_off[is_part])
    left, right = upright.boxes(seen.place)[things.set_of][:, ::2].T
    x = seen.place[things.index, 0]
    # The road at its depth continues beside it.
    things, _ = things.where((x >= left) & (x <= right))
    feet, upright_feet = _feet_of(things, seen), _feet_of(upright, seen)
    is_large = things.lengths >= _LEAST_POINTS
    is_under = feet.reach_under(things, seen)
    lies_under = is_large & (np.bincount(things.set_of, is_under, n_things) >= _LEAST_UNDER)
    is_asked = is_large & ~lies_under & (upright.lengths >= _LEAST_POINTS) & (upright_feet.road_hz > 0.0)
    thing, contradicts, is_own = np.full(len(key), -1), lies_under.copy(), np.zeros(len(key), dtype=bool)
    is_own[things.index] = feet.are_own[things.set_of]
    thing[things.index] = np.where(is_large, np.arange(n_things), -1)[things.set_of]
    for number in np.flatnonzero(is_asked & upright_feet.are_high).tolist():
        contradicts[number] = _hangs(seen, upright.members(number), int(upright_feet.track[number]))
    # An object under the road hides the road at its depth: its tracks there are its own, unless most may be road (a
    # kerb). One that hangs over the road does not hide the road below it.
    off_road = seen.is_off_road[things.index]
    hides_road = lies_under & (2 * np.bincount(things.set_of, off_road, n_things) > things.lengths)
    belongs = off_road | ~contradicts[things.set_of] | hides_road[things.set_of]
    thing[things.index[~belongs]] = -1
    # A car ahead may have the static depth of the houses behind it, which stand on the road beside it.
    for number in np.flatnonzero(lies_under).tolist():
        members = things.index[belongs & (things.set_of == number)]
        thing[members] = -1
        under = things.index[is_under & (things.set_of == number)]
        camera_height = float(seen.road_hz[under].max()) / seen.road.slope_hz
        under = under[np.argsort(seen.place[under, 0])]
        is_near = np.diff(seen.place[under, 0]) < _NOT_ALONE * camera_height
        # By one wrong point a tree that stands beside would be a part.
        under = under[np.append(False, is_near) | np.append(is_near, False) | ~is_near.any()]
        members = _standing_over(seen, members, under, camera_height)
        if not len(members):
            continue
        above = _above(seen, members, int(under[np.argmin(seen.place[under, 1])]), key, xy_px, link_px)
        thing[members] = thing[above] = number
    return Contacts(thing, contradicts, is_asked & ~upright_feet.are_high, is_own)


@dataclass(frozen=True)
class _Feet:
    """Feet of K objects: the ``track (K,)`` of each; ``road_hz, road_sigma_hz (K,)`` of the road there.

    ``median_hz, sigma_hz (K,)`` median inverse depth of each object and its standard deviation; ``slope_hz`` growth of
    the road's inverse depth per tangent downwards. All in 1/s.
    """

    track: Ints
    road_hz: Floats
    road_sigma_hz: Floats
    median_hz: Floats
    sigma_hz: Floats
    slope_hz: float

    def reach_under(self, things: TrackSets, seen: OnGround) -> Bools:
        """Tracks ``(M,)`` of the K ``things`` that lie significantly under the road, at the depth of their thing."""
        of = things.set_of
        return seen.lie_under(things.index, self.median_hz[of], self.sigma_hz[of]) & ~self.are_own[of]

    @property
    def are_own(self) -> Bools:
        """Objects ``(K,)`` that are part of our own car."""
        keep_distance = self.median_hz < _KEEPS_DISTANCE * self.road_hz
        return np.asarray(keep_distance & (self.road_hz > self.slope_hz / _OWN_FRONT))

    @property
    def are_high(self) -> Bools:
        """Objects ``(K,)`` with a foot significantly over the road."""
        tolerance_hz = _FOOT_SIGMAS * np.hypot(self.sigma_hz, _HANGING_PART * self.road_sigma_hz)
        return np.asarray(self.median_hz - _HANGING_PART * self.road_hz > tolerance_hz)


def _feet_of(things: TrackSets, seen: OnGround) -> _Feet:
    """Feet of K objects: of each the middle one of its lowest tracks."""
    lowest_first = np.lexsort((-seen.place[things.index, 1], things.set_of))
    track = things.index[lowest_first[things.first + np.minimum(things.lengths, _FOOT) // 2]]
    sigma_hz = things.medians(seen.sigma_hz[things.index]) * np.sqrt(0.5 * np.pi / things.lengths)
    median_hz = things.medians(seen.rate_hz[things.index])
    return _Feet(track, seen.road_hz[track], seen.road_sigma_hz[track], median_hz, sigma_hz, seen.road.slope_hz)


def _is_over(x: Floats, below_x: Floats, beside: float = 0.0) -> Bools:
    """Which ``x (M,)`` are within the span of ``below_x (K,)``, but for mirrors, or at most ``beside`` aside of it."""
    left, right = below_x.min(), below_x.max()
    return np.asarray(np.maximum(left - x, x - right) <= max(_OVERHANG * (right - left), beside))


def _standing_over(seen: OnGround, members: Ints, under: Ints, camera_height: float) -> Ints:
    """Which points of one static depth, ``members (M,)``, are of the vehicle with points ``under (K,)`` the road.

    ``camera_height`` is that of the camera at the true depth of the vehicle, a tangent.
    """
    over_horizon, reach = -seen.road_hz[members] / seen.road.slope_hz, _BESIDE * camera_height
    is_over, is_high = _is_over(seen.place[members, 0], seen.place[under, 0], reach), over_horizon >= reach
    # What goes on beside it over our own height stands behind it.
    goes_on = np.count_nonzero(~is_over & is_high) > _MOST_BESIDE * np.count_nonzero(is_over & is_high)
    return members[is_over & ~is_high if goes_on else is_over]


def _above(seen: OnGround, members: Ints, foot: int, key: Ints, xy_px: Floats, link_px: float) -> Ints:
    """Upper points of an object, tracks ``(M,)`` with a ``foot``, that look as far away as the background."""
    (x, y), rate_hz = seen.place.T, seen.rate_hz
    is_there = seen.known & seen.is_far & (rate_hz <= rate_hz[members].max()) & (key == key[foot]) & (y < y[foot])
    is_over = _is_over(x, x[members])
    above = np.flatnonzero(is_there & is_over)
    both = np.append(members, above)
    part = connected_parts(np.ones(len(both), dtype=bool), linked_pairs(xy_px[both], link_px))
    above = above[np.isin(part[len(members) :], part[: len(members)])]
    beside = np.flatnonzero(is_there & ~is_over)
    if not len(above) or not len(beside):
        return above
    near_px, _ = KDTree(xy_px[above]).query(xy_px[beside], distance_upper_bound=link_px)
    goes_on = np.count_nonzero(np.isfinite(near_px)) > _MOST_BESIDE * len(above)
    return above[:0] if goes_on else above


def _hangs(seen: OnGround, members: Ints, foot: int) -> bool:
    """Whether an object is suspended: road is seen below it, or in our lane nothing that bears it.

    The ``foot``, one of its tracks ``members (M,)``, is significantly over the road.
    """
    rate_hz = seen.rate_hz[members]
    # Of few values, four times as fast as numpy's quantiles.
    far_hz, near_hz = np.interp([0.05, 0.95], np.linspace(0.0, 1.0, len(rate_hz)), np.sort(rate_hz))
    is_deep = seen.road.slope_hz * (near_hz - far_hz) > _MOST_SIZE * near_hz * far_hz
    if is_deep and near_hz > _MOST_DEPTH_RATIO * far_hz:
        return False
    x, y = seen.place.T
    top, low = y[members].min(), y[foot]
    median_hz, middle = median(rate_hz), median(x[members])
    # One of its points may be wrong.
    is_high = median_hz - np.sort(seen.road_hz[members])[1] > _MOST_SIZE * median_hz
    if is_high and seen.road.slope_hz * np.ptp(x[members]) > _MOST_SIZE * median_hz:
        return False
    bottom = members[y[members] >= low - _BOTTOM * (low - top)]
    is_below = seen.known & (x > x[bottom].min()) & (x < x[bottom].max()) & (y > y[bottom].max())
    if np.count_nonzero(is_below & seen.is_road & (seen.rate_hz * _FARTHER < far_hz)) >= _SEEN_THROUGH:
        return True
    down = (median_hz - seen.road_hz[foot]) / seen.road.slope_hz
    is_aside = abs(middle - seen.aim_x) * seen.road.slope_hz > _OWN_LANE * median_hz
    # A nearer object may bear it, or hide its foot.
    bears = is_below & (y < low + down) & ~seen.is_road & (seen.rate_hz * _FARTHER > far_hz)
    is_gap = down > _BOTTOM * (low - top) and down * len(members) > _MISSING * (low - top)
    return bool(is_gap and not is_aside and not bears.any())


@compiled_for("(f8[::1], f8[::1], b1[::1], i8[:, ::1], i8[::1])")
def _surfaces(rate_hz: Floats, tolerance_hz: Floats, is_seed: Bools, pairs: Ints, label: Ints) -> int:
    """Fill ``label (K,)`` with the surface of each point, -1 without one; return their number.

    A region grows along ``pairs (M, 2)`` from a seed over points of its inverse depth, within ``tolerance_hz (K,)``,
    then again over those of the region's median.
    """
    # The neighbours of point i, from start[i] to start[i + 1]: counted, since a sort takes several times as long.
    start = np.zeros(len(rate_hz) + 1, dtype=np.int64)
    for one, other in pairs:
        start[one + 1] += 1
        start[other + 1] += 1
    for i in range(len(rate_hz)):
        start[i + 1] += start[i]
    beside, end = np.empty(2 * len(pairs), dtype=np.int64), start.copy()
    for one, other in pairs:
        beside[end[one]], beside[end[other]] = other, one
        end[one] += 1
        end[other] += 1
    members, rates, n_things = np.empty(len(rate_hz), dtype=np.int64), np.empty(len(rate_hz)), 0
    for seed in range(len(rate_hz)):
        if label[seed] >= 0 or not is_seed[seed]:
            continue
        centre, count = rate_hz[seed], 0
        for _ in range(2):
            for place in range(count):
                label[members[place]] = -1
            members[0], label[seed], count, done = seed, n_things, 1, 0
            while done < count:
                i = members[done]
                done += 1
                for place in range(start[i], start[i + 1]):
                    j = beside[place]
                    if label[j] < 0 and abs(rate_hz[j] - centre) < tolerance_hz[j]:
                        members[count], label[j] = j, n_things
                        count += 1
            for place in range(count):
                rates[place] = rate_hz[members[place]]
            centre = compiled_median(rates[:count])
        if count < _LEAST_POINTS:
            # They may be part of another surface.
            for place in range(count):
                label[members[place]] = -1
        else:
            n_things += 1
    return n_things
