"""States of every track from all its views: on the path of its cluster where it has one, by itself where not."""

from __future__ import annotations

import numpy as np

from ttcvid.config import CollisionTimesConfig
from ttcvid.geometry.estimation.shared_trajectory import SharedPaths, believed_paths, joined_paths, turned_back
from ttcvid.geometry.estimation.track_on_trajectory import NO_PATH, PathRates, fit_rates_on_paths
from ttcvid.geometry.estimation.track_state import MotionPlane, WholeTracks, fit_whole_tracks, window_gates
from ttcvid.geometry.estimation.trajectory_velocity import PathVelocities, velocities_on_paths
from ttcvid.geometry.kernels.free_point import LEAST_FRAMES
from ttcvid.geometry.kernels.known_path import LEAST_FRAMES as LEAST_FRAMES_ON_PATH
from ttcvid.geometry.paper.epipole import INFINITY_COSINE
from ttcvid.geometry.rotation import normalize, skew
from ttcvid.model import NO_CLUSTER, SCENE_CLUSTER, Bools, Floats, Ints, Status
from ttcvid.stages.egomotion.scene_trajectory import scene_path
from ttcvid.stages.horizon.planar_motion import HorizonPlane
from ttcvid.stages.objects.motions import NO_MOTION_CHI2, FrameMotions
from ttcvid.stages.objects.states import SharedErrors, TrackStates, has_value
from ttcvid.stages.objects.turning import believed_straight, straight_or_in_bend
from ttcvid.stages.tracking.history import TrackHistory

# A rate within this many of its standard deviations may be zero; below minus this, the point moves against its group.
_RATE_SIGMAS = 2.0
# Information below this part of its own diagonal is rounding.
_ROUNDING = 1e-12


def multi_frame_states(
    history: TrackHistory, motions: FrameMotions, plane: HorizonPlane | None, config: CollisionTimesConfig
) -> TrackStates:
    """States by maximum likelihood from the window of each track that one motion explains.

    A track of a cluster with a direction moves along the cluster's path, which all tracks of the cluster improve
    together: its place and its rate are left. A track of no cluster has its free state (with a horizon: in its plane).
    A cluster whose motion is within its noise has none, nor do its tracks.
    """
    views = _views(history, motions, config.object_window_s)
    paths, path_of, is_object = _paths(history, motions, views, plane, config)
    states = _on_paths(history, motions, views, paths, path_of, is_object, config)
    free = np.flatnonzero((motions.cluster_id == NO_CLUSTER) & motions.is_free)
    if len(free):
        _fill_free(states, history, free, plane, config)
    return states


def _paths(
    history: TrackHistory,
    motions: FrameMotions,
    views: Floats,
    plane: HorizonPlane | None,
    config: CollisionTimesConfig,
) -> tuple[SharedPaths, Ints, Bools]:
    """Path of every cluster that has a direction, the path (N,) of each track, and which paths (K,) are objects'."""
    directed = [motion for motion in motions.clusters if motion.direction is not None]
    objects = [motion for motion in directed if motion.cluster_id != SCENE_CLUSTER]
    path_of, parts = np.full(history.n_tracks, NO_PATH, dtype=np.int64), list[SharedPaths]()
    for number, motion in enumerate(directed):
        path_of[motion.members] = number
        way, cov_of_way = motion.direction, motion.direction_cov
        if motion.cluster_id == SCENE_CLUSTER and way is not None and cov_of_way is not None:
            parts.append(scene_path(history, way, cov_of_way))
    first, count = len(parts), len(objects)
    direction = np.reshape([motion.direction for motion in objects], (count, 3))
    cov = np.reshape([motion.direction_cov for motion in objects], (count, 3, 3))
    is_start = np.array([motion.is_body for motion in objects], dtype=bool)
    beliefs = believed_straight(history.since_s, direction, cov, is_start, None if plane is None else plane.normal)
    of_objects = np.where(path_of >= first, path_of - first, NO_PATH)
    is_object = np.arange(first + count) >= first
    seen = views, history.since_s, history.sigma_norm
    if objects:
        parts.append(straight_or_in_bend(*seen, beliefs, of_objects, config, may_leave_directions=plane is None))
    return joined_paths(parts or [believed_paths(beliefs)]), path_of, is_object


def _views(history: TrackHistory, motions: FrameMotions, window_s: float) -> Floats:
    """Positions of all tracks, those of movers within ``window_s`` of the present frame; NaN elsewhere."""
    movers = [motion.members for motion in motions.clusters if motion.is_body]
    if not movers:
        return history.xy
    xy, views, members = history.xy.copy(), history.views_within(window_s), np.concatenate(movers)
    xy[: views.start, members] = xy[views.stop :, members] = np.nan
    return xy


def _on_paths(
    history: TrackHistory,
    motions: FrameMotions,
    views: Floats,
    paths: SharedPaths,
    path_of: Ints,
    is_object: Bools,
    config: CollisionTimesConfig,
) -> TrackStates:
    """States of all N tracks; those without a path have the reason that ``motions`` gives."""
    # What the scene's tracks find is an error of own motion, taken out of all views already; an object turns itself.
    turn_rad_s = np.where(is_object[:, None], paths.turn_rad_s, 0.0)
    rates = fit_rates_on_paths(
        turned_back(views, history.since_s, turn_rad_s, path_of),
        history.since_s,
        history.sigma_norm,
        paths.path,
        path_of,
        config.max_frames,
        config.window_probability,
    )
    # By how much the variances of paths have to be larger (Birge's ratio): their tracks fit worse than noise.
    on_path, n_paths = path_of != NO_PATH, len(paths.direction)
    chi2, dof = (np.bincount(path_of[on_path], each[on_path], n_paths) for each in (rates.chi2, rates.dof))
    redchi = np.maximum(chi2 / np.maximum(dof, 1.0), 1.0)
    shared_cov = paths.cov * redchi[:, None, None]
    # `NO_PATH` picks the last one.
    rate_variance = rates.cov[:, 2, 2] * np.append(redchi, 1.0)[path_of]
    found = velocities_on_paths(rates, rate_variance, path_of, paths.direction, turn_rad_s, is_object, shared_cov)
    errors = (rates.rate_hz, rate_variance, found.jacobian, shared_cov)
    shared = SharedErrors(path_of, paths.direction, *errors, turn_rad_s)
    status = np.where(on_path, _status_on_path(rates, found), motions.no_direction_status)
    moves = np.zeros(n_paths, dtype=bool)
    for k in np.flatnonzero(is_object).tolist():
        moves[k] = _moves(shared, np.flatnonzero((path_of == k) & (rate_variance > 0.0)), k)
    status[(status == Status.no_parallax) & np.append(moves, False)[path_of]] = Status.ok
    status[on_path & ~np.isfinite(rates.rate_hz)] = Status.at_epipole
    is_short = on_path & (rates.n_frames < LEAST_FRAMES_ON_PATH)
    status[is_short | ~np.isfinite(history.xy[history.now, :, 0])] = Status.short_track
    of_states = (found.abc_hz, found.cov, history.sigma_norm, normalize(found.abc_hz), status, shared)
    states = TrackStates(history.xy[history.now], *of_states)
    return states.without(~states.has_value, status)


def _moves(shared: SharedErrors, own: Ints, path: int) -> bool:
    """Whether the tracks ``own (M,)`` of an object say together that it moves along its path.

    To ask each by itself leaves those that noise has brought nearer: of a car 7 s away, a third too near.
    """
    weight, along, cov = 1.0 / shared.rate_variance[own], shared.along[path], shared.cov[path]
    by_shared = along @ np.tensordot(weight, shared.jacobian[own], 1)
    variance = by_shared @ cov @ by_shared + np.sum(weight)
    return bool(weight @ shared.rate_hz[own] > _RATE_SIGMAS * np.sqrt(variance))


def _status_on_path(rates: PathRates, found: PathVelocities) -> Ints:
    """Status (N,) by the rates: along its path, how sure it is that a track moves at all, and forwards."""
    speed_hz = np.sqrt(np.einsum("ni,ni->n", found.abc_hz, found.abc_hz))
    status = np.where(np.abs(found.abc_hz[:, 2]) < INFINITY_COSINE * speed_hz, Status.epipole_at_infinity, Status.ok)
    status[rates.rate_hz < 0.0] = Status.not_rigid
    status[np.abs(rates.rate_hz) < _RATE_SIGMAS * found.along_sigma_hz] = Status.no_parallax
    return status


def _fill_free(
    states: TrackStates, history: TrackHistory, free: Ints, plane: HorizonPlane | None, config: CollisionTimesConfig
) -> None:
    """Fills the free states of the tracks of ``free (M,)`` into ``states``, which come without any of them."""
    found = fit_whole_tracks(
        history.xy.take(free, axis=1),
        history.since_s,
        history.sigma_norm[free],
        config.max_frames,
        config.window_probability,
        None if plane is None else MotionPlane(plane.normal, plane.covariance),
    )
    moved = np.einsum("mi,mij,mj->m", found.state[:, 2:], found.info_w, found.state[:, 2:])
    direction = normalize(found.state[:, 2:])
    gates = window_gates(config.max_frames, 2 * LEAST_FRAMES - 1, config.window_probability)
    status = np.where(np.abs(direction[:, 2]) < INFINITY_COSINE, Status.epipole_at_infinity, Status.ok)
    status[found.chi2 > gates[np.maximum(found.n_frames, LEAST_FRAMES)]] = Status.not_rigid
    status[~(moved > NO_MOTION_CHI2)] = Status.no_parallax
    status[found.n_frames < (LEAST_FRAMES if plane is None else 2)] = Status.short_track
    states.status[free] = status
    has_state = has_value(status)
    of_state = free[has_state]
    states.abc_hz[of_state], states.direction[of_state] = found.state[has_state, 2:], direction[has_state]
    states.cov[of_state] = _free_covariances(found, has_state, history.rotation_rate_cov)


def _free_covariances(found: WholeTracks, which: Bools, rotation_cov: Floats) -> Floats:
    """Covariances (M, 3, 3) of the velocities of free tracks: by their views, and by a turn left in these.

    A turn that is not there moves a point as a velocity of (its rate, covariance ``rotation_cov (3, 3)``) x ray would.
    """
    information = found.info_w[which]
    regular = information + _ROUNDING * information * np.eye(3)
    turn = skew(np.column_stack([found.state[which, :2], np.ones(len(information))]))
    return np.asarray(np.linalg.inv(regular) + turn @ rotation_cov @ np.swapaxes(turn, 1, 2))
