"""Which tracks move as the static scene does."""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.flow_line import moves_towards
from ttcvid.geometry.rotation import tangent_basis
from ttcvid.model import Bools, Floats
from ttcvid.stages.flows import Flows

# Own direction of travel is not known better than this, rad: matching errs in common over large parts of the picture
# (2 px at f = 800 px), which its covariance does not know.
DIRECTION_FLOOR_RAD = np.radians(0.15)
# A static point moves towards dir; against it by more sigmas than this it is a mover.
_WRONG_WAY_SIGMAS = -3.0


def moves_with_scene(
    flows: Flows, directions: Floats, direction_cov: Floats | None, gate_chi2: float, still_rad: float
) -> Bools:
    """Tracks (N,) whose flow the scene explains; tracks without a flow yet are left to it.

    Parameters
    ----------
    directions : (N, 3) ``dir`` of the scene over each track's gap; NaN where the camera did not translate: there
        a static point has no flow at all.
    direction_cov : (3, 3) rad^2 of the present direction, None where there is none.
    gate_chi2 : chi-square, one degree of freedom, inside which a track belongs to the scene.
    still_rad : flow of one step that counts as none, however small the noise; over a gap it grows with its root.
    """
    flow_rad = np.linalg.norm(flows.second - flows.first, axis=1)
    is_still = (flows.length_sigmas**2 < _two_from_one(gate_chi2)) | (flow_rad < still_rad * np.sqrt(flows.gap_frames))
    is_known = np.isfinite(directions[:, 0])
    belongs = is_still | ~flows.has_flow
    if not is_known.any():
        return np.asarray(belongs)
    moving = flows.take(is_known & flows.has_flow)
    fits = _fits_direction(moving, directions[is_known & flows.has_flow], direction_cov, gate_chi2)
    belongs[is_known & flows.has_flow] = fits
    return np.asarray(belongs)


def _fits_direction(flows: Flows, directions: Floats, direction_cov: Floats | None, gate_chi2: float) -> Bools:
    """Gate on the distance from the scene's flow plane, with the direction's own uncertainty; and the sign."""
    fits = np.zeros(len(directions), dtype=bool)
    for direction in np.unique(directions, axis=0):
        index = np.flatnonzero(np.all(directions == direction, axis=1))
        group = flows.take(index)
        basis = tangent_basis(direction)
        u, w = group.first @ basis, group.second @ basis
        area = u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0]
        trace = np.sum(u * u, axis=1) + np.sum(w * w, axis=1)
        largest = 0.5 * (trace + np.sqrt(np.maximum(trace**2 - 4.0 * area**2, 0.0)))
        by_direction = np.cross(group.first, group.second) @ basis
        covariance = DIRECTION_FLOOR_RAD**2 * np.eye(2)
        if direction_cov is not None:
            covariance = covariance + basis.T @ direction_cov @ basis
        variance = largest * group.sigma_rad**2 + np.einsum("ni,ij,nj->n", by_direction, covariance, by_direction)
        towards = moves_towards(direction, group.first, group.second, group.sigma_rad)
        is_near = area**2 <= gate_chi2 * variance
        # Close to the epipole the sense of the flow turns with the least error of the direction.
        sine = np.sqrt(0.5 * trace)
        is_clear = sine > 3.0 * np.sqrt(np.trace(covariance))
        fits[index] = is_near & ~((towards < _WRONG_WAY_SIGMAS) & is_clear)
    return fits


def _two_from_one(gate_chi2: float) -> float:
    """Gate of two degrees of freedom with the probability that ``gate_chi2`` has for one."""
    from scipy.stats import chi2

    return float(chi2.ppf(chi2.cdf(gate_chi2, 1), 2))
