"""Objects that drive straight on, and those in a bend: which of them each of their paths is."""

from __future__ import annotations

import numpy as np

from ttcvid.config import CollisionTimesConfig
from ttcvid.geometry.chi_square import chi2_quantile
from ttcvid.geometry.estimation.shared_trajectory import (
    PathBeliefs,
    SharedPaths,
    chosen_paths,
    fit_paths,
    fit_shared_paths,
)
from ttcvid.geometry.estimation.shared_trajectory_points import PathPoints, points_of_paths
from ttcvid.geometry.estimation.turning_body import TURN_SIGMA_RAD_S, TurningBody, fit_turning_body
from ttcvid.geometry.rotation import cross, normalize
from ttcvid.model import Floats, Ints

STRAIGHT_TURN_RAD_S = 0.006
"""What drives straight on turns itself by some tenths of a deg/s: to believe in more would take noise for a turn, and
that for a wrong velocity."""

# The search believes in a direction that was found as if the path were straight no more than this: its covariance times
# the factor and the square of the angle, so that it finds a path that is not.
_SEARCH_FACTOR, _SEARCH_FLOOR_RAD = 9.0, float(np.radians(1.0))
# Relative acceleration over relative speed of two cars, per axis: 1.2 m/s^2 at 6 m/s.
_OBJECT_BEND_HZ = 0.2
# In a bend it turns by some deg/s. On a horizon, which a body on a circle might leave, that is believed where it
# explains the views much better than none (chi-square with three degrees of freedom, 99.9 %).
_BEND_TURN_RAD_S = 0.02
_BEND_CHI2 = float(chi2_quantile(0.999, 3))
# And where they show no turn, as chance makes it in nine of ten cases, a thing drives straight on: a direction that was
# found as if it did lags behind a turn by many times what it is known to.
_STRAIGHT_CHI2 = float(chi2_quantile(0.9, 3))
# The first order promises more than a fit keeps, and a body that is free to turn follows the errors that neighbours
# share: less than this is enough neither for a second fit nor for a turn of any rate.
_SURE_CHI2 = 2.5 * _BEND_CHI2
# A body on a circle is looked for where the first order, which says a third of a turn or less, says more than this, and
# so many points are there to tell. (In a junction things turn by 0.1 to 0.5 rad/s.)
_ASKED_TURN_RAD_S, _LEAST_POINTS = 0.05, 8
# Residuals whose squares are so many times what noise makes of them reject a straight path in any case.
_REJECTED = 10.0
# Information on a turn below this part of what is believed is none.
_LEAST_TURN_PART = 1e-3
# What this many points of an object say of its path together, more of them hardly say better, in so much more time:
# errors that neighbours have in common limit it.
_MOST_POINTS = 50


def believed_straight(since_s: Floats, direction: Floats, found_cov: Floats, normal: Floats | None) -> PathBeliefs:
    """What is believed of K things that drive straight on at first, at times ``since_s (L,)``.

    Their directions ``(K, 3)`` were found to ``found_cov (K, 3, 3)``, in rad^2, in a plane if that has a ``normal``.
    """
    if normal is None:
        across = np.eye(3) - direction[:, :, None] * direction[:, None, :]
    else:
        along_horizon = normalize(cross(normal, direction))
        across = along_horizon[:, :, None] * along_horizon[:, None, :]
    base = since_s[None, :, None] * direction[:, None, :]
    cov = _SEARCH_FACTOR * found_cov + _SEARCH_FLOOR_RAD**2 * across
    return PathBeliefs(base, direction, cov, _OBJECT_BEND_HZ, _OBJECT_BEND_HZ, STRAIGHT_TURN_RAD_S, turns_itself=True)


def straight_or_in_bend(
    views: Floats,
    since_s: Floats,
    sigma_norm: Floats,
    beliefs: PathBeliefs,
    path_of: Ints,
    config: CollisionTimesConfig,
    found_cov: Floats,
    *,
    may_leave_directions: bool,
) -> SharedPaths:
    """Paths of K things that hardly turn, or, where that explains their views much better, of things in a bend.

    Parameters
    ----------
    views, since_s, sigma_norm, path_of
        As ``xy, t_s, sigma_norm, path_of`` of `points_of_paths`.
    beliefs
        `believed_straight`.
    found_cov
        How well the directions were found that things have if they drive straight on, as for
        `PathFits.paths_from_found_directions`.
    may_leave_directions
        Whether a thing in a bend is a body on a circle, whose direction is free: it would leave a horizon that is
        known. Where it must not, its path is that of a thing that hardly turns, with another belief in its turn.
    """
    longest, probability = config.max_frames, config.window_probability
    points = points_of_paths(views, since_s, sigma_norm, beliefs.base, path_of, longest, _MOST_POINTS)
    fits = fit_paths(points, beliefs, longest, probability)
    straight = fits.paths()
    chi2, by_views_rad_s = _turns_by_views(straight, beliefs.turn_sigma_rad_s)
    is_rejected, of_noise = straight.usual > _REJECTED, np.maximum(straight.usual, 1.0)
    chosen, is_straight = straight, np.ones(len(chi2), dtype=bool)
    if may_leave_directions:
        is_doubted = (chi2 > _BEND_CHI2 * of_noise) | is_rejected
        has_points = np.diff(points.first) >= _LEAST_POINTS
        for k in np.flatnonzero(is_doubted & (by_views_rad_s > _ASKED_TURN_RAD_S) & has_points):
            body = _turning_body(points, int(k), beliefs, float(straight.squares[k]))
            if straight.squares[k] - body.squares > _SURE_CHI2 * max(body.usual, 1.0):
                chosen = chosen_paths(chosen, _path_of_body(body, points.t_s), np.array([k]), np.array([True]))
                is_straight[k] = False
    elif (may_turn := (chi2 > _SURE_CHI2 * of_noise) | is_rejected).any():
        in_bend = fit_shared_paths(points.of(may_turn), beliefs.of(may_turn, _BEND_TURN_RAD_S), longest, probability)
        gain = straight.squares[may_turn] - in_bend.squares
        bends = gain > _BEND_CHI2 * np.maximum(in_bend.usual, 1.0)
        chosen = chosen_paths(straight, in_bend, np.flatnonzero(may_turn), bends)
        is_straight[may_turn] = ~bends
    is_straight &= chi2 <= _STRAIGHT_CHI2 * of_noise
    steady = fits.paths_from_found_directions(found_cov, straight)
    return chosen_paths(chosen, steady, np.arange(len(is_straight)), is_straight)


def _turning_body(points: PathPoints, k: int, beliefs: PathBeliefs, to_beat: float) -> TurningBody:
    """The thing k as a body that turns, by the views that the other fits may use.

    One that leaves not much less than the squares ``to_beat`` is of no use.
    """
    own = slice(points.first[k], points.first[k + 1])
    # What drives along a circle is pulled across by its turn times its speed.
    bend_hz = float(np.hypot(beliefs.across_sigma_hz, TURN_SIGMA_RAD_S))
    noise = points.sigma_norm[own]

    def beats(body: TurningBody) -> bool:
        return body.squares + _BEND_CHI2 * max(1.0, body.usual) <= to_beat

    return fit_turning_body(points.xy[:, own], points.t_s, noise, bend_hz, TURN_SIGMA_RAD_S, beats)


def _path_of_body(body: TurningBody, t_s: Floats) -> SharedPaths:
    """The path of the points of a body that turns, one of K = 1."""
    return SharedPaths(
        body.path_turned_back(t_s)[None],
        body.start[None],
        np.concatenate([np.zeros(6), body.turn_rad_s])[None],
        body.path_cov[None],
        body.direction_cov[None],
        np.array([body.squares]),
        np.array([body.usual]),
    )


def _turns_by_views(paths: SharedPaths, sigma_rad_s: float) -> tuple[Floats, Floats]:
    """Turns that the views alone would show, to first order: the belief in none taken out.

    Returns
    -------
    their chi-square (K,) and, where they are believed as those of tight bends are, how large they are (K,), rad/s.
    """
    # Views may say nothing of a turn about some axis.
    believed, least, tight = 1.0 / sigma_rad_s**2, _LEAST_TURN_PART / sigma_rad_s**2, 1.0 / TURN_SIGMA_RAD_S**2
    information = np.linalg.inv(paths.cov[:, 6:, 6:])
    score = information @ paths.offset[:, 6:, None]
    turn, tight_turn = (np.linalg.solve(information + (each - believed) * np.eye(3), score) for each in (least, tight))
    return np.sum(score * turn, axis=(1, 2)), np.sqrt(np.sum(tight_turn**2, axis=(1, 2)))
