"""Which tracks move as the static scene does."""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.chi_square import chi2_probability, chi2_quantile
from ttcvid.geometry.rotation import cross
from ttcvid.model import Bools, Floats
from ttcvid.stages.flows import Flows

# Own direction of travel is not known better than this, rad: matching errs in common over large parts of the picture
# (2 px at f = 800 px), which its covariance does not know.
DIRECTION_FLOOR_RAD = np.radians(0.15)
# A static point moves towards dir; against it by more sigmas than this it is a mover.
_WRONG_WAY_SIGMAS = -3.0
# The sense is asked for only so many sigmas of the direction away from the epipole.
_CLEAR_SIGMAS, _TINY = 3.0, 1e-9


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
    moving = np.flatnonzero(is_known & flows.has_flow)
    belongs[moving] = _fits_direction(flows.take(moving), directions[moving], direction_cov, gate_chi2)
    return np.asarray(belongs)


def _fits_direction(flows: Flows, directions: Floats, direction_cov: Floats | None, gate_chi2: float) -> Bools:
    """Gate on the distance from the scene's flow plane, with the direction's own uncertainty; and the sense."""
    along_first = np.einsum("ni,ni->n", flows.first, directions)
    along_second = np.einsum("ni,ni->n", flows.second, directions)
    square_first, square_second = 1.0 - along_first**2, 1.0 - along_second**2
    mixed = np.einsum("ni,ni->n", flows.first, flows.second) - along_first * along_second
    trace = square_first + square_second
    largest = 0.5 * (trace + np.sqrt((square_first - square_second) ** 2 + 4.0 * mixed**2))
    normal = cross(flows.first, flows.second)
    area = np.einsum("ni,ni->n", normal, directions)
    covariance = DIRECTION_FLOOR_RAD**2 * np.eye(3) + (0.0 if direction_cov is None else direction_cov)
    variance = largest * flows.sigma_rad**2 + np.einsum("ni,ij,nj->n", normal, covariance, normal)
    is_near = area**2 <= gate_chi2 * variance
    # Close to the epipole the sense of the flow turns with the least error of the direction.
    sine = np.sqrt(np.maximum(0.5 * trace, 0.0))
    is_clear = sine > _CLEAR_SIGMAS * np.sqrt(np.trace(covariance))
    towards = (along_second - along_first) / (np.maximum(sine, _TINY) * np.sqrt(2.0) * flows.sigma_rad)
    return np.asarray(is_near & ~((towards < _WRONG_WAY_SIGMAS) & is_clear))


def _two_from_one(gate_chi2: float) -> float:
    """Gate of two degrees of freedom with the probability that ``gate_chi2`` has for one."""
    return float(chi2_quantile(chi2_probability(gate_chi2, 1), 2))
