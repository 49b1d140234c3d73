"""The horizon through the epipoles of several motions: robust total least squares on the unit sphere.

All directions of motion on level ground are normal to the ground's normal n, so that ``n . dir = 0``: a great circle
through the epipoles. On the sphere an epipole at infinity is a point like any other, and determines the slope.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.special import chdtri, ndtri

from ttcvid.geometry.best_direction import best_direction
from ttcvid.geometry.horizon.plane import normal_by_pitch_roll, pitch_roll_rad
from ttcvid.geometry.paper.epipole import SIGNIFICANCE_SIGMAS
from ttcvid.geometry.rotation import cross, normalize
from ttcvid.model import Bools, Camera, Floats

# A motion agrees with a horizon within 99.7 % of a 1-D Gaussian.
_GATE_CHI2 = SIGNIFICANCE_SIGMAS**2
_MAX_ROUNDS = 10
# The scatter is enlarged by this factor until it is enough.
_SCATTER_STEP = 1.25
# Pairs of motions tried as horizons, at most, by the certainty of their epipoles.
_MAX_PAIRS = 600
# Part of a distribution below the upper border of its 95 % interval.
UPPER_95 = 0.975


@dataclass(frozen=True)
class HorizonFit:
    """A horizon: unit ``normal (3,)`` pointing up, with ``covariance (3, 3)`` in its tangent plane, rad^2.

    ``is_used (K,)`` marks the motions that agree with it; ``residual_rad (K,)`` is the angle of each epipole above it;
    ``scatter_rad`` the scatter of epipoles beyond their own covariances; ``quantile`` the number of standard deviations
    of a 95 % band.
    """

    normal: Floats
    covariance: Floats
    is_used: Bools
    residual_rad: Floats
    scatter_rad: float
    quantile: float


def fit_horizon(
    directions: Floats, covariances: Floats, floor_rad: float, roll_sigma_rad: float | None = None
) -> HorizonFit | None:
    """The great circle nearest to K epipoles, each weighted by its own covariance; None where they determine none.

    The best pair of epipoles by truncated cost starts a least-squares search of the sum of ``(n.e)^2 / (n'Cn + s^2)``
    over the motions that agree; s, the scatter that their covariances do not explain, is at least ``floor_rad`` and
    grows until the sum has its expected size.

    Parameters
    ----------
    directions : ``(K, 3)`` unit vectors of either sign.
    covariances : ``(K, 3, 3)`` in their tangent planes, rad^2.
    floor_rad : Minimum scatter, even where the epipoles agree better.
    roll_sigma_rad : Standard deviation of the prior of the camera's roll about zero; None: no prior.

    Source: the scatter s as in Paule and Mandel, 1982.
    """
    starts = _starts(directions, covariances, roll_sigma_rad)
    if not len(starts):
        return None
    costs = [np.minimum(_chi2(n, directions, covariances, floor_rad), _GATE_CHI2).sum() for n in starts]
    normal = starts[int(np.argmin(costs))]
    is_used = np.zeros(len(directions), dtype=bool)
    scatter_rad = floor_rad
    for _ in range(_MAX_ROUNDS):
        before = is_used
        is_used = _chi2(normal, directions, covariances, scatter_rad) < _GATE_CHI2
        if not is_used.any():
            return None
        used = directions[is_used], covariances[is_used]
        normal, covariance = _best(normal, *used, scatter_rad, roll_sigma_rad)
        n_free = len(used[0]) - 2 + (roll_sigma_rad is not None)
        while n_free > 0 and _chi2(normal, *used, scatter_rad).sum() > n_free:
            scatter_rad *= _SCATTER_STEP
            normal, covariance = _best(normal, *used, scatter_rad, roll_sigma_rad)
        if np.array_equal(before, is_used):
            break
    if not np.isfinite(covariance).all():
        return None
    return HorizonFit(
        normal=normal,
        covariance=covariance,
        is_used=is_used,
        residual_rad=np.arcsin(np.clip(directions @ normal, -1, 1)),
        scatter_rad=scatter_rad,
        quantile=float(ndtri(UPPER_95)),
    )


def is_one_direction(directions: Floats, covariances: Floats, floor_rad: float, probability: float) -> bool:
    """Whether K >= 2 epipoles may all be the same one (of either sign), through which no horizon is determined.

    A chi-square test with two degrees of freedom for each motion but the first; at this ``probability`` the epipoles
    count as different. The others as in `fit_horizon`.
    """
    root = np.linalg.cholesky(np.linalg.inv(covariances + floor_rad**2 * np.eye(3)))

    def residuals(common: Floats) -> Floats:
        signed = directions * np.where(directions @ common < 0, -1.0, 1.0)[:, None]
        return np.asarray(np.einsum("kij,ki->kj", root, signed - common).ravel())

    _, vectors = np.linalg.eigh(np.einsum("ki,kj->ij", directions, directions))
    common, _ = best_direction(residuals, vectors[:, -1])
    total = float(np.sum(residuals(common) ** 2))
    return total < float(chdtri(2 * (len(directions) - 1), 1.0 - probability))


def widest_angle_rad(directions: Floats, covariances: Floats) -> float:
    """Largest angle between any two of K directions, of either sign, that is certain; 0 where none is.

    An angle is certain as far as it exceeds three standard deviations, each direction's along its longest axis.
    """
    angle = np.arccos(np.clip(np.abs(directions @ directions.T), 0.0, 1.0))
    variance = np.linalg.norm(covariances, 2, axis=(1, 2))
    sure = angle - SIGNIFICANCE_SIGMAS * np.sqrt(variance[:, None] + variance[None, :])
    return max(0.0, float(sure.max()))


def pitch_roll_covariance_rad2(fit: HorizonFit) -> Floats:
    """Covariance ``(2, 2)`` of (pitch, roll), rad^2."""
    inverse = np.linalg.pinv(normal_by_pitch_roll(*pitch_roll_rad(fit.normal)))
    return np.asarray(inverse @ fit.covariance @ inverse.T)


def band_px(camera: Camera, fit: HorizonFit, x_px: Floats) -> tuple[Floats, Floats]:
    """Height of the horizon at columns ``(N,)`` of the undistorted picture, and half of its 95 % band: (N,) px each."""
    x = (x_px - camera.cx_px) / camera.fx_px
    n = fit.normal
    rays = np.column_stack([x, -(n[0] * x + n[2]) / n[1], np.ones_like(x)])
    by_normal = -rays / n[1] * camera.fy_px
    variance = np.einsum("ni,ij,nj->n", by_normal, fit.covariance, by_normal)
    return rays[:, 1] * camera.fy_px + camera.cy_px, fit.quantile * np.sqrt(variance)


def _chi2(normal: Floats, directions: Floats, covariances: Floats, scatter_rad: float) -> Floats:
    """Squared distance of each epipole from the horizon, in its own variances: (K,)."""
    return np.asarray((directions @ normal) ** 2 / _variance(normal, covariances, scatter_rad))


def _variance(normal: Floats, covariances: Floats, scatter_rad: float) -> Floats:
    """Of the distance of each epipole from the horizon: (K,) rad^2."""
    return np.asarray(np.einsum("i,kij,j->k", normal, covariances, normal) + scatter_rad**2)


def _starts(directions: Floats, covariances: Floats, roll_sigma_rad: float | None) -> Floats:
    """Normals ``(S, 3)``, pointing up, of horizons through pairs of epipoles; with a prior on roll, through each."""
    order = np.argsort(np.trace(covariances, axis1=1, axis2=2), kind="stable")
    pairs = list(combinations(order.tolist(), 2))[:_MAX_PAIRS]
    candidates = [cross(directions[i], directions[j]) for i, j in pairs]
    if roll_sigma_rad is not None:
        candidates += [np.array([0.0, -d[2], d[1]]) for d in directions]
    if not candidates:
        return np.empty((0, 3))
    normals = normalize(np.array(candidates))
    normals = normals[np.isfinite(normals).all(axis=1)]
    return np.asarray(normals * np.where(normals[:, 1] > 0.0, -1.0, 1.0)[:, None])


def _best(
    start: Floats, directions: Floats, covariances: Floats, scatter_rad: float, roll_sigma_rad: float | None
) -> tuple[Floats, Floats]:
    """The best normal with a given scatter, and its covariance."""

    def residuals(normal: Floats) -> Floats:
        heights = directions @ normal / np.sqrt(_variance(normal, covariances, scatter_rad))
        return heights if roll_sigma_rad is None else np.append(heights, pitch_roll_rad(normal)[1] / roll_sigma_rad)

    return best_direction(residuals, start)
