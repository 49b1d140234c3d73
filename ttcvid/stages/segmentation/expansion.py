"""What heads straight at us on a trajectory of its own: a few tracks at constant bearing that expand.

An aircraft on collision course stands still in the picture and expands. A far scene explains each of its tracks, or
nearly, and their flows diverge. Together they belong to one approaching object, with three unknowns for all, where the
scene has one for each.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ttcvid.config import BodiesConfig
from ttcvid.geometry.estimation.growth import growth_sums
from ttcvid.geometry.rotation import skew, turned_into_plane
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.segmentation.body_views import BodyViews
from ttcvid.stages.segmentation.common_errors import SIGMAS_999, common_growth_hz
from ttcvid.stages.segmentation.obstacles import REACHED_WITHIN_S
from ttcvid.stages.segmentation.surface_memory import Obstacle, remembered, tracks_of
from ttcvid.stages.tracking.history import TrackHistory

LEAST_VIEWS = 6
"""Views that a track needs: with fewer, one V / Z explains any."""
# Minimum number of tracks for an expanding object: as many as for an obstacle, fewer than for a mover. A common
# velocity, which no two objects of the scene have, is stronger evidence than their number.
_LEAST_TRACKS = 4
# Tracks of one object lie within this many link lengths of the one that the scene explains worst (wing tips and nose
# of an aircraft). At most this many of the nearest are used, for at most this many objects per frame.
_LINKS, _MOST_AROUND, _MOST_THINGS = 2.0, 48, 6


@dataclass(frozen=True)
class Growing:
    """An expanding object: tracks ``(M,)``, direction ``(3,)`` V over its length, with its covariance ``(3, 3)``."""

    members: Ints
    direction: Floats
    direction_cov: Floats


def find_growing(
    before: tuple[Obstacle, ...],
    history: TrackHistory,
    redchi: Floats,
    median_redchi: float,
    in_scene: Bools,
    views: BodyViews,
    next_cluster_id: int,
    config: BodiesConfig,
) -> tuple[dict[int, Growing], tuple[Obstacle, ...], int]:
    """The public things that are seen to grow in this frame, by their numbers; what to remember; the next number.

    ``before`` is what the last frame remembered, ``views`` are those of the N tracks of the ``history``; ``redchi
    (N,)`` in the scene, in units of the ``median_redchi``; ``in_scene (N,)`` tracks are of no mover.
    """
    may_be = in_scene & (history.n_frames >= LEAST_VIEWS)
    # Around tracks that contradict the scene, or are known to be part of such a thing.
    is_asked = may_be & ((redchi > config.scene_gate) | np.isin(history.track_id, tracks_of(before)))
    things = list[Growing]()
    for around in around_oddest(redchi, is_asked, history.xy_px, may_be, views.link_px, _MOST_THINGS):
        sigma_norm = np.sqrt(median_redchi) * views.sigma_norm[around]
        thing = _thing_around(history, around, redchi[around], sigma_norm, config)
        if thing is not None:
            things.append(thing)
            may_be[thing.members] = False
    is_free = in_scene.copy()
    for thing in things:
        is_free[thing.members] = False
    public, memory, next_cluster_id = remembered(
        before, history.track_id, [thing.members for thing in things], is_free, next_cluster_id, config
    )
    # No track is part of two, and those of what is only remembered are part of none.
    thing_of = {int(thing.members[0]): thing for thing in things}
    found = {number: thing_of[int(own[0])] for number, own in public.items() if len(own) and int(own[0]) in thing_of}
    return found, memory, next_cluster_id


def around_oddest(
    redchi: Floats, is_asked: Bools, xy_px: Floats, may_be: Bools, link_px: float, most: int
) -> Iterator[Ints]:
    """Sets of tracks ``(M,)`` around each of ``most`` tracks at most, first those that the scene explains worst.

    Around those that are asked, by ``redchi (N,)``, which stand first; then the nearest at ``xy_px (N, 2)`` within
    `_LINKS`. Of both only those that ``may_be (N,)`` at that time: whoever takes some of a set clears them there.
    """
    asked, n_tried = np.flatnonzero(is_asked), 0
    for seed in asked[np.argsort(-redchi[asked], kind="stable")]:
        if n_tried == most:
            break
        if not may_be[seed]:
            continue
        n_tried += 1
        off_px = xy_px - xy_px[seed]
        square = np.einsum("ni,ni->n", off_px, off_px)
        around = np.flatnonzero(may_be & (square < (_LINKS * link_px) ** 2))
        yield np.asarray(around[np.argsort(square[around], kind="stable")[:_MOST_AROUND]])


def _thing_around(
    history: TrackHistory, around: Ints, redchi: Floats, sigma_norm: Floats, config: BodiesConfig
) -> Growing | None:
    """The thing that the first of some tracks (M,) is a part of; None where they show none that comes at us.

    ``redchi, sigma_norm (M,)`` are their reduced chi-squares in the scene, and their noise as the scene shows it.
    """
    past = slice(0, history.n_past + 1)
    xy = turned_into_plane(history.rays[past][:, around], history.cam_R_seen[past])
    sums = growth_sums(xy, history.since_s[past], sigma_norm)
    fits = sums.sharing_a_velocity(redchi, config.scene_gate, _LEAST_TRACKS)
    if fits is None:
        return None
    velocity_hz, cov = sums.unknowns(fits)
    own = sums.redchi_of(velocity_hz)
    if not fits[0] or (redchi[0] > config.scene_gate and not own[0] < redchi[0] / config.gain):
        return None
    cov = max(float(own[fits].mean()), 1.0) * cov + _common_cov(history, around[fits], xy[:, fits])
    if not -velocity_hz[2] > max(SIGMAS_999 * float(np.sqrt(cov[2, 2])), 1.0 / REACHED_WITHIN_S):
        return None
    speed_hz = float(np.linalg.norm(velocity_hz))
    direction = velocity_hz / speed_hz
    across = (np.eye(3) - np.outer(direction, direction)) / speed_hz
    return Growing(np.sort(around[fits]), direction, across @ cov @ across)


def _common_cov(history: TrackHistory, members: Ints, xy: Floats) -> Floats:
    """Covariance (3, 3) of V / Z of some tracks (M,) by what they err by in common: matching, and own rotation.

    ``xy (L, M, 2)`` their places in the plane z = 1.
    """
    off_px = history.xy_px[members] - history.xy_px[members].mean(axis=0)
    seen_s = -history.since_s[np.argmax(np.isfinite(xy[:, :, 0]), axis=0)]
    radius_px = float(np.sqrt(np.mean(np.sum(off_px**2, axis=1))))
    ray = np.append(xy[-1].mean(axis=0), 1.0)
    turned = skew(ray)
    growth_hz = float(common_growth_hz(np.asarray(radius_px), np.median(seen_s)))
    return np.asarray(growth_hz**2 * np.outer(ray, ray) + turned @ history.rotation_rate_cov @ turned.T)
