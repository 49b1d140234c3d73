"""Whether the calibrated horizon still fits: offsets of epipoles should scatter about zero and not drift."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import astuple, dataclass, field

import numpy as np

from ttcvid.config import HorizonCalibrationConfig
from ttcvid.geometry.medians import MEDIAN_NORMAL
from ttcvid.model import SCENE_CLUSTER, Floats, FrameResult, HorizonOffset

# Number of parts of the clip that a drift is estimated from, and least number of frames with an offset in each: an
# error of own motion for a second (a bus before the camera) is no drift.
_PARTS, _LEAST_FRAMES = 4, 25
# Correlation length of the errors of epipoles, frames.
_FRAMES_TOGETHER = 10
# Significance of an offset or a drift, standard deviations.
_SURE_SIGMAS = 4.0
# Least number of frames of a mover that counts.
_LEAST_MOVER_FRAMES = 10
# Least standard deviation of an epipole of one frame, rad.
_LEAST_SIGMA_RAD = 1e-4

_REMEDY = "the calibration no longer fits, calibrate the horizon again"


def own_offset_px(result: FrameResult) -> float | None:
    """Offset of the epipole of own motion from the horizon, px; None where we do not move."""
    return next((row.horizon_offset_px for row in result.clusters if row.cluster_id == SCENE_CLUSTER), None)


def complaint_about_own_epipoles(offset_px: Floats, tolerance_px: float) -> str:
    """Why own epipoles of a clip do not fit the calibration, as a sentence; empty where they do.

    ``offset_px (N,)`` of the frames in order, positive below the horizon; offsets within ``tolerance_px`` are explained
    by the calibration's own error.
    """
    parts = np.array_split(offset_px, _PARTS)
    if len(parts[-1]) < _LEAST_FRAMES:
        return ""
    middle = np.array([np.median(part) for part in parts])
    spread = np.array([np.median(np.abs(part - np.median(part))) for part in parts]) / MEDIAN_NORMAL
    error = spread / np.sqrt([max(1.0, len(part) / _FRAMES_TOGETHER) for part in parts])
    drift_px = float(middle[-1] - middle[0])
    is_steady = bool((np.diff(middle) > 0).all() or (np.diff(middle) < 0).all())
    if is_steady and abs(drift_px) > tolerance_px + _SURE_SIGMAS * float(np.hypot(error[0], error[-1])):
        return f"epipoles drift by {drift_px:+.0f} px across the horizon over the clip: {_REMEDY}"
    overall_px = float(np.median(offset_px))
    is_one_sided = bool((middle > 0).all() or (middle < 0).all())
    if is_one_sided and abs(overall_px) > tolerance_px + _SURE_SIGMAS * float(np.sqrt(np.mean(error**2) / _PARTS)):
        side = "below" if overall_px > 0 else "above"
        return f"epipoles lie {abs(overall_px):.0f} px {side} the horizon: {_REMEDY}"
    return ""


@dataclass
class MoverOffset:
    """Offsets of a mover from the horizon over its frames, weighted by their errors."""

    n_frames: int = 0
    weight: float = 0.0
    weighted: Floats = field(default_factory=lambda: np.zeros(3))

    def add(self, offset: HorizonOffset) -> None:
        """Add one frame."""
        weight = 1.0 / max(offset.sigma_rad, _LEAST_SIGMA_RAD) ** 2
        self.n_frames += 1
        self.weight += weight
        self.weighted += weight * np.array(astuple(offset))

    @property
    def mean(self) -> Floats:
        """The mover's `HorizonOffset`; its error is that of one frame, since its frames have common errors."""
        return self.weighted / self.weight


def complaint_about_movers(
    movers: Collection[MoverOffset], horizon_sigma_rad: float, tolerance_rad: float, config: HorizonCalibrationConfig
) -> str:
    """Why the epipoles of movers do not fit the calibration, as a sentence; empty where they do.

    The errors are those of a calibration: the tracks of a mover have common errors all its life (limbs, clothes, a
    gait), so that each mover has one vote, whatever its number of frames, with a larger error than its tracks say.
    Scatter between movers beyond that may be common too (pedestrians: on tud_stadtmitte all of 18 lie below the true
    horizon, by 0.4 to 9 deg): their mean is then no better than one of them. Besides ``horizon_sigma_rad``, the error
    of the calibration, offsets within ``tolerance_rad`` are those that no calibration is better than.
    """
    seen = [mover for mover in movers if mover.n_frames >= _LEAST_MOVER_FRAMES]
    if len(seen) < config.min_motions:
        return ""
    below, own_sigma, ahead = np.array([mover.mean for mover in seen]).T
    variance = (config.picture_sigma_factor * own_sigma) ** 2 + np.radians(config.picture_floor_deg) ** 2
    information = float(np.sum(ahead**2 / variance))
    pitch_rad = float(np.sum(ahead * below / variance)) / information
    disagreement = float(np.sum((below - ahead * pitch_rad) ** 2 / variance)) / (len(seen) - 1)
    unsaid = len(seen) * max(0.0, disagreement - 1.0)
    error_rad = float(np.hypot(np.sqrt((1.0 + unsaid) / information), horizon_sigma_rad))
    if abs(pitch_rad) <= tolerance_rad + _SURE_SIGMAS * error_rad:
        return ""
    side = "below" if pitch_rad > 0 else "above"
    return (
        f"the epipoles of {len(seen)} movers lie {np.degrees(abs(pitch_rad)):.1f} +- {np.degrees(error_rad):.1f} deg "
        f"{side} the horizon: {_REMEDY}"
    )
