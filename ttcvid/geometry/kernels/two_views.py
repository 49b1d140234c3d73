"""Robust Gauss-Newton on rotation and direction between two frames.

Residuals, scores and information are in sigmas. Rotations are an expected one turned by a rotation vector, the offset.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled, compiled_for, compiled_in_place
from ttcvid.geometry.kernels.arrays import copy_rows
from ttcvid.geometry.kernels.medians import median
from ttcvid.geometry.kernels.normal_equations import add_equations, mirror
from ttcvid.geometry.kernels.rotations import fill_rotation, fill_tangents
from ttcvid.geometry.kernels.solve import solve
from ttcvid.model import Floats

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
# The difference of two squared singular values is not taken for less than this part of their sum.
_LEAST_GAP = 1e-6


@compiled_for(
    "(f8[:, ::1], f8[:, ::1], f8[::1], Tuple((f8[:, ::1], f8[::1], f8[::1])), f8[::1], f8[::1], "
    "Tuple((f8[:, ::1], f8[::1], f8[::1], f8[:, ::1], f8[:, ::1])))"
)
def fit_two_views(
    rays_prev: Floats,
    rays_cam: Floats,
    sigma: Floats,
    priors: tuple[Floats, Floats, Floats],
    offset: Floats,
    direction: Floats,
    found: tuple[Floats, Floats, Floats, Floats, Floats],
) -> None:
    """``offset (3,)`` and ``direction (3,)`` in and out; an empty direction: rotation alone, every point at infinity.

    ``priors`` are the rotation expected, the precision of each unknown, and for the direction the score that belongs
    to that, (3,). Fills ``found``: the rotation, the ``residual (N,)``, signed where there is a direction, the
    ``sense (N,)`` of each point (`_plane_residual`), ``score (N, U)`` and ``information (U, U)``, of two tangent
    coordinates of the direction, where there is one, and the rotation vector.
    """
    cam_R_prev, residual, sense, score, information = found
    expected, precision, pull = priors
    n, n_unknowns, has_direction = len(sigma), len(information), len(direction) > 0
    now, turned = rays_cam.T.copy(), np.empty((3, n))
    n_rows, first_turn = n if has_direction else 3 * n, n_unknowns - 3
    rows, turn, basis = np.empty((n_unknowns + 1, n_rows)), np.empty((3, 3)), np.zeros((3, 2))
    step, left = np.empty(n_unknowns), np.empty((n_unknowns, n_unknowns))
    sense[:] = 0.0
    for count in range(_MAX_STEPS):
        _turn(offset, expected, turn, cam_R_prev)
        _turn_rays(cam_R_prev, rays_prev, turned)
        if has_direction:
            fill_tangents(direction[0], direction[1], direction[2], basis)
            _set_motion_rows(turned, now, sigma, _axes(direction, basis), rows, residual, sense)
        else:
            _set_rotation_rows(turned, now, sigma, rows, residual)
        _weigh(rows, residual, sense, has_direction)
        information[:], step[:] = 0.0, 0.0
        add_equations(rows, n_rows, information, step)
        for j in range(n_unknowns):
            information[j, j] += precision[j]
            if j >= first_turn:
                step[j] -= precision[j] * offset[j - first_turn]
            else:
                step[j] += basis[0, j] * pull[0] + basis[1, j] * pull[1] + basis[2, j] * pull[2]
        copy_rows(information, left)
        is_last = solve(left, step) < _CONVERGED_CHI2 or count == _MAX_STEPS - 1
        if has_direction:
            length = np.sqrt(step[0] * step[0] + step[1] * step[1])
            shorter = min(1.0, _LONGEST_STEP_RAD / max(length, _TINY))
            for j in range(3):
                direction[j] += shorter * (basis[j, 0] * step[0] + basis[j, 1] * step[1])
            length = np.sqrt(direction[0] ** 2 + direction[1] ** 2 + direction[2] ** 2)
            for j in range(3):
                direction[j] /= length
        for j in range(3):
            offset[j] += step[first_turn + j]
        if is_last:
            break
    for j in range(n_unknowns):
        for i in range(n):
            score[i, j] = 0.0
            for k in range(i, n_rows, n):
                score[i, j] += rows[j, k] * rows[n_unknowns, k]
    mirror(information)
    _turn(offset, expected, turn, cam_R_prev)


@compiled
def _turn(offset: Floats, expected: Floats, turn: Floats, rotation: Floats) -> None:
    """Fill ``rotation`` with ``expected`` turned by the ``offset``."""
    fill_rotation(offset[0], offset[1], offset[2], turn)
    for j in range(3):
        for k in range(3):
            rotation[j, k] = turn[j, 0] * expected[0, k] + turn[j, 1] * expected[1, k] + turn[j, 2] * expected[2, k]


@compiled
def _turn_rays(rotation: Floats, rays: Floats, turned: Floats) -> None:
    """Fill ``turned (3, N)``, axis by axis, from ``rays (N, 3)``."""
    for i in range(rays.shape[0]):
        for j in range(3):
            turned[j, i] = rotation[j, 0] * rays[i, 0] + rotation[j, 1] * rays[i, 1] + rotation[j, 2] * rays[i, 2]


@compiled
def _set_rotation_rows(turned: Floats, now: Floats, sigma: Floats, rows: Floats, residual: Floats) -> None:
    """Fill ``rows (4, 3 N)``, axis after axis, without weights, and ``residual (N,)``.

    The three components of a unit ray have two degrees of freedom: each counts half of a coordinate's information.
    """
    n = len(sigma)
    for i in range(n):
        scale, square = np.sqrt(0.5) / sigma[i], 0.0
        for a in range(3):
            b, c, k = (a + 1) % 3, (a + 2) % 3, a * n + i
            rows[a, k], rows[b, k], rows[c, k] = 0.0, scale * turned[c, i], -scale * turned[b, i]
            rows[3, k] = scale * (now[a, i] - turned[a, i])
            square += rows[3, k] * rows[3, k]
        residual[i] = np.sqrt(square)


@compiled
def _set_motion_rows(
    turned: Floats, now: Floats, sigma: Floats, axes: tuple[float, ...], rows: Floats, residual: Floats, sense: Floats
) -> None:
    """Fill ``rows (6, N)`` without weights, ``residual (N,)`` and ``sense (N,)``."""
    for i in range(len(sigma)):
        q, p = (turned[0, i], turned[1, i], turned[2, i]), (now[0, i], now[1, i], now[2, i])
        residual[i], rows[0, i], rows[1, i], rows[2, i], rows[3, i], rows[4, i], sense[i] = _plane_residual(
            q, p, axes, sigma[i]
        )
        rows[5, i] = -residual[i]


@compiled
def _weigh(rows: Floats, residual: Floats, sense: Floats, is_signed: bool) -> None:
    """Multiply ``rows (U + 1, M)`` of N points, N after N, by the root of their weights.

    The scale of the weights is at least 1, in sigmas: a poor start sees far, a good one trusts the noise it was told.
    It is half of the spread: with two fifths of the points on movers the median is no measure of the noise.
    """
    n, root = len(residual), np.abs(residual)
    scale = max(1.0, 0.5 * 1.4826 * median(root) * (1.0 if is_signed else np.sqrt(0.5)))
    for i in range(n):
        relative = residual[i] / (scale * _REDESCENT)
        root[i] = np.sqrt(_WRONG_WAY_WEIGHT if sense[i] < 0.0 else 1.0) / ((1.0 + relative * relative) * scale)
    for j in range(len(rows)):
        for first in range(0, rows.shape[1], n):
            for i in range(np.uint64(n)):
                rows[j, np.uint64(first) + i] *= root[i]


@compiled
def _axes(direction: Floats, basis: Floats) -> tuple[float, float, float, float, float, float, float, float, float]:
    """The direction and its two tangents as plain numbers: no array that a loop fills can hold them."""
    return (
        direction[0],
        direction[1],
        direction[2],
        basis[0, 0],
        basis[1, 0],
        basis[2, 0],
        basis[0, 1],
        basis[1, 1],
        basis[2, 1],
    )


@compiled_in_place
def _plane_residual(
    q: tuple[float, float, float], p: tuple[float, float, float], axes: tuple[float, ...], sigma: float
) -> tuple[float, float, float, float, float, float, float]:
    """Residual of a point, its derivative by direction (2) and rotation (3), and its sense.

    The sense is 1 for a point that moves along the direction by more than its noise, -1 against it, else 0.

    The residual is the smaller singular value of the two rays' parts across the direction: their area,
    direction . (q x p), over the larger one. Both are differentiated. With the denominator held, the estimate solves
    an equation that noise shifts: the direction errs by a bias that grows with the square of the noise.
    """
    q0, q1, q2 = q
    p0, p1, p2 = p
    d0, d1, d2, a0, a1, a2, b0, b1, b2 = axes
    u0, u1 = q0 * a0 + q1 * a1 + q2 * a2, q0 * b0 + q1 * b1 + q2 * b2
    v0, v1 = p0 * a0 + p1 * a1 + p2 * a2, p0 * b0 + p1 * b1 + p2 * b2
    area = u0 * v1 - u1 * v0
    trace = u0 * u0 + u1 * u1 + v0 * v0 + v1 * v1
    # Between the squared singular values. Where they are equal, on the epipole itself, the smaller has no derivative.
    gap = max(np.sqrt(max(trace * trace - 4.0 * area * area, 0.0)), _LEAST_GAP * trace, _TINY)
    largest = max(0.5 * (trace + gap), _TINY)
    scale = 1.0 / (np.sqrt(largest) * sigma)
    residual = area * scale
    by_area = scale + residual * area / (gap * largest)
    by_trace = -0.25 * residual * (1.0 + trace / gap) / largest
    n0, n1, n2 = q1 * p2 - q2 * p1, q2 * p0 - q0 * p2, q0 * p1 - q1 * p0
    along_q, along_p = q0 * d0 + q1 * d1 + q2 * d2, p0 * d0 + p1 * d1 + p2 * d2
    trace_a, trace_b = -2.0 * (along_q * u0 + along_p * v0), -2.0 * (along_q * u1 + along_p * v1)
    cosine = q0 * p0 + q1 * p1 + q2 * p2
    towards = (along_p - along_q) / (np.sqrt(max(trace, _TINY)) * sigma)
    wrong_way = -1.0 if towards <= -_SENSE_SIGMAS else 0.0
    turn_trace = -2.0 * along_q * by_trace
    return (
        residual,
        (n0 * a0 + n1 * a1 + n2 * a2) * by_area + trace_a * by_trace,
        (n0 * b0 + n1 * b1 + n2 * b2) * by_area + trace_b * by_trace,
        (along_q * p0 - cosine * d0) * by_area + (q1 * d2 - q2 * d1) * turn_trace,
        (along_q * p1 - cosine * d1) * by_area + (q2 * d0 - q0 * d2) * turn_trace,
        (along_q * p2 - cosine * d2) * by_area + (q0 * d1 - q1 * d0) * turn_trace,
        1.0 if towards >= _SENSE_SIGMAS else wrong_way,
    )
