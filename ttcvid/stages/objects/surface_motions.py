"""Objects that are found as one surface: what of the scene stands in our way, and what comes straight at us."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ttcvid.config import PipelineConfig
from ttcvid.geometry.paper.epipole import INFINITY_COSINE
from ttcvid.geometry.rotation import normalize
from ttcvid.model import SCENE_CLUSTER, Bools, Camera, Platform, Status
from ttcvid.stages.egomotion.relative_pose import Egomotion
from ttcvid.stages.horizon.planar_motion import HorizonPlane, horizon_offset, horizon_offset_px, onto_horizon
from ttcvid.stages.objects.clusters import ON_HORIZON, ClusterMotion
from ttcvid.stages.segmentation.body_views import BodyViews
from ttcvid.stages.segmentation.expansion import find_growing
from ttcvid.stages.segmentation.labels import BodyMemory, Segmentation
from ttcvid.stages.segmentation.obstacles import StaticPoints, find_obstacles, own_path
from ttcvid.stages.segmentation.road import Road, RoadPoints, find_road
from ttcvid.stages.tracking.history import TrackHistory

# The direction of the scene's path, where that of the last step is not known.
_WAY_SIGMA_RAD = float(np.radians(0.5))


def in_our_way(
    history: TrackHistory,
    egomotion: Egomotion,
    found: Segmentation,
    is_free: Bools,
    memory: BodyMemory,
    link_px: float,
    config: PipelineConfig,
) -> tuple[list[ClusterMotion], BodyMemory]:
    """What of the scene stands in our way, as objects that move as the scene does; and the memory with them."""
    way = own_path(found.seen.scene.path[0], history.since_s)
    in_scene = (found.key == SCENE_CLUSTER) & is_free & (found.seen.redchi < config.bodies.scene_gate)
    platform = config.egomotion.platform
    road = memory.road.road
    if platform == Platform.free and way is not None:
        # We may well be on a road, or low over the ground.
        now_s = float(history.t_s[-1])
        road = find_road(RoadPoints.of(found.seen.fit, in_scene, way.aim, history.track_id, now_s), way.aim)
    seen = StaticPoints(history.track_id, history.xy_px, history.focal_px, link_px, found.seen.fit, in_scene)
    before, number, on_ground = memory.obstacles, memory.next_cluster_id, platform == Platform.vehicle
    public, obstacles, next_id = find_obstacles(before, seen, way, road, number, config.bodies, on_ground=on_ground)
    memory = replace(memory, obstacles=obstacles, next_cluster_id=next_id)
    if way is None:
        return [], memory
    direction, covariance = egomotion.direction, egomotion.direction_cov
    if direction is None or covariance is None or not egomotion.is_told:
        # It is not known by itself, but roughly by all views of the scene.
        direction = -normalize(np.append(way.aim, 1.0)[None])[0]
        covariance = _WAY_SIGMA_RAD**2 * (np.eye(3) - np.outer(direction, direction))
    motions = [
        ClusterMotion(
            number, members, direction, covariance, Status.ok, "egomotion", is_static=True, is_one_surface=True
        )
        for number, members in public.items()
    ]
    return motions, memory


def road_at_own_speed(memory: BodyMemory, found: Segmentation, history: TrackHistory) -> Road | None:
    """The road with inverse depths in units of our present speed; None without one."""
    way = own_path(found.seen.scene.path[0], history.since_s)
    return None if way is None or memory.road.road is None else memory.road.road.at_speed(way.speed)


def growing_things(
    history: TrackHistory,
    views: BodyViews,
    found: Segmentation,
    is_free: Bools,
    memory: BodyMemory,
    config: PipelineConfig,
) -> tuple[list[ClusterMotion], BodyMemory]:
    """What comes straight at us on a way of its own, as objects; and the memory with them."""
    on_scene = found.seen.redchi, found.seen.median_redchi, (found.key == SCENE_CLUSTER) & is_free
    # Of the displaced observations those of earlier views are taken out by now.
    views = replace(views, rays=history.rays)
    before, number, how = memory.growing, memory.next_cluster_id, (Status.ok, "whole-tracks")
    public, growing, next_id = find_growing(before, history, *on_scene, views, number, config.bodies)
    motions = [
        ClusterMotion(number, one.members, one.direction, one.direction_cov, *how, is_one_surface=True)
        for number, one in public.items()
    ]
    return motions, replace(memory, growing=growing, next_cluster_id=next_id)


def on_plane(motion: ClusterMotion, plane: HorizonPlane | None, camera: Camera) -> ClusterMotion:
    """A motion with a direction as found, or moved onto the horizon with the offset noted; with the status of that."""
    direction, covariance = motion.direction, motion.direction_cov
    if direction is None or covariance is None:
        return motion
    if plane is not None:
        motion = replace(
            motion,
            method=motion.method + ON_HORIZON,
            horizon_offset_px=horizon_offset_px(direction, plane, camera),
            horizon_offset=horizon_offset(direction, covariance, plane),
        )
        direction, covariance = onto_horizon(direction, covariance, plane)
    status = Status.epipole_at_infinity if abs(direction[2]) < INFINITY_COSINE else Status.ok
    return replace(motion, direction=direction, direction_cov=covariance, status=status)
