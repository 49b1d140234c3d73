"""New movers at constant bearing: tracks with diverging flows that one approaching object explains.

An object on collision course hardly moves in the picture: it expands. The flows of its tracks are not similar, as those
of other movers are, but one V / Z explains them all.
"""

from __future__ import annotations

import math

import numpy as np

from ttcvid.config import BodiesConfig
from ttcvid.geometry.estimation.growth import GrowthSums, growth_sums
from ttcvid.geometry.estimation.track_on_trajectory import straight_path
from ttcvid.geometry.rotation import each_turned_into_plane
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.segmentation.body_views import BodyViews, cost_of
from ttcvid.stages.segmentation.common_errors import SIGMAS_999, common_growth_hz
from ttcvid.stages.segmentation.expansion import around_oddest
from ttcvid.stages.segmentation.scene import SeenScene

# Minimum number of tracks for an expanding object. Fewer than for other movers, since three unknowns for all are
# stronger evidence than similar flows; as many as support a surface.
_ENOUGH_TRACKS = 5
# At most this many objects per frame, around at most this many tracks: in a street, tracks that slide along outlines of
# posts and trees contradict the scene more than a pedestrian does, some ten at a time, the same ones in each frame.
_MOST_THINGS, _MOST_SEEDS = 3, 12
# What arrives later than this multiple of its observed span has hardly expanded: similar flows determine its
# direction better.
_REACHED_WITHIN = 6.0


def least_tracks(config: BodiesConfig) -> int:
    """Minimum number of tracks for an expanding object."""
    return min(config.min_tracks, _ENOUGH_TRACKS)


def cost_of_birth(needed: int, config: BodiesConfig) -> float:
    """What the tracks of a new thing have to save together, by `cost_of`: about as much as ``needed`` tracks with a
    large chi-square do that it explains better by the ``gain``.
    """
    return needed * math.log(config.gain)


def expanding_movers(
    views: BodyViews, seen: SeenScene, may_be: Bools, seeds: Ints, config: BodiesConfig
) -> list[tuple[Ints, Floats]]:
    """Things that come nearer and spread, each with its tracks (M,) and its path (L, 3).

    The tracks of each are at least `least_tracks`, and cost less than in the scene, all together, by `cost_of_birth`.
    (What a linear fit makes of each track is crude: `new_movers` asks the same of a refined path.)

    Parameters
    ----------
    may_be : (N,) tracks that things may be made of, each of `LEAST_VIEWS` at the least.
    seeds : those of the tracks that contradict the scene together.
    """
    is_asked = np.zeros(len(may_be), dtype=bool)
    is_asked[seeds] = may_be[seeds]
    if not is_asked.any():
        return []
    things = list[tuple[Ints, Floats]]()
    # Most tracks are around several of those asked, and say the same each time.
    near = np.flatnonzero(may_be)
    xy = each_turned_into_plane(views.rays, near, seen.scene.cam_R_past, np.zeros(len(near), dtype=np.int64))
    sums = growth_sums(xy, views.since_s, np.sqrt(seen.median_redchi) * views.sigma_norm[near])
    xy_px, redchi, is_free = views.xy_px[near], seen.redchi[near], np.ones(len(near), dtype=bool)
    for around in around_oddest(redchi, is_asked[near], xy_px, is_free, views.link_px, _MOST_SEEDS):
        found = _thing_around(sums.of(around), redchi[around], config)
        if found is None:
            continue
        is_in, velocity_hz, sigma_hz = found
        members = around[is_in]
        seen_s = float(np.median(-views.since_s[np.argmax(np.isfinite(xy[:, members, 0]), axis=0)]))
        if not _grows(xy_px[members], seen_s, float(velocity_hz[2]), sigma_hz):
            continue
        things.append((near[members], straight_path(velocity_hz / np.linalg.norm(velocity_hz), views.since_s)))
        if len(things) == _MOST_THINGS:
            break
        is_free[members] = False
    return things


def _thing_around(sums: GrowthSums, redchi: Floats, config: BodiesConfig) -> tuple[Bools, Floats, float] | None:
    """Which of some tracks (M,) are a thing with the first; None: too few, or they save too little.

    And (a, b, c) that they share, 1/s, with the standard deviation of c: no surer than their misfits leave it.
    """
    needed = least_tracks(config)
    fits = sums.sharing_a_velocity(redchi, config.scene_gate, needed)
    if fits is None or not fits[0]:
        return None
    unknowns, cov = sums.unknowns(fits)
    own = sums.redchi_of(unknowns)
    if float((cost_of(redchi) - cost_of(own))[fits].sum()) < cost_of_birth(needed, config):
        return None
    return fits, unknowns, float(np.sqrt(max(float(own[fits].mean()), 1.0) * cov[2, 2]))


def _grows(xy_px: Floats, seen_s: float, c_hz: float, sigma_hz: float) -> bool:
    """Whether tracks at ``xy_px (M, 2)``, seen for so long, surely come nearer, beyond what they err by in common."""
    radius_px = np.sqrt(np.mean(np.sum((xy_px - xy_px.mean(axis=0)) ** 2, axis=1)))
    common_hz = float(common_growth_hz(np.asarray(radius_px), np.asarray(seen_s)))
    least_hz = 1.0 / (_REACHED_WITHIN * seen_s)
    return bool(-c_hz > max(SIGMAS_999 * float(np.hypot(sigma_hz, common_hz)), least_hz))
