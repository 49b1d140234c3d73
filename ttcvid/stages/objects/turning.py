"""Relative trajectories of objects: straight, or turning where the views show it significantly."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri

from ttcvid.config import CollisionTimesConfig
from ttcvid.geometry.estimation.shared_trajectory import N_SHARED, PathBeliefs, SharedPaths, chosen_paths, fit_paths
from ttcvid.geometry.estimation.shared_trajectory_points import PathPoints, points_of_paths
from ttcvid.geometry.estimation.turning_body import TURN_SIGMA_RAD_S, TurningBody, fit_turning_body
from ttcvid.geometry.rotation import cross, normalize
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.segmentation.turning_movers import LEAST_POINTS, MOST_POINTS

STRAIGHT_TURN_RAD_S = 0.006
"""Prior of the turn rate of an object on a straight course, some tenths of a deg/s: with a wider one, noise would pass
for a turn, and bias the velocity."""

# A direction from elsewhere (our own, of what stands in our way) has its covariance times this factor, widened by the
# square of this angle. One from the same views only starts the search: it is known to a radian.
_KNOWN_FACTOR, _KNOWN_FLOOR_RAD, _START_RAD = 9.0, float(np.radians(1.0)), 1.0
# Acceleration over the speed, per axis, that is believed of who drives straight on: 0.6 m/s^2 at 6 m/s.
_STRAIGHT_BEND_HZ = 0.1
# The same along the direction of who brakes, and has had hardly any speed against us: where that shows at 95 %.
_BRAKING_HZ, _BRAKING_CHI2 = 1.2, float(chdtri(1, 0.05))
# Prior of the turn rate in a bend, some deg/s. On a known horizon, which a free turning body could leave, it is chosen
# if it lowers the squared residuals significantly (chi-square, three degrees of freedom, 99.9 %).
_BEND_TURN_RAD_S = 0.02
_BEND_CHI2 = float(chdtri(3, 0.001))
# Least gain for a second fit and for a turning body: the first order overestimates the gain, and a turning body follows
# the errors that neighbours share.
_SURE_CHI2 = 2.5 * _BEND_CHI2
# A significant turn is fitted as a turning body from this rate on, by the first order, which gives a third of it or
# less. (At junctions objects turn by 0.1 to 0.5 rad/s.)
_ASKED_TURN_RAD_S = 0.05
# A straight trajectory with a larger reduced chi-square is rejected: a turning body is tried whatever turn shows.
_REJECTED = 10.0
# Least information on a turn, as a share of that of the prior.
_LEAST_TURN_PART = 1e-3


def believed_straight(
    since_s: Floats, direction: Floats, found_cov: Floats, is_start: Bools, normal: Floats | None
) -> PathBeliefs:
    """Priors of the trajectories of K objects on straight courses, by their ``direction (K, 3)`` of motion.

    ``found_cov (K, 3, 3)`` is its covariance, rad^2. It does not count where ``is_start (K,)`` says that the direction
    only starts the search. ``since_s (L,)`` are the times of the views, s, ``normal (3,)`` that of the plane that the
    directions lie in (the horizon); None: any direction.
    """
    if normal is None:
        across = np.eye(3) - direction[:, :, None] * direction[:, None, :]
    else:
        along_horizon = normalize(cross(normal, direction))
        across = along_horizon[:, :, None] * along_horizon[:, None, :]
    base = since_s[None, :, None] * direction[:, None, :]
    sigma_rad = np.where(is_start, _START_RAD, _KNOWN_FLOOR_RAD)[:, None, None]
    cov = np.where(is_start, 0.0, _KNOWN_FACTOR)[:, None, None] * found_cov + sigma_rad**2 * across
    bend_hz = _STRAIGHT_BEND_HZ
    return PathBeliefs(base, direction, cov, bend_hz, bend_hz, STRAIGHT_TURN_RAD_S, turns_itself=True)


def straight_or_in_bend(
    views: Floats,
    since_s: Floats,
    sigma_norm: Floats,
    beliefs: PathBeliefs,
    path_of: Ints,
    config: CollisionTimesConfig,
    *,
    may_leave_directions: bool,
) -> SharedPaths:
    """Trajectories of K objects: straight, or turning where that explains their views significantly better.

    Parameters
    ----------
    views, since_s, sigma_norm, path_of : As ``xy, t_s, sigma_norm, path_of`` of `points_of_paths`.
    may_leave_directions : Whether an object in a bend is fitted as a turning body with a free direction. Otherwise
        (known horizon) it is fitted as a straight one with the wider prior of the turn rate.
    """
    longest, probability = config.max_frames, config.window_probability
    points = points_of_paths(views, since_s, sigma_norm, beliefs.base, path_of, longest, MOST_POINTS)
    fits = fit_paths(points, beliefs, longest, probability).with_braking(_BRAKING_HZ, _BRAKING_CHI2)
    straight = fits.paths()
    chi2, by_views_rad_s = _turns_by_views(straight, beliefs.turn_sigma_rad_s)
    is_rejected, of_noise = straight.median_chi2 > _REJECTED, np.maximum(straight.median_chi2, 1.0)
    chosen = straight
    if may_leave_directions:
        turns = (chi2 > _BEND_CHI2 * of_noise) & (by_views_rad_s > _ASKED_TURN_RAD_S)
        has_points = np.diff(points.first) >= LEAST_POINTS
        for k in np.flatnonzero((turns | is_rejected) & has_points):
            body = _turning_body(points, int(k), float(straight.squares[k]))
            if straight.squares[k] - body.squares > _SURE_CHI2 * max(body.median_chi2, 1.0):
                chosen = chosen_paths(chosen, _path_of_body(body, points.t_s), np.array([k]), np.array([True]))
    elif (may_turn := (chi2 > _SURE_CHI2 * of_noise) | is_rejected).any():
        bent = fit_paths(points.of(may_turn), beliefs.of(may_turn, _BEND_TURN_RAD_S), longest, probability)
        in_bend = bent.with_braking(_BRAKING_HZ, _BRAKING_CHI2).paths()
        gain = straight.squares[may_turn] - in_bend.squares
        bends = gain > _BEND_CHI2 * np.maximum(in_bend.median_chi2, 1.0)
        chosen = chosen_paths(straight, in_bend, np.flatnonzero(may_turn), bends)
    return chosen


def _turning_body(points: PathPoints, k: int, to_beat: float) -> TurningBody:
    """Object k as a turning body, from the views of the other fits.

    The fit ends early if its squared residuals are not significantly below ``to_beat``.
    """
    own = slice(points.first[k], points.first[k + 1])
    # The transverse acceleration on a circle is the turn rate times the speed.
    bend_hz = float(np.hypot(_STRAIGHT_BEND_HZ, TURN_SIGMA_RAD_S))
    noise = points.sigma_norm[own]

    def beats(body: TurningBody) -> bool:
        return body.squares + _BEND_CHI2 * max(1.0, body.median_chi2) <= to_beat

    return fit_turning_body(points.xy[:, own], points.t_s, noise, bend_hz, TURN_SIGMA_RAD_S, beats)


def _path_of_body(body: TurningBody, t_s: Floats) -> SharedPaths:
    """The trajectory of a turning body as `SharedPaths` of K = 1."""
    offset, cov = np.zeros((1, N_SHARED)), np.zeros((1, N_SHARED, N_SHARED))
    offset[0, 6:9], cov[0, :9, :9] = body.turn_rad_s, body.path_cov
    left = np.array([body.squares]), np.array([body.median_chi2])
    return SharedPaths(body.path_turned_back(t_s)[None], body.start[None], offset, cov, *left)


def _turns_by_views(paths: SharedPaths, sigma_rad_s: float) -> tuple[Floats, Floats]:
    """Turns that the views alone would show, to first order: the belief in none taken out.

    Their chi-square (K,) and, where they are believed as those of tight bends are, how large they are (K,), rad/s.
    """
    # Views may say nothing of a turn about some axis.
    believed, least, tight = sigma_rad_s**-2.0, _LEAST_TURN_PART / sigma_rad_s**2, TURN_SIGMA_RAD_S**-2.0
    information = np.linalg.inv(paths.cov[:, 6:9, 6:9])
    score = information @ paths.offset[:, 6:9, None]
    more = np.array([least - believed, tight - believed])[:, None, None, None]
    turn, tight_turn = np.linalg.solve(information + more * np.eye(3), score)
    return np.sum(score * turn, axis=(1, 2)), np.sqrt(np.sum(tight_turn**2, axis=(1, 2)))
