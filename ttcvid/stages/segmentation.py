"""Which tracks move with the static scene, and which with a mover of their own.

Scene and movers are rigid bodies, each with its own path relative to the camera. A track belongs to the body whose path
explains all of its views best, with a say for its neighbours and for where it belonged before. New movers start where
neighbouring tracks contradict the scene together and agree with each other.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ttcvid.config import BodiesConfig
from ttcvid.geometry.compiled import compiled
from ttcvid.geometry.medians import median
from ttcvid.geometry.rigid_path import PathFit, RigidPaths, fit_on_paths
from ttcvid.geometry.whole_track_on_path import straight_path
from ttcvid.model import NO_CLUSTER, SCENE_CLUSTER, Bools, Floats, Ints, Platform
from ttcvid.stages.begun_anew import begun_anew
from ttcvid.stages.belonging import Movers, assigned, is_due, kept, no_movers, numbers_of
from ttcvid.stages.bodies import carried_forward, recent_speed, refined_scene, sway_of, with_unit_speed
from ttcvid.stages.body_views import BodyViews, body_views
from ttcvid.stages.egomotion import FORWARD_DIR, Egomotion, picture_region, region_side_of
from ttcvid.stages.history import TrackHistory
from ttcvid.stages.joining import merged, split
from ttcvid.stages.known_again import known_again, with_velocities
from ttcvid.stages.last_steps import stepped_movers
from ttcvid.stages.new_movers import new_movers
from ttcvid.stages.road import RoadMemory, gathered_evidence, on_road
from ttcvid.stages.sets import places_among
from ttcvid.stages.surface_memory import Obstacle, number_of_taken, without_numbers

# Of more tracks than this only so many correct the scene; those of a crowded place count less: so many times as large
# as the parts of the picture for own motion.
_ENOUGH_TRACKS, _CELLS = 400, 1.2
_SCENE_STEPS = 2
# Own speed does not fall below this part of what it was at the start of the window, so that it can rise again.
_LEAST_SPEED = 0.1
# A rate above so many of its standard deviations is no standstill.
_MOVES_SIGMAS = 3.0
# A single pair of frames tells the direction to some degrees: within 20 deg of ahead it is ahead.
_AHEAD_COSINE = float(np.cos(np.radians(20.0)))
# The usual misfit is that of tracks with more views than this.
_USUAL_VIEWS = 3
# Steps of refinement a frame of a new mover, and of one that has been found in some frames; fewer points than this do
# not refine it.
_YOUNG_STEPS, _YOUNG_FRAMES, _OLD_STEPS, _LEAST_POINTS = 2, 5, 1, 3
# A mover stays one, however well the scene explains it, while the road contradicts its tracks by this on the average.
_MOVER_EVIDENCE = 0.25
# Misfits under 1 (in units of the scene's median) are noise.
_LEAST_MISFIT = 1.0
_LEAST_MEASURED = 10
# What steps farther than this before a camera on a mast is not the street, px.
_STILL_STEP_PX = 1.0


@dataclass(frozen=True)
class BodyMemory:
    """What is known of the last frame: the scene, the movers, and for each track its body and its rate.

    ``obstacles`` are what of the scene stands in our way (`stages.obstacles`), ``growing`` what comes at us
    (`stages.growing`); ``frame (L,)`` the views of the bodies.
    """

    scene: RigidPaths | None = None
    movers: Movers = field(default_factory=lambda: no_movers(0))
    track_id: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    track_key: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    rate_hz: Floats = field(default_factory=lambda: np.empty(0))
    road: RoadMemory = field(default_factory=RoadMemory)
    next_key: int = SCENE_CLUSTER + 1
    next_cluster_id: int = SCENE_CLUSTER + 1
    obstacles: tuple[Obstacle, ...] = ()
    growing: tuple[Obstacle, ...] = ()
    frame: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))


@dataclass(frozen=True)
class Segmentation:
    """The bodies of a frame: ``key (N,)`` of each track's body, the movers, and how the scene explains tracks.

    ``misfit (N,)`` of each track on the scene's path, in units of what is usual there, ``usual_misfit``;
    ``sway (L, 3)`` how far the scene lay off a steady path, 0 before a camera that does not sway.
    """

    key: Ints
    movers: Movers
    scene: RigidPaths
    scene_fit: PathFit
    misfit: Floats
    usual_misfit: float
    sway: Floats


def find_bodies(
    history: TrackHistory,
    egomotion: Egomotion,
    platform: Platform,
    is_free: Bools,
    may_start: Bools,
    memory: BodyMemory,
    link_px: float,
    model_error_px: float,
    config: BodiesConfig,
) -> tuple[Segmentation, BodyMemory]:
    """The scene, corrected, and the movers of a frame.

    Parameters
    ----------
    platform : what carries the camera.
    is_free : (N,) tracks that are not frozen to their pixel.
    may_start : (N,) tracks that a new mover may be made of.
    link_px : two tracks are neighbours when they lie closer than this, px.
    model_error_px : error of a position that no track's noise knows of: lens, shutter, focal length.
    """
    views = body_views(history, is_free, link_px, model_error_px)
    memory = _over_views(memory, history.frame)
    key, rate_hz = _carried_labels(memory, history.track_id)
    is_continued = len(history.t_s) > 1 and memory.scene is not None
    if not (is_continued and len(memory.movers)):
        movers = no_movers(len(history.t_s))
    else:
        paths = carried_forward(memory.movers.paths, egomotion.cam_R_prev, views.t_s)
        where = memory.movers.where.carried_forward(egomotion.cam_R_prev, paths.path[:, -2])
        velocity = memory.movers.velocity.carried_forward(
            egomotion.cam_R_prev, memory.movers.where.centre, views.t_s[-1] - views.t_s[-2]
        )
        movers = replace(memory.movers, paths=paths, where=where, velocity=velocity)
    known = np.append(SCENE_CLUSTER, movers.key)
    key[known[numbers_of(key, movers)] != key] = SCENE_CLUSTER
    region = picture_region(history.rays[-1], _CELLS * region_side_of(history.camera))
    last_scene = memory.scene if is_continued else None
    scene = _scene(history, egomotion, platform != Platform.static, last_scene, views, region, rate_hz, key)
    scene, speed = with_unit_speed(scene, views.since_s)
    memory, rate_hz = replace(memory, rate_hz=memory.rate_hz * speed), rate_hz * speed
    every = views.points(np.arange(len(key)))
    scene_fit = fit_on_paths(every, scene, rate_hz)
    rate_hz = scene_fit.rate_hz
    is_sure = platform == Platform.aircraft or np.isfinite(history.scene_direction).any()
    moves_past = _moves_past(scene_fit, region, is_free)
    rests = not is_sure and not moves_past
    if rests:
        scene_fit = fit_on_paths(every, replace(scene, path=np.zeros_like(scene.path)))
    may_rest = _steps_little(views, scene) if platform == Platform.static else is_free
    usual = _usual_misfit(scene_fit, (key == SCENE_CLUSTER) & is_free & may_rest)
    misfit = seen_misfit = scene_fit.misfit / usual
    road = RoadMemory()
    if platform == Platform.vehicle and scene.path[0, 0, 2] > 0.0:
        in_scene = (key == SCENE_CLUSTER) & is_free & (misfit < config.scene_gate)
        epipole_y = float(scene.path[0, 0, 1] / scene.path[0, 0, 2])
        # What moves as the scene does belongs together by its depth alone, whatever was taken for a part of it.
        alike = np.where(misfit < config.scene_gate, SCENE_CLUSTER, key)
        road_before = memory.road.in_units(speed)
        road = gathered_evidence(road_before, history.track_id, views, scene_fit, alike, in_scene, epipole_y)
        misfit = _with_contradictions(misfit, road, on_road(scene_fit, road), key, config)

    movers = _refined(movers, scene, views, key, usual)
    # What belongs to the scene, far from any mover, and does not contradict it, is asked nothing more.
    neighbours = views.neighbours(is_free & (misfit > config.scene_gate), key != SCENE_CLUSTER)
    key, movers, own = assigned(
        views, movers, None if rests else scene, key, neighbours, scene_fit, misfit, seen_misfit, usual
    )
    before = key
    key, movers = kept(views, key, movers, config)
    key, movers = merged(views, scene, key, movers, neighbours, own.misfit, usual)
    # Of what goes to the scene, too, something new may be made.
    has_changed = key != before
    if has_changed.any():
        is_touched = np.zeros(key.max() + 1, dtype=bool)
        is_touched[key[has_changed]] = True
        own = own.without_rates(is_touched[key])
    next_key = memory.next_key
    # In a hand or on a drone a camera sways. On the road what is before us goes round the same bend as we do.
    sways = platform == Platform.free and not rests
    sway = sway_of(scene.path[0], views.since_s) if sways else np.zeros_like(scene.path[0])
    found, paths, found_hz = new_movers(
        views,
        scene,
        sway,
        (key == SCENE_CLUSTER) & may_start,
        scene_fit,
        misfit,
        seen_misfit,
        usual,
        on_road(scene_fit, road),
        # Before a camera that moves past nothing all surfaces flow alike, and nothing slips.
        history.edge if moves_past else np.zeros_like(history.edge),
        neighbours,
        config,
        # In the air what comes straight at us is found as one surface, which few tracks tell the times of.
        few_are_enough=platform != Platform.aircraft,
    )
    if found and len(movers):
        key, movers, is_known = known_again(views, scene, key, movers, found, paths, found_hz, usual)
        found = [members for members, known in zip(found, is_known, strict=True) if not known]
        paths, found_hz = paths.take(~is_known), found_hz[~is_known]
    for count, members in enumerate(found):
        key[members] = next_key + count
    movers, next_key = movers.with_new(next_key, paths, found_hz), next_key + len(found)
    key, movers, next_key = split(views, key, movers, own, next_key, config)
    movers = with_velocities(views, scene, key, movers)
    surfaces = memory.growing + memory.obstacles
    movers, next_cluster_id = _named(movers, key, history.track_id, surfaces, memory.next_cluster_id, config)
    labels = _with_lost(history, memory, key, rate_hz)
    memory = BodyMemory(scene, movers, *labels, road, next_key, next_cluster_id, frame=history.frame)
    return Segmentation(key, movers, scene, scene_fit, misfit, usual, sway), memory


def restarted_bodies(memory: BodyMemory) -> BodyMemory:
    """Nothing known any more, but no number given out twice."""
    return BodyMemory(next_key=memory.next_key, next_cluster_id=memory.next_cluster_id)


def _over_views(memory: BodyMemory, frame: Ints) -> BodyMemory:
    """The bodies over those of their views that the history with the frames ``frame (L,)`` still has."""
    if memory.scene is None or np.array_equal(memory.frame[1 - len(frame) :], frame[:-1]):
        return memory
    stays = np.isin(memory.frame, frame)
    if not stays.any():
        return restarted_bodies(memory)
    movers = replace(memory.movers, paths=memory.movers.paths.over(stays))
    return replace(memory, scene=memory.scene.over(stays), movers=movers)


def _carried_labels(memory: BodyMemory, track_id: Ints) -> tuple[Ints, Floats]:
    """Body and rate that each track had; new ones are with the scene."""
    key, rate_hz = np.full(len(track_id), SCENE_CLUSTER), np.full(len(track_id), np.nan)
    place = places_among(memory.track_id, track_id)
    is_known = place >= 0
    key[is_known], rate_hz[is_known] = memory.track_key[place[is_known]], memory.rate_hz[place[is_known]]
    return key, rate_hz


def _with_lost(history: TrackHistory, memory: BodyMemory, key: Ints, rate_hz: Floats) -> tuple[Ints, Ints, Floats]:
    """All tracks that may be in the next frame, each with its body and rate."""
    if history.lost is None:
        return history.track_id, key, rate_hz
    lost_key, lost_hz = _carried_labels(memory, history.lost.track_id)
    track_id = np.concatenate([history.track_id, history.lost.track_id])
    order = np.argsort(track_id)
    return track_id[order], np.concatenate([key, lost_key])[order], np.concatenate([rate_hz, lost_hz])[order]


def _scene(
    history: TrackHistory,
    egomotion: Egomotion,
    can_translate: bool,
    before: RigidPaths | None,
    views: BodyViews,
    region: Ints,
    rate_hz: Floats,
    key: Ints,
) -> RigidPaths:
    """The scene on its way, corrected by its tracks; ``region, key (N,)``: the part of the picture that each is in, and
    the body that it was in.
    """
    if before is None:
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
        carried = carried_forward(before, egomotion.cam_R_prev, views.t_s, step)
        # Own motion has corrected the rotations of the last frames by its own means: those are taken over.
        path = carried.path
        if egomotion.direction is not None:
            path = _without_unseen_return(history, carried.path[0])[None]
        scene = RigidPaths(history.cam_R_past[None], path)
    used = np.flatnonzero(views.is_free)
    used = used[:: max(1, -(-len(used) // _ENOUGH_TRACKS))]
    weight = _balance(region[used])
    return refined_scene(scene, views.points(used), weight, key[used] == SCENE_CLUSTER, rate_hz[used], _SCENE_STEPS)


def _without_unseen_return(history: TrackHistory, path: Floats) -> Floats:
    """The path ``(L, 3)`` without steps in which no travel was seen and that go against the present one.

    A camera at rest is carried on along its last direction: where it then starts the other way, that was not so.
    """
    steps = np.diff(path, axis=0)
    unseen = np.isnan(history.scene_direction[1:, 0])
    steps[unseen & (steps @ steps[-1] < 0.0)] = 0.0
    return np.append(-np.cumsum(steps[::-1], axis=0)[::-1], path[-1:], axis=0)


def _moves_past(fit: PathFit, region: Ints, is_free: Bools) -> bool:
    """Whether most parts of the picture show that the camera moves past the scene.

    A resting camera's scene has no flow; a lorry that comes nearer would fit a camera that moves towards it.
    """
    known = np.flatnonzero(is_free & (fit.rate_sigma_hz > 0.0))
    if not len(known):
        return False
    moves = fit.rate_hz[known] > _MOVES_SIGMAS * fit.rate_sigma_hz[known]
    here = region[known]
    per_region = np.bincount(here)
    return bool(np.mean(np.bincount(here, moves)[per_region > 0] > 0.5 * per_region[per_region > 0]) > 0.5)


def _balance(region: Ints) -> Floats:
    """Weight of each track by how many share its part of the picture: one textured lorry is not the world."""
    return np.asarray(1.0 / np.sqrt(np.bincount(region)[region]))


def _steps_little(views: BodyViews, scene: RigidPaths) -> Bools:
    """Tracks (N,) that before a camera on a mast may be those of the street, by their last step."""
    if len(views.rays) < 2:
        return views.is_free
    step = views.rays[-1] - views.rays[-2] @ scene.cam_R_past[0, -2].T
    return np.asarray(np.einsum("ni,ni->n", step, step) < (_STILL_STEP_PX / views.focal_px) ** 2)


def _usual_misfit(fit: PathFit, in_scene: Bools) -> float:
    """Median misfit of the scene's tracks: what the model does not know of, beyond their noise."""
    measured = fit.misfit[in_scene & (fit.n_views > _USUAL_VIEWS)]
    return max(median(measured), _LEAST_MISFIT) if len(measured) > _LEAST_MEASURED else _LEAST_MISFIT


def _with_contradictions(misfit: Floats, road: RoadMemory, is_road: Bools, key: Ints, config: BodiesConfig) -> Floats:
    """Misfits on the scene's path, with those raised that the road contradicts: of single tracks and whole movers.

    Not of what lies on the road, ``is_road (N,)``: where that was taken for a part of a mover, it leaves it again.
    """
    least, raised = 2.0 * config.scene_gate, misfit.copy()
    _raise_odd(key, SCENE_CLUSTER, road.evidence, road.contradicts(), least, raised)
    return np.where(is_road, misfit, raised)


@compiled
def _raise_odd(key: Ints, scene: int, evidence: Floats, is_odd: Bools, least: float, misfit: Floats) -> None:
    """Raise each ``misfit (N,)`` to the least one where a track is odd, or the mean evidence against its mover."""
    n_keys = np.max(key) + 1 if len(key) else 0
    sums, counts = np.zeros(n_keys), np.zeros(n_keys)
    for i in range(len(key)):
        sums[key[i]] += evidence[i]
        counts[key[i]] += 1.0
    for i in range(len(key)):
        k = key[i]
        if is_odd[i] or (k != scene and sums[k] > _MOVER_EVIDENCE * counts[k]):
            misfit[i] = max(misfit[i], least)


def _refined(movers: Movers, scene: RigidPaths, views: BodyViews, key: Ints, usual_misfit: float) -> Movers:
    """The movers, each corrected by the tracks that it had."""
    number = numbers_of(key, movers)
    has_points = np.bincount(number, minlength=len(movers) + 1)[1:] >= _LEAST_POINTS
    track = np.flatnonzero(np.append(False, has_points)[number])
    if not len(track):
        return movers
    steps = np.where(movers.n_found < _YOUNG_FRAMES, _YOUNG_STEPS, _OLD_STEPS)
    points = views.points(track, number[track] - 1)
    paths, rate_hz = stepped_movers(movers.paths, scene, points, steps * has_points, movers.rate_hz)
    paths, rate_hz = begun_anew(paths, rate_hz, is_due(movers.n_found), scene, points, usual_misfit)
    return replace(movers, paths=paths, rate_hz=np.where(has_points, rate_hz, movers.rate_hz))


def _named(
    movers: Movers,
    key: Ints,
    track_id: Ints,
    surfaces: tuple[Obstacle, ...],
    next_cluster_id: int,
    config: BodiesConfig,
) -> tuple[Movers, int]:
    """Public numbers for movers that have been found often enough: that of the surface each was before, or a new one.

    Parameters
    ----------
    key, track_id : (N,) body and number of each track.
    surfaces : what was found as one surface up to the last frame.
    """
    asks = (movers.cluster_id == NO_CLUSTER) & (movers.n_found >= config.confirm_frames)
    cluster_id = movers.cluster_id.copy()
    for place in np.flatnonzero(asks):
        left = without_numbers(surfaces, cluster_id)
        number = number_of_taken(left, track_id, np.flatnonzero(key == movers.key[place]))
        cluster_id[place] = next_cluster_id if number is None else number
        next_cluster_id += number is None
    return replace(movers, cluster_id=cluster_id), next_cluster_id
