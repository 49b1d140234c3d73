"""How far the states of an object contradict each other: by so much their covariances are too small."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ttcvid.geometry.camera.pinhole import rays_from_pixels
from ttcvid.model import Floats
from ttcvid.stages.objects.joint_states import JointStates
from ttcvid.stages.segmentation.bodies import ROUNDING_S
from ttcvid.stages.tracking.history import TrackHistory

# A state is compared with one of at least so long ago, about half of whose views are others, or with the oldest; and
# with the last one, since what jumps to and fro is the same again after some frames.
_LAG_S = 0.25
# States are compared over no longer time, and comparisons of this time count.
_RECENT_S = 0.5
# A reduced chi-square of one counts beside the comparisons, as if it had stood for so many seconds.
_PRIOR_S = 0.15
# An object that comes so near between two states, as a share of its distance, is not compared: its change of depth is
# no longer linear in the errors.
_LEAST_DEPTH = 0.2
# Least variance of a difference, 1/s^2.
_TINY = 1e-12


@dataclass(frozen=True)
class PastState:
    """State ``abc_hz (3,)`` of an object at ``t_s``, with the covariance ``cov (3, 3)`` before it is widened, 1/s^2.

    ``ray (3,)`` meets its reference point in the plane z = 1; both are in the camera of that frame. ``step_s`` is the
    time since the state before it, ``redchi`` what `_compared` finds; None where there was none to compare.
    """

    t_s: float
    step_s: float
    ray: Floats
    abc_hz: Floats
    cov: Floats
    redchi: float | None = None


PastStates = dict[int, tuple[PastState, ...]]
"""The recent states of each object, by ``cluster_id``, the oldest first."""


def with_consistent_covariances(
    joint: JointStates, cluster_id: Sequence[int], history: TrackHistory, past: PastStates
) -> tuple[JointStates, PastStates]:
    """States with covariances that allow for how far they contradict those of a moment ago, and the states up to now.

    At constant velocity the state V / Z follows from an earlier one and the camera's turn. As long as noise is all that
    is wrong, the expected reduced chi-square of the difference is at most one where states share most views, and the
    larger of two somewhat more where they share none (estimators of two and three frames). Outliers, wrong labels and
    relative motion that changes make it larger. Its mean, if above one, multiplies the covariance (the Birge ratio).

    ``cluster_id`` has the number of each of the K states in the present frame of the ``history``.
    """
    t_s = float(history.t_s[history.now])
    rays = rays_from_pixels(history.camera, joint.ref_px)
    recent = {
        number: tuple(one for one in states if one.t_s >= t_s - _RECENT_S - ROUNDING_S)
        for number, states in past.items()
    }
    scale = np.ones((len(joint.owner), 1, 1))
    for k, number in enumerate(cluster_id):
        before = recent.get(number, ())
        step_s = t_s - before[-1].t_s if before else 0.0
        state = PastState(t_s, step_s, rays[k], joint.abc_hz[k], joint.cov[k])
        recent[number] = (*before, replace(state, redchi=_compared(before, state, history)))
        weights = [(min(one.step_s, _LAG_S), one.redchi) for one in recent[number] if one.redchi is not None]
        off_s = _PRIOR_S + sum(weight_s * redchi for weight_s, redchi in weights)
        scale[k] = max(1.0, off_s / (_PRIOR_S + sum(weight_s for weight_s, _ in weights)))
    seen = {number: states for number, states in recent.items() if states}
    return replace(joint, cov=scale * joint.cov), seen


def _compared(before: tuple[PastState, ...], now: PastState, history: TrackHistory) -> float | None:
    """The larger reduced chi-square of a state's differences from the last one and an older one; None without any."""
    old = [state for state in before if state.t_s <= now.t_s - _LAG_S + ROUNDING_S]
    # Of a young object, or between rare frames, both are the same.
    compared = {one.t_s: one for one in (*(old[-1:] or before[:1]), *before[-1:])}.values()
    return max((redchi for one in compared if (redchi := _redchi(one, now, history)) is not None), default=None)


def _redchi(before: PastState, now: PastState, history: TrackHistory) -> float | None:
    """Reduced chi-square of a state's difference from what an earlier one predicts.

    None where the object comes too near, or the earlier frame is no longer in the history. A point at p = (x, y, 1),
    moving at w = (a, b, c), is at R (p + w t) now and moves at R w, both in units of its former depth; R takes vectors
    from the camera of the earlier state to the present one.
    """
    view = int(np.argmin(np.abs(history.t_s - before.t_s)))
    if abs(float(history.t_s[view]) - before.t_s) > ROUNDING_S:
        return None
    since_s, cam_R_past = now.t_s - before.t_s, history.cam_R_past[view]
    depth = float(cam_R_past[2] @ (before.ray + since_s * before.abc_hz))
    if depth < _LEAST_DEPTH:
        return None
    predicted = cam_R_past @ before.abc_hz / depth
    jacobian = (cam_R_past - since_s * np.outer(predicted, cam_R_past[2])) / depth
    cov = now.cov + jacobian @ before.cov @ jacobian.T + _TINY * np.eye(3)
    off = now.abc_hz - predicted
    return float(off @ np.linalg.solve(cov, off)) / 3.0
