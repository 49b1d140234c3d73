"""Errors of the methods by Monte-Carlo: the functions that the analysis itself uses, on noisy pictures of one point."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ttcvid.geometry.estimation.track_state import fit_whole_tracks
from ttcvid.geometry.paper.collision import times_from_position_velocity, times_from_state
from ttcvid.geometry.paper.planar import planar_epipole
from ttcvid.geometry.paper.three_frames import three_frame_direction
from ttcvid.geometry.paper.two_view_state import state_from_direction
from ttcvid.geometry.rotation import normalize
from ttcvid.model import Floats
from ttcvid.studies.sensitivity.case import Case, Errors
from ttcvid.studies.sensitivity.formulas import positions

ONE_SIGMA = 0.6826894921370859
"""Share of a normal distribution within one standard deviation."""
_HORIZON_NORMAL = np.array([0.0, 1.0, 0.0])

Trials = tuple[Floats, Floats, Floats]
"""Of N trials: directions ``(N, 3)``, ttc_z ``(N,)`` and tcpa ``(N,)`` in s; NaN where a method has no answer."""


def planar_two_frame(case: Case, n_trials: int, rng: np.random.Generator) -> Trials:
    """The epipole on the horizon, and the state that belongs to it."""
    q, p = _noisy_rays(case, 2, n_trials, rng)
    sigma = np.full(n_trials, case.sigma_norm)
    direction, _, _ = planar_epipole(normalize(q), normalize(p), _HORIZON_NORMAL, sigma, np.zeros((3, 3)))
    return _with_times(q, p, direction, case.step_s, sigma)


def three_frame(case: Case, n_trials: int, rng: np.random.Generator) -> Trials:
    """The direction from three pictures, and the state that belongs to it."""
    rays = _noisy_rays(case, 3, n_trials, rng)
    sigma = np.full(n_trials, case.sigma_norm)
    direction, _, _ = three_frame_direction(rays, case.step_s, case.step_s, sigma)
    return _with_times(rays[0], rays[2], direction, 2.0 * case.step_s, sigma)


def whole_track(n_frames: int) -> Callable[[Case, int, np.random.Generator], Trials]:
    """Maximum likelihood of the last ``n_frames`` pictures."""

    def trials(case: Case, n_trials: int, rng: np.random.Generator) -> Trials:
        rays = _noisy_rays(case, n_frames, n_trials, rng)
        fit = fit_whole_tracks(rays[..., :2], case.times_s(n_frames), np.full(n_trials, case.sigma_norm))
        times = times_from_state(fit.state)
        return normalize(fit.state[:, 2:]), times.ttc_z_s, times.tcpa_s

    return trials


def stereo(case: Case, n_trials: int, rng: np.random.Generator) -> Trials:
    """Two depths, each from the disparity between a left and a right picture."""
    left = _noisy_rays(case, 2, n_trials, rng)
    depths = case.distance_m + case.times_s(2) * case.velocity_m_s[2]
    true_disparity = case.baseline_m / depths
    right_x = positions(case, case.times_s(2))[:, :1] - true_disparity[:, None]
    right_x = right_x + case.sigma_norm * rng.standard_normal((2, n_trials))
    points = left * (case.baseline_m / (left[..., 0] - right_x))[..., None]
    velocity = (points[1] - points[0]) / case.step_s
    times = times_from_position_velocity(points[1], velocity)
    return normalize(velocity), times.ttc_z_s, times.tcpa_s


def errors_of(case: Case, trials: Trials) -> Errors:
    """What 68 % of the trials stay within, which for normal errors is one standard deviation; no answer is no limit.

    Directions in the plane of ray and motion and across it apart, then together; times by their inverse, which is
    near-normal where a time itself is not, relative to it.
    """
    direction, ttc_z, tcpa = trials
    true = normalize(case.velocity_m_s[None])[0]
    normal = normalize(np.cross(case.position_m, case.velocity_m_s)[None])[0]
    if not np.isfinite(normal).all():
        normal = np.array([0.0, 1.0, 0.0])
    in_plane = np.arctan2(direction @ np.cross(normal, true), direction @ true)
    across = np.arcsin(np.clip(direction @ normal, -1.0, 1.0))
    truth = times_from_position_velocity(case.position_m[None], case.velocity_m_s[None])
    return Errors(
        float(np.hypot(_one_sigma(in_plane), _one_sigma(across))),
        _one_sigma(truth.ttc_z_s / ttc_z - 1.0),
        _one_sigma(truth.tcpa_s / tcpa - 1.0),
    )


def _one_sigma(errors: Floats) -> float:
    size = np.abs(errors)
    return float(np.quantile(np.where(np.isfinite(size), size, np.inf), ONE_SIGMA, method="higher"))


def _noisy_rays(case: Case, n_frames: int, n_trials: int, rng: np.random.Generator) -> Floats:
    """Rays ``(L, N, 3)`` of the point in the last pictures, oldest first, with z = 1."""
    xy = positions(case, case.times_s(n_frames))[:, None, :]
    noisy = xy + case.sigma_norm * rng.standard_normal((n_frames, n_trials, 2))
    return np.concatenate([noisy, np.ones((n_frames, n_trials, 1))], axis=2)


def _with_times(q: Floats, p: Floats, direction: Floats, gap_s: float, sigma_norm: Floats) -> Trials:
    state, _, _ = state_from_direction(q, p, direction, gap_s, sigma_norm)
    times = times_from_state(state)
    return direction, times.ttc_z_s, times.tcpa_s
