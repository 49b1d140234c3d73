"""Changes of speed: what brakes or speeds up before us is no static object at another depth.

A mover along our own direction looks like a static object as long as it keeps its speed. Where it changes that, its
tracks leave the path of the scene by a distance that grows with the square of the time: each by little, and all alike.
What is known as a mover stays one by that, even where its foot is on the road at the depth of a static object. No mover
starts by it, but of tracks that one just lost: on real streets many slide along kerbs as if they changed their speed.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.estimation.rigid_motion import PathFit, RigidPaths
from ttcvid.geometry.kernels.path_point import LEAST_DEPTH_RATIO, ROBUST_SIGMAS
from ttcvid.geometry.medians import MEDIAN_NORMAL, median
from ttcvid.geometry.quotient import quotient
from ttcvid.geometry.rotation import each_turned_into_plane
from ttcvid.model import SCENE_CLUSTER, Bools, Floats, Ints
from ttcvid.stages.segmentation.body_views import BodyViews
from ttcvid.stages.segmentation.common_errors import SIGMAS_999
from ttcvid.stages.tracking.groups import TrackSets

# Views that a track needs: a change of speed is the fourth unknown of its own.
_LEAST_VIEWS = 6
# At most so many tracks of the scene tell what static things show.
_MOST_STATIC = 100
# A track shows the change of its mover if that is likelier than none by this (natural logarithm): e^0.5 to one.
_LEAST_LOG_RATIO = 0.5
# Information, s^2, that is no more than rounding.
_TINY = 1e-12


def change_speed(views: BodyViews, scene: RigidPaths, fit: PathFit, key: Ints, is_asked: Bools) -> Bools:
    """Tracks ``(N,)`` that show, together with the others of their mover, that it brakes or speeds up.

    Parameters
    ----------
    fit : The tracks on the path of the ``scene``.
    key : (N,) their bodies. Tracks of the scene tell what static things seem to change: own motion and lens err.
    is_asked : (N,) tracks that this path explains, and that do not lie on the road.

    Notes
    -----
    A mover changes its speed if the change that its tracks share differs from that of static things by more than 3.09
    standard deviations, either way. Far background may be in a mover by mistake, since any path explains it: a track
    therefore shows the change only where that makes it likelier.
    """
    changes, in_scene = np.zeros(len(key), dtype=bool), key == SCENE_CLUSTER
    is_asked = is_asked & views.is_free & (fit.n_views >= _LEAST_VIEWS) & np.isfinite(fit.rate_hz)
    movers, static = np.flatnonzero(is_asked & ~in_scene), np.flatnonzero(is_asked & in_scene & (fit.rate_hz > 0.0))
    if not len(movers) or not len(static):
        return changes
    static = static[:: -(-len(static) // _MOST_STATIC)]
    score, info = _scores(views, scene, fit.take(static), static)
    common_hz = score.sum() / max(info.sum(), _TINY)
    left = np.abs(score - common_hz * info) / np.sqrt(np.maximum(info, _TINY))
    variance = max(1.0, median(left) / MEDIAN_NORMAL) ** 2
    common_variance = variance / max(info.sum(), _TINY)
    movers = movers[np.argsort(key[movers], kind="stable")]
    bodies = TrackSets(movers, np.unique(key[movers], return_counts=True)[1])
    score, info = _scores(views, scene, fit.take(movers), movers)
    score = score - common_hz * info
    of_body, info_of_body = bodies.sums(score), bodies.sums(info)
    noise = np.sqrt(variance * info_of_body + common_variance * info_of_body**2)
    differs = np.abs(of_body) > SIGMAS_999 * noise
    change_hz = quotient(of_body, info_of_body)[bodies.set_of]
    log_ratio = (score * change_hz - 0.5 * info * change_hz**2) / variance
    changes[movers] = differs[bodies.set_of] & (log_ratio > _LEAST_LOG_RATIO)
    return changes


def _scores(views: BodyViews, scene: RigidPaths, fit: PathFit, track: Ints) -> tuple[Floats, Floats]:
    """Score, in s, and information, in s^2, of the change of speed of the tracks ``track (M,)``: ``(M,)`` each.

    ``fit`` is that of the same tracks. A change by kappa, in 1/s, makes a path T(t) into T(t) (1 + kappa t): kappa is
    half of the acceleration over the speed. Place and inverse depth of a track are eliminated (Schur complement).
    """
    path, since_s, precision = scene.path[0], views.since_s[:, None], views.sigma_norm[track] ** -2.0
    xy = each_turned_into_plane(views.rays, track, scene.cam_R_past, np.zeros(len(track), dtype=np.int64))
    depth = 1.0 + fit.rate_hz * path[:, 2:]
    is_seen = np.isfinite(xy[..., 0]) & (depth > LEAST_DEPTH_RATIO)
    shrink = np.where(is_seen, quotient(1.0, depth), 0.0)
    there = (fit.place + fit.rate_hz[:, None] * path[:, None, :2]) * shrink[..., None]
    off = np.where(is_seen[..., None], xy - there, 0.0)
    weight = is_seen * precision / (1.0 + (off * off).sum(axis=2) * precision / ROBUST_SIGMAS**2)
    by_rate = (path[:, None, :2] - there * path[:, None, 2:]) * shrink[..., None]
    by_change = fit.rate_hz[:, None] * by_rate * since_s[..., None]
    own = np.maximum((weight * shrink * shrink).sum(axis=0), _TINY)

    def product(one: Floats, other: Floats) -> Floats:
        with_place = [np.einsum("lm,lmi->mi", weight * shrink, column) for column in (one, other)]
        return np.asarray(np.einsum("lm,lmi,lmi->m", weight, one, other) - np.einsum("mi,mi->m", *with_place) / own)

    part = product(by_rate, by_change) / np.maximum(product(by_rate, by_rate), _TINY)
    by_change = by_change - part[:, None] * by_rate
    return product(by_change, off), np.maximum(product(by_change, by_change), 0.0)
