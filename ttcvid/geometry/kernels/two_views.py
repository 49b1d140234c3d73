"""Robust Gauss-Newton on rotation and direction between two frames.

Residuals, scores and information are in sigmas. Rotations are an expected one turned by a rotation vector, the offset.
"""

from __future__ import annotations

import numpy as np

from ttcvid.compiled import compiled, compiled_for
from ttcvid.geometry.kernels.medians import median
from ttcvid.geometry.kernels.normal_equations import add_equations
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
# The most that a point costs, also where it moves the wrong way.
_COST_CAP = _SENSE_SIGMAS**2
# Squared lengths below this are a point on the epipole itself, rad^2.
_TINY = 1e-14
# The difference of two squared singular values is not taken for less than this part of their sum.
_LEAST_GAP = 1e-6


@compiled_for(
    "(f8[:, ::1], f8[:, ::1], f8[::1], Tuple((f8[:, ::1], f8[::1], f8[::1])), f8[::1], f8[::1], "
    "Tuple((f8[::1], f8[::1], f8[:, ::1], f8[:, ::1])))"
)
def fit_two_views(
    rays_prev: Floats,
    now: Floats,
    sigma: Floats,
    priors: tuple[Floats, Floats, Floats],
    offset: Floats,
    direction: Floats,
    found: tuple[Floats, Floats, Floats, Floats],
) -> float:
    """``offset (3,)`` and ``direction (3,)`` in and out; an empty direction: rotation alone, every point at infinity.

    ``rays_prev (N, 3)`` are of the first view, ``now (3, N)`` of the second; ``priors`` the rotation expected, the
    precision of each unknown, and for the direction the score that belongs to that, (3,). Fills ``found``: the
    ``residual (N,)``, signed where there is a direction, the ``sense (N,)`` of each point (`_set_motion_rows`), the
    ``rows`` of `normal_equations.add_equations`, (U + 1, N), for a rotation alone (U + 1, 3 N), and ``information (U,
    U)``; the unknowns are two tangent coordinates of the direction, where there is one, and the rotation vector.

    Returns the cost: what counts is how many points a fit explains, not how far others are; one that moves the wrong
    way costs as much as any.
    """
    residual, sense, rows, information = found
    expected, precision, pull = priors
    n, n_unknowns, has_direction = len(sigma), len(information), len(direction) > 0
    root, turned, turn, cam_R_prev = np.empty(n), np.empty((3, n)), np.empty((3, 3)), np.empty((3, 3))
    n_rows, first_turn = n if has_direction else 3 * n, n_unknowns - 3
    axes, basis = np.empty((3, 3)), np.empty((3, 2))
    step, left = np.empty(n_unknowns), np.empty((n_unknowns, n_unknowns))
    for count in range(_MAX_STEPS):
        fill_rotation(offset[0], offset[1], offset[2], turn)
        for j in range(3):
            for k in range(3):
                cam_R_prev[j, k] = (
                    turn[j, 0] * expected[0, k] + turn[j, 1] * expected[1, k] + turn[j, 2] * expected[2, k]
                )
        for i in range(n):
            x, y, z = rays_prev[i, 0], rays_prev[i, 1], rays_prev[i, 2]
            for j in range(3):
                turned[j, i] = cam_R_prev[j, 0] * x + cam_R_prev[j, 1] * y + cam_R_prev[j, 2] * z
        if has_direction:
            fill_tangents(direction[0], direction[1], direction[2], basis)
            for j in range(3):
                axes[0, j], axes[1, j], axes[2, j] = direction[j], basis[j, 0], basis[j, 1]
            _set_motion_rows(turned, now, sigma, axes, rows, residual, sense)
        else:
            for i in range(n):
                # The three components of a unit ray have two degrees of freedom: each counts half of a coordinate's
                # information.
                scale, square = np.sqrt(0.5) / sigma[i], 0.0
                for a in range(3):
                    b, c, k = (a + 1) % 3, (a + 2) % 3, a * n + i
                    rows[a, k], rows[b, k], rows[c, k] = 0.0, scale * turned[c, i], -scale * turned[b, i]
                    rows[3, k] = scale * (now[a, i] - turned[a, i])
                    square += rows[3, k] * rows[3, k]
                residual[i] = np.sqrt(square)
        # The scale of the weights is at least 1, in sigmas: a poor start sees far, a good one trusts the noise it was
        # told. It is half of the spread: with two fifths of the points on movers the median is no measure of the noise.
        for i in range(n):
            root[i] = abs(residual[i])
        scale = max(1.0, 0.5 * 1.4826 * median(root) * (1.0 if has_direction else np.sqrt(0.5)))
        for i in range(n):
            relative = residual[i] / (scale * _REDESCENT)
            root[i] = np.sqrt(_WRONG_WAY_WEIGHT if sense[i] < 0.0 else 1.0) / ((1.0 + relative * relative) * scale)
        for j in range(n_unknowns + 1):
            for first in range(0, n_rows, n):
                for i in range(np.uint64(n)):
                    rows[j, np.uint64(first) + i] *= root[i]
        for j in range(n_unknowns):
            step[j] = 0.0
            for k in range(n_unknowns):
                information[j, k] = 0.0
        add_equations(rows, n_rows, information, step)
        for j in range(n_unknowns):
            information[j, j] += precision[j]
            if j >= first_turn:
                step[j] -= precision[j] * offset[j - first_turn]
            else:
                step[j] += basis[0, j] * pull[0] + basis[1, j] * pull[1] + basis[2, j] * pull[2]
        for j in range(n_unknowns):
            for k in range(j + 1):
                left[j, k] = information[j, k]
        is_last = solve(left, step) < _CONVERGED_CHI2 or count == _MAX_STEPS - 1
        if has_direction:
            length = np.sqrt(step[0] * step[0] + step[1] * step[1])
            shorter = min(1.0, _LONGEST_STEP_RAD / max(length, _TINY))
            for j in range(3):
                direction[j] += shorter * (basis[j, 0] * step[0] + basis[j, 1] * step[1])
            length = np.sqrt(direction[0] * direction[0] + direction[1] * direction[1] + direction[2] * direction[2])
            for j in range(3):
                direction[j] /= length
        for j in range(3):
            offset[j] += step[first_turn + j]
        if is_last:
            break
    for j in range(n_unknowns):
        for k in range(j):
            information[k, j] = information[j, k]
    cost = 0.0
    for i in range(n):
        cost += min(residual[i] * residual[i], _COST_CAP) if sense[i] >= 0.0 else _COST_CAP
    for j in range(3):
        cost += precision[first_turn + j] * offset[j] * offset[j]
    if has_direction:
        # 2 (1 - cos) is the squared angle for small ones and stays finite for opposite directions.
        cost += 2.0 * np.sqrt(pull[0] * pull[0] + pull[1] * pull[1] + pull[2] * pull[2])
        cost -= 2.0 * (direction[0] * pull[0] + direction[1] * pull[1] + direction[2] * pull[2])
    return float(cost)


@compiled
def _set_motion_rows(
    turned: Floats, now: Floats, sigma: Floats, axes: Floats, rows: Floats, residual: Floats, sense: Floats
) -> None:
    """Fill ``rows (6, N)`` without weights, ``residual (N,)`` and ``sense (N,)``; axes (3, 3): direction and tangents.

    The rows have the derivatives by direction (2) and rotation (3). The sense is 1 for a point that moves along the
    direction by more than its noise, -1 against it, else 0.

    The residual is the smaller singular value of the two rays' parts across the direction: their area,
    direction . (q x p), over the larger one. Both are differentiated. With the denominator held, the estimate solves
    an equation that noise shifts: the direction errs by a bias that grows with the square of the noise.
    """
    # As plain numbers: no array that the loop fills can hold them.
    d0, d1, d2, a0, a1, a2 = axes[0, 0], axes[0, 1], axes[0, 2], axes[1, 0], axes[1, 1], axes[1, 2]
    b0, b1, b2 = axes[2, 0], axes[2, 1], axes[2, 2]
    for i in range(len(sigma)):
        q0, q1, q2, p0, p1, p2 = turned[0, i], turned[1, i], turned[2, i], now[0, i], now[1, i], now[2, i]
        u0, u1 = q0 * a0 + q1 * a1 + q2 * a2, q0 * b0 + q1 * b1 + q2 * b2
        v0, v1 = p0 * a0 + p1 * a1 + p2 * a2, p0 * b0 + p1 * b1 + p2 * b2
        area = u0 * v1 - u1 * v0
        trace = u0 * u0 + u1 * u1 + v0 * v0 + v1 * v1
        # Between the squared singular values. Where they are equal, on the epipole, the smaller has no derivative.
        gap = max(np.sqrt(max(trace * trace - 4.0 * area * area, 0.0)), _LEAST_GAP * trace, _TINY)
        largest = max(0.5 * (trace + gap), _TINY)
        scale = 1.0 / (np.sqrt(largest) * sigma[i])
        off = area * scale
        by_area = scale + off * area / (gap * largest)
        by_trace = -0.25 * off * (1.0 + trace / gap) / largest
        n0, n1, n2 = q1 * p2 - q2 * p1, q2 * p0 - q0 * p2, q0 * p1 - q1 * p0
        along_q, along_p = q0 * d0 + q1 * d1 + q2 * d2, p0 * d0 + p1 * d1 + p2 * d2
        cosine, turn_trace = q0 * p0 + q1 * p1 + q2 * p2, -2.0 * along_q * by_trace
        rows[0, i] = (n0 * a0 + n1 * a1 + n2 * a2) * by_area - 2.0 * (along_q * u0 + along_p * v0) * by_trace
        rows[1, i] = (n0 * b0 + n1 * b1 + n2 * b2) * by_area - 2.0 * (along_q * u1 + along_p * v1) * by_trace
        rows[2, i] = (along_q * p0 - cosine * d0) * by_area + (q1 * d2 - q2 * d1) * turn_trace
        rows[3, i] = (along_q * p1 - cosine * d1) * by_area + (q2 * d0 - q0 * d2) * turn_trace
        rows[4, i] = (along_q * p2 - cosine * d2) * by_area + (q0 * d1 - q1 * d0) * turn_trace
        rows[5, i], residual[i] = -off, off
        towards = (along_p - along_q) / (np.sqrt(max(trace, _TINY)) * sigma[i])
        wrong_way = -1.0 if towards <= -_SENSE_SIGMAS else 0.0
        sense[i] = 1.0 if towards >= _SENSE_SIGMAS else wrong_way
