"""The static scene as a body: its path, how that explains each track, and what the road under it contradicts."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ttcvid.config import BodiesConfig
from ttcvid.geometry.estimation.rigid_motion import PathFit, RigidPaths, fit_on_paths
from ttcvid.geometry.estimation.track_on_trajectory import straight_path
from ttcvid.geometry.medians import median
from ttcvid.geometry.rotation import turned_into_plane
from ttcvid.model import SCENE_CLUSTER, Bools, Floats, Ints, Platform
from ttcvid.stages.egomotion.motion_prior import FORWARD_DIR, MOTION_PRIORS
from ttcvid.stages.egomotion.relative_pose import Egomotion, picture_region, region_side_of
from ttcvid.stages.segmentation.bodies import carried_forward, recent_speed, refined_scene, with_unit_speed
from ttcvid.stages.segmentation.body_views import BodyViews
from ttcvid.stages.segmentation.fixed_to_camera import FOLLOWS, ride_odds
from ttcvid.stages.segmentation.road import on_road
from ttcvid.stages.segmentation.road_evidence import RoadMemory, gathered_evidence
from ttcvid.stages.segmentation.speed_changes import change_speed
from ttcvid.stages.tracking.history import TrackHistory

# At most this many tracks refine the scene; those in crowded cells have less weight. Side of the cells, in cells of
# the egomotion; Gauss-Newton steps.
_ENOUGH_TRACKS, _CELLS, _SCENE_STEPS = 400, 1.2, 2
# Own speed does not fall below this part of its value at the start of the window, so that it can rise again.
_LEAST_SPEED = 0.1
# A rate above so many of its standard deviations is no standstill.
_MOVES_SIGMAS = 3.0
# A camera moves where more than this share of the parts of the picture show it. A car often waits, and one lorry fills
# 40 % of them; a hand that holds a camera is seldom still, and most of what it sees is far away.
_LEAST_MOVING, _LEAST_MOVING_FREE = 0.5, 0.25
# A single pair of frames tells the direction to some degrees: within 20 deg of ahead it is ahead.
_AHEAD_COSINE = float(np.cos(np.radians(20.0)))
# The median reduced chi-square is that of tracks with more views than this.
_USUAL_VIEWS = 3
# A track with more evidence against the static scene than this contradicts it.
_ENOUGH_EVIDENCE = 0.5
# A mover stays one, however well the scene explains it, while the road contradicts its tracks by this on the average.
_MOVER_EVIDENCE = 0.25
# A track with less evidence of its own than this is no part of such a mover, unless it is too young to have any and not
# on the road.
_LEAST_EVIDENCE = 0.1
# Misfits under 1 (in units of the scene's median) are noise.
_LEAST_REDCHI, _LEAST_MEASURED = 1.0, 10
# What steps farther than this before a camera on a mast is not the street, px.
_STILL_STEP_PX = 1.0
# What has stood still over so many views has stopped.
_STOPPED_VIEWS = 5


@dataclass(frozen=True)
class SeenScene:
    """The scene of a frame, and how it explains the N tracks.

    Its path ``scene`` in units of which own ``speed`` is one; ``rate_hz (N,)`` of each track on it, and the ``fit`` of
    each: of a scene at rest, without motion. ``redchi (N,)``, in units of what is usual, ``median_redchi``, with
    what the ``road`` contradicts raised above ``seen_redchi (N,)``; ``camera_rests`` on a mast, as was told: then the
    scene has no motion that could be wrong; ``ride_odds (N,)`` log odds that a track is fixed to the camera.
    """

    scene: RigidPaths
    speed: float
    rate_hz: Floats
    fit: PathFit
    redchi: Floats
    seen_redchi: Floats
    median_redchi: float
    road: RoadMemory
    camera_rests: bool
    ride_odds: Floats

    def residual_px2(self, views: BodyViews) -> Floats:
        """Mean squared residual ``(N,)`` of a coordinate of each track in the scene beyond its noise, px^2."""
        sigma_px = views.sigma_norm / views.plane_per_px
        return np.asarray(np.maximum(self.seen_redchi * self.median_redchi - 1.0, 0.0) * sigma_px**2)


@dataclass(frozen=True)
class TrackLabels:
    """N tracks: the body ``key (N,)`` that each is in, and its rate ``rate_hz (N,)`` on the path of that, or NaN."""

    key: Ints
    rate_hz: Floats


def see_scene(
    history: TrackHistory,
    egomotion: Egomotion,
    platform: Platform,
    before: RigidPaths | None,
    road_before: RoadMemory,
    views: BodyViews,
    labels: TrackLabels,
    config: BodiesConfig,
) -> SeenScene:
    """The scene, corrected by its tracks: from that of the last frame, ``before``, and the ``labels`` they had then."""
    is_free, key, can_translate = views.is_free, labels.key, platform != Platform.static
    region = picture_region(history.rays[-1], _CELLS * region_side_of(history.camera))
    scene = _scene(history, egomotion, can_translate, before, views, region, labels)
    scene, speed = with_unit_speed(scene, views.since_s)
    every = views.points(np.arange(len(key)))
    fit = fit_on_paths(every, scene, labels.rate_hz * speed)
    rate_hz = fit.rate_hz
    is_sure = platform == Platform.aircraft or np.isfinite(history.scene_direction).any()
    way, prior = scene.path[0, 0], MOTION_PRIORS[platform]
    least_moving = _LEAST_MOVING_FREE if prior.is_open else _LEAST_MOVING
    passes = is_sure or (_moves_past(fit, region, is_free, least_moving) and not prior.excludes(way))
    if not passes:
        fit = fit_on_paths(every, replace(scene, path=np.zeros_like(scene.path)))
    may_rest = is_free if can_translate else _steps_little(views, scene)
    if egomotion.window is not None:
        may_rest = may_rest & ~egomotion.window.leaves_out(history.track_id)
    # What the model does not know of, beyond the noise of the scene's tracks.
    usual = fit.redchi[(key == SCENE_CLUSTER) & is_free & may_rest & (fit.n_views > _USUAL_VIEWS)]
    median_redchi = max(median(usual), _LEAST_REDCHI) if len(usual) > _LEAST_MEASURED else _LEAST_REDCHI
    redchi = seen_redchi = fit.redchi / median_redchi
    if not can_translate:
        redchi = seen_redchi = _with_stopped(redchi, views, scene)
    road = RoadMemory()
    if platform == Platform.vehicle and scene.path[0, 0, 2] > 0.0:
        in_scene = (key == SCENE_CLUSTER) & is_free & (redchi < config.scene_gate)
        aim = scene.path[0, 0, :2] / scene.path[0, 0, 2]
        # What moves as the scene does belongs together by its depth alone, whatever was taken for a part of it.
        alike = np.where(redchi < config.scene_gate, SCENE_CLUSTER, key)
        # Inverse depths are speed over depth, and shrink where we brake.
        before_hz = road_before.seen.rate_hz * speed
        road_before = replace(road_before, seen=replace(road_before.seen, rate_hz=before_hz))
        road = gathered_evidence(road_before, history.track_id, views, fit, alike, in_scene, aim)
        is_road = on_road(fit, road.road)
        changes = change_speed(views, scene, fit, key, (redchi < config.scene_gate) & ~is_road)
        road = replace(road, by_speed=np.where(changes, 1.0, road.by_speed))
        redchi = _with_contradictions(redchi, road, is_road, key, fit.n_views, config)
    rides = ride_odds(views, scene.cam_R_past[0], scene_passes=passes and can_translate)
    if not can_translate:
        # Most of what a mast sees stays on its pixel: only what is seen to shake with the camera is fixed to it.
        rides = np.where(rides > FOLLOWS, rides, -np.inf)
    return SeenScene(scene, speed, rate_hz, fit, redchi, seen_redchi, median_redchi, road, not can_translate, rides)


def _scene(
    history: TrackHistory,
    egomotion: Egomotion,
    can_translate: bool,
    before: RigidPaths | None,
    views: BodyViews,
    region: Ints,
    labels: TrackLabels,
) -> RigidPaths:
    """The scene on its way, corrected by its tracks; ``region (N,)`` the part of the picture that each is in."""
    if egomotion.window is not None:
        return egomotion.window.paths
    if before is None or len(history.t_s) < 2:
        # Before the parallax shows well where it goes, a camera that can move is taken to move ahead, if roughly.
        seen = egomotion.direction
        way = FORWARD_DIR if seen is None or seen @ FORWARD_DIR > _AHEAD_COSINE else seen
        ahead = straight_path(way, history.since_s) if can_translate else np.zeros((len(views.t_s), 3))
        scene = RigidPaths(history.cam_R_past[None], ahead[None])
    else:
        step = None
        if egomotion.direction is not None:
            dt_s = views.t_s[-1] - views.t_s[-2]
            step = -egomotion.direction * dt_s * max(recent_speed(before.path[0], views.t_s[:-1]), _LEAST_SPEED)
        path = carried_forward(before, egomotion.cam_R_prev, views.t_s, step).path
        if egomotion.direction is not None:
            path = _without_unseen_return(history, path[0])[None]
        # Own motion has corrected the rotations of the last frames by its own means: those are taken over.
        scene = RigidPaths(history.cam_R_past[None], path)
    used = np.flatnonzero(views.is_free)
    used = np.ascontiguousarray(used[:: max(1, -(-len(used) // _ENOUGH_TRACKS))])
    # By how many share a part of the picture: one textured lorry is not the world.
    weight = 1.0 / np.sqrt(np.bincount(region[used])[region[used]])
    in_scene = labels.key[used] == SCENE_CLUSTER
    return refined_scene(scene, views.points(used), weight, in_scene, labels.rate_hz[used], _SCENE_STEPS)


def _without_unseen_return(history: TrackHistory, path: Floats) -> Floats:
    """The path ``(L, 3)`` without steps in which no travel was seen and that go against the present one.

    A camera at rest is carried on along its last direction: where it then starts the other way, that was not so.
    """
    steps = np.diff(path, axis=0)
    unseen = np.isnan(history.scene_direction[1:, 0])
    steps[unseen & (steps @ steps[-1] < 0.0)] = 0.0
    return np.append(-np.cumsum(steps[::-1], axis=0)[::-1], path[-1:], axis=0)


def _moves_past(fit: PathFit, region: Ints, is_free: Bools, least_moving: float) -> bool:
    """Whether more than ``least_moving`` of the parts of the picture show that the camera moves past the scene.

    A resting camera's scene has no flow; a lorry that comes nearer would fit a camera that moves towards it.
    """
    known = np.flatnonzero(is_free & (fit.rate_sigma_hz > 0.0))
    moves = fit.rate_hz[known] > _MOVES_SIGMAS * fit.rate_sigma_hz[known]
    n_known, n_moving = np.bincount(region[known]), np.bincount(region[known], moves)
    return bool(np.count_nonzero(n_moving > 0.5 * n_known) > least_moving * np.count_nonzero(n_known))


def _steps_little(views: BodyViews, scene: RigidPaths) -> Bools:
    """Tracks (N,) that before a camera on a mast may be those of the street, by their last step."""
    if len(views.rays) < 2:
        return views.is_free
    step = views.rays[-1] - views.rays[-2] @ scene.cam_R_past[0, -2].T
    return np.asarray(np.einsum("ni,ni->n", step, step) < (_STILL_STEP_PX / views.focal_px) ** 2)


def _with_stopped(redchi: Floats, views: BodyViews, scene: RigidPaths) -> Floats:
    """Misfits (N,), before a camera at rest those of tracks that have stopped by their last views alone.

    Over these they have moved by no more than their noise, and would have, had they gone on as before: what moved on
    has left them behind, or has stopped.
    """
    if len(views.rays) <= _STOPPED_VIEWS:
        return redchi
    xy = turned_into_plane(views.rays, scene.cam_R_past[0])
    first = np.argmax(np.isfinite(xy[:, :, 0]), axis=0)
    way, last_way = xy[-1] - xy[first, np.arange(len(first))], xy[-1] - xy[-_STOPPED_VIEWS]
    part = views.since_s[-_STOPPED_VIEWS] / np.minimum(views.since_s[first], views.since_s[-_STOPPED_VIEWS])
    # Of two noisy places, two coordinates each.
    variance = 4.0 * views.sigma_norm**2
    moved, missing = ((one * one).sum(axis=1) / variance for one in (last_way, last_way - part[:, None] * way))
    limit = 0.5 * _MOVES_SIGMAS**2
    # Without a view so long ago (NaN) nothing has stopped.
    return np.where((moved < limit) & (missing > limit), np.minimum(redchi, moved), redchi)


def _with_contradictions(
    redchi: Floats, road: RoadMemory, is_road: Bools, key: Ints, n_views: Ints, config: BodiesConfig
) -> Floats:
    """Misfits on the scene's path, with those raised that road or speed contradict: of single tracks and whole movers.

    Of a mover's young tracks, without evidence yet, those are left out that may lie on the road, ``is_road (N,)``.
    """
    # Of a mover along our way the path explains any track: only what stands or hangs where the mover does is its part.
    evidence = np.maximum(road.evidence, road.by_speed)
    may_be_part = (evidence > _LEAST_EVIDENCE) | ((n_views <= _USUAL_VIEWS) & ~is_road)
    of_mover = np.bincount(key, evidence) > _MOVER_EVIDENCE * np.bincount(key)
    is_odd = (evidence > _ENOUGH_EVIDENCE) | (may_be_part & (key != SCENE_CLUSTER) & of_mover[key])
    return np.where(is_odd, np.maximum(redchi, 2.0 * config.scene_gate), redchi)
