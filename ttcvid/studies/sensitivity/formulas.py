"""Errors of the methods by closed form: first-order propagation of the noise of each picture coordinate."""

from __future__ import annotations

import numpy as np

from ttcvid.model import Floats
from ttcvid.studies.sensitivity.case import Case, Errors, errors_from_covariance


def planar_two_frame(case: Case) -> Errors:
    """Two pictures, the epipole where the flow line meets the horizon y = 0.

    With the point at (x0, y0) and (x1, y1), slope m = (x1 - x0) / (y1 - y0), gap d:

    - epipole ``xe = (x0 y1 - x1 y0) / (y1 - y0)``, variance ``sigma^2 (1 + m^2) (y0^2 + y1^2) / (y1 - y0)^2``;
      the direction's angle atan(xe) has that of xe over (1 + xe^2)^2;
    - ``ttc_z = d y0 / (y1 - y0)``, relative variance ``sigma^2 ((y1 / y0)^2 + 1) / (y1 - y0)^2``;
    - ``tcpa = ttc_z (1 + x1 xe) / (1 + xe^2)``.

    Infinite where the point lies in the horizon's plane or does not approach.
    """
    (x0, y0), (x1, y1) = positions(case, case.times_s(2))
    if y1 == y0 or y0 == 0.0:
        return Errors(np.inf, np.inf, np.inf)
    rise, slope = y1 - y0, (x1 - x0) / (y1 - y0)
    xe = (x0 * y1 - x1 * y0) / rise
    # Gradients by (x0, y0, x1, y1); a point that moves along the line does not change the epipole.
    by_xe = np.array([y1, -slope * y1, -y0, slope * y0]) / rise
    by_log_ttc = np.array([0.0, y1 / (y0 * rise), 0.0, -1.0 / rise])
    factor = 1.0 + x1 * xe
    by_log_tcpa = by_log_ttc + by_xe * (x1 / factor - 2.0 * xe / (1.0 + xe * xe))
    by_log_tcpa[2] += xe / factor
    sigma = case.sigma_norm
    return Errors(
        sigma * float(np.linalg.norm(by_xe)) / (1.0 + xe * xe),
        sigma * float(np.linalg.norm(by_log_ttc)),
        sigma * float(np.linalg.norm(by_log_tcpa)),
    )


def general(case: Case, n_frames: int) -> Errors:
    """Three pictures or more, nothing known of the direction.

    In the variable tau = t / (1 + c t) the picture of the point moves along a straight line at constant speed,
    ``x(t) = x + f tau`` with f = (a - x c, b - y c), and d tau / d c = -tau^2. So (x, f, c) along the flow are the
    coefficients of a parabola in tau, and across it (x, f) those of a line. With M_k the k-th moments of tau about its
    mean, summed, ``var(c) = sigma^2 / (f^2 (M4 - M3^2 / M2 - M2^2 / n))``; for short windows of n pictures d apart that
    is ``180 sigma^2 / (f^2 d^4 n (n^2 - 1) (n^2 - 4))``.

    Infinite without flow.
    """
    x, y, a, b, c = case.state
    t = case.times_s(n_frames)
    tau = t / (1.0 + c * t)
    flow = np.array([a - x * c, b - y * c])
    speed = float(np.linalg.norm(flow))
    if speed == 0.0:
        return Errors(np.inf, np.inf, np.inf)
    along = flow / speed
    across = np.array([-along[1], along[0]])
    parabola = np.linalg.inv(_normal(np.stack([np.ones_like(tau), tau, -speed * tau**2], axis=1)))
    line = np.linalg.inv(_normal(np.stack([np.ones_like(tau), tau], axis=1)))
    # (a, b) = f + c (x, y): from (x, f, c) along and (x, f) across to the state.
    to_state = np.zeros((5, 5))
    to_state[:2, 0], to_state[:2, 3] = along, across
    to_state[2:4] = c * to_state[:2]
    to_state[2:4, 1], to_state[2:4, 4], to_state[2:4, 2] = along, across, (x, y)
    to_state[4, 2] = 1.0
    cov = np.zeros((5, 5))
    cov[:3, :3], cov[3:, 3:] = parabola, line
    return errors_from_covariance(
        np.array([a, b, c]), np.array([x, y, 1.0]), case.sigma_norm**2 * to_state @ cov @ to_state.T
    )


def stereo(case: Case) -> Errors:
    """A stereo pair: depth from the disparity d = B f / Z, velocity from two depths.

    With disparities d0, d1 in the plane z = 1 (each the difference of two coordinates, so of variance 2 sigma^2):
    ``Z = B / d`` with ``sigma_Z = Z^2 sqrt(2) sigma / B``, ``ttc_z = gap d0 / (d1 - d0)`` with the relative variance
    ``2 sigma^2 ((d1 / d0)^2 + 1) / (d1 - d0)^2``; direction and tcpa from V = (P1 - P0) / gap, P = B (x, y, 1) / d.
    """
    views = positions(case, case.times_s(2))
    depths = case.distance_m + case.times_s(2) * case.velocity_m_s[2]
    d0, d1 = case.baseline_m / depths
    by_noise = []
    for (x, y), depth in zip(views, depths, strict=True):
        disparity = case.baseline_m / depth
        ray = np.array([x, y, 1.0])
        # By the coordinates (left x, left y, right x): x moves the ray, and both x the disparity.
        by_left = depth * (np.array([1.0, 0.0, 0.0]) - ray / disparity)
        by_noise.append(np.stack([by_left, depth * np.array([0.0, 1.0, 0.0]), depth * ray / disparity], axis=1))
    by_first, by_last = by_noise
    velocity, place, gap = case.velocity_m_s, case.position_m, case.step_s
    by_velocity = np.concatenate([-by_first, by_last], axis=1) / gap
    by_place = np.concatenate([np.zeros((3, 3)), by_last], axis=1)
    speed2 = float(velocity @ velocity)
    tangent = (np.eye(3) - np.outer(velocity, velocity) / speed2) / np.sqrt(speed2)
    closing = float(place @ velocity)
    sigma = case.sigma_norm
    with np.errstate(divide="ignore", invalid="ignore"):
        by_log_tcpa = np.asarray(place @ by_velocity + velocity @ by_place) / closing
        by_log_tcpa = by_log_tcpa - 2.0 * velocity @ by_velocity / speed2
        ttc_z = sigma * np.sqrt(2.0 * ((d1 / d0) ** 2 + 1.0)) / np.abs(d1 - d0)
    return Errors(
        sigma * float(np.linalg.norm(tangent @ by_velocity)), float(ttc_z), sigma * float(np.linalg.norm(by_log_tcpa))
    )


def stereo_depth_sigma_m(case: Case) -> float:
    """Standard deviation of a stereo depth: ``Z^2 sqrt(2) sigma / (B f)``."""
    return case.distance_m**2 * float(np.sqrt(2.0)) * case.sigma_norm / case.baseline_m


def positions(case: Case, times_s: Floats) -> Floats:
    """Where the point is seen at times ``(L,)``: ``(L, 2)`` in the plane z = 1."""
    points = case.position_m + times_s[:, None] * case.velocity_m_s
    return np.asarray(points[:, :2] / points[:, 2:])


def _normal(design: Floats) -> Floats:
    return np.asarray(design.T @ design)
