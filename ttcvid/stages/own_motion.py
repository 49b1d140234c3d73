"""Own motion of a frame: from the last picture, and again over a longer gap where the flow is short."""

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


def find_own_motion(
    history: TrackHistory,
    is_free: Bools,
    memory: EgomotionMemory,
    config: EgomotionConfig,
    least_parallax_px: float,
    max_gap_frames: int,
    target_flow_px: float,
    sigma_floor_px: float,
) -> tuple[Egomotion | None, TrackHistory, EgomotionMemory]:
    """Rotation from the last frame, and direction of travel over the gap that the flow asks for.

    The rotations of single steps add up with their errors, which are partly common to all steps: over ten frames
    they bend the flow of everything far away. Where the flow is short, the motion is therefore found once more
    between the present frame and one so far back that the flow has ``target_flow_px``; its rotation corrects the sum,
    its direction replaces that of the step.

    Parameters
    ----------
    is_free : (N,) tracks that are not frozen to their pixel.
    least_parallax_px : flow of one step that is not taken for translation, however small the noise.

    Returns
    -------
    egomotion : None where there are too few tracks; then the history keeps only the present frame.
    """
    step = _pair(history, is_free, 1, config.min_tracks)
    if step is None:
        return None, last_frame_only(history), memory
    parallax_rad = least_parallax_px / history.focal_px
    egomotion, memory = estimate_egomotion(*step, parallax_rad, memory, config.platform)
    history = with_egomotion(history, egomotion.cam_R_prev, egomotion.direction, egomotion.rotation_sigma_rad)
    history = with_noise(history, egomotion.residual_spread, sigma_floor_px)
    gap = _gap_for(history, is_free, max_gap_frames, target_flow_px)
    long_step = _pair(history, is_free, gap, config.min_tracks) if gap > 1 else None
    if long_step is None:
        return egomotion, history, memory
    summed = history.cam_R_past[-1 - gap]
    start = EgomotionMemory(vector_from_rotation(summed), memory.direction)
    over_gap, _ = estimate_egomotion(*long_step, np.sqrt(gap) * parallax_rad, start, config.platform)
    history = _corrected(history, over_gap, gap)
    egomotion = replace(egomotion, direction=over_gap.direction, direction_cov=over_gap.direction_cov)
    direction = memory.direction if over_gap.direction is None else over_gap.direction
    return egomotion, history, replace(memory, direction=direction)


def _pair(history: TrackHistory, is_free: Bools, gap: int, min_tracks: int) -> tuple[Floats, Floats, Floats] | None:
    """Rays ``gap`` frames ago and now, each in its own camera, and their noise; None with too few tracks."""
    if len(history.frame) <= gap:
        return None
    seen = np.flatnonzero(is_free & np.isfinite(history.rays[-1 - gap, :, 0]) & np.isfinite(history.rays[-1, :, 0]))
    if len(seen) < min_tracks:
        return None
    seen = seen[:: max(1, len(seen) // _ENOUGH_TRACKS)]
    return history.rays[-1 - gap, seen], history.rays[-1, seen], history.sigma_rad[seen]


def _gap_for(history: TrackHistory, is_free: Bools, max_gap_frames: int, target_flow_px: float) -> int:
    """Frames after which the median derotated flow has the wanted length, by the flow of the last step."""
    flow_px = np.linalg.norm(history.rays[-1] - history.derotated(-2), axis=1)[is_free] * history.focal_px
    flow_px = flow_px[np.isfinite(flow_px)]
    longest = min(max_gap_frames, len(history.frame) - 1)
    if not len(flow_px):
        return 1
    return int(np.clip(np.ceil(target_flow_px / max(float(np.median(flow_px)), 1e-6)), 1, longest))


def _corrected(history: TrackHistory, over_gap: Egomotion, gap: int) -> TrackHistory:
    """Past rotations with the error of their sum taken out evenly, and the direction of the last step replaced."""
    error_rad = vector_from_rotation(over_gap.cam_R_prev @ history.cam_R_past[-1 - gap].T)
    steps = np.arange(len(history.frame) - 1, -1, -1)
    correction = rotation_from_vector(error_rad * (steps / gap)[:, None])
    scene_direction = history.scene_direction.copy()
    scene_direction[-1] = np.nan if over_gap.direction is None else over_gap.direction
    return replace(history, cam_R_past=correction @ history.cam_R_past, scene_direction=scene_direction)
