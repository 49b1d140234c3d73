"""Lens distortion with OpenCV's coefficients and its inverse, on the plane z = 1.

A lens model is one-to-one only out to where it folds over: beyond, two rays have the same image. Both directions end
there and give NaN, so that whatever is distorted can be undistorted.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ttcvid.model import Bools, Floats

COEFFICIENT_COUNTS = {"none": (0,), "plumb_bob": (4, 5), "rational": (8,), "fisheye": (4,)}
"""Numbers of coefficients of each model, in OpenCV's order; ``plumb_bob`` with 4 has k3 = 0."""

_MAX_NEWTON_STEPS = 12
_ROUNDING = 32.0 * np.finfo(np.float64).eps
# The inverse starts from a table over the angle from the optical axis, 0.09 deg apart: near enough for Newton's
# method to need two steps.
_TABLE_ANGLE_RAD = np.linspace(0.0, np.pi / 2.0, 1001)
_MAX_TABLE_ANGLE_RAD = np.radians(89.5)


def distort(model: str, coefficients: tuple[float, ...], xy: Floats) -> Floats:
    """Apply a lens model to points ``xy (N, 2)`` of the plane z = 1; NaN beyond its fold.

    Raises
    ------
    ValueError
        The ``model`` is none of `COEFFICIENT_COUNTS`, or has another number of ``coefficients``.

    Source: OpenCV, modules calib3d (pinhole and rational model) and fisheye (Kannala and Brandt, 2006).

    >>> distort("plumb_bob", (-0.2, 0.0, 0.0, 0.0, 0.0), np.array([[0.5, 0.0], [9.0, 0.0]]))
    array([[0.475, 0.   ],
           [  nan,   nan]])
    """
    _check(model, coefficients)
    xy = np.asarray(xy, dtype=np.float64)
    if _does_nothing(model, coefficients):
        return xy.copy()
    x, y = xy.T
    with np.errstate(all="ignore"):
        if model == "fisheye":
            r = np.hypot(x, y)
            angle = np.arctan(r)
            angle_d, slope = _fisheye_angle(coefficients, angle)
            is_valid = (slope > 0.0) & (angle < _table(model, coefficients)[2])
            places = xy * _ratio(angle_d, r)[:, None]
        else:
            x_d, y_d, *jacobian = _radial_tangential(_eight(coefficients), x, y)
            is_valid = _is_before_fold(jacobian) & (x * x + y * y < _table(model, coefficients)[2] ** 2)
            places = np.stack([x_d, y_d], axis=1)
    return np.where(is_valid[:, None], places, np.nan)


def distorted_area(model: str, coefficients: tuple[float, ...], xy: Floats) -> Floats:
    """Factor ``(N,)`` by which `distort` scales a small area at each point: the determinant of its Jacobian.

    >>> distorted_area("fisheye", (0.0, 0.0, 0.0, 0.0), np.array([[0.0, 0.0], [np.sqrt(3.0), 0.0]])).round(4)
    array([1.    , 0.1511])
    """
    _check(model, coefficients)
    if _does_nothing(model, coefficients):
        return np.ones(len(xy))
    x, y = xy.T
    if model != "fisheye":
        _, _, j_xx, j_xy, j_yy = _radial_tangential(_eight(coefficients), x, y)
        return j_xx * j_yy - j_xy * j_xy
    r = np.hypot(x, y)
    angle_d, slope = _fisheye_angle(coefficients, np.arctan(r))
    return np.asarray(_ratio(angle_d, r) * slope / (1.0 + r * r))


def undistort(model: str, coefficients: tuple[float, ...], xy_distorted: Floats, tolerance: float) -> Floats:
    """The inverse of `distort`, with the same error, by Newton's method: undistorted points ``(N, 2)``.

    The iteration ends where `distort` reproduces a point within ``tolerance`` on the plane z = 1. NaN where it does not
    converge: no undistorted point leads there, or it is at the fold, or 90 deg or more off the axis.

    >>> undistort("plumb_bob", (-0.2, 0.0, 0.0, 0.0, 0.0), np.array([[0.475, 0.0], [9.0, 0.0]]), 1e-13).round(12)
    array([[0.5, 0. ],
           [nan, nan]])
    """
    _check(model, coefficients)
    xy_distorted = np.asarray(xy_distorted, dtype=np.float64)
    if _does_nothing(model, coefficients):
        return xy_distorted.copy()
    with np.errstate(all="ignore"):
        r_d = np.hypot(xy_distorted[:, 0], xy_distorted[:, 1])
        within = tolerance + _ROUNDING * r_d
        table_d, table, limit = _table(model, coefficients)
        start = np.interp(r_d, table_d, table)
        if model == "fisheye":
            angle = _invert_fisheye(coefficients, r_d, start, within)
            angle[angle >= limit] = np.nan
            return xy_distorted * _ratio(np.tan(angle), r_d)[:, None]
        start_xy = xy_distorted * _ratio(start, r_d)[:, None]
        xy = _invert_radial_tangential(_eight(coefficients), xy_distorted, start_xy, within)
        return np.where(np.einsum("ni,ni->n", xy, xy)[:, None] < limit**2, xy, np.nan)


def _check(model: str, coefficients: tuple[float, ...]) -> None:
    counts = COEFFICIENT_COUNTS.get(model)
    if counts is None:
        raise ValueError(f"distortion model {model!r}: expected one of {', '.join(COEFFICIENT_COUNTS)}")
    if len(coefficients) not in counts:
        raise ValueError(
            f"distortion model {model}: expected {' or '.join(map(str, counts))} coefficients, got {len(coefficients)}"
        )


def _does_nothing(model: str, coefficients: tuple[float, ...]) -> bool:
    """Whether a model leaves every place alone; the equidistant one never does, even with all coefficients 0."""
    return model != "fisheye" and not any(coefficients)


def _ratio(radius: Floats, other: Floats) -> Floats:
    """A radius over another one at the same points ``(N,)``, 1 at the centre."""
    return np.asarray(np.divide(radius, other, out=np.ones_like(other), where=other > 0.0))


def _eight(coefficients: tuple[float, ...]) -> tuple[float, ...]:
    """k1 k2 p1 p2 k3 k4 k5 k6, zeros where the model has fewer."""
    return coefficients + (0.0,) * (8 - len(coefficients))


def _radial_tangential(k: tuple[float, ...], x: Floats, y: Floats) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Distorted x and y, and the Jacobian's xx, xy and yy entries (it is symmetric)."""
    k1, k2, p1, p2, k3, k4, k5, k6 = k
    xx, yy, xy = x * x, y * y, x * y
    u = xx + yy
    gain = 1.0 + u * (k1 + u * (k2 + u * k3))
    gain_slope = k1 + u * (2.0 * k2 + u * (3.0 * k3))
    if k4 or k5 or k6:
        divisor = 1.0 + u * (k4 + u * (k5 + u * k6))
        gain = np.where(divisor > 0.0, gain / divisor, np.nan)
        gain_slope = (gain_slope - gain * (k4 + u * (2.0 * k5 + u * (3.0 * k6)))) / divisor
    x_d = x * gain + 2.0 * p1 * xy + p2 * (u + 2.0 * xx)
    y_d = y * gain + p1 * (u + 2.0 * yy) + 2.0 * p2 * xy
    twice = 2.0 * gain_slope
    j_xx = gain + twice * xx + 2.0 * p1 * y + 6.0 * p2 * x
    j_xy = twice * xy + 2.0 * p1 * x + 2.0 * p2 * y
    j_yy = gain + twice * yy + 6.0 * p1 * y + 2.0 * p2 * x
    return x_d, y_d, j_xx, j_xy, j_yy


def _is_before_fold(jacobian: list[Floats]) -> Bools:
    """Whether the symmetric Jacobian (xx, xy, yy) is positive definite, as it is at the centre."""
    j_xx, j_xy, j_yy = jacobian
    return np.asarray((j_xx > 0.0) & (j_xx * j_yy > j_xy * j_xy))


def _fisheye_angle(k: tuple[float, ...], angle: Floats) -> tuple[Floats, Floats]:
    """Distorted angle of the equidistant model, and its derivative."""
    k1, k2, k3, k4 = k
    u = angle * angle
    slope = 1.0 + u * (3.0 * k1 + u * (5.0 * k2 + u * (7.0 * k3 + u * (9.0 * k4))))
    return angle * (1.0 + u * (k1 + u * (k2 + u * (k3 + u * k4)))), slope


@lru_cache(maxsize=64)
def _table(model: str, coefficients: tuple[float, ...]) -> tuple[Floats, Floats, float]:
    """Distorted against undistorted radius (fisheye: angle) out to the fold, and a bound that lies just beyond it.

    The fold itself is told by the Jacobian; the bound keeps places further out, where it is positive again, away.
    Tangential coefficients are left out here.
    """
    if model == "fisheye":
        plain = _TABLE_ANGLE_RAD
        distorted, slope = _fisheye_angle(coefficients, plain)
        bound = float(np.pi / 2.0)
    else:
        plain = np.tan(_TABLE_ANGLE_RAD[_TABLE_ANGLE_RAD <= _MAX_TABLE_ANGLE_RAD])
        k1, k2, _, _, *others = _eight(coefficients)
        with np.errstate(all="ignore"):
            distorted, _, slope, *_ = _radial_tangential((k1, k2, 0.0, 0.0, *others), plain, np.zeros_like(plain))
        bound = float(np.inf)
    folded = np.flatnonzero(~((slope > 0.0) & np.isfinite(distorted)))
    if len(folded):
        bound = min(bound, float(plain[folded[0]]))
        plain, distorted = plain[: folded[0]], distorted[: folded[0]]
    return distorted, plain, bound


def _invert_fisheye(k: tuple[float, ...], wanted: Floats, start: Floats, within: Floats) -> Floats:
    """Angles whose distorted angle is the wanted one; NaN where Newton's method does not get there."""
    result = np.full_like(wanted, np.nan)
    active = np.flatnonzero(np.isfinite(wanted))
    angle = start[active]
    for _ in range(_MAX_NEWTON_STEPS):
        angle_d, slope = _fisheye_angle(k, angle)
        miss = angle_d - wanted[active]
        is_there = np.abs(miss) <= within[active]
        is_sound = is_there & (slope > 0.0)
        result[active[is_sound]] = angle[is_sound]
        if is_there.all():
            break
        angle = (angle - miss / slope)[~is_there]
        active = active[~is_there]
    return result


def _invert_radial_tangential(k: tuple[float, ...], wanted: Floats, start: Floats, within: Floats) -> Floats:
    """Places whose distorted place is the wanted one; NaN where Newton's method does not get there."""
    result = np.full_like(wanted, np.nan)
    active = np.flatnonzero(np.isfinite(wanted).all(axis=1))
    x, y = start[active].T
    for _ in range(_MAX_NEWTON_STEPS):
        x_d, y_d, *jacobian = _radial_tangential(k, x, y)
        miss_x, miss_y = x_d - wanted[active, 0], y_d - wanted[active, 1]
        is_there = np.maximum(np.abs(miss_x), np.abs(miss_y)) <= within[active]
        is_sound = is_there & _is_before_fold(jacobian)
        result[active[is_sound], 0], result[active[is_sound], 1] = x[is_sound], y[is_sound]
        if is_there.all():
            break
        j_xx, j_xy, j_yy = jacobian
        determinant = j_xx * j_yy - j_xy * j_xy
        x = (x - (j_yy * miss_x - j_xy * miss_y) / determinant)[~is_there]
        y = (y - (j_xx * miss_y - j_xy * miss_x) / determinant)[~is_there]
        active = active[~is_there]
    return result
