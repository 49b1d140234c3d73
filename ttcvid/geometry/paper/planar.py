"""Planar motion: the epipole of a single flow, where its line meets the horizon.

Directions are ``dir = V / abs(V)`` as in `ttcvid.model`; rays are unit vectors, rotation between the views removed.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.paper.epipole import INFINITY_COSINE, SIGNIFICANCE_SIGMAS
from ttcvid.geometry.quotient import quotient
from ttcvid.geometry.rotation import cross, normalize
from ttcvid.model import Floats, Ints, Status


def planar_epipole(
    q: Floats, p: Floats, horizon_normal: Floats, sigma_rad: Floats, horizon_covariance: Floats
) -> tuple[Floats, Floats, Ints]:
    """Direction of each point that moves in a horizontal plane: flow line x horizon line.

    ``dir`` lies along ``(q x p) x n``, signed by the flow. Its uncertainty along the horizon grows as 1 / sin of the
    angle between flow line and horizon; across, it is the horizon's own.

    Parameters
    ----------
    q, p : ``(N, 3)`` unit rays of the first and the second view.
    horizon_normal : ``(3,)`` unit normal of the horizontal plane, either sign.
    sigma_rad : ``(N,)`` standard deviation of a ray's direction per axis.
    horizon_covariance : ``(3, 3)`` rad^2 of the normal's direction.

    Returns
    -------
    direction : ``(N, 3)``.
    cov : ``(N, 3, 3)`` rad^2, in the tangent plane of the direction.
    status : ``(N,)``: ``short_track`` (NaN), ``no_parallax`` (flow within 3 sigma), ``parallel_to_horizon`` (angle
        between flow line and horizon within 3 sigma): no values. ``epipole_at_infinity``: within 1 deg of the picture
        plane, values are there.

    Source: the paper's section 2.1, "Planar Motion"; DESIGN equation 3.

    >>> q, p = normalize(np.array([[0.1, 0.1, 1.0], [0.2, 0.2, 1.0]]))[:, None, :]
    >>> direction, _, status = planar_epipole(q, p, np.array([0.0, 1.0, 0.0]), np.array([1e-4]), 1e-6 * np.eye(3))
    >>> direction.round(9) + 0.0, status
    (array([[ 0.,  0., -1.]]), array([0]))
    """
    flow_normal = cross(q, p)
    along = cross(flow_normal, horizon_normal)
    flow2 = np.einsum("ni,ni->n", flow_normal, flow_normal)
    sine2 = np.einsum("ni,ni->n", along, along)
    direction = normalize(along)
    direction *= np.where(np.einsum("ni,ni->n", p - q, direction) < 0.0, -1.0, 1.0)[:, None]

    # The flow line's orientation is uncertain by sqrt2 sigma / flow, the horizon's by its own sigma towards the
    # direction; 0 where there is none.
    horizon2 = np.fmax(np.einsum("ni,ij,nj->n", direction, horizon_covariance, direction), 0.0)
    orientation2 = 2.0 * sigma_rad**2 + flow2 * horizon2
    status = np.select(
        [
            ~np.isfinite(flow2 + orientation2),
            flow2 <= SIGNIFICANCE_SIGMAS**2 * 2.0 * sigma_rad**2,
            sine2 <= SIGNIFICANCE_SIGMAS**2 * orientation2,
            np.abs(direction[:, 2]) < INFINITY_COSINE,
        ],
        [Status.short_track, Status.no_parallax, Status.parallel_to_horizon, Status.epipole_at_infinity],
        Status.ok,
    ).astype(np.int64)
    has_value = (status == Status.ok) | (status == Status.epipole_at_infinity)

    # d(dir) = (dm.dir - (n.m) dn.dir) / |m x n| * across - dn.dir * n, with m = q x p and across = dir x n.
    across = cross(normalize(along), horizon_normal)
    ray_sines2 = 2.0 - np.einsum("ni,ni->n", p, direction) ** 2 - np.einsum("ni,ni->n", q, direction) ** 2
    flow_part = quotient(sigma_rad**2 * ray_sines2, sine2)
    lever = quotient(flow_normal @ horizon_normal, np.sqrt(sine2))
    horizon_part = np.sqrt(horizon2)[:, None] * (horizon_normal + lever[:, None] * across)
    cov = (
        flow_part[:, None, None] * across[:, :, None] * across[:, None, :]
        + horizon_part[:, :, None] * horizon_part[:, None, :]
    )
    direction[~has_value], cov[~has_value] = np.nan, np.nan
    return direction, cov, status
