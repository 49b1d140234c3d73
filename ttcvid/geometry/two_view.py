"""Rotation and direction of translation between two frames, by robust Gauss-Newton with Gaussian priors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.geometry.rotation import cross, normalize, rotation_from_vector, tangent_basis, vector_from_rotation
from ttcvid.model import Floats, Ints

# Geman and McClure's weight falls to a quarter at so many sigmas and on towards zero: a lorry of two fifths of all
# points, which Cauchy's weight lets pull for ever, is let go.
_REDESCENT = 4.0
# Gauss-Newton ends after so many steps, or after one whose squared length in sigmas of the estimate is less.
_MAX_STEPS, _CONVERGED_CHI2 = 15, 1e-2
# A step of the direction is cut to this length, rad: beyond it the linearisation means nothing.
_LONGEST_STEP_RAD = 0.3
# A static point moves towards dir; one that moves the other way by more sigmas than this does not belong to
# the scene and keeps only so small a weight that the estimate stays defined.
_WRONG_WAY_SIGMAS, _WRONG_WAY_WEIGHT = -3.0, 0.02
# Standard deviation of a direction that nothing is known of, rad.
_OPEN_DIRECTION_RAD = 1.0
# The most that a point costs: three sigmas squared, also where it moves the wrong way.
_COST_CAP = 9.0
# Squared lengths below this are a point on the epipole itself, rad^2.
_TINY = 1e-14


@dataclass(frozen=True)
class TwoViewFit:
    """A robust fit of the motion between two frames.

    ``cam_R_prev (3, 3)``; ``direction (3,)`` is ``dir`` of the static points, None for a rotation alone;
    ``residual (N,)`` and ``wrong_way (N,)`` (how far a point moves against the direction) in sigmas; ``cost`` the
    sum of capped squares with the prior's part; ``covariance`` of the unknowns in rad^2: two tangent coordinates of the
    direction (along `tangent_basis`) where there is one, then the rotation vector.
    """

    cam_R_prev: Floats
    direction: Floats | None
    residual: Floats
    cost: float
    covariance: Floats


@dataclass(frozen=True)
class GaussianPrior:
    """A rotation vector expected with a standard deviation, and a direction likewise (None: any), in rad."""

    rotation_rad: Floats
    rotation_sigma_rad: float
    direction: Floats | None = None
    direction_sigma_rad: float = np.inf


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
    sigma_difference = np.sqrt(2.0) * sigma_rad[:, None]
    identity = np.eye(3)
    expected = rotation_from_vector(prior.rotation_rad)
    offset = vector_from_rotation(cam_R_prev @ expected.T)
    for _ in range(_MAX_STEPS):
        cam_R_prev = rotation_from_vector(offset) @ expected
        turned = rays_prev @ cam_R_prev.T
        error = (rays_cam - turned) / sigma_difference
        residual = np.linalg.norm(error, axis=1)
        weight = _robust_weight(residual, _robust_scale(residual / np.sqrt(2.0)))
        # d(omega x q) . error: for unit rays the information is the projector across the ray.
        inverse = weight / sigma_difference[:, 0] ** 2
        information = inverse.sum() * identity - (turned * inverse[:, None]).T @ turned
        score = cross(turned, error / sigma_difference) * weight[:, None]
        information += identity / prior.rotation_sigma_rad**2
        step = np.linalg.solve(information, score.sum(axis=0) - offset / prior.rotation_sigma_rad**2)
        offset = offset + step
        if step @ information @ step < _CONVERGED_CHI2:
            break
    cam_R_prev = rotation_from_vector(offset) @ expected
    cost = _capped_cost(residual) + float(offset @ offset) / prior.rotation_sigma_rad**2
    covariance = _robust_covariance(information, score, region)
    return TwoViewFit(cam_R_prev, None, residual, cost, covariance)


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
    expected = rotation_from_vector(prior.rotation_rad)
    offset = vector_from_rotation(cam_R_prev @ expected.T)
    for _ in range(_MAX_STEPS):
        basis = tangent_basis(direction)
        cam_R_prev = rotation_from_vector(offset) @ expected
        turned = rays_prev @ cam_R_prev.T
        residual, jacobian, towards = _plane_residual(turned, rays_cam, sigma_rad, direction, basis)
        is_wrong = towards < _WRONG_WAY_SIGMAS
        weight = _robust_weight(residual, _robust_scale(residual)) * np.where(is_wrong, _WRONG_WAY_WEIGHT, 1.0)
        score = -jacobian * (weight * residual)[:, None]
        information = (jacobian * weight[:, None]).T @ jacobian
        prior_information, prior_score, prior_cost = _prior_terms(prior, offset, direction, basis)
        information += prior_information
        step = np.linalg.solve(information, score.sum(axis=0) + prior_score)
        length = float(np.hypot(step[0], step[1]))
        step[:2] *= min(1.0, _LONGEST_STEP_RAD / max(length, _TINY))
        direction = normalize(direction + basis @ step[:2])
        offset = offset + step[2:]
        if step @ information @ step < _CONVERGED_CHI2:
            break
    cam_R_prev = rotation_from_vector(offset) @ expected
    cost = _capped_cost(np.where(is_wrong, np.inf, residual)) + prior_cost
    covariance = _robust_covariance(information, score, region)
    return TwoViewFit(cam_R_prev, direction, residual, cost, covariance)


def direction_from_flow(rays_prev: Floats, rays_cam: Floats, cam_R_prev: Floats) -> Floats:
    """Direction that lies best in all flow planes, a start for `fit_motion`: (3,).

    Smallest eigenvector of the planes' normals, weighted by the length of the flow, its sign by the majority of it.
    """
    turned = rays_prev @ cam_R_prev.T
    normal = cross(turned, rays_cam)
    _, vectors = np.linalg.eigh(normal.T @ normal)
    direction: Floats = vectors[:, 0]
    return direction if np.sum((rays_cam - turned) @ direction) >= 0 else -direction


def _plane_residual(
    turned: Floats, rays_cam: Floats, sigma_rad: Floats, direction: Floats, basis: Floats
) -> tuple[Floats, Floats, Floats]:
    """Signed residual (N,) in sigmas, its derivative (N, 5) by direction (2) and rotation (3), and the flow towards
    the direction (N,) in sigmas of a difference.

    The numerator is the triple product direction . (turned x rays_cam); the denominator varies slowly and is held.
    """
    u, w = turned @ basis, rays_cam @ basis
    area = u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0]
    trace = np.einsum("ni,ni->n", u, u) + np.einsum("ni,ni->n", w, w)
    largest = 0.5 * (trace + np.sqrt(np.maximum(trace**2 - 4.0 * area**2, 0.0)))
    scale = 1.0 / (np.sqrt(np.maximum(largest, _TINY)) * sigma_rad)
    normal = cross(turned, rays_cam)
    by_direction = normal @ basis
    along_turned = turned @ direction
    cosine = np.einsum("ni,ni->n", turned, rays_cam)
    jacobian = np.empty((len(turned), 5))
    jacobian[:, :2] = by_direction
    jacobian[:, 2:] = along_turned[:, None] * rays_cam - cosine[:, None] * direction
    jacobian *= scale[:, None]
    towards = (rays_cam @ direction - along_turned) / (np.sqrt(np.maximum(trace, _TINY)) * sigma_rad)
    return (normal @ direction) * scale, jacobian, towards


def _prior_terms(
    prior: GaussianPrior, offset: Floats, direction: Floats, basis: Floats
) -> tuple[Floats, Floats, float]:
    """Information (5, 5), score (5,) and cost of the prior, ``offset (3,)`` rad from its rotation."""
    information, score = np.zeros((5, 5)), np.zeros(5)
    precision = 1.0 / prior.rotation_sigma_rad**2
    information[2:, 2:] = precision * np.eye(3)
    # On a sphere a direction is never less certain than this, whatever the flow says.
    information[:2, :2] = np.eye(2) / _OPEN_DIRECTION_RAD**2
    score[2:] = -precision * offset
    cost = precision * float(offset @ offset)
    if prior.direction is not None:
        precision = 1.0 / prior.direction_sigma_rad**2
        towards = basis.T @ prior.direction
        information[:2, :2] += precision * np.eye(2)
        score[:2] = precision * towards
        # 2 (1 - cos) is the squared angle for small ones and stays finite for opposite directions.
        cost += precision * 2.0 * (1.0 - float(direction @ prior.direction))
    return information, score, cost


def _robust_weight(residual: Floats, scale: float) -> Floats:
    weight: Floats = 1.0 / (1.0 + (residual / (scale * _REDESCENT)) ** 2) ** 2 / scale**2
    return weight


def _capped_cost(residual: Floats) -> float:
    """Sum of squared residuals, each capped: what counts is how many points a fit explains, not how far others are."""
    return float(np.sum(np.minimum(residual**2, _COST_CAP)))


def _robust_scale(residual: Floats) -> float:
    """Scale of the weights in sigmas, at least 1: a poor start sees far, a good one trusts the noise it was told.

    Half of the spread: with two fifths of the points on movers the median is no measure of the noise.
    """
    return max(1.0, 0.5 * 1.4826 * float(np.median(np.abs(residual))))


def _robust_covariance(information: Floats, score: Floats, region: Ints) -> Floats:
    """Covariance with the spread of the scores between parts of the picture in place of the assumed noise.

    Neighbouring points err together (one surface, one blur, one slant), so that N points are worth less than N
    independent ones: the scores are summed within a region before they are squared (a cluster-robust "sandwich").
    Never smaller than what the assumed noise gives.
    """
    inverse: Floats = np.linalg.inv(information).astype(np.float64)
    n_regions = int(region.max()) + 1 if len(region) else 0
    k = len(information)
    if n_regions <= k:
        return inverse
    sums = np.stack([np.bincount(region, score[:, j], n_regions) for j in range(k)], axis=1)
    n_used = len(np.unique(region))
    if n_used <= 2 * k:
        return inverse
    sandwich = inverse @ (sums.T @ sums) @ inverse * (n_used / (n_used - k))
    ratio = np.linalg.eigvals(information @ sandwich).real.max()
    return inverse * max(1.0, float(ratio))
