"""The three times with their 90 % intervals, from the image state and its covariance.

ttc_z is made on eta = 1 / ttc_z, which is near-Gaussian where the time is not. tcpa and miss are not monotone in
the state: with ``V / abs(P) = q r + u t`` (radial rate q, transverse rate u >= 0) they are the two components of the
inversion of the point (q, u) in the unit circle, ``(-q, u) / (q^2 + u^2)``, and their intervals are the range of
that over the 90 % ellipse of (q, u). Both are harmonic, so that their extremes lie on the ellipse itself.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.collision import times_from_state
from ttcvid.geometry.inversion_range import inversion_range
from ttcvid.geometry.quotient import quotient
from ttcvid.geometry.rotation import normalize, tangent_basis
from ttcvid.model import CollisionTimes, Floats

# 90 % two-sided quantile of the normal distribution.
_NORMAL_90 = 1.6448536269514722


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
    times = times_from_state(np.column_stack([x, y, abc_hz]))
    eta, eta_sigma = -abc_hz[:, 2], np.sqrt(np.maximum(cov[:, 2, 2], 0.0))
    rates, rates_cov = radial_and_transverse_rate(x, y, abc_hz, cov, sigma_norm)
    tcpa_lo, tcpa_hi, miss_lo, miss_hi = inversion_range(rates, rates_cov)
    return CollisionTimes(
        tcpa_s=times.tcpa_s,
        tcpa_lo_s=tcpa_lo,
        tcpa_hi_s=tcpa_hi,
        miss_s=times.miss_s,
        miss_lo_s=miss_lo,
        miss_hi_s=miss_hi,
        ttc_z_s=times.ttc_z_s,
        ttc_z_lo_s=quotient(1.0, eta + _NORMAL_90 * eta_sigma),
        ttc_z_hi_s=quotient(1.0, eta - _NORMAL_90 * eta_sigma),
    )


def radial_and_transverse_rate(
    x: Floats, y: Floats, abc_hz: Floats, cov: Floats, sigma_norm: Floats
) -> tuple[Floats, Floats]:
    """(q, u) ``(N, 2)`` in 1/s with ``V / abs(P) = q r + u t``, u >= 0, and their covariance ``(N, 2, 2)``.

    Parameters as in `collision_times_from_state`. At u = 0, where no t is given, any normal of r is taken.
    """
    ray = np.column_stack([x, y, np.ones_like(x)])
    length = np.sqrt(np.einsum("ni,ni->n", ray, ray))[:, None]
    r, velocity = ray / length, abc_hz / length
    radial = np.einsum("ni,ni->n", r, velocity)
    across = velocity - radial[:, None] * r
    t = normalize(across)
    has_no_side = np.isnan(t[:, 0])
    t[has_no_side] = tangent_basis(r[has_no_side])[:, :, 0]
    transverse = np.einsum("ni,ni->n", across, t)
    rates = np.column_stack([radial, transverse])

    by_abc = np.stack([r, t], axis=1) / length[:, :, None]
    by_ray = np.stack(
        [transverse[:, None] * t - radial[:, None] * r, -transverse[:, None] * r - radial[:, None] * t], axis=1
    )
    by_xy = by_ray[:, :, :2] * (sigma_norm[:, None] / length)[:, :, None]
    return rates, by_abc @ cov @ np.swapaxes(by_abc, 1, 2) + by_xy @ np.swapaxes(by_xy, 1, 2)
