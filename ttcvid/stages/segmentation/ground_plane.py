"""The ground plane, and its evidence against static tracks: movers along our own direction.

Such a mover looks like a static object at another depth, which would lie under the ground plane or hang over it
(`stages.segmentation.ground_contact`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np

from ttcvid.geometry.estimation.rigid_motion import PathFit
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.egomotion.relative_pose import picture_region
from ttcvid.stages.segmentation.body_views import BodyViews
from ttcvid.stages.segmentation.ground_contact import ON_ROAD, Contacts, OnGround, find_contacts
from ttcvid.stages.tracking.groups import places_among

# Our direction of travel is parallel to the ground plane: its horizon is within twice this standard deviation (tangent)
# of the epipole, for errors of the epipole, bumps and hills. Number of horizons that are tried within it.
_HORIZON_SIGMA, _N_HORIZONS = 0.01, 5
_HORIZON_OFF = 2.0 * _HORIZON_SIGMA
LEAST_BELOW = 0.03
"""Least distance below the horizon (tangent) of points that determine the ground plane, and that it gives speed for."""
OWN_HALF_WIDTH = 0.7
"""Half of our own width in heights of the camera above the road: 0.9 m of 1.3 m in cars, alike in vans and lorries."""
# Largest relative standard deviation of an inverse depth that counts.
_KNOWN_PART = 0.1
# Inverse depths of road points agree within this natural logarithm; a point with less than this share of the road's
# inverse depth would lie under it, and counts against it.
_ROAD_SPREAD, _UNDER_PART = 0.08, 0.75
# Points are weighted to equal totals per square of this side (tangent, 3 deg).
_CELL = 0.05
# Least number of tracks on a ground plane, and their least share of the weight of all below the horizon.
_LEAST_TRACKS, _LEAST_SHARE = 12, 0.3
# The plane is fitted to observations of this time, s, and to at most so many: older ones are thinned out.
_SEEN_FOR_S, _MOST_SEEN = 1.0, 500
# Prior standard deviation of the roll between camera and road, rad.
_ROLL_SIGMA = 0.1
_LEAST_VIEWS = 4
# Evidence decays by the first factor per frame, by the second while an object is not observed against the ground plane
# (a road without texture).
_FORGETTING, _NOTHING_SAID = 0.8, 0.97


@dataclass(frozen=True)
class RoadPoints:
    """M observations of the last frames that may be points of the ground plane.

    place : ``(M, 2)`` in the plane z = 1, relative to our direction of travel: there the ground plane is steady.
    rate_hz : ``(M,)`` inverse depth, 1/s.
    weight : ``(M,)`` with a total of one per square of the image of a frame.
    track_id, t_s : ``(M,)`` track, and time, s.
    """

    place: Floats = field(default_factory=lambda: np.empty((0, 2)))
    rate_hz: Floats = field(default_factory=lambda: np.empty(0))
    weight: Floats = field(default_factory=lambda: np.empty(0))
    track_id: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    t_s: Floats = field(default_factory=lambda: np.empty(0))

    def and_now(self, now: RoadPoints, now_s: float) -> RoadPoints:
        """With those of the present frame, without those seen too long ago."""
        stay = np.flatnonzero(self.t_s > now_s - _SEEN_FOR_S)
        step = 1 + (len(stay) + len(now.t_s)) // _MOST_SEEN
        parts = ((getattr(self, one.name)[stay], getattr(now, one.name)) for one in fields(self))
        return RoadPoints(*(np.concatenate(both)[::step] for both in parts))


@dataclass(frozen=True)
class RoadMemory:
    """Ground plane of a frame, and evidence of tracks against it.

    track_id, evidence : ``(N,)`` evidence of each track against being static, in 0 to 1, by its ground contact.
    by_speed : ``(N,)`` evidence by a change of its speed (`stages.segmentation.speed_changes`).
    plane : ``(3,)`` as from `find_road`; None: not found.
    seen : what it was fitted to.
    """

    track_id: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    evidence: Floats = field(default_factory=lambda: np.empty(0))
    by_speed: Floats = field(default_factory=lambda: np.empty(0))
    plane: Floats | None = None
    seen: RoadPoints = field(default_factory=RoadPoints)

    @property
    def against_scene(self) -> Floats:
        """Evidence ``(N,)`` against being static, of either kind."""
        return np.maximum(self.evidence, self.by_speed)


def gathered_evidence(
    memory: RoadMemory, track_id: Ints, views: BodyViews, fit: PathFit, key: Ints, in_scene: Bools, aim: Floats
) -> RoadMemory:
    """The memory with the ground plane and the evidence of this frame.

    ``fit`` of all N tracks on the trajectory of the scene, ``key (N,)`` their bodies, ``in_scene (N,)`` those that may
    be points of the ground plane; ``aim (2,)`` our direction of travel in the plane z = 1.
    """
    place = places_among(memory.track_id, track_id)
    is_known = place >= 0
    # `place` -1, of a new track, picks the last one.
    evidence = np.append(memory.evidence, 0.0)[place]
    by_speed = _FORGETTING * np.append(memory.by_speed, 0.0)[place]
    now_s = float(views.t_s[-1])
    seen = memory.seen.and_now(road_points(fit, in_scene, aim, track_id, now_s), now_s)
    road = find_road(seen, aim)
    if road is None:
        return RoadMemory(track_id, _FORGETTING * evidence, by_speed, None, seen)
    road_hz, slope_hz = road[0] + fit.place @ road[1:], float(road[2])
    nearest_hz = np.maximum(fit.rate_hz, np.maximum(road_hz, LEAST_BELOW * slope_hz))
    has_depth = fit.rate_sigma_hz < _KNOWN_PART * nearest_hz
    is_rated = views.is_free & (fit.n_views >= _LEAST_VIEWS) & has_depth
    ground = OnGround(fit.place, fit.rate_hz, fit.rate_sigma_hz, road_hz, slope_hz, is_rated, float(aim[0]))
    contacts = find_contacts(views.xy_px, views.link_px, ground, key)
    evidence = _shared_evidence(evidence, is_known & (fit.n_views > _LEAST_VIEWS), contacts)
    # A track that lies under the road by itself needs no others, and no frames before.
    evidence[ground.is_under & ~contacts.is_own] = 1.0
    return RoadMemory(track_id, evidence, by_speed, road, seen)


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


def road_points(fit: PathFit, in_scene: Bools, aim: Floats, track_id: Ints, now_s: float) -> RoadPoints:
    """Points of the scene, ``in_scene (N,)``, below all horizons tried, with a known inverse depth.

    ``fit, track_id (N,)`` of tracks on the trajectory of the scene; ``aim (2,)`` our direction of travel. Weights are
    per square of the image, since a car has more corners than the road.
    """
    is_rated = in_scene & (fit.n_views >= _LEAST_VIEWS) & (fit.rate_sigma_hz < _KNOWN_PART * fit.rate_hz)
    index = np.flatnonzero(is_rated & (fit.place[:, 1] > aim[1] - _HORIZON_OFF + LEAST_BELOW))
    place = fit.place[index] - aim
    cell = picture_region(np.column_stack([place, np.ones(len(place))]), _CELL)
    weight = 1.0 / np.bincount(cell)[cell]
    return RoadPoints(place, fit.rate_hz[index], weight, track_id[index], np.full(len(index), now_s))


def find_road(seen: RoadPoints, aim: Floats) -> Floats | None:
    """The ground plane as ``inverse depth = p0 + p1 x + p2 y``: ``(3,)`` in 1/s, None where there is none.

    The inverse depth of a plane is affine in the image. The densest interval of inverse depths over some horizons about
    our direction of travel, ``aim (2,)`` in the plane z = 1, is the start of a least-squares fit.
    """
    if len({*seen.track_id.tolist()}) < _LEAST_TRACKS:
        return None
    horizon_y = np.linspace(-_HORIZON_OFF, _HORIZON_OFF, _N_HORIZONS)
    below = seen.place[:, 1] - horizon_y[:, None]
    log_slope = np.where(below > LEAST_BELOW, np.log(seen.rate_hz) - np.log(np.maximum(below, LEAST_BELOW)), np.inf)
    order = np.argsort(log_slope, axis=1, kind="stable")
    densest, log_slope_there = _densest(np.take_along_axis(log_slope, order, axis=1), seen.weight[order])
    if densest < 0:
        return None
    slope = float(np.exp(log_slope_there + _ROAD_SPREAD))
    road: Floats | None = np.array([-slope * horizon_y[densest], 0.0, slope])
    for _ in range(2):
        road = None if road is None else _fitted_plane(seen, road)
    # A low wall may fit, but its inverse depth hardly changes downwards, so that its horizon is far above.
    if road is None or road[2] <= 0.0 or abs(road[0]) > _HORIZON_OFF * road[2]:
        return None
    return np.array([road[0] - road[1:] @ aim, road[1], road[2]])


def _fitted_plane(seen: RoadPoints, road: Floats) -> Floats | None:
    """Least-squares plane ``(3,)`` of the points on ``road (3,)``, with a prior on the roll; None with too few of them.

    Residuals are relative to the inverse depth of ``road``. Too few: by number of tracks, or by their share of the
    weight of all points below the horizon.
    """
    columns = np.column_stack([np.ones(len(seen.place)), seen.place])
    predicted = columns @ road
    is_on_road = np.abs(seen.rate_hz - predicted) < 1.5 * _ROAD_SPREAD * predicted
    below = seen.weight[predicted > LEAST_BELOW * road[2]].sum()
    n_tracks, on_road = len({*seen.track_id[is_on_road].tolist()}), seen.weight[is_on_road].sum()
    if n_tracks < _LEAST_TRACKS or on_road < _LEAST_SHARE * below:
        return None
    columns = columns[is_on_road] / predicted[is_on_road, None]
    normal = columns.T @ columns
    normal[1, 1] += normal[2, 2] * _ROLL_SIGMA**2
    return np.asarray(np.linalg.solve(normal, columns.T @ (seen.rate_hz[is_on_road] / predicted[is_on_road])))


def _densest(log_slope: Floats, weight: Floats) -> tuple[int, float]:
    """Row of ``log_slope (H, N)`` with the densest interval of 2 `_ROAD_SPREAD`, and its start; -1 without any.

    Rows are ascending, infinite where there is no point. Support is the ``weight (H, N)`` within the interval, less
    that of points too far below it, which would lie under the road.
    """
    is_point = np.isfinite(log_slope)
    n_rows, n = log_slope.shape
    before, support = np.zeros((n_rows, n + 1)), np.zeros((n_rows, n))
    np.cumsum(np.where(is_point, weight, 0.0), axis=1, out=before[:, 1:])
    for row in range(n_rows):
        start = log_slope[row, : np.count_nonzero(is_point[row])]
        end = np.searchsorted(start, start + 2.0 * _ROAD_SPREAD)
        under = np.searchsorted(start, start + _ROAD_SPREAD + np.log(_UNDER_PART))
        support[row, : len(start)] = before[row, end] - before[row, : len(start)] - before[row, under]
    best, place = np.unravel_index(np.argmax(support), support.shape)
    return (int(best), float(log_slope[best, place])) if support[best, place] > 0.0 else (-1, 0.0)


def on_road(fit: PathFit, memory: RoadMemory) -> Bools:
    """Whether points ``(N,)`` have the inverse depth of the ground plane; none without a plane."""
    if memory.plane is None:
        return np.zeros(len(fit.rate_hz), dtype=bool)
    road_hz = memory.plane[0] + fit.place @ memory.plane[1:]
    is_below = road_hz > LEAST_BELOW * memory.plane[2]
    return np.asarray(is_below & (np.abs(fit.rate_hz - road_hz) < ON_ROAD * road_hz))
