"""The near face of each object: what is seen of it at the depth of its nearest surface.

A car in a bend shows its side, which follows its front; and cars behind each other that are taken for one object pass
us one after the other.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled, compiled_for
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.objects.joint_states import JointStates
from ttcvid.stages.objects.paper_track_states import TrackStates, nothing_shared
from ttcvid.stages.tracking.groups import TrackSets

# Tracks within this part (natural logarithm) of the depth of the nearest surface belong to the near face; a less
# certain one may, within two standard deviations.
_ONE_DEPTH, _SURELY = 0.12, 2.0
# Minimum number of tracks of a near face; and where only certain ones count, so many, and this part of all that may
# belong to it.
_LEAST_TRACKS, _LEAST_KNOWN, _KNOWN_PART = 3, 5, 0.5
# Least rate, 1/s.
_TINY = 1e-12


def front_boxes(members: TrackSets, joint: JointStates, states: TrackStates, xy_px: Floats) -> Floats:
    """Least x and y, greatest x and y, px, of the tracks of each of K surfaces' owners that are as near: (K, 4).

    The whole of what has too few such tracks to show sides: its nearest part may lie where it has none.

    All points of a thing share its velocity, so that the rates speed / Z of its tracks tell how deep each lies; so they
    do the errors of their path, which make no track nearer than another.

    Parameters
    ----------
    members : tracks of the N objects, ``joint.owner (K,)`` among them.
    """
    boxes = members.boxes(xy_px)[joint.owner]
    rate_hz = np.linalg.norm(joint.abc_hz, axis=1)
    first, last = members.first[joint.owner], members.first[joint.owner] + members.lengths[joint.owner]
    shared = nothing_shared(len(states.xy)) if states.shared is None else states.shared
    _fill_fronts(
        members.index,
        (first, last),
        rate_hz,
        states.has_value,
        (states.abc_hz, states.cov),
        (shared.path_of, shared.rate_hz, shared.rate_variance),
        np.ascontiguousarray(xy_px),
        boxes,
    )
    return boxes


@compiled_for(
    "(i8[::1], UniTuple(i8[::1], 2), f8[::1], b1[::1], Tuple((f8[:, ::1], f8[:, :, ::1])), "
    "Tuple((i8[::1], f8[::1], f8[::1])), f8[:, ::1], f8[:, ::1])"
)
def _fill_fronts(
    index: Ints,
    reach: tuple[Ints, Ints],
    rate_hz: Floats,
    has_value: Bools,
    state: tuple[Floats, Floats],
    shared: tuple[Ints, Floats, Floats],
    xy: Floats,
    boxes: Floats,
) -> None:
    """Fills ``boxes (K, 4)``, which come as those of the owners.

    ``reach`` are the first and last places in ``index`` of the owner of each surface.
    """
    abc_hz, cov = state
    path_of, path_rate_hz, path_variance = shared
    known, near = np.empty(4), np.empty(4)
    for k in range(len(rate_hz)):
        n_known, n_near = 0, 0
        known[:2], known[2:], near[:2], near[2:] = np.inf, -np.inf, np.inf, -np.inf
        for place in range(reach[0][k], reach[1][k]):
            i = index[place]
            if not has_value[i]:
                continue
            square, variance = 0.0, 0.0
            for a in range(3):
                square += abc_hz[i, a] * abc_hz[i, a]
                for b in range(3):
                    variance += abc_hz[i, a] * cov[i, a, b] * abc_hz[i, b]
            # Over the rate.
            sigma = np.sqrt(variance) / max(square, _TINY)
            if path_of[i] >= 0:
                sigma = np.sqrt(path_variance[i]) / max(abs(path_rate_hz[i]), _TINY)
            off = abs(0.5 * np.log(max(square, _TINY)) - np.log(rate_hz[k]))
            if off < _ONE_DEPTH + _SURELY * sigma:
                n_near += 1
                _take_in(near, xy[i, 0], xy[i, 1])
            if off < _ONE_DEPTH and _SURELY * sigma < _ONE_DEPTH:
                n_known += 1
                _take_in(known, xy[i, 0], xy[i, 1])
        if n_known >= max(_LEAST_KNOWN, _KNOWN_PART * n_near):
            boxes[k] = known
        elif n_near >= _LEAST_TRACKS:
            boxes[k] = near


@compiled
def _take_in(box: Floats, x: float, y: float) -> None:
    """Widen ``box (4,)`` to hold a place."""
    box[0], box[1], box[2], box[3] = min(box[0], x), min(box[1], y), max(box[2], x), max(box[3], y)
