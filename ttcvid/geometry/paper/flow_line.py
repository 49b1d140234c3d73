"""How well flows agree with a direction of motion: distance to the flow line, and chi-square.

A flow is a pair of unit rays: q in the first view, p in the second, rotation removed. It agrees with a direction
when q, p and the direction lie on one great circle; the sign of the direction is not asked.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.quotient import quotient
from ttcvid.geometry.rotation import cross
from ttcvid.model import Floats


def flow_line_distance_px(epipole_px: Floats, first_px: Floats, second_px: Floats) -> Floats:
    """Distance of an epipole from flow lines in the picture: the paper's test, a fixed epsilon in px.

    A true inlier's line misses its epipole by about sqrt2 sigma k, so a fixed epsilon fits one k only;
    `flow_line_chi2` does not have this flaw. Undistorted positions ``epipole_px (2,)``, ``first_px, second_px (N, 2)``
    give ``(N,)`` px; NaN where there is no flow.

    Source: the paper's (5), DESIGN equation 6.

    >>> flow_line_distance_px(np.array([0.0, 5.0]), np.array([[10.0, 2.0]]), np.array([[12.0, 2.0]]))
    array([3.])
    """
    return np.asarray(np.abs(np.einsum("ni,ni->n", flow_normals(first_px, second_px), epipole_px - first_px)))


def flow_normals(first_px: Floats, second_px: Floats) -> Floats:
    """Unit normals ``(N, 2)`` of flow lines in the picture: (-t_y, t_x) / abs(t) with t the flow; NaN without one.

    ``first_px, second_px (N, 2)`` undistorted.
    """
    x, y = (second_px - first_px).T
    return quotient(np.stack([-y, x], axis=1), np.hypot(x, y)[:, None])


def flow_line_chi2(directions: Floats, q: Floats, p: Floats, sigma_rad: Floats) -> Floats:
    """Chi-square (one degree of freedom) of each flow against each direction, blind to the sign of the direction.

    The least sum of squared movements of p and q, in sigmas, that puts both on one great circle with the direction:
    ``lambda_min(B'(pp' + qq')B) / sigma^2`` with B a basis normal to the direction. With u, w the projections B'p and
    B'q, ``lambda_min = (u x w)^2 / lambda_max``, which loses no digits for short flows; all of it is written in dot
    products, without B.

    Parameters
    ----------
    directions : ``(M, 3)`` or ``(3,)`` unit vectors.
    q, p : ``(N, 3)`` unit rays of the first and the second view.
    sigma_rad : ``(N,)`` standard deviation of a ray's direction per axis.

    Returns
    -------
    ``(M, N)`` or ``(N,)``; 0 for a point on the direction itself, NaN where an input is NaN or sigma is not positive.

    Source: DESIGN equation 6 and the general estimator.

    >>> q, p = np.array([[0.0, 0.6, 0.8]]), np.array([[0.6, 0.0, 0.8]])
    >>> flow_line_chi2(np.array([0.0, 0.0, 1.0]), q, p, np.array([0.1])).round(12)
    array([36.])
    """
    p_along, q_along = directions @ p.T, directions @ q.T
    mixed = np.einsum("ni,ni->n", p, q) - p_along * q_along
    p_square, q_square = _one_minus_square(p_along), _one_minus_square(q_along)
    # In place from here on: fresh (M, N) arrays cost more than the arithmetic.
    lambda_max = p_square + q_square
    p_square -= q_square
    p_square *= p_square
    mixed *= mixed
    mixed *= 4.0
    mixed += p_square
    lambda_max += np.sqrt(mixed, out=mixed)
    lambda_max *= 0.5
    triple: Floats = directions @ cross(p, q).T
    triple *= triple
    chi2: Floats = np.divide(triple, lambda_max, out=triple, where=lambda_max > 0.0)
    chi2 *= quotient(1.0, sigma_rad * sigma_rad)
    return chi2


def _one_minus_square(cosine: Floats) -> Floats:
    """``1 - cosine^2`` in the array's own memory."""
    np.multiply(cosine, cosine, out=cosine)
    return np.subtract(1.0, cosine, out=cosine)
