"""The motions of a frame: the scene's, those of the groups, and the direction that each track takes from them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.config import PipelineConfig
from ttcvid.geometry.chi_square import chi2_quantile
from ttcvid.geometry.epipole import INFINITY_COSINE, direction_chi2
from ttcvid.model import NO_CLUSTER, SCENE_CLUSTER, Bools, Camera, Floats, Ints, Status
from ttcvid.stages.clusters import ClusterMotion
from ttcvid.stages.egomotion import Egomotion
from ttcvid.stages.flows import Flows, scene_directions, select_flows
from ttcvid.stages.group_identity import GroupMemory, former_groups, named
from ttcvid.stages.history import TrackHistory
from ttcvid.stages.motion_groups import MotionGroup, find_motion_groups
from ttcvid.stages.planar import HorizonPlane, horizon_offset_px, onto_horizon, planar_directions
from ttcvid.stages.scene import DIRECTION_FLOOR_RAD, moves_with_scene

# A group's direction is the scene's inside 99 % of a 2-D Gaussian.
_SCENE_DIRECTION_CHI2 = 9.21
# Tracks of one object hang together when they lie closer than this part of the picture's width.
_LINK_PART = 0.05


@dataclass(frozen=True)
class FrameMotions:
    """Flows of the N live tracks and what moves together.

    ``cluster_id (N,)``; ``direction (N, 3)`` with ``direction_cov (N, 3, 3)`` each track's ``dir`` over its own gap,
    NaN where it has none, and ``no_direction_status (N,)`` why; ``clusters`` the scene first, then the groups;
    ``link_px`` the distance within which tracks hang together; ``is_free (N,)`` tracks not frozen to their pixel.
    """

    flows: Flows
    cluster_id: Ints
    direction: Floats
    direction_cov: Floats
    no_direction_status: Ints
    clusters: tuple[ClusterMotion, ...]
    link_px: float
    is_free: Bools


def find_motions(
    history: TrackHistory,
    egomotion: Egomotion | None,
    is_free: Bools,
    memory: GroupMemory,
    plane: HorizonPlane | None,
    still_px: float,
    camera: Camera,
    rng: np.random.Generator,
    config: PipelineConfig,
) -> tuple[FrameMotions, GroupMemory]:
    """Which tracks move with the scene, which in groups of their own, and in what direction.

    Parameters
    ----------
    is_free : (N,) tracks that are not frozen to their pixel.
    still_px : flow of one step that counts as none, however small the noise.
    """
    times, gate = config.collision_times, float(chi2_quantile(config.egomotion.gate_probability, 1))
    flows = select_flows(history, times.max_gap_frames, times.target_flow_px)
    link_px = _LINK_PART * camera.image_size.width_px
    along_scene = scene_directions(history, flows)
    scene_cov = None if egomotion is None else egomotion.direction_cov
    with_scene = is_free & moves_with_scene(flows, along_scene, scene_cov, gate, still_px / history.focal_px)
    groups: list[MotionGroup] = []
    names: list[int | None] = []
    if egomotion is not None:
        former = former_groups(memory, history.track_id, egomotion.cam_R_prev)
        is_candidate = is_free & ~with_scene
        groups = find_motion_groups(flows, history.xy_px, is_candidate, link_px, former, rng, config.motion_groups)
        groups = [group for group in groups if not _has_scene_direction(group, egomotion)]
        names, memory = named(groups, history.track_id, memory, egomotion.cam_R_prev)
    scene = _scene_motion(np.flatnonzero(with_scene), egomotion, plane, camera)
    objects = [
        _group_motion(name, group, plane, camera)
        for name, group in sorted(zip(names, groups, strict=True), key=lambda pair: pair[0] or 0)
        if name is not None
    ]
    clusters = tuple(([scene] if len(scene.members) else []) + objects)
    return _assigned(flows, along_scene, clusters, plane, is_free, link_px), memory


def _has_scene_direction(group: MotionGroup, egomotion: Egomotion) -> bool:
    """Whether a group cannot be told from static points that were badly followed.

    Leaves before the sky and edges that slide go astray together. Their flow lines miss the scene's epipole one by
    one, but the direction that they share lies on it within its uncertainty: no object, and not fit for the scene.
    """
    if group.status == Status.no_epipole:
        return False
    if egomotion.direction is None or egomotion.direction_cov is None:
        return False
    covariance = group.direction_cov + egomotion.direction_cov
    difference = direction_chi2(egomotion.direction, group.direction, covariance, DIRECTION_FLOOR_RAD)
    return difference < _SCENE_DIRECTION_CHI2


def _scene_motion(
    members: Ints, egomotion: Egomotion | None, plane: HorizonPlane | None, camera: Camera
) -> ClusterMotion:
    if egomotion is None or egomotion.direction is None or egomotion.direction_cov is None:
        status = Status.no_epipole if egomotion is None else Status.no_parallax
        return ClusterMotion(SCENE_CLUSTER, members, None, None, status, "egomotion")
    return _on_plane(SCENE_CLUSTER, members, egomotion.direction, egomotion.direction_cov, "egomotion", plane, camera)


def _group_motion(cluster_id: int, group: MotionGroup, plane: HorizonPlane | None, camera: Camera) -> ClusterMotion:
    if group.status == Status.no_epipole:
        return ClusterMotion(cluster_id, group.members, None, None, group.status, "consensus")
    return _on_plane(cluster_id, group.members, group.direction, group.direction_cov, "consensus", plane, camera)


def _on_plane(
    cluster_id: int,
    members: Ints,
    direction: Floats,
    covariance: Floats,
    method: str,
    plane: HorizonPlane | None,
    camera: Camera,
) -> ClusterMotion:
    """The motion as found, or moved onto the horizon with the offset noted."""
    offset_px = None
    if plane is not None:
        offset_px = horizon_offset_px(direction, plane, camera)
        direction, covariance = onto_horizon(direction, covariance, plane)
        method = f"{method}+horizon"
    status = Status.epipole_at_infinity if abs(direction[2]) < INFINITY_COSINE else Status.ok
    return ClusterMotion(cluster_id, members, direction, covariance, status, method, offset_px)


def _assigned(
    flows: Flows,
    along_scene: Floats,
    clusters: tuple[ClusterMotion, ...],
    plane: HorizonPlane | None,
    is_free: Bools,
    link_px: float,
) -> FrameMotions:
    """Each track's direction: its cluster's, or with a horizon its own."""
    n = len(flows.gap_s)
    cluster_id = np.full(n, NO_CLUSTER, dtype=np.int64)
    direction, covariance = np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan)
    status = np.full(n, Status.no_epipole, dtype=np.int64)
    if plane is not None:
        direction, covariance, status = planar_directions(flows, plane)
    status[~is_free] = Status.no_parallax
    direction[~is_free] = np.nan
    for motion in clusters:
        cluster_id[motion.members] = motion.cluster_id
        status[motion.members] = motion.status
        direction[motion.members] = np.nan if motion.direction is None else motion.direction
        covariance[motion.members] = np.nan if motion.direction_cov is None else motion.direction_cov
        if motion.cluster_id == SCENE_CLUSTER and motion.direction is not None:
            # The scene's direction has changed over a gap; with a horizon the present one, corrected, stands for all.
            if plane is None:
                direction[motion.members] = along_scene[motion.members]
            covariance[motion.members] += DIRECTION_FLOOR_RAD**2 * (
                np.eye(3) - np.outer(motion.direction, motion.direction)
            )
    return FrameMotions(flows, cluster_id, direction, covariance, status, clusters, link_px, is_free)
