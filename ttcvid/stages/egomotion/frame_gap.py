"""Egomotion of a frame, over a gap that grows until the flow is long enough."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ttcvid.config import EgomotionConfig
from ttcvid.geometry.estimation.relative_pose import TwoViewFit
from ttcvid.geometry.medians import median
from ttcvid.geometry.rotation import normalize, rotation_from_vector, vector_from_rotation
from ttcvid.model import Bools, Ints
from ttcvid.stages.egomotion.motion_prior import MOTION_PRIORS, EgomotionMemory, SceneWindow
from ttcvid.stages.egomotion.relative_pose import (
    STILL_SIGMAS,
    Egomotion,
    RayPairs,
    cost_of,
    egomotion_of,
    estimate_egomotion,
    picture_region,
    region_side_of,
    with_doubt,
)
from ttcvid.stages.egomotion.scene_trajectory import with_scene_path
from ttcvid.stages.egomotion.window_motion import by_window
from ttcvid.stages.tracking.history import TrackHistory, last_frame_only, with_egomotion
from ttcvid.stages.tracking.noise import with_noise

# In each part of the picture (`picture_region`) only so many tracks are used: errors that neighbours share are what
# limits own motion.
_MOST_IN_CELL = 6
# So many tracks of the scene tell beside known movers how a camera turns: three unknowns, two residuals a track. With
# all tracks instead, a dozen movers before a resting camera turned it by 0.3 deg a frame. (Of a translation, five
# unknowns and one residual a track, they leave no residual: the noise would seem to vanish.)
_LEAST_OF_TURN = 6
# The gap of own motion grows until half of the tracks have this much flow, px, up to so many frames. A steady way
# that asks for the longest gap steps so little that it leaves no third difference (6 step / k^2, k before contact).
_WANTED_FLOW_PX, _LONGEST_GAP = 2.5, 5
_TINY_PX = 1e-6


def find_own_motion(
    history: TrackHistory,
    is_free: Bools,
    in_scene: Bools,
    memory: EgomotionMemory,
    config: EgomotionConfig,
    least_parallax_px: float,
    sigma_floor_px: float,
) -> tuple[Egomotion | None, TrackHistory, EgomotionMemory]:
    """Rotation since the last frame, and direction of travel from the whole tracks of the scene.

    Parameters
    ----------
    history : Views of all tracks, the present one included.
    is_free : ``(N,)`` tracks that are not frozen to their pixel.
    in_scene : ``(N,)`` tracks of no known mover. They alone determine egomotion, unless a fit to all tracks explains
        all of them better, since the known movers may be wrong, or they translate and are fewer than ``min_tracks``.
        Where a window decides (`window_motion.by_window`), the parts of the picture are compared instead.
    memory : Start of the search, from the frame before.
    config : Priors.
    least_parallax_px : Flow of one step that does not count as translation, however small the noise.
    sigma_floor_px : Minimum noise of a track.

    Returns no own motion where there are too few tracks; then the history keeps only the present frame.
    """
    parallax_rad = least_parallax_px / history.focal_px
    window = memory.window if memory.is_window_used else None
    follows = in_scene if window is None else in_scene & ~window.leaves_out(history.track_id)
    step = _last_step(history, is_free, follows, memory, config, parallax_rad)
    if step is None:
        memory = replace(memory, gap_frames=1, window=None, is_window_used=False, n_moving=0)
        return None, last_frame_only(history), memory
    egomotion, history, memory = _over_gap(history, *step, memory, config, parallax_rad, sigma_floor_px)
    tells, belief = step[2], MOTION_PRIORS[config.platform]
    if belief.is_open:
        tracks = history, is_free, in_scene, tells
        found = by_window(*tracks, memory.window, egomotion, belief.rotation_sigma_rad, parallax_rad)
        # Without parallax the path has noise for a shape: it is only carried on, for when the camera moves again, which
        # two views show first.
        is_used = found.direction is not None and (egomotion.direction is not None or memory.is_window_used)
        memory = replace(memory, window=found.window, is_window_used=is_used)
        if found.window is not None and is_used:
            egomotion, memory = found, replace(memory, rotation_rad=found.rotation_rad)
            history = _with_window(history, found, found.window)
            tells = is_free & in_scene & ~found.window.leaves_out(history.track_id)
        else:
            egomotion = replace(egomotion, is_told=False)
    history = with_scene_path(history, tells, egomotion, config.platform)
    step_s = float(history.t_s[-1] - history.t_s[-2])
    memory = memory.with_direction(egomotion.direction, egomotion.direction_cov, belief, step_s)
    return egomotion, history, memory


def _with_window(history: TrackHistory, egomotion: Egomotion, window: SceneWindow) -> TrackHistory:
    """The history with the rotations and directions of all its steps as the window has them."""
    cam_R_past, path = window.paths.cam_R_past[0], window.paths.path[0]
    steps = np.einsum("lji,lj->li", cam_R_past[1:], np.diff(path, axis=0))
    scene_direction = np.concatenate([np.full((1, 3), np.nan), normalize(steps)])
    return replace(
        history, cam_R_past=cam_R_past, scene_direction=scene_direction, rotation_sigma_rad=egomotion.rotation_sigma_rad
    )


def _last_step(
    history: TrackHistory,
    is_free: Bools,
    in_scene: Bools,
    memory: EgomotionMemory,
    config: EgomotionConfig,
    parallax_rad: float,
) -> tuple[TwoViewFit, RayPairs, Bools] | None:
    """Own motion since the last frame, and by which tracks: those of no known mover, or all. None with too few."""
    everything = paired_rays(history, is_free, 1, config.min_tracks, with_past=memory.goes_on)
    if everything is None:
        return None
    without_movers = is_free & in_scene
    pair = None
    if (is_free & ~in_scene).any():
        pair = paired_rays(history, without_movers, 1, _LEAST_OF_TURN, with_past=memory.goes_on)

    def fit_to(rays: RayPairs) -> TwoViewFit:
        return estimate_egomotion(rays, parallax_rad, memory, config.platform)

    if pair is None:
        return fit_to(everything), everything, is_free
    by_scene = fit_to(pair)
    if by_scene.direction is not None and len(pair.now) < config.min_tracks:
        return fit_to(everything), everything, is_free
    if memory.is_window_used:
        return by_scene, pair, without_movers
    by_all = fit_to(everything)
    is_better = cost_of(by_all, everything) < cost_of(by_scene, everything)
    return (by_all, everything, is_free) if is_better else (by_scene, pair, without_movers)


def _over_gap(
    history: TrackHistory,
    fit: TwoViewFit,
    pairs: RayPairs,
    tells: Bools,
    memory: EgomotionMemory,
    config: EgomotionConfig,
    parallax_rad: float,
    sigma_floor_px: float,
) -> tuple[Egomotion, TrackHistory, EgomotionMemory]:
    """Rotation from the last frame, and direction of travel over the gap that the flow asks for.

    Rotations of single steps would add up with their errors, which are partly common to all steps: over ten frames
    they bend the flow of everything far away. Where the flow is short, the motion is therefore found once more
    between the present frame and one so far back that the flow is long enough: its rotation corrects the sum, its
    direction replaces that of the step. The gap stays short nevertheless: the direction found is the mean over it.
    """
    egomotion = egomotion_of(fit)
    history = with_egomotion(history, egomotion.cam_R_prev, egomotion.direction, egomotion.rotation_sigma_rad)
    gap = min(memory.gap_frames, len(history.frame) - 1)
    # Where a step shows no translation, what is left of its flow is noise only if a longer one shows none, either.
    is_noise_known, is_slow = egomotion.direction is not None or gap <= 1, gap >= _LONGEST_GAP
    if is_noise_known:
        history = with_noise(history, egomotion.residual_spread, sigma_floor_px, is_slow)
    before, memory = memory, replace(memory.after(fit), gap_frames=_gap_for(history, tells))
    long_step = paired_rays(history, tells, gap, config.min_tracks, with_past=memory.goes_on) if gap > 1 else None
    if long_step is None:
        if not is_noise_known:
            history = with_noise(history, egomotion.residual_spread, sigma_floor_px, is_slow)
        return egomotion_of(with_doubt(fit, pairs, before, config.platform)), history, memory
    start = replace(memory, rotation_rad=vector_from_rotation(history.cam_R_past[-1 - gap]))
    mean_fit = estimate_egomotion(long_step, np.sqrt(gap) * parallax_rad, start, config.platform)
    over_gap = egomotion_of(with_doubt(mean_fit, long_step, start, config.platform))
    if not is_noise_known:
        told = egomotion if over_gap.direction is None else over_gap
        history = with_noise(history, told.residual_spread, sigma_floor_px, is_slow)
    history = _corrected(history, over_gap, gap)
    mean, cov, is_told = over_gap.direction, over_gap.direction_cov, over_gap.is_told
    egomotion = replace(egomotion, direction=mean, direction_cov=cov, gap_frames=gap, is_told=is_told)
    return egomotion, history, memory


def paired_rays(
    history: TrackHistory, is_free: Bools, gap: int, min_tracks: int, *, with_past: bool = False
) -> RayPairs | None:
    """Points of tracks ``is_free (N,)`` in the views ``gap`` frames ago and now; None with too few of them.

    ``with_past``: and which had moved before. Of tracks so that no place of the picture holds too many: one textured
    lorry is not the world. A mover near by may hold most of the tracks, but it does not fill most of the picture.
    """
    if not 0 < gap < len(history.frame):
        return None
    before, now = history.rays[-1 - gap], history.rays[-1]
    seen = np.flatnonzero(is_free & np.isfinite(before[:, 0] + now[:, 0]))
    if len(seen) < min_tracks:
        return None
    rays, sigma_rad = now.take(seen, axis=0), history.sigma_rad.take(seen)
    # The quietest of each part. That of a ray hangs on its place, too: the same ones in whatever order they come, but
    # for exact ties.
    region = picture_region(rays, region_side_of(history.camera))
    order = np.argsort(region + 0.5 * sigma_rad / sigma_rad.max())
    rank = np.arange(len(order)) - np.searchsorted(region[order], region[order])
    used = np.sort(order[rank < _MOST_IN_CELL])
    if len(used) < min_tracks:
        used = np.arange(len(seen))
    seen, rays, sigma_rad = seen[used], rays.take(used, axis=0), sigma_rad.take(used)
    had_moved = _have_moved(history, seen, gap) if with_past else None
    return RayPairs(before.take(seen, axis=0), rays, sigma_rad, region.take(used), had_moved)


def _have_moved(history: TrackHistory, seen: Ints, gap: int) -> Bools:
    """Which of some tracks ``seen (M,)`` had moved ``gap`` frames ago, but for the camera's turn, since they began."""
    past = len(history.frame) - gap
    rays = history.rays[:past].take(seen, axis=1)
    first = np.isfinite(rays[..., 0]).argmax(axis=0)
    then_R_past = history.cam_R_past[past - 1].T @ history.cam_R_past[:past]
    flow = rays[-1] - np.einsum("mij,mj->mi", then_R_past[first], rays[first, np.arange(len(seen))])
    least_rad = STILL_SIGMAS * np.sqrt(2.0) * history.sigma_rad[seen]
    return np.asarray(np.einsum("mi,mi->m", flow, flow) > least_rad**2)


def _gap_for(history: TrackHistory, is_free: Bools) -> int:
    """Frames after which the median derotated flow has the wanted length, by the flow of the last step."""
    flow = (history.rays[-1] - history.derotated(-2)).take(np.flatnonzero(is_free), axis=0)
    square = np.einsum("ni,ni->n", flow, flow)
    square = square[np.isfinite(square)]
    if not len(square):
        return 1
    flow_px = median(np.sqrt(square)) * history.focal_px
    return min(max(math.ceil(_WANTED_FLOW_PX / max(flow_px, _TINY_PX)), 1), _LONGEST_GAP)


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
