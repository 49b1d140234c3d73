"""Own motion of a frame, over a gap that grows until the flow is long enough."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ttcvid.config import EgomotionConfig
from ttcvid.geometry.rotation import rotation_from_vector, vector_from_rotation
from ttcvid.model import Bools, Floats
from ttcvid.stages.egomotion import Egomotion, EgomotionMemory, estimate_egomotion
from ttcvid.stages.history import TrackHistory, last_frame_only, with_egomotion, with_noise

# Of more tracks than twice this only a part is used: errors that neighbours share are what limits own motion.
_ENOUGH_TRACKS = 400
# The gap of own motion grows until half of the tracks have this much flow, px, up to so many frames.
_WANTED_FLOW_PX, _LONGEST_GAP = 2.5, 5
_TINY_PX = 1e-6


def find_own_motion(
    history: TrackHistory,
    is_free: Bools,
    memory: EgomotionMemory,
    config: EgomotionConfig,
    least_parallax_px: float,
    sigma_floor_px: float,
) -> tuple[Egomotion | None, TrackHistory, EgomotionMemory]:
    """Rotation from the last frame, and direction of travel over the gap that the flow asks for.

    Rotations of single steps would add up with their errors, which are partly common to all steps: over ten frames
    they bend the flow of everything far away. Where the flow is short, the motion is therefore found between the
    present frame and one so far back that the flow is long enough; the rotation of the last step is what the rotation
    over the gap leaves to those before. The gap stays short all the same: the direction found is the mean over it.

    Parameters
    ----------
    is_free : (N,) tracks that are not frozen to their pixel.
    least_parallax_px : flow of one step that is not taken for translation, however small the noise.

    Returns
    -------
    egomotion : None where there are too few tracks; then the history keeps only the present frame.
    """
    gap = min(memory.gap_frames, len(history.frame) - 1)
    pair = _pair(history, is_free, gap, config.min_tracks)
    if pair is None and gap > 1:
        gap = 1
        pair = _pair(history, is_free, gap, config.min_tracks)
    if pair is None:
        return None, last_frame_only(history), replace(memory, gap_frames=1)
    # cam_R_past does not know the present step yet: it leads into the camera of the last frame.
    last_R_past = history.cam_R_past[-1 - gap]
    expected = last_R_past
    if memory.step_rotation_rad is not None:
        expected = rotation_from_vector(memory.step_rotation_rad) @ last_R_past
    start = replace(memory, rotation_rad=None if memory.rotation_rad is None else vector_from_rotation(expected))
    over_gap, memory = estimate_egomotion(
        *pair, np.sqrt(gap) * least_parallax_px / history.focal_px, start, config.platform
    )
    # By way of the rotation vector: a product that goes on for ever would cease to be a rotation, faster each frame.
    cam_R_prev = rotation_from_vector(vector_from_rotation(over_gap.cam_R_prev @ last_R_past.T))
    egomotion = replace(over_gap, cam_R_prev=cam_R_prev)
    history = with_egomotion(history, cam_R_prev, over_gap.direction, over_gap.rotation_sigma_rad)
    history = with_noise(history, over_gap.residual_spread, sigma_floor_px)
    memory = replace(
        memory,
        step_rotation_rad=egomotion.rotation_rad,
        gap_frames=_gap_for(history, is_free),
    )
    return egomotion, history, memory


def _pair(history: TrackHistory, is_free: Bools, gap: int, min_tracks: int) -> tuple[Floats, Floats, Floats] | None:
    """Rays ``gap`` frames ago and now, each in its own camera, and their noise; None with too few tracks."""
    if not 0 < gap < len(history.frame):
        return None
    seen = np.flatnonzero(is_free & np.isfinite(history.rays[-1 - gap, :, 0]) & np.isfinite(history.rays[-1, :, 0]))
    if len(seen) < min_tracks:
        return None
    seen = seen[:: max(1, len(seen) // _ENOUGH_TRACKS)]
    return history.rays[-1 - gap, seen], history.rays[-1, seen], history.sigma_rad[seen]


def _gap_for(history: TrackHistory, is_free: Bools) -> int:
    """Frames after which the median derotated flow has the wanted length, by the flow of the last step."""
    flow_px = np.linalg.norm(history.rays[-1] - history.derotated(-2), axis=1)[is_free] * history.focal_px
    flow_px = flow_px[np.isfinite(flow_px)]
    if not len(flow_px):
        return 1
    return int(np.clip(np.ceil(_WANTED_FLOW_PX / max(float(np.median(flow_px)), _TINY_PX)), 1, _LONGEST_GAP))
