"""The near face of each object: what is seen of it at the depth of its nearest surface.

A car in a bend shows its side, which follows its front; and cars behind each other that are taken for one object pass
us one after the other.
"""

from __future__ import annotations

import numpy as np

from ttcvid.model import Floats
from ttcvid.stages.objects.joint_states import JointStates, own_rates
from ttcvid.stages.objects.states import TrackStates
from ttcvid.stages.tracking.groups import TrackSets

# Tracks within this part (natural logarithm) of the depth of the nearest surface belong to the near face; a less
# certain one may, within two standard deviations.
_ONE_DEPTH, _SURELY = 0.12, 2.0
# Minimum number of tracks of a near face; and where only certain ones count, so many, and this part of all that may
# belong to it.
_LEAST_TRACKS, _LEAST_KNOWN, _KNOWN_PART = 3, 5, 0.5
# Least rate, 1/s.
_TINY = 1e-12


def front_boxes(members: TrackSets, whole_px: Floats, joint: JointStates, states: TrackStates, xy_px: Floats) -> Floats:
    """Least x and y, greatest x and y, px, of the tracks of each of K surfaces' owners that are as near: (K, 4).

    The whole of what has too few such tracks to show sides: its nearest part may lie where it has none.

    All points of a thing share its velocity, so that the rates speed / Z of its tracks tell how deep each lies; so they
    do the errors of their path, which make no track nearer than another. ``members`` are the tracks of all objects,
    ``whole_px (J, 4)`` their boxes, and ``joint.owner (K,)`` those with a surface.
    """
    has_surface = np.zeros(len(members), dtype=bool)
    has_surface[joint.owner] = True
    # Those of each surface's owner, in the order of the surfaces.
    tracks, _ = members.where(states.has_value[members.index] & has_surface[members.set_of])
    abc_hz = states.abc_hz[tracks.index]
    rate_hz = np.linalg.norm(abc_hz, axis=1)
    surface_hz = np.linalg.norm(joint.abc_hz, axis=1)[tracks.set_of]
    off = np.abs(np.log(np.maximum(rate_hz, _TINY) / surface_hz))
    # By what is each track's own.
    own_hz, sigma_hz = own_rates(tracks.index, abc_hz / np.maximum(rate_hz, _TINY)[:, None], states)
    sigma = sigma_hz / np.maximum(np.abs(own_hz), _TINY)
    is_near = off < _ONE_DEPTH + _SURELY * sigma
    is_known = (off < _ONE_DEPTH) & (_SURELY * sigma < _ONE_DEPTH)
    n_near, n_known = (np.bincount(tracks.set_of[which], minlength=len(tracks)) for which in (is_near, is_known))
    are_known_enough = n_known >= np.maximum(_LEAST_KNOWN, _KNOWN_PART * n_near)
    has_face = are_known_enough | (n_near >= _LEAST_TRACKS)
    faces, left = tracks.where(np.where(are_known_enough[tracks.set_of], is_known, is_near) & has_face[tracks.set_of])
    boxes = whole_px[joint.owner]
    boxes[left] = faces.boxes(xy_px)
    return boxes
