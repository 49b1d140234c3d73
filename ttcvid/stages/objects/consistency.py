"""Objects whose times contradict one another: from frame to frame they jump about by more than their own errors.

A tracker that takes hold of now this and now that (cars far ahead in a bend, one before the other; leaves before the
sky) makes a rigid thing of it in each frame, each time another one. No single frame shows that, but their rates do.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from ttcvid.geometry.chi_square import chi2_quantile
from ttcvid.geometry.compiled import compiled, compiled_for
from ttcvid.model import ClusterRow, CollisionTimes, Floats, MotionState, Status
from ttcvid.stages.objects.clusters import ranked

# Longer than the views of one estimate reach back, so that the first and the last share none.
_LASTING_S = 1.5
# And no more rates than two windows of 20 views and some have (1.5 s of 30 frames/s): errors hang together over the
# views that estimates share, and squares of many such windows scatter by more than those of so many single rates.
_MOST_RATES = 45
# Of things whose rates come from independent errors, one in a thousand would be taken for contradictory; errors that
# hang together over 20 views make it fewer, over 5 to 10 of them up to one in fifty.
_CONFIDENCE = 0.999
# Near us, who begins to brake follows no parabola by far, but one with a bend. Since its time is sought, a bend that is
# to explain what contradicts a parabola has to explain it well.
_CONFIDENCE_OF_BEND = 0.99
# A course is a parabola: this many unknowns, and some rates more, so that there is something to test.
_UNKNOWNS, _LEAST_RATES = 3, 5
# A bend of which less than this part is no parabola is none: a divisor.
_TINY = 1e-9
# A rate by which a thing would have come to us by now says hardly anything of its rate now: of 1 - (time since) /
# (time that was left), at least this part must be left.
_LEAST_LEFT = 0.1
# No course is a parabola to better than this part of its rates: 0.2 m/s at 5 m/s.
_UNSEEN_CHANGE = 0.04


@dataclass(frozen=True)
class Rates:
    """What was found of each object lately: by ``cluster_id``, rows (K, 3) of t_s, -Vz/Z in 1/s, its sigma."""

    of_cluster: dict[int, Floats] = field(default_factory=dict)


def steady_rows(rates: Rates, t_s: float, rows: tuple[ClusterRow, ...]) -> tuple[tuple[ClusterRow, ...], Rates]:
    """The rows, without the states and times of objects whose rates contradict one another, and what to remember."""
    found = {row.cluster_id: (t_s, *rate) for row in rows if (rate := _rate(row)) is not None}
    lately: dict[int, Floats] = {}
    for cluster_id, past in rates.of_cluster.items():
        past = past[past[:, 0] >= t_s - _LASTING_S][1 - _MOST_RATES :]
        if len(past):
            lately[cluster_id] = past
    for cluster_id, now in found.items():
        newest = np.array([now])
        lately[cluster_id] = np.concatenate((lately[cluster_id], newest)) if cluster_id in lately else newest
    jumpy = {cluster_id for cluster_id in found if contradicts_itself(lately[cluster_id])}
    if jumpy:
        rows = tuple(ranked([_without_state(row) if row.cluster_id in jumpy else row for row in rows]))
    return rows, Rates(lately)


def contradicts_itself(rates: Floats) -> bool:
    """Whether rates (K, 3) of t_s, -Vz/Z in 1/s and its sigma are those of no single thing, at 99.9 %.

    At constant velocity the depth goes in a straight line, so that a rate r found a time d ago says r / (1 - r d) of
    the rate now. These may follow a parabola over time, for what brakes or turns, and have to lie about it within their
    errors; or about one with a bend, where it began to, at 99 %.
    """
    chi2, gain, n = _chi2_about_parabola(np.ascontiguousarray(rates))
    if n < _LEAST_RATES or not chi2 > _limit(_CONFIDENCE, n - _UNKNOWNS):
        return False
    return chi2 - gain > _limit(_CONFIDENCE_OF_BEND, n - _UNKNOWNS - 1)


@lru_cache(maxsize=256)
def _limit(confidence: float, freedom: int) -> float:
    return float(chi2_quantile(confidence, freedom))


@compiled_for("(f8[:, ::1],)")
def _chi2_about_parabola(rates: Floats) -> tuple[float, float, int]:
    """Weighted squares of the rates about their parabola, and what a bend at some time takes off them at the most.

    The last is how many of the rates say something of now.
    """
    since, value, weight, n = np.empty(len(rates)), np.empty(len(rates)), np.empty(len(rates)), 0
    for i in range(len(rates)):
        ago = rates[-1, 0] - rates[i, 0]
        left = 1.0 - rates[i, 1] * ago
        if left > _LEAST_LEFT:
            since[n], value[n] = ago, rates[i, 1] / left
            weight[n] = (left * left / rates[i, 2]) ** 2
            n += 1
    # The powers 1, t, t^2 made orthogonal one after the other, and what is along each taken off.
    powers, squares, curve = np.empty((_UNKNOWNS, n)), np.zeros(_UNKNOWNS), np.empty(n)
    for p in range(_UNKNOWNS):
        for i in range(n):
            curve[i] = since[i] ** p
        _take_off(curve, powers[:p], squares[:p], weight)
        for i in range(n):
            powers[p, i] = curve[i]
            squares[p] += weight[i] * curve[i] * curve[i]
    value = value[:n]
    _take_off(value, powers, squares, weight)
    chi2, gain = 0.0, 0.0
    for i in range(n):
        chi2 += weight[i] * value[i] * value[i]
    # Of the bends at each time, the one that takes off the most.
    for k in range(1, n - 1):
        before = 0.0
        for i in range(n):
            curve[i] = max(since[i] - since[k], 0.0)
            before += weight[i] * curve[i] * curve[i]
        _take_off(curve, powers, squares, weight)
        along, square = 0.0, 0.0
        for i in range(n):
            along += weight[i] * curve[i] * value[i]
            square += weight[i] * curve[i] * curve[i]
        if square > _TINY * before:
            gain = max(gain, along * along / square)
    return chi2, gain, n


@compiled
def _take_off(curve: Floats, powers: Floats, squares: Floats, weight: Floats) -> None:
    """Takes off a ``curve (n,)`` what of it is along each of the ``powers (P, n)`` with their ``squares (P,)``."""
    for p in range(len(powers)):
        along = 0.0
        for i in range(len(curve)):
            along += weight[i] * powers[p, i] * curve[i]
        if squares[p] > 0.0:
            for i in range(len(curve)):
                curve[i] -= along / squares[p] * powers[p, i]


def _rate(row: ClusterRow) -> tuple[float, float] | None:
    """-Vz/Z of an object's state, 1/s, and its sigma; None without a state."""
    if row.state_abc_hz is None or row.state_cov is None:
        return None
    rate_hz = -float(row.state_abc_hz[2])
    return rate_hz, float(np.hypot(np.sqrt(row.state_cov[2, 2]), _UNSEEN_CHANGE * rate_hz))


def _without_state(row: ClusterRow) -> ClusterRow:
    return row.changed(
        status=Status.not_rigid,
        motion_state=MotionState.unknown,
        ref_px=None,
        state_abc_hz=None,
        state_cov=None,
        urgency_rank=None,
        times=CollisionTimes.missing(1),
    )
