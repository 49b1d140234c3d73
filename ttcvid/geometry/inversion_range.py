"""Range of the inversion of a point in the unit circle over an ellipse: what bounds tcpa and miss.

With (q, u) the radial and transverse rate of a point, tcpa and miss are ``(-q, u) / (q^2 + u^2)``. Both are harmonic,
so that their extremes over a region without the origin lie on its border.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.quotient import quotient
from ttcvid.model import Bools, Floats

# 90 % quantile of chi-square with two degrees of freedom.
_CHI2_90_TWO = 4.605170185988092

_N_UNIFORM = 8
_N_DENSE = 20
# Tangents of half the angle at which the border is looked at: one set uniform, one to be squeezed (see `_border`).
_UNIFORM_TAN = np.tan(0.5 * np.pi * (np.arange(_N_UNIFORM) - 0.5 * (_N_UNIFORM - 1)) / (0.5 * _N_UNIFORM))
_DENSE_TAN = np.tan(0.5 * np.pi * (np.arange(_N_DENSE) - 0.5 * (_N_DENSE - 1)) / (0.5 * _N_DENSE))
_MIN_SQUEEZE = 1e-9

_CLOSEST_POINT_STEPS = 6
_NEWTON_STEPS = 2
_MAX_HALF_STEP = 0.15
# The four objectives, all maximised: signs and components of (q, u) / (q^2 + u^2). They are minus the lower tcpa, the
# upper tcpa, minus the lower miss, the upper miss.
_SIGNS = np.array([[1.0], [-1.0], [-1.0], [1.0]])
_COMPONENTS = np.array([0, 0, 1, 1])
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
    variance_q, variance_u, mixed = cov[:, 0, 0], cov[:, 1, 1], cov[:, 0, 1]
    q, u = rates[:, 0], rates[:, 1]
    determinant = variance_q * variance_u - mixed * mixed
    mahalanobis = variance_u * q * q - 2.0 * mixed * q * u + variance_q * u * u
    holds_origin = mahalanobis < _CHI2_90_TWO * determinant
    reaches_axis = u * u <= _CHI2_90_TWO * variance_u

    maxima = _border_maxima(rates, _semi_axes(cov), _axis_crossings(q, u, cov, reaches_axis))
    maxima[:, holds_origin | np.isnan(mahalanobis)] = np.nan
    tcpa_lo, tcpa_hi, miss_lo, miss_hi = -maxima[0], maxima[1], -maxima[2], maxima[3]
    miss_lo = np.where(reaches_axis, 0.0, miss_lo)
    return tcpa_lo, tcpa_hi, miss_lo, miss_hi


def _semi_axes(cov: Floats) -> Floats:
    """Semi-axes of the 90 % ellipse as columns ``(N, 2, 2)``, the longer one first."""
    half_difference = 0.5 * (cov[:, 0, 0] - cov[:, 1, 1])
    root = np.hypot(half_difference, cov[:, 0, 1])
    longer = 0.5 * (cov[:, 0, 0] + cov[:, 1, 1]) + root
    determinant = cov[:, 0, 0] * cov[:, 1, 1] - cov[:, 0, 1] ** 2
    shorter = np.nan_to_num(quotient(determinant, longer))
    angle = 0.5 * np.arctan2(cov[:, 0, 1], half_difference)
    lengths = np.sqrt(_CHI2_90_TWO * np.maximum(np.stack([longer, shorter], axis=-1), 0.0))
    turn = np.stack([np.stack([np.cos(angle), -np.sin(angle)], -1), np.stack([np.sin(angle), np.cos(angle)], -1)], -2)
    axes: Floats = turn * lengths[:, None, :]
    return axes


def _axis_crossings(q: Floats, u: Floats, cov: Floats, reaches_axis: Bools) -> Floats:
    """The two q ``(2, N)`` at which the ellipse crosses u = 0; NaN where it does not."""
    slope = np.nan_to_num(quotient(cov[:, 0, 1], cov[:, 1, 1]))
    left_over = np.maximum(_CHI2_90_TWO - np.nan_to_num(quotient(u * u, cov[:, 1, 1])), 0.0)
    half_width = np.sqrt(left_over * np.maximum(cov[:, 0, 0] - slope * cov[:, 0, 1], 0.0))
    crossings = q - slope * u + np.array([[-1.0], [1.0]]) * half_width
    return np.where(reaches_axis, crossings, np.nan)


def _border_maxima(centre: Floats, axes: Floats, crossings: Floats) -> Floats:
    """Maxima ``(4, N)`` of the objectives over the ellipse cut at u >= 0: border, crossings of u = 0, centre."""
    cos, sin = _border(centre, axes)
    q = centre[:, :1] + axes[:, 0, :1] * cos + axes[:, 0, 1:] * sin
    u = centre[:, 1:] + axes[:, 1, :1] * cos + axes[:, 1, 1:] * sin
    square = q * q + u * u
    inverse = quotient(1.0, square)
    is_below = ~(u >= 0.0)
    q *= inverse
    u *= inverse
    q[is_below], u[is_below] = -np.inf, -np.inf
    highest = q.argmax(1), u.argmax(1)
    q[is_below], u[is_below] = np.inf, np.inf
    best = np.stack([highest[0], q.argmin(1), u.argmin(1), highest[1]])
    rows = np.arange(len(centre))
    maxima = _climb(centre, axes, cos[rows, best], sin[rows, best])
    maxima[:2] = np.fmax(maxima[:2], _SIGNS[:2] * quotient(1.0, crossings[0]))
    maxima[:2] = np.fmax(maxima[:2], _SIGNS[:2] * quotient(1.0, crossings[1]))
    at_centre = quotient(centre, np.einsum("ni,ni->n", centre, centre)[:, None])
    np.fmax(maxima, _SIGNS * at_centre.T[_COMPONENTS], out=maxima)
    return maxima


def _border(centre: Floats, axes: Floats) -> tuple[Floats, Floats]:
    """Cosines and sines ``(N, n)`` of the parameter of points on the ellipse, dense where it is next to the origin.

    Where the ellipse passes the origin at a distance small against its axes, the inversion has a peak there of the
    width ``squeeze``. Half-angle tangents times ``squeeze`` resolve that peak as they resolve a circle.
    """
    cos0, sin0 = _closest_to_origin(centre, axes)
    offset = axes[:, :, 0] * cos0[:, None] + axes[:, :, 1] * sin0[:, None]
    tangent = axes[:, :, 1] * cos0[:, None] - axes[:, :, 0] * sin0[:, None]
    point = centre + offset
    bend = np.einsum("ni,ni->n", tangent, tangent) - np.einsum("ni,ni->n", point, offset)
    squeeze2 = quotient(np.einsum("ni,ni->n", point, point), np.where(bend > 0.0, bend, np.nan))
    squeeze = np.sqrt(np.clip(np.nan_to_num(squeeze2, nan=1.0), _MIN_SQUEEZE**2, 1.0))
    tangents = np.concatenate(
        [np.broadcast_to(_UNIFORM_TAN, (len(centre), _N_UNIFORM)), squeeze[:, None] * _DENSE_TAN], axis=1
    )
    square = tangents * tangents
    scale = 1.0 / (1.0 + square)
    cos, sin = (1.0 - square) * scale, 2.0 * tangents * scale
    return cos * cos0[:, None] - sin * sin0[:, None], sin * cos0[:, None] + cos * sin0[:, None]


def _closest_to_origin(centre: Floats, axes: Floats) -> tuple[Floats, Floats]:
    """Cosine and sine of the parameter of the ellipse's point nearest to an origin outside of it.

    Newton on Eberly's equation, *Distance from a Point to an Ellipse*, 2013: convex, and started on its left.
    """
    lengths = np.sqrt(np.einsum("nij,nij->nj", axes, axes))
    towards = -np.nan_to_num(quotient(np.einsum("nij,ni->nj", axes, centre), lengths))
    a, b = lengths.T
    a_y, b_y = (lengths * np.abs(towards)).T
    t = np.maximum(a_y - a * a, b_y - b * b)
    for _ in range(_CLOSEST_POINT_STEPS):
        t_a, t_b = t + a * a + _TINY, t + b * b + _TINY
        first, second = (a_y / t_a) ** 2, (b_y / t_b) ** 2
        t += (first + second - 1.0) / (2.0 * (first / t_a + second / t_b) + _TINY)
    cos = np.minimum(a_y / (t + a * a + _TINY), 1.0)
    sin = np.sqrt(1.0 - cos * cos)
    return np.copysign(cos, towards[:, 0]), np.copysign(sin, towards[:, 1])


def _climb(centre: Floats, axes: Floats, cos: Floats, sin: Floats) -> Floats:
    """Maxima ``(4, N)`` of the objectives along the ellipse near the parameters ``(4, N)``, by Newton steps uphill.

    The steps go to the zero of the derivative's numerator, ``n' D - n D'`` with the objective n / D.
    """
    # First the component of the objective, then the other one; the parts of the two axes likewise.
    others = 1 - _COMPONENTS
    n_0, m_0 = centre.T[_COMPONENTS], centre.T[others]
    n_a, n_b = axes[:, :, 0].T[_COMPONENTS], axes[:, :, 1].T[_COMPONENTS]
    m_a, m_b = axes[:, :, 0].T[others], axes[:, :, 1].T[others]
    best = np.full(cos.shape, -np.inf)
    for _ in range(_NEWTON_STEPS + 1):
        n_offset, m_offset = n_a * cos + n_b * sin, m_a * cos + m_b * sin
        n, m = n_0 + n_offset, m_0 + m_offset
        square = n * n + m * m
        value = _SIGNS * quotient(n, square)
        value[:2][~(m[:2] >= 0.0)], value[2:][~(n[2:] >= 0.0)] = -np.inf, -np.inf
        best = np.fmax(best, value)
        n_1, m_1 = n_b * cos - n_a * sin, m_b * cos - m_a * sin
        bend = n_1 * n_1 + m_1 * m_1 - n * n_offset - m * m_offset
        slope = n_1 * square - 2.0 * n * (n * n_1 + m * m_1)
        curvature = np.abs(n_offset * square + 2.0 * n * bend)
        half_step = 0.5 * _SIGNS * slope / (curvature + _TINY)
        half_step = np.clip(half_step, -_MAX_HALF_STEP, _MAX_HALF_STEP)
        scale = 1.0 / (1.0 + half_step * half_step)
        turn_cos, turn_sin = (1.0 - half_step * half_step) * scale, 2.0 * half_step * scale
        cos, sin = cos * turn_cos - sin * turn_sin, sin * turn_cos + cos * turn_sin
    return best
