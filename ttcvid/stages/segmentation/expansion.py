"""What comes straight at us: tracks at constant bearing, with diverging flows that one approaching object explains.

An object on collision course hardly moves in the picture: it expands. The flows of its tracks are not alike, as those
of other movers are, and a far scene explains each of them, or nearly. Together they belong to one approaching object,
with three unknowns for all, V / Z, where the scene has one for each.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np

from ttcvid.config import BodiesConfig
from ttcvid.geometry.estimation.growth import growth_sums
from ttcvid.geometry.estimation.track_on_trajectory import straight_path
from ttcvid.geometry.rotation import each_turned_into_plane, normalize, skew
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.segmentation.body_views import BodyViews, cost_of
from ttcvid.stages.segmentation.common_errors import SIGMAS_999, common_growth_hz
from ttcvid.stages.segmentation.scene import SeenScene
from ttcvid.stages.segmentation.surface_memory import Obstacle, remembered, tracks_of
from ttcvid.stages.tracking.history import TrackHistory

LEAST_VIEWS = 6
"""Views that a track needs: with fewer, one V / Z explains any."""
# Minimum number of tracks of a mover that expands, and of what does in the air, where little else is seen. Fewer than
# for other movers: three unknowns for all are stronger evidence than similar flows.
_LEAST_TRACKS, _LEAST_IN_AIR = 5, 4
# Tracks of one object lie within this many link lengths of the one that the scene explains worst (wing tips and nose
# of an aircraft). At most this many of the nearest are used.
_LINKS, _MOST_AROUND = 2.0, 48
# At most this many new movers per frame; of all, around at most this many tracks. In a street, tracks that slide along
# outlines of posts and trees contradict the scene more than a pedestrian does, some ten at a time, the same each frame.
_MOST_THINGS, _MOST_SEEDS = 3, 12
# What arrives later than this multiple of its observed span has hardly expanded yet: its direction is not told by that.
_REACHED_WITHIN = 6.0


@dataclass(frozen=True)
class Growing:
    """An expanding object: tracks ``(M,)``, direction ``(3,)`` V over its length, with its covariance ``(3, 3)``."""

    members: Ints
    direction: Floats
    direction_cov: Floats


def least_tracks(config: BodiesConfig) -> int:
    """Minimum number of tracks of a mover that expands."""
    return min(config.min_tracks, _LEAST_TRACKS)


def expanding_movers(
    views: BodyViews, seen: SeenScene, may_be: Bools, seeds: Ints, config: BodiesConfig
) -> list[tuple[Ints, Floats]]:
    """New movers that come nearer and expand, each with its tracks (M,) and its path (L, 3).

    The tracks of each are at least `least_tracks`, and cost less than in the scene, all together, as `new_movers` asks
    again of a refined path: what a linear fit makes of each track is crude.

    Parameters
    ----------
    may_be : (N,) tracks that things may be made of, each of `LEAST_VIEWS` at the least.
    seeds : those of the tracks that contradict the scene together.
    """
    is_asked, needed = may_be & np.isin(np.arange(len(may_be)), seeds), least_tracks(config)

    def is_better(by_scene: Floats, by_own: Floats) -> bool:
        return float((cost_of(by_scene) - cost_of(by_own)).sum()) >= needed * math.log(config.gain)

    on_scene = seen.scene.cam_R_past[0], seen.redchi, seen.median_redchi
    found = _expansions(views, *on_scene, may_be, is_asked, is_better, (needed, config.scene_gate))
    return [(members, straight_path(normalize(hz), views.since_s)) for members, hz, _ in islice(found, _MOST_THINGS)]


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
    may_be = in_scene & (np.isfinite(views.rays[..., 0]).sum(axis=0) >= LEAST_VIEWS)
    # Around tracks that contradict the scene, or are known to be part of such a thing.
    is_asked = may_be & ((redchi > config.scene_gate) | np.isin(history.track_id, tracks_of(before)))
    things, is_free, gate = list[Growing](), in_scene.copy(), config.scene_gate

    def is_better(by_scene: Floats, by_own: Floats) -> bool:
        return bool(by_scene[0] <= gate or by_own[0] < by_scene[0] / config.gain)

    on_scene = history.cam_R_seen, redchi, median_redchi
    for members, velocity_hz, cov in _expansions(views, *on_scene, may_be, is_asked, is_better, (_LEAST_IN_AIR, gate)):
        turned = skew(np.append(views.xy[members].mean(axis=0), 1.0))
        cov = cov + turned @ history.rotation_rate_cov @ turned.T
        direction = normalize(velocity_hz)
        across = (np.eye(3) - np.outer(direction, direction)) / np.linalg.norm(velocity_hz)
        things.append(Growing(members, direction, across @ cov @ across))
        is_free[members] = False
    public, memory, next_cluster_id = remembered(
        before, history.track_id, [thing.members for thing in things], is_free, next_cluster_id, config
    )
    # No track is part of two, and those of what is only remembered are part of none.
    thing_of = {int(thing.members[0]): thing for thing in things}
    found = {number: thing_of[int(own[0])] for number, own in public.items() if len(own) and int(own[0]) in thing_of}
    return found, memory, next_cluster_id


def _expansions(
    views: BodyViews,
    cam_R_past: Floats,
    redchi: Floats,
    median_redchi: float,
    may_be: Bools,
    is_asked: Bools,
    is_better: Callable[[Floats, Floats], bool],
    limits: tuple[int, float],
) -> Iterator[tuple[Ints, Floats, Floats]]:
    """Things that come nearer: tracks (M,), V / Z (3,) and its covariance (3, 3) of each, in 1/s.

    Each is around a track that ``is_asked (N,)``, first around those that the scene explains worst, of that and the
    nearest others that ``may_be (N,)`` part of one. By their ``redchi (M,)`` in the scene and on V / Z, that track
    first, ``is_better`` says whether they are one. ``limits`` are their least number and their largest misfit.
    """
    near, n_tried, (least, most_redchi) = np.flatnonzero(may_be), 0, limits
    asked = np.flatnonzero(is_asked[near])
    if not len(asked):
        return
    # Most tracks are around several of those asked, and say the same each time.
    xy = each_turned_into_plane(views.rays, near, cam_R_past[None], np.zeros(len(near), dtype=np.int64))
    sums = growth_sums(xy, views.since_s, np.sqrt(median_redchi) * views.sigma_norm[near])
    xy_px, redchi, is_free = views.xy_px[near], redchi[near], np.ones(len(near), dtype=bool)
    for seed in asked[np.argsort(-redchi[asked], kind="stable")]:
        if n_tried == _MOST_SEEDS:
            return
        if not is_free[seed]:
            continue
        n_tried += 1
        square = ((xy_px - xy_px[seed]) ** 2).sum(axis=1)
        around = np.flatnonzero(is_free & (square < (_LINKS * views.link_px) ** 2))
        around = around[np.argsort(square[around], kind="stable")[:_MOST_AROUND]]
        of_these, by_scene = sums.of(around), redchi[around]
        fits = of_these.sharing_a_velocity(by_scene, most_redchi, least)
        if fits is None or not fits[0]:
            continue
        velocity_hz, cov = of_these.unknowns(fits)
        by_own = of_these.redchi_of(velocity_hz)
        if not is_better(by_scene[fits], by_own[fits]):
            continue
        members = np.sort(around[fits])
        seen_s = float(np.median(-views.since_s[np.argmax(np.isfinite(xy[:, members, 0]), axis=0)]))
        radius_px = np.sqrt(np.mean(np.sum((xy_px[members] - xy_px[members].mean(axis=0)) ** 2, axis=1)))
        common_hz = common_growth_hz(radius_px, np.asarray(seen_s)) * np.append(xy[-1, members].mean(axis=0), 1.0)
        # No surer than their misfits leave it, nor than what their matching errs by in common.
        cov = max(float(by_own[fits].mean()), 1.0) * cov + np.outer(common_hz, common_hz)
        if -velocity_hz[2] > max(SIGMAS_999 * math.sqrt(cov[2, 2]), 1.0 / (_REACHED_WITHIN * seen_s)):
            yield near[members], velocity_hz, cov
            is_free[members] = False
