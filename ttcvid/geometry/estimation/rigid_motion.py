"""Points of rigid things on their paths relative to the camera, and the paths corrected by where the points were seen.

The static scene and every mover are treated alike: a thing at rest in its own frame, seen from a camera that moves past
it. Its points share, for each past view, one rotation and one shift, and have a depth each:
a point at (x, y, 1) now was at (x + rho T_x, y + rho T_y, 1 + rho T_z), up to its depth, when the thing was at T.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from ttcvid.geometry.kernels.newest_view import predict_newest
from ttcvid.geometry.kernels.rigid_points import LANES, N_EQUATIONS, add_turns_and_shifts, fit_rigid_points
from ttcvid.geometry.kernels.solve import solve_each
from ttcvid.geometry.medians import medians
from ttcvid.geometry.rotation import rotation_from_vector, vector_from_rotation
from ttcvid.model import Bools, Floats, Ints

# Gauss-Newton steps on a point from its last rate, at most: the path changes little between two frames.
_N_STEPS = 2
# Weight of a point falls to a half where its misfit is twice the typical one, which counts as this at the least. Not
# single residuals: where a path is wrong, all of a view are large.
_HALF_WEIGHT, _LEAST_TYPICAL_MISFIT = 2.0, 0.25
# Paths shorter than this have no scale to keep.
_NO_LENGTH = 1e-9


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
    ``misfit (M,)`` robust chi-square over its degrees of freedom, about 1 for a point that moves along the path;
    ``n_views (M,)``. NaN (misfit: 0) with fewer than two views.
    """

    place: Floats
    rate_hz: Floats
    rate_sigma_hz: Floats
    misfit: Floats
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
    by_track = np.full((n, 3, -(-n_views // LANES) * LANES), np.nan)
    by_track[..., by_track.shape[2] - n_views :] = rays.transpose(1, 2, 0)
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
    m = len(points.track)
    place, rate, sigma, misfit = np.empty((m, 2)), np.empty(m), np.empty(m), np.empty(m)
    n_views = np.empty(m, dtype=np.int64)
    least = least_rate_hz if isinstance(least_rate_hz, np.ndarray) else np.full(m, least_rate_hz)
    fit_rigid_points(
        points.rays,
        points.track,
        points.thing,
        ways_of(paths, points.rays.shape[2]),
        points.sigma_norm,
        (np.zeros(m) if rate_hz is None else rate_hz, least),
        2 * _N_STEPS if rate_hz is None else _N_STEPS,
        (place, rate, sigma, misfit, n_views),
    )
    return PathFit(place, rate, sigma, misfit, n_views)


@dataclass(frozen=True)
class Surprise:
    """How far M points are now from where they were to be expected.

    ``off (M, 2)`` of where the path of its thing leads each, in the plane z = 1; ``chi2 (M,)``, with two degrees of
    freedom, of that or of where its own course over the last views leads, whichever is nearer: what is on neither has
    nothing to do with the earlier views. 0 where these say nothing.
    """

    off: Floats
    chi2: Floats


def surprise_of_newest(points: Points, paths: RigidPaths, rate_hz: Floats) -> Surprise:
    """How far the points are now from where their earlier views lead; ``rate_hz (M,)`` to start from, NaN: none."""
    off, chi2 = np.empty((len(points.track), 2)), np.empty(len(points.track))
    ways = ways_of(paths, points.rays.shape[2])
    predict_newest(
        points.rays, points.track, points.thing, ways, points.sigma_norm, points.since_s, rate_hz, (off, chi2)
    )
    return Surprise(off, chi2)


def ways_of(paths: RigidPaths, n_views: int) -> Floats:
    """Rotation and path in each of M views, side by side: ``(K, 12, M)``; what is left over of M stands first."""
    ways = np.zeros((len(paths), 12, n_views))
    since = n_views - paths.path.shape[1]
    ways[:, :9, since:] = paths.cam_R_past.reshape(len(paths), -1, 9).transpose(0, 2, 1)
    ways[:, 9:, since:] = paths.path.transpose(0, 2, 1)
    return ways


def weights_by_misfit(points: Points, fit: PathFit, weight: Floats, n_things: int) -> tuple[Floats, Bools]:
    """The ``weight`` (M,) of points, less with an unusual misfit, 0 without a rate; and which things have any, (K,)."""
    has_rate = np.isfinite(fit.rate_hz)
    of_used = np.where(has_rate & (weight > 0.0), fit.misfit, np.nan)
    typical = np.maximum(medians(of_used, points.thing, n_things), _LEAST_TYPICAL_MISFIT)
    return np.where(has_rate, weight / (1.0 + fit.misfit / (_HALF_WEIGHT * typical[points.thing])), 0.0), np.isfinite(
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
    thing without points its motion.

    Parameters
    ----------
    n_steps : (K,) of each thing.
    weight : (M,) of each point, 0 leaves it out; None: all alike.
    rate_hz : (M,) rates to start from; None or NaN: none.

    Returns
    -------
    The paths, and the rate of each point, (M,).
    """
    weight = np.ones(len(points.track)) if weight is None else weight
    rate = np.zeros(len(points.track)) if rate_hz is None else rate_hz.copy()
    is_left = np.ones(len(paths), dtype=np.bool_)
    for step in range(int(n_steps.max(initial=0))):
        is_left &= n_steps > step
        of_left = np.flatnonzero(is_left[points.thing])
        some = replace(points, track=points.track[of_left], thing=points.thing[of_left])
        fit = fit_on_paths(some, paths, rate[of_left])
        rate[of_left] = fit.rate_hz
        weight_now, has_points = weights_by_misfit(some, fit, weight[of_left], len(paths))
        is_left &= has_points
        if is_left.any():
            equations = _equations(some, paths, fit, weight_now)
            paths = _where(is_left, _corrected(paths, equations, priors, points.since_s), paths)
    return paths, rate


def _equations(points: Points, paths: RigidPaths, fit: PathFit, weight: Floats) -> tuple[Floats, Floats]:
    """Normal equations of a turn and a shift of each view: information ``(K, L, 6, 6)`` and score ``(K, L, 6)``."""
    n_lanes, n_views = points.rays.shape[2], len(points.since_s)
    sums = np.zeros((len(paths), N_EQUATIONS, n_lanes))
    ways, of_point = ways_of(paths, n_lanes), (fit.place, fit.rate_hz, weight)
    add_turns_and_shifts(points.rays, points.track, points.thing, ways, points.sigma_norm, of_point, sums)
    row, column = np.tril_indices(7)
    whole = np.empty((len(paths), n_views, 7, 7))
    whole[..., row, column] = whole[..., column, row] = sums[..., n_lanes - n_views :].transpose(0, 2, 1)
    return whole[..., :6, :6], whole[..., 6, :6]


def _corrected(paths: RigidPaths, equations: tuple[Floats, Floats], priors: PathPriors, since_s: Floats) -> RigidPaths:
    """The paths with past views turned and shifted by least squares with the priors; they keep their length."""
    past, diagonal = slice(0, len(since_s) - 1), np.arange(6)
    information, score = (part[:, past] for part in equations)
    cam_R_past, path = paths.cam_R_past.copy(), paths.path.copy()
    shift_sigma = priors.shift_sigma[past] * (np.linalg.norm(path[:, past], axis=2) + _NO_LENGTH)
    turn_sigma = np.broadcast_to(priors.turn_sigma_rad[past], shift_sigma.shape)
    precision = np.repeat(np.stack([turn_sigma, shift_sigma], axis=-1) ** -2.0, 3, axis=-1)
    off = np.zeros((*shift_sigma.shape, 6))
    if priors.cam_R_past is not None:
        off[..., :3] = vector_from_rotation(priors.cam_R_past[past] @ cam_R_past[:, past].transpose(0, 1, 3, 2))
    off[..., 3:] = path[:, past] - (since_s[past] / since_s[0])[:, None] * path[:, :1]
    information[..., diagonal, diagonal] += precision
    change = np.ascontiguousarray(score - precision * off)
    solve_each(np.ascontiguousarray(information).reshape(-1, 6, 6), change.reshape(-1, 6))
    turned = rotation_from_vector(-change[..., :3]) @ cam_R_past[:, past]
    # One step of Newton's towards the nearest rotation: products that go on for ever cease to be some.
    cam_R_past[:, past] = turned @ (1.5 * np.eye(3) - 0.5 * turned.transpose(0, 1, 3, 2) @ turned)
    path[:, past] += change[..., 3:]
    before, after = (np.sqrt((each**2).sum(axis=2).max(axis=1)) for each in (paths.path, path))
    has_scale = np.minimum(before, after) > _NO_LENGTH
    scale = np.divide(before, after, out=np.ones(len(paths)), where=has_scale)
    return RigidPaths(cam_R_past, path * scale[:, None, None])


def _where(is_first: Bools, first: RigidPaths, second: RigidPaths) -> RigidPaths:
    """The first paths of the things that ``is_first (K,)`` marks, the second of the others."""
    if is_first.all():
        return first
    chosen = is_first[:, None, None]
    rotations = np.where(chosen[..., None], first.cam_R_past, second.cam_R_past)
    return RigidPaths(rotations, np.where(chosen, first.path, second.path))
