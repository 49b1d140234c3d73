"""The epipole shared by many flows by maximum likelihood on the unit sphere, beside which the paper's is measured.

A flow is a pair of unit rays, the rotation between the views removed: q in the first view, p in the second.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.best_direction import best_direction
from ttcvid.geometry.paper.epipole import INFINITY_COSINE, MAX_DIRECTION_SIGMA_RAD, SIGNIFICANCE_SIGMAS
from ttcvid.geometry.paper.flow_line import flow_line_chi2
from ttcvid.geometry.quotient import quotient
from ttcvid.geometry.rotation import cross, normalize
from ttcvid.model import Floats, Status

# Closer than this to the direction (rad) a point has no side from which it could approach it.
_LEAST_ANGLE_RAD = 1e-12


def epipole_maximum_likelihood(q: Floats, p: Floats, sigma_rad: Floats) -> tuple[Floats, Floats, Floats, Status]:
    """Direction of motion shared by N flows, by maximum likelihood on the unit sphere.

    Minimises the sum of `flow_line_chi2`. Unlike least squares on unit normals of flow lines, it is not pulled towards
    the points when they lie on one side.

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


def moves_towards(directions: Floats, q: Floats, p: Floats, sigma_rad: Floats) -> Floats:
    """How surely each point moves towards each direction: signed, in sigmas; arguments as in `flow_line_chi2`.

    The component of the flow along the great circle through its middle and the direction, positive towards the
    direction, over the sqrt2 sigma of a difference of two positions: ``(M, N)`` or ``(N,)``, 0 for a point on the
    direction itself.

    Source: DESIGN section 3 ("the sign of the direction is tested separately").

    >>> q, p = np.array([[0.0, 0.6, 0.8]]), np.array([[0.0, 0.8, 0.6]])
    >>> moves_towards(np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), q, p, np.array([0.1])).round(12)
    array([[ 2.],
           [-2.]])
    """
    middle_length = np.sqrt(np.einsum("ni,ni->n", p + q, p + q))
    p_along, q_along = directions @ p.T, directions @ q.T
    cosine = p_along + q_along
    cosine *= quotient(1.0, middle_length)
    sine = np.sqrt(np.maximum(1.0 - cosine * cosine, 0.0))
    p_along -= q_along
    component: Floats = np.divide(p_along, sine, out=np.zeros_like(sine), where=~(sine <= _LEAST_ANGLE_RAD))
    component *= quotient(1.0, np.sqrt(2.0) * sigma_rad)
    return component


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
