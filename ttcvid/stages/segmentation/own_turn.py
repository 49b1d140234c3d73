"""Our own motion along a bend: heading, speed and turn rate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.geometry.along_bend import share_of_bend
from ttcvid.geometry.rotation import vector_from_rotation
from ttcvid.model import Floats
from ttcvid.stages.segmentation.road import LEAST_BELOW, Road
from ttcvid.stages.tracking.history import TrackHistory

# The turn is that of so long, s: steps of a car's wheels and of matching are gone by then, a bend has hardly changed.
_TURN_S = 0.5


@dataclass(frozen=True)
class OwnBend:
    """Where we drive, ``heading (3,)``, and how fast we turn to the right, but for steering to and fro.

    ``road`` with inverse depths in units of our present speed; None without one.
    """

    heading: Floats
    turn_rad_s: float
    road: Road | None

    def speed_hz(self, foot: Floats) -> float | None:
        """Our speed over the depth of what stands on the road where its ``foot`` (x, y) is seen; None: not known."""
        if self.road is None:
            return None
        speed_hz = float(self.road.rate_hz(foot))
        return speed_hz if speed_hz > LEAST_BELOW * self.road.slope_hz else None


def own_bend(history: TrackHistory, direction: Floats | None, road: Road | None) -> OwnBend | None:
    """The bend that we drive along, by ``dir`` of the scene, ``direction (3,)``, and ``road`` as of `OwnBend`.

    None where we do not drive ahead, or that has not been seen for long enough.
    """
    if direction is None or not direction[2] < 0.0:
        return None
    first = int(np.searchsorted(history.since_s, -_TURN_S, side="right")) - 1
    if first < 0:
        return None
    # What we turn away from goes to the other side.
    turn_rad_s = float(vector_from_rotation(history.cam_R_seen[first])[1] / history.since_s[first])
    return OwnBend(-direction, share_of_bend(turn_rad_s) * turn_rad_s, road)
