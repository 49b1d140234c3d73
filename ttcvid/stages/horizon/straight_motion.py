"""One straight motion, as it enters a horizon."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.config import HorizonCalibrationConfig
from ttcvid.model import Floats, Ints

TRACKS, OUTLINE = "tracks", "outline"
"""What a motion was seen from."""


@dataclass(frozen=True)
class Motion:
    """One straight motion of one mover in one clip.

    ``status``: ``used`` (for the horizon), ``off_horizon``, ``curved``, ``not_rigid`` (no common motion of the tracks),
    ``uncertain`` (the epipole could be anywhere). ``track_id`` are its tracks; ``direction (3,)`` and ``covariance (3,
    3)`` (rad^2) are NaN where there are none; ``turned_rad`` the turn of its path; ``noise_px``, ``correlation`` as in
    `Translation`; ``looseness`` the scatter of its points over that of a rigid body; ``evidence``: the points of the
    mover, or its outline as a whole; ``clip`` and ``mover`` are numbers of which and whose it is.
    """

    status: str
    track_id: Ints
    first_frame: int
    last_frame: int
    duration_s: float
    direction: Floats
    covariance: Floats
    turned_rad: float = np.nan
    noise_px: float = np.nan
    correlation: float = np.nan
    looseness: float = 1.0
    evidence: str = TRACKS
    clip: int = 0
    mover: int = 0


def certainty(covariance: Floats, config: HorizonCalibrationConfig) -> str:
    """Status of a motion whose direction has this ``covariance (3, 3)`` in rad^2: ``used`` or ``uncertain``."""
    sigma_rad = float(np.sqrt(np.linalg.norm(covariance, 2)))
    return "uncertain" if sigma_rad > np.radians(config.max_sigma_deg) else "used"
