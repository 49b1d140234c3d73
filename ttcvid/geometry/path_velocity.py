"""From rates on shared paths to velocities (a, b, c) with covariances, and how those hang on what the paths share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.geometry.compiled import compiled
from ttcvid.geometry.shared_path import N_SHARED
from ttcvid.geometry.whole_track_on_path import PathRates
from ttcvid.model import Bools, Floats, Ints


@dataclass(frozen=True)
class PathVelocities:
    """Velocities of N points: ``abc_hz (N, 3)`` = V / Z, rho e and what a turn adds to it; NaN without path or rate.

    ``along_sigma_hz (N,)`` how sure it is along the path; ``cov (N, 3, 3)`` in 1/s^2 with what the speed may change by
    soon; ``jacobian (N, 3, 9)`` of (a, b, c) by what the points of a path share.
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
    change: Floats,
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
        ``(K, 9, 9)`` of the shared unknowns of `geometry.shared_path`.
    change
        ``(K,)`` by what part the speed along each path may change soon.
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
        change,
        found.abc_hz,
        found.along_sigma_hz,
        found.cov,
        found.jacobian,
    )
    return found


@compiled
def _fill(
    state: Floats,
    rate_variance: Floats,
    by_shared: Floats,
    path_of: Ints,
    direction: Floats,
    turn_rad_s: Floats,
    is_own_turn: Bools,
    shared_cov: Floats,
    change: Floats,
    abc_hz: Floats,
    along_sigma_hz: Floats,
    cov: Floats,
    jacobian: Floats,
) -> None:
    """Fill the results of `velocities_on_paths`."""
    n_shared = shared_cov.shape[1]
    product = np.empty((3, n_shared))
    for i in range(len(path_of)):
        k = path_of[i]
        x, y, rate_hz = state[i, 0], state[i, 1], state[i, 2]
        if k < 0 or not np.isfinite(rate_hz):
            abc_hz[i], along_sigma_hz[i], cov[i], jacobian[i] = np.nan, np.nan, np.nan, np.nan
            continue
        for j in range(3):
            abc_hz[i, j] = rate_hz * direction[k, j]
            for m in range(n_shared):
                jacobian[i, j, m] = direction[k, j] * by_shared[i, m]
            jacobian[i, j, j] += rate_hz
        if is_own_turn[k]:
            jacobian[i, 0, 7] += 1.0
            jacobian[i, 0, 8] -= y
            jacobian[i, 1, 6] -= 1.0
            jacobian[i, 1, 8] += x
            jacobian[i, 2, 6] += y
            jacobian[i, 2, 7] -= x
            abc_hz[i, 0] += turn_rad_s[k, 1] - turn_rad_s[k, 2] * y
            abc_hz[i, 1] += turn_rad_s[k, 2] * x - turn_rad_s[k, 0]
            abc_hz[i, 2] += turn_rad_s[k, 0] * y - turn_rad_s[k, 1] * x
        for j in range(3):
            for m in range(n_shared):
                total = 0.0
                for q in range(n_shared):
                    total += jacobian[i, j, q] * shared_cov[k, q, m]
                product[j, m] = total
        along = 0.0
        for j in range(3):
            for m in range(j + 1):
                total = rate_variance[i] * direction[k, j] * direction[k, m]
                for q in range(n_shared):
                    total += product[j, q] * jacobian[i, m, q]
                along += (1.0 if m == j else 2.0) * direction[k, j] * total * direction[k, m]
                total += change[k] * change[k] * abc_hz[i, j] * abc_hz[i, m]
                cov[i, j, m] = cov[i, m, j] = total
        along_sigma_hz[i] = np.sqrt(along)
