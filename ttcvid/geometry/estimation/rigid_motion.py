"""Points of rigid things on their paths relative to the camera, and the paths corrected by where the points were seen.

The static scene and every mover are treated alike: a thing at rest in its own frame, seen from a camera that moves past
it. Its points share, for each past view, one rotation and one shift, and have a depth each:
a point at (x, y, 1) now was at (x + rho T_x, y + rho T_y, 1 + rho T_z), up to its depth, when the thing was at T.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from ttcvid.geometry.kernels.newest_view import predict_newest
from ttcvid.geometry.kernels.path_point import LANES
from ttcvid.geometry.kernels.rigid_points import correct_ways, fit_rigid_points
from ttcvid.geometry.medians import medians
from ttcvid.model import Bools, Floats, Ints

# Gauss-Newton steps on a point from its last rate, at most: the path changes little between two frames.
_MOST_STEPS = 2
# Weight of a point falls to a half where its misfit is so many times the typical one, which counts as that at least.
# Not single residuals: where a path is wrong, all of a view are large.
_HALF_WEIGHT, _LEAST_TYPICAL_REDCHI = 2.0, 0.25


@dataclass(frozen=True)
class RigidPaths:
    """How K rigid things moved relative to the camera over L views, each up to the scale of its path.

    ``cam_R_past (K, L, 3, 3)`` turns a ray of view l into the present camera as if the thing had not turned since;
    ``path (K, L, 3)`` is where it was, less where it is now, in s of its speed.
    """

    cam_R_past: Floats
    path: Floats

    def __len__(self) -> int:
        return len(self.path)

    def take(self, index: Ints | Bools) -> RigidPaths:
        """The things that an index array or a mask picks."""
        return RigidPaths(self.cam_R_past[index], self.path[index])

    def over(self, view: Bools) -> RigidPaths:
        """The same things over those of the views that a mask (L,) picks."""
        return RigidPaths(self.cam_R_past[:, view], self.path[:, view])

    def joined(self, other: RigidPaths) -> RigidPaths:
        """These things and others."""
        return RigidPaths(np.concatenate([self.cam_R_past, other.cam_R_past]), np.concatenate([self.path, other.path]))


@dataclass(frozen=True)
class Points:
    """M points, each of one of K things: which of the N tracks and which thing, ``track, thing (M,)``.

    ``rays (N, 3, M)`` unit rays of the tracks, each in the camera of its view (`views_by_track`); ``sigma_norm
    (N,)`` standard deviation of one coordinate in the plane z = 1; ``since_s (L,)`` times relative to the present view,
    the last one, s.
    """

    rays: Floats
    sigma_norm: Floats
    since_s: Floats
    track: Ints
    thing: Ints


@dataclass(frozen=True)
class PathFit:
    """M points, each on the path of its thing.

    ``place (M, 2)`` now, in the plane z = 1; ``rate_hz (M,)`` rho with its standard deviation ``rate_sigma_hz (M,)``;
    ``redchi (M,)`` robust chi-square over its degrees of freedom, about 1 for a point that moves along the path;
    ``n_views (M,)``. NaN (misfit: 0) with fewer than two views.
    """

    place: Floats
    rate_hz: Floats
    rate_sigma_hz: Floats
    redchi: Floats
    n_views: Ints

    def take(self, index: Ints) -> PathFit:
        """The points that an index array picks."""
        return PathFit(*(getattr(self, f.name)[index] for f in fields(self)))


@dataclass(frozen=True)
class PathPriors:
    """How views may leave what is expected of them: Gaussian, by view.

    ``cam_R_past (L, 3, 3)`` are the rotations expected, with ``turn_sigma_rad (L,)``, None: those that each step starts
    from; a path is expected to be straight and steady, within ``shift_sigma (L,)`` of its length.
    """

    cam_R_past: Floats | None
    turn_sigma_rad: Floats
    shift_sigma: Floats


def views_by_track(rays: Floats) -> Floats:
    """The views of each track side by side, for `Points`: ``(N, 3, M)`` from ``rays (L, N, 3)``.

    NaN where not observed. M is L, filled up with unobserved views, the first ones, to a multiple of `LANES`.
    """
    n_views, n = rays.shape[:2]
    by_track = np.empty((n, 3, -(-n_views // LANES) * LANES))
    first = by_track.shape[2] - n_views
    by_track[..., :first], by_track[..., first:] = np.nan, rays.transpose(1, 2, 0)
    return by_track


def fit_on_paths(
    points: Points, paths: RigidPaths, rate_hz: Floats | None = None, least_rate_hz: float | Floats = 0.0
) -> PathFit:
    """Place and rate of each point, and how badly the path of its thing explains all of its views.

    In contrast to `whole_track_on_path` no view is left out: the question is not when the point arrives, but whether
    it belongs to the thing.

    Parameters
    ----------
    rate_hz : (M,) rates to start from; None or NaN: none.
    least_rate_hz : rates stay above it, one for all or (M,): nothing lies behind the camera, and points of one thing
        lie side by side.

    Source: DESIGN section 3 (w_i = s_i e).
    """
    return _fit_on_ways(points, ways_of(paths, points.rays.shape[2]), rate_hz, least_rate_hz)


def _fit_on_ways(
    points: Points, ways: Floats, rate_hz: Floats | None = None, least_rate_hz: float | Floats = 0.0
) -> PathFit:
    """As `fit_on_paths`, with the ``ways (K, 12, M)`` of `ways_of`."""
    m = len(points.track)
    place, rate, sigma, redchi = np.empty((m, 2)), np.empty(m), np.empty(m), np.empty(m)
    n_views = np.empty(m, dtype=np.int64)
    least = least_rate_hz if isinstance(least_rate_hz, np.ndarray) else np.full(m, least_rate_hz)
    fit_rigid_points(
        points.rays,
        points.track,
        points.thing,
        ways,
        points.sigma_norm,
        (np.zeros(m) if rate_hz is None else rate_hz, least),
        2 * _MOST_STEPS if rate_hz is None else _MOST_STEPS,
        (place, rate, sigma, redchi, n_views),
    )
    return PathFit(place, rate, sigma, redchi, n_views)


@dataclass(frozen=True)
class Surprise:
    """How far M points are now from where they were to be expected.

    ``off (M, 2)`` of where the path of its thing leads each, in the plane z = 1; ``chi2 (M,)`` of that, with two
    degrees of freedom, ``line_chi2 (M,)`` of where its own course over the last views leads; ``past_redchi (M,)``
    reduced chi-square of the earlier views on the path. 0 where these say nothing. ``is_past_off (M, L)`` views that
    are displaced, the last one not: most others lie on the path, later ones among them.
    """

    off: Floats
    chi2: Floats
    line_chi2: Floats
    past_redchi: Floats
    is_past_off: Bools


def surprise_of_newest(points: Points, paths: RigidPaths, rate_hz: Floats) -> Surprise:
    """How far the points are now from where their earlier views lead; ``rate_hz (M,)`` to start from, NaN: none."""
    m, n_lanes = len(points.track), points.rays.shape[2]
    chi2, line_chi2, past_redchi = np.empty((3, m))
    found = Surprise(np.empty((m, 2)), chi2, line_chi2, past_redchi, np.zeros((m, n_lanes), dtype=bool))
    ways, filled = ways_of(paths, n_lanes), (found.off, chi2, line_chi2, past_redchi, found.is_past_off)
    predict_newest(points.rays, points.track, points.thing, ways, points.sigma_norm, points.since_s, rate_hz, filled)
    return replace(found, is_past_off=found.is_past_off[:, n_lanes - len(points.since_s) :])


def ways_of(paths: RigidPaths, n_views: int) -> Floats:
    """Rotation and path in each of M views, side by side: ``(K, 12, M)``; what is left over of M stands first."""
    ways = np.zeros((len(paths), 12, n_views))
    since = n_views - paths.path.shape[1]
    ways[:, :9, since:] = paths.cam_R_past.reshape(len(paths), -1, 9).transpose(0, 2, 1)
    ways[:, 9:, since:] = paths.path.transpose(0, 2, 1)
    return ways


def weights_by_redchi(points: Points, fit: PathFit, weight: Floats, n_things: int) -> tuple[Floats, Bools]:
    """The ``weight`` (M,) of points, less with an unusual misfit, 0 without a rate; and which things have any, (K,)."""
    has_rate = np.isfinite(fit.rate_hz)
    of_used = np.where(has_rate & (weight > 0.0), fit.redchi, np.nan)
    typical = np.maximum(medians(of_used, points.thing, n_things), _LEAST_TYPICAL_REDCHI)
    return np.where(has_rate, weight / (1.0 + fit.redchi / (_HALF_WEIGHT * typical[points.thing])), 0.0), np.isfinite(
        typical
    )


def refined_paths(
    points: Points,
    paths: RigidPaths,
    priors: PathPriors,
    n_steps: Ints,
    weight: Floats | None = None,
    rate_hz: Floats | None = None,
) -> tuple[RigidPaths, Floats]:
    """The paths as their points show them: the points on the paths and then each past view by its points, in turn.

    Robust least squares with six unknowns a view; points with an unusual misfit weigh less. A path keeps its length, a
    thing without points its motion. Returns the paths, and the rate of each point, (M,).

    Parameters
    ----------
    n_steps : (K,) of each thing.
    weight : (M,) of each point, 0 leaves it out; None: all alike.
    rate_hz : (M,) rates to start from; None or NaN: none.
    """
    weight = np.ones(len(points.track)) if weight is None else weight
    rate = np.zeros(len(points.track)) if rate_hz is None else rate_hz.copy()
    is_left, ways = np.ones(len(paths), dtype=bool), ways_of(paths, points.rays.shape[2])
    expected = np.empty((0, 3, 3)) if priors.cam_R_past is None else priors.cam_R_past
    of_views = points.since_s, expected, priors.turn_sigma_rad**-2.0, priors.shift_sigma**-2.0
    for step in range(n_steps.max(initial=0)):
        is_left &= n_steps > step
        some = np.flatnonzero(is_left[points.thing])
        members = replace(points, track=points.track[some], thing=points.thing[some])
        fit = _fit_on_ways(members, ways, rate[some])
        rate[some] = fit.rate_hz
        used, has_points = weights_by_redchi(members, fit, weight[some], len(paths))
        is_left &= has_points
        if not is_left.any():
            break
        of_points = fit.place, fit.rate_hz, used
        correct_ways(points.rays, members.track, members.thing, ways, points.sigma_norm, of_points, is_left, of_views)
    return _paths_of(ways, len(points.since_s)), rate


def _paths_of(ways: Floats, n_views: int) -> RigidPaths:
    """The paths over the last ``n_views`` of the views of `ways_of`."""
    by_view = ways[..., ways.shape[2] - n_views :].transpose(0, 2, 1)
    turned = by_view[..., :9].reshape(len(ways), n_views, 3, 3)
    # One step of Newton's towards the nearest rotation: products that go on for ever cease to be some.
    turned = turned @ (1.5 * np.eye(3) - 0.5 * turned.swapaxes(2, 3) @ turned)
    return RigidPaths(turned, np.ascontiguousarray(by_view[..., 9:]))
