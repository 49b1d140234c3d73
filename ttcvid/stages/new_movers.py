"""New movers: neighbouring tracks that contradict the scene together and agree with each other."""

from __future__ import annotations

import numpy as np

from ttcvid.config import BodiesConfig
from ttcvid.geometry.rigid_path import RigidPaths
from ttcvid.geometry.rotation import turned_into_plane
from ttcvid.geometry.shared_direction import shared_directions
from ttcvid.geometry.whole_track import fit_whole_tracks
from ttcvid.geometry.whole_track_on_path import straight_path
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.bodies import refined_movers
from ttcvid.stages.body_views import BodyViews, fit_on_movers
from ttcvid.stages.connected import connected_parts, linked_pairs

# Views that a track needs to contradict the scene.
_LEAST_VIEWS = 3
# Neighbours contradict the scene together where the median of their ln(misfit) is this part of the gate's.
_TOGETHER, _LEAST_AROUND = 0.6, 3
# Flows of two tracks are alike when they differ by less than this part of their mean and this, px over the window.
_FLOW_PART, _FLOW_PX = 0.35, 1.0
# A new path is refined in so many steps.
_FIRST_STEPS = 3
# The square window of a tracker slips on a road that grows and shears below it, by this part of its way in a frame.
_SLIP = 0.02
# Misfits below this say nothing any more.
_NO_MISFIT = 0.1


def new_movers(
    views: BodyViews,
    scene: RigidPaths,
    in_scene: Bools,
    n_views: Ints,
    misfit: Floats,
    seen_misfit: Floats,
    usual_misfit: float,
    on_road: Bools,
    config: BodiesConfig,
) -> tuple[list[Ints], RigidPaths, Floats]:
    """Connected tracks of the scene that contradict it together and that a motion of their own explains.

    Parameters
    ----------
    in_scene, n_views : (N,) which tracks belong to the scene by now, and their views.
    misfit, seen_misfit : (N,) of each track on the scene's path, in units of ``usual_misfit``, with what the road
        contradicts and without it.
    on_road : (N,) tracks at the depth of the road on which they are seen.

    Returns
    -------
    Tracks (M,), motion and median rate of each.
    """
    none = list[Ints](), scene.take(np.empty(0, dtype=np.int64)), np.empty(0)
    is_asked = in_scene & views.is_free & (n_views >= _LEAST_VIEWS)
    candidates = _candidates(views, is_asked, np.where(on_road, _beside_slip(views), 1.0) * misfit, config)
    if len(candidates) < config.min_tracks:
        return none
    xy = turned_into_plane(views.rays[:, candidates], scene.cam_R_past[0])
    is_along = (misfit > config.scene_gate) & (seen_misfit < config.scene_gate)
    label = _alike_and_near(views, candidates, xy, is_along[candidates])
    is_one = np.bincount(label)[label] >= config.min_tracks
    if not is_one.any():
        return none
    xy, candidates = xy[:, is_one], candidates[is_one]
    numbers, thing = np.unique(label[is_one], return_inverse=True)
    tracks = fit_whole_tracks(xy, views.since_s, views.sigma_norm[candidates])
    directions, _, _ = shared_directions(tracks.state[:, 2:], tracks.info_w, thing, len(numbers))
    points = views.points(candidates, thing)
    ways = np.stack([straight_path(direction, views.since_s) for direction in directions])
    # What contradicts the scene by its place alone moves along our own path.
    ways[np.bincount(thing, is_along[candidates]) > 0.0] = scene.path[0]
    starts = RigidPaths(np.repeat(scene.cam_R_past, len(ways), axis=0), ways)
    paths, rate_hz = refined_movers(starts, scene, points, np.full(len(starts), _FIRST_STEPS))
    misfit_by_own = fit_on_movers(points, paths, rate_hz).misfit / usual_misfit
    is_better = misfit_by_own < misfit[candidates] / config.gain
    least = np.maximum(config.min_tracks, np.bincount(thing) // 2 + 1)
    is_found = np.isfinite(directions[:, 0]) & (np.bincount(thing, is_better) >= least)
    found = np.flatnonzero(is_found)
    return [candidates[is_better & (thing == number)] for number in found], paths.take(found), rate_hz[found]


def _beside_slip(views: BodyViews) -> Floats:
    """What part of its squared error each track (N,) would have if its window slips as well as may be."""
    if len(views.rays) < 2:
        return np.ones(len(views.sigma_norm))
    moved = views.rays[-1] - views.rays[-2]
    # The square of a track that was not seen is NaN, which `fmax` takes for nothing.
    slip2 = _SLIP**2 * np.fmax(np.einsum("ni,ni->n", moved, moved), 0.0)
    return np.asarray(views.sigma_norm**2 / (views.sigma_norm**2 + slip2))


def _candidates(views: BodyViews, is_asked: Bools, misfit: Floats, config: BodiesConfig) -> Ints:
    """Tracks that contradict the scene, in a neighbourhood that does."""
    index = np.flatnonzero(is_asked & (misfit > config.scene_gate))
    if len(index) < config.min_tracks:
        return index
    around = np.column_stack([index, views.neighbours[index]])
    counts = np.column_stack([np.ones(len(index), dtype=bool), views.has_neighbour[index]]) & is_asked[around]
    ordered = np.sort(np.where(counts, np.log(np.maximum(misfit[around], _NO_MISFIT)), np.inf), axis=1)
    every, n = np.arange(len(index)), np.count_nonzero(counts, axis=1)
    median = 0.5 * (ordered[every, (n - 1) // 2] + ordered[every, n // 2])
    return np.asarray(index[(median > _TOGETHER * np.log(config.scene_gate)) & (n >= _LEAST_AROUND)])


def _alike_and_near(views: BodyViews, index: Ints, xy: Floats, is_along: Bools) -> Ints:
    """Number of the part that each track of ``index`` belongs to: near ones of similar flow are connected.

    Those that move along our own path, ``is_along``, only with each other.
    """
    pairs = linked_pairs(views.xy_px[index], views.link_px)
    oldest = np.argmax(np.isfinite(xy[:, :, 0]), axis=0)
    span_s = -views.since_s[oldest]
    flow = (xy[-1] - xy[oldest, np.arange(len(index))]) / span_s[:, None]
    one, other = flow[pairs[:, 0]], flow[pairs[:, 1]]
    mean = 0.5 * (np.linalg.norm(one, axis=1) + np.linalg.norm(other, axis=1))
    floor = _FLOW_PX / views.focal_px / np.minimum(span_s[pairs[:, 0]], span_s[pairs[:, 1]])
    is_alike = np.linalg.norm(one - other, axis=1) < _FLOW_PART * mean + floor
    is_alike &= is_along[pairs[:, 0]] == is_along[pairs[:, 1]]
    return connected_parts(np.ones(len(index), dtype=bool), pairs[is_alike])
