"""The inner loops of `two_view`: robust Gauss-Newton on rotation and direction between two frames, compiled.

All arrays that a function fills are arguments of it. Rotations are ``expected`` turned by the rotation vector
``offset``; residuals, scores and information are in sigmas.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled
from ttcvid.model import Floats, Ints

# Geman and McClure's weight falls to a quarter at so many sigmas and on towards zero: a lorry of two fifths of all
# points, which Cauchy's weight lets pull for ever, is let go.
_REDESCENT = 4.0
# Gauss-Newton ends after so many steps, or after one whose squared length in sigmas of the estimate is less.
_MAX_STEPS, _CONVERGED_CHI2 = 15, 1e-2
# A step of the direction is cut to this length, rad: beyond it the linearisation means nothing.
_LONGEST_STEP_RAD = 0.3
# A static point moves towards dir; one that moves the other way by more sigmas than this does not belong to the scene
# and keeps only so small a weight that the estimate stays defined.
_SENSE_SIGMAS, _WRONG_WAY_WEIGHT = 3.0, 0.02
# Squared lengths below this are a point on the epipole itself, rad^2.
_TINY = 1e-14


@compiled
def descend_rotation(
    rays_prev: Floats,
    rays_cam: Floats,
    sigma: Floats,
    expected: Floats,
    prior_sigma: float,
    offset: Floats,
    cam_R_prev: Floats,
    residual: Floats,
    score: Floats,
    information: Floats,
) -> None:
    """Rotation alone: ``offset (3,)`` in and out; fills ``cam_R_prev``, ``residual (N,)``, ``score (N, 3)`` and
    ``information (3, 3)``.
    """
    n = len(rays_prev)
    turned, total, step = np.empty((n, 3)), np.empty(3), np.empty(3)
    prior = 1.0 / (prior_sigma * prior_sigma)
    for _ in range(_MAX_STEPS):
        _turn(offset, expected, cam_R_prev)
        for i in range(n):
            square = 0.0
            for j in range(3):
                turned[i, j] = (
                    cam_R_prev[j, 0] * rays_prev[i, 0]
                    + cam_R_prev[j, 1] * rays_prev[i, 1]
                    + cam_R_prev[j, 2] * rays_prev[i, 2]
                )
                square += (rays_cam[i, j] - turned[i, j]) ** 2
            residual[i] = np.sqrt(0.5 * square) / sigma[i]
        scale = _robust_scale(np.sqrt(0.5) * residual)
        information[:] = 0.0
        for j in range(3):
            information[j, j] = prior
            total[j] = -offset[j] * prior
        for i in range(n):
            weight = _weight(residual[i], scale) * 0.5 / (sigma[i] * sigma[i])
            q, p = turned[i], rays_cam[i]
            # d(omega x q) . (p - q): the information of a unit ray is the projector across it.
            score[i, 0] = weight * (q[1] * p[2] - q[2] * p[1])
            score[i, 1] = weight * (q[2] * p[0] - q[0] * p[2])
            score[i, 2] = weight * (q[0] * p[1] - q[1] * p[0])
            for j in range(3):
                total[j] += score[i, j]
                information[j, j] += weight
                for k in range(3):
                    information[j, k] -= weight * q[j] * q[k]
        _solve(information, total, step)
        offset += step
        if _square(information, step) < _CONVERGED_CHI2:
            break
    _turn(offset, expected, cam_R_prev)


@compiled
def descend_motion(
    rays_prev: Floats,
    rays_cam: Floats,
    sigma: Floats,
    expected: Floats,
    prior_sigma: float,
    prior_direction: Floats,
    prior_precision: float,
    open_precision: float,
    offset: Floats,
    direction: Floats,
    cam_R_prev: Floats,
    residual: Floats,
    sense: Floats,
    score: Floats,
    information: Floats,
) -> None:
    """Rotation and direction: ``offset (3,)`` and ``direction (3,)`` in and out.

    Fills ``cam_R_prev``, the signed ``residual (N,)``, ``sense (N,)`` (`_plane_residual`),
    ``score (N, 5)`` and ``information (5, 5)`` of two tangent coordinates of the direction and the rotation vector.
    """
    n = len(rays_prev)
    jacobian, basis, q, total, step = np.empty((n, 5)), np.empty((3, 2)), np.empty(3), np.empty(5), np.empty(5)
    prior = 1.0 / (prior_sigma * prior_sigma)
    for _ in range(_MAX_STEPS):
        _tangents(direction, basis)
        _turn(offset, expected, cam_R_prev)
        for i in range(n):
            p = rays_cam[i]
            for j in range(3):
                q[j] = (
                    cam_R_prev[j, 0] * rays_prev[i, 0]
                    + cam_R_prev[j, 1] * rays_prev[i, 1]
                    + cam_R_prev[j, 2] * rays_prev[i, 2]
                )
            _plane_residual(q, p, sigma[i], direction, basis, i, residual, sense, jacobian)
        scale = _robust_scale(residual)
        information[:] = 0.0
        total[:] = 0.0
        for i in range(n):
            weight = _weight(residual[i], scale)
            if sense[i] < 0.0:
                weight *= _WRONG_WAY_WEIGHT
            for j in range(5):
                score[i, j] = -jacobian[i, j] * weight * residual[i]
                total[j] += score[i, j]
                for k in range(j + 1):
                    information[j, k] += weight * jacobian[i, j] * jacobian[i, k]
        for j in range(5):
            for k in range(j):
                information[k, j] = information[j, k]
        for j in range(3):
            information[2 + j, 2 + j] += prior
            total[2 + j] -= prior * offset[j]
        for j in range(2):
            # On a sphere a direction is never less certain than this, whatever the flow says.
            information[j, j] += open_precision + prior_precision
            for k in range(3):
                total[j] += prior_precision * basis[k, j] * prior_direction[k]
        _solve(information, total, step)
        length = np.sqrt(step[0] * step[0] + step[1] * step[1])
        shorter = min(1.0, _LONGEST_STEP_RAD / max(length, _TINY))
        step[0] *= shorter
        step[1] *= shorter
        for j in range(3):
            direction[j] += basis[j, 0] * step[0] + basis[j, 1] * step[1]
            offset[j] += step[2 + j]
        direction /= np.sqrt(direction[0] ** 2 + direction[1] ** 2 + direction[2] ** 2)
        if _square(information, step) < _CONVERGED_CHI2:
            break
    _turn(offset, expected, cam_R_prev)


@compiled
def add_up_regions(region: Ints, score: Floats, sums: Floats) -> None:
    """Add the scores ``(N, k)`` of each region to ``sums (k, regions)``."""
    for i in range(len(region)):
        for j in range(score.shape[1]):
            sums[j, region[i]] += score[i, j]


@compiled
def _plane_residual(
    q: Floats,
    p: Floats,
    sigma: float,
    direction: Floats,
    basis: Floats,
    i: int,
    residual: Floats,
    sense: Floats,
    jacobian: Floats,
) -> None:
    """Residual of point i, its derivative by direction (2) and rotation (3), and its sense.

    ``sense`` is 1 for a point that moves along the direction by more than its noise, -1 against it, else 0.

    The numerator is the triple product direction . (q x p); the denominator varies slowly and is held.
    """
    u0 = q[0] * basis[0, 0] + q[1] * basis[1, 0] + q[2] * basis[2, 0]
    u1 = q[0] * basis[0, 1] + q[1] * basis[1, 1] + q[2] * basis[2, 1]
    v0 = p[0] * basis[0, 0] + p[1] * basis[1, 0] + p[2] * basis[2, 0]
    v1 = p[0] * basis[0, 1] + p[1] * basis[1, 1] + p[2] * basis[2, 1]
    area = u0 * v1 - u1 * v0
    trace = u0 * u0 + u1 * u1 + v0 * v0 + v1 * v1
    largest = 0.5 * (trace + np.sqrt(max(trace * trace - 4.0 * area * area, 0.0)))
    scale = 1.0 / (np.sqrt(max(largest, _TINY)) * sigma)
    n0, n1, n2 = q[1] * p[2] - q[2] * p[1], q[2] * p[0] - q[0] * p[2], q[0] * p[1] - q[1] * p[0]
    along_q = q[0] * direction[0] + q[1] * direction[1] + q[2] * direction[2]
    along_p = p[0] * direction[0] + p[1] * direction[1] + p[2] * direction[2]
    cosine = q[0] * p[0] + q[1] * p[1] + q[2] * p[2]
    residual[i] = (n0 * direction[0] + n1 * direction[1] + n2 * direction[2]) * scale
    for j in range(2):
        jacobian[i, j] = (n0 * basis[0, j] + n1 * basis[1, j] + n2 * basis[2, j]) * scale
    for j in range(3):
        jacobian[i, 2 + j] = (along_q * p[j] - cosine * direction[j]) * scale
    towards = (along_p - along_q) / (np.sqrt(max(trace, _TINY)) * sigma)
    sense[i] = 0.0 if abs(towards) < _SENSE_SIGMAS else np.sign(towards)


@compiled
def _weight(residual: float, scale: float) -> float:
    relative = residual / (scale * _REDESCENT)
    weight: float = 1.0 / (1.0 + relative * relative) ** 2 / (scale * scale)
    return weight


@compiled
def _robust_scale(residual: Floats) -> float:
    """Scale of the weights in sigmas, at least 1: a poor start sees far, a good one trusts the noise it was told.

    Half of the spread: with two fifths of the points on movers the median is no measure of the noise.
    """
    spread: float = 0.5 * 1.4826 * np.median(np.abs(residual))
    return max(1.0, spread)


@compiled
def _solve(matrix: Floats, right: Floats, solution: Floats) -> None:
    """Fill ``solution`` of a positive definite system, by elimination."""
    n = len(right)
    rest = matrix.copy()
    solution[:] = right
    for j in range(n):
        for i in range(j + 1, n):
            factor = rest[i, j] / rest[j, j]
            solution[i] -= factor * solution[j]
            for k in range(j, n):
                rest[i, k] -= factor * rest[j, k]
    for j in range(n - 1, -1, -1):
        for k in range(j + 1, n):
            solution[j] -= rest[j, k] * solution[k]
        solution[j] /= rest[j, j]


@compiled
def _square(information: Floats, step: Floats) -> float:
    total = 0.0
    for j in range(len(step)):
        for k in range(len(step)):
            total += step[j] * information[j, k] * step[k]
    return total


@compiled
def _turn(offset: Floats, expected: Floats, rotation: Floats) -> None:
    """Fill ``rotation`` with ``expected`` turned by the rotation vector ``offset``, by Rodrigues' formula."""
    x, y, z = offset[0], offset[1], offset[2]
    square = x * x + y * y + z * z
    angle = np.sqrt(square)
    sine = np.sin(angle) / angle if angle > 0.0 else 1.0
    half = np.sin(0.5 * angle) / (0.5 * angle) if angle > 0.0 else 1.0
    versed = 0.5 * half * half
    turn = np.empty((3, 3))
    turn[0, 0], turn[0, 1], turn[0, 2] = (
        1.0 - versed * (y * y + z * z),
        versed * x * y - sine * z,
        versed * x * z + sine * y,
    )
    turn[1, 0], turn[1, 1], turn[1, 2] = (
        versed * x * y + sine * z,
        1.0 - versed * (x * x + z * z),
        versed * y * z - sine * x,
    )
    turn[2, 0], turn[2, 1], turn[2, 2] = (
        versed * x * z - sine * y,
        versed * y * z + sine * x,
        1.0 - versed * (x * x + y * y),
    )
    for j in range(3):
        for k in range(3):
            rotation[j, k] = turn[j, 0] * expected[0, k] + turn[j, 1] * expected[1, k] + turn[j, 2] * expected[2, k]


@compiled
def _tangents(direction: Floats, basis: Floats) -> None:
    """Fill ``basis (3, 2)`` as `rotation.tangent_basis` does."""
    x, y, z = direction[0], direction[1], direction[2]
    sign = -1.0 if 1.0 + y < 1e-3 else 1.0
    inverse = -1.0 / (sign + y)
    mixed = z * x * inverse
    basis[0, 0], basis[1, 0], basis[2, 0] = sign * mixed, -sign * z, 1.0 + sign * z * z * inverse
    basis[0, 1], basis[1, 1], basis[2, 1] = sign + x * x * inverse, -x, mixed
