"""Range of the inversion of a point in the unit circle over an ellipse: what bounds tcpa and miss.

With (q, u) the radial and transverse rate of a point, tcpa and miss are ``(-q, u) / (q^2 + u^2)``. Both are harmonic,
so that their extremes over a region without the origin lie on its border.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled
from ttcvid.model import Floats

CHI2_90_TWO = 4.605170185988092
"""90 % quantile of chi-square with two degrees of freedom."""

_N_UNIFORM = 8
_N_DENSE = 20
# Tangents of half the angle at which the border is looked at: one set uniform, one to be squeezed (see `_look_around`).
_UNIFORM_TAN = np.tan(0.5 * np.pi * (np.arange(_N_UNIFORM) - 0.5 * (_N_UNIFORM - 1)) / (0.5 * _N_UNIFORM))
_DENSE_TAN = np.tan(0.5 * np.pi * (np.arange(_N_DENSE) - 0.5 * (_N_DENSE - 1)) / (0.5 * _N_DENSE))
_MIN_SQUEEZE = 1e-9

# Over an ellipse that is smaller than this part of its distance from the origin the inversion is nearly linear.
_SMALL_PART = 0.3
_CLOSEST_POINT_STEPS = 6
_NEWTON_STEPS = 2
_MAX_HALF_STEP = 0.15
# Added to denominators that are zero only together with their numerators.
_TINY = 1e-300


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


@compiled
def _range_of_each(rates: Floats, cov: Floats, bounds: Floats) -> None:
    """Fill ``bounds (4, N)``: lower and upper tcpa, lower and upper miss."""
    # q, u, the longer semi-axis, the shorter one; parameters (cos, sin) of the highest and lowest q and u.
    ellipse, best = np.empty(6), np.empty((4, 2))
    for i in range(len(rates)):
        q, u = rates[i, 0], rates[i, 1]
        variance_q, variance_u, mixed = cov[i, 0, 0], cov[i, 1, 1], cov[i, 0, 1]
        reaches_axis = u * u <= CHI2_90_TWO * variance_u
        if reaches_axis:
            bounds[2, i] = 0.0
        mahalanobis = variance_u * q * q - 2.0 * mixed * q * u + variance_q * u * u
        determinant = variance_q * variance_u - mixed * mixed
        # Not written as its opposite: NaN ends here too.
        if not mahalanobis >= CHI2_90_TWO * determinant or (q == 0.0 and u == 0.0):
            continue
        _set_ellipse(q, u, variance_q, variance_u, mixed, ellipse)
        is_small = ellipse[2] ** 2 + ellipse[3] ** 2 < _SMALL_PART**2 * (q * q + u * u)
        if is_small and not reaches_axis:
            _look_uphill(ellipse, best)
        else:
            _look_around(ellipse, best)
        for which in range(4):
            # Components and signs of (q, u) / (q^2 + u^2), all maximised: the highest q is minus the lower tcpa.
            component, sign = which // 2, 1.0 - 2.0 * (which % 2)
            value = _climb(ellipse, component, sign, best[which, 0], best[which, 1])
            value = max(value, sign * (u if component else q) / (q * q + u * u))
            if reaches_axis and not component:
                slope = mixed / variance_u if variance_u > 0.0 else 0.0
                left_over = CHI2_90_TWO - (u * u / variance_u if variance_u > 0.0 else 0.0)
                half_width = np.sqrt(max(left_over, 0.0) * max(variance_q - slope * mixed, 0.0))
                for side in (-1.0, 1.0):
                    crossing = q - slope * u + side * half_width
                    if crossing != 0.0:
                        value = max(value, sign / crossing)
            if component == 0:
                bounds[which, i] = -sign * value
            elif which == 2:
                bounds[3, i] = value
            elif not reaches_axis:
                bounds[2, i] = -value


@compiled
def _set_ellipse(q: float, u: float, variance_q: float, variance_u: float, mixed: float, ellipse: Floats) -> None:
    """Centre and semi-axes (q and u of the longer one, of the shorter one) of the 90 % ellipse."""
    half_difference = 0.5 * (variance_q - variance_u)
    root = np.sqrt(half_difference * half_difference + mixed * mixed)
    longer = 0.5 * (variance_q + variance_u) + root
    shorter = (variance_q * variance_u - mixed * mixed) / longer if longer > 0.0 else 0.0
    # Of twice the angle of the longer axis, these are cosine and sine.
    cos_twice, sin_twice = (half_difference / root, mixed / root) if root > 0.0 else (1.0, 0.0)
    # The larger one of the two by a root, so that no digits are lost.
    larger = np.sqrt(0.5 * (1.0 + abs(cos_twice)))
    other = 0.5 * sin_twice / larger
    cos, sin = (larger, other) if cos_twice >= 0.0 else (abs(other), np.copysign(larger, sin_twice))
    long, short = np.sqrt(CHI2_90_TWO * max(longer, 0.0)), np.sqrt(CHI2_90_TWO * max(shorter, 0.0))
    ellipse[0], ellipse[1] = q, u
    ellipse[2], ellipse[3] = long * cos, long * sin
    ellipse[4], ellipse[5] = -short * sin, short * cos


@compiled
def _look_uphill(ellipse: Floats, best: Floats) -> None:
    """Cosine and sine ``best (4, 2)`` of the border's points in which the objectives, taken as linear, are extreme.

    The gradients at the centre are (u^2 - q^2, -2 q u) and (-2 q u, q^2 - u^2), over (q^2 + u^2)^2.
    """
    q, u, aq, au, bq, bu = ellipse
    along, across = u * u - q * q, -2.0 * q * u
    for component in range(2):
        slope_q, slope_u = (across, -along) if component else (along, across)
        by_cos, by_sin = slope_q * aq + slope_u * au, slope_q * bq + slope_u * bu
        length = np.hypot(by_cos, by_sin) + _TINY
        for side in range(2):
            sign = 1.0 - 2.0 * side
            best[2 * component + side, 0], best[2 * component + side, 1] = (
                sign * by_cos / length,
                sign * by_sin / length,
            )


@compiled
def _look_around(ellipse: Floats, best: Floats) -> None:
    """Cosine and sine ``best (4, 2)`` of the border's points, at u >= 0, with the highest and lowest objectives.

    The border is looked at in points that are dense where it is next to the origin: where the ellipse passes the origin
    at a distance small against its axes, the inversion has a peak there of the width ``squeeze``. Half-angle tangents
    times ``squeeze`` resolve that peak as they resolve a circle.
    """
    q0, u0, aq, au, bq, bu = ellipse
    cos0, sin0 = _closest_to_origin(ellipse)
    offset_q, offset_u = aq * cos0 + bq * sin0, au * cos0 + bu * sin0
    tangent_q, tangent_u = bq * cos0 - aq * sin0, bu * cos0 - au * sin0
    near_q, near_u = q0 + offset_q, u0 + offset_u
    bend = tangent_q * tangent_q + tangent_u * tangent_u - near_q * offset_q - near_u * offset_u
    squeeze = 1.0
    if bend > 0.0:
        squeeze = np.sqrt(min(max((near_q * near_q + near_u * near_u) / bend, _MIN_SQUEEZE * _MIN_SQUEEZE), 1.0))
    extremes = np.array([-np.inf, np.inf, -np.inf, np.inf])
    best[:, 0], best[:, 1] = cos0, sin0
    for k in range(_N_UNIFORM + _N_DENSE):
        tangent = _UNIFORM_TAN[k] if k < _N_UNIFORM else squeeze * _DENSE_TAN[k - _N_UNIFORM]
        scale = 1.0 / (1.0 + tangent * tangent)
        cosine, sine = (1.0 - tangent * tangent) * scale, 2.0 * tangent * scale
        cos, sin = cosine * cos0 - sine * sin0, sine * cos0 + cosine * sin0
        q, u = q0 + aq * cos + bq * sin, u0 + au * cos + bu * sin
        if not u >= 0.0:
            continue
        inverse = 1.0 / (q * q + u * u)
        for which in range(4):
            value = (u if which >= 2 else q) * inverse
            if (which % 2 == 0 and value > extremes[which]) or (which % 2 == 1 and value < extremes[which]):
                extremes[which] = value
                best[which, 0], best[which, 1] = cos, sin


@compiled
def _closest_to_origin(ellipse: Floats) -> tuple[float, float]:
    """Cosine and sine of the parameter of the ellipse's point nearest to an origin outside of it.

    Newton on Eberly's equation, *Distance from a Point to an Ellipse*, 2013: convex, and started on its left.
    """
    q0, u0, aq, au, bq, bu = ellipse
    a, b = np.hypot(aq, au), np.hypot(bq, bu)
    towards_a, towards_b = -(aq * q0 + au * u0), -(bq * q0 + bu * u0)
    a_y, b_y = abs(towards_a), abs(towards_b)
    t = max(a_y - a * a, b_y - b * b)
    for _ in range(_CLOSEST_POINT_STEPS):
        t_a, t_b = t + a * a + _TINY, t + b * b + _TINY
        first, second = (a_y / t_a) ** 2, (b_y / t_b) ** 2
        t += (first + second - 1.0) / (2.0 * (first / t_a + second / t_b) + _TINY)
    cos = min(a_y / (t + a * a + _TINY), 1.0)
    sin = np.sqrt(1.0 - cos * cos)
    return np.copysign(cos, towards_a), np.copysign(sin, towards_b)


@compiled
def _climb(ellipse: Floats, component: int, sign: float, cos: float, sin: float) -> float:
    """Maximum of an objective along the ellipse near a parameter, by Newton steps uphill.

    The steps go to the zero of the derivative's numerator, ``n' D - n D'`` with the objective n / D.
    """
    other = 1 - component
    n_0, n_a, n_b = ellipse[component], ellipse[2 + component], ellipse[4 + component]
    m_0, m_a, m_b = ellipse[other], ellipse[2 + other], ellipse[4 + other]
    best = -np.inf
    for _ in range(_NEWTON_STEPS + 1):
        n_offset, m_offset = n_a * cos + n_b * sin, m_a * cos + m_b * sin
        n, m = n_0 + n_offset, m_0 + m_offset
        square = n * n + m * m
        if (n if component else m) >= 0.0 and square > 0.0:
            best = max(best, sign * n / square)
        n_1, m_1 = n_b * cos - n_a * sin, m_b * cos - m_a * sin
        bend = n_1 * n_1 + m_1 * m_1 - n * n_offset - m * m_offset
        slope = n_1 * square - 2.0 * n * (n * n_1 + m * m_1)
        curvature = abs(n_offset * square + 2.0 * n * bend)
        half_step = min(max(0.5 * sign * slope / (curvature + _TINY), -_MAX_HALF_STEP), _MAX_HALF_STEP)
        scale = 1.0 / (1.0 + half_step * half_step)
        turn_cos, turn_sin = (1.0 - half_step * half_step) * scale, 2.0 * half_step * scale
        cos, sin = cos * turn_cos - sin * turn_sin, sin * turn_cos + cos * turn_sin
    return best
