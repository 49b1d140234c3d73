"""Flow and direction of every track over its own gap, for the paper's estimators."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.config import CollisionTimesConfig
from ttcvid.geometry.compiled import compiled_for
from ttcvid.model import NO_CLUSTER, SCENE_CLUSTER, Floats, Ints, Status
from ttcvid.stages.egomotion.flows import Flows, scene_directions, select_flows
from ttcvid.stages.egomotion.relative_pose import DIRECTION_FLOOR_RAD
from ttcvid.stages.horizon.planar_motion import HorizonPlane, planar_directions
from ttcvid.stages.objects.motions import FrameMotions
from ttcvid.stages.tracking.history import TrackHistory


@dataclass(frozen=True)
class TrackDirections:
    """``direction (N, 3)`` with ``covariance (N, 3, 3)`` is ``dir`` of each track over its flow, NaN where it has none.

    ``status (N,)`` says why it has none.
    """

    flows: Flows
    direction: Floats
    covariance: Floats
    status: Ints


def track_directions(
    history: TrackHistory, motions: FrameMotions, plane: HorizonPlane | None, config: CollisionTimesConfig
) -> TrackDirections:
    """Each track's direction: its cluster's, or with a horizon its own."""
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
    # The scene's direction has changed over a gap; with a horizon the present one, corrected, stands for all.
    is_followed = plane is None and np.isfinite(ways[:, 0]) & (ids == SCENE_CLUSTER)
    _take_over(place, ways, covs, along_scene, int(np.argmax(is_followed)), direction, covariance)
    return TrackDirections(flows, direction, covariance, status)


@compiled_for("(i8[::1], f8[:, ::1], f8[:, :, ::1], f8[:, ::1], i8, f8[:, ::1], f8[:, :, ::1])")
def _take_over(
    place: Ints,
    ways: Floats,
    covs: Floats,
    along_scene: Floats,
    followed: int,
    direction: Floats,
    covariance: Floats,
) -> None:
    """Fill what each of N tracks takes from its cluster, at ``place (N,)`` of those of K + 1 rows; 0 is no cluster.

    Those at the place ``followed`` take directions of their own, ``along_scene (N, 3)``; 0: none do.
    """
    for i in range(len(place)):
        k = place[i]
        if k == 0:
            continue
        for a in range(3):
            direction[i, a] = along_scene[i, a] if k == followed else ways[k, a]
            for b in range(3):
                covariance[i, a, b] = covs[k, a, b]
