"""Bounds of tcpa and miss: the range of an inversion in the unit circle over an ellipse.

With (q, u) the radial and transverse rate of a point, tcpa and miss are ``(-q, u) / (q^2 + u^2)``. Both are harmonic,
so that their extremes over a region without the origin lie on its border.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled, compiled_for, compiled_in_place
from ttcvid.model import Floats

CHI2_90_TWO = 4.605170185988092
"""90 % quantile of chi-square with two degrees of freedom."""

# Tangents of half the angle at which the border is looked at: one set uniform, one to be squeezed (see `_look_around`).
_N_UNIFORM, _N_DENSE, _N_LOOKS = np.uint64(8), np.uint64(20), np.uint64(28)
_TANGENTS = np.concatenate([np.tan(np.pi * ((np.arange(n) + 0.5) / n - 0.5)) for n in (_N_UNIFORM, _N_DENSE)])
_LOOK_SIN, _LOOK_Q, _LOOK_U, _N_LOOK = (np.uint64(28 * j) for j in range(1, 5))
_MIN_SQUEEZE = 1e-9

# Over an ellipse that is smaller than this part of its distance from the origin the inversion is nearly linear.
_SMALL_PART = 0.3
_CLOSEST_POINT_STEPS = 6
_NEWTON_STEPS = 2
_MAX_HALF_STEP = 0.15
# Added to denominators that are zero only together with their numerators.
_TINY = 1e-300

# What is known of a block of points stands in one flat array, number j of point c at ``j + c``, and is worked at in
# loops without a branch: only then the compiler takes several points at a time. Without a sign: an index that may count
# from the end would take them apart. q and u, their covariance, the semi-axes of the ellipse (q and u of the longer
# one, of the shorter one), whether it is without the origin, and small.
_BLOCK = np.uint64(32)
_U, _VARIANCE_Q, _VARIANCE_U, _MIXED, _LONG_Q, _LONG_U, _SHORT_Q, _SHORT_U, _IS_OUTSIDE, _IS_SMALL = (
    np.uint64(32 * j) for j in range(1, 11)
)
# Highest q, lowest q, highest u, lowest u: cosine and sine of where on the ellipse, and q or u over q^2 + u^2 there.
_COS, _SIN, _FOUND, _N_POINT = (np.uint64(32 * j) for j in (11, 15, 19, 23))
_HIGH_Q, _LOW_Q, _HIGH_U, _LOW_U = (np.uint64(32 * j) for j in range(4))


def inversion_range(rates: Floats, cov: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Range of ``-q / (q^2 + u^2)`` and ``u / (q^2 + u^2)`` over the 90 % ellipse of (q, u), cut at u >= 0.

    Parameters
    ----------
    rates
        ``(N, 2)`` q and u >= 0 in 1/s.
    cov
        ``(N, 2, 2)`` in 1/s^2; may be singular or zero.

    Returns
    -------
    Lower and upper bound of the first, then of the second, each ``(N,)`` in s. NaN where infinite: an ellipse with
    the origin inside has no bounds of the first and no upper bound of the second.
    """
    bounds = np.full((4, len(rates)), np.nan)
    _range_of_each(np.ascontiguousarray(rates), np.ascontiguousarray(cov), bounds)
    return bounds[0], bounds[1], bounds[2], bounds[3]


@compiled_for("(f8[:, ::1], f8[:, :, ::1], f8[:, ::1])")
def _range_of_each(rates: Floats, cov: Floats, bounds: Floats) -> None:
    """Fill ``bounds (4, N)``: lower and upper tcpa, lower and upper miss."""
    points, looks = np.ones(_N_POINT), np.empty(_N_LOOK)
    for first in range(0, len(rates), _BLOCK):
        count = min(len(rates) - first, int(_BLOCK))
        for c in range(count):
            i = first + c
            points[c], points[_U + c], points[_MIXED + c] = rates[i, 0], rates[i, 1], cov[i, 0, 1]
            points[_VARIANCE_Q + c], points[_VARIANCE_U + c] = cov[i, 0, 0], cov[i, 1, 1]
        _look_uphill(points)
        for c in range(count):
            if points[_IS_OUTSIDE + c] > points[_IS_SMALL + c]:
                _look_around(points, c, looks)
        _climb(points)
        for c in range(count):
            reaches_axis = points[_U + c] * points[_U + c] <= CHI2_90_TWO * points[_VARIANCE_U + c]
            if points[_IS_OUTSIDE + c] == 1.0:
                if reaches_axis:
                    _look_on_axis(points, c)
                bounds[0, first + c] = -points[_FOUND + _HIGH_Q + c]
                bounds[1, first + c] = -points[_FOUND + _LOW_Q + c]
                bounds[2, first + c] = points[_FOUND + _LOW_U + c]
                bounds[3, first + c] = points[_FOUND + _HIGH_U + c]
            if reaches_axis:
                bounds[2, first + c] = 0.0


@compiled
def _look_uphill(points: Floats) -> None:
    """Ellipses of a block of points, and on each where the objectives, taken as linear, are highest and lowest."""
    for c in range(_BLOCK):
        q, u, variance_q, variance_u = points[c], points[_U + c], points[_VARIANCE_Q + c], points[_VARIANCE_U + c]
        mixed, square = points[_MIXED + c], q * q + u * u
        half_difference = 0.5 * (variance_q - variance_u)
        root = np.sqrt(half_difference * half_difference + mixed * mixed)
        longer = 0.5 * (variance_q + variance_u) + root
        determinant = variance_q * variance_u - mixed * mixed
        shorter = determinant / longer if longer > 0.0 else 0.0
        # Of twice the angle of the longer axis, these are cosine and sine.
        cos_twice = half_difference / root if root > 0.0 else 1.0
        sin_twice = mixed / root if root > 0.0 else 0.0
        # The larger one of the two by a root, so that no digits are lost.
        larger = np.sqrt(0.5 * (1.0 + abs(cos_twice)))
        other = 0.5 * sin_twice / larger
        cos = larger if cos_twice >= 0.0 else abs(other)
        sin = other if cos_twice >= 0.0 else (larger if sin_twice >= 0.0 else -larger)
        long, short = np.sqrt(CHI2_90_TWO * max(longer, 0.0)), np.sqrt(CHI2_90_TWO * max(shorter, 0.0))
        aq, au, bq, bu = long * cos, long * sin, -short * sin, short * cos
        points[_LONG_Q + c], points[_LONG_U + c], points[_SHORT_Q + c], points[_SHORT_U + c] = aq, au, bq, bu
        # NaN is not outside either.
        mahalanobis = variance_u * q * q - 2.0 * mixed * q * u + variance_q * u * u
        is_outside = (mahalanobis >= CHI2_90_TWO * determinant) & (square > 0.0)
        is_small = (u * u > CHI2_90_TWO * variance_u) & (long * long < _SMALL_PART * _SMALL_PART * square)
        points[_IS_OUTSIDE + c] = 1.0 if is_outside else 0.0
        points[_IS_SMALL + c] = 1.0 if is_outside & is_small else 0.0
        # The gradients at the centre are (u^2 - q^2, -2 q u) and (-2 q u, q^2 - u^2), over (q^2 + u^2)^2.
        along, across = u * u - q * q, -2.0 * q * u
        by_cos, by_sin = along * aq + across * au, along * bq + across * bu
        inverse = 1.0 / (np.sqrt(by_cos * by_cos + by_sin * by_sin) + _TINY)
        cos, sin = by_cos * inverse, by_sin * inverse
        points[_COS + c], points[_SIN + c] = cos, sin
        points[_COS + _LOW_Q + c], points[_SIN + _LOW_Q + c] = -cos, -sin
        by_cos, by_sin = across * aq - along * au, across * bq - along * bu
        inverse = 1.0 / (np.sqrt(by_cos * by_cos + by_sin * by_sin) + _TINY)
        cos, sin = by_cos * inverse, by_sin * inverse
        points[_COS + _HIGH_U + c], points[_SIN + _HIGH_U + c] = cos, sin
        points[_COS + _LOW_U + c], points[_SIN + _LOW_U + c] = -cos, -sin


@compiled
def _look_around(points: Floats, c: int, looks: Floats) -> None:
    """Where the objectives are highest and lowest among places on the border of the ellipse of point c, at u >= 0.

    The border is looked at in places that are dense where it is next to the origin: where the ellipse passes the origin
    at a distance small against its axes, the inversion has a peak there of the width ``squeeze``. Half-angle tangents
    times ``squeeze`` resolve that peak as they resolve a circle. ``looks`` is scratch.
    """
    q0, u0, aq, au = points[c], points[_U + c], points[_LONG_Q + c], points[_LONG_U + c]
    bq, bu = points[_SHORT_Q + c], points[_SHORT_U + c]
    cos0, sin0 = _closest_to_origin(q0, u0, aq, au, bq, bu)
    offset_q, offset_u = aq * cos0 + bq * sin0, au * cos0 + bu * sin0
    tangent_q, tangent_u = bq * cos0 - aq * sin0, bu * cos0 - au * sin0
    near_q, near_u = q0 + offset_q, u0 + offset_u
    bend = tangent_q * tangent_q + tangent_u * tangent_u - near_q * offset_q - near_u * offset_u
    squeeze = 1.0
    if bend > 0.0:
        squeeze = np.sqrt(min(max((near_q * near_q + near_u * near_u) / bend, _MIN_SQUEEZE * _MIN_SQUEEZE), 1.0))
    for k in range(_N_LOOKS):
        tangent = _TANGENTS[k] * (1.0 if k < _N_UNIFORM else squeeze)
        scale = 1.0 / (1.0 + tangent * tangent)
        cosine, sine = (1.0 - tangent * tangent) * scale, 2.0 * tangent * scale
        cos, sin = cosine * cos0 - sine * sin0, sine * cos0 + cosine * sin0
        q, u = q0 + aq * cos + bq * sin, u0 + au * cos + bu * sin
        inverse = 1.0 / (q * q + u * u)
        looks[k], looks[_LOOK_SIN + k], looks[_LOOK_Q + k], looks[_LOOK_U + k] = cos, sin, q * inverse, u * inverse
    highest_q, lowest_q, highest_u, lowest_u = -np.inf, np.inf, -np.inf, np.inf
    for which in range(_HIGH_Q, _LOW_U + _BLOCK, _BLOCK):
        points[_COS + which + c], points[_SIN + which + c] = cos0, sin0
    for k in range(_N_LOOKS):
        cos, sin, q, u = looks[k], looks[_LOOK_SIN + k], looks[_LOOK_Q + k], looks[_LOOK_U + k]
        if not u >= 0.0:
            continue
        if q > highest_q:
            highest_q, points[_COS + c], points[_SIN + c] = q, cos, sin
        if q < lowest_q:
            lowest_q, points[_COS + _LOW_Q + c], points[_SIN + _LOW_Q + c] = q, cos, sin
        if u > highest_u:
            highest_u, points[_COS + _HIGH_U + c], points[_SIN + _HIGH_U + c] = u, cos, sin
        if u < lowest_u:
            lowest_u, points[_COS + _LOW_U + c], points[_SIN + _LOW_U + c] = u, cos, sin


@compiled
def _closest_to_origin(q0: float, u0: float, aq: float, au: float, bq: float, bu: float) -> tuple[float, float]:
    """Cosine and sine of the parameter of the ellipse's point nearest to an origin outside of it.

    Newton on Eberly's equation, *Distance from a Point to an Ellipse*, 2013: convex, and started on its left.
    """
    aa, bb = aq * aq + au * au, bq * bq + bu * bu
    towards_a, towards_b = -(aq * q0 + au * u0), -(bq * q0 + bu * u0)
    a_y, b_y = abs(towards_a), abs(towards_b)
    t = max(a_y - aa, b_y - bb)
    for _ in range(_CLOSEST_POINT_STEPS):
        t_a, t_b = t + aa + _TINY, t + bb + _TINY
        first, second = (a_y / t_a) ** 2, (b_y / t_b) ** 2
        t += (first + second - 1.0) / (2.0 * (first / t_a + second / t_b) + _TINY)
    cos = min(a_y / (t + aa + _TINY), 1.0)
    sin = np.sqrt(1.0 - cos * cos)
    return np.copysign(cos, towards_a), np.copysign(sin, towards_b)


@compiled
def _climb(points: Floats) -> None:
    """The extremes of a block of points, each by Newton steps uphill along its ellipse."""
    for c in range(_BLOCK):
        q, aq, bq = points[c], points[_LONG_Q + c], points[_SHORT_Q + c]
        u, au, bu = points[_U + c], points[_LONG_U + c], points[_SHORT_U + c]
        points[_FOUND + c] = _highest(q, aq, bq, u, au, bu, 1.0, False, points[_COS + c], points[_SIN + c])
        points[_FOUND + _LOW_Q + c] = -_highest(
            q, aq, bq, u, au, bu, -1.0, False, points[_COS + _LOW_Q + c], points[_SIN + _LOW_Q + c]
        )
        points[_FOUND + _HIGH_U + c] = _highest(
            u, au, bu, q, aq, bq, 1.0, True, points[_COS + _HIGH_U + c], points[_SIN + _HIGH_U + c]
        )
        points[_FOUND + _LOW_U + c] = -_highest(
            u, au, bu, q, aq, bq, -1.0, True, points[_COS + _LOW_U + c], points[_SIN + _LOW_U + c]
        )


@compiled_in_place
def _highest(
    n_0: float,
    n_a: float,
    n_b: float,
    m_0: float,
    m_a: float,
    m_b: float,
    sign: float,
    is_u: bool,
    cos: float,
    sin: float,
) -> float:
    """Maximum of ``sign n / (n^2 + m^2)`` along the ellipse near a parameter, and in its centre.

    n and m are q and u, or u and q (``is_u``), of the centre and along the semi-axes. The steps go to the zero of the
    derivative's numerator, ``n' D - n D'`` with the objective n / D.
    """
    best = sign * n_0 / (n_0 * n_0 + m_0 * m_0)
    for _ in range(_NEWTON_STEPS + 1):
        n_offset, m_offset = n_a * cos + n_b * sin, m_a * cos + m_b * sin
        n, m = n_0 + n_offset, m_0 + m_offset
        square = n * n + m * m
        is_there = ((n if is_u else m) >= 0.0) & (square > 0.0)
        value = sign * n / square
        best = max(best, value) if is_there else best
        n_1, m_1 = n_b * cos - n_a * sin, m_b * cos - m_a * sin
        bend = n_1 * n_1 + m_1 * m_1 - n * n_offset - m * m_offset
        slope = n_1 * square - 2.0 * n * (n * n_1 + m * m_1)
        curvature = abs(n_offset * square + 2.0 * n * bend)
        half_step = min(max(0.5 * sign * slope / (curvature + _TINY), -_MAX_HALF_STEP), _MAX_HALF_STEP)
        scale = 1.0 / (1.0 + half_step * half_step)
        turn_cos, turn_sin = (1.0 - half_step * half_step) * scale, 2.0 * half_step * scale
        cos, sin = cos * turn_cos - sin * turn_sin, sin * turn_cos + cos * turn_sin
    return best


@compiled
def _look_on_axis(points: Floats, c: int) -> None:
    """The highest and lowest q over q^2 + u^2 of point c, where the axis u = 0 crosses its ellipse, too."""
    q, u, variance_q, variance_u = points[c], points[_U + c], points[_VARIANCE_Q + c], points[_VARIANCE_U + c]
    mixed = points[_MIXED + c]
    slope = mixed / variance_u if variance_u > 0.0 else 0.0
    left_over = CHI2_90_TWO - (u * u / variance_u if variance_u > 0.0 else 0.0)
    half_width = np.sqrt(max(left_over, 0.0) * max(variance_q - slope * mixed, 0.0))
    for side in (-1.0, 1.0):
        crossing = q - slope * u + side * half_width
        if crossing != 0.0:
            points[_FOUND + c] = max(points[_FOUND + c], 1.0 / crossing)
            points[_FOUND + _LOW_Q + c] = min(points[_FOUND + _LOW_Q + c], 1.0 / crossing)
