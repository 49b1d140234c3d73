"""From rates on shared paths to velocities (a, b, c) with covariances, and how those hang on what the paths share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.geometry.compiled import compiled_for
from ttcvid.geometry.estimation.shared_trajectory import N_SHARED
from ttcvid.geometry.estimation.track_on_trajectory import PathRates
from ttcvid.model import Bools, Floats, Ints

# As `N_SHARED`: a copy on disk would not notice that this changed elsewhere.
_N_SHARED = 9


@dataclass(frozen=True)
class PathVelocities:
    """Velocities of N points: ``abc_hz (N, 3)`` = V / Z, rho e and what a turn adds to it; NaN without path or rate.

    ``along_sigma_hz (N,)`` how sure it is along the path; ``cov (N, 3, 3)`` in 1/s^2; ``jacobian (N, 3, 9)`` of
    (a, b, c) by what the points of a path share.
    """

    abc_hz: Floats
    along_sigma_hz: Floats
    cov: Floats
    jacobian: Floats


def velocities_on_paths(
    rates: PathRates,
    rate_variance: Floats,
    path_of: Ints,
    direction: Floats,
    turn_rad_s: Floats,
    is_own_turn: Bools,
    shared_cov: Floats,
) -> PathVelocities:
    """(a, b, c) of N points.

    Parameters
    ----------
    rates, path_of
        Of `fit_rates_on_paths`, with sensitivities, on views turned back by ``turn_rad_s``.
    rate_variance
        ``(N,)`` of the rates, by noise of the points' own, in 1/s^2.
    direction, turn_rad_s
        ``(K, 3)`` each: e = dir and the rotation rate of each path.
    is_own_turn
        ``(K,)`` True where the thing on the path turns: its points have the velocity turn x P beside. False: the
        rotation is an error of the camera's, which is no motion.
    shared_cov
        ``(K, 9, 9)`` of the shared unknowns of `geometry.estimation.shared_trajectory`.
    """
    n = len(path_of)
    found = PathVelocities(np.empty((n, 3)), np.empty(n), np.empty((n, 3, 3)), np.empty((n, 3, N_SHARED)))
    _fill(
        rates.state,
        rate_variance,
        rates.by_shared,
        np.asarray(path_of, dtype=np.int64),
        direction,
        turn_rad_s,
        is_own_turn,
        shared_cov,
        found.abc_hz,
        found.along_sigma_hz,
        found.cov,
        found.jacobian,
    )
    return found


@compiled_for(
    "(f8[:, ::1], f8[::1], f8[:, ::1], i8[::1], f8[:, ::1], f8[:, ::1], b1[::1], f8[:, :, ::1], "
    "f8[:, ::1], f8[::1], f8[:, :, ::1], f8[:, :, ::1])"
)
def _fill(
    state: Floats,
    rate_variance: Floats,
    by_shared: Floats,
    path_of: Ints,
    direction: Floats,
    turn_rad_s: Floats,
    is_own_turn: Bools,
    shared_cov: Floats,
    abc_hz: Floats,
    along_sigma_hz: Floats,
    cov: Floats,
    jacobian: Floats,
) -> None:
    """Fill the results of `velocities_on_paths`.

    The jacobian is e s' + G: s is what the shared unknowns do to the rate, G what they do at this rate, of which only
    the columns of u and of the turn are not zero. So is the covariance J S J' = e e' (s'S s) + e (G S s)' + (G S s) e'
    + G S G', at half the products.
    """
    to_rate, by_turn = np.empty(_N_SHARED), np.empty((_N_SHARED, 3))
    for i in range(len(path_of)):
        k = path_of[i]
        x, y, rate_hz = state[i, 0], state[i, 1], state[i, 2]
        if k < 0 or not np.isfinite(rate_hz):
            abc_hz[i], along_sigma_hz[i], cov[i], jacobian[i] = np.nan, np.nan, np.nan, np.nan
            continue
        turns = 1.0 if is_own_turn[k] else 0.0
        turned_x, turned_y = turns * x, turns * y
        for j in range(3):
            abc_hz[i, j] = rate_hz * direction[k, j]
            for m in range(_N_SHARED):
                jacobian[i, j, m] = direction[k, j] * by_shared[i, m]
            jacobian[i, j, j] += rate_hz
        jacobian[i, 0, 7] += turns
        jacobian[i, 0, 8] -= turned_y
        jacobian[i, 1, 6] -= turns
        jacobian[i, 1, 8] += turned_x
        jacobian[i, 2, 6] += turned_y
        jacobian[i, 2, 7] -= turned_x
        abc_hz[i, 0] += turns * turn_rad_s[k, 1] - turn_rad_s[k, 2] * turned_y
        abc_hz[i, 1] += turn_rad_s[k, 2] * turned_x - turns * turn_rad_s[k, 0]
        abc_hz[i, 2] += turn_rad_s[k, 0] * turned_y - turn_rad_s[k, 1] * turned_x
        square = 0.0
        for q in range(_N_SHARED):
            total = 0.0
            for m in range(_N_SHARED):
                total += shared_cov[k, q, m] * by_shared[i, m]
            to_rate[q] = total
            square += total * by_shared[i, q]
            about_x, about_y, about_z = shared_cov[k, q, 6], shared_cov[k, q, 7], shared_cov[k, q, 8]
            by_turn[q, 0] = rate_hz * shared_cov[k, q, 0] + turns * about_y - turned_y * about_z
            by_turn[q, 1] = rate_hz * shared_cov[k, q, 1] - turns * about_x + turned_x * about_z
            by_turn[q, 2] = rate_hz * shared_cov[k, q, 2] + turned_y * about_x - turned_x * about_y
        mixed = (
            rate_hz * to_rate[0] + turns * to_rate[7] - turned_y * to_rate[8],
            rate_hz * to_rate[1] - turns * to_rate[6] + turned_x * to_rate[8],
            rate_hz * to_rate[2] + turned_y * to_rate[6] - turned_x * to_rate[7],
        )
        square += rate_variance[i]
        for m in range(3):
            cov[i, 0, m] = rate_hz * by_turn[0, m] + turns * by_turn[7, m] - turned_y * by_turn[8, m]
            cov[i, 1, m] = rate_hz * by_turn[1, m] - turns * by_turn[6, m] + turned_x * by_turn[8, m]
            cov[i, 2, m] = rate_hz * by_turn[2, m] + turned_y * by_turn[6, m] - turned_x * by_turn[7, m]
        along = 0.0
        for j in range(3):
            for m in range(j + 1):
                total = cov[i, j, m] + direction[k, j] * (square * direction[k, m] + mixed[m])
                total += mixed[j] * direction[k, m]
                along += (1.0 if m == j else 2.0) * direction[k, j] * total * direction[k, m]
                cov[i, j, m] = cov[i, m, j] = total
        along_sigma_hz[i] = np.sqrt(along)
