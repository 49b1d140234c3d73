"""Time from the expansion of a region: what is left when a point itself shows no flow (constant bearing)."""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.quotient import quotient
from ttcvid.model import Floats, Ints

# On the plane z = 1: points that are closer together than this (root mean square) differ by rounding alone.
_LEAST_EXTENT = 1e-9


def expansion_rate(
    rays_first: Floats, rays_second: Floats, dt_s: float | Floats, weights: Floats | None = None
) -> tuple[Floats, Floats]:
    """Expansion of regions about their centroids between two views, in 1/s.

    A region that keeps its depth relations grows by ``scale = Z_first / Z_second``, so that
    ``expansion = (scale - 1) / dt = -Vz / Z_second`` and ``ttc_z = 1 / expansion`` at the second view. The scale is
    that of the least-squares similarity without rotation about the axis: the geometric mean of the fit of the second
    view on the first and the inverse of the opposite fit, which is the ratio of sizes. One fit alone is biased low by
    the noise in what it is fitted on. Differences from the centroid make it blind to camera rotation, to first order.

    Parameters
    ----------
    rays_first, rays_second : ``(..., m, 3)``: regions of m points each, rotation removed, any length, z > 0.
    dt_s : Time between the views, scalar or ``(...)``.
    weights : ``(..., m)`` relative inverse variances, 0 for absent points; None: equal. Points that are NaN or not in
        front of the camera are absent by themselves.

    Returns
    -------
    expansion_hz : ``(...)``, positive when it grows; NaN with fewer than two points, no extent, or no positive dt.
    sigma_hz : ``(...)``, from the residuals of the similarity (2 m - 3 degrees of freedom). Points at different depths
        or with motions of their own make it larger, as they should.

    Source: the paper's "Direct Collision Candidate"; DESIGN equation 8.

    A square that grows by 10 % in 0.1 s is 1 s away:

    >>> corners = np.array([[-1.0, -1.0, 10.0], [1.0, -1.0, 10.0], [1.0, 1.0, 10.0], [-1.0, 1.0, 10.0]])
    >>> expansion_hz, _ = expansion_rate(corners * [1, 1, 1.1], corners, 0.1)
    >>> float(round(expansion_hz, 9))
    1.0
    """
    *xy, z = np.moveaxis(np.stack(np.broadcast_arrays(rays_first, rays_second)), -1, 0)
    with np.errstate(all="ignore"):
        # In the plane z = 1, x and y (2,) by view (2,) by region and point.
        places = np.array(xy) / z
    is_there = (z > 0.0).all(axis=0) & np.isfinite(places.sum(axis=(0, 1)))
    weight = np.where(is_there, 1.0 if weights is None else weights, 0.0)
    total, count = weight.sum(axis=-1), np.count_nonzero(weight, axis=-1)
    # With u, v the offsets from the centroids of the two views: scale^2 = sum w v^2 / sum w u^2, and the residuals
    # v - scale u have 2 m - 3 degrees of freedom.
    places = np.where(is_there, places, 0.0)
    off = places - quotient(np.einsum("cv...m,...m->cv...", places, weight), total)[..., None]
    uu, vv = np.einsum("cv...m,cv...m,...m->v...", off, off, weight)
    has_extent = np.minimum(uu, vv) > _LEAST_EXTENT**2 * total
    scale = np.sqrt(quotient(vv, np.where(has_extent, uu, np.nan)))
    left = off[:, 1] - scale[..., None] * off[:, 0]
    squares = np.einsum("c...m,c...m,...m->...", left, left, weight)
    variance = squares / (np.maximum(2 * count - 3, 1) * (1.0 + scale**2)) * (quotient(1.0, uu) + quotient(1.0, vv))
    dt_s = np.where(np.asarray(dt_s) > 0.0, dt_s, np.nan)
    return (scale - 1.0) / dt_s, scale * np.sqrt(variance) / dt_s


def expansion_of_neighbourhood(
    rays_first: Floats, rays_second: Floats, neighbours: Ints, dt_s: float | Floats
) -> tuple[Floats, Floats]:
    """`expansion_rate` of the neighbourhood of each of Q query points.

    Parameters
    ----------
    rays_first, rays_second : ``(N, 3)`` as in `expansion_rate`.
    neighbours : ``(Q, m)`` indices of the points of each neighbourhood; negative: absent.
    dt_s : Time between the views, scalar or ``(Q,)``.

    Returns
    -------
    expansion_hz, sigma_hz : ``(Q,)``.

    Source: DESIGN equation 8.
    """
    is_there = (neighbours >= 0).astype(np.float64)
    return expansion_rate(rays_first[neighbours], rays_second[neighbours], dt_s, is_there)
