"""Time from the expansion of a region: what is left when a point itself shows no flow (constant bearing)."""

from __future__ import annotations

import math

import numpy as np

from ttcvid.geometry.compiled import compiled, compiled_for
from ttcvid.model import Floats, Ints

LEAST_EXTENT = 1e-9
"""On the plane z = 1: points that are closer together than this (root mean square) differ by rounding alone."""


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
    *shape, m, _ = np.broadcast_shapes(rays_first.shape, rays_second.shape)

    def one_after_the_other(values: Floats | float, *last: int) -> Floats:
        every = np.array(np.broadcast_to(values, (*shape, m, *last)), dtype=np.float64, order="C")
        return every.reshape(-1, *last)

    regions = np.arange(math.prod(shape) * m).reshape(math.prod(shape), m)
    views = one_after_the_other(rays_first, 3), one_after_the_other(rays_second, 3)
    weights = one_after_the_other(1.0 if weights is None else weights)
    return _rates(*views, weights, regions, np.broadcast_to(dt_s, shape), shape)


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
    views = np.ascontiguousarray(rays_first), np.ascontiguousarray(rays_second)
    return _rates(*views, np.ones(len(rays_first)), neighbours, dt_s, [len(neighbours)])


def _rates(
    first: Floats, second: Floats, weights: Floats, regions: Ints, dt_s: float | Floats, shape: list[int]
) -> tuple[Floats, Floats]:
    """`expansion_rate` of ``regions (R, m)`` of N points, in the given shape."""
    scale, log_scale_variance = np.full(len(regions), np.nan), np.full(len(regions), np.nan)
    _fit_each(first, second, weights, np.asarray(regions, dtype=np.int64), scale, log_scale_variance)
    dt_s = np.where(np.asarray(dt_s) > 0.0, dt_s, np.nan)
    scale = scale.reshape(shape)
    return (scale - 1.0) / dt_s, scale * np.sqrt(log_scale_variance.reshape(shape)) / dt_s


@compiled_for("(f8[:, ::1], f8[:, ::1], f8[::1], i8[:, ::1], f8[::1], f8[::1])")
def _fit_each(
    first: Floats, second: Floats, weights: Floats, regions: Ints, scale: Floats, log_scale_variance: Floats
) -> None:
    """Fills the similarity's ``scale (R,)`` of each of the ``regions (R, m)``, and the variance of its logarithm.

    With u, v the offsets from the centroids of the two views: scale^2 = sum w v^2 / sum w u^2, and the residuals
    v - scale u have 2 m - 3 degrees of freedom.
    """
    offset, w = np.empty((regions.shape[1], 4)), np.empty(regions.shape[1])
    for region in range(len(regions)):
        count = _offsets(first, second, weights, regions[region], offset, w)
        uu, vv, misfit, total = 0.0, 0.0, 0.0, 0.0
        for i in range(count):
            total += w[i]
            uu += w[i] * (offset[i, 0] ** 2 + offset[i, 1] ** 2)
            vv += w[i] * (offset[i, 2] ** 2 + offset[i, 3] ** 2)
        least = LEAST_EXTENT**2 * total
        if not (uu > least and vv > least):
            continue
        ratio = np.sqrt(vv / uu)
        for i in range(count):
            misfit += w[i] * ((offset[i, 2] - ratio * offset[i, 0]) ** 2 + (offset[i, 3] - ratio * offset[i, 1]) ** 2)
        scale[region] = ratio
        if count > 1:
            point_variance = misfit / ((2 * count - 3) * (1.0 + ratio * ratio))
            log_scale_variance[region] = point_variance * (1.0 / uu + 1.0 / vv)


@compiled
def _offsets(first: Floats, second: Floats, weights: Floats, region: Ints, offset: Floats, w: Floats) -> int:
    """Fills ``offset (m, 4)`` from the centroids of both views with the points that are seen, and their weights.

    ``region (m,)`` are the points, negative: absent.
    """
    count, total = 0, 0.0
    first_x, first_y, second_x, second_y = 0.0, 0.0, 0.0, 0.0
    for i in region:
        # Comparisons with NaN are False.
        if i < 0 or not (weights[i] > 0.0 and first[i, 2] > 0.0 and second[i, 2] > 0.0):
            continue
        x, y = first[i, 0] / first[i, 2], first[i, 1] / first[i, 2]
        u, v = second[i, 0] / second[i, 2], second[i, 1] / second[i, 2]
        # A sum is finite where all of its terms are.
        if np.isfinite(x + y + u + v):
            w[count] = weights[i]
            offset[count, 0], offset[count, 1], offset[count, 2], offset[count, 3] = x, y, u, v
            first_x, first_y = first_x + w[count] * x, first_y + w[count] * y
            second_x, second_y = second_x + w[count] * u, second_y + w[count] * v
            total += w[count]
            count += 1
    for i in range(count):
        offset[i, 0] -= first_x / total
        offset[i, 1] -= first_y / total
        offset[i, 2] -= second_x / total
        offset[i, 3] -= second_y / total
    return count
