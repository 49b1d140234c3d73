"""What a road tells of movers along our own direction, which look like static points at a wrong depth.

Such a thing would lie under the road, or hang over it (`stages.segmentation.ground_contact`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ttcvid.geometry.estimation.rigid_motion import PathFit
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.egomotion.relative_pose import picture_region
from ttcvid.stages.segmentation.body_views import BodyViews
from ttcvid.stages.segmentation.ground_contact import Contacts, find_contacts, on_ground
from ttcvid.stages.tracking.groups import places_among

# The camera looks along the road within so much, as the tangent of its pitch; heights of the horizon that are tried.
_PITCH, _N_HORIZONS = 0.06, 13
LEAST_BELOW = 0.03
"""From so far below the horizon on (tangent) a point says something of the road, and the road of our speed."""
# With a rate known to this part.
_KNOWN_PART = 0.1
# Rates of road points agree within this part (natural logarithm); a point with less than this part of the road's rate
# would lie under it, and counts against a road.
_ROAD_SPREAD, _UNDER_PART = 0.08, 0.75
# Points count by the parts of the picture in which they lie: squares of this side (tangent, 3 deg).
_CELL = 0.05
# A road is borne by so many points, and by this part of the weight of all below the horizon.
_LEAST_POINTS, _LEAST_SHARE = 12, 0.3
# The horizon of the plane lies this close to where we go: twice the pitch, one for its own error.
_HORIZON_OFF = 2.0 * _PITCH
# How much the road may fall to one side, beside how much it comes nearer downwards: roll of the camera.
_ROLL_SIGMA = 0.1
_LEAST_VIEWS = 4
# A point lies on the road within this part of its rate.
_ON_ROAD = 0.2
# Evidence decays by the first factor per frame, by the second where there is a road but the frame does not observe it
# there, as where the road has no texture; a track contradicts a static scene above the last value.
_FORGETTING, _NOTHING_SAID, _ENOUGH = 0.8, 0.97, 0.5
# The road itself changes slowly: beside our way its memory is longer.
_ROAD_FORGETTING = 0.85


@dataclass(frozen=True)
class RoadMemory:
    """Evidence of each track ``track_id (N,)`` against standing on the ground: ``evidence (N,)`` in 0 to 1.

    ``plane (3,)`` is the road of this frame, as from `find_road` but steadied, None where there is none, and
    ``epipole_y`` the height of our direction of travel.
    """

    track_id: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    evidence: Floats = field(default_factory=lambda: np.empty(0))
    plane: Floats | None = None
    epipole_y: float = 0.0

    def in_units(self, speed: float) -> RoadMemory:
        """The same where ``speed`` is 1: where we brake, the road of the frames before comes nearer the slower."""
        return self if self.plane is None else replace(self, plane=self.plane * speed)

    def contradicts(self) -> Bools:
        """Tracks that a static scene cannot hold: (N,)."""
        return np.asarray(self.evidence > _ENOUGH)


def gathered_evidence(
    memory: RoadMemory, track_id: Ints, views: BodyViews, fit: PathFit, key: Ints, in_scene: Bools, aim: Floats
) -> RoadMemory:
    """The evidence of the last frames with that of this one.

    Parameters
    ----------
    fit : of all N tracks on the path of the scene.
    key : (N,) body of each track by now; ``in_scene (N,)`` tracks that a road may be made of.
    aim : (2,) where we go in the plane z = 1.
    """
    evidence, epipole_y = np.zeros(len(track_id)), float(aim[1])
    place = places_among(memory.track_id, track_id)
    is_known = place >= 0
    evidence[is_known] = memory.evidence[place[is_known]]
    road = steadied(memory, find_road(fit, in_scene, epipole_y), epipole_y)
    if road is None:
        return RoadMemory(track_id, _FORGETTING * evidence, None, epipole_y)
    most_sigma_hz = _KNOWN_PART * np.maximum(fit.rate_hz, LEAST_BELOW * road[2])
    is_rated = views.is_free & (fit.n_views >= _LEAST_VIEWS) & (fit.rate_sigma_hz < most_sigma_hz)
    seen = on_ground(fit, road, is_rated, float(aim[0]))
    contacts = find_contacts(views.xy_px, views.link_px, seen, key)
    evidence = _shared_evidence(evidence, is_known & (fit.n_views > _LEAST_VIEWS), contacts)
    return RoadMemory(track_id, evidence, road, epipole_y)


def _shared_evidence(evidence: Floats, is_old: Bools, contacts: Contacts) -> Floats:
    """The evidence (N,), the same for all points of a thing: the mean of its old ones, and what its foot says now."""
    own, new = np.flatnonzero(contacts.thing >= 0), _FORGETTING * evidence
    thing, n_things = contacts.thing[own], len(contacts.contradicts)
    count = np.bincount(thing, is_old[own], n_things)
    mean = np.bincount(thing, is_old[own] * evidence[own], n_things) / np.maximum(count, 1.0)
    says = contacts.contradicts | contacts.is_borne
    mean = np.where(says, _FORGETTING * mean + (1.0 - _FORGETTING) * contacts.contradicts, _NOTHING_SAID * mean)
    new[own] = mean[thing]
    return new


def steadied(memory: RoadMemory, road: Floats | None, epipole_y: float) -> Floats | None:
    """The road (3,) of this frame with those of the last ones: where it is far, one frame errs by a car's height.

    The road lies steadily below our way, not in the picture: its horizon is taken from the epipole on.
    """
    if road is None or memory.plane is None:
        return road
    before = _along_our_way(memory.plane, memory.epipole_y)
    horizon, tilt, slope = before + (1.0 - _ROAD_FORGETTING) * (_along_our_way(road, epipole_y) - before)
    return np.array([-slope * (epipole_y + horizon), slope * tilt, slope])


def _along_our_way(road: Floats, epipole_y: float) -> Floats:
    """Height of the horizon below the epipole, fall to the right, and rate a tangent below the horizon: (3,)."""
    return np.array([-road[0] / road[2] - epipole_y, road[1] / road[2], road[2]])


def find_road(fit: PathFit, in_scene: Bools, epipole_y: float) -> Floats | None:
    """The road as the plane ``rate = p0 + p1 x + p2 y``: (3,) in 1/s, None where there is none.

    A plane has inverse depths that are affine in the picture. The densest rates below each of some horizons about the
    epipole, then least squares with those points.

    Parameters
    ----------
    fit : of N points on the path of the scene; ``in_scene (N,)`` those that may lie on the road.
    """
    index = np.flatnonzero(_may_be_road(fit, in_scene, epipole_y))
    if len(index) < _LEAST_POINTS:
        return None
    place, rate = fit.place[index], fit.rate_hz[index]
    weight = _share_of_cell(place)
    horizon_y = epipole_y + np.linspace(-_PITCH, _PITCH, _N_HORIZONS)
    below = place[:, 1] - horizon_y[:, None]
    log_slope = np.where(below > LEAST_BELOW, np.log(rate) - np.log(np.maximum(below, LEAST_BELOW)), np.inf)
    order = np.argsort(log_slope, axis=1, kind="stable")
    densest, log_slope_there = _densest(np.take_along_axis(log_slope, order, axis=1), weight[order])
    if densest < 0:
        return None
    slope = float(np.exp(log_slope_there + _ROAD_SPREAD))
    road: Floats | None = np.array([-slope * horizon_y[densest], 0.0, slope])
    for _ in range(2):
        road = None if road is None else _fitted_plane(place, rate, weight, road)
    return road if road is not None and _is_level(road, epipole_y) else None


def _share_of_cell(place: Floats) -> Floats:
    """Weight of each point (N,): one for each part of the picture, since a car has more corners than the road has."""
    cell = picture_region(np.column_stack([place, np.ones(len(place))]), _CELL)
    return np.asarray(1.0 / np.bincount(cell)[cell])


def _may_be_road(fit: PathFit, in_scene: Bools, epipole_y: float) -> Bools:
    """Points (N,) of the scene below any horizon, of a known rate."""
    is_rated = in_scene & (fit.n_views >= _LEAST_VIEWS) & (fit.rate_sigma_hz < _KNOWN_PART * fit.rate_hz)
    return np.asarray(is_rated & (fit.place[:, 1] > epipole_y - _PITCH + LEAST_BELOW))


def _fitted_plane(place: Floats, rate: Floats, weight: Floats, road: Floats) -> Floats | None:
    """The plane (3,) of the points that lie on a ``road (3,)``, None where these are too few.

    Too few of them, or with too small a part of the ``weight (N,)`` of all below the horizon. Least squares of rates
    over what the road before has there, with a prior on the roll.
    """
    columns = np.column_stack([np.ones(len(place)), place])
    predicted = columns @ road
    is_on_road = np.abs(rate - predicted) < 1.5 * _ROAD_SPREAD * predicted
    below = weight[predicted > LEAST_BELOW * road[2]].sum()
    if np.count_nonzero(is_on_road) < _LEAST_POINTS or weight[is_on_road].sum() < _LEAST_SHARE * below:
        return None
    columns = columns[is_on_road] / predicted[is_on_road, None]
    normal = columns.T @ columns
    normal[1, 1] += normal[2, 2] * _ROLL_SIGMA**2
    return np.asarray(np.linalg.solve(normal, columns.T @ (rate[is_on_road] / predicted[is_on_road])))


def _is_level(road: Floats, epipole_y: float) -> bool:
    """Whether a plane (3,) comes nearer downwards as a road does: it ends in a horizon, about where we go.

    A wall fits a road for as long as it is low; but its rates hardly change downwards, and its horizon is high above.
    """
    return bool(road[2] > 0.0 and abs(-road[0] / road[2] - epipole_y) < _HORIZON_OFF)


def _densest(log_slope: Floats, weight: Floats) -> tuple[int, float]:
    """Which row of ``(H, N)`` holds the densest interval of 2 `_ROAD_SPREAD`, and where it starts; -1 without any.

    Rows are ascending, with infinity where there is no point, and have a ``weight (H, N)`` each. What lies too far
    under the interval counts against it.
    """
    is_point = np.isfinite(log_slope)
    before = np.pad(np.cumsum(np.where(is_point, weight, 0.0), axis=1), ((0, 0), (1, 0)))
    support = np.zeros(log_slope.shape)
    for row in np.flatnonzero(np.count_nonzero(is_point, axis=1) >= _LEAST_POINTS):
        start = log_slope[row, is_point[row]]
        end = np.searchsorted(start, start + 2.0 * _ROAD_SPREAD)
        under = np.searchsorted(start, start + _ROAD_SPREAD + np.log(_UNDER_PART))
        support[row, : len(start)] = before[row, end] - before[row, : len(start)] - before[row, under]
    row, place = np.unravel_index(np.argmax(support), support.shape)
    return (int(row), float(log_slope[row, place])) if support[row, place] > 0.0 else (-1, 0.0)


def on_road(fit: PathFit, memory: RoadMemory) -> Bools:
    """Points at the depth of the road where they are seen: (N,); none where no road is known."""
    if memory.plane is None:
        return np.zeros(len(fit.rate_hz), dtype=bool)
    return np.asarray(np.abs(fit.rate_hz / _rate_of_road(fit, memory.plane) - 1.0) < _ON_ROAD)


def _rate_of_road(fit: PathFit, road: Floats) -> Floats:
    """Rate of the road where each point is seen: (N,), NaN at the horizon and above."""
    rate = road[0] + fit.place @ road[1:]
    return np.where(rate > LEAST_BELOW * road[2], rate, np.nan)
