"""Merges of movers that are one, and splits of one that is two."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.cluster.hierarchy import linkage
from scipy.spatial import ConvexHull, KDTree

from ttcvid.geometry.estimation.rigid_motion import PathFit, RigidPaths, fit_on_paths
from ttcvid.geometry.kernels.rigid_points import NO_LENGTH
from ttcvid.geometry.medians import medians
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.segmentation.bodies import refined_movers
from ttcvid.stages.segmentation.body_views import BodyViews, cost_of, fit_on_movers
from ttcvid.stages.segmentation.data_association import Movers, is_due, numbers_of
from ttcvid.stages.segmentation.scene import SeenScene
from ttcvid.stages.tracking.neighbours import connected_parts, linked_pairs, pairs_without_gaps

# Tracks side by side hang together if their inverse depths differ by less than the first factor. Farther apart they may
# differ more, since a side may be slanted: its depth changes by up to so many times the distance across, and by no more
# than the second factor.
_STEP, _MOST_STEP, _SLOPE = 1.2, 1.5, 3.0
# Only inverse depths known to this part count (one sigma).
_KNOWN_PART = 0.05
# Tracks are side by side within this many times the smallest distance that connects all groups of tracks.
_BESIDE = 1.5
# Two movers become one within this part of the tolerances: what is near the limit keeps its number.
_TO_MERGE = 0.5
# Bayesian information criterion: two movers are merged if one trajectory costs their tracks (`_ENOUGH_TRACKS` of each
# at most) less than half of so many parameters times log(number of tracks) more than two trajectories do. With six, the
# unknowns of a view, a turning bus falls in two; with twelve, two that part slowly are one.
_PARAMETERS = 8.0
# A merge is tried if the trajectory of the larger raises the reduced chi-square of the smaller, at least 1, by at most
# this factor: that of one half of a turning bus leaves the other up to 30 times as far off before refinement.
_WORTH_TRYING, _LEAST_REDCHI = 32.0, 1.0
# Two parts of one motion are things of their own if what lies between them is none of theirs in more than this share of
# the gaps across; a thing is only split where it surely is so.
_FOREIGN_PART, _SURELY_FOREIGN_PART = 0.5, 0.75
# What lies between has more views than this: of younger ones nobody knows what they belong to.
_YOUNG_VIEWS = 2
# Gauss-Newton steps for the joint trajectory; smallest number of tracks of a group, and largest of each mover in tests.
_JOINT_STEPS, _LEAST_TRACKS, _ENOUGH_TRACKS = 4, 3, 60


_Pairs = tuple[Ints, Ints]
"""Indices of the larger and the smaller of P pairs of movers, ``(P,)`` each."""


def merged(
    views: BodyViews, seen: SeenScene, key: Ints, movers: Movers, neighbours: Ints, redchi: Floats
) -> tuple[Ints, Movers]:
    """Labels and movers after merges of adjacent movers that one trajectory explains; the older ``key`` is kept.

    Movers are adjacent if they have neighbouring tracks, and nothing foreign is seen between them.

    Parameters
    ----------
    key : ``(N,)`` body of each track.
    neighbours : ``(N, K)`` neighbours of tracks; themselves for missing ones.
    redchi : ``(N,)`` reduced chi-square of each track on its body, over the scene's median one.
    """
    number = numbers_of(key, movers)
    asked = _asked_neighbours(neighbours, number, movers)
    tracks_of = [np.flatnonzero(number == place + 1) for place in range(len(movers))]
    pairs = None if asked is None else _worth_trying(views, seen, tracks_of, movers, asked, redchi)
    if pairs is None:
        return key, movers
    joint, joint_hz, is_one = _joint(views, seen, tracks_of, movers, pairs)
    key, paths, rate_hz = key.copy(), movers.paths.take(np.arange(len(movers))), movers.rate_hz.copy()
    is_gone, is_changed = np.zeros(len(movers), dtype=bool), np.zeros(len(movers), dtype=bool)
    for place in np.flatnonzero(is_one):
        both = [int(one[place]) for one in pairs]
        # What has just been merged with a third one waits for the next time.
        if is_changed[both].any():
            continue
        younger, older = sorted(both, key=lambda mover: (movers.n_found[mover], -mover))
        others = _others(views, number, both)
        if _foreign_part(views.xy, tracks_of[younger], tracks_of[older], others) > _FOREIGN_PART:
            continue
        key[tracks_of[younger]] = movers.key[older]
        is_gone[younger], is_changed[both] = True, True
        paths.cam_R_past[older], paths.path[older] = joint.cam_R_past[place], joint.path[place]
        rate_hz[older] = joint_hz[place]
    return key, replace(movers, paths=paths, rate_hz=rate_hz).take(~is_gone)


def _asked_neighbours(neighbours: Ints, number: Ints, movers: Movers) -> _Pairs | None:
    """The adjacent movers that are due; None without any.

    Adjacent ones have neighbouring tracks, and the smaller one `_LEAST_TRACKS`. ``neighbours (N, K)`` of each track,
    ``number (N,)`` as from `numbers_of`.
    """
    counts = np.bincount(number, minlength=len(movers) + 1)[1:]
    beside = np.zeros((len(movers) + 1, len(movers) + 1), dtype=bool)
    of_mover = np.flatnonzero(number)
    beside[number[of_mover, None], number[neighbours[of_mover]]] = True
    one, other = np.nonzero(np.triu((beside | beside.T)[1:, 1:], 1))
    is_asked = is_due(np.minimum(movers.n_found[one], movers.n_found[other]))
    is_asked &= np.minimum(counts[one], counts[other]) >= _LEAST_TRACKS
    if not is_asked.any():
        return None
    one, other = one[is_asked], other[is_asked]
    is_larger = counts[one] >= counts[other]
    return np.where(is_larger, one, other), np.where(is_larger, other, one)


def _worth_trying(
    views: BodyViews, seen: SeenScene, tracks_of: list[Ints], movers: Movers, asked: _Pairs, own_redchi: Floats
) -> _Pairs | None:
    """Those of adjacent movers whose merge is worth trying; None without any."""
    large, small = asked
    pair = np.repeat(np.arange(len(large)), [len(tracks_of[place]) for place in small])
    tracks = np.concatenate([tracks_of[place] for place in small])
    fit = fit_on_movers(views.points(tracks, pair), movers.paths.take(large), movers.rate_hz[large])
    off = medians(fit.redchi, pair, len(large)) / seen.median_redchi
    limit = np.maximum(medians(own_redchi[tracks], pair, len(large)), _LEAST_REDCHI)
    is_worth = off <= _WORTH_TRYING * limit
    return (large[is_worth], small[is_worth]) if is_worth.any() else None


def _joint(
    views: BodyViews, seen: SeenScene, tracks_of: list[Ints], movers: Movers, pairs: _Pairs
) -> tuple[RigidPaths, Floats, Bools]:
    """Joint trajectory of each of P pairs, its median inverse depth ``(P,)``, and whether the pair is one: ``(P,)``.

    It is if that costs less than two, and its tracks hang together.
    """
    large, small = pairs
    of_pairs = [tracks_of[place] for pair in zip(large, small, strict=True) for place in pair]
    parts = [tracks[:: -(-len(tracks) // _ENOUGH_TRACKS)] for tracks in of_pairs]
    part = np.repeat(np.arange(len(parts)), [len(tracks) for tracks in parts])
    track = np.concatenate(parts)
    mover = np.column_stack([large, small]).ravel()[part]
    own = fit_on_movers(views.points(track, mover), movers.paths, movers.rate_hz)
    points = views.points(track, part // 2)
    # From one inverse depth for all, the first steps would bend a trajectory that fits, and some points not converge.
    # Those of the smaller mover are in units of its own trajectory.
    length = np.linalg.norm(movers.paths.path, axis=2).max(axis=1) + NO_LENGTH
    start_hz = own.rate_hz * length[mover] / length[large][part // 2]
    start, steps = movers.paths.take(large), np.full(len(large), _JOINT_STEPS)
    joint, joint_hz = refined_movers(start, seen.scene, points, steps, start_hz)
    fit = fit_on_paths(points, joint, start_hz)
    # What does not converge costs as much as what is far off.
    cost, own_cost = (cost_of(np.nan_to_num(one.redchi / seen.median_redchi, nan=np.inf)) for one in (fit, own))
    is_one = np.bincount(points.thing, cost - own_cost) < 0.5 * _PARAMETERS * np.log(np.bincount(points.thing))
    for pair in np.flatnonzero(is_one):
        of_pair = np.flatnonzero(points.thing == pair)
        is_one[pair] = _hang_together(views.xy[track[of_pair]], fit.take(of_pair), part[of_pair] % 2)
    return joint, joint_hz, is_one


def _hang_together(xy: Floats, fit: PathFit, side: Ints) -> bool:
    """Whether most tracks of both movers, ``side (M,)`` 0 and 1, are in the same part on a common trajectory.

    Or whether they have about the same median inverse depth, which decides where that of single tracks is not known. A
    large object spans depths: the cab of a lorry beside us is twice as far away as its tank.
    """
    index = _known(fit)
    n_known = np.bincount(side[index], minlength=2)
    is_known = n_known.min() >= _LEAST_TRACKS
    used = index if is_known else np.arange(len(side))
    rates_hz = medians(fit.rate_hz[used], side[used], 2)
    is_alike = bool(rates_hz.max() < (_STEP**_TO_MERGE if is_known else _MOST_STEP) * rates_hz.min())
    if is_alike or not is_known:
        return is_alike
    label = _hanging_parts(xy[index], fit.take(index), _TO_MERGE)
    counts = np.array([np.bincount(label[side[index] == one], minlength=len(label)) for one in (0, 1)])
    return bool((2 * counts > n_known[:, None]).all(axis=0).any())


def _known(fit: PathFit) -> Ints:
    """Indices of the points whose inverse depth is known."""
    return np.flatnonzero(_sigma_hz(fit) < _KNOWN_PART * fit.rate_hz)


def _sigma_hz(fit: PathFit) -> Floats:
    """Standard deviation ``(M,)`` of inverse depths, larger where the path explains the views badly."""
    return fit.rate_sigma_hz * np.sqrt(np.fmax(fit.redchi, 1.0))


def _hanging_parts(xy: Floats, fit: PathFit, slack: float) -> Ints:
    """Number of the part that each of M tracks of a body at ``xy (M, 2)`` belongs to: those of a part hang together.

    ``slack`` is the part of the tolerances that is allowed.
    """
    n = len(xy)
    joins = linkage(xy, "single") if n > 1 else np.empty((0, 4))
    # Single tracks far from the others connect nothing: only distances between groups count.
    size = np.append(np.ones(n), joins[:, 3])
    is_group = size[joins[:, :2].astype(np.int64)].min(axis=1, initial=n) >= _LEAST_TRACKS
    if not is_group.any():
        return np.zeros(n, dtype=np.int64)
    one, other = linked_pairs(xy, _BESIDE * joins[is_group, 2].max()).T
    log_rate, sigma = np.log(fit.rate_hz), _sigma_hz(fit) / fit.rate_hz
    apart = np.hypot(*(xy[one] - xy[other]).T)
    limit = slack * np.clip(_SLOPE * apart, np.log(_STEP), np.log(_MOST_STEP)) + sigma[one] + sigma[other]
    hangs = np.abs(log_rate[one] - log_rate[other]) < limit
    return connected_parts(np.ones(n, dtype=bool), np.column_stack([one[hangs], other[hangs]]))


def _others(views: BodyViews, number: Ints, movers: list[int]) -> Ints:
    """Tracks that belong to none of these movers and are no young ones; ``number (N,)`` as from `numbers_of`."""
    is_old = np.isfinite(views.rays[-1 - _YOUNG_VIEWS :, :, 0]).sum(axis=0) > _YOUNG_VIEWS
    return np.flatnonzero(views.is_free & is_old & ~np.isin(number, np.array(movers) + 1))


def _foreign_part(xy: Floats, one: Ints, other: Ints, others: Ints) -> float:
    """Share of the gaps between two sets of tracks at ``xy (N, 2)`` that one of the ``others`` lies in.

    A gap is the circle over a track and the nearest one of the other set, as in a Gabriel graph, within the convex hull
    of both; the nearer half of each set counts. The smooth side of a lorry between two groups of its corners is no such
    gap, the street seen between two cars is one.
    """
    # Outside of the lens model a track has no place.
    one, other = (tracks[np.isfinite(xy[tracks, 0])] for tracks in (one, other))
    if not (len(one) and len(other) and len(others)):
        return 0.0
    ends, middles, radii = list[Floats](), list[Floats](), list[Floats]()
    for these, those in ((one, other), (other, one)):
        apart, nearest = KDTree(xy[those]).query(xy[these])
        is_near = apart <= np.median(apart)
        here, there = xy[these][is_near], xy[those][nearest[is_near]]
        ends += [here, there]
        middles.append(0.5 * (here + there))
        radii.append(0.5 * apart[is_near])
    # Joggled: the tracks may lie on a line.
    normal_x, normal_y, offset = ConvexHull(np.concatenate(ends), qhull_options="QJ").equations.T
    x, y = xy[others].T
    is_inside = (np.outer(x, normal_x) + np.outer(y, normal_y) + offset < 0.0).all(axis=1)
    if not is_inside.any():
        return 0.0
    off, _ = KDTree(xy[others[is_inside]]).query(np.concatenate(middles))
    return float(np.mean(off < np.concatenate(radii)))


_Parts = tuple[Ints, Ints, Floats]
"""Parts of a mover: the places (M,) among its tracks that tell, the part of each, and the median rates of the parts.

Part 0 keeps the mover's number.
"""


def split(views: BodyViews, key: Ints, movers: Movers, next_key: int, least: int) -> tuple[Ints, Movers, int]:
    """Labels ``(N,)`` and movers after splits of those that do not hang together, and the ``next_key`` that is free.

    What moves in the direction of the mover beside it has the same trajectory, at other inverse depths, or with
    something else in between. A part becomes a mover if it has ``least`` tracks. All other tracks go with the nearest.
    """
    number, key = numbers_of(key, movers), key.copy()
    for mover in np.flatnonzero(is_due(movers.n_found) & (movers.n_missed == 0)):
        tracks = np.flatnonzero(number == mover + 1)
        if len(tracks) < 2 * least:
            continue
        fit = fit_on_movers(views.points(tracks, np.full(len(tracks), mover)), movers.paths, movers.rate_hz)
        parts = _parts_in_depth(views.xy[tracks], fit, least)
        if parts is None:
            parts = _parts_across_gaps(views, number, int(mover), movers.rate_hz[mover], least)
        if parts is None:
            continue
        (index, part, rate_hz), xy = parts, views.xy[tracks]
        n_new, nearest = len(rate_hz) - 1, part[KDTree(xy[index]).query(xy)[1]]
        key[tracks[nearest > 0]] = next_key + nearest[nearest > 0] - 1
        movers = movers.with_new(next_key, movers.paths.take(np.full(n_new, mover)), rate_hz[1:])
        # What is left is seen as a whole with fewer tracks.
        movers.rate_hz[mover], movers.last.n_tracks[mover] = rate_hz[0], 0
        next_key += n_new
    return key, movers, next_key


def _parts_in_depth(xy: Floats, fit: PathFit, least: int) -> _Parts | None:
    """Parts of a mover, its tracks at ``xy (M, 2)``, whose median inverse depths differ: ``least`` known ones each."""
    index = _known(fit)
    index = index[:: 1 + len(index) // (4 * _ENOUGH_TRACKS)]
    if len(index) < 2 * least:
        return None
    # Half of a part are no farther off than its median: where so many are not far apart, no two medians are.
    ordered_hz, half = np.sort(fit.rate_hz[index]), (least + 1) // 2
    if ordered_hz[-half] <= _STEP * ordered_hz[half - 1]:
        return None
    label = _hanging_parts(xy[index], fit.take(index), 1.0)
    counts = np.bincount(label)
    largest, rate_hz = int(counts.argmax()), medians(fit.rate_hz[index], label, len(counts))
    is_part = (counts >= least) & (np.abs(np.log(rate_hz / rate_hz[largest])) > np.log(_STEP))
    return _as_parts(index, label, largest, np.flatnonzero(is_part), rate_hz)


def _parts_across_gaps(views: BodyViews, number: Ints, mover: int, rate_hz: float, least: int) -> _Parts | None:
    """Parts of a mover of inverse depth ``rate_hz`` across gaps in which something else is seen.

    ``number (N,)`` as from `numbers_of`.
    """
    tracks = np.flatnonzero(number == mover + 1)
    xy_px, is_in = views.xy_px[tracks], np.ones(len(tracks), dtype=bool)
    label = connected_parts(is_in, pairs_without_gaps(xy_px, views.link_px))
    counts = np.bincount(label)
    large, largest = np.flatnonzero(counts >= least), int(counts.argmax())
    if len(large) < 2:
        return None
    others = _others(views, number, [mover])
    is_apart = [
        all(
            _foreign_part(views.xy, tracks[label == part], tracks[label == one], others) > _SURELY_FOREIGN_PART
            for one in large[large != part]
        )
        for part in large
    ]
    apart = large[np.array(is_apart, dtype=bool) & (large != largest)]
    # What hangs on to the largest part stays with it.
    label[np.isin(label, np.setdiff1d(large, apart))] = largest
    return _as_parts(np.arange(len(tracks)), label, largest, apart, np.full(len(counts), rate_hz))


def _as_parts(index: Ints, label: Ints, largest: int, parts: Ints, rate_hz: Floats) -> _Parts | None:
    """The ``parts`` and the largest one of the tracks ``index (M,)`` with these labels; None without parts."""
    if not len(parts):
        return None
    kept = np.append(largest, parts)
    place = np.full(len(rate_hz), -1)
    place[kept] = np.arange(len(kept))
    is_told = place[label] >= 0
    return index[is_told], place[label[is_told]], rate_hz[kept]
