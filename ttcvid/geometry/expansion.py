"""Time from the expansion of a region: what is left when a point itself shows no flow (constant bearing)."""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.quotient import quotient
from ttcvid.model import Floats, Ints


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
    rays_first, rays_second
        ``(..., m, 3)``: regions of m points each, rotation removed, any length, z > 0.
    dt_s
        Time between the views, scalar or ``(...)``.
    weights
        ``(..., m)`` relative inverse variances, 0 for absent points; None: equal. Points that are NaN or not in front
        of the camera are absent by themselves.

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
    first, second = _normalised(rays_first), _normalised(rays_second)
    is_seen = np.isfinite(first + second).all(axis=-1)
    w: Floats = np.where(is_seen, 1.0 if weights is None else weights, 0.0)
    first, second = _from_centroid(first, w), _from_centroid(second, w)

    size2_first, size2_second = _weighted_square_sum(first, w), _weighted_square_sum(second, w)
    scale = np.sqrt(quotient(size2_second, size2_first))
    misfit2 = _weighted_square_sum(second - scale[..., None, None] * first, w)
    freedom = 2.0 * np.count_nonzero(w > 0.0, axis=-1) - 3.0
    point_variance = quotient(misfit2, np.maximum(freedom, 0.0) * (1.0 + scale * scale))
    log_scale_variance = point_variance * (quotient(1.0, size2_first) + quotient(1.0, size2_second))
    dt_s = np.where(np.asarray(dt_s) > 0.0, dt_s, np.nan)
    return (scale - 1.0) / dt_s, scale * np.sqrt(log_scale_variance) / dt_s


def expansion_of_neighbourhood(
    rays_first: Floats, rays_second: Floats, neighbours: Ints, dt_s: float | Floats
) -> tuple[Floats, Floats]:
    """`expansion_rate` of the neighbourhood of each of Q query points.

    Parameters
    ----------
    rays_first, rays_second
        ``(N, 3)`` as in `expansion_rate`.
    neighbours
        ``(Q, m)`` indices of the points of each neighbourhood; negative: absent.
    dt_s
        Time between the views, scalar or ``(Q,)``.

    Returns
    -------
    expansion_hz, sigma_hz : ``(Q,)``.

    Source: DESIGN equation 8.
    """
    is_there = (neighbours >= 0).astype(np.float64)
    return expansion_rate(rays_first[neighbours], rays_second[neighbours], dt_s, is_there)


def _normalised(rays: Floats) -> Floats:
    """Normalised coordinates ``(..., 2)``; NaN where a ray does not point in front of the camera."""
    depth = rays[..., 2:]
    return quotient(rays[..., :2], np.where(depth > 0.0, depth, np.nan))


def _from_centroid(points: Floats, weights: Floats) -> Floats:
    """Offsets ``(..., m, 2)`` from the weighted centroid; zero for absent points."""
    points = np.where(weights[..., None] > 0.0, points, 0.0)
    centroid = quotient(np.einsum("...m,...mi->...i", weights, points), weights.sum(axis=-1)[..., None])
    return np.where(weights[..., None] > 0.0, points - centroid[..., None, :], 0.0)


def _weighted_square_sum(offsets: Floats, weights: Floats) -> Floats:
    """``sum w abs(offset)^2`` ``(...)``."""
    result: Floats = np.einsum("...m,...mi,...mi->...", weights, offsets, offsets)
    return result
