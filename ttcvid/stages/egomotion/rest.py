"""Whether the camera rests: then most cells of the picture stay in place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.model import Bools, Floats, ImageSize, PointSet
from ttcvid.stages.tracking.groups import in_common

# Parts of the picture along its longer side.
_PARTS = 16
# A point stays within this over the time between two looks, px; a mast sways by less.
_STAYS_PX = 1.0
# The camera of a clip rests when it does so in this share of all looks.
_RESTING_LOOKS = 0.9
_LEAST_POINTS = 8

RESTING_SHARE = 0.5
"""With more than this share of the parts in their place the camera rests: traffic may fill the others."""


@dataclass(frozen=True)
class Look:
    """Two frames compared: time of the later one, and the share of the picture's cells that stayed in place."""

    t_s: float
    still_share: float


def compare_looks(before: PointSet, now: PointSet, t_s: float, size: ImageSize) -> Look | None:
    """Compare the points of two frames, the later one at ``t_s``; None with too few points in common.

    Each cell of the picture has one vote, by the majority of its points, so that one lorry full of texture does not
    outvote the street.
    """
    before_px, now_px = in_common(before, now)
    if len(now_px) < _LEAST_POINTS:
        return None
    return Look(t_s, share_of_parts(now_px, np.linalg.norm(now_px - before_px, axis=1) < _STAYS_PX, size))


def share_of_parts(xy_px: Floats, stays: Bools, size: ImageSize) -> float:
    """Share of the cells of a picture in which most points ``xy_px (N, 2)`` stay: ``stays (N,)``."""
    side_px = size.longer_side_px / _PARTS
    cell = np.clip((xy_px / side_px).astype(np.int64), 0, _PARTS - 1)
    _, part = np.unique(cell[:, 1] * _PARTS + cell[:, 0], return_inverse=True)
    return float(np.mean(np.bincount(part, stays) > 0.5 * np.bincount(part)))


def complaint_about_motion(looks: list[Look]) -> str:
    """Why the camera does not rest, as a sentence; empty where it does."""
    if not looks:
        return "too few points to see whether the camera rests: take a clip with more texture"
    moving_s = [look.t_s for look in looks if look.still_share <= RESTING_SHARE]
    if len(moving_s) <= (1.0 - _RESTING_LOOKS) * len(looks):
        return ""
    part = 100.0 * len(moving_s) / len(looks)
    return (
        f"the camera does not rest: most of the picture moves in {part:.0f} % of the clip, between {moving_s[0]:.2f} s "
        f"and {moving_s[-1]:.2f} s: give --moving for a driving camera, or --start and --end of a part at rest"
    )
