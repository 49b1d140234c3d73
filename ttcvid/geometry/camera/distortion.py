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
# The inverse starts from a table of undistorted radii, 0.09 deg apart as seen from the camera and up to 89.91 deg: near
# enough for Newton's method to need two steps.
_TABLE_RADIUS = np.tan(np.linspace(0.0, np.pi / 2.0, 1001)[:-1])


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
        x_d, y_d, *jacobian = _with_jacobian(model, coefficients, x, y)
        is_valid = _is_before_fold(jacobian) & (x * x + y * y < _table(model, coefficients)[2] ** 2)
    return np.where(is_valid[:, None], np.stack([x_d, y_d], axis=1), np.nan)


def distorted_area(model: str, coefficients: tuple[float, ...], xy: Floats) -> Floats:
    """Factor ``(N,)`` by which `distort` scales a small area at each point: the determinant of its Jacobian.

    >>> distorted_area("fisheye", (0.0, 0.0, 0.0, 0.0), np.array([[0.0, 0.0], [np.sqrt(3.0), 0.0]])).round(4)
    array([1.    , 0.1511])
    """
    _check(model, coefficients)
    if _does_nothing(model, coefficients):
        return np.ones(len(xy))
    _, _, j_xx, j_xy, j_yy = _with_jacobian(model, coefficients, *xy.T)
    return j_xx * j_yy - j_xy * j_xy


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
        table_d, table, limit = _table(model, coefficients)
        x, y = _ratio(np.interp(r_d, table_d, table), r_d) * xy_distorted.T
        for _ in range(_MAX_NEWTON_STEPS):
            x_d, y_d, *jacobian = _with_jacobian(model, coefficients, x, y)
            miss_x, miss_y = x_d - xy_distorted[:, 0], y_d - xy_distorted[:, 1]
            # Also what is not finite: no step helps it.
            is_done = ~(np.maximum(np.abs(miss_x), np.abs(miss_y)) > tolerance + _ROUNDING * r_d)
            if is_done.all():
                break
            j_xx, j_xy, j_yy = jacobian
            determinant = np.where(is_done, np.inf, j_xx * j_yy - j_xy * j_xy)
            x = x - (j_yy * miss_x - j_xy * miss_y) / determinant
            y = y - (j_xx * miss_y - j_xy * miss_x) / determinant
        is_sound = is_done & _is_before_fold(jacobian) & (x * x + y * y < limit**2)
    return np.where(is_sound[:, None], np.stack([x, y], axis=1), np.nan)


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


def _with_jacobian(
    model: str, coefficients: tuple[float, ...], x: Floats, y: Floats
) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Distorted x and y, and the Jacobian's xx, xy and yy entries (it is symmetric).

    The ``gain`` is that of the radius, ``twice`` its derivative by the squared radius, times two.
    """
    xx, yy, xy = x * x, y * y, x * y
    u = xx + yy
    if model == "fisheye":
        k1, k2, k3, k4 = coefficients
        p1 = p2 = 0.0
        r = np.sqrt(u)
        angle = np.arctan(r)
        v = angle * angle
        gain = _ratio(angle * (1.0 + v * (k1 + v * (k2 + v * (k3 + v * k4)))), r)
        slope = 1.0 + v * (3.0 * k1 + v * (5.0 * k2 + v * (7.0 * k3 + v * 9.0 * k4)))
        twice = (slope / (1.0 + u) - gain) / np.where(u > 0.0, u, 1.0)
    else:
        k1, k2, p1, p2, k3, k4, k5, k6 = coefficients + (0.0,) * (8 - len(coefficients))
        gain = 1.0 + u * (k1 + u * (k2 + u * k3))
        twice = 2.0 * (k1 + u * (2.0 * k2 + u * (3.0 * k3)))
        if k4 or k5 or k6:
            divisor = 1.0 + u * (k4 + u * (k5 + u * k6))
            gain = np.where(divisor > 0.0, gain / divisor, np.nan)
            twice = (twice - 2.0 * gain * (k4 + u * (2.0 * k5 + u * (3.0 * k6)))) / divisor
    x_d = x * gain + 2.0 * p1 * xy + p2 * (u + 2.0 * xx)
    y_d = y * gain + p1 * (u + 2.0 * yy) + 2.0 * p2 * xy
    j_xx = gain + twice * xx + 2.0 * p1 * y + 6.0 * p2 * x
    j_xy = twice * xy + 2.0 * p1 * x + 2.0 * p2 * y
    j_yy = gain + twice * yy + 6.0 * p1 * y + 2.0 * p2 * x
    return x_d, y_d, j_xx, j_xy, j_yy


def _is_before_fold(jacobian: list[Floats]) -> Bools:
    """Whether the symmetric Jacobian (xx, xy, yy) is positive definite, as it is at the centre."""
    j_xx, j_xy, j_yy = jacobian
    return np.asarray((j_xx > 0.0) & (j_xx * j_yy > j_xy * j_xy))


@lru_cache(maxsize=64)
def _table(model: str, coefficients: tuple[float, ...]) -> tuple[Floats, Floats, float]:
    """Distorted against undistorted radius out to the fold, and an undistorted one that lies just beyond it.

    The fold itself is told by the Jacobian; the bound keeps places further out, where it is positive again, away.
    Tangential coefficients are left out here.
    """
    if model != "fisheye":
        coefficients = (*coefficients[:2], 0.0, 0.0, *coefficients[4:])
    plain = _TABLE_RADIUS
    with np.errstate(all="ignore"):
        distorted, _, slope, *_ = _with_jacobian(model, coefficients, plain, np.zeros_like(plain))
    folded = np.flatnonzero(~((slope > 0.0) & np.isfinite(distorted)))
    end, bound = (folded[0], float(plain[folded[0]])) if len(folded) else (len(plain), np.inf)
    return distorted[:end], plain[:end], bound
