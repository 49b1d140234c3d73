"""Data association: each track gets the body that explains its views best, with smoothness over neighbours."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ttcvid.config import BodiesConfig
from ttcvid.geometry.estimation.rigid_motion import RigidPaths
from ttcvid.geometry.medians import medians
from ttcvid.model import NO_CLUSTER, SCENE_CLUSTER, Bools, Floats, Ints
from ttcvid.stages.segmentation.body_views import BodyViews, cost_of, fit_on_movers
from ttcvid.stages.segmentation.common_errors import drift_cost
from ttcvid.stages.segmentation.fixed_to_camera import FOLLOWS
from ttcvid.stages.segmentation.last_known import LastKnown, nothing_known
from ttcvid.stages.segmentation.scene import SeenScene

# Rewards of a label: agreement of all neighbours that are sure of it, the former label, and the scene.
_NEIGHBOUR_WEIGHT, _HABIT_WEIGHT, _SCENE_WEIGHT = 1.0, 0.3, 0.4
# The rewards of the former label and of the scene hold for tracks with more views than these.
_HABIT_VIEWS, _SCENE_VIEWS = 3, 2
# A track whose reduced chi-square under the scene is below the first (over the usual one) is not associated with a
# mover whose tracks are this many times as far away: a bus seen from behind at 10 m ends at 22 m.
_SCENE_EXPLAINS, _NEARER, _RATE_SIGMAS = 3.0, 2.0, 3.0
# A mover most of whose tracks have a smaller reduced chi-square (over the usual one) under the scene stands still. Its
# own trajectory, free in every frame, would explain them better still, and its tracks would support each other.
_AS_STILL = 1.0
# Nor is one a mover that costs less than this as a part of the scene that drifts.
_AS_DRIFT = 1.0
# A hidden mover can be re-identified for this long, s: later its motion may have changed.
_KNOWN_AGAIN_S = 1.0
# Merges and splits are tried in the first frames of a mover, then every fourth frame.
_YOUNG_FRAMES, _DUE_FRAMES = 5, 4


@dataclass(frozen=True)
class Movers:
    """K movers, ascending in ``key``.

    key : ``(K,)`` internal number.
    cluster_id : ``(K,)`` public number; `NO_CLUSTER` until the mover is confirmed.
    n_found, n_missed : ``(K,)`` frames in which it was found, and frames without since the last of them.
    rate_hz : ``(K,)`` median inverse depth of its tracks (speed over depth), 1/s.
    paths : relative trajectories.
    last : last known positions and velocities.
    """

    key: Ints
    cluster_id: Ints
    n_found: Ints
    n_missed: Ints
    rate_hz: Floats
    paths: RigidPaths
    last: LastKnown

    def __len__(self) -> int:
        return len(self.key)

    def take(self, index: Ints | Bools) -> Movers:
        """The movers of an index array or a mask ``(K,)``."""
        return Movers(
            self.key[index],
            self.cluster_id[index],
            self.n_found[index],
            self.n_missed[index],
            self.rate_hz[index],
            self.paths.take(index),
            self.last.take(index),
        )

    def with_new(self, next_key: int, paths: RigidPaths, rate_hz: Floats) -> Movers:
        """The movers and J new ones, whose keys count up from ``next_key``; ``rate_hz (J,)``."""
        count = len(paths)
        if not count:
            return self
        return Movers(
            np.append(self.key, next_key + np.arange(count)),
            np.append(self.cluster_id, np.full(count, NO_CLUSTER)),
            np.append(self.n_found, np.ones(count, dtype=np.int64)),
            np.append(self.n_missed, np.zeros(count, dtype=np.int64)),
            np.append(self.rate_hz, rate_hz),
            self.paths.joined(paths),
            self.last.with_new(count),
        )


def no_movers(n_views: int) -> Movers:
    """Zero movers, with trajectories over ``n_views`` views."""
    none, paths = np.empty(0, dtype=np.int64), RigidPaths(np.empty((0, n_views, 3, 3)), np.empty((0, n_views, 3)))
    return Movers(none, none, none, none, np.empty(0), paths, nothing_known(0))


def is_due(n_found: Ints) -> Bools:
    """Whether merges and splits are tried in this frame for movers: ``(K,)``, by their ``n_found (K,)``."""
    return np.asarray((n_found <= _YOUNG_FRAMES) | (n_found % _DUE_FRAMES == 0))


def numbers_of(key: Ints, movers: Movers) -> Ints:
    """Index of the body of each track: ``(N,)``, 0 the scene, else 1 + index of its mover."""
    return np.searchsorted(movers.key, key, side="right")


def assigned(views: BodyViews, seen: SeenScene, key: Ints, movers: Movers, neighbours: Ints) -> tuple[Ints, Floats]:
    """Labels of least cost over the scene, a track's former body and those of its neighbours.

    Parameters
    ----------
    key : ``(N,)`` former body of each track.
    neighbours : ``(N, K)`` neighbours of tracks; themselves for missing ones.

    Returns the key ``(N,)`` of the body of each track, and its reduced chi-square on that, over the scene's median one.
    """
    redchi = seen.redchi
    if not len(movers):
        return key, redchi
    number, n_bodies = numbers_of(key, movers), len(movers) + 1
    votes = _votes(number, neighbours, n_bodies, np.ones(len(key)))
    n_neighbours = votes.sum(axis=1, keepdims=True)
    # As one array, so that both are contiguous: other types would compile the fit of points a second time.
    track, mover = np.array(np.nonzero((votes[:, 1:] > 0) | (number[:, None] == np.arange(1, n_bodies))))
    points = views.points(track, mover)
    fit = fit_on_movers(points, movers.paths, movers.rate_hz)
    off = fit.redchi / seen.median_redchi
    is_own = number[track] == mover + 1
    is_other = redchi[track] < _SCENE_EXPLAINS
    is_other &= are_nearer(fit.rate_hz, fit.rate_sigma_hz, mover, is_own, len(movers))
    is_no_part = (redchi[track] < _AS_STILL) | (seen.ride_odds[track] > -FOLLOWS)
    n_own, n_still = (np.bincount(mover, one, len(movers)) for one in (is_own, is_own & is_no_part))
    is_no_mover = n_still > 0.5 * n_own
    # What the road contradicts moves along our own way: that is no drift.
    residual_px2 = np.where(redchi > seen.seen_redchi, np.inf, seen.residual_px2(views))
    is_no_mover |= drift_cost(residual_px2, number, n_bodies, views.common_px)[1:] < _AS_DRIFT
    # Infinite: combinations that are not tried, or excluded.
    redchis = np.full((len(key), n_bodies), np.inf)
    redchis[:, 0], redchis[track, 1 + mover] = redchi, np.where(is_other | is_no_mover[mover], np.inf, off)
    agreement = _votes(number, neighbours, n_bodies, sureness(redchis, number)) / np.maximum(n_neighbours, 1.0)
    best = np.argmin(_costs(redchis, agreement, number, seen.fit.n_views, seen.camera_rests), axis=1)
    return np.append(SCENE_CLUSTER, movers.key)[best], redchis[np.arange(len(key)), best]


def are_nearer(rate_hz: Floats, sigma_hz: Floats, thing: Ints, is_own: Bools, n_things: int) -> Bools:
    """Whether tracks ``(M,)`` are significantly nearer than the other tracks of an object, too near to be part of it.

    The trajectory of a car ahead in our direction is that of the scene up to its speed: it explains the road before the
    car as well as the scene does, at another depth. ``rate_hz, sigma_hz (M,)`` inverse depth of each track on the
    trajectory of object ``thing (M,)``, 1/s; ``is_own (M,)`` whether it belongs to that now.
    """
    is_own = is_own & np.isfinite(rate_hz)
    median_hz = medians(rate_hz[is_own], thing[is_own], n_things)[thing]
    # False without an inverse depth (NaN) of the track or of the object.
    return np.asarray(rate_hz - median_hz - _RATE_SIGMAS * sigma_hz > (_NEARER - 1.0) * np.abs(median_hz))


def _votes(number: Ints, neighbours: Ints, n_bodies: int, weight: Floats) -> Floats:
    """Sum of the ``weight (N,)`` of the neighbours ``(N, K)`` of each track in each body: ``(N, B)``."""
    track = np.arange(len(number))[:, None]
    place, weights = track * n_bodies + number[neighbours], np.where(neighbours != track, weight[neighbours], 0.0)
    votes = np.bincount(place.ravel(), weights.ravel(), len(number) * n_bodies)
    return np.asarray(votes.reshape(len(number), n_bodies))


def sureness(redchis: Floats, number: Ints) -> Floats:
    """By how much the probability of the former body of each track differs from that of the likeliest other: ``(N,)``.

    ``redchis (N, B)`` and ``number (N,)`` as in `_costs`. What two bodies explain alike, or none does, has no say in
    where its neighbours belong: far background at the vanishing point fits a car ahead of us as well as the scene.
    """
    costs, track = cost_of(redchis), np.arange(len(number))
    own = costs[track, number]
    costs[track, number] = np.inf
    return np.asarray(np.tanh(0.5 * np.abs(np.ascontiguousarray(costs.T).min(axis=0) - own)))


def _costs(redchis: Floats, agreement: Floats, number: Ints, n_views: Ints, camera_rests: bool) -> Floats:
    """Cost of each body for each track: ``(N, B)``, the scene first.

    By ``redchis, agreement (N, B)``, reduced chi-square over the median one and share of the neighbours as far as they
    are sure, and ``number, n_views (N,)``, former body and number of views. Before a camera at rest the trajectory of
    the scene is exact: no label is rewarded, no chi-square capped. A swinging leg fits its body badly, the scene worse.
    """
    heard = _NEIGHBOUR_WEIGHT * agreement
    if camera_rests:
        return np.asarray(np.log1p(redchis) - heard)
    costs = np.where(np.isinf(redchis), np.inf, cost_of(redchis) - heard)
    costs[n_views > _SCENE_VIEWS, 0] -= _SCENE_WEIGHT
    old = np.flatnonzero(n_views > _HABIT_VIEWS)
    costs[old, number[old]] -= _HABIT_WEIGHT
    return costs


def kept(views: BodyViews, key: Ints, movers: Movers, config: BodiesConfig) -> tuple[Ints, Movers]:
    """Labels and movers without those that are lost.

    A mover of too few tracks is lost after ``forget_frames``, and its tracks go to the scene. A confirmed one is kept
    without tracks for `_KNOWN_AGAIN_S` after it was last seen, for its re-identification.
    """
    number, now_s, least = numbers_of(key, movers), views.t_s[-1], min(3, config.min_tracks)
    counts = np.bincount(number, minlength=len(movers) + 1)[1:]
    is_found = counts >= least
    is_held = is_found | (movers.n_missed < config.forget_frames)
    is_hidden = (movers.cluster_id != NO_CLUSTER) & (is_held | (now_s - movers.last.seen_s <= _KNOWN_AGAIN_S))
    movers = replace(
        movers,
        n_found=movers.n_found + is_found,
        n_missed=np.where(is_found, 0, movers.n_missed + 1),
        last=movers.last.with_positions(number, views.xy, movers.rate_hz, now_s, least),
    )
    is_kept = (is_held & (counts > 0)) | is_hidden
    key = np.where(np.append(True, is_held)[number], key, SCENE_CLUSTER)
    return key, movers if is_kept.all() else movers.take(is_kept)
