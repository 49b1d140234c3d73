"""Range of the inversion of a point in the unit circle over an ellipse: what bounds tcpa and miss.

With (q, u) the radial and transverse rate of a point, tcpa and miss are ``(-q, u) / (q^2 + u^2)``. Both are harmonic,
so that their extremes over a region without the origin lie on its border.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.quotient import quotient
from ttcvid.model import Floats

# 90 % quantile of chi-square with two degrees of freedom.
_CHI2_90_TWO = 4.605170185988092

_N_UNIFORM = 10
_N_DENSE = 22
# Tangents of half the angle at which the border is looked at: one set uniform, one to be squeezed (see `_border`).
_UNIFORM_TAN = np.tan(0.5 * np.pi * (np.arange(_N_UNIFORM) - 0.5 * (_N_UNIFORM - 1)) / (0.5 * _N_UNIFORM))
_DENSE_TAN = np.tan(0.5 * np.pi * (np.arange(_N_DENSE) - 0.5 * (_N_DENSE - 1)) / (0.5 * _N_DENSE))
_MIN_SQUEEZE = 1e-9

_CLOSEST_POINT_STEPS = 6
_NEWTON_STEPS = 3
_MAX_NEWTON_STEP_RAD = 0.3
# What is maximised, as factors of (q, u) / (q^2 + u^2): minus lower tcpa, upper tcpa, minus lower miss, upper miss.
_OBJECTIVES = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, -1.0], [0.0, 1.0]])


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
    maxima[:, holds_origin] = np.nan
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


def _axis_crossings(q: Floats, u: Floats, cov: Floats, reaches_axis: np.ndarray) -> Floats:
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
    inverse = quotient(1.0, q * q + u * u)
    q *= inverse
    u *= inverse
    is_below = ~(u >= 0.0)
    highest_q, lowest_q = np.where(is_below, -np.inf, q), np.where(is_below, np.inf, q)
    lowest_u = np.where(is_below, np.inf, u)
    best = np.stack([highest_q.argmax(1), lowest_q.argmin(1), lowest_u.argmin(1), np.where(is_below, 0.0, u).argmax(1)])
    rows = np.arange(len(centre))
    maxima = _climb(centre, axes, cos[rows, best], sin[rows, best])
    for point in (crossings[0], crossings[1]):
        maxima = np.fmax(maxima, _OBJECTIVES[:, :1] * quotient(1.0, point))
    square = np.einsum("ni,ni->n", centre, centre)
    return np.fmax(maxima, quotient(_OBJECTIVES @ centre.T, square))


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
    y0, y1 = np.abs(towards).T
    t = np.maximum(a * y0 - a * a, b * y1 - b * b)
    for _ in range(_CLOSEST_POINT_STEPS):
        first, second = (np.nan_to_num(quotient(s * y, t + s * s)) for s, y in ((a, y0), (b, y1)))
        slope = 2.0 * (
            first * first * np.nan_to_num(quotient(1.0, t + a * a))
            + second * second * np.nan_to_num(quotient(1.0, t + b * b))
        )
        t = t + np.nan_to_num(quotient(first * first + second * second - 1.0, slope))
    cos = np.clip(np.nan_to_num(quotient(a * y0, t + a * a)), 0.0, 1.0)
    sin = np.sqrt(1.0 - cos * cos)
    return np.copysign(cos, towards[:, 0]), np.copysign(sin, towards[:, 1])


def _climb(centre: Floats, axes: Floats, cos: Floats, sin: Floats) -> Floats:
    """Maxima ``(4, N)`` of the objectives along the ellipse from parameters ``(4, N)``, by guarded Newton steps."""
    value = _objective(_point(centre, axes, cos, sin))
    for _ in range(_NEWTON_STEPS):
        step = _newton_step(centre, axes, cos, sin)
        new_cos, new_sin = cos * np.cos(step) - sin * np.sin(step), sin * np.cos(step) + cos * np.sin(step)
        new_point = _point(centre, axes, new_cos, new_sin)
        new_value = _objective(new_point)
        is_better = (new_value > value) & (new_point[..., 1] >= 0.0)
        cos, sin, value = (
            np.where(is_better, new, old) for new, old in ((new_cos, cos), (new_sin, sin), (new_value, value))
        )
    return np.where(_point(centre, axes, cos, sin)[..., 1] >= 0.0, value, np.nan)


def _newton_step(centre: Floats, axes: Floats, cos: Floats, sin: Floats) -> Floats:
    """Step ``(4, N)`` in rad towards the zero of the derivative's numerator, n' D - n D' with value n / D."""
    point = _point(centre, axes, cos, sin)
    tangent = _point(np.zeros_like(centre), axes, -sin, cos)
    n, n_1, n_2 = (np.einsum("ki,kni->kn", _OBJECTIVES, v) for v in (point, tangent, centre - point))
    square, mixed = np.einsum("kni,kni->kn", point, point), np.einsum("kni,kni->kn", point, tangent)
    bend = np.einsum("kni,kni->kn", tangent, tangent) + np.einsum("kni,kni->kn", point, centre - point)
    step = -np.nan_to_num(quotient(n_1 * square - 2.0 * n * mixed, n_2 * square - 2.0 * n * bend))
    return np.clip(step, -_MAX_NEWTON_STEP_RAD, _MAX_NEWTON_STEP_RAD)


def _point(centre: Floats, axes: Floats, cos: Floats, sin: Floats) -> Floats:
    """Points ``(4, N, 2)`` of the ellipse."""
    points: Floats = centre + axes[:, :, 0] * cos[..., None] + axes[:, :, 1] * sin[..., None]
    return points


def _objective(points: Floats) -> Floats:
    """The four objectives ``(4, N)`` at points ``(4, N, 2)``."""
    return quotient(np.einsum("ki,kni->kn", _OBJECTIVES, points), np.einsum("kni,kni->kn", points, points))
