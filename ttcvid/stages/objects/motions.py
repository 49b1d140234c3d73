"""The motions of a frame: the scene's, and those of the movers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from ttcvid.config import PipelineConfig
from ttcvid.geometry.estimation.rigid_motion import RigidPaths
from ttcvid.geometry.paper.epipole import MAX_DIRECTION_SIGMA_RAD
from ttcvid.geometry.quotient import quotient
from ttcvid.geometry.rotation import skew
from ttcvid.model import NO_CLUSTER, SCENE_CLUSTER, Bools, Camera, Floats, ImageSize, Ints, Platform, Status
from ttcvid.stages.egomotion.relative_pose import Egomotion
from ttcvid.stages.horizon.planar_motion import HorizonPlane
from ttcvid.stages.objects.clusters import ClusterMotion
from ttcvid.stages.objects.surface_motions import growing_things, in_our_way, on_plane, road_at_own_speed
from ttcvid.stages.segmentation.bodies import direction_of_last_step
from ttcvid.stages.segmentation.body_views import WORST_REDCHI, body_views
from ttcvid.stages.segmentation.data_association import numbers_of
from ttcvid.stages.segmentation.labels import BodyMemory, Segmentation, find_bodies
from ttcvid.stages.segmentation.last_known import UNSURE_HZ
from ttcvid.stages.segmentation.own_turn import OwnBend, own_bend
from ttcvid.stages.tracking.history import TrackHistory, without_displaced

# Tracks of one object hang together when they lie closer than this part of the picture's longer side.
# Where few tracks are given they lie farther apart: random points hang together from 1.2 times their spacing on
# (percolation of discs, sqrt(4.51 / pi)). Nothing is a neighbour beyond so many times the first distance.
_LINK_PART, _SPARSE_LINK, _MOST_LINK = 0.05, 1.2, 2.0
# A velocity over its noise along itself, at 95 %, has a direction: what heads for us is well known across.
_NO_DIRECTION_CHI2 = float(chdtri(1, 0.05))
NO_MOTION_CHI2 = float(chdtri(3, 0.05))
"""A velocity may be zero inside 95 % of a 3-D Gaussian."""


@dataclass(frozen=True)
class FrameMotions:
    """What of the N live tracks moves together.

    ``cluster_id (N,)``, and ``no_direction_status (N,)`` why that has no direction, where it has none; ``clusters`` the
    scene first, then the movers; ``link_px`` the distance within which tracks hang together; ``is_free (N,)`` tracks
    not frozen to their pixel; ``bend`` how we drive along a road, None where we do not, or that is not known.
    What is displaced, a single false observation, is of no cluster, and not rigid.
    """

    cluster_id: Ints
    no_direction_status: Ints
    clusters: tuple[ClusterMotion, ...]
    link_px: float
    is_free: Bools
    bend: OwnBend | None = None


def _link_px(size: ImageSize, n_tracks: int) -> float:
    """Distance within which two of ``n_tracks`` spread over a picture are neighbours."""
    spacing_px = math.sqrt(size.width_px * size.height_px / max(n_tracks, 1))
    least_px = _LINK_PART * size.longer_side_px
    return float(np.clip(_SPARSE_LINK * spacing_px, least_px, _MOST_LINK * least_px))


def find_motions(
    history: TrackHistory,
    egomotion: Egomotion | None,
    is_free: Bools,
    may_start: Bools,
    memory: BodyMemory,
    plane: HorizonPlane | None,
    camera: Camera,
    config: PipelineConfig,
) -> tuple[FrameMotions, TrackHistory, BodyMemory]:
    """Which tracks move with the scene, which in bodies of their own, and in what direction.

    Tracks ``is_free (N,)`` are not frozen to their pixel; those of ``may_start (N,)`` do not look like becoming so,
    either: a new mover may start from them. The history comes back with the past rotations as the scene's tracks
    correct them.
    """
    link_px = _link_px(camera.image_size, int(is_free.sum()))
    in_scene, objects, bend = is_free, list[ClusterMotion](), None
    is_displaced = np.zeros(history.n_tracks, dtype=bool)
    if egomotion is not None:
        can_translate = config.egomotion.platform != Platform.static
        views = body_views(history, is_free, link_px, can_translate=can_translate)
        found, memory = find_bodies(
            history, views, egomotion, config.egomotion.platform, may_start, memory, config.bodies
        )
        history = replace(history, cam_R_past=found.seen.scene.cam_R_past[0])
        history = without_displaced(history, found.is_displaced, found.is_past_off)
        is_displaced, is_free = found.is_displaced, is_free & ~found.is_displaced
        in_scene = (found.key == SCENE_CLUSTER) & is_free & (found.seen.redchi < WORST_REDCHI)
        objects = _object_motions(history, found, is_free, plane, camera)
        surfaces = list[ClusterMotion]()
        if config.egomotion.platform == Platform.aircraft:
            surfaces, memory = growing_things(history, views, found, is_free, memory, config)
        is_left = is_free.copy()
        for surface in surfaces:
            is_left[surface.members] = False
        obstacles, memory = in_our_way(history, egomotion, found, is_left, memory, link_px, config)
        surfaces = [on_plane(one, plane, camera) for one in [*surfaces, *obstacles]]
        if config.egomotion.platform == Platform.vehicle:
            bend = own_bend(history, egomotion.direction, road_at_own_speed(memory, found, history))
        objects = sorted([*objects, *surfaces], key=lambda motion: motion.cluster_id)
        for surface in surfaces:
            in_scene[surface.members] = False
        egomotion = _with_direction_of_last_step(egomotion, found.seen.scene, history.since_s)
    scene = scene_motion(np.flatnonzero(in_scene), egomotion, plane, camera)
    clusters = tuple(([scene] if len(scene.members) else []) + objects)
    motions = replace(_assigned(clusters, is_free, is_displaced, link_px), bend=bend)
    return motions, history, memory


def _with_direction_of_last_step(egomotion: Egomotion, scene: RigidPaths, since_s: Floats) -> Egomotion:
    """Own motion with the direction of the last step, by the scene's whole tracks, instead of the mean over a gap.

    A camera that sways leaves the mean by 5 deg within 0.2 s.
    """
    if egomotion.direction is None or egomotion.direction_cov is None or egomotion.gap_frames == 1:
        return egomotion
    found = direction_of_last_step(scene.path[0], since_s)
    if found is None:
        return egomotion
    direction, cov = found
    across = np.eye(3) - np.outer(direction, direction)
    # The views do not tell what errs in all of them alike: two views know that at least as badly.
    return replace(egomotion, direction=direction, direction_cov=cov + across @ egomotion.direction_cov @ across)


def _object_motions(
    history: TrackHistory, found: Segmentation, is_free: Bools, plane: HorizonPlane | None, camera: Camera
) -> list[ClusterMotion]:
    """The movers that have a public number, each with the direction of the velocity that its tracks share.

    The search for the trajectory that gives its times starts from there (`track_states`).
    """
    movers, number = found.movers, numbers_of(found.key, found.movers)
    cluster_id, n_bodies = np.append(NO_CLUSTER, movers.cluster_id), len(movers) + 1
    # What is frozen to its pixels is burned-in text, and so is the rest of a mover that mostly is.
    is_text = np.bincount(number, ~is_free, n_bodies) > 0.5 * np.bincount(number, minlength=n_bodies)
    members = np.flatnonzero(((cluster_id > 0) & ~is_text)[number] & is_free)
    body = np.flatnonzero(np.bincount(number[members], minlength=n_bodies))
    parts = {int(cluster_id[k]): members[number[members] == k] for k in body}
    velocity_hz, info = movers.last.v_hz[body - 1], movers.last.info[body - 1] / found.seen.median_redchi
    return motions_of(parts, velocity_hz, info, history, plane, camera)


def motions_of(
    members: Mapping[int, Ints],
    velocity_hz: Floats,
    info: Floats,
    history: TrackHistory,
    plane: HorizonPlane | None,
    camera: Camera,
) -> list[ClusterMotion]:
    """The motion of each of K movers, their tracks given by ``cluster_id``.

    By the velocity V / Z of each, ``velocity_hz (K, 3)`` in 1/s, and its information matrix ``info (K, 3, 3)``. One
    whose velocity is within its noise has no direction.
    """
    direction, cov = _directions(velocity_hz, info, history, list(members.values()))
    motions = []
    for (cluster_id, index), way, cov_of_way in zip(members.items(), direction, cov, strict=True):
        motion = ClusterMotion(cluster_id, index, None, None, Status.no_parallax, "whole-tracks")
        if np.isfinite(way[0]):
            motion = on_plane(replace(motion, direction=way, direction_cov=cov_of_way), plane, camera)
        motions.append(motion)
    return motions


def _directions(
    velocity_hz: Floats, info: Floats, history: TrackHistory, members: Sequence[Ints]
) -> tuple[Floats, Floats]:
    """The directions (K, 3) of the velocities of K movers, and their covariances (K, 3, 3); NaN where one is unknown.

    As if each moved at constant velocity: how it changes its speed its trajectory will tell (`turning`). All tracks of
    a mover err alike by a rotation left in them.
    """
    if not members:
        return np.empty((0, 3)), np.empty((0, 3, 3))
    # Where a track is not seen its place is not known.
    places = (history.xy[history.now, index] for index in members)
    middle = np.array([np.nansum(xy, axis=0) / max(np.count_nonzero(np.isfinite(xy[:, 0])), 1) for xy in places])
    ray = np.column_stack([middle, np.ones(len(middle))])
    turn = history.rotation_rate_sigma_rad_s * skew(ray)
    own = np.linalg.inv(info + np.eye(3) / UNSURE_HZ**2) + turn @ turn.transpose(0, 2, 1)
    speed_hz = np.linalg.norm(velocity_hz, axis=1)[:, None]
    direction = quotient(velocity_hz, speed_hz)
    across = (np.eye(3) - direction[:, :, None] * direction[:, None, :]) / speed_hz[:, :, None]
    cov = across @ own @ across
    moves = speed_hz[:, 0] ** 2 > _NO_DIRECTION_CHI2 * np.einsum("ki,kij,kj->k", direction, own, direction)
    is_known = moves & (np.trace(cov, axis1=1, axis2=2) < MAX_DIRECTION_SIGMA_RAD**2)
    direction[~is_known] = np.nan
    return direction, cov


def scene_motion(
    members: Ints, egomotion: Egomotion | None, plane: HorizonPlane | None, camera: Camera
) -> ClusterMotion:
    """The motion of the scene's tracks ``members``: that of the camera, seen the other way round."""
    if egomotion is None or egomotion.direction is None or egomotion.direction_cov is None or not egomotion.is_told:
        status = Status.no_epipole if egomotion is None else Status.no_parallax
        return ClusterMotion(SCENE_CLUSTER, members, None, None, status, "egomotion")
    direction, covariance = egomotion.direction, egomotion.direction_cov
    return on_plane(ClusterMotion(SCENE_CLUSTER, members, direction, covariance, Status.ok, "egomotion"), plane, camera)


def _assigned(clusters: tuple[ClusterMotion, ...], is_free: Bools, is_displaced: Bools, link_px: float) -> FrameMotions:
    """The cluster of each track, and why it has no direction where that has none."""
    cluster_id = np.full(len(is_free), NO_CLUSTER, dtype=np.int64)
    status = np.full(len(is_free), Status.no_epipole, dtype=np.int64)
    status[~is_free] = Status.no_parallax
    status[is_displaced] = Status.not_rigid
    for motion in clusters:
        cluster_id[motion.members], status[motion.members] = motion.cluster_id, motion.status
    return FrameMotions(cluster_id, status, clusters, link_px, is_free)
