"""The image state (x, y, a, b, c) of points whose direction of motion is known, from two views.

(x, y) = (X, Y) / Z is where the point is in the second view, (a, b, c) = V / Z its velocity in units of its depth,
in 1/s. The points of a translating object share the direction e: (a, b, c) = s e, with one unknown rate s each.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.paper.epipole import INFINITY_COSINE, SIGNIFICANCE_SIGMAS
from ttcvid.geometry.quotient import quotient
from ttcvid.geometry.rotation import cross
from ttcvid.model import Bools, Floats, Ints, Status

# A rate s within this many of its standard deviations may be zero; below minus this, the sign of e is not the point's.
_RATE_SIGMAS = 2.0


def state_from_direction(
    q: Floats,
    p: Floats,
    direction: Floats,
    gap_s: float | Floats,
    sigma_norm: Floats,
    direction_cov: Floats | None = None,
) -> tuple[Floats, Floats, Ints]:
    """State of each point and its covariance, from two views and a direction of motion.

    ``s`` solves ``q x (p - s gap e) = 0`` by least squares along ``m = q x e``: ``s = (q x p).m / m^2 / gap``.

    Parameters
    ----------
    q, p : ``(N, 3)`` rays of the first view (rotated into the second camera) and of the second; any length, z > 0.
    direction : ``(3,)`` or ``(N, 3)`` unit vectors e = dir.
    gap_s : Time between the views in s, scalar or ``(N,)``.
    sigma_norm : ``(N,)`` standard deviation of a point's x and y in normalised coordinates (z = 1), in both views.
    direction_cov : ``(3, 3)`` or ``(N, 3, 3)`` rad^2 in the tangent plane of e; None: e is exact.

    Returns
    -------
    state : ``(N, 5)`` x, y without unit, a, b, c in 1/s.
    cov : ``(N, 5, 5)``, to first order; exact derivatives, no finite differences.
    status : ``(N,)``. Without values: ``short_track`` (a ray is NaN or not in front of the camera, no positive gap or
        sigma), ``no_epipole`` (e is NaN), ``at_epipole`` (both rays within 3 sigma of the epipole line). With values:
        ``no_parallax`` (s within 2 sigma of zero), ``not_rigid`` (the point moves against e by more than 2 sigma),
        ``epipole_at_infinity`` (e within 1 deg of the picture plane: ttc_z has no good value, tcpa and miss have).

    Source: DESIGN section 3, the general estimator ("w_i = s_i e with one shared e").

    A point at (1, 0, 10) m that comes 1 m nearer in 0.1 s has ttc_z = 1 s, that is c = -1 / s:

    >>> q, p = np.array([[1.0, 0.0, 11.0]]), np.array([[1.0, 0.0, 10.0]])
    >>> state, _, _ = state_from_direction(q, p, np.array([0.0, 0.0, -1.0]), 0.1, np.array([1e-5]))
    >>> state.round(9) + 0.0
    array([[ 0.1,  0. ,  0. ,  0. , -1. ]])
    """
    n_points = len(q)
    e = np.broadcast_to(direction, (n_points, 3))
    gap_s = np.broadcast_to(np.asarray(gap_s, dtype=np.float64), (n_points,))
    q, r = _to_unit_depth(q), _to_unit_depth(p)
    variance = np.where((sigma_norm > 0.0) & (gap_s > 0.0), sigma_norm, np.nan) ** 2
    cov_e = np.zeros((1, 3, 3)) if direction_cov is None else np.reshape(direction_cov, (-1, 3, 3))

    s, ds_dq, ds_dr, ds_de = rate_from_direction(q, r, e, gap_s)
    # (a, b, c) = s e depends on q and r through s alone; x and y are those of r.
    jacobian_e = e[:, :, None] * ds_de[:, None, :] + s[:, None, None] * np.eye(3)
    s_variance = variance * _square_sum(np.concatenate([ds_dq[:, :2], ds_dr[:, :2]], axis=1))
    cov = np.empty((n_points, 5, 5))
    cov[:, :2, :2] = variance[:, None, None] * np.eye(2)
    cov[:, :2, 2:] = variance[:, None, None] * ds_dr[:, :2, None] * e[:, None, :]
    cov[:, 2:, :2] = np.swapaxes(cov[:, :2, 2:], 1, 2)
    cov[:, 2:, 2:] = s_variance[:, None, None] * e[:, :, None] * e[:, None, :]
    cov[:, 2:, 2:] += jacobian_e @ cov_e @ np.swapaxes(jacobian_e, 1, 2)
    state = np.concatenate([r[:, :2], s[:, None] * e], axis=1)

    s_sigma = np.sqrt(
        s_variance + np.maximum(np.einsum("ni,nij,nj->n", ds_de, np.broadcast_to(cov_e, (n_points, 3, 3)), ds_de), 0.0)
    )
    status = np.select(
        [
            ~np.isfinite(q + r).all(axis=1) | ~np.isfinite(variance),
            ~np.isfinite(e).all(axis=1),
            is_at_epipole(q, r, e, variance, np.nan_to_num(np.trace(cov_e, axis1=1, axis2=2))) | ~np.isfinite(s),
            np.abs(s) < _RATE_SIGMAS * s_sigma,
            s < 0.0,
            np.abs(e[:, 2]) < INFINITY_COSINE,
        ],
        [
            Status.short_track,
            Status.no_epipole,
            Status.at_epipole,
            Status.no_parallax,
            Status.not_rigid,
            Status.epipole_at_infinity,
        ],
        Status.ok,
    ).astype(np.int64)
    has_no_value = np.isin(status, [Status.short_track, Status.no_epipole, Status.at_epipole])
    state[has_no_value], cov[has_no_value] = np.nan, np.nan
    return state, cov, status


def rate_from_direction(q: Floats, r: Floats, e: Floats, gap_s: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Rate s ``(N,)`` of each point along a known direction, as in `state_from_direction`, in 1/s.

    ``s = (q x r).m / (m.m gap)`` with ``m = q x e``, for points q and r ``(N, 3)`` of the two views on the plane z = 1;
    with its derivatives ``(N, 3)`` by q, r and e.
    """
    m, flow = cross(q, e), cross(q, r)
    square = _square_sum(m)
    scale = quotient(1.0, square * gap_s)
    s = np.einsum("ni,ni->n", flow, m) * scale
    twice = 2.0 * (s * gap_s)[:, None]
    ds_dq = cross(r, m) + cross(e, flow) - twice * cross(e, m)
    ds_dr = cross(m, q)
    ds_de = cross(flow, q) - twice * cross(m, q)
    return s, ds_dq * scale[:, None], ds_dr * scale[:, None], ds_de * scale[:, None]


def is_at_epipole(q: Floats, r: Floats, e: Floats, variance: Floats, e_variance: Floats) -> Bools:
    """Whether both rays ``(N, 3)`` of a point, in the two views, lie within noise of the line along e: (N,).

    ``variance (N,)`` is that of a ray's direction, rad^2; ``e_variance``, ``(N,)`` or ``(1,)``, the trace of the
    covariance of e: the variance along the worse axis where the direction is uncertain along one axis only, and at most
    twice as much otherwise.
    """
    # Squared sine of the angle between ray and e. What is not known is no sign of being off.
    sine2 = [1.0 - np.einsum("ni,ni->n", rays, e) ** 2 / _square_sum(rays) for rays in (q, r)]
    farther = np.fmax(np.fmax(*sine2), 0.0)
    return np.asarray(farther < SIGNIFICANCE_SIGMAS**2 * (variance + e_variance))


def _to_unit_depth(rays: Floats) -> Floats:
    """The same rays with z = 1; NaN where they do not point in front of the camera."""
    return quotient(rays, np.where(rays[:, 2:] > 0.0, rays[:, 2:], np.nan))


def _square_sum(v: Floats) -> Floats:
    """Squared lengths ``(N,)``."""
    return np.asarray(np.einsum("ni,ni->n", v, v))
