"""Errors that no unbiased method can fall below: the Cramer-Rao bound, from the Fisher information of all pictures."""

from __future__ import annotations

import numpy as np

from ttcvid.model import Floats
from ttcvid.studies.sensitivity.case import Case, Errors, errors_from_covariance

_SINGULAR = 1e-12


def bound(case: Case, n_frames: int, is_planar: bool) -> Errors:
    """The bound for one camera: the state (x, y, a, b, c), with ``is_planar`` without b, which is known to be zero.

    The Jacobian is that of x(t) = (x + a t) / (1 + c t), y(t) = (y + b t) / (1 + c t).
    """
    x, y, a, b, c = case.state
    t = case.times_s(n_frames)
    depth = 1.0 + c * t
    zero = np.zeros_like(t)
    by_x = np.stack([1.0 / depth, zero, t / depth, zero, -t * (x + a * t) / depth**2], axis=1)
    by_y = np.stack([zero, 1.0 / depth, zero, t / depth, -t * (y + b * t) / depth**2], axis=1)
    known = [0, 1, 2, 4] if is_planar else [0, 1, 2, 3, 4]
    cov = np.zeros((5, 5))
    inverse = _inverse((by_x.T @ by_x + by_y.T @ by_y)[np.ix_(known, known)])
    if inverse is None:
        return Errors(np.inf, np.inf, np.inf)
    cov[np.ix_(known, known)] = case.sigma_norm**2 * inverse
    return errors_from_covariance(np.array([a, b, c]), np.array([x, y, 1.0]), cov)


def stereo_bound(case: Case) -> Errors:
    """The bound for two pairs of pictures: P and V in units of the present depth, by left x, left y and right x."""
    state = np.concatenate([case.position_m, case.velocity_m_s])
    rows = []
    for t in case.times_s(2):
        point = state[:3] + t * state[3:]
        left = np.array([[1.0, 0.0, -point[0] / point[2]], [0.0, 1.0, -point[1] / point[2]]]) / point[2]
        right = np.array([[1.0, 0.0, -(point[0] - case.baseline_m) / point[2]]]) / point[2]
        by_point = np.concatenate([left, right])
        rows.append(np.concatenate([by_point, t * by_point], axis=1))
    jacobian = np.concatenate(rows)
    inverse = _inverse(jacobian.T @ jacobian)
    if inverse is None:
        return Errors(np.inf, np.inf, np.inf)
    # (x, y, a, b, c) = (X, Y, V) / Z: the direction, ttc_z and tcpa are functions of these alone.
    z = state[2]
    to_state = np.zeros((5, 6))
    to_state[0, 0] = to_state[1, 1] = to_state[2, 3] = to_state[3, 4] = to_state[4, 5] = 1.0 / z
    to_state[:, 2] = -np.array([state[0], state[1], *state[3:]]) / z**2
    cov = case.sigma_norm**2 * to_state @ inverse @ to_state.T
    return errors_from_covariance(state[3:] / z, np.array([state[0] / z, state[1] / z, 1.0]), cov)


def _inverse(information: Floats) -> Floats | None:
    """The inverse; None where something is not observed at all. Scaled first: its units differ by powers of ten."""
    scale = np.sqrt(np.diag(information))
    if not (scale > 0.0).all():
        return None
    scaled = information / np.outer(scale, scale)
    if np.linalg.eigvalsh(scaled)[0] < _SINGULAR:
        return None
    return np.asarray(np.linalg.inv(scaled) / np.outer(scale, scale))
