"""What a frame adds to the motions known so far: the part of an analysis that the next frame depends on."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ttcvid.config import PipelineConfig
from ttcvid.geometry.camera.pinhole import rays_from_pixels
from ttcvid.geometry.rotation import normalize
from ttcvid.model import Camera, Frame, FrameStatus, Platform, PointSet
from ttcvid.stages.egomotion.frame_gap import find_own_motion
from ttcvid.stages.egomotion.motion_prior import EgomotionMemory
from ttcvid.stages.egomotion.outflow import flows_out
from ttcvid.stages.egomotion.relative_pose import Egomotion
from ttcvid.stages.egomotion.window_motion import LEAST_TOLD
from ttcvid.stages.horizon.planar_motion import HorizonPlane, followed_plane
from ttcvid.stages.objects.motions import find_motions
from ttcvid.stages.segmentation.labels import BodyMemory, in_scene, restarted_bodies
from ttcvid.stages.smoothing import Seen
from ttcvid.stages.tracking.history import TrackHistory, empty_history, extended
from ttcvid.stages.tracking.static_overlays import FrozenMemory, find_frozen
from ttcvid.stages.tracking.tracked_frames import TrackedFrame

# Flow left after the rotation that is not taken for motion, however small the noise, px: matching errs in common.
LEAST_PARALLAX_PX = 0.25
# A rotation that moves the picture by more than this shows which pixels are frozen, px.
_TURNING_PX = 0.5
# Third differences need four frames of history, the direction of a free camera more.
_LEAST_HISTORY = max(4, LEAST_TOLD)


@dataclass(frozen=True)
class Clip:
    """What does not change during an analysis."""

    camera: Camera
    config: PipelineConfig
    plane: HorizonPlane | None


@dataclass(frozen=True)
class SeenFrame:
    """A frame with its motions, from which the next frame continues; ``seen`` is None for one without a result.

    ``dt_s`` is the time over which the motion of the frame is measured, ``plane`` the last position of the horizon.
    """

    frame: Frame
    dt_s: float | None
    status: FrameStatus
    plane: HorizonPlane | None
    seen: Seen | None = None


@dataclass(frozen=True)
class Memory:
    """All that is remembered about motions from one frame to the next.

    ``t_s`` is the time of the last frame, ``used_t_s`` that of the last one with points in the history.
    """

    history: TrackHistory
    t_s: float | None = None
    used_t_s: float | None = None
    egomotion: EgomotionMemory = field(default_factory=EgomotionMemory)
    frozen: FrozenMemory = field(default_factory=FrozenMemory)
    bodies: BodyMemory = field(default_factory=BodyMemory)
    scene_moves: bool = False
    plane: HorizonPlane | None = None


def see_motions(tracked: TrackedFrame, memory: Memory, clip: Clip) -> tuple[SeenFrame, Memory]:
    """Egomotion and segmentation of a frame: what later frames depend on."""
    frame, points, status = tracked.frame, tracked.points, tracked.status
    followed = clip.plane if memory.plane is None else memory.plane
    if status == FrameStatus.bad_dt:
        return SeenFrame(frame, _since(memory.t_s, frame), status, followed), memory
    dt_s = _since(memory.used_t_s, frame)
    memory = replace(memory, t_s=frame.t_s)
    if status in (FrameStatus.dark, FrameStatus.duplicate):
        return SeenFrame(frame, dt_s, status, followed), memory
    memory = replace(memory, used_t_s=frame.t_s)
    if status == FrameStatus.cut:
        memory = _after_cut(memory, clip)

    step_s = np.inf if dt_s is None else dt_s
    is_frozen, frozen = find_frozen(memory.frozen, points, scene_moves=memory.scene_moves, step_s=step_s)
    history = _with_points(frame, points, memory.history, clip)
    tracks = history, ~is_frozen, in_scene(memory.bodies, history.track_id)
    own, least_noise_px = clip.config.egomotion, clip.config.tracking.sigma_floor_px
    egomotion, history, ego_memory = find_own_motion(*tracks, memory.egomotion, own, LEAST_PARALLAX_PX, least_noise_px)
    if egomotion is not None:
        dt_s = float(history.t_s[-1] - history.t_s[-2])
    if status == FrameStatus.ok:
        status = _motion_status(egomotion, clip.config.egomotion.platform)
    turn = None if egomotion is None else egomotion.cam_R_prev
    plane = followed_plane(memory.plane, clip.plane, turn, dt_s, clip.camera)
    motions, history, bodies = find_motions(
        history, egomotion, ~is_frozen, ~frozen.is_suspect, memory.bodies, plane, clip.camera, clip.config
    )
    # Behind a few frames with too few tracks everything goes on with those from before.
    before_s = memory.history.t_s
    is_gap = egomotion is None and len(before_s) > 1 and frame.t_s - before_s[-1] <= before_s[-1] - before_s[0]
    memory = replace(
        memory,
        history=memory.history if is_gap else history,
        frozen=frozen,
        egomotion=ego_memory,
        bodies=restarted_bodies(bodies) if egomotion is None and not is_gap else bodies,
        scene_moves=_shows_frozen_pixels(egomotion, history, clip),
        plane=plane,
    )
    return SeenFrame(frame, dt_s, status, plane, Seen(history, egomotion, motions, plane)), memory


def _since(t_s: float | None, frame: Frame) -> float | None:
    return None if t_s is None else frame.t_s - t_s


def _after_cut(memory: Memory, clip: Clip) -> Memory:
    """Nothing is carried over a cut but the numbers already given away."""
    return Memory(
        history=empty_history(clip.camera, clip.config.tracking.sigma_start_px),
        t_s=memory.t_s,
        used_t_s=memory.used_t_s,
        bodies=restarted_bodies(memory.bodies),
    )


def _with_points(frame: Frame, points: PointSet, before: TrackHistory, clip: Clip) -> TrackHistory:
    """The history with this frame's points as rays; a point that no ray belongs to (far outside a lens) has NaN."""
    rays = normalize(rays_from_pixels(clip.camera, points.xy_px))
    times = clip.config.collision_times
    max_frames = max(_LEAST_HISTORY, times.max_gap_frames + 1, times.max_frames)
    return extended(before, frame.index, frame.t_s, points, rays, max_frames)


def _motion_status(egomotion: Egomotion | None, platform: Platform) -> FrameStatus:
    """Status of a frame whose picture is in order."""
    if egomotion is None:
        return FrameStatus.few_tracks
    if platform == Platform.static:
        return FrameStatus.static
    return FrameStatus.ok if egomotion.direction is not None and egomotion.is_told else FrameStatus.rotation_only


def _shows_frozen_pixels(egomotion: Egomotion | None, history: TrackHistory, clip: Clip) -> bool:
    """Whether the camera moved so that every pixel of the scene had to change its place.

    Also where most of the picture rides along with the camera, and so is taken for a scene at rest.
    """
    if egomotion is None:
        return False
    own, turned_px = clip.config.egomotion, float(np.linalg.norm(egomotion.rotation_rad)) * clip.camera.fx_px
    if (egomotion.direction is not None and egomotion.is_told) or turned_px > _TURNING_PX:
        return True
    return own.platform != Platform.static and flows_out(history, LEAST_PARALLAX_PX, own.min_tracks, own.platform)
