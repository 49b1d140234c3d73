"""The paper's iterative RANSAC over epipoles: flows that share one direction at similar times.

Hypotheses from pairs, a chi-square gate in sigmas of each flow, and a count of what chance alone would give.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from epipole_of_flows import epipole_maximum_likelihood, moves_towards
from scipy.special import chdtri, gammaln, logsumexp

from ttcvid.geometry.paper.epipole import SIGNIFICANCE_SIGMAS
from ttcvid.geometry.paper.flow_line import flow_line_chi2
from ttcvid.geometry.quotient import quotient
from ttcvid.geometry.rotation import cross, normalize
from ttcvid.model import Bools, Floats, Ints

# A flow that moves against a direction by more than this many sigmas does not share it.
_WRONG_WAY_SIGMAS = -2.0
# Two flow planes that meet at less than this sine do not define a direction.
_LEAST_SINE = 1e-3
# Any two lines that are not parallel meet somewhere: a group has at least three (the paper, section 3.3).
_LEAST_FLOWS = 3
# Probability with which a flow passes the gate of its own direction.
_GATE_PROBABILITY = 0.99
# ... and within which it is not looked for elsewhere: the noisiest flows of a motion are no motion of their own.
_WIDE_GATE_PROBABILITY = 0.9999
# Rates of a group differ by its depth: this part of the middle one, and three sigmas, are allowed.
_RATE_PART, _RATE_SIGMAS = 0.4, 3.0
# A group is believed when chance gives fewer than this many of its kind.
_LOG_FALSE_ALARMS = float(np.log(0.05))
# Times that a group is fitted to the flows that agree with it, or all groups to those that agree best.
_FITS = 4


@dataclass(frozen=True)
class EpipoleGroup:
    """Flows of one relative motion.

    ``direction (3,)`` is ``dir`` with ``covariance (3, 3)`` in its tangent plane, rad^2; ``rate_hz`` the middle rate
    abs(V)/abs(P) of its flows in the second view, one over the paper's k where they are near their epipole; ``members
    (M,)`` ascending indices of the flows.
    """

    direction: Floats
    covariance: Floats
    rate_hz: float
    members: Ints


@dataclass(frozen=True)
class _Flows:
    """Flows as the search sees them: those (N,) that are ``is_usable`` are longer than their noise."""

    q: Floats
    p: Floats
    sigma_rad: Floats
    gap_s: Floats
    is_usable: Bools


def epipoles_by_ransac(
    first: Floats,
    second: Floats,
    sigma_rad: Floats,
    gap_s: float | Floats,
    rng: np.random.Generator,
    n_hypotheses: int = 300,
    max_groups: int = 12,
) -> list[EpipoleGroup]:
    """Motions that flows fall into by their epipoles and times, the largest first.

    Greedy: of ``n_hypotheses`` pairs the one that the most of the flows left agree with is fitted to them, takes them,
    and the rest is searched again. In the end each flow goes to the motion that explains it best, whichever was found
    first. Needs no neighbourhood in the picture, and so cannot tell two things apart that move alike.

    Parameters
    ----------
    first, second
        ``(N, 3)`` unit rays of the two views, rotation removed. NaN, and flows within 3 sigmas of none, are left out.
    sigma_rad
        ``(N,)`` standard deviation of a ray's direction per axis.
    gap_s
        Time between the views in s, scalar or ``(N,)``.
    rng
        Chooses the pairs.

    Returns
    -------
    Groups of at least three flows, each expected less than 0.05 times by chance; empty where there is none.

    Source: the paper's (5) and its clustering of independent motions, DESIGN equation 6; similar rates instead of
    similar k, as times have poles, and significance by `log_false_alarms`.

    >>> position = np.array([[3.0, 1.0, 20.0], [-2.0, 1.5, 25.0], [1.0, -2.0, 15.0], [-4.0, 0.5, 20.0]])
    >>> before, now = normalize(position + (0.0, 0.0, 0.5)), normalize(position)
    >>> group, = epipoles_by_ransac(before, now, np.full(4, 1e-6), 0.1, np.random.default_rng(0))
    >>> group.direction.round(6) + 0.0, group.members
    (array([ 0.,  0., -1.]), array([0, 1, 2, 3]))
    """
    flows = _flows(first, second, sigma_rad, gap_s)
    left, groups = flows.is_usable.copy(), list[EpipoleGroup]()
    while len(groups) < max_groups:
        group = _largest_group(flows, np.flatnonzero(left), rng, n_hypotheses)
        if group is None:
            break
        left[_agreeing(flows, np.flatnonzero(left), group, _WIDE_GATE_PROBABILITY)] = False
        groups.append(group)
    return _reassigned(flows, groups)


def _flows(first: Floats, second: Floats, sigma_rad: Floats, gap_s: float | Floats) -> _Flows:
    if first.shape != second.shape or first.shape != (len(sigma_rad), 3):
        raise ValueError(
            f"expected first and second (N, 3) and sigma_rad (N,), got {first.shape}, {second.shape}, {sigma_rad.shape}"
        )
    gaps_s = np.broadcast_to(np.asarray(gap_s, dtype=np.float64), sigma_rad.shape)
    flows = _Flows(first, second, sigma_rad, gaps_s, np.asarray(np.isfinite(first + second).all(axis=1)))
    is_usable: Bools = np.asarray(flows.is_usable & (sigma_rad > 0.0) & (gaps_s > 0.0))
    index = np.flatnonzero(is_usable)
    is_usable[index] = _length_sigmas(flows, index) > SIGNIFICANCE_SIGMAS
    return replace(flows, is_usable=is_usable)


def _length_sigmas(flows: _Flows, index: Ints) -> Floats:
    length = np.linalg.norm(flows.p[index] - flows.q[index], axis=1)
    return quotient(length, np.sqrt(2.0) * flows.sigma_rad[index])


def _largest_group(flows: _Flows, left: Ints, rng: np.random.Generator, n_hypotheses: int) -> EpipoleGroup | None:
    """The motion that the most of the flows ``left`` agree with, None where chance would do as well."""
    if len(left) < _LEAST_FLOWS:
        return None
    one = rng.integers(0, len(left), n_hypotheses)
    other = (one + rng.integers(1, len(left), n_hypotheses)) % len(left)
    directions, is_defined = directions_of_pairs(flows.q[left], flows.p[left], one, other)
    directions, one, other = directions[is_defined], one[is_defined], other[is_defined]
    if not len(directions):
        return None
    rates_hz, _ = _rates(flows, left, directions)
    row = np.arange(len(directions))
    middle_hz = 0.5 * (rates_hz[row, one] + rates_hz[row, other])
    counts = np.count_nonzero(_agree(flows, left, directions, middle_hz), axis=1)
    best = int(np.argmax(counts))
    agreeing = left[_agree(flows, left, directions[best : best + 1], middle_hz[best : best + 1])[0]]
    group = None
    for _ in range(_FITS):
        group = _fitted(flows, agreeing)
        if group is None:
            return None
        agreeing = _agreeing(flows, left, group, _GATE_PROBABILITY)
        if np.array_equal(agreeing, group.members):
            break
    return group if group is not None and _is_significant(flows, left, group) else None


def _fitted(flows: _Flows, members: Ints) -> EpipoleGroup | None:
    """Maximum likelihood of the members' direction, and their middle rate; None where they leave it open."""
    if len(members) < _LEAST_FLOWS:
        return None
    q, p, sigma_rad = flows.q[members], flows.p[members], flows.sigma_rad[members]
    direction, covariance, _, _ = epipole_maximum_likelihood(q, p, sigma_rad)
    if not np.isfinite(direction).all():
        return None
    rates_hz, _ = _rates(flows, members, direction[None])
    return EpipoleGroup(direction, covariance, float(np.median(rates_hz)), members)


def _is_significant(flows: _Flows, among: Ints, group: EpipoleGroup) -> bool:
    """Whether chance would hardly bring as many flows together; that their rates agree is not even counted."""
    chance = float(np.mean(chance_of_sharing(_length_sigmas(flows, among), float(chdtri(1, 1.0 - _GATE_PROBABILITY)))))
    n_tests = 0.5 * len(among) * (len(among) - 1)
    return log_false_alarms(n_tests, len(among), len(group.members), chance) < _LOG_FALSE_ALARMS


def _reassigned(flows: _Flows, groups: list[EpipoleGroup]) -> list[EpipoleGroup]:
    """Each flow with the motion that explains its direction and its rate best, and the motions fitted anew."""
    index = np.flatnonzero(flows.is_usable)
    for _ in range(_FITS):
        if not groups:
            break
        directions = np.array([group.direction for group in groups])
        middle_hz = np.array([group.rate_hz for group in groups])
        off = flow_line_chi2(directions, flows.q[index], flows.p[index], flows.sigma_rad[index])
        off += _rate_offset(flows, index, directions, middle_hz) ** 2
        off[~_agree(flows, index, directions, middle_hz)] = np.inf
        label = np.where(np.isfinite(off).any(axis=0), np.argmin(off, axis=0), -1)
        fitted = [_fitted(flows, index[label == number]) for number in range(len(groups))]
        groups = [group for group in fitted if group is not None]
    taken = np.concatenate([group.members for group in groups]) if groups else np.empty(0, dtype=np.int64)
    groups = sorted(groups, key=lambda g: (-len(g.members), g.members[0]))
    # Chance is asked about the flows that no other group explains.
    unexplained = np.setdiff1d(index, taken)
    return [g for g in groups if _is_significant(flows, np.union1d(unexplained, g.members), g)]


def _agreeing(flows: _Flows, index: Ints, group: EpipoleGroup, probability: float) -> Ints:
    """Those of the flows ``index`` that agree with a group."""
    is_in = _agree(flows, index, group.direction[None], np.array([group.rate_hz]), probability)[0]
    return np.asarray(index[is_in])


def _agree(
    flows: _Flows, index: Ints, directions: Floats, middle_hz: Floats, probability: float = _GATE_PROBABILITY
) -> Bools:
    """Which of the flows ``index`` share each of M directions at a rate like ``middle_hz (M,)``: (M, N)."""
    gate_chi2 = float(chdtri(1, 1.0 - probability))
    shares = shares_direction(directions, flows.q[index], flows.p[index], flows.sigma_rad[index], gate_chi2)
    return np.asarray(shares & (np.abs(_rate_offset(flows, index, directions, middle_hz)) < 1.0))


def _rate_offset(flows: _Flows, index: Ints, directions: Floats, middle_hz: Floats) -> Floats:
    """How far rates are from the middle one of their group, over what is allowed: (M, N)."""
    rates_hz, sigma_hz = _rates(flows, index, directions)
    allowed_hz = _RATE_PART * np.abs(middle_hz)[:, None] + _RATE_SIGMAS * sigma_hz
    return quotient(rates_hz - middle_hz[:, None], allowed_hz)


def _rates(flows: _Flows, index: Ints, directions: Floats) -> tuple[Floats, Floats]:
    """Rate abs(V)/abs(P) in the second view of N flows along each of M directions, and its noise: (M, N) each.

    ``q x (p - rate gap e) = 0`` by least squares along q x e, as in `state_from_direction`.
    """
    q, p, gap_s = flows.q[index], flows.p[index], flows.gap_s[index]
    q_along = directions @ q.T
    square = 1.0 - q_along**2
    rate_hz = quotient(directions @ p.T - q_along * np.einsum("ni,ni->n", p, q), square * gap_s)
    sigma_hz = quotient(np.sqrt(2.0) * flows.sigma_rad[index], np.sqrt(np.maximum(square, 0.0)) * gap_s)
    return np.nan_to_num(rate_hz), np.nan_to_num(sigma_hz)


def directions_of_pairs(q: Floats, p: Floats, one: Ints, other: Ints) -> tuple[Floats, Bools]:
    """The direction in which the flow planes of two tracks meet, for each of M pairs.

    Parameters
    ----------
    q, p : (N, 3) unit rays of the first and the second view.
    one, other : (M,) indices of the pairs.

    Returns
    -------
    directions : (M, 3) unit vectors, each with the sign towards which its two flows move; NaN where undefined.
    is_defined : (M,) the planes meet at an angle and both flows agree in sign.
    """
    normals = normalize(cross(q, p))
    meeting = cross(normals[one], normals[other])
    sine = np.linalg.norm(meeting, axis=1)
    direction = normalize(meeting)
    flow = p - q
    towards_one = np.einsum("mi,mi->m", flow[one], direction)
    towards_other = np.einsum("mi,mi->m", flow[other], direction)
    sign = np.where(towards_one < 0.0, -1.0, 1.0)
    is_defined = (sine > _LEAST_SINE) & (towards_one * towards_other > 0.0)
    return direction * sign[:, None], is_defined


def shares_direction(directions: Floats, q: Floats, p: Floats, sigma_rad: Floats, gate_chi2: float) -> Bools:
    """Which of N flows lie in a plane with each of M directions and move towards it: (M, N).

    The gate is on the chi-square of the flow line (the paper's epsilon in sigmas of each flow instead of pixels at
    the epipole), the sign is tested separately.
    """
    near = flow_line_chi2(directions, q, p, sigma_rad) < gate_chi2
    near &= moves_towards(directions, q, p, sigma_rad) > _WRONG_WAY_SIGMAS
    return near


def chance_of_sharing(length_sigmas: Floats, gate_chi2: float) -> Floats:
    """Probability that a flow of random orientation passes the gate of a given direction: (N,).

    A flow of ``length_sigmas`` standard deviations has its orientation within asin(gate / length) of the right one by
    chance with probability asin(...) / pi, one of the two senses counted.
    """
    sine = np.sqrt(gate_chi2) / np.maximum(length_sigmas, 1e-9)
    chance: Floats = np.arcsin(np.minimum(1.0, sine)) / np.pi
    return chance


def log_false_alarms(n_tests: float, n_members: int, n_inliers: int, chance: float) -> float:
    """Natural logarithm of the expected number of groups as good as this one by chance (a-contrario).

    ``n_tests`` groups are tried, each with two members that define its direction; the other ``n_inliers - 2`` of
    ``n_members - 2`` agree by chance with probability ``chance`` each (binomial tail).
    """
    n, k = n_members - 2, n_inliers - 2
    if k <= 0:
        return float(np.log(n_tests))
    counts = np.arange(k, n + 1)
    chance = min(max(chance, 1e-9), 1.0 - 1e-9)
    terms = gammaln(n + 1) - gammaln(counts + 1) - gammaln(n - counts + 1)
    terms = terms + counts * np.log(chance) + (n - counts) * np.log1p(-chance)
    return float(np.log(n_tests) + min(0.0, float(logsumexp(terms))))
