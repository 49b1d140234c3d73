"""Things that nothing bears: the road is seen where they would have to stand.

What comes towards us along our own direction looks like something that stands still, nearer than it is and so smaller:
its wheels float over the road.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.geometry.estimation.rigid_motion import PathFit
from ttcvid.geometry.medians import quantile
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.tracking.neighbours import linked_parts

# Points of a thing hang together within this part of their rates; so many are a thing.
_ONE_THING, _LEAST_THING = 0.12, 6
# What is as near as the road below it, within this factor, is taken for road and not for a part of a thing.
_NO_ROAD = 1.25
# A thing floats when even its two lowest points have this many times the rate of the road there.
_FLOATS = 1.5
# It is no longer than so many heights of the camera, or than this part of its distance: a row of houses is no thing.
_MOST_LENGTH, _MOST_DEPTH_RATIO = 3.0, 1.3
# A point is road within this part of its rate. What is seen through below a thing is farther than it by this factor:
# the last part down to its foot may be hidden.
_ON_ROAD, _FARTHER = 0.2, 1.25
# It is seen below the lowest part of the thing: beside the trunk of a tree the road is seen below its crown.
_BOTTOM = 0.25


@dataclass(frozen=True)
class Floating:
    """What N tracks say of things that nothing bears.

    ``thing (N,)`` number of the thing that each is a point of, -1 without one; ``is_borne (N,)`` points of things that
    reach down to the road; ``below (N,)`` number of the thing below which each is seen, a point of the road farther
    away than that, -1 without one.
    """

    thing: Ints
    is_borne: Bools
    below: Ints


def find_floating(
    xy_px: Floats, link_px: float, fit: PathFit, key: Ints, road_hz: Floats, slope_hz: float, known: Bools
) -> Floating:
    """Things, and where the road is seen through below them.

    Parameters
    ----------
    xy_px : (N, 2) where tracks are seen; points of a thing are nearer to each other than ``link_px``.
    fit : of the tracks on the path of the scene; ``known (N,)`` those whose rate is.
    key : (N,) body of each track by now.
    road_hz : (N,) rate of the road where each track is seen, NaN where none is; ``slope_hz`` how much it grows a
        tangent downwards: own speed over the camera's height.
    """
    found = Floating(np.full(len(key), -1), np.zeros(len(key), dtype=bool), np.full(len(key), -1))
    over = fit.rate_hz / road_hz
    index = np.flatnonzero(known & ~(over < _NO_ROAD))
    on_road = np.flatnonzero(known & (np.abs(over - 1.0) < _ON_ROAD))
    tolerance = np.full(len(index), 0.5 * _ONE_THING)
    label = linked_parts(xy_px[index], link_px, key[index], np.log(fit.rate_hz[index]), tolerance)
    x, y = fit.place.T
    for number in np.flatnonzero(np.bincount(label) >= _LEAST_THING):
        thing = index[label == number]
        found.thing[thing] = number
        lowest = thing[np.argsort(-y[thing], kind="stable")[:2]]
        if not np.isfinite(over[lowest]).all():
            continue
        if not over[lowest].min() > _FLOATS:
            found.is_borne[thing] = True
            continue
        near_hz, far_hz = quantile(fit.rate_hz[thing], 0.95), quantile(fit.rate_hz[thing], 0.05)
        if near_hz > _MOST_DEPTH_RATIO * far_hz and slope_hz * (1.0 / far_hz - 1.0 / near_hz) > _MOST_LENGTH:
            continue
        bottom = thing[y[thing] >= y[lowest[0]] - _BOTTOM * (y[lowest[0]] - y[thing].min())]
        under = on_road[(x[on_road] > x[bottom].min()) & (x[on_road] < x[bottom].max()) & (y[on_road] > y[lowest[0]])]
        above = thing[np.argmin(np.abs(x[under, None] - x[thing]), axis=1)]
        found.below[under[fit.rate_hz[under] * _FARTHER < fit.rate_hz[above]]] = number
    return found
