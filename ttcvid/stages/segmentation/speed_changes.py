"""Changes of speed: what brakes before us is no static object at another depth.

A mover along our own direction looks like a static object as long as it keeps its speed. Where it changes that, its
tracks leave the path of the scene by a distance that grows with the square of the time: each by little, and all alike.
What is known as a mover stays one by that, although its foot may be where that of a static object would be. (Tracks of
no known mover are not asked: of a real street, many slide along kerbs and outlines as if they changed their speed.)
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.estimation.rigid_motion import PathFit, RigidPaths
from ttcvid.geometry.medians import median
from ttcvid.geometry.quotient import quotient
from ttcvid.geometry.rotation import each_turned_into_plane
from ttcvid.model import SCENE_CLUSTER, Bools, Floats, Ints
from ttcvid.stages.segmentation.body_views import BodyViews
from ttcvid.stages.segmentation.common_errors import SIGMAS_999
from ttcvid.stages.tracking.groups import TrackSets

# Views that a track needs: a change of speed is the fourth unknown of its own.
_LEAST_VIEWS = 6
# The weight of a view falls to a half where it misses the path by so many sigmas.
_HALF_WEIGHT_SIGMAS = 3.0
# A view in which a point was nearer than this part of its present depth says nothing.
_LEAST_DEPTH_RATIO = 0.05
# So many tracks of the scene tell what static things show. Median of the absolute value of a standard normal variable.
_MOST_OTHERS, _MEDIAN_NORMAL = 100, 0.6745
# A track tells by itself where the change of its body explains it better than none, by this log likelihood ratio.
_TELLS = 0.5
_TINY = 1e-12


def change_speed(views: BodyViews, scene: RigidPaths, fit: PathFit, key: Ints, is_asked: Bools) -> Bools:
    """Which of N tracks show, with the other tracks of their mover, that it changes its speed beside the scene: (N,).

    Parameters
    ----------
    fit : The tracks on the path of the ``scene``.
    key : (N,) their bodies; tracks of the scene tell what static things seem to change.
    is_asked : (N,) those that this path explains, and that do not lie on the road.

    Notes
    -----
    A mover changes its speed if the change that all its tracks share exceeds 3.09 standard deviations. A track shows it
    where it has the better likelihood with that change than without.
    """
    changes = np.zeros(len(key), dtype=bool)
    is_asked, in_scene = is_asked & views.is_free & (fit.n_views >= _LEAST_VIEWS), key == SCENE_CLUSTER
    asked, others = np.flatnonzero(is_asked & ~in_scene), np.flatnonzero(is_asked & in_scene)
    if not len(asked) or not len(others):
        return changes
    others = np.ascontiguousarray(others[:: -(-len(others) // _MOST_OTHERS)])
    score, info = _scores(views, scene, fit.take(others), others)
    # Of static things nothing changes its speed: what they show is what own motion and the lens leave.
    usual = max(1.0, median(np.abs(score) / np.sqrt(np.maximum(info, _TINY))) / _MEDIAN_NORMAL)
    asked = asked[np.argsort(key[asked], kind="stable")]
    _, lengths = np.unique(key[asked], return_counts=True)
    bodies = TrackSets(asked, lengths)
    score, info = _scores(views, scene, fit.take(asked), asked) / usual**2
    of_body, info_of_body = bodies.sums(score), bodies.sums(info)
    differs = np.abs(of_body) > SIGMAS_999 * np.sqrt(info_of_body)
    change_hz = quotient(of_body, info_of_body)[bodies.set_of]
    # Far background ahead, which any path explains, tells nothing by itself.
    changes[asked] = differs[bodies.set_of] & (score * change_hz - 0.5 * info * change_hz**2 > _TELLS)
    return changes


def _scores(views: BodyViews, scene: RigidPaths, fit: PathFit, track: Ints) -> Floats:
    """Score and information ``(2, M)``, in s and s^2, of the change of speed of each of some tracks ``track (M,)``.

    A change by kappa, in 1/s, makes a path T(t) into T(t) (1 + kappa t). Place and inverse depth of a track are
    eliminated (Schur complement).
    """
    path, since_s, precision = scene.path[0], views.since_s[:, None], views.sigma_norm[track] ** -2.0
    xy = each_turned_into_plane(views.rays, track, scene.cam_R_past, np.zeros(len(track), dtype=np.int64))
    depth = 1.0 + fit.rate_hz * path[:, 2:]
    is_seen = np.isfinite(xy[..., 0]) & (depth > _LEAST_DEPTH_RATIO)
    shrink = np.where(is_seen, quotient(1.0, depth), 0.0)
    there = (fit.place + fit.rate_hz[:, None] * path[:, None, :2]) * shrink[..., None]
    off = np.where(is_seen[..., None], xy - there, 0.0)
    weight = is_seen * precision / (1.0 + (off * off).sum(axis=2) * precision / _HALF_WEIGHT_SIGMAS**2)
    by_rate = (path[:, None, :2] - there * path[:, None, 2:]) * shrink[..., None]
    by_change = fit.rate_hz[:, None] * by_rate * since_s[..., None]
    own = np.maximum((weight * shrink * shrink).sum(axis=0), _TINY)

    def product(one: Floats, other: Floats) -> Floats:
        with_place = [np.einsum("lm,lmi->mi", weight * shrink, column) for column in (one, other)]
        return np.asarray(np.einsum("lm,lmi,lmi->m", weight, one, other) - np.einsum("mi,mi->m", *with_place) / own)

    part = product(by_rate, by_change) / np.maximum(product(by_rate, by_rate), _TINY)
    by_change = by_change - part[:, None] * by_rate
    return np.stack([product(by_change, off), product(by_change, by_change)])
