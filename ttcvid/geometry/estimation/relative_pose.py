"""Rotation and direction of translation between two frames, by robust Gauss-Newton with Gaussian priors."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ttcvid.geometry.kernels.two_views import fit_two_views
from ttcvid.geometry.rotation import cross, rotation_from_vector, vector_from_rotation
from ttcvid.model import Floats, Ints

# Standard deviation of a direction that nothing is known of, rad.
_OPEN_DIRECTION_RAD = 1.0


@dataclass(frozen=True)
class TwoViewFit:
    """A robust fit of the motion between two frames.

    ``cam_R_prev (3, 3)``; ``direction (3,)`` is ``dir`` of the static points, None for a rotation alone;
    ``residual (N,)`` in sigmas; ``cost`` the sum of capped squares with the prior's part; ``information (k, k)`` on the
    unknowns and ``rows (k + 1, N)`` of each point as of `two_views.fit_two_views`, in 1/rad^2 and 1/rad: of two tangent
    coordinates of the direction (along `tangent_basis`) where there is one, then of the rotation vector, for a rotation
    alone of three axes one after the other; ``region (N,)`` as in `fit_motion`.
    ``sense (N,)`` is 1 for points that move along the direction by more than their noise, -1 for those that move
    against it (they would lie behind), else 0. ``doubt (3, 3)`` is the covariance of the direction by other
    fits that do nearly as well, rad^2: `covariance` is that about this one.
    """

    cam_R_prev: Floats
    direction: Floats | None
    residual: Floats
    cost: float
    information: Floats
    rows: Floats
    region: Ints
    sense: Floats
    doubt: Floats = field(default_factory=lambda: np.zeros((3, 3)))

    @cached_property
    def covariance(self) -> Floats:
        """Covariance (k, k) of the unknowns, rad^2: that of the assumed noise, times the ``spread_ratio``."""
        return np.asarray(self.spread_ratio * self._by_noise, dtype=np.float64)

    @cached_property
    def _by_noise(self) -> Floats:
        """The covariance by the assumed noise."""
        return np.asarray(np.linalg.inv(self.information), dtype=np.float64)

    @cached_property
    def spread_ratio(self) -> float:
        """By how much the spread of the scores exceeds that of the assumed noise; at least 1.

        Neighbouring points err together (one surface, one blur, one slant), so that N points are worth less than N
        independent ones: the scores are summed within a region before they are squared (a cluster-robust "sandwich").
        The largest eigenvalue of I^-1 sum g g', with the information I and the scores g of a region.
        """
        k, n_used = len(self.information), np.count_nonzero(np.bincount(self.region))
        if n_used <= 2 * k:
            return 1.0
        scores = (self.rows[:-1] * self.rows[-1]).reshape(k, -1, len(self.region)).sum(axis=1)
        cell = self.region + (self.region.max() + 1) * np.arange(k)[:, None]
        sums = np.bincount(cell.ravel(), scores.ravel()).reshape(k, -1)
        half = np.linalg.cholesky(self._by_noise).T @ sums
        return max(1.0, float(np.linalg.eigvalsh(half @ half.T)[-1]) * n_used / (n_used - k))


@dataclass(frozen=True)
class GaussianPrior:
    """A rotation vector expected with a standard deviation, and a direction likewise (None: any), in rad."""

    rotation_rad: Floats
    rotation_sigma_rad: float
    direction: Floats | None = None
    direction_sigma_rad: float = np.inf

    @cached_property
    def cam_R_prev(self) -> Floats:
        """The rotation expected, (3, 3)."""
        return rotation_from_vector(self.rotation_rad)


def fit_motion(
    rays_prev: Floats,
    rays_cam: Floats,
    sigma_rad: Floats,
    region: Ints,
    prior: GaussianPrior,
    cam_R_prev: Floats,
    direction: Floats | None = None,
) -> TwoViewFit:
    """Rotation and direction: a point moves in the plane of its ray and the direction, by an unknown amount.

    The residual of a point is the least distance of its two rays from a common plane through the direction, the
    square root of lambda_min(B'(pp' + qq')B) / sigma^2: chi-square with one degree of freedom, near the epipole too.

    Parameters
    ----------
    rays_prev, rays_cam : (N, 3) unit rays of the same points, each in its own camera.
    sigma_rad : (N,) noise of one coordinate of a unit ray.
    region : (N,) number of the part of the picture a point lies in; errors within one part are taken as common.
    cam_R_prev, direction : (3, 3) and (3,) start; no direction: rotation alone, every point at infinity, two
        residuals a point.
    """
    direction = None if direction is None else direction.copy()
    offset, n = vector_from_rotation(cam_R_prev @ prior.cam_R_prev.T), len(rays_cam)
    k, n_rows = (3, 3 * n) if direction is None else (5, n)
    precision, pull = np.full(k, prior.rotation_sigma_rad**-2.0), np.zeros(3)
    if direction is not None:
        # On a sphere a direction is never less certain than this, whatever the flow says.
        precision[:2] = _OPEN_DIRECTION_RAD**-2.0
        if prior.direction is not None:
            precision[:2] += prior.direction_sigma_rad**-2.0
            pull = prior.direction / prior.direction_sigma_rad**2
    residual, sense, rows, information = np.empty(n), np.zeros(n), np.empty((k + 1, n_rows)), np.empty((k, k))
    cost = fit_two_views(
        rays_prev,
        np.ascontiguousarray(rays_cam.T),
        sigma_rad,
        (prior.cam_R_prev, precision, pull),
        offset,
        np.empty(0) if direction is None else direction,
        (residual, sense, rows, information),
    )
    fitted = rotation_from_vector(offset) @ prior.cam_R_prev
    return TwoViewFit(fitted, direction, residual, cost, information, rows, region, sense)


def direction_from_flow(rays_prev: Floats, rays_cam: Floats, cam_R_prev: Floats) -> Floats:
    """Direction that lies best in all flow planes, a start for `fit_motion`: (3,).

    Smallest eigenvector of the planes' normals, weighted by the length of the flow, its sign by the majority of it.
    """
    turned = rays_prev @ cam_R_prev.T
    normal = cross(turned, rays_cam)
    _, vectors = np.linalg.eigh(normal.T @ normal)
    direction: Floats = vectors[:, 0]
    return direction if np.sum((rays_cam - turned) @ direction) >= 0 else -direction
