"""Which object is reached first, of those with a credible approach.

A minimum over many objects in many frames finds whatever has the largest error: a handful of points that were grouped a
moment ago. An approach is credible once its whole 90 % interval has approached in each frame of the persistence, and it
has enough tracks to be a body.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from ttcvid.config import PipelineConfig
from ttcvid.model import APPROACHING, ClusterRow

_ROUNDING_S = 1e-9

Since = Mapping[int, float]
"""By ``cluster_id``: the time, s, since which each frame has said that the object approaches."""


def nearest_object(
    since: Since, t_s: float, clusters: tuple[ClusterRow, ...], config: PipelineConfig
) -> tuple[ClusterRow | None, Since]:
    """The object with the smallest time to depth zero among credible approaches, and what to remember.

    They last for ``events.persistence_s``, and have ``bodies.min_tracks`` tracks.
    """
    # Those that approach by their whole 90 % intervals.
    times = ((row, row.times) for row in clusters if row.motion_state in APPROACHING)
    surely = [row for row, one in times if 0.0 < one.ttc_z_lo_s[0] <= one.ttc_z_s[0] <= one.ttc_z_hi_s[0] < math.inf]
    now = {row.cluster_id: since.get(row.cluster_id, t_s) for row in surely}
    lasting_s, needed = config.events.persistence_s - _ROUNDING_S, config.bodies.min_tracks
    told = [row for row in surely if t_s - now[row.cluster_id] >= lasting_s and row.n_tracks >= needed]
    return min(told, key=lambda row: float(row.times.ttc_z_s[0]), default=None), now
