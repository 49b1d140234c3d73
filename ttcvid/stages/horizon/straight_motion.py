"""One straight motion, as it counts for a horizon."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.model import Floats, Ints

TRACKS, OUTLINE = "tracks", "outline"
"""What a motion was seen from."""


@dataclass(frozen=True)
class Motion:
    """One straight motion of one mover in one clip.

    ``status``: ``used`` (of the horizon), ``off_horizon``, ``curved``, ``not_rigid`` (the tracks do not move as one),
    ``uncertain`` (the epipole could be anywhere). ``track_id`` are its tracks; ``direction (3,)`` and ``covariance
    (3, 3)`` NaN where there are none; ``turned_rad`` by how much its path bends; ``noise_px``, ``correlation`` as in
    `Translation`; ``looseness`` how many times more its points scatter than those of a rigid body; ``evidence``: the
    points of the mover, or its outline as a whole.
    """

    clip: int
    mover: int
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
