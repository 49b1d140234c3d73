"""New movers that keep their bearing: tracks whose flows point away from each other, as those of one thing that comes.

What crosses our way and will hit us hardly moves in the picture: it grows. The flows of its tracks are not alike, as
those of other movers are, but one V / Z explains them all.
"""

from __future__ import annotations

import numpy as np

from ttcvid.config import BodiesConfig
from ttcvid.geometry.growth import GrowthSums, growth_sums
from ttcvid.geometry.rigid_path import RigidPaths
from ttcvid.geometry.rotation import each_turned_into_plane
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.approach import common_growth_hz
from ttcvid.stages.body_views import BodyViews
from ttcvid.stages.growing import SIGMAS_999, around_any, around_the_oddest

# Tracks that are enough for a thing: fewer than those of other movers, since three unknowns for all say more than flows
# that are alike; as many as bear a surface.
_ENOUGH_TRACKS = 5
# So many things are looked for in a frame, around so many tracks: in a street, tracks that slide along the outlines of
# posts and trees contradict the scene worse than somebody who walks does, some ten at a time, and the same ones in each
# frame.
_MOST_THINGS, _MOST_SEEDS = 3, 12
# Misfits below this are noise.
_NOISE = 1.0
# What will be here later than so many times as long as it has been seen has hardly grown: its direction is better told
# by flows that are alike.
_REACHED_WITHIN = 6.0


def least_tracks(config: BodiesConfig) -> int:
    """Tracks that a thing needs that spreads."""
    return min(config.min_tracks, _ENOUGH_TRACKS)


def spreading_things(
    views: BodyViews,
    scene: RigidPaths,
    may_be: Bools,
    sway: Floats,
    seeds: Ints,
    misfit: Floats,
    usual_misfit: float,
    config: BodiesConfig,
) -> list[tuple[Ints, Floats]]:
    """Things that come nearer and spread, each with its tracks (M,) and its path (L, 3).

    The tracks of each are `least_tracks`, and explained better than by the scene, all together and that one around
    which it was looked for, by `BodiesConfig.gain`; as many misfit the scene by so much. (What a linear fit makes of
    each track is too crude to ask more of all: `new_movers` does, of a refined path.)

    Parameters
    ----------
    may_be : (N,) tracks that things may be made of, each of `LEAST_VIEWS` at the least.
    sway : (L, 3) how far the scene lay off a steady path, as in `bodies.sway_of`.
    seeds : those of the tracks that contradict the scene together.
    misfit : (N,) of each track on the path of the scene, in units of ``usual_misfit``.
    """
    is_free, is_asked = may_be.copy(), np.zeros(len(may_be), dtype=bool)
    is_asked[seeds] = may_be[seeds]
    things, needed = list[tuple[Ints, Floats]](), least_tracks(config)
    # Most tracks are around several of those asked, and say the same each time.
    near, place = around_any(views.xy_px, is_asked, is_free, views.link_px), np.empty(len(may_be), dtype=np.int64)
    place[near] = np.arange(len(near))
    xy = each_turned_into_plane(views.rays, near, scene.cam_R_past, np.zeros(len(near), dtype=np.int64))
    sums = growth_sums(xy, views.since_s, np.sqrt(usual_misfit) * views.sigma_norm[near], sway)
    for _ in range(_MOST_SEEDS):
        if len(things) == _MOST_THINGS or not np.count_nonzero(is_asked):
            break
        seed, around = around_the_oddest(views.xy_px, misfit, is_asked, is_free, views.link_px)
        is_asked[seed] = False
        around_misfit = misfit[around]
        if np.count_nonzero(around_misfit > config.gain) < needed:
            continue
        found = _thing_around(sums.of(place[around]), around_misfit, config)
        if found is None:
            continue
        fits, unknowns, sigma_hz = found
        velocity_hz, path = unknowns[:3], views.since_s[:, None] * unknowns[:3] + unknowns[3] * sway
        members, xy_px = around[fits], views.xy_px[around[fits]]
        seen_s = -views.since_s[np.argmax(np.isfinite(xy[:, place[members], 0]), axis=0)]
        radius_px = np.sqrt(np.mean(np.sum((xy_px - xy_px.mean(axis=0)) ** 2, axis=1)))
        common_hz = float(common_growth_hz(np.asarray(radius_px), np.median(seen_s)))
        least_hz = 1.0 / (_REACHED_WITHIN * np.median(seen_s))
        if -velocity_hz[2] > max(SIGMAS_999 * float(np.hypot(sigma_hz, common_hz)), least_hz):
            things.append((members, path / np.linalg.norm(velocity_hz)))
            is_free[members] = is_asked[members] = False
    return things


def _thing_around(sums: GrowthSums, misfit: Floats, config: BodiesConfig) -> tuple[Bools, Floats, float] | None:
    """Which of some tracks (M,) are a thing with the first; its (a, b, c, s), and the standard deviation of c."""
    fits = sums.sharing_a_velocity(misfit, config.scene_gate, least_tracks(config))
    if fits is None:
        return None
    unknowns, cov = sums.unknowns(fits)
    own = sums.misfits(unknowns)
    is_better = np.maximum(own[fits], _NOISE).sum() < misfit[fits].sum() / config.gain
    if not (fits[0] and own[0] < misfit[0] / config.gain and is_better):
        return None
    return fits, unknowns, float(np.sqrt(max(float(own[fits].mean()), 1.0) * cov[2, 2]))
