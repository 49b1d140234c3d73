"""Objects whose times contradict one another: from frame to frame they jump about by more than their own errors.

A tracker that takes hold of now this and now that (cars far ahead in a bend, one before the other; leaves before the
sky) makes a rigid thing of it in each frame, each time another one. No single frame shows that, but their rates do.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ttcvid.geometry.chi_square import chi2_quantile
from ttcvid.geometry.compiled import compiled
from ttcvid.model import ClusterRow, CollisionTimes, Floats, MotionState, Status
from ttcvid.stages.clusters import ranked

# Longer than the views of one estimate reach back, so that the first and the last share none.
_LASTING_S = 1.5
# Of things whose rates come from independent errors, one in a thousand would be taken for contradictory; views that
# estimates have in common make it fewer.
_CONFIDENCE = 0.999
# A course is a parabola: this many unknowns, and some rates more, so that there is something to test.
_UNKNOWNS, _LEAST_RATES = 3, 5
# A rate by which a thing would have come to us by now says hardly anything of its rate now: of 1 - (time since) /
# (time that was left), at least this part must be left.
_LEAST_LEFT = 0.1


@dataclass(frozen=True)
class Rates:
    """What was found of each object lately: by ``cluster_id``, rows (K, 3) of t_s, -Vz/Z in 1/s, its sigma."""

    of_cluster: dict[int, Floats] = field(default_factory=dict)


def steady_rows(rates: Rates, t_s: float, rows: tuple[ClusterRow, ...]) -> tuple[tuple[ClusterRow, ...], Rates]:
    """The rows, without the states and times of objects whose rates contradict one another, and what to remember."""
    found = {row.cluster_id: (t_s, *rate) for row in rows if (rate := _rate(row)) is not None}
    lately: dict[int, Floats] = {}
    for cluster_id in rates.of_cluster.keys() | found.keys():
        past = rates.of_cluster.get(cluster_id, np.empty((0, 3)))
        past = past[past[:, 0] >= t_s - _LASTING_S]
        now = np.reshape(found.get(cluster_id, ()), (-1, 3))
        if len(past) + len(now):
            lately[cluster_id] = np.vstack((past, now))
    jumpy = {cluster_id for cluster_id in found if contradicts_itself(lately[cluster_id])}
    if jumpy:
        rows = tuple(ranked([_without_state(row) if row.cluster_id in jumpy else row for row in rows]))
    return rows, Rates(lately)


def contradicts_itself(rates: Floats) -> bool:
    """Whether rates (K, 3) of t_s, -Vz/Z in 1/s and its sigma are those of no single thing, at 99.9 %.

    At constant velocity the depth goes in a straight line, so that a rate r found a time d ago says r / (1 - r d) of
    the rate now. These may follow a parabola over time, for what brakes or turns, and have to lie about it within their
    errors.
    """
    chi2, n = _chi2_about_parabola(np.ascontiguousarray(rates))
    return n >= _LEAST_RATES and chi2 > float(chi2_quantile(_CONFIDENCE, n - _UNKNOWNS))


@compiled
def _chi2_about_parabola(rates: Floats) -> tuple[float, int]:
    """Weighted squares of the rates about their parabola, and how many of them say something of now."""
    since, value, weight, n = np.empty(len(rates)), np.empty(len(rates)), np.empty(len(rates)), 0
    for i in range(len(rates)):
        ago = rates[-1, 0] - rates[i, 0]
        left = 1.0 - rates[i, 1] * ago
        if left > _LEAST_LEFT:
            since[n], value[n] = ago, rates[i, 1] / left
            weight[n] = (left * left / rates[i, 2]) ** 2
            n += 1
    # The powers 1, t, t^2 made orthogonal one after the other, and what is along each taken off.
    powers = np.empty((_UNKNOWNS, n))
    for p in range(_UNKNOWNS):
        for i in range(n):
            powers[p, i] = since[i] ** p
        for q in range(p + 1):
            along, square = 0.0, 0.0
            for i in range(n):
                along += weight[i] * powers[q, i] * (powers[p, i] if q < p else value[i])
                square += weight[i] * powers[q, i] * powers[q, i]
            if square > 0.0:
                for i in range(n):
                    if q < p:
                        powers[p, i] -= along / square * powers[q, i]
                    else:
                        value[i] -= along / square * powers[q, i]
    chi2 = 0.0
    for i in range(n):
        chi2 += weight[i] * value[i] * value[i]
    return chi2, n


def _rate(row: ClusterRow) -> tuple[float, float] | None:
    """-Vz/Z of an object's state, 1/s, and its sigma; None without a state."""
    if row.state_abc_hz is None or row.state_cov is None:
        return None
    return -float(row.state_abc_hz[2]), float(np.sqrt(row.state_cov[2, 2]))


def _without_state(row: ClusterRow) -> ClusterRow:
    return row.changed(
        status=Status.not_rigid,
        motion_state=MotionState.unknown,
        ref_px=None,
        state_abc_hz=None,
        state_cov=None,
        speed_change=0.0,
        urgency_rank=None,
        times=CollisionTimes.missing(1),
    )
