"""The horizon of a resting camera from the motions of all its clips, or why it is undetermined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtrit

from ttcvid.config import HorizonCalibrationConfig
from ttcvid.geometry.horizon.line import UPPER_95, HorizonFit, band_px, fit_horizon, is_one_direction, widest_angle_rad
from ttcvid.model import Camera, Floats
from ttcvid.stages.horizon.straight_motion import TRACKS, Motion

# Standard deviation of a roll assumed zero, rad: that of a spirit level.
ROLL_ZERO_SIGMA_RAD = 1e-4


@dataclass(frozen=True)
class HorizonResult:
    """A horizon with the motions behind it; ``fit`` is None where undetermined, and ``reason`` says why.

    ``roll_zero``: roll was assumed zero, not measured.
    """

    fit: HorizonFit | None
    motions: tuple[Motion, ...]
    reason: str = ""
    roll_zero: bool = False

    @property
    def notes(self) -> tuple[str, ...]:
        """What a user has to know before trusting it."""
        return ("roll taken as zero",) if self.roll_zero else ()


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
    floor_rad = np.radians(config.floor_deg)
    least = 1 if roll_zero else config.min_motions
    n_usable = _count(usable)
    if n_usable < least:
        found = f"{n_usable} straight motion{'s' * (n_usable != 1)} found of {_count(motions)}"
        return HorizonResult(None, tuple(motions), f"{found}, at least {least} needed: take a longer clip, or several")
    directions = np.array([motion.direction for motion in usable])
    covariances = formal = np.array([motion.covariance for motion in usable])
    reason = "" if roll_zero else _too_alike(directions, covariances, config)
    if reason:
        return HorizonResult(None, tuple(motions), reason)
    if from_pictures:
        covariances = covariances * _picture_factors(usable, config)[:, None, None]
        floor_rad = max(floor_rad, float(np.radians(config.picture_floor_deg)))
    fit = fit_horizon(directions, covariances, floor_rad, ROLL_ZERO_SIGMA_RAD if roll_zero else None)
    if fit is None:
        return HorizonResult(None, tuple(motions), "the epipoles lie on no common line")
    if from_pictures:
        fit = replace(fit, quantile=float(stdtrit(fit.is_used.sum(), UPPER_95)))
    labelled = with_verdict(motions, covariances, fit)
    n_agree = _count([motion for motion in labelled if motion.status == "used"])
    if n_agree < least or 2 * n_agree < n_usable:
        reason = f"only {n_agree} of {n_usable} motions agree on a horizon: do they move on one level ground?"
    elif not roll_zero:
        reason = _too_alike(directions[fit.is_used], formal[fit.is_used], config)
    reason = reason or too_wide(fit, camera, config, "take a longer clip")
    return HorizonResult(None if reason else fit, labelled, reason, roll_zero)


def _count(motions: Sequence[Motion]) -> int:
    """Number of motions: those of points, and of outlines where a mover's points tell none."""
    by_tracks = {(motion.clip, motion.mover) for motion in motions if motion.evidence == TRACKS}
    return sum(motion.evidence == TRACKS or (motion.clip, motion.mover) not in by_tracks for motion in motions)


def _picture_factors(motions: list[Motion], config: HorizonCalibrationConfig) -> Floats:
    """How many times the variances ``(K,)`` of epipoles from pictures are larger than their own scatter says.

    Points of a body that is not quite rigid (people: limbs, clothes) err together, and the more the more they scatter.
    """
    who = [(motion.clip, motion.mover, motion.evidence == TRACKS) for motion in motions]
    _, same, count = np.unique(who, axis=0, return_inverse=True, return_counts=True)
    of_tracks = config.picture_sigma_factor * np.array([motion.looseness for motion in motions])
    is_tracks = np.array([motion.evidence == TRACKS for motion in motions])
    return np.asarray(np.where(is_tracks, of_tracks, config.outline_sigma_factor) ** 2 * count[same.ravel()])


def with_verdict(motions: list[Motion], covariances: Floats, fit: HorizonFit) -> tuple[Motion, ...]:
    """Motions with their status after the fit of the ``used`` ones, and the covariances that these had there."""
    fitted = zip(fit.is_used, covariances, strict=True)

    def judged(motion: Motion) -> Motion:
        agrees, covariance = next(fitted)
        return replace(motion, status="used" if agrees else "off_horizon", covariance=covariance)

    return tuple(judged(motion) if motion.status == "used" else motion for motion in motions)


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


def too_wide(fit: HorizonFit, camera: Camera, config: HorizonCalibrationConfig, remedy: str) -> str:
    """Why the band of a fitted line is too wide to be of use, with the ``remedy``; empty if it is not."""
    _, half_px = band_px(camera, fit, np.array([(camera.image_size.width_px - 1) / 2]))
    most_px = config.max_band_part * camera.image_size.height_px
    if half_px[0] <= most_px:
        return ""
    return f"the 95 % band is +-{half_px[0]:.0f} px at the centre, more than {most_px:.0f} px: {remedy}"
