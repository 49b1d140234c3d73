"""The inner loops of `two_view`: robust Gauss-Newton on rotation and direction between two frames, compiled.

All arrays that a function fills are arguments of it. Rotations are ``expected`` turned by the rotation vector
``offset``; residuals, scores and information are in sigmas.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled, compiled_for, compiled_in_place
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


@compiled_for("(f8[:, ::1], f8[:, ::1], f8[::1], f8[:, ::1], f8, f8[::1], f8[:, ::1], f8[::1], f8[:, ::1], f8[:, ::1])")
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
    before, now, turned = _by_axis(rays_prev), _by_axis(rays_cam), np.empty((3, n))
    total, step = np.empty(3), np.empty(3)
    prior = 1.0 / (prior_sigma * prior_sigma)
    for count in range(_MAX_STEPS):
        _turn(offset, expected, cam_R_prev)
        _turn_rays(cam_R_prev, before, turned)
        for i in range(n):
            x, y, z = now[0, i] - turned[0, i], now[1, i] - turned[1, i], now[2, i] - turned[2, i]
            residual[i] = np.sqrt(0.5 * (x * x + y * y + z * z)) / sigma[i]
        scale = _robust_scale(np.sqrt(0.5) * residual)
        _add_up_rotation(turned, now, sigma, residual, scale, information, total)
        for j in range(3):
            information[j, j] += prior
            total[j] -= offset[j] * prior
        _solve(information, total, step)
        is_last = count == _MAX_STEPS - 1 or _square(information, step) < _CONVERGED_CHI2
        if is_last:
            for i in range(n):
                weight = _weight(residual[i], scale) * 0.5 / (sigma[i] * sigma[i])
                for j in range(3):
                    k, m = (j + 1) % 3, (j + 2) % 3
                    score[i, j] = weight * (turned[k, i] * now[m, i] - turned[m, i] * now[k, i])
        offset += step
        if is_last:
            break
    _turn(offset, expected, cam_R_prev)


@compiled_for(
    "(f8[:, ::1], f8[:, ::1], f8[::1], f8[:, ::1], f8, f8[::1], f8, f8, f8[::1], f8[::1], f8[:, ::1], f8[::1], "
    "f8[::1], f8[:, ::1], f8[:, ::1])"
)
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
    before, now, turned = _by_axis(rays_prev), _by_axis(rays_cam), np.empty((3, n))
    basis, total, step = np.empty((3, 2)), np.empty(5), np.empty(5)
    prior = 1.0 / (prior_sigma * prior_sigma)
    for count in range(_MAX_STEPS):
        _tangents(direction, basis)
        _turn(offset, expected, cam_R_prev)
        _turn_rays(cam_R_prev, before, turned)
        axes = _axes(direction, basis)
        _set_residuals(turned, now, sigma, axes, residual)
        scale = _robust_scale(residual)
        _add_up_motion(turned, now, sigma, axes, scale, information, total)
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
        is_last = count == _MAX_STEPS - 1 or _square(information, step) < _CONVERGED_CHI2
        if is_last:
            for i in range(n):
                q, p = (turned[0, i], turned[1, i], turned[2, i]), (now[0, i], now[1, i], now[2, i])
                r, j0, j1, j2, j3, j4, sense[i] = _plane_residual(q, p, axes, sigma[i])
                pull = -_weight(r, scale) * (_WRONG_WAY_WEIGHT if sense[i] < 0.0 else 1.0) * r
                score[i, 0], score[i, 1] = pull * j0, pull * j1
                score[i, 2], score[i, 3], score[i, 4] = pull * j2, pull * j3, pull * j4
        for j in range(3):
            direction[j] += basis[j, 0] * step[0] + basis[j, 1] * step[1]
            offset[j] += step[2 + j]
        direction /= np.sqrt(direction[0] ** 2 + direction[1] ** 2 + direction[2] ** 2)
        if is_last:
            break
    _turn(offset, expected, cam_R_prev)


@compiled
def _by_axis(rays: Floats) -> Floats:
    """Rays ``(N, 3)`` as ``(3, N)``: loops over them then work at several at a time."""
    by_axis = np.empty((3, len(rays)))
    for i in range(len(rays)):
        by_axis[0, i], by_axis[1, i], by_axis[2, i] = rays[i, 0], rays[i, 1], rays[i, 2]
    return by_axis


@compiled
def _turn_rays(rotation: Floats, rays: Floats, turned: Floats) -> None:
    """Fill ``turned (3, N)``, axis by axis."""
    for j in range(3):
        a, b, c, row = rotation[j, 0], rotation[j, 1], rotation[j, 2], turned[j]
        for i in range(rays.shape[1]):
            row[i] = a * rays[0, i] + b * rays[1, i] + c * rays[2, i]


@compiled
def _add_up_rotation(
    turned: Floats, now: Floats, sigma: Floats, residual: Floats, scale: float, information: Floats, total: Floats
) -> None:
    """Fill ``information (3, 3)`` and score ``total (3,)`` of all points.

    d(omega x q) . (p - q): the information of a unit ray is the projector across it.
    """
    xx, xy, yy, xz, yz, zz, s0, s1, s2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(len(sigma)):
        weight = _weight(residual[i], scale) * 0.5 / (sigma[i] * sigma[i])
        x, y, z = turned[0, i], turned[1, i], turned[2, i]
        s0 += weight * (y * now[2, i] - z * now[1, i])
        s1 += weight * (z * now[0, i] - x * now[2, i])
        s2 += weight * (x * now[1, i] - y * now[0, i])
        xx += weight * x * x
        xy += weight * x * y
        yy += weight * y * y
        xz += weight * x * z
        yz += weight * y * z
        zz += weight * z * z
    total[0], total[1], total[2] = s0, s1, s2
    # Unit rays: the sum of the weights is that of the squares.
    information[0, 0], information[1, 1], information[2, 2] = yy + zz, xx + zz, xx + yy
    information[0, 1] = information[1, 0] = -xy
    information[0, 2] = information[2, 0] = -xz
    information[1, 2] = information[2, 1] = -yz


@compiled
def _set_residuals(turned: Floats, now: Floats, sigma: Floats, axes: tuple[float, ...], residual: Floats) -> None:
    """Fill ``residual (N,)``."""
    for i in range(len(sigma)):
        q, p = (turned[0, i], turned[1, i], turned[2, i]), (now[0, i], now[1, i], now[2, i])
        residual[i] = _plane_residual(q, p, axes, sigma[i])[0]


@compiled
def _add_up_motion(
    turned: Floats,
    now: Floats,
    sigma: Floats,
    axes: tuple[float, ...],
    scale: float,
    information: Floats,
    total: Floats,
) -> None:
    """Fill ``information (5, 5)`` and score ``total (5,)`` of all points."""
    n00, n10, n11, n20, n21, n22, n30, n31 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    n32, n33, n40, n41, n42, n43, n44 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    s0, s1, s2, s3, s4 = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(len(sigma)):
        q, p = (turned[0, i], turned[1, i], turned[2, i]), (now[0, i], now[1, i], now[2, i])
        r, j0, j1, j2, j3, j4, sense = _plane_residual(q, p, axes, sigma[i])
        weight = _weight(r, scale) * (_WRONG_WAY_WEIGHT if sense < 0.0 else 1.0)
        w0, w1, w2, w3, w4 = weight * j0, weight * j1, weight * j2, weight * j3, weight * j4
        n00 += w0 * j0
        n10 += w1 * j0
        n11 += w1 * j1
        n20 += w2 * j0
        n21 += w2 * j1
        n22 += w2 * j2
        n30 += w3 * j0
        n31 += w3 * j1
        n32 += w3 * j2
        n33 += w3 * j3
        n40 += w4 * j0
        n41 += w4 * j1
        n42 += w4 * j2
        n43 += w4 * j3
        n44 += w4 * j4
        s0 += w0 * r
        s1 += w1 * r
        s2 += w2 * r
        s3 += w3 * r
        s4 += w4 * r
    total[0], total[1], total[2], total[3], total[4] = -s0, -s1, -s2, -s3, -s4
    information[0, 0], information[1, 0], information[1, 1] = n00, n10, n11
    information[2, 0], information[2, 1], information[2, 2] = n20, n21, n22
    information[3, 0], information[3, 1], information[3, 2], information[3, 3] = n30, n31, n32, n33
    information[4, 0], information[4, 1], information[4, 2] = n40, n41, n42
    information[4, 3], information[4, 4] = n43, n44
    for j in range(5):
        for k in range(j):
            information[k, j] = information[j, k]


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


@compiled_in_place
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
    """Fill ``solution`` of a positive definite system, by elimination; as in `shared_path_descent`."""
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
    """Fill ``rotation`` with ``expected`` turned as `rotation.rotation_from_vector` of ``offset`` does."""
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
