"""Births of movers: neighbouring tracks that contradict the scene and share a flow, an expansion or a depth."""

from __future__ import annotations

import math

import numpy as np

from ttcvid.config import BodiesConfig
from ttcvid.geometry.estimation.rigid_motion import PathFit, RigidPaths
from ttcvid.geometry.estimation.track_on_trajectory import straight_path
from ttcvid.geometry.medians import medians, row_medians
from ttcvid.geometry.rotation import normalize, turned_into_plane
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.segmentation.bodies import refined_movers
from ttcvid.stages.segmentation.body_views import BodyViews, cost_of, fit_on_movers
from ttcvid.stages.segmentation.common_errors import drift_cost
from ttcvid.stages.segmentation.expansion import LEAST_VIEWS, expanding_movers, least_tracks
from ttcvid.stages.segmentation.fixed_to_camera import FOLLOWS
from ttcvid.stages.segmentation.ground_contact import depth_tolerance_hz
from ttcvid.stages.segmentation.last_known import STEPS_TO_VELOCITY, recent_velocities
from ttcvid.stages.segmentation.scene import SeenScene
from ttcvid.stages.tracking.neighbours import connected_parts, linked_pairs, without_gaps

# Least number of views of a track that contradicts the scene.
_LEAST_VIEWS = 3
# A neighbourhood contradicts the scene if the median of ln(reduced chi-square) exceeds this share of that of the gate,
# over at least so many tracks.
_TOGETHER, _LEAST_AROUND = 0.6, 3
# Flows of two tracks are alike if they differ by less than this share of their mean plus this, px in the shorter span.
_FLOW_PART, _FLOW_PX = 0.35, 1.0
# A flow is the median over the views in this part of a track's span, the older one: of some tracks every third
# observation is displaced.
_OLDEST_PART = 0.5
# Least part of its tracks that a mover explains better; Gauss-Newton steps for a new trajectory.
_MOST, _FIRST_STEPS = 0.5, 3
# The velocity towards us is believed to be about as large as that across, or 0.3/s where that is less: what comes
# straight at us has hardly any across.
_AHEAD_OF_ACROSS, _LEAST_AHEAD_HZ = 1.0, 0.3
# Reduced chi-squares are at least this where their logarithm is taken.
_NO_REDCHI = 0.1


def new_movers(
    views: BodyViews, seen: SeenScene, in_scene: Bools, neighbours: Ints, config: BodiesConfig
) -> tuple[list[Ints], RigidPaths, Floats]:
    """Sets of connected tracks that contradict the scene and that a trajectory of their own explains.

    Parameters
    ----------
    in_scene : ``(N,)`` tracks of the scene that may be part of a birth.
    neighbours : ``(N, K)`` neighbours of tracks; themselves for missing ones.

    Returns of each of J births its tracks ``(M,)``, trajectory and median inverse depth ``(J,)``, 1/s.
    """
    is_asked = in_scene & views.is_free & (seen.ride_odds < -FOLLOWS) & (seen.fit.n_views >= _LEAST_VIEWS)
    candidates = _candidates(neighbours, is_asked, seen.redchi, config)
    # Constant bearing with expansion shows a mover even where only the road contradicts the scene's motion.
    things = expanding_movers(views, seen, is_asked & (seen.fit.n_views >= LEAST_VIEWS), candidates, config)
    spread, paths, rate_hz = _explained(views, seen, things, least_tracks(config), 0.0, np.zeros_like(in_scene), config)
    contradicts = (seen.redchi > config.scene_gate) & np.isfinite(seen.fit.rate_sigma_hz)
    is_along = contradicts & (seen.seen_redchi < config.scene_gate)
    # What lies under the road contradicts by itself, what stands over that with its surface: no neighbours are asked.
    candidates = np.union1d(candidates, np.flatnonzero(is_asked & is_along))
    candidates = candidates[~np.isin(candidates, np.concatenate([candidates[:0], *spread]))]
    things = _alike_things(views, seen, candidates, is_along, config)
    # What just moves alike contradicts the scene track by track, at constant bearing only what is at its edges does.
    alike, alike_paths, alike_hz = _explained(views, seen, things, config.min_tracks, _MOST, is_along, config)
    return spread + alike, paths.joined(alike_paths), np.append(rate_hz, alike_hz)


def _explained(
    views: BodyViews,
    seen: SeenScene,
    things: list[tuple[Ints, Floats]],
    needed: int,
    least_part: float,
    is_along: Bools,
    config: BodiesConfig,
) -> tuple[list[Ints], RigidPaths, Floats]:
    """Those of K proposals that cost less on a trajectory of their own than on the scene's, all tracks together.

    Each of the ``things`` is its tracks ``(M,)`` and trajectory ``(L, 3)``. It has to explain at least ``needed`` of
    its tracks, and ``least_part`` of them, better than the scene by the ``gain``, and to save together as much as so
    many tracks with a large chi-square do. ``is_along (N,)`` tracks contradict the scene by their depth alone: a thing
    with one of them starts on the scene's own trajectory.

    Returned as by `new_movers`, with the tracks that are explained significantly better.
    """
    scene, redchi, median_redchi = seen.scene, seen.redchi, seen.median_redchi
    if not things:
        return [], scene.take(np.empty(0, dtype=np.int64)), np.empty(0)
    track = np.concatenate([members for members, _ in things])
    thing = np.repeat(np.arange(len(things)), [len(members) for members, _ in things])
    points = views.points(track, thing)
    ways = np.stack([path for _, path in things])
    # Tracks that contradict the scene by their depth alone move along our own direction.
    goes_along = np.bincount(thing, is_along[track]) > 0.0
    ways[goes_along] = scene.path[0]
    starts = RigidPaths(np.repeat(scene.cam_R_past, len(ways), axis=0), ways)
    paths, rate_hz = refined_movers(starts, scene, points, np.full(len(starts), _FIRST_STEPS))
    redchi_by_own = fit_on_movers(points, paths, rate_hz).redchi / median_redchi
    is_better = redchi_by_own < redchi[track] / config.gain
    saved = cost_of(redchi[track]) - cost_of(redchi_by_own)
    cost = needed * math.log(config.gain)
    is_found = np.bincount(thing, saved) > cost
    # No mover where a common drift costs less than a birth.
    drift = drift_cost(seen.residual_px2(views)[track], thing, len(starts), views.common_px)
    is_found &= goes_along | (drift > cost)
    is_found &= np.bincount(thing, is_better) > least_part * np.bincount(thing)
    is_found &= np.bincount(thing, is_better) >= needed
    found = np.flatnonzero(is_found)
    return [track[is_better & (thing == number)] for number in found], paths.take(found), rate_hz[found]


def _candidates(neighbours: Ints, is_asked: Bools, redchi: Floats, config: BodiesConfig) -> Ints:
    """Indices ``(M,)`` of tracks that contradict the scene, in a neighbourhood that contradicts it."""
    index = np.flatnonzero(is_asked & (redchi > config.scene_gate))
    around = np.column_stack([index, neighbours[index]])
    is_known = is_asked[around]
    is_known[:, 1:] &= neighbours[index] != index[:, None]
    middle = row_medians(np.log(np.maximum(redchi[around], _NO_REDCHI)), is_known)
    is_candidate = middle > _TOGETHER * np.log(config.scene_gate)
    return np.asarray(index[is_candidate & (is_known.sum(axis=1) >= _LEAST_AROUND)])


def _alike_things(
    views: BodyViews, seen: SeenScene, candidates: Ints, is_along: Bools, config: BodiesConfig
) -> list[tuple[Ints, Floats]]:
    """Connected tracks of similar motion among ``candidates (C,)``: tracks ``(M,)``, straight path ``(L, 3)`` of each.

    The path is that of the velocity of all tracks of a thing together: a track of a few views does not tell its own.
    ``is_along (N,)`` tracks that move along our own direction.
    """
    if len(candidates) < config.min_tracks:
        return []
    cam_R_past = seen.scene.cam_R_past[0]
    xy = turned_into_plane(views.rays.take(candidates, axis=1), cam_R_past)
    flow, label = _alike_and_near(views, seen.fit, candidates, xy, is_along[candidates])
    is_one = np.bincount(label)[label] >= config.min_tracks
    if not is_one.any():
        return []
    flow, candidates = flow[is_one], candidates[is_one]
    numbers, thing = np.unique(label[is_one], return_inverse=True)
    across_hz = [medians(along, thing, len(numbers)) for along in flow.T.copy()]
    start_hz = np.column_stack([*across_hz, np.zeros(len(numbers))])
    ahead_hz = np.maximum(_AHEAD_OF_ACROSS * np.hypot(*across_hz), _LEAST_AHEAD_HZ)
    points = views.points(candidates, thing)
    velocity_hz, _ = recent_velocities(points, cam_R_past, start_hz, STEPS_TO_VELOCITY, ahead_hz)
    directions = normalize(velocity_hz)
    told = np.flatnonzero(np.isfinite(directions[:, 0]))
    return [(candidates[thing == number], straight_path(directions[number], views.since_s)) for number in told]


def _alike_and_near(views: BodyViews, fit: PathFit, index: Ints, xy: Floats, is_along: Bools) -> tuple[Floats, Ints]:
    """Flow ``(C, 2)`` of each track ``index (C,)``, 1/s, and its connected component: near ones that move alike.

    Tracks along our own direction, ``is_along (C,)``, are connected with each other only, by inverse depth on the path
    of the scene, ``fit``: their flows diverge.
    """
    oldest, since_s = np.isfinite(xy[:, :, 0]).argmax(axis=0), views.since_s
    span_s = -since_s[oldest]
    flows = (xy[-1] - xy[:-1]) / -since_s[:-1, None, None]
    is_old = (since_s[:-1, None] <= -_OLDEST_PART * span_s) & np.isfinite(flows[..., 0])
    flow = np.column_stack([row_medians(flows[..., axis].T, is_old.T) for axis in (0, 1)])
    length = np.sqrt((flow * flow).sum(axis=1))
    pairs = linked_pairs(views.xy_px[index], views.link_px)
    one, other = pairs.T
    floor = _FLOW_PX / views.focal_px / np.minimum(span_s[one], span_s[other])
    apart = np.hypot(*(flow[one] - flow[other]).T)
    is_alike = apart < _FLOW_PART * 0.5 * (length[one] + length[other]) + floor
    rate_hz, tolerance_hz = fit.rate_hz[index], depth_tolerance_hz(fit.rate_hz[index], fit.rate_sigma_hz[index])
    is_one_depth = np.abs(rate_hz[one] - rate_hz[other]) < 0.5 * (tolerance_hz[one] + tolerance_hz[other])
    is_alike = np.where(is_along[one], is_one_depth, is_alike) & (is_along[one] == is_along[other])
    pairs = without_gaps(pairs.take(np.flatnonzero(is_alike), axis=0), views.xy_px[index], views.link_px)
    return flow, connected_parts(np.ones(len(index), dtype=bool), pairs)
