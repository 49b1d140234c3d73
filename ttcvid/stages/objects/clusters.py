"""Rows of clusters: epipole, state and times of the nearest surface, motion state, urgency."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ttcvid.geometry.camera.pinhole import pixels_from_rays, rays_from_pixels
from ttcvid.geometry.estimation.intervals import (
    collision_times_from_state,
    radial_and_transverse_rate,
    with_focal_interval,
)
from ttcvid.geometry.paper.epipole import INFINITY_COSINE, direction_chi2
from ttcvid.model import (
    APPROACHING,
    SCENE_CLUSTER,
    SCENE_MOTION,
    Bools,
    Camera,
    ClusterRow,
    Floats,
    HorizonOffset,
    Ints,
    MotionState,
    Status,
)
from ttcvid.stages.objects.joint_states import JointStates, joint_states
from ttcvid.stages.objects.near_face import front_boxes
from ttcvid.stages.objects.states import TrackStates
from ttcvid.stages.segmentation.common_errors import SIGMAS_999
from ttcvid.stages.tracking.groups import TrackSets

# Transverse motion is significant at 95 %. Its rate has two components: 95 % of a 2-D Gaussian, in sigmas.
_SIGMAS_95_OF_TWO = 2.45
# Two directions are equal if their difference is inside 99 % of a 2-D Gaussian.
_SAME_DIRECTION_CHI2 = 9.21
# Directions with a larger standard deviation are equal to none, rad.
_KNOWN_DIRECTION_RAD = float(np.radians(10.0))
# Statuses of clusters with a direction.
_VALUED = (Status.ok, Status.epipole_at_infinity)
# Statuses that leave open whether an object has a state.
_OPEN = (*_VALUED, Status.no_parallax)
# Noise of a point that is exact by definition.
_EXACT = 1e-12

ON_HORIZON = "+horizon"
"""End of the ``method`` of a direction that was moved onto the horizon."""


@dataclass(frozen=True)
class ClusterMotion:
    """A cluster before its state and times.

    cluster_id, status, method : as in the tables.
    members : ``(M,)`` indices of its tracks in the frame.
    direction, direction_cov : its ``dir`` ``(3,)`` and the covariance (3, 3), rad^2; None without one.
    horizon_offset_px, horizon_offset : offset of its epipole from the horizon before it was moved there, in px, and as
        an angle with its standard deviation.
    is_static : it moves with the scene (a standing obstacle).
    is_one_surface : it was found as one surface, and may have few tracks.
    """

    cluster_id: int
    members: Ints
    direction: Floats | None
    direction_cov: Floats | None
    status: Status
    method: str
    horizon_offset_px: float | None = None
    is_static: bool = False
    is_one_surface: bool = False
    horizon_offset: HorizonOffset | None = None

    @property
    def is_body(self) -> bool:
        """Whether it is a mover with a trajectory of its own, and not one surface in our way or of an aircraft."""
        return self.cluster_id != SCENE_CLUSTER and not self.is_one_surface


def surfaces_of(
    motions: Sequence[ClusterMotion], members: TrackSets, states: TrackStates, xy_px: Floats, link_px: float
) -> JointStates:
    """States of the nearest surfaces of the objects among K clusters. The scene has none: it has many depths.

    ``states, xy_px, link_px`` are of all tracks, as for `joint_states`.
    """
    believed, _ = _directions(motions)
    is_scene = np.array([motion.cluster_id == SCENE_CLUSTER for motion in motions], dtype=bool)
    is_one = np.array([motion.is_one_surface for motion in motions], dtype=bool)
    return joint_states(members, np.where(is_scene[:, None], np.nan, believed), is_one, states, xy_px, link_px)


def rows_of(
    motions: Sequence[ClusterMotion],
    members: TrackSets,
    joint: JointStates,
    states: TrackStates,
    xy_px: Floats,
    expansion_hz: Floats,
) -> list[ClusterRow]:
    """Rows of K clusters; those of objects have the state of their surface in ``joint``, and no times (`with_times`).

    ``states, xy_px`` are of all tracks, ``expansion_hz (K,)`` of each cluster, NaN where unknown.
    """
    direction, direction_cov = _directions(motions)
    status = [motion.status for motion in motions]
    if states.shared is not None:
        _take_directions_of_states(motions, joint, direction, direction_cov, status)
    is_ours = np.array([motion.cluster_id == SCENE_CLUSTER or motion.is_static for motion in motions], dtype=bool)
    numbers, boxes = motion_ids(is_ours, direction, direction_cov), members.boxes(xy_px)
    has_values = np.logical_or.reduceat(states.has_value[members.index], members.first).tolist()
    rows = [
        ClusterRow(
            cluster_id=motion.cluster_id,
            motion_id=numbers[place],
            n_tracks=int(members.lengths[place]),
            box_px=tuple(boxes[place].tolist()),
            status=_status_without_state(motion, has_values=has_values[place]),
            epipole_status=status[place],
            method=motion.method,
            direction=None if math.isnan(direction[place, 0]) else direction[place],
            direction_cov=None if math.isnan(direction[place, 0]) else direction_cov[place],
            horizon_offset_px=motion.horizon_offset_px,
            horizon_offset=motion.horizon_offset,
            expansion_hz=float(expansion_hz[place]) if math.isfinite(expansion_hz[place]) else None,
        )
        for place, motion in enumerate(motions)
    ]
    if motions and motions[0].cluster_id == SCENE_CLUSTER and motions[0].status == Status.no_parallax:
        rows[0] = rows[0].changed(motion_state=MotionState.no_relative_motion)
    fronts = front_boxes(members, boxes, joint, states, xy_px).tolist()
    for k, place in enumerate(joint.owner.tolist()):
        rows[place] = rows[place].changed(
            status=motions[place].status,
            ref_px=tuple(joint.ref_px[k].tolist()),
            ref_sigma=tuple(joint.ref_sigma[k].tolist()),
            front_px=tuple(fronts[k]),
            state_abc_hz=joint.abc_hz[k],
            state_cov=joint.cov[k],
        )
    return rows


def _status_without_state(motion: ClusterMotion, *, has_values: bool) -> Status:
    """Status of a cluster without a state: of an object ``no_parallax``, or ``not_rigid`` if tracks have values.

    An object without a direction keeps the reason for that.
    """
    if motion.cluster_id == SCENE_CLUSTER or motion.direction is None or motion.status not in _OPEN:
        return motion.status
    return Status.not_rigid if has_values else Status.no_parallax


def motion_ids(is_ours: Bools, direction: Floats, direction_cov: Floats) -> list[int]:
    """``motion_id`` of K clusters: 0 for the scene and standing obstacles, ``is_ours (K,)``, movers from 1.

    Movers share a number if their ``direction (K, 3)``, NaN where unknown, is equal within small errors. A mover never
    has 0, even along our own direction: users take the closing speed of what stands still for their own speed.
    """
    movers = np.flatnonzero(~is_ours)
    is_same = _have_same_direction(direction[movers], direction_cov[movers]) if len(movers) > 1 else np.ones((1, 1))
    numbers, ids = list[int](), [SCENE_MOTION] * len(is_ours)
    for place, mover in enumerate(movers.tolist()):
        same = np.flatnonzero(is_same[place, :place])
        numbers.append(numbers[same[0]] if len(same) else max([SCENE_MOTION, *numbers]) + 1)
        ids[mover] = numbers[-1]
    return ids


def ranked(rows: list[ClusterRow]) -> list[ClusterRow]:
    """Rows with ``urgency_rank`` of approaching objects, 1 first, by their distance in collision times abs(P)/abs(V).

    Conclusion of the paper: a near car at our own speed is harmless (both its times are long), a far one that closes in
    fast is not; one that will pass at a distance is between.
    """
    urgent = [
        (float(np.hypot(row.times.tcpa_s[0], row.times.miss_s[0])), row.cluster_id)
        for row in rows
        if row.motion_state in APPROACHING
    ]
    rank = {cluster_id: place + 1 for place, (_, cluster_id) in enumerate(sorted(urgent))}
    return [row.changed(urgency_rank=rank[row.cluster_id]) if row.cluster_id in rank else row for row in rows]


def with_epipole_pixels(rows: list[ClusterRow], camera: Camera) -> list[ClusterRow]:
    """Rows with the pixel of each epipole, where the line along its direction meets the image plane."""
    unknown = np.full(3, np.nan)
    directions = np.reshape([unknown if row.direction is None else row.direction for row in rows], (-1, 3))
    places = zip(rows, epipole_pixels(directions, camera), strict=True)
    return [row.changed(epipole_px=pixel) if np.isfinite(pixel[0]) else row for row, pixel in places]


def epipole_pixels(directions: Floats, camera: Camera) -> Floats:
    """Epipoles ``(K, 2)`` of ``directions (K, 3)`` in source pixels; NaN within 1 deg of the image plane."""
    z = directions[:, 2]
    forward = np.where(np.abs(z) < INFINITY_COSINE, np.nan, np.sign(z))[:, None] * directions
    return pixels_from_rays(camera, forward)


def with_times(rows: list[ClusterRow], camera: Camera) -> list[ClusterRow]:
    """Rows with motion states, and with times whose intervals are bounded, where they have a state."""
    stated = [place for place, row in enumerate(rows) if row.state_abc_hz is not None and row.ref_px is not None]
    if not stated:
        return rows
    xy = rays_from_pixels(camera, np.array([rows[place].ref_px for place in stated]))[:, :2]
    abc_hz = np.array([rows[place].state_abc_hz for place in stated])
    cov = np.array([rows[place].state_cov for place in stated])
    # The centroid of the surface is known by its tracks; as a point that is looked at, it has no error.
    ref_sigma = np.transpose([rows[place].ref_sigma for place in stated])
    times = collision_times_from_state(xy[:, 0], xy[:, 1], abc_hz, cov, ref_sigma)
    times = with_focal_interval(times, xy[:, 0], xy[:, 1], abc_hz, camera).where_bounded()
    rates, rates_cov = radial_and_transverse_rate(xy[:, 0], xy[:, 1], abc_hz, cov, np.full(len(stated), _EXACT))
    sigmas = np.sqrt(np.diagonal(rates_cov, axis1=1, axis2=2))
    rows = list(rows)
    for i, (place, rate, sigma) in enumerate(zip(stated, rates.tolist(), sigmas.tolist(), strict=True)):
        rows[place] = rows[place].changed(times=times.take(slice(i, i + 1)), motion_state=_motion_state(rate, sigma))
    return rows


def _motion_state(rates: Sequence[float], sigmas: Sequence[float]) -> MotionState:
    """Motion state by tests of the radial rate q (negative: nearer) at 99.9 % and the transverse u at 95 %, in 1/s."""
    (q, u), (q_sigma, u_sigma) = rates, sigmas
    moves_across = u > _SIGMAS_95_OF_TWO * u_sigma
    if q < -SIGMAS_999 * q_sigma:
        return MotionState.approaching if moves_across else MotionState.constant_bearing
    if q > SIGMAS_999 * q_sigma:
        return MotionState.receding
    return MotionState.unknown if moves_across else MotionState.no_relative_motion


def _take_directions_of_states(
    motions: Sequence[ClusterMotion], joint: JointStates, direction: Floats, direction_cov: Floats, status: list[Status]
) -> None:
    """Replaces the directions, covariances and their statuses of objects, of all K, by those of their states.

    The direction of a mover assumes straight tracks at constant speed; their common trajectory bends and changes
    speed. On a horizon, better known than either, the direction is kept, and so is that of what stands still: our own.
    """
    is_kept = np.array([motion.is_static or motion.method.endswith(ON_HORIZON) for motion in motions], dtype=bool)
    speed_hz = np.linalg.norm(joint.abc_hz, axis=1)
    taken = ~is_kept[joint.owner] & (speed_hz > 0.0)
    owner, speed_hz = joint.owner[taken], speed_hz[taken, None]
    direction[owner] = ways = joint.abc_hz[taken] / speed_hz
    across = (np.eye(3) - ways[:, :, None] * ways[:, None, :]) / speed_hz[:, :, None]
    direction_cov[owner] = across @ joint.cov[taken] @ across
    for place in owner.tolist():
        if status[place] in _VALUED:
            status[place] = Status.ok if abs(direction[place, 2]) >= INFINITY_COSINE else Status.epipole_at_infinity


def _have_same_direction(direction: Floats, cov: Floats) -> Bools:
    """Whether pairs of clusters ``(K, K)`` have equal directions, within small errors."""
    is_one = direction_chi2(direction, direction[:, None], cov + cov[:, None]) < _SAME_DIRECTION_CHI2
    is_known = cov[:, 0, 0] + cov[:, 1, 1] + cov[:, 2, 2] < _KNOWN_DIRECTION_RAD**2
    return np.asarray(is_one & is_known & is_known[:, None])


def _directions(motions: Sequence[ClusterMotion]) -> tuple[Floats, Floats]:
    """Directions ``(K, 3)`` and their covariances ``(K, 3, 3)``, NaN where unknown."""
    direction, cov = np.full((len(motions), 3), np.nan), np.full((len(motions), 3, 3), np.nan)
    for place, one in enumerate(motions):
        if one.direction is not None and one.direction_cov is not None:
            direction[place], cov[place] = one.direction, one.direction_cov
    return direction, cov
