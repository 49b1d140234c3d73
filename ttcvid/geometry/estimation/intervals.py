"""The three times with their 90 % intervals, from the image state and its covariance.

ttc_z is made on eta = 1 / ttc_z, which is near-Gaussian where the time is not. tcpa and miss are not monotone in the
state: with ``V / abs(P) = q r + u t`` (radial rate q, transverse rate u >= 0) they are the two components of the
inversion of the point (q, u) in the unit circle, and their intervals are the range of that over the 90 % ellipse of
(q, u) (`tcpa_miss_bounds`). Where nobody gave the focal length, they hold what it may be; ttc_z does not depend on it.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ttcvid.geometry.estimation.tcpa_miss_bounds import CHI2_90_TWO, bounds_of_tcpa_and_miss
from ttcvid.geometry.quotient import quotient
from ttcvid.model import Camera, CollisionTimes, Floats

NORMAL_90_SIGMAS = 1.6448536269514722
"""A 90 % interval of one normal value ends so many standard deviations from it: those of 1 / ttc_z."""

REGION_90_SIGMAS = math.sqrt(CHI2_90_TWO)
"""Those of tcpa and miss end so many from it, where they are short: they are the borders of the 90 % region of both
together, so that each alone holds 97 %."""

LIKELY_FIELDS_DEG = 40.0, 110.0
"""Horizontal fields of view between which those of 90 % of the cameras lie of which nothing is known: a narrow webcam,
and a wide dashboard camera."""
# So many focal lengths of an interval are looked at: the miss distance may be largest in between (found to 0.3 %).
_FOCAL_STEPS = 13


def collision_times_from_state(x: Floats, y: Floats, abc_hz: Floats, cov: Floats, sigma_norm: Floats) -> CollisionTimes:
    """The three times of N points with 90 % intervals.

    Parameters
    ----------
    x, y : ``(N,)`` normalised image coordinates.
    abc_hz : ``(N, 3)`` (a, b, c) = V / Z in 1/s.
    cov : ``(N, 3, 3)`` covariance of (a, b, c) in 1/s^2.
    sigma_norm : ``(N,)``, or of each coordinate ``(2, N)``: standard deviation of x and y, taken as independent of
        (a, b, c): their correlation is smaller than the rest by the length of the flow.

    The bounds of ttc_z are 1 / eta_hi and 1 / eta_lo: lo > hi means through infinity. Those of tcpa and miss are
    ordered. NaN bounds are infinite ones: when the ellipse holds V = 0, both of tcpa and the upper one of miss. The
    range over the ellipse is found to 1e-3 of the bound, to some 1e-2 for ellipses a thousand times longer than wide.

    Source: DESIGN section 2, "Intervals".

    >>> times = collision_times_from_state(
    ...     np.array([1.0]), np.array([0.0]), np.array([[-0.5, 0.0, -0.1]]), 1e-6 * np.eye(3)[None], np.array([1e-4])
    ... )
    >>> [round(float(v[0]), 2) for v in (times.tcpa_lo_s, times.tcpa_s, times.tcpa_hi_s)]
    [2.3, 2.31, 2.32]
    """
    rates, rates_cov = radial_and_transverse_rate(x, y, abc_hz, cov, sigma_norm)
    tcpa_s, miss_s = quotient(rates.T * [[-1.0], [1.0]], np.sum(rates**2, axis=1))
    bounds = bounds_of_tcpa_and_miss(rates, rates_cov)
    reach = NORMAL_90_SIGMAS * np.sqrt(np.maximum(cov[:, 2, 2], 0.0))
    # The value itself is in the region; by another way of rounding it may seem to lie beyond the border.
    return CollisionTimes(
        tcpa_s,
        np.minimum(bounds[0], tcpa_s),
        np.maximum(bounds[1], tcpa_s),
        miss_s,
        np.minimum(bounds[2], miss_s),
        np.maximum(bounds[3], miss_s),
        quotient(-1.0, abc_hz[:, 2]),
        quotient(1.0, reach - abc_hz[:, 2]),
        quotient(-1.0, reach + abc_hz[:, 2]),
    )


def focal_interval_px(camera: Camera) -> tuple[float, float] | None:
    """The 90 % interval of a focal length that nobody gave; None: it was given."""
    if camera.is_assumed:
        narrow, wide = (math.tan(math.radians(field) / 2.0) for field in LIKELY_FIELDS_DEG)
        return 0.5 * camera.image_size.width_px / wide, 0.5 * camera.image_size.width_px / narrow
    if camera.focal_sigma_px is None:
        return None
    factor = math.exp(NORMAL_90_SIGMAS * camera.focal_sigma_px / camera.fx_px)
    return camera.fx_px / factor, camera.fx_px * factor


def with_focal_interval(times: CollisionTimes, x: Floats, y: Floats, abc_hz: Floats, camera: Camera) -> CollisionTimes:
    """The times with intervals of tcpa and miss that also hold what the focal length may be, where nobody gave it.

    ``x, y, abc_hz`` are those of `collision_times_from_state`. x, y, a and b are in proportion to 1 / focal length, c
    is the same. What the other focal lengths lead to is added to the reach of each interval, in squares: where that is
    most of it, it holds 90 %.
    """
    interval_px = focal_interval_px(camera)
    if interval_px is None:
        return times
    square = (camera.fx_px / np.geomspace(*interval_px, _FOCAL_STEPS)[:, None]) ** 2
    a, b, c = abc_hz.T
    speed2 = square * (a * a + b * b) + c * c
    tcpa_s = quotient(-square * (x * a + y * b) - c, speed2)
    miss_s = quotient(np.sqrt(square * ((y * c - b) ** 2 + (a - x * c) ** 2) + (square * (x * b - y * a)) ** 2), speed2)
    tcpa, miss = (
        (
            value - np.hypot(value - low, value - np.minimum(others.min(axis=0), value)),
            value + np.hypot(high - value, np.maximum(others.max(axis=0), value) - value),
        )
        for value, low, high, others in (
            (times.tcpa_s, times.tcpa_lo_s, times.tcpa_hi_s, tcpa_s),
            (times.miss_s, times.miss_lo_s, times.miss_hi_s, miss_s),
        )
    )
    return replace(times, tcpa_lo_s=tcpa[0], tcpa_hi_s=tcpa[1], miss_lo_s=np.maximum(miss[0], 0.0), miss_hi_s=miss[1])


def radial_and_transverse_rate(
    x: Floats, y: Floats, abc_hz: Floats, cov: Floats, sigma_norm: Floats
) -> tuple[Floats, Floats]:
    """Radial rate q and transverse rate u of each point: ``V / abs(P) = q r + u t``, u >= 0; any t where u = 0.

    Of what `collision_times_from_state` takes: q and u ``(N, 2)`` in 1/s with their covariance ``(N, 2, 2)``.
    """
    # With P the ray (x, y, 1): q = r.V / abs(P) and u = t.V / abs(P), so that dq = (r.dV + (u t - q r).dP) / abs(P)
    # and du = (t.dV - (u r + q t).dP) / abs(P).
    inverse = 1.0 / np.sqrt(x * x + y * y + 1.0)
    r, v = np.array([x * inverse, y * inverse, inverse]), abc_hz.T * inverse
    q = np.einsum("in,in->n", r, v)
    across = v - q * r
    u = np.sqrt(np.einsum("in,in->n", across, across))
    # Any normal of r where nothing goes across: it is never along y alone.
    aside = np.array([r[2], np.zeros(len(x)), -r[0]]) / np.sqrt(r[0] ** 2 + r[2] ** 2)
    t = np.where(u > 0.0, quotient(across, u), aside)
    by_ray = np.array([u * t - q * r, -u * r - q * t])[:, :2] * (inverse * sigma_norm)
    by_velocity = np.array([r, t]) * inverse
    rates_cov = np.einsum("min,ijn,kjn->mkn", by_velocity, np.ascontiguousarray(cov.transpose(1, 2, 0)), by_velocity)
    rates_cov += np.einsum("min,kin->mkn", by_ray, by_ray)
    return np.array([q, u]).T, rates_cov.transpose(2, 0, 1)
