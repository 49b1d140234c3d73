"""The epipole shared by many flows, by intersection of flow lines in the picture; and when two epipoles differ.

All directions are ``dir = V / abs(V)`` as in `ttcvid.model`: points move towards +dir, away from -dir.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.paper.flow_line import flow_normals
from ttcvid.geometry.rotation import tangent_basis
from ttcvid.model import Floats, Status

# A motion or an angle below this many standard deviations is noise.
SIGNIFICANCE_SIGMAS = 3.0
# Within 1 deg of the picture plane an epipole is at infinity, for its pixel; its direction is as good as any. As the
# cosine between dir and the optical axis, which is dir_z.
INFINITY_COSINE = float(np.cos(np.radians(89.0)))

# Flow lines in the picture are parallel when their normals span less than this (ratio of singular values).
_PARALLEL_RATIO = 1e-10
# A direction less certain than this (rad) is unknown: the tangent plane is no model of the sphere beyond.
MAX_DIRECTION_SIGMA_RAD = 0.5


def epipole_from_flow_lines(first_px: Floats, second_px: Floats) -> tuple[Floats, Status]:
    """Least-squares intersection of flow lines in the picture, by pseudo-inverse of their unit normals.

    Kept as the paper has it. Its unit normals are themselves noisy, which biases it towards the points (80 one-sided
    lines, 0.3 px: 32 px in the tests); maximum likelihood on the sphere (`flow_line_chi2`) has no such bias.

    Parameters
    ----------
    first_px, second_px : ``(N, 2)`` undistorted, rotation removed. Points without flow or with NaN are left out.

    Returns
    -------
    epipole_px : ``(2,)``, NaN unless the status is ``ok``.
    status : ``no_epipole`` (fewer than two lines) or ``epipole_at_infinity`` (parallel lines).

    Source: the paper's (4), DESIGN equation 5.

    >>> epipole, _ = epipole_from_flow_lines(np.array([[1.0, 1.0], [2.0, 1.0]]), np.array([[2.0, 2.0], [4.0, 2.0]]))
    >>> epipole.round(9) + 0.0
    array([0., 0.])
    """
    normals = flow_normals(first_px, second_px)
    is_line = np.isfinite(normals).all(axis=1)
    if is_line.sum() < 2:
        return np.full(2, np.nan), Status.no_epipole
    normals, points = normals[is_line], first_px[is_line]
    centre = points.mean(axis=0)
    offsets = np.einsum("ni,ni->n", normals, points - centre)
    solution, _, _, singular_values = np.linalg.lstsq(normals, offsets, rcond=_PARALLEL_RATIO)
    if singular_values[1] <= _PARALLEL_RATIO * singular_values[0]:
        return np.full(2, np.nan), Status.epipole_at_infinity
    return centre + solution, Status.ok


def direction_chi2(one: Floats, other: Floats, covariance: Floats) -> Floats:
    """Squared difference of two directions in their joint uncertainty, a chi-square with two degrees of freedom.

    Parameters
    ----------
    one, other : ``(..., 3)`` unit vectors, broadcast.
    covariance : ``(..., 3, 3)`` rad^2: the sum of both, in their tangent planes.

    Returns
    -------
    ``(...)``. Infinite for directions in opposite half-spaces: the same line travelled the other way is another motion.

    >>> ahead, aside = np.array([0.0, 0.0, 1.0]), np.array([0.02, 0.0, 1.0])
    >>> direction_chi2(ahead, np.array([aside, -aside]), 0.01**2 * np.eye(3)).round(9)
    array([ 4., inf])
    """
    basis = tangent_basis(one)
    x, y = np.moveaxis((other[..., None, :] @ basis)[..., 0, :], -1, 0)
    across = np.swapaxes(basis, -1, -2) @ covariance @ basis
    xx, xy, yy = across[..., 0, 0], across[..., 0, 1], across[..., 1, 1]
    chi2 = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / (xx * yy - xy * xy)
    return np.where(np.sum(one * other, axis=-1) < 0.0, np.inf, chi2)
