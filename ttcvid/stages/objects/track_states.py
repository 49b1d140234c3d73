"""States of every track from all its views: on the path of its cluster where it has one, by itself where not."""

from __future__ import annotations

import numpy as np

from ttcvid.config import CollisionTimesConfig
from ttcvid.geometry.chi_square import chi2_quantile
from ttcvid.geometry.compiled import compiled, compiled_for
from ttcvid.geometry.estimation.shared_trajectory import SharedPaths, joined_paths, turned_back
from ttcvid.geometry.estimation.track_on_trajectory import NO_PATH, PathRates, fit_rates_on_paths
from ttcvid.geometry.estimation.track_state import MotionPlane, fit_whole_tracks, window_gates
from ttcvid.geometry.estimation.trajectory_velocity import velocities_on_paths
from ttcvid.geometry.kernels.free_point import LEAST_FRAMES
from ttcvid.geometry.kernels.known_path import LEAST_FRAMES as LEAST_FRAMES_ON_PATH
from ttcvid.geometry.paper.epipole import INFINITY_COSINE, SIGNIFICANCE_SIGMAS
from ttcvid.model import SCENE_CLUSTER, Bools, Floats, Ints, Status
from ttcvid.stages.egomotion.scene_trajectory import scene_path
from ttcvid.stages.horizon.planar_motion import HorizonPlane
from ttcvid.stages.objects.motions import FrameMotions
from ttcvid.stages.objects.overlaps import overlap_factors
from ttcvid.stages.objects.paper_track_states import SharedErrors, TrackStates
from ttcvid.stages.objects.turning import believed_straight, straight_or_in_bend
from ttcvid.stages.tracking.history import TrackHistory

# A rate within this many of its standard deviations may be zero; below minus this, the point moves against its group.
_RATE_SIGMAS = 2.0
# The whole velocity may be zero inside 95 % of a 3-D Gaussian.
_NO_MOTION_CHI2 = float(chi2_quantile(0.95, 3))
# What `_judge` says of tracks: their numbers are an argument, for a copy on disk would not notice that they changed.
_JUDGEMENTS = (
    Status.short_track,
    Status.at_epipole,
    Status.no_parallax,
    Status.not_rigid,
    Status.epipole_at_infinity,
    Status.ok,
)
_JUDGED = tuple(int(judgement) for judgement in _JUDGEMENTS)
# Acceleration does not last: by this part of itself it is another one now than over the views. Brakes come and go.
_ACCELERATION_CHANGE = 0.5
# What is left of a sum of squares below this part of it is rounding.
_ROUNDING = 1e-15


def multi_frame_states(
    history: TrackHistory, motions: FrameMotions, plane: HorizonPlane | None, config: CollisionTimesConfig
) -> TrackStates:
    """States by maximum likelihood from the window of each track that one motion explains.

    A track of a cluster with a direction moves along the cluster's path, which all tracks of the cluster improve
    together: its place and its rate are left. Any other track, but for those of a scene that does not move, has its
    free state (with a horizon: in its plane).
    """
    views = _views(history, motions)
    paths, path_of, is_object, common = _paths(history, motions, views, plane, config)
    states = _on_paths(history, motions, views, paths, path_of, is_object, common, config)
    has_none = (motions.cluster_id == SCENE_CLUSTER) & (path_of == NO_PATH)
    free = np.flatnonzero((path_of == NO_PATH) & ~has_none & motions.is_free)
    if len(free):
        _fill_free(states, history, free, plane, config)
    return states


def _paths(
    history: TrackHistory,
    motions: FrameMotions,
    views: Floats,
    plane: HorizonPlane | None,
    config: CollisionTimesConfig,
) -> tuple[SharedPaths, Ints, Bools, Floats]:
    """Path of every cluster that has a direction, and the path (N,) of each track.

    Which paths (K,) are objects', and what the noise of the tracks of each has in common (K,), see `overlap_factors`.
    """
    scene = [motion for motion in motions.clusters if motion.cluster_id == SCENE_CLUSTER]
    objects = [motion for motion in motions.clusters if motion.cluster_id != SCENE_CLUSTER]
    objects = [motion for motion in objects if motion.direction is not None]
    path_of = np.full(history.n_tracks, NO_PATH, dtype=np.int64)
    parts: list[SharedPaths] = []
    if scene and scene[0].direction is not None and scene[0].direction_cov is not None:
        parts.append(scene_path(history, scene[0].direction, scene[0].direction_cov))
        path_of[scene[0].members] = 0
    first = len(parts)
    for number, motion in enumerate(objects):
        path_of[motion.members] = first + number
    count = len(objects)
    direction = np.reshape([motion.direction for motion in objects], (count, 3))
    cov = np.reshape([motion.direction_cov for motion in objects], (count, 3, 3))
    beliefs = believed_straight(history.since_s, direction, cov, None if plane is None else plane.normal)
    of_objects = np.where(path_of >= first, path_of - first, NO_PATH)
    # Tracks of a small object look at the same pixels: so much less do they know together.
    is_object = np.arange(first + count) >= first
    common = overlap_factors(history.xy_px, path_of, is_object)
    parts.append(
        straight_or_in_bend(
            views,
            history.since_s,
            history.sigma_norm,
            beliefs,
            of_objects,
            config,
            cov,
            common[first:],
            may_leave_directions=plane is None,
        )
    )
    return joined_paths(parts), path_of, is_object, common


def _views(history: TrackHistory, motions: FrameMotions) -> Floats:
    """Positions of all tracks over the time for which the motion of their cluster has been the same; NaN elsewhere."""
    reach_s, xy = history.reach_s, history.xy if motions.steady_xy is None else motions.steady_xy
    changed = [motion for motion in motions.clusters if motion.window_s < reach_s]
    if not changed:
        return xy
    first, stop = np.zeros(history.n_tracks, dtype=np.int64), np.full(history.n_tracks, len(history.t_s))
    # Most objects have the same.
    views_of = {window_s: history.views_within(window_s) for window_s in {motion.window_s for motion in changed}}
    for motion in changed:
        within = views_of[motion.window_s]
        first[motion.members], stop[motion.members] = within.start, within.stop
    views = np.empty_like(xy)
    _keep_within(xy, first, stop, views)
    return views


@compiled_for("(f8[:, :, ::1], i8[::1], i8[::1], f8[:, :, ::1])")
def _keep_within(xy: Floats, first: Ints, stop: Ints, views: Floats) -> None:
    """Fills ``views (L, N, 2)`` with those of each track from ``first (N,)`` up to ``stop (N,)``, NaN elsewhere."""
    for place in range(len(xy)):
        for i in range(xy.shape[1]):
            is_within = first[i] <= place < stop[i]
            views[place, i, 0] = xy[place, i, 0] if is_within else np.nan
            views[place, i, 1] = xy[place, i, 1] if is_within else np.nan


def _on_paths(
    history: TrackHistory,
    motions: FrameMotions,
    views: Floats,
    paths: SharedPaths,
    path_of: Ints,
    is_object: Bools,
    common: Floats,
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
    misfit = _misfit(path_of, rates, len(paths.direction)) * common
    shared_cov = paths.cov * misfit[:, None, None]
    bend = _ACCELERATION_CHANGE * paths.offset[:, 3:6]
    shared_cov[:, 3:6, 3:6] += bend[:, :, None] * bend[:, None, :]
    own_cov = paths.direction_cov
    direction_variance = misfit * (own_cov[:, 0, 0] + own_cov[:, 1, 1] + own_cov[:, 2, 2])
    # `NO_PATH` picks the last one.
    rate_variance = rates.cov[:, 2, 2] * np.append(misfit, 1.0)[path_of]
    found = velocities_on_paths(rates, rate_variance, path_of, paths.direction, turn_rad_s, is_object, shared_cov)
    errors = (rates.rate_hz, rate_variance, found.jacobian, rates.by_shared)
    shared = SharedErrors(path_of, paths.direction, *errors, shared_cov, turn_rad_s)
    direction, status = np.full((history.n_tracks, 3), np.nan), np.empty(history.n_tracks, dtype=np.int64)
    _judge(
        history.xy,
        history.now % len(history.xy),
        path_of,
        paths.direction,
        direction_variance,
        history.sigma_norm,
        rates.rate_hz,
        rates.n_frames,
        found.along_sigma_hz,
        motions.no_direction_status,
        _JUDGED,
        LEAST_FRAMES_ON_PATH,
        INFINITY_COSINE,
        SIGNIFICANCE_SIGMAS**2,
        found.abc_hz,
        found.cov,
        direction,
        status,
    )
    return TrackStates(history.xy[history.now], found.abc_hz, found.cov, history.sigma_norm, direction, status, shared)


@compiled_for(
    "(f8[:, :, ::1], i8, i8[::1], f8[:, ::1], f8[::1], f8[::1], f8[::1], i8[::1], f8[::1], i8[::1], "
    "UniTuple(i8, 6), i8, f8, f8, f8[:, ::1], f8[:, :, ::1], f8[:, ::1], i8[::1])"
)
def _judge(
    xy: Floats,
    now: int,
    path_of: Ints,
    path_direction: Floats,
    direction_variance: Floats,
    sigma_norm: Floats,
    rate_hz: Floats,
    n_frames: Ints,
    along_sigma_hz: Floats,
    no_direction: Ints,
    judgements: tuple[int, ...],
    least_frames: int,
    infinity_cosine: float,
    significant_chi2: float,
    abc_hz: Floats,
    cov: Floats,
    direction: Floats,
    status: Ints,
) -> None:
    """Fills ``direction (N, 3)`` and ``status (N,)``; without a result, ``abc_hz (N, 3)`` and ``cov`` become NaN.

    ``judgements`` are the numbers of `_JUDGEMENTS`, ``no_direction (N,)`` those of tracks without a path.
    """
    short, at_epipole, no_parallax, not_rigid, at_infinity, ok = judgements
    for i in range(len(path_of)):
        k = path_of[i]
        if not np.isfinite(xy[now, i, 0]) or (k >= 0 and n_frames[i] < least_frames):
            status[i] = short
        elif k < 0:
            status[i] = no_direction[i]
        elif not np.isfinite(rate_hz[i]) or _is_at_epipole(
            xy[:, i], now, path_direction[k], significant_chi2 * (sigma_norm[i] ** 2 + direction_variance[k])
        ):
            status[i] = at_epipole
        # Along its path: how sure it is that a track moves at all, and forwards.
        elif abs(rate_hz[i]) < _RATE_SIGMAS * along_sigma_hz[i]:
            status[i] = no_parallax
        elif rate_hz[i] < 0.0:
            status[i] = not_rigid
        else:
            speed_hz = np.sqrt(abc_hz[i, 0] ** 2 + abc_hz[i, 1] ** 2 + abc_hz[i, 2] ** 2)
            for j in range(3):
                direction[i, j] = abc_hz[i, j] / speed_hz
            status[i] = at_infinity if abs(direction[i, 2]) < infinity_cosine else ok
            continue
        abc_hz[i], cov[i] = np.nan, np.nan


@compiled
def _is_at_epipole(xy: Floats, now: int, e: Floats, variance: float) -> bool:
    """Whether the first and the last of the views ``(L, 2)`` lie on the line along e within a variance (rad^2).

    As `geometry.paper.two_view_state.is_at_epipole`: abs(ray x e) over abs(ray) is the sine of their angle.
    """
    first = 0
    while not np.isfinite(xy[first, 0]):
        first += 1
    for place in (first, now):
        x, y = xy[place, 0], xy[place, 1]
        cx, cy, cz = y * e[2] - e[1], e[0] - x * e[2], x * e[1] - y * e[0]
        if not cx * cx + cy * cy + cz * cz < (x * x + y * y + 1.0) * variance:
            return False
    return True


def _misfit(path_of: Ints, rates: PathRates, count: int) -> Floats:
    """By how much the variances (K,) of paths have to be larger (Birge's ratio): their tracks fit worse than noise."""
    misfit = np.empty(count)
    _fill_misfits(path_of, rates.chi2, rates.dof, misfit)
    return misfit


@compiled_for("(i8[::1], f8[::1], i8[::1], f8[::1])")
def _fill_misfits(path_of: Ints, chi2: Floats, dof: Ints, misfit: Floats) -> None:
    """Fills ``misfit (K,)`` of `_misfit`."""
    dof_sum = np.zeros(len(misfit))
    misfit[:] = 0.0
    for i in range(len(path_of)):
        if path_of[i] >= 0:
            misfit[path_of[i]] += chi2[i]
            dof_sum[path_of[i]] += dof[i]
    for k in range(len(misfit)):
        misfit[k] = max(misfit[k] / max(dof_sum[k], 1.0), 1.0)


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
        has_covariance=False,
    )
    _judge_free(
        free,
        (found.state, found.info_w, found.chi2, found.n_frames),
        window_gates(config.max_frames, 2 * LEAST_FRAMES - 1, config.window_probability),
        np.ascontiguousarray(history.rotation_rate_cov),
        _JUDGED,
        (LEAST_FRAMES, 2 if plane is not None else LEAST_FRAMES),
        INFINITY_COSINE,
        _NO_MOTION_CHI2,
        (states.abc_hz, states.cov, states.direction, states.status),
    )


@compiled_for(
    "(i8[::1], Tuple((f8[:, ::1], f8[:, :, ::1], f8[::1], i8[::1])), f8[::1], f8[:, ::1], UniTuple(i8, 6), "
    "UniTuple(i8, 2), f8, f8, Tuple((f8[:, ::1], f8[:, :, ::1], f8[:, ::1], i8[::1])))"
)
def _judge_free(
    free: Ints,
    found: tuple[Floats, Floats, Floats, Ints],
    gates: Floats,
    rotation_cov: Floats,
    judgements: tuple[int, ...],
    least: tuple[int, int],
    infinity_cosine: float,
    no_motion_chi2: float,
    states: tuple[Floats, Floats, Floats, Ints],
) -> None:
    """Fills the statuses of the tracks of ``free (M,)``, and the states of those that have one.

    ``found`` are state, info_w, chi2 and n_frames of `WholeTracks`, ``judgements`` the numbers of `_JUDGEMENTS`,
    ``least`` the views that a window has and those that a state needs, ``states`` what is filled of `TrackStates`.
    """
    short, _, no_parallax, not_rigid, at_infinity, ok = judgements
    state, info_w, chi2, n_frames = found
    abc_hz, cov, direction, status = states
    least_window, least_views = least
    # Scratch of the covariance.
    root, turn = np.zeros((3, 3)), np.zeros((3, 3))
    for m in range(len(free)):
        i, moved, square = free[m], 0.0, 0.0
        for j in range(3):
            square += state[m, 2 + j] * state[m, 2 + j]
            for k in range(3):
                moved += state[m, 2 + j] * info_w[m, j, k] * state[m, 2 + k]
        if n_frames[m] < least_views:
            status[i] = short
        elif not moved > no_motion_chi2:
            status[i] = no_parallax
        elif chi2[m] > gates[max(n_frames[m], least_window)]:
            status[i] = not_rigid
        else:
            for j in range(3):
                abc_hz[i, j], direction[i, j] = state[m, 2 + j], state[m, 2 + j] / np.sqrt(square)
            status[i] = at_infinity if abs(direction[i, 2]) < infinity_cosine else ok
            _set_free_covariance(info_w, state, m, rotation_cov, root, turn, cov, i)


@compiled
def _set_free_covariance(
    info_w: Floats, state: Floats, m: int, rotation_cov: Floats, root: Floats, turn: Floats, cov: Floats, i: int
) -> None:
    """Fills ``cov[i]`` of the velocity of the free track m: by its views, and by a turn left in these.

    The first is the inverse of ``info_w[m] (3, 3)``, by Cholesky factors. A turn that is not there moves a point as a
    velocity of (its rate, of covariance ``rotation_cov (3, 3)``) x (the ray) would.
    """
    aa, ab, ac = info_w[m, 0, 0], info_w[m, 1, 0], info_w[m, 2, 0]
    # The inverse of the lower factor.
    root[0, 0] = 1.0 / np.sqrt(aa)
    b_a, c_a = ab * root[0, 0], ac * root[0, 0]
    root[1, 1] = 1.0 / np.sqrt(max(info_w[m, 1, 1] - b_a * b_a, _ROUNDING * info_w[m, 1, 1]))
    c_b = (info_w[m, 2, 1] - c_a * b_a) * root[1, 1]
    root[2, 2] = 1.0 / np.sqrt(max(info_w[m, 2, 2] - c_a * c_a - c_b * c_b, _ROUNDING * info_w[m, 2, 2]))
    root[1, 0], root[2, 1] = -b_a * root[0, 0] * root[1, 1], -c_b * root[1, 1] * root[2, 2]
    root[2, 0] = -(c_a * root[0, 0] + c_b * root[1, 0]) * root[2, 2]
    x, y = state[m, 0], state[m, 1]
    turn[0, 1], turn[0, 2], turn[1, 2] = -1.0, y, -x
    turn[1, 0], turn[2, 0], turn[2, 1] = 1.0, -y, x
    for j in range(3):
        for k in range(3):
            total = 0.0
            for p in range(3):
                total += root[p, j] * root[p, k]
                for q in range(3):
                    total += turn[j, p] * rotation_cov[p, q] * turn[k, q]
            cov[i, j, k] = total
