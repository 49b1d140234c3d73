"""Which tracks move with the static scene, and which with a mover of their own.

Scene and movers are rigid bodies, each with its own path relative to the camera. A track belongs to the body whose path
explains all of its views best, with a say for its neighbours and for where it belonged before. New movers start where
neighbouring tracks contradict the scene together and agree with each other.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ttcvid.config import BodiesConfig
from ttcvid.geometry.rigid_path import PathFit
from ttcvid.geometry.whole_track_on_path import straight_path
from ttcvid.model import SCENE_CLUSTER, Bools, Floats, Ints, Platform
from ttcvid.stages.bodies import Body, carried_forward, recent_speed, refined_scene, with_unit_speed
from ttcvid.stages.body_views import BodyViews, body_views
from ttcvid.stages.connected import connected_parts, linked_pairs
from ttcvid.stages.egomotion import FORWARD_DIR, Egomotion
from ttcvid.stages.history import TrackHistory
from ttcvid.stages.new_movers import new_movers
from ttcvid.stages.road import RoadMemory, gathered_evidence

# Of twice as many tracks and more, only a part corrects the scene; those of a crowded place count less: cells of this
# side, in units of the focal length.
_ENOUGH_TRACKS, _CELL = 400, 0.12
_SCENE_STEPS = 2
# Own speed does not fall below this part of what it was at the start of the window, so that it can rise again.
_LEAST_SPEED = 0.1
# A rate above so many of its standard deviations is no standstill.
_MOVES_SIGMAS = 3.0
# Belonging is decided by ln(1 + misfit), misfits beyond this being equally bad; all neighbours together weigh this
# much, where a track was before this much, and that most of the world stands still this much.
_WORST_MISFIT, _NEIGHBOUR_WEIGHT, _HABIT_WEIGHT, _SCENE_WEIGHT = 50.0, 1.0, 0.3, 0.4
# The habit and the scene's bonus count for tracks with more views than these.
_HABIT_VIEWS, _SCENE_VIEWS = 3, 2
# Two bodies, or two parts of one, are one where their rates differ by less than this factor.
_ONE_RATE = 1.5
# Two movers are one where one motion explains both at most this much worse than two, misfits below 1 being 1; before
# that is tried, the motion of the larger has to explain the smaller within this factor.
_MERGED_MISFIT, _WORTH_TRYING = 2.0, 8.0
# Steps of refinement a frame, of a new mover, of one that has been found in some frames, and of two taken as one.
_YOUNG_STEPS, _YOUNG_FRAMES, _OLD_STEPS, _JOINT_STEPS = 2, 5, 1, 4
_MERGE_FRAMES = 4
# A mover stays one, however well the scene explains it, while the road contradicts its tracks by this on the average.
_MOVER_EVIDENCE = 0.25
# Misfits under 1 (in units of the scene's median) are noise.
_LEAST_MISFIT = 1.0
_LEAST_MEASURED = 10
_TINY_HZ = 1e-9


@dataclass(frozen=True)
class Mover:
    """A mover as remembered: ``key`` is internal, ``cluster_id`` public (None until it has been confirmed)."""

    key: int
    cluster_id: int | None
    n_found: int
    n_missed: int
    body: Body


@dataclass(frozen=True)
class BodyMemory:
    """What is known of the last frame: the scene, the movers, and for each track its body and its rate."""

    scene: Body | None = None
    movers: tuple[Mover, ...] = ()
    track_id: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    track_key: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    rate_hz: Floats = field(default_factory=lambda: np.empty(0))
    road: RoadMemory = field(default_factory=RoadMemory)
    next_key: int = SCENE_CLUSTER + 1
    next_cluster_id: int = SCENE_CLUSTER + 1


@dataclass(frozen=True)
class Segmentation:
    """The bodies of a frame: ``key (N,)`` of each track's body, the movers by key, and how the scene explains tracks.

    ``misfit (N,)`` of each track on the scene's path, in units of what is usual there.
    """

    key: Ints
    movers: dict[int, Mover]
    scene: Body
    scene_fit: PathFit
    misfit: Floats


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
    key, rate_hz = _carried_labels(memory, history.track_id)
    is_continued = len(history.t_s) > 1 and memory.scene is not None
    movers = [_carried(mover, egomotion, views) for mover in memory.movers] if is_continued else []
    key[~np.isin(key, [m.key for m in movers])] = SCENE_CLUSTER
    scene = _scene(
        history, egomotion, platform != Platform.static, memory.scene if is_continued else None, views, key, rate_hz
    )
    scene, rate_hz = with_unit_speed(scene, views.since_s, rate_hz)
    scene_fit = scene.fit(views.rays, views.sigma_norm, rate_hz, 0.0)
    rate_hz = scene_fit.rate_hz
    is_sure = platform == Platform.aircraft or np.isfinite(history.scene_direction).any()
    if not is_sure and not _moves_past(scene_fit, history.rays[-1], is_free):
        scene_fit = replace(scene, path=np.zeros_like(scene.path)).fit(views.rays, views.sigma_norm, None, 0.0)
    usual = _usual_misfit(scene_fit, (key == SCENE_CLUSTER) & is_free)
    misfit = scene_fit.misfit / usual
    road = RoadMemory()
    if platform == Platform.vehicle and scene.path[0, 2] > 0.0:
        in_scene = (key == SCENE_CLUSTER) & is_free & (misfit < config.scene_gate)
        epipole_y = float(scene.path[0, 1] / scene.path[0, 2])
        road = gathered_evidence(memory.road, history.track_id, views, scene_fit, key, in_scene, epipole_y)
        misfit = _with_contradictions(misfit, road, key, config)

    movers = [replace(m, body=_refined_by_own(m, scene, views, key)) for m in movers]
    key = _assigned(views, movers, key, scene_fit.n_views, misfit, usual)
    key, movers = _kept(key, movers, config)
    key, movers = _merged(views, scene, key, movers, usual)
    next_key = memory.next_key
    for members, body in new_movers(
        views, scene, (key == SCENE_CLUSTER) & may_start, scene_fit.n_views, misfit, usual, config
    ):
        key[members] = next_key
        movers.append(Mover(next_key, None, 1, 0, body))
        next_key += 1
    key, movers, next_key = _split(views, key, movers, next_key, config)
    movers, next_cluster_id = _named(movers, memory.next_cluster_id, config)
    memory = BodyMemory(scene, tuple(movers), history.track_id, key, rate_hz, road, next_key, next_cluster_id)
    return Segmentation(key, {m.key: m for m in movers}, scene, scene_fit, misfit), memory


def restarted_bodies(memory: BodyMemory) -> BodyMemory:
    """Nothing known any more, but no number given out twice."""
    return BodyMemory(next_key=memory.next_key, next_cluster_id=memory.next_cluster_id)


def _carried_labels(memory: BodyMemory, track_id: Ints) -> tuple[Ints, Floats]:
    """Body and rate that each track had; new ones are with the scene."""
    key, rate_hz = np.full(len(track_id), SCENE_CLUSTER), np.full(len(track_id), np.nan)
    if len(memory.track_id):
        place = np.minimum(np.searchsorted(memory.track_id, track_id), len(memory.track_id) - 1)
        is_known = memory.track_id[place] == track_id
        key[is_known], rate_hz[is_known] = memory.track_key[place[is_known]], memory.rate_hz[place[is_known]]
    return key, rate_hz


def _carried(mover: Mover, egomotion: Egomotion, views: BodyViews) -> Mover:
    return replace(mover, body=carried_forward(mover.body, egomotion.cam_R_prev, views.t_s))


def _scene(
    history: TrackHistory,
    egomotion: Egomotion,
    can_translate: bool,
    before: Body | None,
    views: BodyViews,
    key: Ints,
    rate_hz: Floats,
) -> Body:
    """The scene on its way, corrected by its tracks."""
    if before is None:
        # Before any parallax shows where it goes, a camera that can move is taken to move ahead.
        ahead = straight_path(FORWARD_DIR, history.since_s) if can_translate else np.zeros((len(views.t_s), 3))
        scene = Body(history.cam_R_past, ahead)
    else:
        step = None
        if egomotion.direction is not None:
            dt_s = views.t_s[-1] - views.t_s[-2]
            step = -egomotion.direction * dt_s * max(recent_speed(before, views.t_s[:-1]), _LEAST_SPEED)
        carried = carried_forward(before, egomotion.cam_R_prev, views.t_s, step)
        # Own motion has corrected the rotations of the last frames by its own means: those are taken over.
        scene = replace(carried, cam_R_past=history.cam_R_past)
    used = np.flatnonzero(views.is_free)
    used = used[:: max(1, len(used) // _ENOUGH_TRACKS)]
    weight = _balance(history.rays[-1, used])
    return refined_scene(
        scene, views.rays[:, used], views.sigma_norm[used], weight, rate_hz[used], views.since_s, _SCENE_STEPS
    )


def _moves_past(fit: PathFit, rays: Floats, is_free: Bools) -> bool:
    """Whether most parts of the picture show that the camera moves past the scene.

    A resting camera's scene has no flow; a lorry that comes nearer would fit a camera that moves towards it.
    """
    known = np.flatnonzero(is_free & (fit.rate_sigma_hz > 0.0))
    if not len(known):
        return False
    moves = fit.rate_hz[known] > _MOVES_SIGMAS * fit.rate_sigma_hz[known]
    _, number, count = np.unique(_cells(rays[known]), return_inverse=True, return_counts=True)
    return bool(np.mean(np.bincount(number, moves) > 0.5 * count) > 0.5)


def _cells(rays: Floats) -> Ints:
    """The part of the picture that each ray ``(N, 3)`` lies in: (N,)."""
    cell = np.floor(np.nan_to_num(rays[:, :2] / np.maximum(rays[:, 2:], 0.05)) / _CELL).astype(np.int64)
    return np.asarray(cell[:, 0] * 4096 + cell[:, 1])


def _balance(rays: Floats) -> Floats:
    """Weight of each ray by how many share its part of the picture: one textured lorry is not the world."""
    if not len(rays):
        return np.empty(0)
    _, number, count = np.unique(_cells(rays), return_inverse=True, return_counts=True)
    return np.asarray(1.0 / np.sqrt(count[number]))


def _usual_misfit(fit: PathFit, in_scene: Bools) -> float:
    """Median misfit of the scene's tracks: what the model does not know of, beyond their noise."""
    measured = fit.misfit[in_scene & (fit.n_views > _HABIT_VIEWS)]
    return max(float(np.median(measured)), _LEAST_MISFIT) if len(measured) > _LEAST_MEASURED else _LEAST_MISFIT


def _with_contradictions(misfit: Floats, road: RoadMemory, key: Ints, config: BodiesConfig) -> Floats:
    """Misfits on the scene's path, with those raised that the road contradicts: of single tracks and whole movers."""
    is_odd = road.contradicts()
    for number in np.unique(key[(key != SCENE_CLUSTER) & is_odd]):
        own = key == number
        is_odd[own] |= np.mean(road.evidence[own]) > _MOVER_EVIDENCE
    return np.where(is_odd, np.maximum(misfit, 2.0 * config.scene_gate), misfit)


def _refined_by_own(mover: Mover, scene: Body, views: BodyViews, key: Ints) -> Body:
    own = np.flatnonzero(key == mover.key)
    steps = _YOUNG_STEPS if mover.n_found < _YOUNG_FRAMES else _OLD_STEPS
    return views.refined(mover.body, scene, own, steps) if len(own) > 2 else mover.body


def _assigned(views: BodyViews, movers: list[Mover], key: Ints, n_views: Ints, misfit: Floats, usual: float) -> Ints:
    """Each track to the body that explains it best, among the scene and those that it or a neighbour belonged to."""
    if not movers:
        return key
    label_around = key[views.neighbours]
    is_other = views.has_neighbour
    n_others = np.maximum(np.count_nonzero(is_other, axis=1), 1)
    keys = np.array([SCENE_CLUSTER] + [m.key for m in movers])
    score = np.full((len(keys), len(key)), np.inf)
    for row, number in enumerate(keys):
        around = (label_around == number) & is_other
        near = np.flatnonzero((key == number) | around.any(axis=1)) if row else np.arange(len(key))
        off = misfit if row == 0 else views.misfit(movers[row - 1].body, near) / usual
        score[row, near] = np.log1p(np.minimum(off, _WORST_MISFIT))
        score[row, near] -= _NEIGHBOUR_WEIGHT * (np.count_nonzero(around, axis=1) / n_others)[near]
        score[row, near] -= _HABIT_WEIGHT * ((key == number) & (n_views > _HABIT_VIEWS))[near]
    score[0] -= _SCENE_WEIGHT * (n_views > _SCENE_VIEWS)
    return np.asarray(keys[np.argmin(score, axis=0)])


def _kept(key: Ints, movers: list[Mover], config: BodiesConfig) -> tuple[Ints, list[Mover]]:
    """Movers that still have tracks; those with a last one or two wait for a while, then these go to the scene."""
    key, kept = key.copy(), []
    for mover in movers:
        own = key == mover.key
        if np.count_nonzero(own) >= min(3, config.min_tracks):
            kept.append(replace(mover, n_found=mover.n_found + 1, n_missed=0))
            continue
        if own.any() and mover.n_missed < config.forget_frames:
            kept.append(replace(mover, n_missed=mover.n_missed + 1))
        else:
            key[own] = SCENE_CLUSTER
    return key, kept


def _merged(views: BodyViews, scene: Body, key: Ints, movers: list[Mover], usual: float) -> tuple[Ints, list[Mover]]:
    """Movers side by side that one motion explains are one; the older one's number stays."""
    key = key.copy()
    alive = {m.key: m for m in movers}
    for one in movers:
        for other in movers:
            if one.key >= other.key or one.key not in alive or other.key not in alive:
                continue
            # What was two in one frame is seldom one in the next: of old ones that is asked now and then.
            age = min(alive[one.key].n_found, alive[other.key].n_found)
            if age > _YOUNG_FRAMES and age % _MERGE_FRAMES:
                continue
            joint = _joint(views, scene, key, alive[one.key], alive[other.key], usual)
            if joint is not None:
                older = max(alive[one.key], alive[other.key], key=lambda m: (m.n_found, -m.key))
                younger = other.key if older.key == one.key else one.key
                key[key == younger] = older.key
                alive[older.key] = replace(older, body=joint)
                del alive[younger]
    return key, list(alive.values())


def _joint(views: BodyViews, scene: Body, key: Ints, one: Mover, other: Mover, usual: float) -> Body | None:
    """The motion of two movers taken as one, None where they are two."""
    own, others = np.flatnonzero(key == one.key), np.flatnonzero(key == other.key)
    if min(len(own), len(others)) < 3 or not np.any(key[views.neighbours[own]] == other.key):
        return None
    both = np.concatenate([own, others])
    apart = np.concatenate([views.misfit(one.body, own), views.misfit(other.body, others)]) / usual
    limit = max(float(np.median(apart)), _LEAST_MISFIT)
    large, few = (one, others) if len(own) >= len(others) else (other, own)
    if np.median(views.misfit(large.body, few)) / usual > _WORTH_TRYING * limit:
        return None
    joint = views.refined(large.body, scene, both, _JOINT_STEPS)
    fit = joint.fit(views.rays[:, both], views.sigma_norm[both], None, 0.0)
    # A track that has just been born has no rate yet.
    is_own, is_known = np.arange(len(both)) < len(own), np.isfinite(fit.rate_hz)
    if not ((is_own & is_known).any() and (~is_own & is_known).any()):
        return None
    rates = np.median(fit.rate_hz[is_own & is_known]), np.median(fit.rate_hz[~is_own & is_known])
    if not max(rates) < _ONE_RATE * min(rates):
        return None
    return joint if np.median(fit.misfit) / usual < _MERGED_MISFIT * limit else None


def _split(
    views: BodyViews, key: Ints, movers: list[Mover], next_key: int, config: BodiesConfig
) -> tuple[Ints, list[Mover], int]:
    """Parts of a mover that do not hang together in the picture, or lie at other depths, are movers of their own.

    The largest part keeps the number.
    """
    key, all_movers = key.copy(), []
    for mover in movers:
        all_movers.append(mover)
        own = np.flatnonzero(key == mover.key)
        if len(own) < 2 * config.min_tracks:
            continue
        fit = mover.body.fit(views.rays[:, own], views.sigma_norm[own], np.full(len(own), mover.body.rate_hz), 0.0)
        pairs = linked_pairs(views.xy_px[own], views.link_px)
        log_rate = np.log(np.maximum(np.nan_to_num(fit.rate_hz), _TINY_HZ))
        unsure = np.nan_to_num(fit.rate_sigma_hz / np.maximum(fit.rate_hz, _TINY_HZ), nan=np.inf)
        one, other = pairs.T
        apart = np.abs(log_rate[one] - log_rate[other])
        is_one = apart < np.log(_ONE_RATE) + 2.0 * (unsure[one] + unsure[other])
        label = connected_parts(np.ones(len(own), dtype=bool), pairs[is_one])
        counts = np.bincount(label)
        for number in np.argsort(-counts, kind="stable")[1:]:
            if counts[number] < config.min_tracks:
                break
            key[own[label == number]] = next_key
            all_movers.append(Mover(next_key, None, 1, 0, mover.body))
            next_key += 1
    return key, all_movers, next_key


def _named(movers: list[Mover], next_cluster_id: int, config: BodiesConfig) -> tuple[list[Mover], int]:
    """Public numbers for movers that have been found often enough."""
    named = []
    for mover in movers:
        if mover.cluster_id is None and mover.n_found >= config.confirm_frames:
            mover, next_cluster_id = replace(mover, cluster_id=next_cluster_id), next_cluster_id + 1
        named.append(mover)
    return named, next_cluster_id
