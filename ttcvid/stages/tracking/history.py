"""The observations of every live track around a frame, with the rotation from each other camera to its own."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ttcvid.geometry.camera.pinhole import plane_per_px
from ttcvid.geometry.estimation.shared_trajectory import SharedPaths
from ttcvid.geometry.medians import median
from ttcvid.geometry.rotation import rotation_from_vector, turned_into_plane
from ttcvid.model import Bools, Camera, Floats, Ints, PointSet
from ttcvid.stages.tracking.groups import places_among

# Views that count as recent, however long ago.
_LEAST_RECENT = 4
# Views are not thinned out among so many last ones: own motion looks back as far, and a track's roughness comes from
# even steps. Half a frame is left to times that were rounded.
_DENSE_VIEWS, _ROUNDING_FRAMES = 5, 0.5
# So many false observations in a row are no chance: at 30 % of them one in 11 pairs is.
_STRAYING_VIEWS = 2

FULL_RATE_HZ = 30.0
"""The views of a clip that is faster are thinned, so that they reach as far back as they would at this rate."""

ROTATION_DRIFT_RAD = float(np.radians(0.006))
"""Systematic matching error rotates the camera estimate by this much per view, always in the same sense.

Measured: 0.004 deg on simulated streets, 0.013 deg of yaw on kitti_odom_straight50.
"""

# What is known of each track, ``(N,)``, beside its rays and its present pixel.
_OF_TRACKS = ("track_id", "n_frames", "sigma_px", "noise_sum", "noise_weight")


@dataclass(frozen=True)
class LostTracks:
    """What a `TrackHistory` knows of M tracks that are not seen in its present frame and may come back.

    ``rays (L, M, 3)`` over the views of the history; the rest (M,) as in the history.
    """

    track_id: Ints
    n_frames: Ints
    rays: Floats
    sigma_px: Floats
    noise_sum: Floats
    noise_weight: Floats


@dataclass(frozen=True)
class TrackHistory:
    """The last L views of the N live tracks, oldest first: every frame, but where the clip is faster than 30/s.

    ``frame (L,)``, ``t_s (L,)``; ``cam_R_past (L, 3, 3)`` turns a ray of frame l into the present camera
    (`with_egomotion` brings it up to date); ``scene_direction (L, 3)`` is ``dir`` of the scene in the step up to frame
    l, in its own camera, NaN where unknown; ``rotation_sigma_rad`` the error of the present rotation, per axis;
    ``track_id (N,)`` ascending; ``n_frames (N,)`` observations so far; ``xy_px (N, 2)`` present position;
    ``rays (L, N, 3)`` unit rays in the camera of their own frame, NaN where not observed; ``sigma_px (N,)`` noise of
    one coordinate of one observation; ``noise_sum, noise_weight (N,)`` its evidence and ``pool_sigma_px`` the noise of
    all tracks together; ``plane_per_px (N,)`` how much of the plane z = 1 a pixel spans where each track is
    (`pinhole.plane_per_px`); ``common_error_px`` as in `PointSet`. ``scene`` is the path of the static scene as its
    tracks see it together (`egomotion.scene_trajectory`), None until found in this frame. ``now`` is the entry of the
    present frame, counted from the end: the last one, but where a frame is looked at once more with views of later ones
    (`stages.smoothing`). ``lost`` are tracks that may come back.
    """

    frame: Ints
    t_s: Floats
    cam_R_past: Floats
    scene_direction: Floats
    rotation_sigma_rad: float
    track_id: Ints
    n_frames: Ints
    xy_px: Floats
    rays: Floats
    sigma_px: Floats
    noise_sum: Floats
    noise_weight: Floats
    pool_sigma_px: float
    plane_per_px: Floats
    camera: Camera
    common_error_px: float = 0.0
    scene: SharedPaths | None = None
    now: int = -1
    lost: LostTracks | None = None

    @property
    def n_past(self) -> int:
        """Number of frames before the present one."""
        return len(self.frame) + self.now

    @property
    def n_tracks(self) -> int:
        """Number of live tracks."""
        return len(self.track_id)

    @property
    def focal_px(self) -> float:
        """Pixels per rad about the axis."""
        return 0.5 * (self.camera.fx_px + self.camera.fy_px)

    @cached_property
    def sigma_rad(self) -> Floats:
        """Noise of one coordinate of a unit ray, ``(N,)`` rad.

        What a pixel spans in the plane z = 1 is seen under a smaller angle away from the axis: cos^2 along the radius
        and cos across, taken together as cos^1.5.
        """
        return np.asarray(self.sigma_norm * np.clip(self.rays[self.now, :, 2], 0.1, 1.0) ** 1.5)

    @cached_property
    def sigma_norm(self) -> Floats:
        """Noise of one coordinate in the plane z = 1, ``(N,)``."""
        return self.sigma_px * self.plane_per_px

    @cached_property
    def xy(self) -> Floats:
        """Positions in the plane z = 1 of the present camera, ``(L, N, 2)``; NaN where not observed."""
        return turned_into_plane(self.rays, self.cam_R_seen)

    @cached_property
    def cam_R_seen(self) -> Floats:
        """``cam_R_past`` without the rotation rate that the scene's tracks find left in it, ``(L, 3, 3)``."""
        if self.scene is None:
            return self.cam_R_past
        return rotation_from_vector(-self.since_s[:, None] * self.scene.turn_rad_s) @ self.cam_R_past

    @property
    def rotation_rate_cov(self) -> Floats:
        """Covariance (3, 3) of the rotation rate that is left in all past rays, (rad/s)^2."""
        if self.scene is not None:
            return self.scene.cov[0, 6:9, 6:9]
        return self.rotation_rate_sigma_rad_s**2 * np.eye(3)

    @property
    def rotation_rate_sigma_rad_s(self) -> float:
        """What is to be expected, per axis, of a rotation rate that own motion leaves in the past rays."""
        return ROTATION_DRIFT_RAD / self.step_s if len(self.t_s) > 1 else 0.0

    @cached_property
    def step_s(self) -> float:
        """Usual time between views, 0 with a single one."""
        return median(np.diff(self.t_s)) if len(self.t_s) > 1 else 0.0

    def views_within(self, window_s: float) -> slice:
        """The views within a time of the present one, and the last few up to it in any case."""
        first = int(np.searchsorted(self.since_s, -window_s))
        stop = int(np.searchsorted(self.since_s, window_s, side="right"))
        return slice(max(0, min(first, self.n_past + 1 - _LEAST_RECENT)), stop)

    @cached_property
    def since_s(self) -> Floats:
        """Times relative to the present frame, ``(L,)`` s: up to 0, but for later views."""
        return np.asarray(self.t_s - self.t_s[self.now])

    @property
    def scene_steps(self) -> Floats:
        """Where the static scene was relative to the camera, ``(L, 3)`` s in the axes of the present camera.

        The sum of the steps, each along its own direction: own speed is taken as steady, own direction is not. NaN
        beyond a step whose direction is not known.
        """
        steps = np.einsum("lij,lj->li", self.cam_R_past, self.scene_direction)[1:]
        lengths = np.diff(self.t_s)[:, None] * steps
        path, n_past = np.zeros((len(self.t_s), 3)), self.n_past
        path[:n_past] = -np.cumsum(lengths[:n_past][::-1], axis=0)[::-1]
        path[n_past + 1 :] = np.cumsum(lengths[n_past:], axis=0)
        return path

    def derotated(self, index: int) -> Floats:
        """Rays of history entry ``index`` as the present camera would see them: ``(N, 3)``, NaN where not observed."""
        return np.asarray(self.rays[index] @ self.cam_R_seen[index].T)


def empty_history(camera: Camera, sigma_start_px: float) -> TrackHistory:
    """Before the first frame, and after a cut."""
    return TrackHistory(
        frame=np.empty(0, np.int64),
        t_s=np.empty(0),
        cam_R_past=np.empty((0, 3, 3)),
        scene_direction=np.empty((0, 3)),
        rotation_sigma_rad=0.0,
        track_id=np.empty(0, np.int64),
        n_frames=np.empty(0, np.int64),
        xy_px=np.empty((0, 2)),
        rays=np.empty((0, 0, 3)),
        sigma_px=np.empty(0),
        noise_sum=np.empty(0),
        noise_weight=np.empty(0),
        pool_sigma_px=sigma_start_px,
        plane_per_px=np.empty(0),
        camera=camera,
    )


def extended(
    history: TrackHistory, frame: int, t_s: float, points: PointSet, rays: Floats, max_frames: int
) -> TrackHistory:
    """The history with one more frame, of at most ``max_frames`` views.

    ``rays (N, 3)`` are the unit rays of the points. Tracks that are not among ``points`` end; those that may come back
    (``points.unseen_id``) end when no view of them is left.
    """
    if history.lost is not None:
        history = _with_lost(history, history.lost)
    n = len(points.track_id)
    by_id = np.argsort(history.track_id, kind="stable")
    # -1, of a new track, picks the last one.
    before = np.append(by_id, -1)[places_among(history.track_id[by_id], points.track_id)]
    is_new = before < 0

    def carried(values: Floats | Ints, new: float) -> Any:
        # Of a new track (-1) that of the last one stands there first, if there is any.
        return np.where(is_new, new, values.take(before, mode="wrap")) if len(values) else np.full(n, new)

    stay = _views_that_stay(history.t_s, t_s, max_frames)
    kept = history.rays[stay]
    with_past = np.empty((len(kept) + 1, n, 3))
    with_past[-1] = rays
    if history.n_tracks:
        kept.take(before, axis=1, out=with_past[:-1], mode="wrap")
    with_past[:-1, is_new] = np.nan
    return replace(
        history,
        frame=np.append(history.frame[stay], frame),
        t_s=np.append(history.t_s[stay], t_s),
        cam_R_past=np.concatenate([history.cam_R_past[stay], np.eye(3)[None]]),
        scene_direction=np.concatenate([history.scene_direction[stay], np.full((1, 3), np.nan)]),
        track_id=points.track_id,
        n_frames=carried(history.n_frames, 0) + 1,
        xy_px=points.xy_px,
        rays=with_past,
        scene=None,
        sigma_px=carried(history.sigma_px, history.pool_sigma_px),
        noise_sum=carried(history.noise_sum, 0.0),
        noise_weight=carried(history.noise_weight, 0.0),
        plane_per_px=plane_per_px(history.camera, rays),
        common_error_px=points.common_error_px,
        lost=_lost_tracks(history, points, kept),
    )


def _with_lost(history: TrackHistory, lost: LostTracks) -> TrackHistory:
    """The history with its lost tracks after the others, but for their present pixels, which nobody knows."""
    rays = np.concatenate([history.rays, lost.rays], axis=1)
    known: dict[str, Any] = {name: np.append(getattr(history, name), getattr(lost, name)) for name in _OF_TRACKS}
    return replace(history, rays=rays, lost=None, **known)


def _lost_tracks(history: TrackHistory, points: PointSet, kept: Floats) -> LostTracks | None:
    """Tracks of a history, seen in its ``kept`` views, that are not among the next ``points`` and may come back."""
    gone = np.flatnonzero(places_among(points.track_id, history.track_id) < 0)
    if points.unseen_id is not None:
        gone = gone[places_among(points.unseen_id, history.track_id[gone]) >= 0]
    rays = np.full((len(kept) + 1, len(gone), 3), np.nan)
    if history.n_tracks:
        kept.take(gone, axis=1, out=rays[:-1], mode="wrap")
    was_seen = np.isfinite(rays[..., 0]).any(axis=0)
    if not was_seen.any():
        return None
    of_tracks = {name: getattr(history, name)[gone[was_seen]] for name in _OF_TRACKS}
    return LostTracks(rays=rays.compress(was_seen, axis=1), **of_tracks)


def _views_that_stay(t_s: Floats, now_s: float, max_frames: int) -> slice | Ints:
    """Which of the past views at the times ``t_s (L,)`` are kept beside a new one.

    The oldest goes where the others reach far enough back without it; else the one whose neighbours are closest in
    time, so that a fast clip is looked at over the same time with as many views.
    """
    first = max(0, len(t_s) - max_frames + 1)
    wanted_s = (max_frames - 1 - _ROUNDING_FRAMES) / FULL_RATE_HZ
    if first != 1 or max_frames < _DENSE_VIEWS + 2 or now_s - t_s[1] >= wanted_s:
        return slice(first, None)
    between_s = t_s[2 : len(t_s) - _DENSE_VIEWS + 1] - t_s[: len(t_s) - _DENSE_VIEWS - 1]
    return np.delete(np.arange(len(t_s)), 1 + int(np.argmin(np.round(between_s, 6))))


def last_frame_only(history: TrackHistory) -> TrackHistory:
    """The history without its past rays, for a step whose rotation is not known."""
    return replace(
        history,
        frame=history.frame[-1:],
        t_s=history.t_s[-1:],
        cam_R_past=history.cam_R_past[-1:],
        scene_direction=history.scene_direction[-1:],
        rays=history.rays[-1:],
        lost=None,
    )


def without_displaced(history: TrackHistory, is_displaced: Bools, is_past_off: Bools) -> TrackHistory:
    """The history without the present observation of ``is_displaced (N,)`` and the earlier ones ``is_past_off (L, N)``.

    What has strayed for longer is not displaced, but has found another thing: its track begins anew, with this one.
    """
    if not (is_displaced.any() or is_past_off.any()):
        return history
    rays, now = history.rays.copy(), len(history.rays) - 1
    has_strayed = is_displaced & np.isnan(rays[max(now - _STRAYING_VIEWS, 0) : now, :, 0]).all(axis=0)
    rays[-1, is_displaced & ~has_strayed] = np.nan
    rays[:-1, has_strayed] = np.nan
    rays.reshape(-1, 3)[np.flatnonzero(is_past_off)] = np.nan
    # The present one has made its track look noisy: nothing but its peers tells of that now.
    noise_sum = np.where(is_displaced, history.noise_weight, history.noise_sum)
    return replace(history, rays=rays, noise_sum=noise_sum)


def with_egomotion(
    history: TrackHistory, cam_R_prev: Floats, direction: Floats | None, rotation_sigma_rad: float
) -> TrackHistory:
    """Carry all past rotations over the step from the last frame to the present one, and note the scene's direction.

    ``cam_R_prev (3, 3)`` rotates the step, ``direction (3,)`` is ``dir`` of the scene in it, or None.
    """
    cam_R_past = np.concatenate([cam_R_prev @ history.cam_R_past[:-1], np.eye(3)[None]])
    newest = np.full(3, np.nan) if direction is None else direction
    scene_direction = np.concatenate([history.scene_direction[:-1], newest[None]])
    return replace(
        history, cam_R_past=cam_R_past, scene_direction=scene_direction, rotation_sigma_rad=rotation_sigma_rad
    )
