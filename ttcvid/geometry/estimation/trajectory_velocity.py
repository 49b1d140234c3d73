"""From rates on shared paths to velocities (a, b, c) with covariances, and how those hang on what the paths share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.geometry.estimation.shared_trajectory import N_SHARED
from ttcvid.geometry.estimation.track_on_trajectory import PathRates
from ttcvid.geometry.rotation import cross, skew
from ttcvid.model import Bools, Floats, Ints


@dataclass(frozen=True)
class PathVelocities:
    """Velocities of N points: ``abc_hz (N, 3)`` = V / Z, rho e and what a turn adds to it; NaN without path or rate.

    ``along_sigma_hz (N,)`` how sure it is along the path; ``cov (N, 3, 3)`` in 1/s^2; ``jacobian (N, 3, 12)`` of
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
    rates, path_of : Of `fit_rates_on_paths`, with sensitivities, on views turned back by ``turn_rad_s``.
    rate_variance : ``(N,)`` of the rates, by noise of the points' own, in 1/s^2.
    direction, turn_rad_s : ``(K, 3)`` each: e = dir and the rotation rate of each path.
    is_own_turn : ``(K,)`` True where the thing on the path turns: its points have the velocity turn x P beside. False:
        the rotation is an error of the camera's, which is no motion.
    shared_cov : ``(K, 12, 12)`` of the shared unknowns of `geometry.estimation.shared_trajectory`.
    """
    n = len(path_of)
    found = PathVelocities(*(np.full(shape, np.nan) for shape in ((n, 3), n, (n, 3, 3), (n, 3, N_SHARED))))
    known = np.flatnonzero((path_of >= 0) & np.isfinite(rates.state[:, 2]))
    path, (x, y, rate_hz) = path_of[known], rates.state[known].T
    e, turns = direction[path], is_own_turn[path].astype(np.float64)
    turned = np.stack([turns * x, turns * y, turns], axis=1)
    # Through the rate the shared unknowns go along e; besides, a wrong direction and a wrong turn go at this rate.
    jacobian = e[:, :, None] * rates.by_shared[known][:, None]
    axes = np.arange(3)
    jacobian[:, axes, axes] += rate_hz[:, None]
    jacobian[:, :, 6:9] -= skew(turned)
    cov = jacobian @ shared_cov[path] @ jacobian.transpose(0, 2, 1)
    cov += rate_variance[known, None, None] * e[:, :, None] * e[:, None]
    found.abc_hz[known] = rate_hz[:, None] * e + cross(turn_rad_s[path], turned)
    found.along_sigma_hz[known] = np.sqrt(np.einsum("ni,nij,nj->n", e, cov, e))
    found.cov[known], found.jacobian[known] = cov, jacobian
    return found
