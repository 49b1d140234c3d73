"""States of every track from all its views: on the path of its cluster where it has one, by itself where not."""

from __future__ import annotations

import numpy as np

from ttcvid.config import CollisionTimesConfig
from ttcvid.geometry.chi_square import chi2_quantile
from ttcvid.geometry.epipole import INFINITY_COSINE
from ttcvid.geometry.rotation import normalize, skew
from ttcvid.geometry.state import is_at_epipole
from ttcvid.geometry.whole_track import LEAST_FRAMES, MotionPlane, fit_whole_tracks
from ttcvid.geometry.whole_track_on_path import NO_PATH, fit_rates_on_paths, straight_path
from ttcvid.model import SCENE_CLUSTER, Bools, Floats, Ints, Status
from ttcvid.stages.flows import ROTATION_DRIFT_RAD
from ttcvid.stages.history import TrackHistory
from ttcvid.stages.motions import FrameMotions
from ttcvid.stages.planar import HorizonPlane
from ttcvid.stages.track_states import SharedErrors, TrackStates

# A rate within this many of its standard deviations may be zero; below minus this, the point moves against its group.
_RATE_SIGMAS = 2.0
# The whole velocity may be zero inside 95 % of a 3-D Gaussian, of two components with two views alone.
_NO_MOTION_CHI2 = float(chi2_quantile(0.95, 3))


def multi_frame_states(
    history: TrackHistory, motions: FrameMotions, plane: HorizonPlane | None, config: CollisionTimesConfig
) -> TrackStates:
    """States by maximum likelihood from the window of each track that one motion explains.

    A track of a cluster with a direction moves along the cluster's path: its place and its rate are left. Any other
    track, but for those of a scene that does not move, has its free state (with a horizon: in its plane).
    """
    paths, directions, path_of = _paths(history, motions)
    states = _on_paths(history, motions, paths, directions, path_of, config)
    has_none = (motions.cluster_id == SCENE_CLUSTER) & (path_of == NO_PATH)
    free = np.flatnonzero((path_of == NO_PATH) & ~has_none & motions.is_free)
    return _with_free(states, history, free, plane, config)


def _paths(history: TrackHistory, motions: FrameMotions) -> tuple[Floats, Floats, Ints]:
    """Paths ``(K, L, 3)`` and directions ``(K, 3)`` of the clusters that have one, and the path of each track."""
    path_of = np.full(history.n_tracks, NO_PATH, dtype=np.int64)
    paths: list[Floats] = []
    directions: list[Floats] = []
    for motion in motions.clusters:
        if motion.direction is None:
            continue
        is_scene = motion.cluster_id == SCENE_CLUSTER
        path_of[motion.members] = len(paths)
        paths.append(history.scene_path if is_scene else straight_path(motion.direction, history.since_s))
        directions.append(motion.direction)
    count = len(paths)
    return np.reshape(paths, (count, len(history.t_s), 3)), np.reshape(directions, (count, 3)), path_of


def _on_paths(
    history: TrackHistory,
    motions: FrameMotions,
    paths: Floats,
    directions: Floats,
    path_of: Ints,
    config: CollisionTimesConfig,
) -> TrackStates:
    """States of all N tracks; those without a path have the reason that ``motions`` gives."""
    rates = fit_rates_on_paths(
        history.xy, history.since_s, history.sigma_norm, paths, path_of, config.max_frames, config.window_probability
    )
    n = history.n_tracks
    has_path = path_of != NO_PATH
    direction, direction_cov = np.full((n, 3), np.nan), np.zeros((n, 3, 3))
    direction[has_path] = directions[path_of[has_path]]
    direction_cov[has_path] = motions.direction_cov[has_path]
    by_rotation = rates.by_rotation * _rotation_rate_sigma(history)
    shared = SharedErrors(rates.cov[:, 2, 2], rates.by_direction, by_rotation)
    by_e = direction[:, :, None] * rates.by_direction[:, None, :] + rates.rate_hz[:, None, None] * np.eye(3)
    along = rates.cov[:, 2, 2] + np.einsum("ni,ni->n", by_rotation, by_rotation)
    cov = along[:, None, None] * direction[:, :, None] * direction[:, None, :]
    cov += by_e @ direction_cov @ np.swapaxes(by_e, 1, 2)
    by_direction = np.einsum("ni,nij,nj->n", rates.by_direction, direction_cov, rates.by_direction)
    sigma_hz = np.sqrt(along + np.maximum(by_direction, 0.0))
    xy = history.xy[-1]
    status = np.select(
        [
            ~np.isfinite(xy[:, 0]) | (has_path & (rates.n_frames < 2)),
            ~has_path,
            _is_at_epipole(history, direction, direction_cov) | ~np.isfinite(rates.rate_hz),
            np.abs(rates.rate_hz) < _RATE_SIGMAS * sigma_hz,
            rates.rate_hz < 0.0,
            np.abs(direction[:, 2]) < INFINITY_COSINE,
        ],
        [
            Status.short_track,
            motions.no_direction_status,
            Status.at_epipole,
            Status.no_parallax,
            Status.not_rigid,
            Status.epipole_at_infinity,
        ],
        Status.ok,
    ).astype(np.int64)
    has_value = np.isin(status, [Status.ok, Status.epipole_at_infinity])
    abc_hz = np.where(has_value[:, None], rates.rate_hz[:, None] * direction, np.nan)
    cov = np.where(has_value[:, None, None], cov, np.nan)
    return TrackStates(xy, abc_hz, cov, history.sigma_norm, direction, status, shared)


def _with_free(
    states: TrackStates,
    history: TrackHistory,
    free: Ints,
    plane: HorizonPlane | None,
    config: CollisionTimesConfig,
) -> TrackStates:
    """The same with the free states of the tracks of ``free (M,)``."""
    if not len(free):
        return states
    motion_plane = None if plane is None else MotionPlane(plane.normal, plane.covariance)
    found = fit_whole_tracks(
        history.xy[:, free],
        history.since_s,
        history.sigma_norm[free],
        None,
        config.max_frames,
        config.window_probability,
        motion_plane,
    )
    velocity = found.state[:, 2:]
    moved = np.einsum("ni,nij,nj->n", velocity, found.info_w, velocity)
    direction = normalize(velocity)
    n_views = 2 if plane is not None else LEAST_FRAMES
    status = np.select(
        [
            ~(found.n_frames >= n_views),
            ~(moved > _NO_MOTION_CHI2),
            found.chi2 > chi2_quantile(config.window_probability, np.maximum(found.dof, 1)),
            np.abs(direction[:, 2]) < INFINITY_COSINE,
        ],
        [Status.short_track, Status.no_parallax, Status.not_rigid, Status.epipole_at_infinity],
        Status.ok,
    ).astype(np.int64)
    # A turn that is not there moves a point as a velocity of (its rate) x (the ray) would.
    turn = skew(np.column_stack([found.state[:, :2], np.ones(len(free))])) * _rotation_rate_sigma(history)
    has_value = np.isin(status, [Status.ok, Status.epipole_at_infinity])
    cov = np.full((len(free), 3, 3), np.nan)
    cov[has_value] = np.linalg.inv(found.info_w[has_value])
    cov += turn @ np.swapaxes(turn, 1, 2)
    return states.replaced(free, velocity, cov, direction, status)


def _is_at_epipole(history: TrackHistory, direction: Floats, direction_cov: Floats) -> Bools:
    """Tracks whose first and last view both lie on the line along their direction, within noise."""
    xy = history.xy
    oldest = np.argmax(np.isfinite(xy[:, :, 0]), axis=0)
    first = xy[oldest, np.arange(history.n_tracks)]
    ones = np.ones(history.n_tracks)
    q, r = np.column_stack([first, ones]), np.column_stack([xy[-1], ones])
    return is_at_epipole(q, r, direction, history.sigma_norm**2, direction_cov)


def _rotation_rate_sigma(history: TrackHistory) -> float:
    """Standard deviation, per axis, of a rotation rate that is left in all past views, rad/s."""
    steps_s = np.diff(history.t_s)
    return ROTATION_DRIFT_RAD / float(np.median(steps_s)) if len(steps_s) else 0.0
