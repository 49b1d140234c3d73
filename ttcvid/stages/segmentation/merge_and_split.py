"""Movers that turn out to be one, and parts of one that turn out to be several."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ttcvid.config import BodiesConfig
from ttcvid.geometry.compiled import compiled_for
from ttcvid.geometry.estimation.rigid_motion import RigidPaths, fit_on_paths
from ttcvid.geometry.medians import medians
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.segmentation.bodies import refined_movers
from ttcvid.stages.segmentation.body_views import BodyViews, fit_on_movers
from ttcvid.stages.segmentation.data_association import Movers, OwnFit, is_due, numbers_of
from ttcvid.stages.segmentation.plain_gaps import across_plain_gaps
from ttcvid.stages.tracking.neighbours import connected_parts, linked_parts

# Two bodies, or two parts of one, are one where their rates differ by less than this factor; or where they hang
# together by tracks beside each other whose rates differ by less than the other, and are known to a fourth of that.
_ONE_RATE, _BESIDE_RATE, _KNOWN_PART = 1.5, 1.2, 0.25
# Two movers are one where one motion explains both at most this much worse than two, misfits below 1 being 1; before
# that is tried, the motion of the larger has to explain the smaller within this factor: what fits one half of a bus
# that turns leaves the other up to 30 times as far off, until both correct it.
_MERGED_MISFIT, _WORTH_TRYING = 2.0, 32.0
_LEAST_MISFIT = 1.0
# Steps of refinement of two taken as one; so many tracks of each tell whether they are.
_JOINT_STEPS, _ENOUGH_TRACKS = 4, 60
_LEAST_TRACKS = 3
# Views after which a track says by its own motion to what it belongs: a new one is taken for the scene's.
_LEAST_VIEWS = 5
_TINY_HZ = 1e-9


@dataclass(frozen=True)
class _Pairs:
    """P pairs of neighbouring movers: the places ``large, small (P,)`` of both.

    ``limit (P,)`` is the misfit that is usual in both, in units of the scene's.
    """

    large: Ints
    small: Ints
    limit: Floats

    def take(self, index: Ints) -> _Pairs:
        """The pairs that an index array picks."""
        return _Pairs(self.large[index], self.small[index], self.limit[index])


@dataclass(frozen=True)
class _Joint:
    """The motions of P pairs taken as one, the median rate of their points, and whether each pair is one."""

    paths: RigidPaths
    rate_hz: Floats
    is_one: Bools

    def take(self, index: Ints) -> _Joint:
        """The pairs that an index array picks."""
        return _Joint(self.paths.take(index), self.rate_hz[index], self.is_one[index])


def merged(
    views: BodyViews,
    scene: RigidPaths,
    key: Ints,
    movers: Movers,
    neighbours: Ints,
    own_misfit: Floats,
    usual_misfit: float,
) -> tuple[Ints, Movers]:
    """Movers side by side, or with nothing between, that one motion explains are one; the older one's number stays.

    Parameters
    ----------
    neighbours : (N, K) of each track that belongs to a mover.
    own_misfit : (N,) of each track on its body, in units of ``usual_misfit``.
    """
    number = numbers_of(key, movers)
    asked = _asked_neighbours(views, neighbours, number, movers)
    if asked is None:
        return key, movers
    tracks_of = [np.flatnonzero(number == place + 1) for place in range(len(movers))]
    pairs = _worth_trying(views, tracks_of, movers, *asked, own_misfit, usual_misfit)
    if pairs is None:
        return key, movers
    every = _joint(views, scene, tracks_of, movers, pairs, usual_misfit)
    key, paths, rate_hz = key.copy(), movers.paths.take(np.arange(len(movers))), movers.rate_hz.copy()
    is_gone, is_changed = np.zeros(len(movers), dtype=bool), np.zeros(len(movers), dtype=bool)
    for place in range(len(pairs.large)):
        joint, pair = every.take(np.array([place])), pairs.take(np.array([place]))
        both = [int(pair.large[0]), int(pair.small[0])]
        if is_gone[both].any():
            continue
        if is_changed[both].any():
            # One of the two has just become one with another.
            movers = replace(movers, paths=paths, rate_hz=rate_hz)
            joint = _joint(views, scene, tracks_of, movers, pair, usual_misfit)
        if not joint.is_one[0]:
            continue
        younger, older = sorted(both, key=lambda mover: (movers.n_found[mover], -mover))
        key[tracks_of[younger]] = movers.key[older]
        tracks_of[older] = np.flatnonzero(key == movers.key[older])
        is_gone[younger], is_changed[older] = True, True
        paths.cam_R_past[older], paths.path[older] = joint.paths.cam_R_past[0], joint.paths.path[0]
        rate_hz[older] = joint.rate_hz[0]
    return key, replace(movers, paths=paths, rate_hz=rate_hz).take(~is_gone)


def _asked_neighbours(views: BodyViews, neighbours: Ints, number: Ints, movers: Movers) -> tuple[Ints, Ints] | None:
    """The places of the larger and the smaller of each two neighbours that are asked about; None without any."""
    if len(movers) < 2:
        return None
    pairs = np.empty((len(movers) * (len(movers) - 1) // 2, 2), dtype=np.int64)
    touch = np.empty(len(pairs), dtype=bool)
    count = _list_pairs(number, neighbours, len(movers), pairs, touch)
    large, small, touch = *pairs[:count].T, touch[:count]
    is_asked = is_due(np.minimum(movers.n_found[large], movers.n_found[small]))
    apart = np.flatnonzero(is_asked & ~touch)
    is_asked[apart] = across_plain_gaps(views.xy_px, number, _told(views), number, 1 + large[apart], 1 + small[apart])
    return (large[is_asked], small[is_asked]) if is_asked.any() else None


def _worth_trying(
    views: BodyViews,
    tracks_of: list[Ints],
    movers: Movers,
    large: Ints,
    small: Ints,
    own_misfit: Floats,
    usual_misfit: float,
) -> _Pairs | None:
    """Neighbours, at the places ``large, small (P,)``, that may be one; None without any."""
    counts = np.array([len(tracks) for tracks in tracks_of], dtype=np.int64)
    few = np.repeat(np.arange(len(large)), counts[small])
    points = views.points(np.concatenate([tracks_of[place] for place in small]), few)
    fit = fit_on_movers(points, movers.paths.take(large), movers.rate_hz[large])
    off = medians(fit.misfit, few, len(large)) / usual_misfit
    both = np.repeat(np.arange(len(large)), counts[large] + counts[small])
    own = np.concatenate([tracks_of[place] for pair in zip(large, small, strict=True) for place in pair])
    limit = np.maximum(medians(own_misfit[own], both, len(large)), _LEAST_MISFIT)
    is_worth = off <= _WORTH_TRYING * limit
    return _Pairs(large[is_worth], small[is_worth], limit[is_worth]) if is_worth.any() else None


@compiled_for("(i8[::1], i8[:, ::1], i8, i8[:, ::1], b1[::1])")
def _list_pairs(number: Ints, neighbours: Ints, n_movers: int, pairs: Ints, touch: Bools) -> int:
    """Fill ``pairs (P, 2)`` of movers, the larger one first, and whether they ``touch (P,)``; how many there are.

    Those touch that have tracks beside each other: ``number (N,)`` as from `numbers_of`, ``neighbours (N, K)``. The
    smaller one has `_LEAST_TRACKS`.
    """
    beside, counts, n_pairs = np.zeros((n_movers + 1, n_movers + 1), dtype=np.bool_), np.zeros(n_movers + 1), 0
    for i in range(len(number)):
        counts[number[i]] += 1
        if number[i] > 0:
            for k in range(neighbours.shape[1]):
                beside[number[i], number[neighbours[i, k]]] = True
    for one in range(1, n_movers + 1):
        for other in range(one + 1, n_movers + 1):
            if min(counts[one], counts[other]) >= _LEAST_TRACKS:
                is_large = counts[one] >= counts[other]
                pairs[n_pairs, 0], pairs[n_pairs, 1] = (
                    (one if is_large else other) - 1,
                    (other if is_large else one) - 1,
                )
                touch[n_pairs] = beside[one, other]
                n_pairs += 1
    return n_pairs


def _joint(
    views: BodyViews, scene: RigidPaths, tracks_of: list[Ints], movers: Movers, pairs: _Pairs, usual_misfit: float
) -> _Joint:
    """Each pair taken as one."""
    of_pairs = [tracks_of[place] for pair in zip(pairs.large, pairs.small, strict=True) for place in pair]
    parts = [tracks[:: -(-len(tracks) // _ENOUGH_TRACKS)] for tracks in of_pairs]
    part, n_pairs = np.repeat(np.arange(len(parts)), [len(tracks) for tracks in parts]), len(pairs.large)
    points = views.points(np.concatenate(parts), part // 2)
    steps = np.full(n_pairs, _JOINT_STEPS)
    # From no rates at all the first steps would bend a path that fits.
    start_hz = movers.rate_hz[pairs.large][points.thing]
    joint, joint_hz = refined_movers(movers.paths.take(pairs.large), scene, points, steps, start_hz)
    fit = fit_on_paths(points, joint)
    # A track that has just been born has no rate yet.
    known = np.isfinite(fit.rate_hz)
    one, other = medians(fit.rate_hz[known], part[known], len(parts)).reshape(-1, 2).T
    is_one = medians(fit.misfit, points.thing, n_pairs) < _MERGED_MISFIT * usual_misfit * pairs.limit
    is_one_rate = np.maximum(one, other) < _ONE_RATE * np.minimum(one, other)
    for pair in np.flatnonzero(is_one & ~is_one_rate):
        is_one[pair] = _hang_together(views, joint.take(np.array([pair])), *of_pairs[2 * pair : 2 * pair + 2])
    return _Joint(joint, joint_hz, is_one)


def _hang_together(views: BodyViews, path: RigidPaths, one: Ints, other: Ints) -> bool:
    """Whether most tracks of ``one`` and of the ``other`` are of one piece on one ``path``, though they lie deep.

    The cab of a lorry beside us is twice as far away as its tank, and in between is the rest of it.
    """
    both = np.concatenate([one, other])
    fit = fit_on_paths(views.points(both, np.zeros_like(both)), path)
    is_known = fit.rate_sigma_hz < _KNOWN_PART * np.log(_BESIDE_RATE) * fit.rate_hz
    if not is_known.any():
        return False
    rate_hz, is_other = fit.rate_hz[is_known], np.flatnonzero(is_known) >= len(one)
    nothing, tolerance = np.zeros_like(both[is_known]), np.full(len(rate_hz), 0.5 * np.log(_BESIDE_RATE))
    label = linked_parts(views.xy_px[both[is_known]], views.link_px, nothing, np.log(rate_hz), tolerance)
    n_one, n_other = np.bincount(label[~is_other], minlength=1), np.bincount(label[is_other], minlength=1)
    return bool(n_one.argmax() == n_other.argmax() and 2 * n_one.max() > len(one) and 2 * n_other.max() > len(other))


def split(
    views: BodyViews, key: Ints, movers: Movers, own_fit: OwnFit, next_key: int, config: BodiesConfig
) -> tuple[Ints, Movers, int]:
    """Parts of a mover that do not hang together in the picture, or lie at other depths, are movers of their own.

    Those apart from each other with nothing else between them stay one. The largest part keeps the number. ``own_fit``
    of each track on the path of its mover: what it does not know is found out.
    """
    number = numbers_of(key, movers)
    counts = np.bincount(number, minlength=len(movers) + 1)[1:]
    own = np.flatnonzero(np.append(False, counts >= 2 * config.min_tracks)[number])
    if not len(own):
        return key, movers, next_key
    body, key = number[own] - 1, key.copy()
    rate_hz, sigma_hz = own_fit.rate_hz[own], own_fit.rate_sigma_hz[own]
    unknown = np.flatnonzero(np.isnan(rate_hz))
    if len(unknown):
        fit = fit_on_paths(views.points(own[unknown], body[unknown]), movers.paths, movers.rate_hz[body[unknown]])
        rate_hz[unknown], sigma_hz[unknown] = fit.rate_hz, fit.rate_sigma_hz
    # Where nothing is known (NaN), the rate is none, and may be any.
    rate_hz = np.fmax(rate_hz, _TINY_HZ)
    unsure = np.fmin(sigma_hz / rate_hz, np.inf)
    tolerance = 0.5 * np.log(_ONE_RATE) + 2.0 * unsure
    label = linked_parts(views.xy_px[own], views.link_px, body, np.log(rate_hz), tolerance)
    counts = np.bincount(label)
    if len(counts) == np.count_nonzero(np.bincount(body)):
        # Each is of one piece.
        return key, movers, next_key
    label = _across_gaps(views, number, own, label, rate_hz)
    counts = np.bincount(label)
    mover_of = np.empty(len(counts), dtype=np.int64)
    mover_of[label] = body
    by_size = np.lexsort((-counts, mover_of))
    is_largest = np.append(True, np.diff(mover_of[by_size]) > 0)
    parts = by_size[~is_largest & (counts[by_size] >= config.min_tracks)]
    for count, part in enumerate(parts.tolist()):
        key[own[label == part]] = next_key + count
    parents = mover_of[parts]
    return key, movers.with_new(next_key, movers.paths.take(parents), movers.rate_hz[parents]), next_key + len(parts)


def _across_gaps(views: BodyViews, number: Ints, own: Ints, label: Ints, rate_hz: Floats) -> Ints:
    """The parts ``label (M,)`` of tracks ``own (M,)``: those of one mover, at one depth, with nothing between are one.

    ``number (N,)`` as from `numbers_of`; ``rate_hz (M,)``.
    """
    n_parts = int(label.max()) + 1
    mover_of, part = np.empty(n_parts, dtype=np.int64), np.full(len(number), -1)
    mover_of[label], part[own] = number[own], label
    large = np.flatnonzero(np.bincount(label) >= _LEAST_TRACKS)
    log_rate = np.log(medians(rate_hz, label, n_parts))
    one, other = large[np.stack(np.triu_indices(len(large), 1))]
    is_asked = (mover_of[one] == mover_of[other]) & (np.abs(log_rate[one] - log_rate[other]) < np.log(_ONE_RATE))
    if not is_asked.any():
        return label
    one, other = one[is_asked], other[is_asked]
    is_one = across_plain_gaps(views.xy_px, number, _told(views), part, one, other, views.link_px)
    return connected_parts(np.ones(n_parts, dtype=bool), np.stack([one, other], axis=1)[is_one])[label]


def _told(views: BodyViews) -> Bools:
    """Tracks (N,) that are seen in enough views to tell to which body they belong."""
    return np.asarray(np.isfinite(views.rays[-_LEAST_VIEWS:, :, 0]).all(axis=0))
