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
    found = PathVelocities(*(np.full((n, *size), np.nan) for size in ((3,), (), (3, 3), (3, N_SHARED))))
    _fill(
        np.ascontiguousarray(rates.xy),
        np.ascontiguousarray(rates.rate_hz),
        rate_variance,
        rates.by_path,
        rates.by_rotation,
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
    xy: Floats,
    rate_hz: Floats,
    rate_variance: Floats,
    by_path: Floats,
    by_rotation: Floats,
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
        if k < 0 or not np.isfinite(rate_hz[i]):
            continue
        x, y = xy[i, 0], xy[i, 1]
        slope, e, shared = jacobian[i], direction[k], shared_cov[k]
        for j in range(3):
            abc_hz[i, j] = rate_hz[i] * e[j]
            for m in range(6):
                slope[j, m] = e[j] * by_path[i, m]
            slope[j, j] += rate_hz[i]
            for m in range(3):
                # A rotation rate taken for too large turns the views back too far.
                slope[j, 6 + m] = -e[j] * by_rotation[i, m]
        if is_own_turn[k]:
            slope[0, 7] += 1.0
            slope[0, 8] -= y
            slope[1, 6] -= 1.0
            slope[1, 8] += x
            slope[2, 6] += y
            slope[2, 7] -= x
            turn = turn_rad_s[k]
            abc_hz[i, 0] += turn[1] - turn[2] * y
            abc_hz[i, 1] += turn[2] * x - turn[0]
            abc_hz[i, 2] += turn[0] * y - turn[1] * x
        for j in range(3):
            for m in range(n_shared):
                total = 0.0
                for q in range(n_shared):
                    total += slope[j, q] * shared[q, m]
                product[j, m] = total
        along = 0.0
        for j in range(3):
            for m in range(3):
                total = rate_variance[i] * e[j] * e[m]
                for q in range(n_shared):
                    total += product[j, q] * slope[m, q]
                along += e[j] * total * e[m]
                cov[i, j, m] = total + change[k] * change[k] * abc_hz[i, j] * abc_hz[i, m]
        along_sigma_hz[i] = np.sqrt(along)
