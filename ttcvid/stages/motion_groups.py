"""Groups of tracks that share one relative motion, found among those that do not move with the scene.

The paper's iterative RANSAC over epipoles, with what real pictures add to it: hypotheses from neighbours, a gate in
sigmas of each flow, similar times, one place in the picture, and a count of what chance alone would give.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
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
from ttcvid.model import NO_CLUSTER, Bools, Floats, Ints, Status
from ttcvid.stages.flows import Flows

# Neighbours of a track that vote for a hypothesis.
_N_NEIGHBOURS = 16
# Rates abs(V)/distance of one object differ by its depth: this part of the median, and three sigmas, are allowed.
_RATE_SPREAD, _RATE_SIGMAS = 0.4, 3.0
# A group is believed when chance gives fewer than this many of its kind in a frame.
_LOG_FALSE_ALARMS = float(np.log(0.05))
# Hypotheses that fail the last test before the search ends.
_MAX_FAILURES = 12
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
    rows: Ints
    columns: Ints
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
    members = _extract(search, local_former, rng, config)
    groups = [_fitted(search, m) for m in members]
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
    return _Search(flows, xy_px, link_px, neighbours, pairs[:, 0], pairs[:, 1], gate, chance)


def _localised(group: FormerGroup, index: Ints, n_tracks: int) -> FormerGroup:
    """The same group with candidate numbers in place of track numbers."""
    position = np.full(n_tracks, -1)
    position[index] = np.arange(len(index))
    members = position[group.members]
    return FormerGroup(members[members >= 0], group.direction)


def _extract(
    search: _Search, former: list[FormerGroup], rng: np.random.Generator, config: MotionGroupsConfig
) -> list[Ints]:
    """Greedy extraction: the hypothesis with most support takes its connected tracks, the rest go on."""
    directions, supporters = _hypotheses(search, former, rng, config)
    if not len(directions):
        return []
    flows = search.flows
    shares = shares_direction(directions, flows.first, flows.second, flows.sigma_rad, search.gate_chi2)
    is_free = np.ones(len(search.xy_px), dtype=bool)
    votes_of = [np.unique(s) for s in supporters]
    is_open = np.ones(len(directions), dtype=bool)
    found: list[Ints] = []
    failures = 0
    while len(found) < config.max_groups and failures < _MAX_FAILURES:
        usable = shares & is_free
        votes = np.array([np.count_nonzero(usable[m, s]) for m, s in enumerate(votes_of)]) * is_open
        best = int(np.argmax(votes))
        if votes[best] < config.min_tracks:
            break
        is_open[best] = False
        members = _grown(search, usable[best], votes_of[best], directions[best], is_free)
        if len(members) >= config.min_tracks and _is_significant(search, members, is_free):
            found.append(members)
            is_free[members] = False
        else:
            failures += 1
    return found


def _hypotheses(
    search: _Search, former: list[FormerGroup], rng: np.random.Generator, config: MotionGroupsConfig
) -> tuple[Floats, list[Ints]]:
    """Directions (M, 3) to try, and for each the tracks that vote on it: former groups', then pairs of neighbours'."""
    n = len(search.xy_px)
    seeds = rng.permutation(np.resize(np.arange(n), min(config.n_hypotheses, 2 * n)))
    partner = search.neighbours[seeds, rng.integers(0, search.neighbours.shape[1], len(seeds))]
    directions, is_defined = directions_of_pairs(search.flows.first, search.flows.second, seeds, partner)
    supporters = [search.neighbours[seed] for seed in seeds[is_defined]]
    known = [g for g in former if g.direction is not None and len(g.members) >= config.min_tracks]
    warm = [g.direction for g in known if g.direction is not None]
    return np.array([*warm, *directions[is_defined]]), [g.members for g in known] + supporters


def _grown(search: _Search, shares: Bools, supporters: Ints, direction: Floats, is_free: Bools) -> Ints:
    """The connected tracks around the supporters that share a direction and have similar rates, refitted once."""
    members = _connected_to(search, shares, supporters)
    members = _of_similar_rate(search, members, direction)
    if len(members) < 2:
        return members
    refined, _, chi2_all, status = _direction_of(search, members, direction)
    if status in (Status.no_epipole, Status.no_parallax):
        return members
    again = (chi2_all < search.gate_chi2) & is_free
    return _of_similar_rate(search, _connected_to(search, again, members), refined)


def _connected_to(search: _Search, is_in: Bools, seeds: Ints) -> Ints:
    """Tracks of ``is_in`` in the connected part that holds most of the seeds."""
    keep = is_in[search.rows] & is_in[search.columns]
    n = len(is_in)
    graph = coo_array((np.ones(np.count_nonzero(keep)), (search.rows[keep], search.columns[keep])), shape=(n, n))
    _, label = connected_components(graph, directed=False)
    seeds = seeds[is_in[seeds]]
    if not len(seeds):
        return np.empty(0, dtype=np.int64)
    values, counts = np.unique(label[seeds], return_counts=True)
    connected: Ints = np.flatnonzero(is_in & (label == values[np.argmax(counts)]))
    return connected


def _of_similar_rate(search: _Search, members: Ints, direction: Floats) -> Ints:
    """Members whose rate abs(V)/distance is like the median's: the paper's similar TTC, kept away from its poles."""
    if len(members) < 2:
        return members
    flows = search.flows.take(members)
    across = np.cross(flows.first, direction)
    across2 = np.maximum(np.einsum("ni,ni->n", across, across), 1e-12)
    normal = np.cross(flows.first, flows.second)
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


def _direction_of(search: _Search, members: Ints, start: Floats | None) -> tuple[Floats, Floats, Floats, Status]:
    """Maximum-likelihood direction of the members, and the chi-square of ALL candidates against it."""
    flows = search.flows.take(members)
    direction, covariance, _, status = epipole_maximum_likelihood(
        flows.first, flows.second, flows.sigma_rad, start=start
    )
    if status in (Status.no_epipole, Status.no_parallax):
        return direction, covariance, np.full(len(search.xy_px), np.inf), status
    everything = search.flows
    chi2_all = flow_line_chi2(direction, everything.first, everything.second, everything.sigma_rad)
    return direction, covariance, chi2_all, status


def _fitted(search: _Search, members: Ints) -> MotionGroup:
    direction, covariance, _, status = _direction_of(search, members, None)
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
    if one.direction is None or other.direction is None:
        return None
    distance, _ = KDTree(search.xy_px[one.members]).query(search.xy_px[other.members])
    if distance.min() > search.link_px:
        return None
    members = np.sort(np.concatenate([one.members, other.members]))
    joint = _fitted(search, members)
    if joint.direction is None or len(_of_similar_rate(search, members, joint.direction)) < 0.9 * len(members):
        return None
    apart = _chi2_sum(search, one, one.members) + _chi2_sum(search, other, other.members)
    return joint if _chi2_sum(search, joint, members) - apart < _MERGE_CHI2 else None


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
    return [_fitted(search, m) for m in members if len(m) >= config.min_tracks]


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
