"""Objects that drive straight on, and those in a bend: which of them each of their paths is."""

from __future__ import annotations

import numpy as np

from ttcvid.config import CollisionTimesConfig
from ttcvid.geometry.chi_square import chi2_quantile
from ttcvid.geometry.shared_path import PathBeliefs, SharedPaths, chosen_paths, fit_shared_paths, points_of_paths
from ttcvid.model import Floats, Ints

STRAIGHT_TURN_RAD_S = 0.006
"""What drives straight on turns itself by some tenths of a deg/s: to believe in more would take noise for a turn, and
that for a wrong velocity."""

# In a bend it turns by some deg/s. That is believed where the views explain it much better than none (chi-square with
# three degrees of freedom, 99.9 %).
_BEND_TURN_RAD_S = 0.02
_BEND_CHI2 = float(chi2_quantile(0.999, 3))
# The first order promises more than a fit keeps: a second one is not made for less than this.
_PROMISED_CHI2 = 2.5 * _BEND_CHI2
# Residuals whose squares are so many times what noise makes of them reject a straight path in any case.
_REJECTED = 10.0
# Information on a turn below this part of what is believed is none.
_LEAST_TURN_PART = 1e-3
# What this many points of an object say of its path together, more of them hardly say better, in so much more time:
# errors that neighbours have in common limit it.
_MOST_POINTS = 50


def straight_or_in_bend(
    views: Floats,
    since_s: Floats,
    sigma_norm: Floats,
    beliefs: PathBeliefs,
    path_of: Ints,
    config: CollisionTimesConfig,
) -> SharedPaths:
    """Paths of K things that hardly turn, or, where that explains their views much better, of things in a bend.

    Parameters
    ----------
    views, since_s, sigma_norm, path_of
        As ``xy, t_s, sigma_norm, path_of`` of `points_of_paths`.
    beliefs
        Of things that drive straight on, with `STRAIGHT_TURN_RAD_S`.
    """
    longest, probability = config.max_frames, config.window_probability
    points = points_of_paths(views, since_s, sigma_norm, beliefs.base, path_of, longest, _MOST_POINTS)
    straight = fit_shared_paths(points, beliefs, longest, probability)
    speaks_against = _turn_chi2(straight, beliefs.turn_sigma_rad_s) > _PROMISED_CHI2 * np.maximum(straight.usual, 1.0)
    may_turn = speaks_against | (straight.usual > _REJECTED)
    if not may_turn.any():
        return straight
    in_bend = fit_shared_paths(points.of(may_turn), beliefs.of(may_turn, _BEND_TURN_RAD_S), longest, probability)
    gain = straight.squares[may_turn] - in_bend.squares
    turns = gain > _BEND_CHI2 * np.maximum(in_bend.usual, 1.0)
    return chosen_paths(straight, in_bend, np.flatnonzero(may_turn), turns)


def _turn_chi2(paths: SharedPaths, sigma_rad_s: float) -> Floats:
    """Chi-square (K,) of the turns that the views alone would show, to first order: the belief in none taken out."""
    pull = np.linalg.inv(paths.cov[:, 6:, 6:])
    by_views = pull - np.eye(3) / sigma_rad_s**2
    score = (pull @ paths.turn_rad_s[..., None])[..., 0]
    # Views may say nothing of a turn about some axis.
    least = _LEAST_TURN_PART / sigma_rad_s**2 * np.eye(3)
    return np.asarray(np.sum(score * np.linalg.solve(by_views + least, score[..., None])[..., 0], axis=1))
