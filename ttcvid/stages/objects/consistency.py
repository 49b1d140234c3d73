"""How far the states of an object contradict each other: by so much their covariances are too small."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ttcvid.model import Floats
from ttcvid.stages.objects.joint_states import JointStates

# A state is compared with one of so long ago at least: both rest on windows of views, which then share few of them.
_LAG_S = 0.25
# States are compared over no longer time, and comparisons of this time count.
_RECENT_S = 0.5
# Before anything could be compared a reduced chi-square of one is assumed, which counts for so many seconds.
_AT_FIRST_S = 0.15
# An object that comes so near between two states, as a share of its distance, is not compared: its change of depth is
# no longer linear in the errors.
_LEAST_DEPTH = 0.2
# Presentation times are rounded to the clock of their container, s.
_ROUNDING_S = 1e-3
# Least variance of a difference, 1/s^2.
_TINY = 1e-12


@dataclass(frozen=True)
class PastState:
    """State ``abc_hz (3,)`` of an object at ``t_s``, with the covariance ``cov (3, 3)`` that its tracks give, 1/s^2.

    ``step_s`` is the time since the state before it, ``chi2`` the reduced chi-square of the difference from an earlier
    one; None where there was none to compare.
    """

    t_s: float
    step_s: float
    abc_hz: Floats
    cov: Floats
    chi2: float | None = None


PastStates = dict[int, tuple[PastState, ...]]
"""The recent states of each object, by ``cluster_id``, the oldest first."""


def with_consistent_covariances(
    joint: JointStates, cluster_id: Sequence[int], t_s: float, past: PastStates
) -> tuple[JointStates, PastStates]:
    """States with covariances that allow for how far they contradict those of a moment ago, and the states so far.

    At constant velocity the state V / Z follows from an earlier one. As long as noise is all that is wrong, the reduced
    chi-square of the difference is at most one. Outliers, wrong labels, and motion that no trajectory of the model has
    make it larger. Its mean multiplies the covariance (the Birge ratio); over drawn scenes the mean squared error of
    1 / ttc_z grows in proportion to it.

    ``cluster_id`` has the number of each of the K states, ``t_s`` is the time of their frame.
    """
    recent = {number: _since(states, t_s - _RECENT_S) for number, states in past.items()}
    now: PastStates = {}
    scale = np.ones(len(joint.owner))
    for k, number in enumerate(cluster_id):
        before = recent.get(number, ())
        step_s = t_s - before[-1].t_s if before else 0.0
        state = PastState(t_s, step_s, joint.abc_hz[k], joint.cov[k])
        earlier = [one for one in before if one.t_s <= t_s - _LAG_S + _ROUNDING_S]
        now[number] = (*before, replace(state, chi2=_reduced_chi2(earlier[-1], state) if earlier else None))
        scale[k] = max(1.0, _mean_chi2(now[number]))
    seen = {number: states for number, states in recent.items() if states} | now
    return replace(joint, cov=scale[:, None, None] * joint.cov), seen


def _since(states: tuple[PastState, ...], t_s: float) -> tuple[PastState, ...]:
    return tuple(one for one in states if one.t_s >= t_s - _ROUNDING_S)


def _mean_chi2(states: tuple[PastState, ...]) -> float:
    """Mean over time of the reduced chi-squares of an object's states."""
    compared = [(one.step_s, one.chi2) for one in states if one.chi2 is not None]
    total = _AT_FIRST_S + sum(step_s * chi2 for step_s, chi2 in compared)
    return total / (_AT_FIRST_S + sum(step_s for step_s, _ in compared))


def _reduced_chi2(before: PastState, now: PastState) -> float | None:
    """Of the difference from the state that an earlier one predicts; None where the object comes too near."""
    since_s = now.t_s - before.t_s
    depth = 1.0 + float(before.abc_hz[2]) * since_s
    if depth < _LEAST_DEPTH:
        return None
    predicted = before.abc_hz / depth
    jacobian = np.eye(3) / depth
    jacobian[:, 2] -= predicted * since_s / depth
    cov = now.cov + jacobian @ before.cov @ jacobian.T + _TINY * np.eye(3)
    off = now.abc_hz - predicted
    return float(off @ np.linalg.solve(cov, off)) / 3.0
