"""Rotation and direction of translation between two frames, by robust Gauss-Newton with Gaussian priors."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ttcvid.geometry.compiled import compiled_for
from ttcvid.geometry.rotation import cross, rotation_from_vector, vector_from_rotation
from ttcvid.geometry.two_view_descent import descend_motion, descend_rotation
from ttcvid.model import Floats, Ints

# Standard deviation of a direction that nothing is known of, rad.
_OPEN_DIRECTION_RAD = 1.0
# The most that a point costs: three sigmas squared, also where it moves the wrong way.
_COST_CAP = 9.0


@dataclass(frozen=True)
class TwoViewFit:
    """A robust fit of the motion between two frames.

    ``cam_R_prev (3, 3)``; ``direction (3,)`` is ``dir`` of the static points, None for a rotation alone;
    ``residual (N,)`` in sigmas; ``cost`` the sum of capped squares with the prior's part; ``information (k, k)`` on the
    unknowns and ``score (N, k)`` of each point, in 1/rad^2 and 1/rad: of two tangent coordinates of the direction
    (along `tangent_basis`) where there is one, then of the rotation vector; ``region (N,)`` as in `fit_rotation`.
    ``sense (N,)`` is 1 for points that move along the direction by more than their noise, -1 for those that move
    against it (they would lie behind), else 0.
    """

    cam_R_prev: Floats
    direction: Floats | None
    residual: Floats
    cost: float
    information: Floats
    score: Floats
    region: Ints
    sense: Floats

    @cached_property
    def covariance(self) -> Floats:
        """Covariance (k, k) of the unknowns, rad^2, with the spread of the scores in place of the assumed noise.

        Neighbouring points err together (one surface, one blur, one slant), so that N points are worth less than N
        independent ones: the scores are summed within a region before they are squared (a cluster-robust "sandwich").
        Never smaller than what the assumed noise gives: the inverse information I^-1, made larger by the largest
        eigenvalue of I^-1 sum g g', g the scores of a region.
        """
        covariance = np.empty_like(self.information)
        _fill_covariance(self.information, self.score, self.region, covariance)
        return covariance


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


def fit_rotation(
    rays_prev: Floats, rays_cam: Floats, sigma_rad: Floats, region: Ints, prior: GaussianPrior, cam_R_prev: Floats
) -> TwoViewFit:
    """Rotation alone: every point at infinity, two residuals a point.

    Parameters
    ----------
    rays_prev, rays_cam : (N, 3) unit rays of the same points, each in its own camera.
    sigma_rad : (N,) noise of one coordinate of a unit ray.
    region : (N,) number of the part of the picture a point lies in; errors within one part are taken as common.
    cam_R_prev : (3, 3) start.
    """
    expected = prior.cam_R_prev
    offset = vector_from_rotation(cam_R_prev @ expected.T)
    fitted, residual, score, information = (
        np.empty((3, 3)),
        np.empty(len(rays_cam)),
        np.empty((len(rays_cam), 3)),
        np.empty((3, 3)),
    )
    descend_rotation(
        rays_prev, rays_cam, sigma_rad, expected, prior.rotation_sigma_rad, offset, fitted, residual, score, information
    )
    sense = np.zeros(len(rays_cam))
    cost = _capped_cost(residual, sense) + float(offset @ offset) / prior.rotation_sigma_rad**2
    return TwoViewFit(fitted, None, residual, cost, information, score, region, sense)


def fit_motion(
    rays_prev: Floats,
    rays_cam: Floats,
    sigma_rad: Floats,
    region: Ints,
    prior: GaussianPrior,
    cam_R_prev: Floats,
    direction: Floats,
) -> TwoViewFit:
    """Rotation and direction: a point moves in the plane of its ray and the direction, by an unknown amount.

    The residual of a point is the least distance of its two rays from a common plane through the direction, the
    square root of lambda_min(B'(pp' + qq')B) / sigma^2: chi-square with one degree of freedom, also close to the
    epipole. Parameters as for `fit_rotation`; ``direction (3,)`` is the start.
    """
    n = len(rays_cam)
    expected = prior.cam_R_prev
    offset, direction = vector_from_rotation(cam_R_prev @ expected.T), direction.copy()
    fitted, residual, sense = np.empty((3, 3)), np.empty(n), np.empty(n)
    score, information = np.empty((n, 5)), np.empty((5, 5))
    descend_motion(
        rays_prev,
        rays_cam,
        sigma_rad,
        expected,
        prior.rotation_sigma_rad,
        np.zeros(3) if prior.direction is None else prior.direction,
        0.0 if prior.direction is None else 1.0 / prior.direction_sigma_rad**2,
        1.0 / _OPEN_DIRECTION_RAD**2,
        offset,
        direction,
        fitted,
        residual,
        sense,
        score,
        information,
    )
    cost = _capped_cost(residual, sense) + _prior_cost(prior, offset, direction)
    return TwoViewFit(fitted, direction, residual, cost, information, score, region, sense)


def direction_from_flow(rays_prev: Floats, rays_cam: Floats, cam_R_prev: Floats) -> Floats:
    """Direction that lies best in all flow planes, a start for `fit_motion`: (3,).

    Smallest eigenvector of the planes' normals, weighted by the length of the flow, its sign by the majority of it.
    """
    turned = rays_prev @ cam_R_prev.T
    normal = cross(turned, rays_cam)
    _, vectors = np.linalg.eigh(normal.T @ normal)
    direction: Floats = vectors[:, 0]
    return direction if np.sum((rays_cam - turned) @ direction) >= 0 else -direction


def _prior_cost(prior: GaussianPrior, offset: Floats, direction: Floats) -> float:
    """Squared distance from the prior in its sigmas, ``offset (3,)`` rad from its rotation."""
    cost = float(offset @ offset) / prior.rotation_sigma_rad**2
    if prior.direction is not None:
        # 2 (1 - cos) is the squared angle for small ones and stays finite for opposite directions.
        cost += 2.0 * (1.0 - float(direction @ prior.direction)) / prior.direction_sigma_rad**2
    return cost


@compiled_for("(f8[::1], f8[::1])")
def _capped_cost(residual: Floats, sense: Floats) -> float:
    """Sum of squared residuals, each capped: what counts is how many points a fit explains, not how far others are.

    A point that moves the wrong way costs as much as any.
    """
    cost = 0.0
    for i in range(len(residual)):
        cost += min(residual[i] * residual[i], _COST_CAP) if sense[i] >= 0.0 else _COST_CAP
    return cost


@compiled_for("(f8[:, ::1], f8[:, ::1], i8[::1], f8[:, ::1])")
def _fill_covariance(information: Floats, score: Floats, region: Ints, covariance: Floats) -> None:
    """Fill ``covariance (k, k)`` of `TwoViewFit`."""
    covariance[:] = np.linalg.inv(information)
    k, n_regions = len(covariance), 0
    for number in region:
        n_regions = max(n_regions, number + 1)
    sums, has_points, n_used = np.zeros((k, n_regions)), np.zeros(n_regions, dtype=np.bool_), 0
    for i in range(len(region)):
        n_used += 0 if has_points[region[i]] else 1
        has_points[region[i]] = True
        for j in range(k):
            sums[j, region[i]] += score[i, j]
    if n_used <= 2 * k:
        return
    half = np.linalg.cholesky(covariance).T @ sums
    ratio = np.linalg.eigvalsh(half @ half.T)[k - 1] * n_used / (n_used - k)
    covariance *= max(1.0, ratio)
