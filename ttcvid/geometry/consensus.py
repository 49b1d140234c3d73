"""Which flows share one direction: hypotheses from pairs, the chi-square gate, and what chance alone would give."""

from __future__ import annotations

import numpy as np
from scipy.special import gammaln, logsumexp

from ttcvid.geometry.flow_line import flow_line_chi2, moves_towards
from ttcvid.geometry.rotation import cross, normalize
from ttcvid.model import Bools, Floats, Ints

# A flow that moves against a direction by more than this many sigmas does not share it.
_WRONG_WAY_SIGMAS = -2.0
# Two flow planes that meet at less than this sine do not define a direction.
_LEAST_SINE = 1e-3


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
