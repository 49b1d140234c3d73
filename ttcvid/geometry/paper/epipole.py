"""The epipole shared by many flows: by intersection of flow lines in the picture, and by maximum likelihood.

All directions are ``dir = V / abs(V)`` as in `ttcvid.model`: points move towards +dir, away from -dir. Rays are unit
vectors with the rotation between the views removed; q in the first view, p in the second.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.best_direction import best_direction
from ttcvid.geometry.paper.flow_line import flow_line_chi2, flow_normals, moves_towards
from ttcvid.geometry.quotient import quotient
from ttcvid.geometry.rotation import cross, normalize, tangent_basis
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
    lines, 0.3 px: 32 px in the tests); `epipole_maximum_likelihood` has no such bias.

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


def epipole_maximum_likelihood(q: Floats, p: Floats, sigma_rad: Floats) -> tuple[Floats, Floats, Floats, Status]:
    """Direction of motion shared by N flows, by maximum likelihood on the unit sphere.

    Minimises the sum of `flow_line_chi2`. Unlike least squares on unit
    normals of flow lines, it is not pulled towards the points when they lie on one side.

    Parameters
    ----------
    q, p : ``(N, 3)`` unit rays of the first and the second view; NaN rays are left out.
    sigma_rad : ``(N,)`` standard deviation of a ray's direction per axis.

    Returns
    -------
    direction : ``(3,)`` unit vector, its sign chosen by the flow; NaN for ``no_parallax`` and ``no_epipole``.
    cov : ``(3, 3)`` rad^2 in its tangent plane, from the Hessian of chi-square.
    chi2 : ``(N,)`` of each flow.
    status : ``no_parallax`` (all flow within noise), ``no_epipole`` (fewer than two flows, or the direction is not
        determined to 0.5 rad), ``epipole_at_infinity`` (within 1 deg of the picture plane; values are there).

    Source: DESIGN section 3, the general estimator, "epipole of many flows".
    """
    n_flows = len(q)
    nothing = np.full(3, np.nan), np.full((3, 3), np.nan), np.full(n_flows, np.nan)
    is_usable = np.isfinite(q).all(axis=1) & np.isfinite(p).all(axis=1) & (sigma_rad > 0.0)
    if is_usable.sum() < 2:
        return *nothing, Status.no_epipole
    used = q[is_usable], p[is_usable], sigma_rad[is_usable]
    # Flows that together are no longer than noise makes them: chi-square of 2 N degrees of freedom.
    flow_chi2, freedom = np.sum((used[1] - used[0]) ** 2 / (2.0 * used[2][:, None] ** 2)), 2.0 * len(used[0])
    if flow_chi2 <= freedom + SIGNIFICANCE_SIGMAS * np.sqrt(2.0 * freedom):
        return *nothing, Status.no_parallax
    normals = cross(used[1], used[0])

    def signed_roots(direction: Floats) -> Floats:
        return np.asarray(np.sign(normals @ direction) * np.sqrt(flow_line_chi2(direction, *used)))

    direction, cov = best_direction(signed_roots, _eigen_epipole(*used))
    if not np.linalg.norm(cov, 2) < MAX_DIRECTION_SIGMA_RAD**2:
        return *nothing, Status.no_epipole
    # One wild flow must not outvote the others.
    votes = np.clip(moves_towards(direction, *used), -SIGNIFICANCE_SIGMAS, SIGNIFICANCE_SIGMAS)
    direction = direction * np.where(votes.sum() < 0.0, -1.0, 1.0)
    at_infinity = abs(direction[2]) < INFINITY_COSINE
    status = Status.epipole_at_infinity if at_infinity else Status.ok
    return direction, cov, flow_line_chi2(direction, q, p, sigma_rad), status


def direction_chi2(one: Floats, other: Floats, covariance: Floats) -> Floats:
    """Squared difference of two directions in their joint uncertainty, a chi-square with two degrees of freedom.

    Parameters
    ----------
    one, other : ``(..., 3)`` unit vectors, broadcast.
    covariance : ``(..., 3, 3)`` rad^2: the sum of both, in their tangent planes.

    Returns
    -------
    ``(...)``. Infinite for directions in opposite half-spaces: the same line, travelled the other way, is another
    motion.

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


def _eigen_epipole(q: Floats, p: Floats, sigma_rad: Floats) -> Floats:
    """Start for the maximum likelihood: the best of five closed solutions, ``(3,)`` of either sign.

    The two smaller eigenvectors of ``sum n n' / sigma^2`` and of ``sum n n' / abs(n)^2`` with ``n = q x p`` (the
    first weights flows by their length, the second, the paper's on the sphere, does not; both are biased), and the
    mean flow.
    """
    normals = cross(q, p)
    length2 = np.einsum("ni,ni->n", normals, normals)
    factors = np.stack([quotient(1.0, sigma_rad**2), np.nan_to_num(quotient(1.0, length2))])
    _, vectors = np.linalg.eigh(np.einsum("kn,ni,nj->kij", factors, normals, normals))
    # A small thing that crosses has its flow along its own plane: there the direction is that of the mean flow, and
    # the smallest eigenvectors may lie on the thing itself.
    mean_flow = normalize(np.mean(p - q, axis=0))
    candidates = np.concatenate([vectors[:, :, 0], vectors[:, :, 1], mean_flow[None]])
    # By the logarithm, so that some flows of another motion do not choose.
    cost = np.log1p(flow_line_chi2(candidates, q, p, sigma_rad)).sum(axis=-1)
    return np.asarray(candidates[np.argmin(cost)])
