"""The horizon of a resting camera from the motions of all its clips, or why it is undetermined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtrit

from ttcvid.config import HorizonCalibrationConfig
from ttcvid.geometry.horizon.line import HorizonFit, band_px, fit_horizon, is_one_direction, widest_angle_rad
from ttcvid.model import Camera, Floats
from ttcvid.stages.horizon.straight_motion import TRACKS, Motion

# Standard deviation of a roll assumed zero, rad: that of a spirit level.
ROLL_ZERO_SIGMA_RAD = 1e-4
# Part of a distribution below the upper border of its 95 % interval.
_UPPER_95 = 0.975


@dataclass(frozen=True)
class HorizonResult:
    """A horizon with the motions behind it; ``fit`` is None where undetermined, and ``reason`` says why.

    ``roll_zero``: roll was assumed zero, not measured; ``notes`` are warnings for the user.
    """

    fit: HorizonFit | None
    motions: tuple[Motion, ...]
    reason: str = ""
    roll_zero: bool = False
    notes: tuple[str, ...] = ()


def calibrated_horizon(
    motions: list[Motion], camera: Camera, config: HorizonCalibrationConfig, *, from_pictures: bool = False
) -> HorizonResult:
    """The line through the epipoles of straight motions.

    Undetermined with too few motions, with motions in one direction, and where the band is too wide to be of use. With
    ``config.roll_zero`` the line is level and one direction is enough.

    Where tracks come ``from_pictures`` all tracks of a mover have common errors (what their windows hold changes as it
    turns, approaches, is occluded), which no scatter between them shows. Their epipoles get larger standard deviations,
    and the pieces of one mover count as one. How much larger is known roughly only, so the band is that of Student's
    distribution with as many degrees of freedom as there are motions.

    """
    roll_zero = config.roll_zero
    usable = [motion for motion in motions if motion.status == "used"]
    refused = tuple(motions)
    floor_rad = np.radians(config.floor_deg)
    least = 1 if roll_zero else config.min_motions
    n_usable = _count(usable)
    if n_usable < least:
        found = f"{n_usable} straight motion{'s' * (n_usable != 1)} found of {_count(motions)}"
        return HorizonResult(None, refused, f"{found}, at least {least} needed: take a longer clip, or several")
    directions = np.array([motion.direction for motion in usable])
    covariances = formal = np.array([motion.covariance for motion in usable])
    if not roll_zero:
        reason = _too_alike(directions, covariances, config)
        if reason:
            return HorizonResult(None, refused, reason)
    if from_pictures:
        covariances = covariances * _picture_factors(usable, config)[:, None, None]
        floor_rad = max(floor_rad, float(np.radians(config.picture_floor_deg)))
    fit = fit_horizon(directions, covariances, floor_rad, ROLL_ZERO_SIGMA_RAD if roll_zero else None)
    if fit is None:
        return HorizonResult(None, refused, "the epipoles lie on no common line")
    if from_pictures:
        fit = replace(fit, quantile=float(stdtrit(fit.is_used.sum(), _UPPER_95)))
    judged = with_verdict([replace(one, covariance=cov) for one, cov in zip(usable, covariances, strict=True)], fit)
    remaining = iter(judged)
    labelled = tuple(next(remaining) if motion.status == "used" else motion for motion in motions)
    agreeing = [motion for motion in judged if motion.status == "used"]
    reason = _disagreement(_count(agreeing), n_usable, least)
    if not reason and not roll_zero:
        reason = _too_alike(directions[fit.is_used], formal[fit.is_used], config)
    reason = reason or too_wide(fit, camera, config, "take a longer clip")
    notes = ("roll taken as zero",) if roll_zero else ()
    return HorizonResult(None if reason else fit, labelled, reason, roll_zero, notes)


def _count(motions: Sequence[Motion]) -> int:
    """Number of motions: those of points, and of outlines where a mover's points tell none."""
    by_tracks = {(motion.clip, motion.mover) for motion in motions if motion.evidence == TRACKS}
    return sum(motion.evidence == TRACKS or (motion.clip, motion.mover) not in by_tracks for motion in motions)


def _picture_factors(motions: list[Motion], config: HorizonCalibrationConfig) -> Floats:
    """How many times the variances ``(K,)`` of epipoles from pictures are larger than their own scatter says.

    Points of a body that is not quite rigid (people: their limbs, their clothes) err together, and the more the more
    they scatter.
    """
    who = [(motion.clip, motion.mover, motion.evidence == TRACKS) for motion in motions]
    _, same, count = np.unique(who, axis=0, return_inverse=True, return_counts=True)
    of_tracks = config.picture_sigma_factor * np.array([motion.looseness for motion in motions])
    is_tracks = np.array([motion.evidence == TRACKS for motion in motions])
    return np.asarray(np.where(is_tracks, of_tracks, config.outline_sigma_factor) ** 2 * count[same.ravel()])


def with_verdict(motions: list[Motion], fit: HorizonFit) -> tuple[Motion, ...]:
    """Motions with their status after the fit of all of them."""
    status = np.where(fit.is_used, "used", "off_horizon").tolist()
    return tuple(replace(motion, status=said) for motion, said in zip(motions, status, strict=True))


def _too_alike(directions: np.ndarray, covariances: np.ndarray, config: HorizonCalibrationConfig) -> str:
    remedy = "film objects that cross or turn off, too, or give --roll-zero if the camera has no roll"
    if is_one_direction(directions, covariances, np.radians(config.floor_deg), config.one_direction_probability):
        return f"all {len(directions)} motions run in one direction: {remedy}"
    widest_deg = float(np.degrees(widest_angle_rad(directions, covariances)))
    if widest_deg < config.min_spread_deg:
        return (
            f"directions certainly differ by {widest_deg:.1f} deg only, {config.min_spread_deg:g} deg needed: {remedy}"
        )
    return ""


def _disagreement(n_used: int, n_all: int, least: int) -> str:
    """Why too few of the motions agree on a line, empty if enough do."""
    if n_used < least:
        return f"only {n_used} of {n_all} motions agree on a horizon"
    if 2 * n_used < n_all:
        return f"only {n_used} of {n_all} motions agree on a horizon: do they move on one level ground?"
    return ""


def too_wide(fit: HorizonFit, camera: Camera, config: HorizonCalibrationConfig, remedy: str) -> str:
    """Why the band of a fitted line is too wide to be of use, with the ``remedy``; empty if it is not."""
    _, half_px = band_px(camera, fit, np.array([(camera.image_size.width_px - 1) / 2]))
    most_px = config.max_band_part * camera.image_size.height_px
    if half_px[0] <= most_px:
        return ""
    return f"the 95 % band is +-{half_px[0]:.0f} px at the centre, more than {most_px:.0f} px: {remedy}"
