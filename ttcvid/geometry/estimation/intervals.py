"""The three times with their 90 % intervals, from the image state and its covariance.

ttc_z is made on eta = 1 / ttc_z, which is near-Gaussian where the time is not. tcpa and miss are not monotone in
the state: with ``V / abs(P) = q r + u t`` (radial rate q, transverse rate u >= 0) they are the two components of the
inversion of the point (q, u) in the unit circle, ``(-q, u) / (q^2 + u^2)``, and their intervals are the range of
that over the 90 % ellipse of (q, u). Both are harmonic, so that their extremes lie on the ellipse itself.
"""

from __future__ import annotations

import math
from dataclasses import fields

import numpy as np

from ttcvid.geometry.compiled import compiled_for
from ttcvid.geometry.estimation.tcpa_miss_bounds import CHI2_90_TWO, inversion_range
from ttcvid.model import CollisionTimes, Floats

NORMAL_90_SIGMAS = 1.6448536269514722
"""A 90 % interval of one normal value ends so many standard deviations from it: those of 1 / ttc_z."""

REGION_90_SIGMAS = math.sqrt(CHI2_90_TWO)
"""Those of tcpa and miss end so many from it, where they are short: they are the borders of the 90 % region of both
together, so that each alone holds 97 %."""

_N_TIMES = len(fields(CollisionTimes))


def collision_times_from_state(x: Floats, y: Floats, abc_hz: Floats, cov: Floats, sigma_norm: Floats) -> CollisionTimes:
    """The three times of N points with 90 % intervals.

    Parameters
    ----------
    x, y
        ``(N,)`` normalised image coordinates.
    abc_hz
        ``(N, 3)`` (a, b, c) = V / Z in 1/s.
    cov
        ``(N, 3, 3)`` covariance of (a, b, c) in 1/s^2.
    sigma_norm
        ``(N,)`` standard deviation of x and y, taken as independent of (a, b, c): their correlation is smaller
        than the rest by the length of the flow.

    Returns
    -------
    `CollisionTimes`. The bounds of ttc_z are 1 / eta_hi and 1 / eta_lo: lo > hi means through infinity. Those of tcpa
    and miss are ordered. NaN bounds are infinite ones: when the ellipse holds V = 0, both of tcpa and the upper one
    of miss. The range over the ellipse is found to 1e-3 of the bound, to some 1e-2 for
    ellipses a thousand times longer than wide.

    Source: DESIGN section 2, "Intervals".

    >>> times = collision_times_from_state(
    ...     np.array([1.0]), np.array([0.0]), np.array([[-0.5, 0.0, -0.1]]), 1e-6 * np.eye(3)[None], np.array([1e-4])
    ... )
    >>> [round(float(v[0]), 2) for v in (times.tcpa_lo_s, times.tcpa_s, times.tcpa_hi_s)]
    [2.3, 2.31, 2.32]
    """
    times = np.full((_N_TIMES, len(x)), np.nan)
    found = CollisionTimes(*times)
    _times_of_each(np.ascontiguousarray(x), np.ascontiguousarray(y), abc_hz, cov, times)
    bounds = inversion_range(*radial_and_transverse_rate(x, y, abc_hz, cov, sigma_norm))
    # The value itself is in the region; by another way of rounding it may seem to lie beyond the border.
    np.minimum(bounds[0], found.tcpa_s, out=found.tcpa_lo_s)
    np.maximum(bounds[1], found.tcpa_s, out=found.tcpa_hi_s)
    np.minimum(bounds[2], found.miss_s, out=found.miss_lo_s)
    np.maximum(bounds[3], found.miss_s, out=found.miss_hi_s)
    return found


@compiled_for("(f8[::1], f8[::1], f8[:, ::1], f8[:, :, ::1], f8[:, ::1])")
def _times_of_each(x: Floats, y: Floats, abc_hz: Floats, cov: Floats, times: Floats) -> None:
    """Fills of ``times (9, N)``, in the order of `CollisionTimes`, the times themselves and the bounds of ttc_z.

    The times are those of `geometry.paper.collision.times_from_position_velocity`, at the ray (x, y, 1).
    """
    for i in range(len(x)):
        a, b, c = abc_hz[i, 0], abc_hz[i, 1], abc_hz[i, 2]
        speed2 = a * a + b * b + c * c
        if speed2 != 0.0:
            across_x, across_y, across_z = y[i] * c - b, a - x[i] * c, x[i] * b - y[i] * a
            times[0, i] = -(x[i] * a + y[i] * b + c) / speed2
            times[3, i] = np.sqrt(across_x * across_x + across_y * across_y + across_z * across_z) / speed2
        if c != 0.0:
            times[6, i] = -1.0 / c
        reach = NORMAL_90_SIGMAS * np.sqrt(max(cov[i, 2, 2], 0.0))
        if reach - c != 0.0:
            times[7, i] = 1.0 / (reach - c)
        if reach + c != 0.0:
            times[8, i] = -1.0 / (reach + c)


def radial_and_transverse_rate(
    x: Floats, y: Floats, abc_hz: Floats, cov: Floats, sigma_norm: Floats
) -> tuple[Floats, Floats]:
    """Radial rate q and transverse rate u of each point, with their covariance: ``V / abs(P) = q r + u t``, u >= 0.

    Parameters
    ----------
    x, y, abc_hz, cov, sigma_norm
        As in `collision_times_from_state`.

    Returns
    -------
    rates : ``(N, 2)`` q and u in 1/s; where u = 0, any t normal to r.
    cov : ``(N, 2, 2)`` in 1/s^2.
    """
    rates, rates_cov = np.empty((len(x), 2)), np.empty((len(x), 2, 2))
    _rates_of_each(np.ascontiguousarray(x), np.ascontiguousarray(y), abc_hz, cov, sigma_norm, rates, rates_cov)
    return rates, rates_cov


@compiled_for("(f8[::1], f8[::1], f8[:, ::1], f8[:, :, ::1], f8[::1], f8[:, ::1], f8[:, :, ::1])")
def _rates_of_each(
    x: Floats, y: Floats, abc_hz: Floats, cov: Floats, sigma_norm: Floats, rates: Floats, rates_cov: Floats
) -> None:
    """Fills ``rates (N, 2)`` and ``rates_cov (N, 2, 2)``.

    With P the ray (x, y, 1): q = r.V / abs(P) and u = t.V / abs(P), so that dq = (r.dV + (u t - q r).dP) / abs(P) and
    du = (t.dV - (u r + q t).dP) / abs(P).
    """
    by_velocity, by_ray = np.empty((2, 3)), np.empty((2, 3))
    for i in range(len(x)):
        inverse = 1.0 / np.sqrt(x[i] * x[i] + y[i] * y[i] + 1.0)
        r, v = (x[i] * inverse, y[i] * inverse, inverse), (abc_hz[i, 0], abc_hz[i, 1], abc_hz[i, 2])
        q = (r[0] * v[0] + r[1] * v[1] + r[2] * v[2]) * inverse
        tx, ty, tz = v[0] * inverse - q * r[0], v[1] * inverse - q * r[1], v[2] * inverse - q * r[2]
        u = np.sqrt(tx * tx + ty * ty + tz * tz)
        if u > 0.0:
            t = (tx / u, ty / u, tz / u)
        else:
            # Any normal of r: it is never along y alone.
            across = 1.0 / np.sqrt(r[0] * r[0] + r[2] * r[2])
            t = (r[2] * across, 0.0, -r[0] * across)
        rates[i, 0], rates[i, 1] = q, u
        for j in range(3):
            by_velocity[0, j], by_velocity[1, j] = r[j] * inverse, t[j] * inverse
            by_ray[0, j], by_ray[1, j] = (u * t[j] - q * r[j]) * inverse, -(u * r[j] + q * t[j]) * inverse
        for m in range(2):
            for n in range(m + 1):
                total = (by_ray[m, 0] * by_ray[n, 0] + by_ray[m, 1] * by_ray[n, 1]) * sigma_norm[i] ** 2
                for j in range(3):
                    for k in range(3):
                        total += by_velocity[m, j] * cov[i, j, k] * by_velocity[n, k]
                rates_cov[i, m, n] = rates_cov[i, n, m] = total
