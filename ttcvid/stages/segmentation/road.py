"""The road: a plane that may bend along our way, fitted to points of the scene below the horizon."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace

import numpy as np

from ttcvid.geometry.estimation.rigid_motion import PathFit
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.egomotion.relative_pose import picture_region

# Our direction of travel is parallel to the road: its horizon is within twice this standard deviation (tangent) of the
# epipole, for errors of the epipole, bumps and hills. Number of horizons that are tried within it.
_HORIZON_SIGMA, _N_HORIZONS = 0.01, 5
_HORIZON_OFF = 2.0 * _HORIZON_SIGMA
# Points that by themselves say another horizon, so many standard deviations off, are no road.
_CONTRADICTS = 3.0
LEAST_BELOW = 0.03
"""Least distance below the horizon (tangent) of points that determine the road, and that it gives speed for."""
OWN_HALF_WIDTH = 0.7
"""Half of our own width in heights of the camera above the road: 0.9 m of 1.3 m in cars, alike in vans and lorries."""
KNOWN_PART, LEAST_VIEWS = 0.1, 4
"""Largest relative standard deviation of an inverse depth that counts, and least number of views of its track."""
# Inverse depths of road points agree within this natural logarithm; a point with less than this share of the road's
# inverse depth would lie under it, and counts against it.
_ROAD_SPREAD, _UNDER_PART = 0.08, 0.75
# A point may be on the road if its inverse depth is within this share of the road's.
_ON_ROAD = 0.2
# Points are weighted to equal totals per square of this side (tangent, 3 deg).
_CELL = 0.05
# Least number of tracks on a road, and their least share of the weight of all below the horizon.
_LEAST_TRACKS, _LEAST_SHARE = 12, 0.3
# The road is fitted to observations of this time, s, and to at most so many: older ones are thinned out.
_SEEN_FOR_S, _MOST_SEEN = 1.0, 500
# Prior standard deviations of the roll between camera and road, rad, and of `Road.bend`, 1 / (2 R): that of a crest of
# 2500 camera heights.
_ROLL_SIGMA, _BEND_SIGMA = 0.1, 2e-4
# A road is uneven: its points lie off it by the first tangent. A bump tilts the camera by the second, for a frame.
_UNEVEN, _BUMP_SIGMA = 0.01, 0.002
# Least reduced chi-square of the points: where they agree better than modelled, the covariance shrinks by no more.
_LEAST_REDCHI = 0.05
_TINY = 1e-9


@dataclass(frozen=True)
class RoadPoints:
    """M observations of the last frames that may be points of the road.

    place : ``(M, 2)`` in the plane z = 1, relative to our direction of travel: there the road is steady.
    rate_hz : ``(M,)`` inverse depth, 1/s.
    weight : ``(M,)`` with a total of one per square of the image of a frame.
    track_id, t_s : ``(M,)`` track, and time, s.
    """

    place: Floats = field(default_factory=lambda: np.empty((0, 2)))
    rate_hz: Floats = field(default_factory=lambda: np.empty(0))
    weight: Floats = field(default_factory=lambda: np.empty(0))
    track_id: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    t_s: Floats = field(default_factory=lambda: np.empty(0))

    @classmethod
    def of(cls, fit: PathFit, in_scene: Bools, aim: Floats, track_id: Ints, now_s: float) -> RoadPoints:
        """Points of the scene, ``in_scene (N,)``, below all horizons tried, with a known inverse depth.

        ``fit, track_id (N,)`` of tracks on the trajectory of the scene; ``aim (2,)`` our direction of travel. Weights
        are per square of the image, since a car has more corners than the road.
        """
        is_rated = in_scene & (fit.n_views >= LEAST_VIEWS) & (fit.rate_sigma_hz < KNOWN_PART * fit.rate_hz)
        index = np.flatnonzero(is_rated & (fit.place[:, 1] > aim[1] - _HORIZON_OFF + LEAST_BELOW))
        place = fit.place[index] - aim
        cell = picture_region(np.column_stack([place, np.ones(len(place))]), _CELL)
        weight = 1.0 / np.bincount(cell)[cell]
        return cls(place, fit.rate_hz[index], weight, track_id[index], np.full(len(index), now_s))

    def and_now(self, now: RoadPoints, now_s: float) -> RoadPoints:
        """With those of the present frame, without those seen too long ago."""
        stay = np.flatnonzero(self.t_s > now_s - _SEEN_FOR_S)
        step = 1 + (len(stay) + len(now.t_s)) // _MOST_SEEN
        parts = ((getattr(self, one.name)[stay], getattr(now, one.name)) for one in fields(self))
        return RoadPoints(*(np.concatenate(both)[::step] for both in parts))


@dataclass(frozen=True)
class Road:
    """A plane that bends along our way, seen in the plane z = 1.

    plane : ``(3,)`` of its tangential plane below us: the inverse depth at (x, y) is p0 + p1 x + p2 y, 1/s.
    bend : k: at depth Z the road lies k Z^2 below that plane, both in heights of the camera; positive over a crest,
        negative in a hollow.
    cov : ``(4, 4)`` covariance of ``plane`` and of ``slope_hz * bend``, 1/s^2.
    """

    plane: Floats
    bend: float = 0.0
    cov: Floats = field(default_factory=lambda: np.zeros((4, 4)))

    @property
    def slope_hz(self) -> float:
        """Growth of the inverse depth per tangent downwards, 1/s: our speed in heights of the camera."""
        return float(self.plane[2])

    def below(self, place: Floats) -> Floats:
        """How far ``place (..., 2)`` is below the horizon of the tangential plane, a tangent."""
        return np.asarray((self.plane[0] + place @ self.plane[1:]) / self.plane[2])

    def rate_hz(self, place: Floats) -> Floats:
        """Inverse depth of the road that is seen at ``place (..., 2)``, 1/s; negative above its horizon: none is known.

        Where a crest hides it, half of that of the tangential plane. A hollow may be seen above the horizon, but no
        point of it that would say so.
        """
        below = self.below(place)
        # What is seen at a tangent Y has u = 1 / Z with u + k / u = Y.
        bent = 0.5 * (below + np.sqrt(np.maximum(below**2 - 4.0 * self.bend, 0.0)))
        return np.asarray(self.slope_hz * np.where(below > 0.0, bent, below))

    def sigma_hz(self, place: Floats) -> Floats:
        """Standard deviation ``(N,)`` of `rate_hz` at ``place (N, 2)``, bumps included, 1/s."""
        columns = self.columns(place)
        variance = np.einsum("ni,ij,nj->n", columns, self.cov, columns) + (_BUMP_SIGMA * self.slope_hz) ** 2
        # As the error moves u, it moves k / u as well.
        return np.asarray(np.sqrt(variance) / np.maximum(1.0 - self.bend * columns[:, 3] ** 2, _TINY))

    def heights(self, place: Floats, rate_hz: Floats) -> Floats:
        """Heights ``(N,)`` over the road of points with these inverse depths, in heights of the camera."""
        inverse = np.maximum(rate_hz / self.slope_hz, _TINY)
        return np.asarray(1.0 + self.bend / inverse**2 - self.below(place) / inverse)

    def columns(self, place: Floats) -> Floats:
        """Columns ``(N, 4)`` of ``plane`` and ``slope_hz * bend`` in `rate_hz`, with the present one in k / u."""
        inverse = np.maximum(self.rate_hz(place) / self.slope_hz, LEAST_BELOW)
        return np.column_stack([np.ones(len(place)), place, -1.0 / inverse])

    def at_speed(self, speed: float) -> Road:
        """The road with its rates in another unit of speed: ``speed`` is that of the present one."""
        return replace(self, plane=speed * self.plane, cov=speed**2 * self.cov)


def may_be_road(rate_hz: Floats, road_hz: Floats) -> Bools:
    """Whether points ``(N,)`` may be on the road, by their inverse depths and those of the road there."""
    return np.asarray(np.abs(rate_hz - road_hz) < _ON_ROAD * road_hz)


def on_road(fit: PathFit, road: Road | None) -> Bools:
    """Whether points ``(N,)`` may be on the road that was found, surely below its horizon; none without one."""
    if road is None:
        return np.zeros(len(fit.rate_hz), dtype=bool)
    road_hz = road.rate_hz(fit.place)
    return (road_hz > LEAST_BELOW * road.slope_hz) & may_be_road(fit.rate_hz, road_hz)


def find_road(seen: RoadPoints, aim: Floats) -> Road | None:
    """The road of the points ``seen``; None where there is none.

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
    start = _fitted_road(seen, Road(np.array([-slope * horizon_y[densest], 0.0, slope])))
    road = None if start is None else _fitted_road(seen, start)
    if start is None or road is None or road.slope_hz <= 0.0 or abs(road.plane[0]) > _HORIZON_OFF * road.slope_hz:
        return None
    # A low wall may fit, but its inverse depth hardly changes downwards, so that its points want a horizon far above.
    # The chi-square between what they want and the prior is p0^2 / (variance of the prior - variance of the fit).
    told_hz2 = (_HORIZON_SIGMA * start.slope_hz) ** 2 - road.cov[0, 0]
    if road.plane[0] ** 2 > _CONTRADICTS**2 * told_hz2:
        return None
    # Places are relative to our direction of travel no longer.
    moved = np.eye(4)
    moved[0, 1:3] = -aim
    return replace(road, plane=moved[:3, :3] @ road.plane, cov=moved @ road.cov @ moved.T)


def _fitted_road(seen: RoadPoints, road: Road) -> Road | None:
    """Least-squares fit of the points on ``road``, with priors; None with too few of them.

    Too few: by number of tracks, or by their share of the weight of all points below the horizon.
    """
    predicted_hz = road.rate_hz(seen.place)
    index = np.flatnonzero(np.abs(seen.rate_hz - predicted_hz) < 1.5 * _ROAD_SPREAD * predicted_hz)
    weight_below = seen.weight[predicted_hz > LEAST_BELOW * road.slope_hz].sum()
    n_tracks, weight = len({*seen.track_id[index].tolist()}), seen.weight[index]
    if n_tracks < _LEAST_TRACKS or weight.sum() < _LEAST_SHARE * weight_below:
        return None
    # A track counts once, however often it is seen.
    weight = weight * (n_tracks / len(index))
    information = weight / np.hypot(_ROAD_SPREAD * predicted_hz[index], _UNEVEN * road.slope_hz) ** 2
    columns, rate_hz = road.columns(seen.place[index]), seen.rate_hz[index]
    prior = np.diag(np.array([_HORIZON_SIGMA, _ROLL_SIGMA, np.inf, _BEND_SIGMA]) ** -2.0) / road.slope_hz**2
    redchi = 1.0
    for _ in range(2):
        cov = np.linalg.inv((columns.T * information) @ columns / redchi + prior)
        found = cov @ (columns.T @ (information * rate_hz)) / redchi
        redchi = max(float(information @ (rate_hz - columns @ found) ** 2 / weight.sum()), _LEAST_REDCHI)
    return Road(found[:3], float(found[3] / found[2]), cov)


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
