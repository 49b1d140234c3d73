"""Groups of tracks that share one relative motion, found among those that do not move with the scene.

The paper's iterative RANSAC over epipoles, with what real pictures add to it: hypotheses from neighbours, a gate in
sigmas of each flow, similar times, one place in the picture, and a count of what chance alone would give.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from ttcvid.config import MotionGroupsConfig
from ttcvid.geometry.chi_square import chi2_quantile
from ttcvid.geometry.consensus import (
    chance_of_sharing,
    directions_of_pairs,
    log_false_alarms,
    shares_direction,
)
from ttcvid.geometry.epipole import (
    INFINITY_COSINE,
    MAX_DIRECTION_SIGMA_RAD,
    direction_chi2,
    epipole_maximum_likelihood,
    refine_epipoles,
)
from ttcvid.geometry.flow_line import flow_line_chi2
from ttcvid.geometry.rotation import cross
from ttcvid.model import NO_CLUSTER, Bools, Floats, Ints, Status
from ttcvid.stages.flows import Flows
from ttcvid.stages.scene import DIRECTION_FLOOR_RAD
from ttcvid.stages.surfaces import connected_parts

# Neighbours of a track that vote for a hypothesis.
_N_NEIGHBOURS = 16
# Rates abs(V)/distance of one object differ by its depth: this part of the median, and three sigmas, are allowed.
_RATE_SPREAD, _RATE_SIGMAS = 0.4, 3.0
# A group is believed when chance gives fewer than this many of its kind in a frame.
_LOG_FALSE_ALARMS = float(np.log(0.05))
# Hypotheses that fail the last test before the search ends.
_MAX_FAILURES = 3
# A merged direction may cost this much chi-square (two degrees of freedom, 99.9 %), and of many tracks this much a
# track: errors that tracks share (blur, slant, a curved path) are not in their noise.
_MERGE_CHI2, _MERGE_CHI2_PER_TRACK = 13.8, 0.3
# A joint fit is good by itself when its chi-square lies inside this probability.
_GOOD_FIT = 0.99
# So much of two groups has to have one rate, for them to be one.
_MERGE_SIMILAR = 0.8
# Gauss-Newton steps of a fit, from the last frame's direction or from a hypothesis.
_FIT_STEPS = 3


@dataclass(frozen=True)
class MotionGroup:
    """Tracks of one relative motion: ``members (M,)`` are indices of the frame's flows.

    ``direction (3,)`` is ``dir`` with its tangent covariance ``direction_cov (3, 3)``, rad^2. With status
    ``no_epipole`` the flow lines leave it open, and it is only good as a start for the next frame.
    """

    members: Ints
    direction: Floats
    direction_cov: Floats
    status: Status


@dataclass(frozen=True)
class FormerGroup:
    """What a group of the last frame says of this one: its members that are still there, and its direction, turned."""

    members: Ints
    direction: Floats


@dataclass(frozen=True)
class _Search:
    """The candidates' flows, places and neighbourhood during one search (indices count candidates)."""

    flows: Flows
    xy_px: Floats
    link_px: float
    neighbours: Ints
    pairs: Ints
    gate_chi2: float
    chance: Floats


@dataclass(frozen=True)
class _Groups:
    """Groups during the search: ``label (N,)`` of each candidate, NO_CLUSTER for none; ``directions (K, 3)``."""

    label: Ints
    directions: Floats


def find_motion_groups(
    flows: Flows,
    xy_px: Floats,
    is_candidate: Bools,
    link_px: float,
    former: list[FormerGroup],
    rng: np.random.Generator,
    config: MotionGroupsConfig,
) -> list[MotionGroup]:
    """Groups of relative motion among the candidate tracks.

    The groups of the last frame are continued; new ones are looked for among the tracks that are left; then
    each track goes to the group nearby that explains it best, whoever took it first.

    Parameters
    ----------
    flows : of all N tracks.
    xy_px : (N, 2) present places, px.
    is_candidate : (N,) tracks that do not move with the scene.
    link_px : two tracks of an object are connected when they lie closer than this, px.
    former : groups of the last frame, where the search starts (members index ``flows``).
    """
    index = np.flatnonzero(is_candidate & flows.has_flow)
    if len(index) < config.min_tracks:
        return []
    search = _prepare(flows.take(index), xy_px[index], link_px, config)
    groups = _continued(search, former, index, flows.has_flow.size)
    groups = _with_new_groups(search, groups, rng, config)
    groups = _merged(search, _assigned(search, groups))
    return _results(search, groups, index, config)


def _prepare(flows: Flows, xy_px: Floats, link_px: float, config: MotionGroupsConfig) -> _Search:
    tree = KDTree(xy_px)
    count = min(_N_NEIGHBOURS + 1, len(xy_px))
    _, neighbours = tree.query(xy_px, k=count, distance_upper_bound=link_px)
    neighbours = neighbours.reshape(len(xy_px), count)
    # KDTree marks a missing neighbour with N: the track itself stands in for it.
    own = np.arange(len(xy_px))[:, None]
    neighbours = np.where(neighbours == len(xy_px), own, neighbours)
    pairs = np.stack([np.broadcast_to(own, neighbours.shape), neighbours], axis=-1)[:, 1:].reshape(-1, 2)
    gate = float(chi2_quantile(config.gate_probability, 1))
    chance = chance_of_sharing(flows.length_sigmas, gate)
    return _Search(flows, xy_px, link_px, neighbours, pairs, gate, chance)


def _continued(search: _Search, former: list[FormerGroup], index: Ints, n_tracks: int) -> _Groups:
    """The groups of the last frame with the tracks that go on in about their directions, and these fitted."""
    position = np.full(n_tracks, NO_CLUSTER)
    position[index] = np.arange(len(index))
    label = np.full(len(index), NO_CLUSTER)
    for number, group in enumerate(former):
        members = position[group.members]
        label[members[members != NO_CLUSTER]] = number
    directions = np.array([group.direction for group in former]).reshape(-1, 3)
    return _fitted(search, _assigned(search, _Groups(label, directions)))


def _assigned(search: _Search, groups: _Groups) -> _Groups:
    """Each candidate to the group that explains it best, among those that it or a neighbour belongs to by now."""
    n_groups, n = len(groups.directions), len(groups.label)
    if not n_groups:
        return groups
    flows = search.flows
    cost = flow_line_chi2(groups.directions, flows.first, flows.second, flows.sigma_rad)
    shares = shares_direction(groups.directions, flows.first, flows.second, flows.sigma_rad, search.gate_chi2)
    label_around = groups.label[search.neighbours]
    is_near = np.stack([np.any(label_around == number, axis=1) for number in range(n_groups)])
    cost = np.where(shares & is_near, cost, np.inf)
    label = np.where(np.isfinite(cost.min(axis=0)), np.argmin(cost, axis=0), NO_CLUSTER)
    taken = np.flatnonzero(label != NO_CLUSTER)
    is_like = _has_similar_rate(search, taken, label[taken], groups.directions)
    kept = np.full(n, NO_CLUSTER)
    kept[taken[is_like]] = label[taken[is_like]]
    return _Groups(kept, groups.directions)


def _fitted(search: _Search, groups: _Groups) -> _Groups:
    return _Groups(groups.label, _fit(search, groups)[0])


def _fit(search: _Search, groups: _Groups) -> tuple[Floats, Floats]:
    """Maximum-likelihood directions (K, 3) of the groups and their covariances (K, 3, 3)."""
    if not len(groups.directions):
        return groups.directions, np.empty((0, 3, 3))
    taken = np.flatnonzero(groups.label != NO_CLUSTER)
    flows = search.flows.take(taken)
    return refine_epipoles(
        groups.directions, groups.label[taken], flows.first, flows.second, flows.sigma_rad, _FIT_STEPS
    )


def _with_new_groups(search: _Search, groups: _Groups, rng: np.random.Generator, config: MotionGroupsConfig) -> _Groups:
    """Greedy extraction of new groups: the hypothesis with most support takes its connected tracks, the rest go on."""
    label, directions = groups.label.copy(), list(groups.directions)
    free = np.flatnonzero(label == NO_CLUSTER)
    if len(free) < config.min_tracks:
        return groups
    hypotheses, voters = _hypotheses(search, free, rng, config)
    flows = search.flows
    shares = shares_direction(hypotheses, flows.first, flows.second, flows.sigma_rad, search.gate_chi2)
    is_open = np.ones(len(hypotheses), dtype=bool)
    rows = np.arange(len(hypotheses))[:, None]
    failures = 0
    n_former = len(directions)
    while is_open.any() and len(directions) - n_former < config.max_groups and failures < _MAX_FAILURES:
        is_free = label == NO_CLUSTER
        votes = np.count_nonzero(shares[rows, voters] & is_free[voters], axis=1) * is_open
        best = int(np.argmax(votes))
        if votes[best] < config.min_tracks:
            break
        is_open[best] = False
        members = _grown(search, shares[best] & is_free, voters[best], hypotheses[best])
        if len(members) < config.min_tracks or not _is_significant(search, members, is_free):
            failures += 1
            continue
        direction, members = _refined(search, members, hypotheses[best], is_free)
        label[members] = len(directions)
        directions.append(direction)
    return _Groups(label, np.array(directions).reshape(-1, 3))


def _refined(search: _Search, members: Ints, direction: Floats, is_free: Bools) -> tuple[Floats, Ints]:
    """The members' direction by maximum likelihood, and the free tracks around them that this direction has.

    A pair of noisy flows points too badly to gather all of its object at once; what it left over would make a second.
    """
    one = np.full(len(is_free), NO_CLUSTER)
    one[members] = 0
    direction = _fit(search, _Groups(one, direction[None]))[0][0]
    flows = search.flows
    shares = shares_direction(direction[None], flows.first, flows.second, flows.sigma_rad, search.gate_chi2)[0]
    again = _grown(search, shares & is_free, members, direction)
    return direction, again if len(again) >= len(members) else members


def _grown(search: _Search, is_in: Bools, seeds: Ints, direction: Floats) -> Ints:
    """Tracks of ``is_in`` that are connected to the seeds and have similar rates along the direction."""
    members = _connected_to(search, is_in, seeds)
    return members[_has_similar_rate(search, members, np.zeros(len(members), np.int64), direction[None])]


def _hypotheses(
    search: _Search, free: Ints, rng: np.random.Generator, config: MotionGroupsConfig
) -> tuple[Floats, Ints]:
    """Directions (M, 3) of pairs of neighbours among the free tracks, and the tracks (M, K) that vote on each.

    The neighbourhood of a pair votes: a small far object is not outvoted by chance agreement elsewhere in the picture.
    """
    n_voters = search.neighbours.shape[1]
    seeds = np.resize(rng.permutation(free), min(config.n_hypotheses, 2 * len(free)))
    partner = search.neighbours[seeds, rng.integers(0, n_voters, len(seeds))]
    directions, is_defined = directions_of_pairs(search.flows.first, search.flows.second, seeds, partner)
    return directions[is_defined], search.neighbours[seeds[is_defined]]


def _connected_to(search: _Search, is_in: Bools, seeds: Ints) -> Ints:
    """Tracks of ``is_in`` in the connected part that holds most of the seeds."""
    seeds = seeds[is_in[seeds]]
    if not len(seeds):
        return np.empty(0, dtype=np.int64)
    label = connected_parts(is_in, search.pairs)
    connected: Ints = np.flatnonzero(is_in & (label == np.argmax(np.bincount(label[seeds]))))
    return connected


def _has_similar_rate(search: _Search, index: Ints, label: Ints, directions: Floats) -> Bools:
    """Which of the tracks ``index`` have a rate abs(V)/distance like the median of their group ``label``: (M,).

    The paper's similar TTC, kept away from its poles.
    """
    flows, direction = search.flows.take(index), directions[label]
    across = cross(flows.first, direction)
    across2 = np.maximum(np.einsum("ni,ni->n", across, across), 1e-12)
    normal = cross(flows.first, flows.second)
    rate_hz = np.einsum("ni,ni->n", normal, across) / across2 / flows.gap_s
    sigma_hz = np.sqrt(2.0 / across2) * flows.sigma_rad / flows.gap_s
    middle_hz = np.zeros(len(directions))
    for number in np.unique(label):
        middle_hz[number] = np.median(rate_hz[label == number])
    middle_hz = middle_hz[label]
    similar: Bools = np.abs(rate_hz - middle_hz) < _RATE_SPREAD * np.abs(middle_hz) + _RATE_SIGMAS * sigma_hz
    return similar


def _is_significant(search: _Search, members: Ints, is_free: Bools) -> bool:
    """Whether chance would hardly gather as many flows of this neighbourhood."""
    is_around = np.zeros(len(is_free), dtype=bool)
    is_around[search.neighbours[members]] = True
    is_around[members] = True
    chance = float(np.mean(search.chance[members]))
    n_around = int(np.count_nonzero(is_around & is_free))
    return log_false_alarms(len(search.xy_px), n_around, len(members), chance) < _LOG_FALSE_ALARMS


def _merged(search: _Search, groups: _Groups) -> _Groups:
    """Join neighbouring groups whose flows one direction explains as well as two."""
    directions, covariances = _fit(search, groups)
    label = groups.label.copy()
    for one in range(len(directions)):
        for other in range(one + 1, len(directions)):
            if _may_be_one(search, label, directions, covariances, one, other) and _is_one(
                search, label, directions, one, other
            ):
                label[label == other] = one
    return _Groups(label, directions)


def _may_be_one(search: _Search, label: Ints, directions: Floats, covariances: Floats, one: int, other: int) -> bool:
    """Cheap tests before the fit of two groups together: directions that do not contradict, and neighbours."""
    covariance = covariances[one] + covariances[other]
    if not np.isfinite(covariance).all():
        return False
    if direction_chi2(directions[one], directions[other], covariance, DIRECTION_FLOOR_RAD) > _MERGE_CHI2:
        return False
    return bool(np.any(label[search.neighbours[label == one]] == other))


def _is_one(search: _Search, label: Ints, directions: Floats, one: int, other: int) -> bool:
    """Whether one direction and one rate explain both groups: chi-square of the joint fit against the separate ones."""
    members = np.flatnonzero((label == one) | (label == other))
    flows = search.flows.take(members)
    joint, _, chi2_joint, status = epipole_maximum_likelihood(
        flows.first, flows.second, flows.sigma_rad, start=directions[one]
    )
    if status in (Status.no_epipole, Status.no_parallax):
        return False
    similar = _has_similar_rate(search, members, np.zeros(len(members), np.int64), joint[None])
    apart = flow_line_chi2(directions[[one, other]], flows.first, flows.second, flows.sigma_rad)
    separate = np.where(label[members] == one, apart[0], apart[1])
    allowed = max(_MERGE_CHI2, _MERGE_CHI2_PER_TRACK * len(members))
    # Groups that were split by the sign of their noise fit too well apart: a good joint fit is enough.
    is_good = np.sum(chi2_joint) < chi2_quantile(_GOOD_FIT, len(members))
    return bool(np.mean(similar) > _MERGE_SIMILAR and (is_good or np.sum(chi2_joint - separate) < allowed))


def _results(search: _Search, groups: _Groups, index: Ints, config: MotionGroupsConfig) -> list[MotionGroup]:
    """The groups that are large enough, with their final directions, in terms of the frame's tracks."""
    directions, covariances = _fit(search, groups)
    found = []
    for number, (direction, covariance) in enumerate(zip(directions, covariances, strict=True)):
        members = np.flatnonzero(groups.label == number)
        if len(members) >= config.min_tracks:
            found.append(MotionGroup(index[members], direction, covariance, _direction_status(direction, covariance)))
    return found


def _direction_status(direction: Floats, covariance: Floats) -> Status:
    if not np.trace(covariance) < MAX_DIRECTION_SIGMA_RAD**2:
        return Status.no_epipole
    return Status.epipole_at_infinity if abs(direction[2]) < INFINITY_COSINE else Status.ok
