"""Own motion of a frame, over a gap that grows until the flow is long enough."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ttcvid.config import EgomotionConfig
from ttcvid.geometry.compiled import compiled
from ttcvid.geometry.medians import median
from ttcvid.geometry.rotation import rotation_from_vector, vector_from_rotation
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.egomotion import Egomotion, EgomotionMemory, estimate_egomotion, picture_region, region_side_of
from ttcvid.stages.history import TrackHistory, last_frame_only, with_egomotion
from ttcvid.stages.scene_path import with_scene_path
from ttcvid.stages.track_noise import with_noise

# In each part of the picture (`picture_region`) only so many tracks are used: errors that neighbours share are what
# limits own motion.
_MOST_IN_CELL = 6
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
    """Rotation from the last frame, and direction of travel as the whole tracks of the scene show it.

    Parameters
    ----------
    is_free : (N,) tracks that are not frozen to their pixel.
    least_parallax_px : flow of one step that is not taken for translation, however small the noise.

    Returns
    -------
    egomotion : None where there are too few tracks; then the history keeps only the present frame.
    """
    egomotion, history, memory = _from_two_views(history, is_free, memory, config, least_parallax_px, sigma_floor_px)
    if egomotion is None:
        return None, history, memory
    history = with_scene_path(history, is_free, egomotion)
    direction = memory.direction if egomotion.direction is None else egomotion.direction
    return egomotion, history, replace(memory, direction=direction)


def _from_two_views(
    history: TrackHistory,
    is_free: Bools,
    memory: EgomotionMemory,
    config: EgomotionConfig,
    least_parallax_px: float,
    sigma_floor_px: float,
) -> tuple[Egomotion | None, TrackHistory, EgomotionMemory]:
    """Rotation from the last frame, and direction of travel over the gap that the flow asks for.

    Rotations of single steps would add up with their errors, which are partly common to all steps: over ten frames
    they bend the flow of everything far away. Where the flow is short, the motion is therefore found once more
    between the present frame and one so far back that the flow is long enough: its rotation corrects the sum, its
    direction replaces that of the step. The gap stays short all the same: the direction found is the mean over it.
    """
    step = _pair(history, is_free, 1, config.min_tracks)
    if step is None:
        return None, last_frame_only(history), replace(memory, gap_frames=1)
    parallax_rad, side = least_parallax_px / history.focal_px, region_side_of(history.camera)
    egomotion, memory = estimate_egomotion(*step, parallax_rad, memory, config.platform, side)
    history = with_egomotion(history, egomotion.cam_R_prev, egomotion.direction, egomotion.rotation_sigma_rad)
    history = with_noise(history, egomotion.residual_spread, sigma_floor_px)
    gap = min(memory.gap_frames, len(history.frame) - 1)
    memory = replace(memory, gap_frames=_gap_for(history, is_free))
    long_step = _pair(history, is_free, gap, config.min_tracks) if gap > 1 else None
    if long_step is None:
        return egomotion, history, memory
    start = replace(memory, rotation_rad=vector_from_rotation(history.cam_R_past[-1 - gap]))
    over_gap, _ = estimate_egomotion(*long_step, np.sqrt(gap) * parallax_rad, start, config.platform, side)
    history = _corrected(history, over_gap, gap)
    egomotion = replace(egomotion, direction=over_gap.direction, direction_cov=over_gap.direction_cov)
    return egomotion, history, memory


def _pair(history: TrackHistory, is_free: Bools, gap: int, min_tracks: int) -> tuple[Floats, Floats, Floats] | None:
    """Rays ``gap`` frames ago and now, each in its own camera, and their noise; None with too few tracks."""
    if not 0 < gap < len(history.frame):
        return None
    before, now, sigma_rad = history.rays[-1 - gap], history.rays[-1], history.sigma_rad
    seen = np.flatnonzero(is_free & np.isfinite(before[:, 0]) & np.isfinite(now[:, 0]))
    if len(seen) < min_tracks:
        return None
    seen = _spread(now, sigma_rad, seen, min_tracks, region_side_of(history.camera))
    return before[seen], now[seen], sigma_rad[seen]


def _spread(rays: Floats, sigma_rad: Floats, seen: Ints, min_tracks: int, side: float) -> Ints:
    """Tracks among ``seen`` so that no place of the picture holds too many: one textured lorry is not the world.

    A mover near by may hold most of the tracks, but it does not fill most of the picture.
    """
    is_kept, rays = np.zeros(len(seen), dtype=bool), rays[seen]
    _keep_some(rays, sigma_rad[seen], picture_region(rays, side), is_kept)
    spread = seen[is_kept]
    return spread if len(spread) >= min_tracks else seen


@compiled
def _keep_some(rays: Floats, sigma: Floats, region: Ints, is_kept: Bools) -> None:
    """Fills ``is_kept (N,)`` with the quietest few of each region: the same ones in whatever order the tracks come."""
    kept = np.full((region.max() + 1 if len(region) else 0, _MOST_IN_CELL), -1, dtype=np.int64)
    for i in range(len(rays)):
        new = i
        for place in range(_MOST_IN_CELL):
            old = kept[region[i], place]
            if old < 0 or (sigma[new], rays[new, 0], rays[new, 1]) < (sigma[old], rays[old, 0], rays[old, 1]):
                kept[region[i], place], new = new, old
            if new < 0:
                break
    for old in kept.ravel():
        if old >= 0:
            is_kept[old] = True


def _gap_for(history: TrackHistory, is_free: Bools) -> int:
    """Frames after which the median derotated flow has the wanted length, by the flow of the last step."""
    flow = history.rays[-1] - history.derotated(-2)
    flow_px = np.sqrt(np.einsum("ni,ni->n", flow, flow)) * history.focal_px
    flow_px = flow_px[is_free & np.isfinite(flow_px)]
    if not len(flow_px):
        return 1
    return int(np.clip(np.ceil(_WANTED_FLOW_PX / max(median(flow_px), _TINY_PX)), 1, _LONGEST_GAP))


def _corrected(history: TrackHistory, over_gap: Egomotion, gap: int) -> TrackHistory:
    """Past rotations with the error of their sum taken out evenly, and the direction of the last step replaced."""
    error_rad = vector_from_rotation(over_gap.cam_R_prev @ history.cam_R_past[-1 - gap].T)
    # What lies before the gap was put right when it was within one: it is carried along, not stretched.
    steps = np.minimum(np.arange(len(history.frame) - 1, -1, -1), gap)
    corrected = rotation_from_vector(error_rad * (steps / gap)[:, None]) @ history.cam_R_past
    # By way of rotation vectors: products that go on for ever would cease to be rotations.
    corrected = rotation_from_vector(vector_from_rotation(corrected))
    scene_direction = history.scene_direction.copy()
    scene_direction[-1] = np.nan if over_gap.direction is None else over_gap.direction
    return replace(history, cam_R_past=corrected, scene_direction=scene_direction)
