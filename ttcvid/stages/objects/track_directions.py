"""Flow and direction of every track over its own gap, for the paper's estimators."""

from __future__ import annotations

import numpy as np

from ttcvid.config import CollisionTimesConfig
from ttcvid.model import NO_CLUSTER, SCENE_CLUSTER, Floats, Ints, Status
from ttcvid.stages.egomotion.flows import Flows, scene_directions, select_flows
from ttcvid.stages.egomotion.relative_pose import DIRECTION_FLOOR_RAD
from ttcvid.stages.horizon.planar_motion import HorizonPlane, planar_directions
from ttcvid.stages.objects.motions import FrameMotions
from ttcvid.stages.tracking.history import TrackHistory


def track_directions(
    history: TrackHistory, motions: FrameMotions, plane: HorizonPlane | None, config: CollisionTimesConfig
) -> tuple[Flows, Floats, Floats, Ints]:
    """Each track's flow, and its ``dir`` over that: its cluster's, or with a horizon its own.

    Of the directions ``(N, 3)``, NaN where there is none, also the covariances ``(N, 3, 3)``, and why there is none.
    """
    flows, clusters = select_flows(history, config.max_gap_frames, config.target_flow_px), motions.clusters
    along_scene, n = scene_directions(history, flows), history.n_tracks
    direction, covariance = np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan)
    status = np.full(n, Status.no_epipole, dtype=np.int64)
    if plane is not None:
        direction, covariance, status = planar_directions(flows, plane)
    status[~motions.is_free] = Status.no_parallax
    direction[~motions.is_free] = np.nan
    # Which of the clusters each track is in, and what it takes from there: the first stands for none of them.
    place, ids = np.zeros(n, dtype=np.int64), np.full(len(clusters) + 1, NO_CLUSTER)
    ways, covs = np.full((len(clusters) + 1, 3), np.nan), np.full((len(clusters) + 1, 3, 3), np.nan)
    for number, motion in enumerate(clusters, start=1):
        place[motion.members], ids[number] = number, motion.cluster_id
        status[motion.members] = motion.status
        way, cov = motion.direction, motion.direction_cov
        if way is not None and cov is not None:
            ways[number], covs[number] = way, cov
            if motion.cluster_id == SCENE_CLUSTER:
                covs[number] += DIRECTION_FLOOR_RAD**2 * (np.eye(3) - np.outer(way, way))
    taken = place > 0
    direction[taken], covariance[taken] = ways[place[taken]], covs[place[taken]]
    # The scene's direction has changed over a gap; with a horizon the present one, corrected, stands for all.
    is_followed = (plane is None) & np.isfinite(ways[:, 0]) & (ids == SCENE_CLUSTER)
    in_scene = is_followed[place]
    direction[in_scene] = along_scene[in_scene]
    return flows, direction, covariance, status
