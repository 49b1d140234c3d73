"""Bounds of tcpa and miss: the range of an inversion in the unit circle over an ellipse.

With (q, u) the radial and transverse rate of a point, tcpa and miss are ``(-q, u) / (q^2 + u^2)``. Both are harmonic,
so that their extremes over a region without the origin lie on its border.
"""

from __future__ import annotations

import numpy as np

from ttcvid.compiled import compiled, compiled_for
from ttcvid.model import Floats

CHI2_90_TWO = 4.605170185988092
"""90 % quantile of chi-square with two degrees of freedom."""

# Half the angle at which the border is looked at, as a tangent: one set uniform, one to be squeezed (`_look_around`).
_N_UNIFORM, _N_DENSE = 8, 20
_TANGENTS = np.concatenate([np.tan(np.pi * ((np.arange(n) + 0.5) / n - 0.5)) for n in (_N_UNIFORM, _N_DENSE)])
_MIN_SQUEEZE = 1e-9

# Over an ellipse that is smaller than this part of its distance from the origin the inversion is nearly linear.
_SMALL_PART = 0.3
_CLOSEST_POINT_STEPS = 6
_NEWTON_STEPS = 2
_MAX_HALF_STEP = 0.15
# Added to denominators that are zero only together with their numerators.
_TINY = 1e-300

_Ellipse = tuple[tuple[float, float, float], tuple[float, float, float]]
"""q and u, each of the centre and along the longer and the shorter semi-axis."""
# The extremes: of q over q^2 + u^2 and of u over q^2 + u^2.
_N_EXTREMES = 4
_HIGH_Q, _LOW_Q, _HIGH_U, _LOW_U = range(_N_EXTREMES)


def bounds_of_tcpa_and_miss(rates: Floats, cov: Floats) -> Floats:
    """Range of ``-q / (q^2 + u^2)`` and ``u / (q^2 + u^2)`` over the 90 % ellipse of (q, u), cut at u >= 0.

    Of ``rates (N, 2)``, q and u >= 0 in 1/s, with ``cov (N, 2, 2)``, which may be singular or zero: lower and upper
    bound of the first, then of the second, ``(4, N)`` in s. NaN where infinite: an ellipse with the origin inside
    has no bounds of the first and no upper bound of the second.
    """
    bounds = np.full((4, len(rates)), np.nan)
    _range_of_each(np.ascontiguousarray(rates), np.ascontiguousarray(cov), bounds)
    return bounds


@compiled_for("(f8[:, ::1], f8[:, :, ::1], f8[:, ::1])")
def _range_of_each(rates: Floats, cov: Floats, bounds: Floats) -> None:
    """Fill ``bounds (4, N)``: lower and upper tcpa, lower and upper miss."""
    start, found = np.empty((_N_EXTREMES, 2)), np.empty(_N_EXTREMES)
    for i in range(len(rates)):
        q, u, variance_q, variance_u, mixed = rates[i, 0], rates[i, 1], cov[i, 0, 0], cov[i, 1, 1], cov[i, 0, 1]
        square, determinant = q * q + u * u, variance_q * variance_u - mixed * mixed
        reaches_axis = u * u <= CHI2_90_TWO * variance_u
        if reaches_axis:
            bounds[2, i] = 0.0
        mahalanobis = variance_u * q * q - 2.0 * mixed * q * u + variance_q * u * u
        # NaN is not outside either.
        if not (mahalanobis >= CHI2_90_TWO * determinant and square > 0.0):
            continue
        # Radial and transverse part, q and u, of the longer and of the shorter semi-axis.
        half_difference = 0.5 * (variance_q - variance_u)
        root = np.sqrt(half_difference * half_difference + mixed * mixed)
        longer = 0.5 * (variance_q + variance_u) + root
        shorter = determinant / longer if longer > 0.0 else 0.0
        # Of twice the angle of the longer axis, these are cosine and sine.
        cos_twice, sin_twice = (half_difference / root, mixed / root) if root > 0.0 else (1.0, 0.0)
        # The larger one of the two by a root, so that no digits are lost.
        larger = np.sqrt(0.5 * (1.0 + abs(cos_twice)))
        other = 0.5 * sin_twice / larger
        cos, sin = (larger, other) if cos_twice >= 0.0 else (abs(other), np.copysign(larger, sin_twice))
        long, short = np.sqrt(CHI2_90_TWO * max(longer, 0.0)), np.sqrt(CHI2_90_TWO * max(shorter, 0.0))
        aq, au, bq, bu = long * cos, long * sin, -short * sin, short * cos
        ellipse = (q, aq, bq), (u, au, bu)
        if not reaches_axis and aq * aq + au * au < _SMALL_PART * _SMALL_PART * square:
            # Where the extremes would be if the objectives were linear: their gradients at the centre are
            # (u^2 - q^2, -2 q u) and (-2 q u, q^2 - u^2), over (q^2 + u^2)^2.
            along, across = u * u - q * q, -2.0 * q * u
            for high, by_q, by_u in ((_HIGH_Q, along, across), (_HIGH_U, across, -along)):
                by_cos, by_sin = by_q * aq + by_u * au, by_q * bq + by_u * bu
                inverse = 1.0 / (np.sqrt(by_cos * by_cos + by_sin * by_sin) + _TINY)
                start[high, 0], start[high, 1] = by_cos * inverse, by_sin * inverse
                start[high + 1, 0], start[high + 1, 1] = -by_cos * inverse, -by_sin * inverse
        else:
            _look_around(ellipse, start)
        for extreme in range(_N_EXTREMES):
            found[extreme] = _climbed(ellipse, extreme, start)
        if reaches_axis:
            # The axis u = 0 crosses the ellipse, too.
            slope = mixed / variance_u if variance_u > 0.0 else 0.0
            left_over = CHI2_90_TWO - (u * u / variance_u if variance_u > 0.0 else 0.0)
            half_width = np.sqrt(max(left_over, 0.0) * max(variance_q - slope * mixed, 0.0))
            for side in (-1.0, 1.0):
                crossing = q - slope * u + side * half_width
                if crossing != 0.0:
                    found[_HIGH_Q], found[_LOW_Q] = (
                        max(found[_HIGH_Q], 1.0 / crossing),
                        min(found[_LOW_Q], 1.0 / crossing),
                    )
        bounds[0, i], bounds[1, i], bounds[3, i] = -found[_HIGH_Q], -found[_LOW_Q], found[_HIGH_U]
        if not reaches_axis:
            bounds[2, i] = found[_LOW_U]


@compiled
def _look_around(ellipse: _Ellipse, start: Floats) -> None:
    """Fill ``start (4, 2)``, cosine and sine of the extremes among places on the border, at u >= 0.

    The border is looked at in places that are dense where it is next to the origin: where the ellipse passes the origin
    at a distance small against its axes, the inversion has a peak there of the width ``squeeze``. Half-angle tangents
    times ``squeeze`` resolve that peak as they resolve a circle. The point next to the origin is found by Newton on
    Eberly's equation, *Distance from a Point to an Ellipse*, 2013: convex, and started on its left.
    """
    (q0, aq, bq), (u0, au, bu) = ellipse
    aa, bb = aq * aq + au * au, bq * bq + bu * bu
    towards_a, towards_b = -(aq * q0 + au * u0), -(bq * q0 + bu * u0)
    a_y, b_y = abs(towards_a), abs(towards_b)
    t = max(a_y - aa, b_y - bb)
    for _ in range(_CLOSEST_POINT_STEPS):
        t_a, t_b = t + aa + _TINY, t + bb + _TINY
        first, second = (a_y / t_a) ** 2, (b_y / t_b) ** 2
        t += (first + second - 1.0) / (2.0 * (first / t_a + second / t_b) + _TINY)
    cos0 = min(a_y / (t + aa + _TINY), 1.0)
    cos0, sin0 = np.copysign(cos0, towards_a), np.copysign(np.sqrt(1.0 - cos0 * cos0), towards_b)
    offset_q, offset_u = aq * cos0 + bq * sin0, au * cos0 + bu * sin0
    tangent_q, tangent_u = bq * cos0 - aq * sin0, bu * cos0 - au * sin0
    near_q, near_u = q0 + offset_q, u0 + offset_u
    bend = tangent_q * tangent_q + tangent_u * tangent_u - near_q * offset_q - near_u * offset_u
    squeeze = 1.0
    if bend > 0.0:
        squeeze = np.sqrt(min(max((near_q * near_q + near_u * near_u) / bend, _MIN_SQUEEZE * _MIN_SQUEEZE), 1.0))
    start[:, 0], start[:, 1] = cos0, sin0
    highest_q, lowest_q, highest_u, lowest_u = -np.inf, np.inf, -np.inf, np.inf
    for k in range(len(_TANGENTS)):
        tangent = _TANGENTS[k] * (1.0 if k < _N_UNIFORM else squeeze)
        scale = 1.0 / (1.0 + tangent * tangent)
        cosine, sine = (1.0 - tangent * tangent) * scale, 2.0 * tangent * scale
        cos, sin = cosine * cos0 - sine * sin0, sine * cos0 + cosine * sin0
        q, u = q0 + aq * cos + bq * sin, u0 + au * cos + bu * sin
        inverse = 1.0 / (q * q + u * u)
        q, u = q * inverse, u * inverse
        if not u >= 0.0:
            continue
        if q > highest_q:
            highest_q, start[_HIGH_Q, 0], start[_HIGH_Q, 1] = q, cos, sin
        if q < lowest_q:
            lowest_q, start[_LOW_Q, 0], start[_LOW_Q, 1] = q, cos, sin
        if u > highest_u:
            highest_u, start[_HIGH_U, 0], start[_HIGH_U, 1] = u, cos, sin
        if u < lowest_u:
            lowest_u, start[_LOW_U, 0], start[_LOW_U, 1] = u, cos, sin


@compiled
def _climbed(ellipse: _Ellipse, extreme: int, start: Floats) -> float:
    """One of the extremes along the ellipse near its ``start (4, 2)``, or that of the centre, by Newton steps.

    With n and m for q and u, or for u and q, the steps go to the zero of the derivative's numerator, ``n' D - n D'``
    with the objective n / D = n / (n^2 + m^2).
    """
    is_u, sign = extreme >= _HIGH_U, 1.0 if extreme in (_HIGH_Q, _HIGH_U) else -1.0
    (n_0, n_a, n_b), (m_0, m_a, m_b) = (ellipse[1], ellipse[0]) if is_u else (ellipse[0], ellipse[1])
    cos, sin, best = start[extreme, 0], start[extreme, 1], sign * n_0 / (n_0 * n_0 + m_0 * m_0)
    for _ in range(_NEWTON_STEPS + 1):
        n_offset, m_offset = n_a * cos + n_b * sin, m_a * cos + m_b * sin
        n, m = n_0 + n_offset, m_0 + m_offset
        square = n * n + m * m
        if (n if is_u else m) >= 0.0 and square > 0.0:
            best = max(best, sign * n / square)
        n_1, m_1 = n_b * cos - n_a * sin, m_b * cos - m_a * sin
        bend = n_1 * n_1 + m_1 * m_1 - n * n_offset - m * m_offset
        slope = n_1 * square - 2.0 * n * (n * n_1 + m * m_1)
        curvature = abs(n_offset * square + 2.0 * n * bend)
        half_step = min(max(0.5 * sign * slope / (curvature + _TINY), -_MAX_HALF_STEP), _MAX_HALF_STEP)
        scale = 1.0 / (1.0 + half_step * half_step)
        turn_cos, turn_sin = (1.0 - half_step * half_step) * scale, 2.0 * half_step * scale
        cos, sin = cos * turn_cos - sin * turn_sin, sin * turn_cos + cos * turn_sin
    return sign * best
