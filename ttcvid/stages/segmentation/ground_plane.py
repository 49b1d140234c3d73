"""The ground plane, and its evidence against static tracks: movers along our own direction.

Such a mover looks like a static object at another depth, which would lie under the ground plane or hang over it
(`stages.segmentation.ground_contact`).
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

# Largest pitch of the camera against the road (tangent), and number of horizons that are tried within it.
_PITCH, _N_HORIZONS = 0.06, 13
LEAST_BELOW = 0.03
"""Least distance below the horizon (tangent) of points that determine the ground plane, and that it gives speed for."""
# Largest relative standard deviation of an inverse depth that counts.
_KNOWN_PART = 0.1
# Inverse depths of road points agree within this natural logarithm; a point with less than this share of the road's
# inverse depth would lie under it, and counts against it.
_ROAD_SPREAD, _UNDER_PART = 0.08, 0.75
# Points are weighted to equal totals per square of this side (tangent, 3 deg).
_CELL = 0.05
# Least number of points on a ground plane, and their least share of the weight of all below the horizon.
_LEAST_POINTS, _LEAST_SHARE = 12, 0.3
# Largest distance of the plane's horizon from the epipole (tangent): the pitch, and as much for its error.
_HORIZON_OFF = 2.0 * _PITCH
# Prior standard deviation of the roll between camera and road, rad.
_ROLL_SIGMA = 0.1
_LEAST_VIEWS = 4
# A point is on the road if its inverse depth is within this share of the road's.
_ON_ROAD = 0.2
# Evidence decays by the first factor per frame, by the second while an object is not observed against the ground plane
# (a road without texture). Above the last value a track contradicts the static scene.
_FORGETTING, _NOTHING_SAID, _ENOUGH = 0.8, 0.97, 0.5
# The ground plane, relative to our direction of travel, decays by this factor: it changes slowly.
_ROAD_FORGETTING = 0.85


@dataclass(frozen=True)
class RoadMemory:
    """Ground plane of a frame, and evidence of tracks against it.

    Attributes
    ----------
    track_id, evidence : ``(N,)`` evidence of each track against being static, in 0 to 1.
    plane : ``(3,)`` as from `find_road`, filtered over frames; None: not found.
    epipole_y : y of our direction of travel in the plane z = 1.
    """

    track_id: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    evidence: Floats = field(default_factory=lambda: np.empty(0))
    plane: Floats | None = None
    epipole_y: float = 0.0

    def in_units(self, speed: float) -> RoadMemory:
        """The memory in units of another speed: inverse depths are speed over depth, and shrink where we brake."""
        return self if self.plane is None else replace(self, plane=self.plane * speed)

    def contradicts(self) -> Bools:
        """Whether tracks ``(N,)`` contradict the static scene."""
        return np.asarray(self.evidence > _ENOUGH)


def gathered_evidence(
    memory: RoadMemory, track_id: Ints, views: BodyViews, fit: PathFit, key: Ints, in_scene: Bools, aim: Floats
) -> RoadMemory:
    """The memory with the ground plane and the evidence of this frame.

    Parameters
    ----------
    fit : of all N tracks on the trajectory of the scene.
    key : ``(N,)`` body of each track.
    in_scene : ``(N,)`` tracks that may be points of the ground plane.
    aim : ``(2,)`` our direction of travel in the plane z = 1.
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
    """Evidence ``(N,)``, equal over each object: mean of its older tracks, updated by its ground contact now."""
    own, new = np.flatnonzero(contacts.thing >= 0), _FORGETTING * evidence
    thing, n_things = contacts.thing[own], len(contacts.contradicts)
    count = np.bincount(thing, is_old[own], n_things)
    mean = np.bincount(thing, is_old[own] * evidence[own], n_things) / np.maximum(count, 1.0)
    says = contacts.contradicts | contacts.is_borne
    mean = np.where(says, _FORGETTING * mean + (1.0 - _FORGETTING) * contacts.contradicts, _NOTHING_SAID * mean)
    new[own] = mean[thing]
    return new


def steadied(memory: RoadMemory, road: Floats | None, epipole_y: float) -> Floats | None:
    """The ground plane ``(3,)`` filtered over frames: far ahead, a single frame errs by a car's height.

    It is steady relative to our direction of travel, not in the picture: its horizon is measured from the epipole.
    """
    if road is None or memory.plane is None:
        return road
    before = _along_our_way(memory.plane, memory.epipole_y)
    horizon, tilt, slope = before + (1.0 - _ROAD_FORGETTING) * (_along_our_way(road, epipole_y) - before)
    return np.array([-slope * (epipole_y + horizon), slope * tilt, slope])


def _along_our_way(road: Floats, epipole_y: float) -> Floats:
    """``(3,)``: horizon below the epipole, slope to the right, inverse depth at tangent 1 below the horizon."""
    return np.array([-road[0] / road[2] - epipole_y, road[1] / road[2], road[2]])


def find_road(fit: PathFit, in_scene: Bools, epipole_y: float) -> Floats | None:
    """The ground plane as ``inverse depth = p0 + p1 x + p2 y``: ``(3,)`` in 1/s, None where there is none.

    The inverse depth of a plane is affine in the image. The densest interval of inverse depths over some horizons about
    the epipole is the start of a least-squares fit.

    Parameters
    ----------
    fit : of N tracks on the trajectory of the scene.
    in_scene : ``(N,)`` tracks that may be points of the ground plane.
    epipole_y : y of our direction of travel in the plane z = 1.
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
    """Weights ``(N,)`` with a total of one per square of the image: a car has more corners than the road."""
    cell = picture_region(np.column_stack([place, np.ones(len(place))]), _CELL)
    return np.asarray(1.0 / np.bincount(cell)[cell])


def _may_be_road(fit: PathFit, in_scene: Bools, epipole_y: float) -> Bools:
    """Whether points ``(N,)`` belong to the scene, lie below all horizons tried, and have a known inverse depth."""
    is_rated = in_scene & (fit.n_views >= _LEAST_VIEWS) & (fit.rate_sigma_hz < _KNOWN_PART * fit.rate_hz)
    return np.asarray(is_rated & (fit.place[:, 1] > epipole_y - _PITCH + LEAST_BELOW))


def _fitted_plane(place: Floats, rate: Floats, weight: Floats, road: Floats) -> Floats | None:
    """Least-squares plane ``(3,)`` of the points on ``road (3,)``, with a prior on the roll; None with too few of them.

    Residuals are relative to the inverse depth of ``road``. Too few: by number, or by their share of the
    ``weight (N,)`` of all points below the horizon.
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
    """Whether a plane ``(3,)`` is level: its horizon is near our direction of travel.

    A low wall may fit, but its inverse depth hardly changes downwards, so that its horizon is far above.
    """
    return bool(road[2] > 0.0 and abs(-road[0] / road[2] - epipole_y) < _HORIZON_OFF)


def _densest(log_slope: Floats, weight: Floats) -> tuple[int, float]:
    """Row of ``log_slope (H, N)`` with the densest interval of 2 `_ROAD_SPREAD`, and its start; -1 without any.

    Rows are ascending, infinite where there is no point. Support is the ``weight (H, N)`` within the interval, less
    that of points too far below it, which would lie under the road.
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
    """Whether points ``(N,)`` have the inverse depth of the ground plane; none without a plane."""
    if memory.plane is None:
        return np.zeros(len(fit.rate_hz), dtype=bool)
    return np.asarray(np.abs(fit.rate_hz / _rate_of_road(fit, memory.plane) - 1.0) < _ON_ROAD)


def _rate_of_road(fit: PathFit, road: Floats) -> Floats:
    """Inverse depth of the ground plane at each point, 1/s: ``(N,)``, NaN at the horizon and above."""
    rate = road[0] + fit.place @ road[1:]
    return np.where(rate > LEAST_BELOW * road[2], rate, np.nan)
