"""Own motion of a camera that may go anywhere, from all views of a window, and which tracks follow it.

Nothing is known of how such a camera moves, and movers may hold most of the tracks: but they hold few parts of the
picture, and leave the scene's path within some views. Each part therefore counts once, all views decide, and where
the path found explains too few parts, paths of random tracks are tried beside it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ttcvid.geometry.estimation.relative_pose import GaussianPrior, fit_motion
from ttcvid.geometry.estimation.rigid_motion import Points, RigidPaths, fit_on_paths, views_by_track
from ttcvid.geometry.estimation.window_bundle import WindowFit, adjust_window, fitted_robustly, planar_dual
from ttcvid.geometry.medians import median
from ttcvid.geometry.paper.flow_line import flow_line_chi2
from ttcvid.geometry.rotation import normalize, rotation_from_vector, vector_from_rotation
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.egomotion.motion_prior import FORWARD_DIR, SceneWindow
from ttcvid.stages.egomotion.relative_pose import Egomotion, picture_region, region_side_of
from ttcvid.stages.tracking.history import TrackHistory

# A track follows a path with a smaller reduced chi-square, and a step within so many sigmas.
_GATE_REDCHI, _SIGMAS = 6.0, 3.0
# A track is judged by this quantile of its squared residuals over that of noise (chi-square, two degrees of freedom).
_SHARE, _SHARE_CHI2 = 0.6, 1.83
# With fewer views than this a track follows any path.
_LEAST_VIEWS = 4
LEAST_TOLD = 6
"""Views from which on a direction is known: of five it is off by more than 20 deg in every third drawn scene."""
# Tracks that a path needs, and how many at most determine it.
_LEAST_TRACKS, _MOST_TRACKS = 12, 100
# Steps of the adjustment where a path is carried on, where it starts anew, and of the planar dual: these show which of
# the two is right, and the next frame goes on from it.
_STEPS, _FIRST_STEPS, _DUAL_STEPS = 6, 15, 3
# Shares of the parts of the picture: no other path is tried where this one and the known movers explain the first, and
# this one alone the second.
_EXPLAINED, _LEAST_EXPLAINED = 0.9, 0.5
# Where it explains less than this, it may be that of a mover: its direction is not told.
_LEAST_KNOWN = 0.6
# Another path replaces this one if its cost is lower by this much; the cost is 1 where it explains nothing.
_MARGIN = 0.05
# The planar dual replaces a motion if the sum of capped squares falls by this: noise alone makes it the cheaper one by
# up to 20, and the direction would jump to and fro.
_SURELY_LESS = 25.0
# Other paths start from two views so far apart, over which this share of the tracks is seen.
_GAP_FRAMES, _LEAST_SEEN = 8, 0.6
# Samples a frame, tracks of each (five determine a motion), and how many of the best are refined.
_N_SAMPLES, _SAMPLE_SIZE, _N_REFINED = 12, 7, 3
# Gates of the refinement, one after the other, sigmas: a sample's motion is off by a few.
_GATES = (12.0, 6.0, 4.0, _SIGMAS)
# A path whose direction has a larger standard deviation by noise is none, rad; with what the tracks err in common the
# direction of a result has a smaller one, and two views show the same direction within twice that.
_KNOWN_DIRECTION_RAD, _TOLD_DIRECTION_RAD = float(np.radians(20.0)), float(np.radians(10.0))
# Over a window the common error of tracks looks like a translation that moves them by so many times it, 0.6 px: drawn
# hand-held and hovering cameras err in direction by about that over the flow of their window.
_COMMON_ERRORS = 2.4
# A lens that nobody measured bends the flow of a turn by this part of it: distortion of some per cent.
_LENS_ERROR = 0.05
# Steps of the fit of a turn to flow.
_TURN_STEPS = 3
_TINY = 1e-9


@dataclass(frozen=True)
class _Tracks:
    """N tracks over the window: the history, views by track, free ones, those of no known mover, parts of the picture.

    ``seen (M,)`` are the free ones of the present frame, ``region (M,)`` the part of the picture each is in.
    """

    history: TrackHistory
    by_track: Floats
    in_scene: Bools
    seen: Ints
    region: Ints

    def per_part(self, values: Floats | Bools) -> float:
        """Mean over the parts of the picture of the mean of ``values (M,)`` in each."""
        weight = 1.0 / np.bincount(self.region)[self.region]
        return float(weight @ values / weight.sum())


_Motion = tuple[Floats, Floats]


def by_window(
    history: TrackHistory,
    is_free: Bools,
    in_scene: Bools,
    tells: Bools,
    before: SceneWindow | None,
    step: Egomotion,
    turn_sigma_rad: float,
    least_parallax_rad: float,
) -> Egomotion:
    """Own motion by all views of the scene's tracks; ``step`` with too few of them.

    Parameters
    ----------
    history : views of all tracks, with the rotation of the last step.
    is_free, in_scene : (N,) tracks not frozen to a pixel, and those of no known mover.
    tells : (N,) those that determined ``step``.
    before : the window of the last frame.
    step : own motion from the last frame by two views, a start.
    turn_sigma_rad : prior of the rotation of a step.
    least_parallax_rad : flow that does not count as translation.
    """
    seen = np.flatnonzero(is_free & np.isfinite(history.rays[-1, :, 0]))
    if len(seen) < _LEAST_TRACKS or len(history.frame) < 2:
        return step
    region = picture_region(history.rays[-1, seen], region_side_of(history.camera))
    tracks = _Tracks(history, views_by_track(history.rays), in_scene, seen, region)
    outside = np.zeros(history.n_tracks, dtype=bool) if before is None else before.leaves_out(history.track_id)
    paths = None if before is None else _carried(history, before, step)
    if paths is None:
        paths = _straight(history, history.cam_R_past, FORWARD_DIR if step.direction is None else step.direction)
    fit = _adjusted(tracks, paths, tells, _STEPS if before is not None else _FIRST_STEPS)
    redchi = _redchis(tracks, paths if fit is None else fit.paths)
    # Known movers, which no path has to explain, do not fill most of the picture.
    explained_part = 0.0 if fit is None else tracks.per_part(redchi < _GATE_REDCHI)
    if fit is None or _share(tracks, redchi) < _EXPLAINED or explained_part < _LEAST_EXPLAINED:
        other = _other(tracks, tells, turn_sigma_rad)
        if other is not None:
            redchi_of_other = _redchis(tracks, other.paths)
            if fit is None or _cost(tracks, redchi_of_other) < _cost(tracks, redchi) - _MARGIN:
                fit, redchi = other, redchi_of_other
    if fit is None:
        return step
    outside[seen] = redchi > _GATE_REDCHI
    is_scene = _share(tracks, redchi) >= _LEAST_KNOWN
    return _result(history, fit, step, outside, is_scene, least_parallax_rad)


def _carried(history: TrackHistory, before: SceneWindow, step: Egomotion) -> RigidPaths | None:
    """The path of the last frame as the present camera sees it, gone on as it went."""
    stays = np.isin(before.frame, history.frame[:-1])
    if np.count_nonzero(stays) != len(history.frame) - 1 or np.count_nonzero(stays) < 2:
        return None
    cam_R_past, path = before.paths.cam_R_past[0, stays], before.paths.path[0, stays]
    (before_s, last_s), now_s = history.t_s[-3:-1], history.t_s[-1]
    ahead = path[-2] * (now_s - last_s) / (last_s - before_s)
    rotation = np.concatenate([step.cam_R_prev @ cam_R_past, np.eye(3)[None]])
    return RigidPaths(rotation[None], np.concatenate([(path + ahead) @ step.cam_R_prev.T, np.zeros((1, 3))])[None])


def _straight(history: TrackHistory, cam_R_past: Floats, direction: Floats) -> RigidPaths:
    return RigidPaths(cam_R_past[None], (history.since_s[:, None] * direction)[None])


def _points(tracks: _Tracks, index: Ints) -> Points:
    history = tracks.history
    return Points(tracks.by_track, history.sigma_norm, history.since_s, index, np.zeros(len(index), dtype=np.int64))


def _redchis(tracks: _Tracks, paths: RigidPaths) -> Floats:
    """How badly each present track (M,) follows a path: a quantile of its squared residuals, 1 by noise alone.

    With too few views it is 0. The mean would not do: of some tracks every third observation is displaced.
    """
    history = tracks.history
    fit = fit_on_paths(_points(tracks, tracks.seen), paths)
    ray = np.column_stack([fit.place, np.ones(len(fit.place))])
    there = (ray + fit.rate_hz[:, None] * paths.path[0][:, None]) @ paths.cam_R_past[0]
    rays = history.rays[:, tracks.seen]
    with np.errstate(divide="ignore", invalid="ignore"):
        off = (there[..., :2] / there[..., 2:] - rays[..., :2] / rays[..., 2:]) / history.sigma_norm[tracks.seen, None]
    square = np.sort((off * off).sum(axis=2), axis=0)
    n_views = np.isfinite(square).sum(axis=0)
    at = np.maximum(np.ceil(_SHARE * n_views).astype(np.int64) - 1, 0)
    return np.where(n_views >= _LEAST_VIEWS, square[at, np.arange(len(at))] / _SHARE_CHI2, 0.0)


def _cost(tracks: _Tracks, redchi: Floats) -> float:
    return tracks.per_part(np.minimum(redchi / _GATE_REDCHI, 1.0))


def _share(tracks: _Tracks, redchi: Floats) -> float:
    """Share of the parts of the picture that follow a path, or belong to known movers."""
    return tracks.per_part((redchi < _GATE_REDCHI) | ~tracks.in_scene[tracks.seen])


def _adjusted(tracks: _Tracks, paths: RigidPaths, tells: Bools, n_steps: int) -> WindowFit | None:
    """The path by the tracks that ``tells (N,)`` marks, of each part of the picture as many; None with too few."""
    history = tracks.history
    n_views = np.isfinite(history.rays[:, tracks.seen, 0]).sum(axis=0)
    used = np.flatnonzero(tells[tracks.seen] & (n_views >= min(_LEAST_VIEWS, len(history.frame)) - 1))
    longest = used[np.lexsort((-n_views[used], tracks.region[used]))]
    place = np.arange(len(longest)) - np.searchsorted(tracks.region[longest], tracks.region[longest])
    used = tracks.seen[longest[np.argsort(place, kind="stable")[:_MOST_TRACKS]]]
    fit = fit_on_paths(_points(tracks, used), paths)
    is_fit = np.isfinite(fit.rate_hz)
    used = used[is_fit]
    if len(used) < _LEAST_TRACKS:
        return None
    xy = history.rays[:, used, :2] / history.rays[:, used, 2:]
    region = tracks.region[np.searchsorted(tracks.seen, used)]
    point = np.column_stack([fit.place[is_fit], fit.rate_hz[is_fit]])
    observed = xy, history.sigma_norm[used], region
    found = adjust_window(*observed, paths, point, n_steps)
    # Flat ground leaves two motions: tried in each frame, since the wrong one is carried on as well as the right one.
    if dual := planar_dual(found):
        other = adjust_window(*observed, *dual, _DUAL_STEPS)
        found = other if other.cost < found.cost - _SURELY_LESS else found
    length = float(np.sqrt((found.paths.path**2).sum(axis=2).max()))
    units = max(-history.since_s[0], _TINY) / max(length, _TINY)
    paths = RigidPaths(found.paths.cam_R_past, found.paths.path * units)
    return replace(found, paths=paths, point=found.point / (1.0, 1.0, units))


def _result(
    history: TrackHistory, fit: WindowFit, step: Egomotion, outside: Bools, is_scene: bool, least_parallax_rad: float
) -> Egomotion:
    """Own motion of the last step."""
    parallax_rad, is_measured = _parallax_rad(fit), not (history.camera.is_assumed or history.camera.is_found)
    turned_rad = float(np.linalg.norm(vector_from_rotation(fit.paths.cam_R_past[0, 0])))
    bent_rad = 0.0 if is_measured else _LENS_ERROR * turned_rad
    is_sure = np.trace(fit.direction_cov) < _KNOWN_DIRECTION_RAD**2 and len(history.frame) >= LEAST_TOLD
    is_known = bool(is_scene and is_sure and parallax_rad > least_parallax_rad + bent_rad)
    direction = normalize(-fit.paths.path[0, -2:-1])[0]
    common_rad = _COMMON_ERRORS * history.common_error_px / history.focal_px + bent_rad
    across = np.eye(3) - np.outer(direction, direction)
    cov = fit.direction_cov + 0.5 * (common_rad / max(parallax_rad, _TINY)) ** 2 * across
    agree = step.direction is not None and direction @ step.direction > math.cos(2.0 * _TOLD_DIRECTION_RAD)
    return replace(
        step,
        cam_R_prev=fit.paths.cam_R_past[0, -2],
        rotation_cov=fit.rotation_cov,
        direction=direction if is_known else None,
        direction_cov=cov if is_known else None,
        gap_frames=1,
        window=SceneWindow(history.frame, fit.paths, history.track_id[outside]),
        is_told=bool(is_known and agree and np.trace(cov) < _TOLD_DIRECTION_RAD**2),
    )


def _parallax_rad(fit: WindowFit) -> float:
    """Median flow of the points by translation from the farthest view, as far as no turn explains it.

    Past a wall a translation looks like a turn, and what differs is what the lens bends, too.
    """
    x, y = fit.point[:, :2].T
    path = fit.paths.path[0]
    start = path[(path * path).sum(axis=1).argmax()]
    flow = fit.point[:, 2:] * (start[:2] - fit.point[:, :2] * start[2])
    # Flow by a turn about each axis (Longuet-Higgins and Prazdny, 1980).
    by_turn = np.stack([[x * y, -(1.0 + x * x), y], [1.0 + y * y, -x * y, -x]]).transpose(2, 0, 1)
    return median(fitted_robustly(by_turn, flow, _TURN_STEPS)[1])


def _other(tracks: _Tracks, tells: Bools, turn_sigma_rad: float) -> WindowFit | None:
    """The path that the best of some random motions over two views leads to; None without any."""
    history = tracks.history
    gap = _gap(history, tracks.seen)
    if gap == 0:
        return None
    both = np.isfinite(history.rays[-1 - gap, tracks.seen, 0])
    seen, region = tracks.seen[both], np.unique(tracks.region[both], return_inverse=True)[1]
    before, now, sigma = history.rays[-1 - gap, seen], history.rays[-1, seen], history.sigma_rad[seen]
    start_R = history.cam_R_past[-1 - gap]
    prior = GaussianPrior(vector_from_rotation(start_R), np.sqrt(gap) * turn_sigma_rad)
    weight = 1.0 / np.bincount(region)[region]

    def fitted(used: Ints, motion: _Motion) -> _Motion:
        none = np.zeros(len(used), dtype=np.int64)
        fit = fit_motion(before[used], now[used], sigma[used], none, prior, *motion)
        return fit.cam_R_prev, motion[1] if fit.direction is None else fit.direction

    def chi2_of(motion: _Motion) -> Floats:
        turned = before @ motion[0].T
        is_behind = (now - turned) @ motion[1] < -_SIGMAS * sigma
        return np.where(is_behind, np.inf, flow_line_chi2(motion[1], turned, now, sigma))

    def cost_of(motion: _Motion) -> float:
        return float(weight @ np.minimum(chi2_of(motion), _SIGMAS**2))

    def refined(motion: _Motion) -> _Motion:
        for gate in _GATES:
            used = np.flatnonzero(chi2_of(motion) < gate * gate)
            if len(used) < _LEAST_TRACKS:
                break
            motion = fitted(used, motion)
        return motion

    rng = np.random.default_rng(int(history.frame[-1]))
    found = []
    known = np.flatnonzero(tells[seen])
    if len(known) >= _LEAST_TRACKS:
        starts = normalize(rng.normal(size=(_N_REFINED, 3)))
        found += [fitted(known, (start_R, direction)) for start in starts for direction in (start, -start)]
    for _ in range(_N_SAMPLES):
        order = rng.permutation(len(region))
        _, first = np.unique(region[order], return_index=True)
        sample = order[rng.permutation(first)[:_SAMPLE_SIZE]]
        found.append(fitted(sample, (start_R, normalize(rng.normal(size=(1, 3)))[0])))
    best = min([refined(motion) for motion in sorted(found, key=cost_of)[:_N_REFINED]], key=cost_of)
    tells = np.zeros(history.n_tracks, dtype=bool)
    tells[seen[chi2_of(best) < _SIGMAS**2]] = True
    off_rad = vector_from_rotation(best[0] @ start_R.T)
    steps = np.minimum(np.arange(len(history.frame) - 1, -1, -1), gap) / gap
    cam_R_past = rotation_from_vector(off_rad * steps[:, None]) @ history.cam_R_past
    return _adjusted(tracks, _straight(history, cam_R_past, best[1]), tells, _FIRST_STEPS)


def _gap(history: TrackHistory, seen: Ints) -> int:
    """The largest gap over which most of the present tracks are seen; 0: none."""
    for gap in range(min(_GAP_FRAMES, len(history.frame) - 1), 0, -1):
        n_seen = np.count_nonzero(np.isfinite(history.rays[-1 - gap, seen, 0]))
        if n_seen >= max(_LEAST_TRACKS, _LEAST_SEEN * len(seen)):
            return gap
    return 0
