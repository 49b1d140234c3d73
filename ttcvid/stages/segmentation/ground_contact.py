"""Where things would touch the ground if they stood still: what lies under the road, or hangs over it, moves.

What moves along our own direction looks like a static thing at another depth. A car ahead that we close on slowly looks
too far away: its foot would lie under the road. An oncoming one looks too near, and so smaller: it hangs over the road.
(Klappstein et al., 2009: the constraints of positive depth and of positive height.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from ttcvid.geometry.compiled import compiled_for
from ttcvid.geometry.estimation.rigid_motion import PathFit
from ttcvid.geometry.medians import median, quantile
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.tracking.neighbours import connected_parts, linked_pairs

# Points of a thing have rates within this part of each other's, and so many of their standard deviations.
_ONE_THING, _SIGMAS = 0.12, 2.0
# A thing has so many points; its foot is where the middle one of its lowest ones is: one of them may be an error.
_LEAST_POINTS, _FOOT = 4, 3
# A point may be road within this part of its rate.
_ON_ROAD = 0.2
# A foot with less than the first part of the road's rate lies under the road, with more than the second it hangs: a
# road is no plane, and is found to a quarter of its depth. Both at so many standard deviations: of the rate, and of the
# horizon of the road, which is known to this tangent.
_UNDER_PART, _HANGING_PART, _FOOT_SIGMAS, _HORIZON_SIGMA = 0.75, 1.4, 3.0, 0.002
# What keeps its distance, but for this part of our speed, with a foot less than so many heights of the camera ahead, is
# our own car: bonnet, dashboard, or their reflection in the windscreen.
_KEEPS_DISTANCE, _OWN_FRONT = 0.2, 3.0
# What hangs is no longer than so many heights of the camera, or than this part of its distance: a row of houses is no
# thing.
_MOST_LENGTH, _MOST_DEPTH_RATIO = 3.0, 1.3
# Below it so many points of the road are seen that are farther than it by this factor: the last part down to its foot
# may be hidden. They are seen below its lowest part: beside the trunk of a tree the road is seen below its crown.
_SEEN_THROUGH, _FARTHER, _BOTTOM = 2, 1.25, 0.25
# Or it hangs over our own lane, so many heights of the camera to the side at the most, where nothing hangs, and would
# show so many points down to the road if it had as many there as above.
_OWN_LANE, _MISSING = 2.0, 3.0
# What would lie under the road may appear as far away as the background: less than this tangent below the horizon a
# point with the rate of the road there, or less, connects nothing. It belongs to a thing if it stands above its foot,
# as a roof does, beside its other points, and farther to the side by this part of its width at the most, as mirrors
# do. Where more than this part of what is above goes on beside it, it is background.
_FAR, _OVERHANG, _MOST_BESIDE = 0.015, 0.1, 0.25


@dataclass(frozen=True)
class Contacts:
    """Things by the N tracks that show them: ``thing (N,)`` the number of each track's, -1 without one.

    ``contradicts, is_borne (K,)``: things that the ground contradicts, and those that reach down to it.
    """

    thing: Ints
    contradicts: Bools
    is_borne: Bools


@dataclass(frozen=True)
class OnGround:
    """N tracks on the path of the scene over a road.

    ``place (N, 2)``; ``rate_hz, sigma_hz (N,)``; ``road_hz (N,)`` the rate of the road where each is seen, which grows
    by ``slope_hz`` a tangent downwards; ``known (N,)`` tracks whose rate is; ``aim_x`` where we go.
    """

    place: Floats
    rate_hz: Floats
    sigma_hz: Floats
    road_hz: Floats
    slope_hz: float
    known: Bools
    aim_x: float

    @property
    def is_off_road(self) -> Bools:
        """Points (N,) that are known not to lie on the road."""
        return np.asarray(self.known & ~(np.abs(self.rate_hz - self.road_hz) < _ON_ROAD * self.road_hz))

    @property
    def is_far(self) -> Bools:
        """Points (N,) that appear far away, and are not seen before a road that is nearer."""
        return np.asarray(np.maximum(self.rate_hz, self.road_hz) < _FAR * self.slope_hz)


def on_ground(fit: PathFit, road: Floats, known: Bools, aim_x: float) -> OnGround:
    """The tracks over a road (3,) as from `stages.segmentation.ground_plane.find_road`."""
    road_hz = road[0] + fit.place @ road[1:]
    return OnGround(fit.place, fit.rate_hz, fit.rate_sigma_hz, road_hz, float(road[2]), known, aim_x)


def find_contacts(xy_px: Floats, link_px: float, seen: OnGround, key: Ints) -> Contacts:
    """Things, and how each meets the ground.

    Parameters
    ----------
    xy_px : (N, 2) where tracks are seen; points of a thing are nearer to each other than ``link_px``.
    key : (N,) body of each track by now.
    """
    index = np.flatnonzero(seen.known & ~seen.is_far)
    pairs = linked_pairs(xy_px[index], link_px)
    pairs = pairs[key[index[pairs[:, 0]]] == key[index[pairs[:, 1]]]]
    tolerance = 0.5 * (_ONE_THING * np.abs(seen.rate_hz[index]) + _SIGMAS * seen.sigma_hz[index])
    label, is_off = np.full(len(index), -1), seen.is_off_road[index]
    both = np.concatenate([pairs, pairs[:, ::-1]])
    both = both[np.argsort(both[:, 0], kind="stable")]
    start, beside = np.searchsorted(both[:, 0], np.arange(len(index) + 1)), np.ascontiguousarray(both[:, 1])
    n_things = _surfaces(seen.rate_hz[index], tolerance, is_off, start, beside, label)
    thing = np.full(len(key), -1)
    contradicts, is_borne = np.zeros(n_things, dtype=bool), np.zeros(n_things, dtype=bool)
    for number in range(n_things):
        members = index[label == number]
        upright = members[seen.is_off_road[members]]
        x = seen.place[members, 0]
        # Beside it the road goes on at its depth.
        members = members[(x >= seen.place[upright, 0].min()) & (x <= seen.place[upright, 0].max())]
        if len(members) < _LEAST_POINTS:
            continue
        if _lies_under(seen, members):
            contradicts[number] = True
            members = np.append(members, _above(seen, members, key, xy_px, link_px))
        elif len(upright) >= _LEAST_POINTS and seen.road_hz[_foot(seen, upright)] > 0.0:
            contradicts[number] = _hangs(seen, upright)
            is_borne[number] = not contradicts[number] and not _is_high(seen, upright)
        thing[members] = number
    return Contacts(thing, contradicts, is_borne)


def _foot(seen: OnGround, members: Ints) -> int:
    """The track in the middle of the lowest of some (M,)."""
    lowest = members[np.argsort(-seen.place[members, 1], kind="stable")[:_FOOT]]
    return int(lowest[len(lowest) // 2])


def _lies_under(seen: OnGround, members: Ints) -> bool:
    """Whether the foot of a thing, tracks (M,), surely lies under the road, and it is not a part of our own car."""
    road_hz, usual_hz = seen.road_hz[_foot(seen, members)], _usual_hz(seen, members)
    if usual_hz < _KEEPS_DISTANCE * road_hz and road_hz > seen.slope_hz / _OWN_FRONT:
        return False
    return bool(_UNDER_PART * road_hz - usual_hz > _FOOT_SIGMAS * _foot_sigma_hz(seen, members, _UNDER_PART))


def _is_high(seen: OnGround, members: Ints) -> bool:
    """Whether the foot of a thing, tracks (M,), surely lies above the road."""
    limit_hz = _HANGING_PART * seen.road_hz[_foot(seen, members)]
    return bool(_usual_hz(seen, members) - limit_hz > _FOOT_SIGMAS * _foot_sigma_hz(seen, members, _HANGING_PART))


def _usual_hz(seen: OnGround, members: Ints) -> float:
    return median(seen.rate_hz[members])


def _foot_sigma_hz(seen: OnGround, members: Ints, part: float) -> float:
    """Standard deviation of the rate of a thing, tracks (M,), beside that part of the road's at its foot."""
    rate_sigma_hz = median(seen.sigma_hz[members]) * np.sqrt(0.5 * np.pi / len(members))
    return float(np.hypot(rate_sigma_hz, part * seen.slope_hz * _HORIZON_SIGMA))


def _above(seen: OnGround, members: Ints, key: Ints, xy_px: Floats, link_px: float) -> Ints:
    """What stands above a thing, tracks (M,), and appears as far away as the background."""
    (x, y), rate_hz, foot = seen.place.T, seen.rate_hz, _foot(seen, members)
    is_there = seen.known & seen.is_far & (rate_hz <= rate_hz[members].max()) & (key == key[foot]) & (y < y[foot])
    left, right = x[members].min(), x[members].max()
    is_over = np.maximum(left - x, x - right) <= _OVERHANG * (right - left)
    above = np.flatnonzero(is_there & is_over)
    if not len(above):
        return above
    both = np.append(members, above)
    part = connected_parts(np.ones(len(both), dtype=bool), linked_pairs(xy_px[both], link_px))
    above = above[np.isin(part[len(members) :], part[: len(members)])]
    beside = np.flatnonzero(is_there & ~is_over)
    if not len(above) or not len(beside):
        return above
    near_px, _ = KDTree(xy_px[above]).query(xy_px[beside], distance_upper_bound=link_px)
    goes_on = np.count_nonzero(np.isfinite(near_px)) > _MOST_BESIDE * len(above)
    return above[:0] if goes_on else above


def _hangs(seen: OnGround, members: Ints) -> bool:
    """Whether the road is seen below a thing, tracks (M,), or nothing where it would have to stand in our lane."""
    rate_hz = seen.rate_hz[members]
    near_hz, far_hz = quantile(rate_hz, 0.95), quantile(rate_hz, 0.05)
    is_deep = seen.slope_hz * (near_hz - far_hz) > _MOST_LENGTH * near_hz * far_hz
    if (is_deep and near_hz > _MOST_DEPTH_RATIO * far_hz) or not _is_high(seen, members):
        return False
    (x, y), foot = seen.place.T, _foot(seen, members)
    top, low = y[members].min(), y[foot]
    bottom = members[y[members] >= low - _BOTTOM * (low - top)]
    is_below = seen.known & (x > x[bottom].min()) & (x < x[bottom].max()) & (y > y[bottom].max())
    is_road = np.abs(seen.rate_hz - seen.road_hz) < _ON_ROAD * seen.road_hz
    if np.count_nonzero(is_below & is_road & (seen.rate_hz * _FARTHER < far_hz)) >= _SEEN_THROUGH:
        return True
    usual_hz, middle = median(rate_hz), median(x[members])
    down = (usual_hz - seen.road_hz[foot]) / seen.slope_hz
    is_aside = abs(middle - seen.aim_x) * seen.slope_hz > _OWN_LANE * usual_hz
    # What is nearer may bear it, or hide its foot.
    bears = is_below & (y < low + down) & ~is_road & (seen.rate_hz * _FARTHER > far_hz)
    return bool(down * len(members) > _MISSING * (low - top) and not is_aside and not bears.any())


@compiled_for("(f8[::1], f8[::1], b1[::1], i8[::1], i8[::1], i8[::1])")
def _surfaces(rate_hz: Floats, tolerance: Floats, is_seed: Bools, start: Ints, beside: Ints, label: Ints) -> int:
    """Fill ``label (K,)`` with the surface of each point, -1 without one; how many they are.

    From a seed on to points of its rate, then to those of the median rate of all of these. The neighbours of point i
    are ``beside[start[i] : start[i + 1]]``.
    """
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
                    if label[j] < 0 and abs(rate_hz[j] - centre) < 2.0 * tolerance[j]:
                        members[count], label[j] = j, n_things
                        count += 1
            for place in range(count):
                rates[place] = rate_hz[members[place]]
            centre = np.median(rates[:count])
        if count < _LEAST_POINTS:
            # Another surface may well hold them.
            for place in range(count):
                label[members[place]] = -1
        else:
            n_things += 1
    return n_things
