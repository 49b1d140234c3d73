"""Segmentation of the tracks of a frame into the static scene and movers.

The scene and each mover are rigid bodies with a relative trajectory. A track is assigned to the body that explains all
of its views best, with a smoothness term over neighbours and one for its former label. Births are proposed where
neighbouring tracks contradict the scene and agree with each other; movers that are one are merged, one that is two is
split.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ttcvid.config import BodiesConfig
from ttcvid.geometry.estimation.rigid_motion import RigidPaths, surprise_of_newest
from ttcvid.geometry.medians import medians
from ttcvid.model import NO_CLUSTER, SCENE_CLUSTER, Bools, Floats, Ints, Platform
from ttcvid.stages.egomotion.relative_pose import Egomotion
from ttcvid.stages.segmentation.births import new_movers
from ttcvid.stages.segmentation.bodies import carried_forward, stepped_movers
from ttcvid.stages.segmentation.body_views import BodyViews
from ttcvid.stages.segmentation.data_association import Movers, assigned, kept, no_movers, numbers_of
from ttcvid.stages.segmentation.merges import merged, split
from ttcvid.stages.segmentation.reidentification import reidentified, with_velocities
from ttcvid.stages.segmentation.road_evidence import RoadMemory
from ttcvid.stages.segmentation.scene import SeenScene, TrackLabels, see_scene
from ttcvid.stages.segmentation.surface_memory import Obstacle, are_confirmed
from ttcvid.stages.segmentation.turning_movers import with_turning_bodies
from ttcvid.stages.tracking.groups import places_among
from ttcvid.stages.tracking.history import TrackHistory

# Gauss-Newton steps a frame for a young mover (up to so many frames) and for an older one, and the least number of
# tracks for them.
_YOUNG_STEPS, _YOUNG_FRAMES, _OLD_STEPS, _LEAST_POINTS = 2, 5, 1, 3
# An observation is displaced where a uniform density over a square of this side explains it better than noise about its
# prediction does: at one displaced one of so many, and as many more as are found in the frame.
_STRAY_PX, _PRIOR_TRACKS = 24.0, 200.0
# Bounds of the squared residual from which on it is: noise alone seldom reaches the first, and never the second.
_LEAST_CHI2, _MOST_CHI2 = 3.0**2, 6.0**2
# Rounds in which the median residual is found without displaced observations. Two residuals are alike within this
# share of their length.
_ROUNDS, _ALIKE = 3, 0.3
# Median of a chi-square variable with two degrees of freedom.
_MEDIAN_CHI2_2 = 1.3863
# Least number of tracks of a birth before a camera at rest, where only movers have flow.
_TRACKS_AT_REST = 3


@dataclass(frozen=True)
class BodyMemory:
    """Bodies of the last frame.

    scene, movers : the bodies; None before the first frame.
    track_id, track_key, rate_hz : ``(M,)`` number, body and inverse depth (1/s) of each track, by ascending number.
    road : memory of the road.
    next_key, next_cluster_id : next body and next public number that are free.
    obstacles : standing obstacles (`segmentation.obstacles`).
    growing : expanding surfaces (`segmentation.expansion`).
    frame : ``(L,)`` frames of the views of the trajectories.
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
    """Bodies of a frame and the labels of its N tracks.

    key : ``(N,)`` body of each track; 0 the scene.
    movers, seen : the bodies; the scene, and how it explains each track.
    is_displaced : ``(N,)`` tracks whose present observation is displaced: no body explains it.
    is_past_off : ``(L, N)`` earlier observations that are displaced.
    """

    key: Ints
    movers: Movers
    seen: SeenScene
    is_displaced: Bools
    is_past_off: Bools


def in_scene(memory: BodyMemory, track_id: Ints) -> Bools:
    """Whether tracks ``(N,)`` belonged to no mover in the last frame."""
    return np.asarray(_carried_labels(memory, track_id).key == SCENE_CLUSTER)


def find_bodies(
    history: TrackHistory,
    views: BodyViews,
    egomotion: Egomotion,
    platform: Platform,
    may_start: Bools,
    memory: BodyMemory,
    config: BodiesConfig,
) -> tuple[Segmentation, BodyMemory]:
    """Segmentation of a frame, and the memory for the next one.

    ``views`` are those of the N tracks as from `body_views`; ``may_start (N,)`` tracks may be part of a birth.
    """
    memory = _over_views(memory, history.frame)
    labels = _carried_labels(memory, history.track_id)
    key, movers = labels.key, _carried_movers(memory, egomotion, views)
    number, known = numbers_of(key, movers), np.append(SCENE_CLUSTER, movers.key)
    is_lost = known[number] != key
    key[is_lost], number[is_lost] = SCENE_CLUSTER, 0
    seen = see_scene(history, egomotion, platform, memory.scene, memory.road, views, labels, config)

    movers = _refined(movers, seen, views, number, config)
    neighbours = views.neighbours()
    is_displaced, is_past_off = _are_displaced(views, seen, movers, number, labels.rate_hz, neighbours, config)
    belonged, views = key, replace(views, is_free=views.is_free & ~is_displaced)
    key, own_redchi = assigned(views, seen, key, movers, neighbours)
    key, movers = kept(views, key, movers, config)
    key, movers = merged(views, seen, key, movers, neighbours, own_redchi)
    # A track with a displaced observation keeps its body: the next observation may fit again.
    known = np.append(SCENE_CLUSTER, movers.key)
    key = np.where(is_displaced & (known[numbers_of(belonged, movers)] == belonged), belonged, key)
    key, movers, next_key = split(views, key, movers, memory.next_key, config.min_tracks)
    key, movers, next_key = _with_new(views, seen, key, movers, neighbours, may_start, next_key, config)
    number = numbers_of(key, movers)
    movers = with_velocities(views, seen.scene, number, movers)
    n_tracks = np.bincount(number, minlength=len(movers) + 1)[1:]
    movers, next_cluster_id = _named(movers, n_tracks, memory.next_cluster_id, config)
    memory = replace(memory, rate_hz=memory.rate_hz * seen.speed)
    tracks = _with_lost(history, memory, key, seen.rate_hz)
    surfaces = memory.obstacles, memory.growing
    memory = BodyMemory(seen.scene, movers, *tracks, seen.road, next_key, next_cluster_id, *surfaces, history.frame)
    return Segmentation(key, movers, seen, is_displaced, is_past_off), memory


def _are_displaced(
    views: BodyViews,
    seen: SeenScene,
    movers: Movers,
    number: Ints,
    rate_hz: Floats,
    neighbours: Ints,
    config: BodiesConfig,
) -> tuple[Bools, Bools]:
    """Whether the present observation of tracks ``(N,)`` is displaced, off the path of their body; and earlier ones.

    Their bodies are ``number (N,)`` as from `numbers_of`, and ``rate_hz (N,)`` their rates in the last frame. Earlier
    ones, ``(L, N)``, are displaced where later ones are on that path again; none if most of a body are, in a view. Of
    the present one: where the earlier observations do not follow that path, also off their own course.

    Residuals are judged against the median of their body: if most are large, its last step is wrong. A residual that a
    neighbour shares is none of a single observation: it may belong to a mover not found yet.
    """
    start_hz = np.where(number == 0, rate_hz * seen.speed, np.append(0.0, movers.rate_hz)[number])
    points = views.points(np.arange(len(number)), number)
    surprise = surprise_of_newest(points, seen.scene.joined(movers.paths), start_hz)
    # What follows the path of its body goes on along it; what never did, along its own course.
    is_on_path = surprise.past_redchi < config.scene_gate * seen.median_redchi
    chi2 = np.where(is_on_path, surprise.chi2, np.minimum(surprise.chi2, surprise.line_chi2))
    is_displaced, is_known = np.zeros(len(number), dtype=bool), (chi2 > 0.0) & views.is_free
    log_area = np.log(_STRAY_PX**2 / (2.0 * np.pi * (views.sigma_norm * views.focal_px) ** 2))
    n_bodies = len(movers) + 1
    for _ in range(_ROUNDS):
        tells = np.flatnonzero(is_known & ~is_displaced)
        median_chi2 = np.fmax(medians(chi2[tells], number[tells], n_bodies) / _MEDIAN_CHI2_2, 1.0)
        odds = (1.0 + np.count_nonzero(is_displaced)) / (_PRIOR_TRACKS + len(tells))
        limit = np.clip(2.0 * (log_area - np.log(median_chi2 * odds)[number]), _LEAST_CHI2, _MOST_CHI2)
        before, is_displaced = is_displaced, is_known & (chi2 > limit * median_chi2[number])
        if np.array_equal(is_displaced, before):
            break
    track, view = np.divmod(np.flatnonzero(surprise.is_past_off & views.is_free[:, None]), len(views.t_s))
    at = view * n_bodies + number[track]
    is_past_off = np.zeros((len(views.t_s), len(number)), dtype=bool)
    is_past_off[view, track] = 2 * np.bincount(at)[at] < np.bincount(number)[number[track]]
    if not is_displaced.any():
        return is_displaced, is_past_off
    beside = neighbours[is_displaced]
    off = surprise.off[is_displaced]
    apart = np.linalg.norm(surprise.off[beside] - off[:, None], axis=2)
    is_alike = apart < _ALIKE * np.linalg.norm(off, axis=1)[:, None]
    is_alike &= beside != np.flatnonzero(is_displaced)[:, None]
    is_displaced[is_displaced] = ~is_alike.any(axis=1)
    return is_displaced, is_past_off


def _carried_movers(memory: BodyMemory, egomotion: Egomotion, views: BodyViews) -> Movers:
    """Movers of the last frame, predicted for this one."""
    if len(views.t_s) < 2 or memory.scene is None or not len(memory.movers):
        return no_movers(len(views.t_s))
    before, cam_R_prev = memory.movers, egomotion.cam_R_prev
    paths = carried_forward(before.paths, cam_R_prev, views.t_s)
    last = before.last.carried_forward(cam_R_prev, paths.path[:, -2], views.t_s[-1] - views.t_s[-2])
    return replace(before, paths=paths, last=last)


def _with_new(
    views: BodyViews,
    seen: SeenScene,
    key: Ints,
    movers: Movers,
    neighbours: Ints,
    may_start: Bools,
    next_key: int,
    config: BodiesConfig,
) -> tuple[Ints, Movers, int]:
    """Labels ``(N,)`` and movers after births among the scene's tracks, re-identified or new, and the next key."""
    births = config
    if seen.camera_rests:
        births = config.model_copy(update={"min_tracks": min(config.min_tracks, _TRACKS_AT_REST)})
    found, paths, found_hz = new_movers(views, seen, (key == SCENE_CLUSTER) & may_start, neighbours, births)
    if seen.camera_rests and found:
        is_one = _are_no_outlines(views, key, found, config.min_tracks)
        found = [members for members, is_mover in zip(found, is_one, strict=True) if is_mover]
        paths, found_hz = paths.take(is_one), found_hz[is_one]
    if found and len(movers):
        key, movers, is_known = reidentified(views, seen, key, movers, found, paths, found_hz)
        found = [members for members, known in zip(found, is_known, strict=True) if not known]
        paths, found_hz = paths.take(~is_known), found_hz[~is_known]
    for count, members in enumerate(found):
        key[members] = next_key + count
    return key, movers.with_new(next_key, paths, found_hz), next_key + len(found)


def _are_no_outlines(views: BodyViews, key: Ints, found: list[Ints], enough: int) -> Bools:
    """Which births ``(K,)`` have ``enough`` tracks, or no other moving track nearer than ``views.link_px``.

    Corners where the outline of a mover crosses lines of the background move along it: they are few, and beside it.
    """
    moves, is_one = key != SCENE_CLUSTER, np.array([len(members) >= enough for members in found])
    for members in (found[place] for place in np.flatnonzero(is_one)):
        moves[members] = True
    for place in np.flatnonzero(~is_one):
        off_px = views.xy_px[found[place], None] - views.xy_px[moves]
        is_one[place] = not (np.hypot(off_px[:, :, 0], off_px[:, :, 1]) < views.link_px).any()
    return is_one


def restarted_bodies(memory: BodyMemory) -> BodyMemory:
    """Memory without bodies; keys and cluster numbers go on."""
    return BodyMemory(next_key=memory.next_key, next_cluster_id=memory.next_cluster_id)


def _over_views(memory: BodyMemory, frame: Ints) -> BodyMemory:
    """Memory with the trajectories over those views only that are in the history's frames ``frame (L,)``."""
    if memory.scene is None or np.array_equal(memory.frame[1 - len(frame) :], frame[:-1]):
        return memory
    stays = np.isin(memory.frame, frame)
    if not stays.any():
        return restarted_bodies(memory)
    movers = replace(memory.movers, paths=memory.movers.paths.over(stays))
    return replace(memory, scene=memory.scene.over(stays), movers=movers)


def _carried_labels(memory: BodyMemory, track_id: Ints) -> TrackLabels:
    """Body and inverse depth of each track in the last frame; new tracks belong to the scene, with NaN."""
    # -1, of a new track, picks the last one.
    place = places_among(memory.track_id, track_id)
    return TrackLabels(np.append(memory.track_key, SCENE_CLUSTER)[place], np.append(memory.rate_hz, np.nan)[place])


def _with_lost(history: TrackHistory, memory: BodyMemory, key: Ints, rate_hz: Floats) -> tuple[Ints, Ints, Floats]:
    """Number, body and inverse depth of all tracks that may be in the next frame, lost ones included: ``(M,)`` each."""
    if history.lost is None:
        return history.track_id, key, rate_hz
    lost = _carried_labels(memory, history.lost.track_id)
    track_id = np.concatenate([history.track_id, history.lost.track_id])
    order = np.argsort(track_id)
    return track_id[order], np.concatenate([key, lost.key])[order], np.concatenate([rate_hz, lost.rate_hz])[order]


def _refined(movers: Movers, seen: SeenScene, views: BodyViews, number: Ints, config: BodiesConfig) -> Movers:
    """Movers refined by the tracks of their last labels, as turning bodies where these explain them."""
    has_points = np.bincount(number, minlength=len(movers) + 1)[1:] >= _LEAST_POINTS
    track = np.flatnonzero(np.append(False, has_points)[number])
    if not len(track):
        return movers
    steps = np.where(movers.n_found < _YOUNG_FRAMES, _YOUNG_STEPS, _OLD_STEPS)
    points = views.points(track, number[track] - 1)
    paths, rate_hz = stepped_movers(movers.paths, seen.scene, points, steps * has_points, movers.rate_hz)
    paths = with_turning_bodies(views, seen, points, paths, rate_hz, config.scene_gate)
    return replace(movers, paths=paths, rate_hz=np.where(has_points, rate_hz, movers.rate_hz))


def _named(movers: Movers, n_tracks: Ints, next_cluster_id: int, config: BodiesConfig) -> tuple[Movers, int]:
    """Movers of ``n_tracks (K,)`` tracks with public numbers once they are confirmed, and the next number."""
    asks = (movers.cluster_id == NO_CLUSTER) & are_confirmed(movers.n_found, n_tracks, config)
    cluster_id = movers.cluster_id.copy()
    cluster_id[asks] = next_cluster_id + np.arange(np.count_nonzero(asks))
    return replace(movers, cluster_id=cluster_id), next_cluster_id + int(np.count_nonzero(asks))
