"""Merges of movers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ttcvid.geometry.estimation.rigid_motion import RigidPaths, fit_on_paths
from ttcvid.geometry.medians import medians
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.segmentation.bodies import refined_movers
from ttcvid.stages.segmentation.body_views import BodyViews, fit_on_movers
from ttcvid.stages.segmentation.data_association import Movers, is_due, numbers_of
from ttcvid.stages.tracking.neighbours import linked_parts

# Two bodies, or two parts of one, can be one if the ratio of their inverse depths is below the first factor, or if they
# are connected by neighbouring tracks with ratios below the second, each known to a fourth of that.
_ONE_RATE, _BESIDE_RATE, _KNOWN_PART = 1.5, 1.2, 0.25
# Two movers are merged if one trajectory raises their reduced chi-square (at least 1) by at most the first factor. That
# is tried if the trajectory of the larger fits the smaller within the second: that of one half of a turning bus leaves
# the other up to 30 times as far off before refinement.
_MERGED_REDCHI, _WORTH_TRYING = 2.0, 32.0
_LEAST_REDCHI = 1.0
# Gauss-Newton steps for the joint trajectory, and largest number of tracks of each mover in its test.
_JOINT_STEPS, _ENOUGH_TRACKS = 4, 60
_LEAST_TRACKS = 3


@dataclass(frozen=True)
class _Pairs:
    """P pairs of neighbouring movers.

    large, small : ``(P,)`` indices of both.
    limit : ``(P,)`` median reduced chi-square of their tracks on their own bodies, over that of the scene.
    """

    large: Ints
    small: Ints
    limit: Floats

    def take(self, index: Ints) -> _Pairs:
        """The pairs that an index array picks."""
        return _Pairs(self.large[index], self.small[index], self.limit[index])


@dataclass(frozen=True)
class _Joint:
    """Joint trajectories of P pairs, median inverse depths ``rate_hz (P,)``, and whether each pair is one: ``(P,)``."""

    paths: RigidPaths
    rate_hz: Floats
    is_one: Bools


def merged(
    views: BodyViews,
    scene: RigidPaths,
    key: Ints,
    movers: Movers,
    neighbours: Ints,
    own_redchi: Floats,
    median_redchi: float,
) -> tuple[Ints, Movers]:
    """Labels and movers after merges of adjacent movers that one trajectory explains; the older ``key`` is kept.

    Movers are adjacent if they have neighbouring tracks.

    Parameters
    ----------
    key : ``(N,)`` body of each track.
    neighbours : ``(N, K)`` neighbours of tracks; themselves for missing ones.
    own_redchi : ``(N,)`` reduced chi-square of each track on its body, over ``median_redchi``.
    """
    number = numbers_of(key, movers)
    asked = _asked_neighbours(neighbours, number, movers)
    if asked is None:
        return key, movers
    tracks_of = [np.flatnonzero(number == place + 1) for place in range(len(movers))]
    pairs = _worth_trying(views, tracks_of, movers, *asked, own_redchi, median_redchi)
    if pairs is None:
        return key, movers
    every = _joint(views, scene, tracks_of, movers, pairs, median_redchi)
    key, paths, rate_hz = key.copy(), movers.paths.take(np.arange(len(movers))), movers.rate_hz.copy()
    is_gone, is_changed = np.zeros(len(movers), dtype=bool), np.zeros(len(movers), dtype=bool)
    for place in range(len(pairs.large)):
        joint, at, both = every, place, [int(pairs.large[place]), int(pairs.small[place])]
        if is_gone[both].any():
            continue
        if is_changed[both].any():
            # One of the two has just been merged with a third.
            movers = replace(movers, paths=paths, rate_hz=rate_hz)
            joint, at = _joint(views, scene, tracks_of, movers, pairs.take(np.array([place])), median_redchi), 0
        if not joint.is_one[at]:
            continue
        younger, older = sorted(both, key=lambda mover: (movers.n_found[mover], -mover))
        key[tracks_of[younger]] = movers.key[older]
        tracks_of[older] = np.flatnonzero(key == movers.key[older])
        is_gone[younger], is_changed[older] = True, True
        paths.cam_R_past[older], paths.path[older] = joint.paths.cam_R_past[at], joint.paths.path[at]
        rate_hz[older] = joint.rate_hz[at]
    return key, replace(movers, paths=paths, rate_hz=rate_hz).take(~is_gone)


def _asked_neighbours(neighbours: Ints, number: Ints, movers: Movers) -> tuple[Ints, Ints] | None:
    """Indices of the larger and the smaller of P adjacent movers that are due, ``(P,)`` each; None without any.

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
    views: BodyViews,
    tracks_of: list[Ints],
    movers: Movers,
    large: Ints,
    small: Ints,
    own_redchi: Floats,
    median_redchi: float,
) -> _Pairs | None:
    """Adjacent movers, of indices ``large, small (P,)``, whose merge is worth trying; None without any."""
    counts = np.array([len(tracks) for tracks in tracks_of], dtype=np.int64)
    few = np.repeat(np.arange(len(large)), counts[small])
    points = views.points(np.concatenate([tracks_of[place] for place in small]), few)
    fit = fit_on_movers(points, movers.paths.take(large), movers.rate_hz[large])
    off = medians(fit.redchi, few, len(large)) / median_redchi
    both = np.repeat(np.arange(len(large)), counts[large] + counts[small])
    own = np.concatenate([tracks_of[place] for pair in zip(large, small, strict=True) for place in pair])
    limit = np.maximum(medians(own_redchi[own], both, len(large)), _LEAST_REDCHI)
    is_worth = off <= _WORTH_TRYING * limit
    return _Pairs(large[is_worth], small[is_worth], limit[is_worth]) if is_worth.any() else None


def _joint(
    views: BodyViews, scene: RigidPaths, tracks_of: list[Ints], movers: Movers, pairs: _Pairs, median_redchi: float
) -> _Joint:
    """Joint trajectory of each pair, and whether it is one mover."""
    of_pairs = [tracks_of[place] for pair in zip(pairs.large, pairs.small, strict=True) for place in pair]
    parts = [tracks[:: -(-len(tracks) // _ENOUGH_TRACKS)] for tracks in of_pairs]
    part, n_pairs = np.repeat(np.arange(len(parts)), [len(tracks) for tracks in parts]), len(pairs.large)
    points = views.points(np.concatenate(parts), part // 2)
    steps = np.full(n_pairs, _JOINT_STEPS)
    # Without inverse depths to start from, the first steps would bend a trajectory that fits.
    start_hz = movers.rate_hz[pairs.large][points.thing]
    joint, joint_hz = refined_movers(movers.paths.take(pairs.large), scene, points, steps, start_hz)
    fit = fit_on_paths(points, joint)
    # A new track has no inverse depth yet.
    known = np.isfinite(fit.rate_hz)
    one, other = medians(fit.rate_hz[known], part[known], len(parts)).reshape(-1, 2).T
    is_one = medians(fit.redchi, points.thing, n_pairs) < _MERGED_REDCHI * median_redchi * pairs.limit
    is_one_rate = np.maximum(one, other) < _ONE_RATE * np.minimum(one, other)
    for pair in np.flatnonzero(is_one & ~is_one_rate):
        is_one[pair] = _hang_together(views, joint.take(np.array([pair])), *of_pairs[2 * pair : 2 * pair + 2])
    return _Joint(joint, joint_hz, is_one)


def _hang_together(views: BodyViews, path: RigidPaths, one: Ints, other: Ints) -> bool:
    """Whether most tracks of ``one`` and of the ``other`` are connected in image and depth, on a common trajectory.

    A large object spans depths: the cab of a lorry beside us is twice as far away as its tank.
    """
    both = np.concatenate([one, other])
    fit = fit_on_paths(views.points(both, np.zeros_like(both)), path)
    is_known = fit.rate_sigma_hz < _KNOWN_PART * np.log(_BESIDE_RATE) * fit.rate_hz
    if not is_known.any():
        return False
    rate_hz, is_other = fit.rate_hz[is_known], np.flatnonzero(is_known) >= len(one)
    tolerance = np.full(len(rate_hz), 0.5 * np.log(_BESIDE_RATE))
    label = linked_parts(views.xy_px[both[is_known]], views.link_px, np.log(rate_hz), tolerance)
    n_one, n_other = np.bincount(label[~is_other], minlength=1), np.bincount(label[is_other], minlength=1)
    return bool(n_one.argmax() == n_other.argmax() and 2 * n_one.max() > len(one) and 2 * n_other.max() > len(other))
