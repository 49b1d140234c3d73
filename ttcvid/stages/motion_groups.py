"""Groups of tracks that share one relative motion, found among those that do not move with the scene.

The paper's iterative RANSAC over epipoles, with what real pictures add to it: hypotheses from neighbours, a gate in
sigmas of each flow, similar times, one place in the picture, and a count of what chance alone would give.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import KDTree
from scipy.stats import chi2

from ttcvid.config import MotionGroupsConfig
from ttcvid.geometry.consensus import (
    chance_of_sharing,
    directions_of_pairs,
    log_false_alarms,
    shares_direction,
)
from ttcvid.geometry.epipole import epipole_maximum_likelihood
from ttcvid.geometry.flow_line import flow_line_chi2
from ttcvid.geometry.rotation import cross, tangent_basis
from ttcvid.model import NO_CLUSTER, Bools, Floats, Ints, Status
from ttcvid.stages.flows import Flows
from ttcvid.stages.surfaces import connected_parts

# Neighbours of a track that vote for a hypothesis.
_N_NEIGHBOURS = 16
# Rates abs(V)/distance of one object differ by its depth: this part of the median, and three sigmas, are allowed.
_RATE_SPREAD, _RATE_SIGMAS = 0.4, 3.0
# A group is believed when chance gives fewer than this many of its kind in a frame.
_LOG_FALSE_ALARMS = float(np.log(0.05))
# Hypotheses that fail the last test before the search ends.
_MAX_FAILURES = 3
# A direction is fitted again when more than this part of its tracks has changed.
_REFIT_PART = 0.25
# A merged direction may cost this much chi-square (two degrees of freedom, 99.9 %).
_MERGE_CHI2 = 13.8


@dataclass(frozen=True)
class MotionGroup:
    """Tracks of one relative motion: ``members (M,)`` are indices of the frame's flows.

    ``direction (3,)`` is ``dir`` with its tangent covariance ``direction_cov (3, 3)``, rad^2; both None with status
    ``no_epipole`` or ``no_parallax``, where the flow lines leave it open.
    """

    members: Ints
    direction: Floats | None
    direction_cov: Floats | None
    status: Status


@dataclass(frozen=True)
class FormerGroup:
    """What a group of the last frame says of this one: its members that are still there, and its direction, turned."""

    members: Ints
    direction: Floats | None


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


def find_motion_groups(
    flows: Flows,
    xy_px: Floats,
    is_candidate: Bools,
    link_px: float,
    former: list[FormerGroup],
    rng: np.random.Generator,
    config: MotionGroupsConfig,
) -> list[MotionGroup]:
    """Groups of relative motion among the candidate tracks, the best supported first.

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
    local_former = [_localised(group, index, flows.has_flow.size) for group in former]
    groups = _extract(search, local_former, rng, config)
    groups = _reassigned(search, _merged(search, groups), config)
    return [MotionGroup(index[g.members], g.direction, g.direction_cov, g.status) for g in groups]


def _prepare(flows: Flows, xy_px: Floats, link_px: float, config: MotionGroupsConfig) -> _Search:
    tree = KDTree(xy_px)
    count = min(_N_NEIGHBOURS + 1, len(xy_px))
    _, neighbours = tree.query(xy_px, k=count, distance_upper_bound=link_px)
    neighbours = neighbours.reshape(len(xy_px), count)
    # KDTree marks a missing neighbour with N: the track itself stands in for it.
    own = np.arange(len(xy_px))[:, None]
    neighbours = np.where(neighbours == len(xy_px), own, neighbours)
    pairs = tree.query_pairs(link_px, output_type="ndarray")
    gate = float(chi2.ppf(config.gate_probability, 1))
    chance = chance_of_sharing(flows.length_sigmas, gate)
    return _Search(flows, xy_px, link_px, neighbours, pairs, gate, chance)


def _localised(group: FormerGroup, index: Ints, n_tracks: int) -> FormerGroup:
    """The same group with candidate numbers in place of track numbers."""
    position = np.full(n_tracks, -1)
    position[index] = np.arange(len(index))
    members = position[group.members]
    return FormerGroup(members[members >= 0], group.direction)


def _extract(
    search: _Search, former: list[FormerGroup], rng: np.random.Generator, config: MotionGroupsConfig
) -> list[MotionGroup]:
    """Greedy extraction: the groups of the last frame first, then the hypotheses by their support.

    Each takes its connected tracks away from those that follow.
    """
    is_free = np.ones(len(search.xy_px), dtype=bool)
    found = []
    for known in former:
        group = _continued(search, known, is_free, config)
        if group is not None:
            found.append(group)
            is_free[group.members] = False
    directions, voters = _hypotheses(search, np.flatnonzero(is_free), rng, config)
    flows = search.flows
    shares = shares_direction(directions, flows.first, flows.second, flows.sigma_rad, search.gate_chi2)
    is_open = np.ones(len(directions), dtype=bool)
    rows = np.arange(len(directions))[:, None]
    failures = 0
    while is_open.any() and len(found) < config.max_groups and failures < _MAX_FAILURES:
        votes = np.count_nonzero(shares[rows, voters] & is_free[voters], axis=1) * is_open
        best = int(np.argmax(votes))
        if votes[best] < config.min_tracks:
            break
        is_open[best] = False
        group = _new_group(search, shares[best], voters[best], directions[best], is_free, config)
        if group is None:
            failures += 1
        else:
            found.append(group)
            is_free[group.members] = False
    return found


def _continued(search: _Search, known: FormerGroup, is_free: Bools, config: MotionGroupsConfig) -> MotionGroup | None:
    """A group of the last frame, where enough of its tracks go on in about its direction."""
    members = known.members[is_free[known.members]]
    if known.direction is None or len(members) < config.min_tracks:
        return None
    group = _refined(search, members, known.direction, is_free)
    return group if len(group.members) >= config.min_tracks else None


def _new_group(
    search: _Search, shares: Bools, voters: Ints, direction: Floats, is_free: Bools, config: MotionGroupsConfig
) -> MotionGroup | None:
    """The group around a hypothesis, where chance would hardly gather as many flows."""
    members = _grown(search, shares & is_free, voters, direction)
    if len(members) < config.min_tracks or not _is_significant(search, members, is_free):
        return None
    group = _refined(search, members, direction, is_free)
    return group if len(group.members) >= config.min_tracks else None


def _hypotheses(
    search: _Search, free: Ints, rng: np.random.Generator, config: MotionGroupsConfig
) -> tuple[Floats, Ints]:
    """Directions (M, 3) of pairs of neighbours among the free tracks, and the tracks (M, K) that vote on each.

    The neighbourhood of a pair votes: a small far object is not outvoted by chance agreement elsewhere in the picture.
    """
    n_voters = search.neighbours.shape[1]
    seeds = rng.permutation(np.resize(free, min(config.n_hypotheses, 2 * len(free))))
    partner = search.neighbours[seeds, rng.integers(0, n_voters, len(seeds))]
    directions, is_defined = directions_of_pairs(search.flows.first, search.flows.second, seeds, partner)
    return directions[is_defined], search.neighbours[seeds[is_defined]]


def _grown(search: _Search, shares: Bools, voters: Ints, direction: Floats) -> Ints:
    """The connected tracks around the voters that share a direction and have similar rates."""
    return _of_similar_rate(search, _connected_to(search, shares, voters), direction)


def _refined(search: _Search, members: Ints, direction: Floats, is_free: Bools) -> MotionGroup:
    """The group with its direction by maximum likelihood, and the members that this direction has."""
    group = _fitted(search, members, direction)
    if group.direction is None:
        return group
    flows = search.flows
    near = flow_line_chi2(group.direction, flows.first, flows.second, flows.sigma_rad) < search.gate_chi2
    again = _grown(search, near & is_free, members, group.direction)
    return replace(group, members=again)


def _connected_to(search: _Search, is_in: Bools, seeds: Ints) -> Ints:
    """Tracks of ``is_in`` in the connected part that holds most of the seeds."""
    seeds = seeds[is_in[seeds]]
    if not len(seeds):
        return np.empty(0, dtype=np.int64)
    label = connected_parts(is_in, search.pairs)
    connected: Ints = np.flatnonzero(is_in & (label == np.argmax(np.bincount(label[seeds]))))
    return connected


def _of_similar_rate(search: _Search, members: Ints, direction: Floats) -> Ints:
    """Members whose rate abs(V)/distance is like the median's: the paper's similar TTC, kept away from its poles."""
    if len(members) < 2:
        return members
    flows = search.flows.take(members)
    across = cross(flows.first, direction)
    across2 = np.maximum(np.einsum("ni,ni->n", across, across), 1e-12)
    normal = cross(flows.first, flows.second)
    rate_hz = np.einsum("ni,ni->n", normal, across) / across2 / flows.gap_s
    sigma_hz = np.sqrt(2.0 / across2) * flows.sigma_rad / flows.gap_s
    middle = float(np.median(rate_hz))
    similar: Ints = members[np.abs(rate_hz - middle) < _RATE_SPREAD * abs(middle) + _RATE_SIGMAS * sigma_hz]
    return similar


def _is_significant(search: _Search, members: Ints, is_free: Bools) -> bool:
    """Whether chance would hardly gather as many flows of this neighbourhood."""
    free = np.flatnonzero(is_free)
    distance, _ = KDTree(search.xy_px[members]).query(search.xy_px[free], distance_upper_bound=search.link_px)
    around = free[np.isfinite(distance)]
    chance = float(np.mean(search.chance[members]))
    return log_false_alarms(len(search.xy_px), len(around), len(members), chance) < _LOG_FALSE_ALARMS


def _fitted(search: _Search, members: Ints, start: Floats | None = None) -> MotionGroup:
    """The members with their direction by maximum likelihood."""
    flows = search.flows.take(members)
    direction, covariance, _, status = epipole_maximum_likelihood(
        flows.first, flows.second, flows.sigma_rad, start=start
    )
    if status in (Status.no_epipole, Status.no_parallax):
        return MotionGroup(members, None, None, status)
    return MotionGroup(members, direction, covariance, status)


def _merged(search: _Search, groups: list[MotionGroup]) -> list[MotionGroup]:
    """Join neighbouring groups whose flows one direction explains as well as two."""
    groups = list(groups)
    one = 0
    while one < len(groups):
        for other in range(one + 1, len(groups)):
            joint = _joined(search, groups[one], groups[other])
            if joint is not None:
                groups[one] = joint
                del groups[other]
                break
        else:
            one += 1
    return groups


def _joined(search: _Search, one: MotionGroup, other: MotionGroup) -> MotionGroup | None:
    if not _may_be_one(search, one, other):
        return None
    members = np.sort(np.concatenate([one.members, other.members]))
    joint = _fitted(search, members, one.direction)
    if joint.direction is None or len(_of_similar_rate(search, members, joint.direction)) < 0.9 * len(members):
        return None
    apart = _chi2_sum(search, one, one.members) + _chi2_sum(search, other, other.members)
    return joint if _chi2_sum(search, joint, members) - apart < _MERGE_CHI2 else None


def _may_be_one(search: _Search, one: MotionGroup, other: MotionGroup) -> bool:
    """Cheap tests before the fit of two groups together: neighbours, with directions that do not contradict."""
    if one.direction is None or one.direction_cov is None or other.direction is None or other.direction_cov is None:
        return False
    basis = tangent_basis(one.direction)
    offset = basis.T @ other.direction
    covariance = basis.T @ (one.direction_cov + other.direction_cov) @ basis
    if one.direction @ other.direction < 0.0 or offset @ np.linalg.solve(covariance, offset) > _MERGE_CHI2:
        return False
    distance, _ = KDTree(search.xy_px[one.members]).query(search.xy_px[other.members])
    return float(distance.min()) <= search.link_px


def _chi2_sum(search: _Search, group: MotionGroup, members: Ints) -> float:
    if group.direction is None:
        return np.inf
    flows = search.flows.take(members)
    return float(np.sum(flow_line_chi2(group.direction, flows.first, flows.second, flows.sigma_rad)))


def _reassigned(search: _Search, groups: list[MotionGroup], config: MotionGroupsConfig) -> list[MotionGroup]:
    """Give each track to the group nearby that explains it best, whoever took it first, and fit once more."""
    if not groups:
        return []
    cost = np.stack([_cost_of_joining(search, group) for group in groups])
    owner = np.where(np.min(cost, axis=0) < search.gate_chi2, np.argmin(cost, axis=0), NO_CLUSTER)
    members = [np.flatnonzero(owner == number) for number in range(len(groups))]
    return [
        _fitted(search, now, group.direction) if _differ(now, group.members) else replace(group, members=now)
        for now, group in zip(members, groups, strict=True)
        if len(now) >= config.min_tracks
    ]


def _differ(one: Ints, other: Ints) -> bool:
    """Whether two sets of tracks differ by enough to move a direction."""
    return len(np.setxor1d(one, other, assume_unique=True)) > _REFIT_PART * len(one)


def _cost_of_joining(search: _Search, group: MotionGroup) -> Floats:
    """Chi-square of each candidate in the group, infinite where it is out of place, rate or sense: (N,)."""
    cost = np.full(len(search.xy_px), np.inf)
    if group.direction is None:
        # No direction to compare with: the members stay by the least claim.
        cost[group.members] = 0.0
        return cost
    flows = search.flows
    distance, _ = KDTree(search.xy_px[group.members]).query(search.xy_px, distance_upper_bound=search.link_px)
    near = np.flatnonzero(np.isfinite(distance))
    near = near[
        shares_direction(
            group.direction[None], flows.first[near], flows.second[near], flows.sigma_rad[near], search.gate_chi2
        )[0]
    ]
    near = _of_similar_rate(search, near, group.direction)
    chosen = flows.take(near)
    cost[near] = flow_line_chi2(group.direction, chosen.first, chosen.second, chosen.sigma_rad)
    return cost
