"""The horizon of a driving camera, from the epipoles of its own motion with its rotation removed.

The car moves along the road, so its direction lies on the horizon. Within a window of a few seconds all directions are
rotated into one camera, that of the window's mean tilt: a pitching car takes its horizon along, and the calibrated one
is that about which it pitches. Where the car turns, the directions spread along the horizon and determine its slope; on
a straight road they do not, and the roll is assumed zero within a few degrees.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from ttcvid.config import HorizonCalibrationConfig
from ttcvid.geometry.horizon.line import fit_horizon, pitch_roll_covariance_rad2
from ttcvid.geometry.rotation import normalize, rotation_from_vector, tangent_basis
from ttcvid.model import SCENE_CLUSTER, Camera, Floats, FrameResult
from ttcvid.stages.horizon.at_rest import ROLL_ZERO_SIGMA_RAD, HorizonResult, too_wide, with_verdict
from ttcvid.stages.horizon.straight_motion import Motion
from ttcvid.stages.horizon.whole_tracks import usual_step_s

# Prior standard deviation of the roll of a camera in a car, rad; a drive with turns determines it better.
_ROLL_SIGMA_RAD = np.radians(2.0)
# The roll counts as measured if its standard deviation is below this share of the prior one.
_MEASURED_PART = 0.5
# Rotations are accumulated over this window, s: their errors stay small compared with those of the directions.
_WINDOW_S = 4.0
# Directions are averaged over this window, s, since their errors are correlated from frame to frame, and over at least
# so many frames (half a frame is added against rounding).
_BIN_S = 0.5
_LEAST_FRAMES = 3


@dataclass(frozen=True)
class OwnStep:
    """Egomotion up to one frame: ``cam_R_prev (3, 3)``, and ``direction (3,)`` of the scene with its covariance.

    Direction and ``covariance (3, 3)`` (rad^2) are NaN where the camera did not translate.
    """

    frame: int
    t_s: float
    cam_R_prev: Floats
    direction: Floats
    covariance: Floats


def own_step(result: FrameResult) -> OwnStep | None:
    """Egomotion of a frame's result, None where it has none."""
    if result.rotation_rad is None:
        return None
    scene = next((row for row in result.clusters if row.cluster_id == SCENE_CLUSTER), None)
    direction, covariance = np.full(3, np.nan), np.full((3, 3), np.nan)
    if scene is not None and scene.direction is not None and scene.direction_cov is not None:
        direction, covariance = scene.direction, scene.direction_cov
    return OwnStep(result.frame, result.t_s, rotation_from_vector(result.rotation_rad), direction, covariance)


def own_motions(steps: Iterable[OwnStep | None], clip: int = 0) -> list[Motion]:
    """Directions of own motion over half a second or three frames each, in the camera of their window's mean tilt."""
    motions = [motion for window in _windows(steps) for motion in _motions_of_window(window)]
    return [replace(motion, clip=clip, mover=number) for number, motion in enumerate(motions)]


def driving_horizon(motions: list[Motion], camera: Camera, config: HorizonCalibrationConfig) -> HorizonResult:
    """The line through the directions of own motion; roll zero as far as the drive does not determine it."""
    duration_s = sum(motion.duration_s for motion in motions)
    if duration_s < config.min_drive_s:
        reason = f"own motion is seen for {duration_s:.1f} s only, {config.min_drive_s:g} s needed: take a longer drive"
        return HorizonResult(None, tuple(motions), reason)
    directions = np.array([motion.direction for motion in motions])
    covariances = np.array([motion.covariance for motion in motions])
    floor_rad = np.radians(config.driving_floor_deg)
    roll_sigma_rad = ROLL_ZERO_SIGMA_RAD if config.roll_zero else _ROLL_SIGMA_RAD
    fit = fit_horizon(directions, covariances, floor_rad, roll_sigma_rad)
    if fit is None:
        return HorizonResult(None, tuple(motions), "the directions of own motion lie on no common line")
    # The mean tilt of the car (load, camber, slope of the road) is a common error of the whole drive.
    fit = replace(fit, covariance=fit.covariance + floor_rad**2 * (np.eye(3) - np.outer(fit.normal, fit.normal)))
    labelled = with_verdict(motions, covariances, fit)
    n_agree = int(fit.is_used.sum())
    if 2 * n_agree < len(motions):
        reason = f"only {n_agree} of {len(motions)} directions of own motion agree on a horizon"
    else:
        reason = too_wide(fit, camera, config, "take a longer drive")
    if reason:
        return HorizonResult(None, labelled, reason)
    roll_found_rad = float(np.sqrt(pitch_roll_covariance_rad2(fit)[1, 1]))
    is_assumed = bool(config.roll_zero or roll_found_rad > _MEASURED_PART * _ROLL_SIGMA_RAD)
    if is_assumed:
        level = fit_horizon(directions, covariances, floor_rad, ROLL_ZERO_SIGMA_RAD)
        if level is not None:
            fit = replace(level, covariance=fit.covariance)
    return HorizonResult(fit, labelled, "", is_assumed)


def _windows(steps: Iterable[OwnStep | None]) -> Iterable[list[OwnStep]]:
    """Stretches without a gap, of at most `_WINDOW_S`."""
    window: list[OwnStep] = []
    for step in steps:
        if window and (step is None or step.t_s - window[0].t_s > _WINDOW_S):
            yield window
            window = []
        if step is not None:
            window.append(step)
    if window:
        yield window


def _motions_of_window(window: list[OwnStep]) -> list[Motion]:
    ref_R_cam = [np.eye(3)]
    for step in window[1:]:
        ref_R_cam.append(ref_R_cam[-1] @ step.cam_R_prev.T)
    # n of frame i is ref_R_cam[i]' n_ref; its mean over the window is what the window stands for.
    mean_from_ref = np.mean([rotation.T for rotation in ref_R_cam], axis=0)
    to_mean = np.linalg.inv(mean_from_ref).T
    start_s = window[0].t_s
    bin_s = max(_BIN_S, (_LEAST_FRAMES + 0.5) * usual_step_s([step.t_s for step in window]))
    bins: dict[int, list[int]] = {}
    for place, step in enumerate(window):
        if np.isfinite(step.direction[0]):
            bins.setdefault(int((step.t_s - start_s) / bin_s), []).append(place)
    return [
        _averaged([window[place] for place in places], [to_mean @ ref_R_cam[place] for place in places])
        for places in bins.values()
        if len(places) >= _LEAST_FRAMES
    ]


def _averaged(steps: list[OwnStep], turned: list[Floats]) -> Motion:
    """Median direction of neighbouring frames, with the covariance of a single one plus that of their scatter."""
    directions = normalize(np.array([R @ step.direction for R, step in zip(turned, steps, strict=True)]))
    mean = normalize(np.median(directions, axis=0))
    basis = tangent_basis(mean)
    own = np.median(
        [basis.T @ R @ step.covariance @ R.T @ basis for R, step in zip(turned, steps, strict=True)], axis=0
    )
    scatter = np.cov(directions @ basis, rowvar=False) / len(steps)
    return Motion(
        status="used",
        track_id=np.array([step.frame for step in steps], dtype=np.int64),
        first_frame=steps[0].frame,
        last_frame=steps[-1].frame,
        # Each step is own motion up to its frame: the first one counts as the others do.
        duration_s=(steps[-1].t_s - steps[0].t_s) * len(steps) / (len(steps) - 1),
        direction=mean,
        covariance=basis @ (own + scatter) @ basis.T,
    )
