"""New movers at constant bearing: tracks with diverging flows that one approaching object explains.

An object on collision course hardly moves in the picture: it expands. The flows of its tracks are not similar, as those
of other movers are, but one V / Z explains them all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.config import BodiesConfig
from ttcvid.geometry.estimation.growth import GrowthSums, growth_sums
from ttcvid.geometry.estimation.track_on_trajectory import straight_path
from ttcvid.geometry.rotation import each_turned_into_plane
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.segmentation.body_views import BodyViews, cost_of
from ttcvid.stages.segmentation.common_errors import SIGMAS_999, common_growth_hz
from ttcvid.stages.segmentation.expansion import nearest_around, oddest_first
from ttcvid.stages.segmentation.scene import SeenScene

# Minimum number of tracks for an expanding object. Fewer than for other movers, since three unknowns for all are
# stronger evidence than similar flows; as many as support a surface.
_ENOUGH_TRACKS = 5
# Minimum number of tracks of an object that heads at us, the fewest that determine V / Z with one to spare. It
# arrives within this time (a warning is of no use later), and passes within this part of its distance (half of two
# cars at 20 m), and within the other part of the distance at which a static point there would pass: tracks that slide
# along outlines of static objects pass us as these do, and close to our heading everything static heads at us.
_FEW_TRACKS, _SOON_S, _AT_US, _UNLIKE_STANDING = 3, 5.0, 0.1, 0.5
# At most this many searches for objects of so few tracks.
_ROUNDS = 3
# At most this many objects per frame, around at most this many tracks: in a street, tracks that slide along outlines
# of posts and trees contradict the scene more than a pedestrian does, some ten at a time, the same ones in each
# frame.
_MOST_THINGS, _MOST_SEEDS = 3, 12
# What arrives later than this multiple of its observed span has hardly expanded: similar flows determine its
# direction better.
_REACHED_WITHIN = 6.0


def least_tracks(config: BodiesConfig) -> int:
    """Minimum number of tracks for an expanding object."""
    return min(config.min_tracks, _ENOUGH_TRACKS)


def cost_of_birth(needed: Ints | int, config: BodiesConfig) -> Floats:
    """What the tracks of a new thing have to save together, by `cost_of`: about as much as ``needed`` tracks with a
    large chi-square do that it explains better by the ``gain``.
    """
    return np.asarray(needed * np.log(config.gain))


def tracks_needed(things: list[tuple[Ints, Floats]], config: BodiesConfig) -> Ints:
    """Tracks (K,) that each thing needs that its own path surely explains: all of `least_tracks`, or of fewer these."""
    lengths, least = np.array([len(members) for members, _ in things], dtype=np.int64), least_tracks(config)
    return np.where(lengths < least, _FEW_TRACKS, least)


def expanding_movers(
    views: BodyViews, seen: SeenScene, may_be: Bools, seeds: Ints, config: BodiesConfig, *, few_are_enough: bool
) -> list[tuple[Ints, Floats]]:
    """Things that come nearer and spread, each with its tracks (M,) and its path (L, 3).

    The tracks of each are `least_tracks`, and cost less than in the scene, all together, by `cost_of_birth`. (What a
    linear fit makes of each track is crude: `new_movers` asks the same of a refined path.) Of what heads at us, soon, a
    few may be enough, if each contradicts the scene and is explained better by `BodiesConfig.gain`.

    Parameters
    ----------
    may_be : (N,) tracks that things may be made of, each of `LEAST_VIEWS` at the least.
    seeds : those of the tracks that contradict the scene together.
    few_are_enough : of what heads at us.
    """
    is_asked = np.zeros(len(may_be), dtype=bool)
    is_asked[seeds] = may_be[seeds]
    if not is_asked.any():
        return []
    things, small, needed = list[_Thing](), list[_Thing](), least_tracks(config)
    least = min(_FEW_TRACKS, needed) if few_are_enough else needed
    # Most tracks are around several of those asked, and say the same each time.
    near = np.flatnonzero(may_be)
    xy = each_turned_into_plane(views.rays, near, seen.scene.cam_R_past, np.zeros(len(near), dtype=np.int64))
    sums = growth_sums(xy, views.since_s, np.sqrt(seen.median_redchi) * views.sigma_norm[near])
    xy_px, redchi, is_free, n_tried = views.xy_px[near], seen.redchi[near], np.ones(len(near), dtype=bool), 0
    for seed in oddest_first(redchi, is_asked[near]):
        if len(things) == _MOST_THINGS or n_tried == _MOST_SEEDS:
            break
        if not is_free[seed]:
            continue
        n_tried += 1
        around = nearest_around(seed, xy_px, is_free, views.link_px)
        found = _thing_around(sums.of(around), redchi[around], least, needed, config)
        if found is None:
            continue
        thing = _Thing(around[found.is_in], found.unknowns)
        own_xy = xy[:, thing.members]
        seen_s = float(np.median(-views.since_s[np.argmax(np.isfinite(own_xy[:, :, 0]), axis=0)]))
        within_s = _SOON_S if found.is_few else _REACHED_WITHIN * seen_s
        if not _grows(xy_px[thing.members], seen_s, found, 1.0 / within_s):
            continue
        if not found.is_few:
            things.append(thing)
            is_free[thing.members] = False
        elif _heads_at_us(own_xy[-1].mean(axis=0), thing.unknowns, seen.scene.path[0, 0]):
            small.append(thing)
    things = _with_small_ones(things, small, sums, config)
    return [(near[thing.members], thing.path(views.since_s)) for thing in things]


@dataclass(frozen=True)
class _Thing:
    """Tracks ``members (M,)`` of `GrowthSums` that share ``unknowns (3,)``."""

    members: Ints
    unknowns: Floats

    def path(self, since_s: Floats) -> Floats:
        """Where it was at the times ``since_s (L,)``, less where it is, in s of its speed: (L, 3)."""
        return straight_path(self.unknowns / np.linalg.norm(self.unknowns), since_s)


@dataclass(frozen=True)
class _Sharing:
    """Which of some tracks (M,) share ``unknowns (3,)`` of `GrowthSums`, and the standard deviation of c, 1/s.

    ``is_few``: fewer than a thing needs that does not head at us.
    """

    is_in: Bools
    unknowns: Floats
    sigma_hz: float
    is_few: bool


def _with_small_ones(things: list[_Thing], small: list[_Thing], sums: GrowthSums, config: BodiesConfig) -> list[_Thing]:
    """The things, and of those of few tracks the first that are no part of another.

    What is left over of a thing is none.
    """
    things = list(things)
    for thing in small:
        own = sums.of(thing.members)
        is_other = all(float(np.median(own.redchi_of(one.unknowns))) > config.scene_gate for one in things)
        is_free = not any(np.isin(thing.members, one.members).any() for one in things)
        if len(things) < _MOST_THINGS and is_free and is_other:
            things.append(thing)
    return things


def _thing_around(sums: GrowthSums, redchi: Floats, least: int, needed: int, config: BodiesConfig) -> _Sharing | None:
    """Which of some tracks (M,), so many at the ``least``, are a thing with the first; None: too few.

    Of a thing that saves too little, or has fewer than ``needed``, those that contradict the scene one by one.
    """
    fits = sums.sharing_a_velocity(redchi, config.scene_gate, least)
    if fits is None or not fits[0]:
        return None
    unknowns, cov = sums.unknowns(fits)
    own = sums.redchi_of(unknowns)
    saved = float((cost_of(redchi) - cost_of(own))[fits].sum())
    if np.count_nonzero(fits) < needed or saved < cost_of_birth(needed, config):
        return _odd_ones(sums, fits, redchi, config)
    return _shared_by(fits, unknowns, cov, own, is_few=False)


def _odd_ones(sums: GrowthSums, fits: Bools, redchi: Floats, config: BodiesConfig) -> _Sharing | None:
    """Those of the tracks ``fits (M,)`` that contradict the scene one by one; None where they are too few."""
    fits = fits & (redchi > config.scene_gate)
    for _ in range(_ROUNDS):
        if np.count_nonzero(fits) < _FEW_TRACKS:
            return None
        unknowns, cov = sums.unknowns(fits)
        own = sums.redchi_of(unknowns)
        stays = fits & (own < redchi / config.gain)
        if np.array_equal(stays, fits):
            return _shared_by(fits, unknowns, cov, own, is_few=True)
        fits = stays
    return None


def _grows(xy_px: Floats, seen_s: float, found: _Sharing, least_hz: float) -> bool:
    """Whether tracks at ``xy_px (M, 2)`` surely come nearer, beyond what they err by in common, and at ``least_hz``."""
    radius_px = np.sqrt(np.mean(np.sum((xy_px - xy_px.mean(axis=0)) ** 2, axis=1)))
    common_hz = float(common_growth_hz(np.asarray(radius_px), np.asarray(seen_s)))
    return bool(-found.unknowns[2] > max(SIGMAS_999 * float(np.hypot(found.sigma_hz, common_hz)), least_hz))


def _shared_by(fits: Bools, unknowns: Floats, cov: Floats, own: Floats, *, is_few: bool) -> _Sharing:
    """What the tracks ``fits (M,)`` share, no surer than their misfits ``own (M,)`` leave it."""
    return _Sharing(fits, unknowns, float(np.sqrt(max(float(own[fits].mean()), 1.0) * cov[2, 2])), is_few)


def _heads_at_us(xy: Floats, velocity_hz: Floats, own_path: Floats) -> bool:
    """Whether what is at ``xy (2,)``, in the plane z = 1, and comes nearer at ``velocity_hz`` passes near us.

    And much nearer than what stands still there, as the scene does that was at ``own_path (3,)``.
    """
    off = float(np.hypot(*(xy - velocity_hz[:2] / velocity_hz[2])))
    stands_off = float(np.hypot(*(xy - own_path[:2] / own_path[2]))) if own_path[2] > 0.0 else np.inf
    return off < min(_AT_US, _UNLIKE_STANDING * stands_off)
