"""The epipole shared by many flows: by intersection of flow lines in the picture, and by maximum likelihood.

All directions are ``dir = V / abs(V)`` as in `ttcvid.model`: points move towards +dir, away from -dir. Rays are unit
vectors with the rotation between the views removed; q in the first view, p in the second.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.flow_line import flow_line_chi2, flow_normals, moves_towards
from ttcvid.geometry.quotient import quotient
from ttcvid.geometry.rotation import normalize, tangent_basis
from ttcvid.model import Floats, Status

# A motion or an angle below this many standard deviations is noise.
SIGNIFICANCE_SIGMAS = 3.0
# Within 1 deg of the picture plane an epipole is at infinity, for its pixel; its direction is as good as any.
INFINITY_COSINE = float(np.sin(np.radians(1.0)))

# Flow lines in the picture are parallel when their normals span less than this (ratio of singular values).
_PARALLEL_RATIO = 1e-10
# A direction less certain than this (rad) is unknown: the tangent plane is no model of the sphere beyond.
_MAX_DIRECTION_SIGMA_RAD = 0.5
_MAX_ITERATIONS = 30
_CONVERGED_STEP_RAD = 1e-12
# Fractions of a Gauss-Newton step that are tried at once; the best one is taken.
_STEP_FRACTIONS = np.array([1.0, 0.5, 0.2, 0.05, 0.01])
# In the vote on the sign a track counts at most this many sigmas: one wild flow must not outvote the others.
_MAX_VOTE_SIGMAS = 3.0


def epipole_from_flow_lines(first_px: Floats, second_px: Floats) -> tuple[Floats, Status]:
    """Least-squares intersection of flow lines in the picture, by pseudo-inverse of their unit normals.

    Kept as the paper has it. Its unit normals are themselves noisy, which biases it towards the points (80 one-sided
    lines, 0.3 px: 32 px in the tests); `epipole_maximum_likelihood` is what the stages use.

    Parameters
    ----------
    first_px, second_px
        ``(N, 2)`` undistorted, rotation removed. Points without flow or with NaN are left out.

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


def epipole_maximum_likelihood(
    q: Floats,
    p: Floats,
    sigma_rad: Floats,
    weights: Floats | None = None,
    start: Floats | None = None,
    cauchy_sigmas: float | None = None,
) -> tuple[Floats, Floats, Floats, Status]:
    """Direction of motion shared by N flows, by maximum likelihood on the unit sphere.

    Minimises the sum of `flow_line_chi2` by Gauss-Newton in the tangent plane. Unlike least squares on unit normals
    of flow lines, it is not pulled towards the points when they lie on one side.

    Parameters
    ----------
    q, p
        ``(N, 3)`` unit rays of the first and the second view.
    sigma_rad
        ``(N,)`` standard deviation of a ray's direction per axis.
    weights
        ``(N,)`` factors of chi-square; 0 leaves a flow out. NaN rays are left out by themselves.
    start
        ``(3,)`` unit vector, either sign; without it the better of two eigenvector solutions.
    cauchy_sigmas
        Scale of robust Cauchy weights in sigmas; None: plain least squares.

    Returns
    -------
    direction : ``(3,)`` unit vector, its sign chosen by the flow; NaN for ``no_parallax`` and ``no_epipole``.
    cov : ``(3, 3)`` rad^2 in its tangent plane, from the Hessian of the (weighted) chi-square.
    chi2 : ``(N,)`` of each flow, unweighted.
    status : ``no_parallax`` (all flow within noise), ``no_epipole`` (fewer than two flows, or the direction is not
        determined to 0.5 rad), ``epipole_at_infinity`` (within 1 deg of the picture plane; values are there).

    Source: DESIGN section 3, the general estimator, "epipole of many flows".
    """
    n_flows = len(q)
    nothing = np.full(3, np.nan), np.full((3, 3), np.nan), np.full(n_flows, np.nan)
    weights = np.ones(n_flows) if weights is None else weights
    is_usable = np.isfinite(q).all(axis=1) & np.isfinite(p).all(axis=1) & (sigma_rad > 0.0) & (weights > 0.0)
    if is_usable.sum() < 2:
        return *nothing, Status.no_epipole
    used = q[is_usable], p[is_usable], sigma_rad[is_usable]
    if not _has_motion(*used):
        return *nothing, Status.no_parallax
    direction = eigen_epipole(*used, weights[is_usable]) if start is None else start
    direction, cov = _descend(direction, *used, weights[is_usable], cauchy_sigmas)
    if not np.linalg.norm(cov, 2) < _MAX_DIRECTION_SIGMA_RAD**2:
        return *nothing, Status.no_epipole
    factor = _robust_factor(flow_line_chi2(direction, *used), cauchy_sigmas) * weights[is_usable]
    votes = np.clip(moves_towards(direction, *used), -_MAX_VOTE_SIGMAS, _MAX_VOTE_SIGMAS)
    direction = direction * np.where(factor @ votes < 0.0, -1.0, 1.0)
    at_infinity = abs(direction[2]) < INFINITY_COSINE
    status = Status.epipole_at_infinity if at_infinity else Status.ok
    return direction, cov, flow_line_chi2(direction, q, p, sigma_rad), status


def eigen_epipole(q: Floats, p: Floats, sigma_rad: Floats, weights: Floats) -> Floats:
    """Start for the maximum likelihood: the better of two closed solutions, ``(3,)`` of either sign.

    Smallest eigenvectors of ``sum w n n' / sigma^2`` and of ``sum w n n' / abs(n)^2`` with ``n = q x p``: the first
    weights flows by their length, the second (the paper's, on the sphere) does not. Both are biased.
    """
    normals = np.cross(q, p)
    length2 = np.einsum("ni,ni->n", normals, normals)
    factors = np.stack([quotient(weights, sigma_rad**2), np.nan_to_num(quotient(weights, length2))])
    _, vectors = np.linalg.eigh(np.einsum("kn,ni,nj->kij", factors, normals, normals))
    candidates = vectors[:, :, 0]
    cost = flow_line_chi2(candidates, q, p, sigma_rad) @ weights
    best: Floats = candidates[np.argmin(cost)]
    return best


def _has_motion(q: Floats, p: Floats, sigma_rad: Floats) -> bool:
    """Whether the flows together are longer than noise makes them (chi-square of 2 N degrees of freedom)."""
    chi2 = np.sum(quotient(np.einsum("ni,ni->n", p - q, p - q), 2.0 * sigma_rad**2))
    freedom = 2.0 * len(q)
    return bool(chi2 > freedom + SIGNIFICANCE_SIGMAS * np.sqrt(2.0 * freedom))


def _descend(
    direction: Floats, q: Floats, p: Floats, sigma_rad: Floats, weights: Floats, cauchy_sigmas: float | None
) -> tuple[Floats, Floats]:
    """Gauss-Newton from a start: the direction at the minimum and its covariance (infinite where undetermined)."""
    cov = np.full((3, 3), np.inf)
    cost = _robust_cost(flow_line_chi2(direction[None], q, p, sigma_rad), weights, cauchy_sigmas)[0]
    for _ in range(_MAX_ITERATIONS):
        basis = tangent_basis(direction)
        residual, jacobian = _residuals(direction, basis, q, p, sigma_rad)
        weighted = jacobian * (weights * _robust_factor(residual**2, cauchy_sigmas))[:, None]
        hessian = weighted.T @ jacobian
        if not np.linalg.cond(hessian) < 1.0 / np.finfo(np.float64).eps:
            return direction, np.full((3, 3), np.inf)
        cov = basis @ np.linalg.inv(hessian) @ basis.T
        step = -basis @ np.linalg.solve(hessian, weighted.T @ residual)
        trials = normalize(direction + _STEP_FRACTIONS[:, None] * step)
        costs = _robust_cost(flow_line_chi2(trials, q, p, sigma_rad), weights, cauchy_sigmas)
        best = int(np.argmin(costs))
        if not costs[best] < cost:
            break
        direction, cost = trials[best], costs[best]
        if np.linalg.norm(step) < _CONVERGED_STEP_RAD:
            break
    return direction, cov


def _residuals(direction: Floats, basis: Floats, q: Floats, p: Floats, sigma_rad: Floats) -> tuple[Floats, Floats]:
    """Signed roots ``(N,)`` of `flow_line_chi2` and their derivatives ``(N, 2)`` by tangent coordinates."""
    p_along, q_along, p_tangent, q_tangent = p @ direction, q @ direction, p @ basis, q @ basis
    normals = np.cross(p, q)
    half_difference = 0.5 * (q_along**2 - p_along**2)
    mixed = np.einsum("ni,ni->n", p, q) - p_along * q_along
    root = np.hypot(half_difference, mixed)
    lambda_max = np.maximum(1.0 - 0.5 * (p_along**2 + q_along**2) + root, 0.0)
    d_p, d_q = p_along[:, None] * p_tangent, q_along[:, None] * q_tangent
    d_mixed = -(q_along[:, None] * p_tangent + p_along[:, None] * q_tangent)
    d_root = np.nan_to_num(quotient(half_difference, root))[:, None] * (d_q - d_p)
    d_root += np.nan_to_num(quotient(mixed, root))[:, None] * d_mixed
    d_lambda = d_root - d_p - d_q
    scale = np.nan_to_num(quotient(1.0, np.sqrt(lambda_max) * sigma_rad))
    residual = (normals @ direction) * scale
    relative = np.nan_to_num(quotient(0.5 * residual, lambda_max))
    return residual, (normals @ basis) * scale[:, None] - relative[:, None] * d_lambda


def _robust_factor(chi2: Floats, cauchy_sigmas: float | None) -> Floats:
    """Cauchy weight of each flow; ones without a scale."""
    if cauchy_sigmas is None:
        return np.ones_like(chi2)
    weight: Floats = 1.0 / (1.0 + chi2 / cauchy_sigmas**2)
    return weight


def _robust_cost(chi2: Floats, weights: Floats, cauchy_sigmas: float | None) -> Floats:
    """Weighted sum over flows of chi-square ``(M, N)``, or of its Cauchy loss."""
    loss = chi2 if cauchy_sigmas is None else cauchy_sigmas**2 * np.log1p(chi2 / cauchy_sigmas**2)
    total: Floats = loss @ weights
    return total
