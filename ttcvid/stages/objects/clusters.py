"""One row a cluster: its epipole, the state of its nearest surface, how it moves, and how urgent it is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ttcvid.geometry.camera.pinhole import pixels_from_rays, rays_from_pixels
from ttcvid.geometry.estimation.intervals import collision_times_from_state, radial_and_transverse_rate
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
from ttcvid.stages.tracking.groups import TrackSets

# Approaching, receding and sideways motion are told at 95 % (one side).
_SIGMAS_95 = 1.645
# Sideways rate, a length of two components, is none below this many sigmas (95 % of a 2-D Gaussian).
_SIGMAS_95_OF_TWO = 2.45
# Two directions are one when their difference is inside 99 % of a 2-D Gaussian.
_SAME_DIRECTION_CHI2 = 9.21
# Directions known less well than this could be any, rad.
_KNOWN_DIRECTION_RAD = float(np.radians(10.0))
# A cluster has a direction.
_VALUED = (Status.ok, Status.epipole_at_infinity)
# What says no more of an object than that it may have a state.
_OPEN = (*_VALUED, Status.no_parallax)
# Noise of a point that is exact by definition.
_EXACT = 1e-12

ON_HORIZON = "+horizon"
"""End of the ``method`` of a direction that was moved onto the horizon."""


@dataclass(frozen=True)
class ClusterMotion:
    """What is known of a cluster before its times: ``members`` index the frame's tracks, ``direction`` is its ``dir``.

    ``horizon_offset_px`` how far off the horizon its epipole was found, before it was moved there, and
    ``horizon_offset`` the same as an angle with its error; ``window_s`` for how
    long its motion has been what it is; ``is_static`` a thing that moves with the scene; ``is_one_surface`` one that
    was found as one surface, and may have few tracks.
    """

    cluster_id: int
    members: Ints
    direction: Floats | None
    direction_cov: Floats | None
    status: Status
    method: str
    horizon_offset_px: float | None = None
    window_s: float = np.inf
    is_static: bool = False
    is_one_surface: bool = False
    horizon_offset: HorizonOffset | None = None


def rows_of(
    motions: Sequence[ClusterMotion],
    members: TrackSets,
    states: TrackStates,
    xy_px: Floats,
    link_px: float,
    expansion_hz: Floats,
) -> list[ClusterRow]:
    """A row for each cluster; an object's has the state of its nearest surface, and `with_times` what follows from it.

    The scene has no state (it has many depths).

    Parameters
    ----------
    members : tracks of the K ``motions``.
    expansion_hz : (K,) of all tracks of each, NaN where unknown.
    """
    believed, believed_cov = _directions(motions)
    is_scene = np.array([_is_scene(motion) for motion in motions], dtype=bool)
    is_static = np.array([motion.is_static for motion in motions], dtype=bool)
    is_one = np.array([motion.is_one_surface for motion in motions], dtype=bool)
    joint = joint_states(members, np.where(is_scene[:, None], np.nan, believed), is_one, states, xy_px, link_px)
    stated: dict[int, dict[str, Any]] = {}
    fronts = front_boxes(members, joint, states, xy_px).tolist()
    for place, ref_px, front_px, abc_hz, cov in zip(
        joint.owner.tolist(),
        joint.ref_px.tolist(),
        fronts,
        joint.abc_hz,
        joint.cov,
        strict=True,
    ):
        stated[place] = {
            "status": motions[place].status,
            "ref_px": tuple(ref_px),
            "front_px": tuple(front_px),
            "state_abc_hz": abc_hz,
            "state_cov": cov,
        }
    turned = _directions_of_states(motions, joint, believed, believed_cov)
    for place, direction, cov, status in turned:
        believed[place], believed_cov[place] = direction, cov
        stated[place].update(direction=direction, direction_cov=cov, epipole_status=status)
    facts = zip(
        members.boxes(xy_px).tolist(),
        members.lengths.tolist(),
        expansion_hz.tolist(),
        np.logical_or.reduceat(states.has_value[members.index], members.first).tolist(),
        motion_ids(is_scene | is_static, believed, believed_cov),
        strict=True,
    )
    return [
        _row(motion, *each, stated.get(place, {}))
        for place, (motion, each) in enumerate(zip(motions, facts, strict=True))
    ]


def _is_scene(motion: ClusterMotion) -> bool:
    return motion.cluster_id == SCENE_CLUSTER


def _row(
    motion: ClusterMotion,
    box_px: list[float],
    n_tracks: int,
    expansion_hz: float,
    has_values: bool,
    motion_id: int,
    stated: dict[str, Any],
) -> ClusterRow:
    """The row of a cluster, with what is ``stated`` of it beside what its motion and the places of its tracks say.

    An object without a state has no parallax. Where its tracks have values, but too few of them one value, it is not
    rigid.
    """
    status, motion_state = motion.status, MotionState.unknown
    if _is_scene(motion):
        motion_state = MotionState.no_relative_motion if status == Status.no_parallax else motion_state
    elif status in _OPEN:
        status = Status.not_rigid if has_values else Status.no_parallax
    x0, y0, x1, y1 = box_px
    facts: dict[str, Any] = {
        "cluster_id": motion.cluster_id,
        "motion_id": motion_id,
        "n_tracks": n_tracks,
        "box_px": (x0, y0, x1, y1),
        "status": status,
        "epipole_status": motion.status,
        "method": motion.method,
        "motion_state": motion_state,
        "direction": motion.direction,
        "direction_cov": motion.direction_cov,
        "horizon_offset_px": motion.horizon_offset_px,
        "horizon_offset": motion.horizon_offset,
        "expansion_hz": expansion_hz if math.isfinite(expansion_hz) else None,
    }
    return ClusterRow(**(facts | stated))


def motion_ids(is_ours: Bools, direction: Floats, direction_cov: Floats) -> list[int]:
    """Number of each cluster's motion: 0 for those of our own, the scene and what stands in our way; movers from 1.

    Movers share a number where their directions, both known well, are one. A mover has none of the scene's, though it
    may go along our own line: who is told that a thing stands still takes our speed for its closing speed.

    Parameters
    ----------
    is_ours, direction, direction_cov : (K,), (K, 3), (K, 3, 3) of the clusters; NaN where not known.
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
    """Give approaching objects their urgency, 1 first: by the distance in collision times, abs(P') = abs(P)/abs(V).

    The paper's conclusion: a near car at our own speed is harmless (both its times are long), a far one that closes
    fast is not; one that will pass far off lies between.
    """
    urgent = [
        (float(np.hypot(row.times.tcpa_s[0], row.times.miss_s[0])), row.cluster_id)
        for row in rows
        if row.motion_state in APPROACHING
    ]
    rank = {cluster_id: place + 1 for place, (_, cluster_id) in enumerate(sorted(urgent))}
    return [row.changed(urgency_rank=rank[row.cluster_id]) if row.cluster_id in rank else row for row in rows]


def with_epipole_pixels(rows: list[ClusterRow], camera: Camera) -> list[ClusterRow]:
    """The same with the pixel of each epipole: where the line along its direction meets the picture."""
    directed = [place for place, row in enumerate(rows) if row.direction is not None]
    pixels = epipole_pixels(np.reshape([rows[place].direction for place in directed], (-1, 3)), camera)
    rows = list(rows)
    for place, pixel in zip(directed, pixels, strict=True):
        if np.isfinite(pixel[0]):
            rows[place] = rows[place].changed(epipole_px=pixel)
    return rows


def epipole_pixels(directions: Floats, camera: Camera) -> Floats:
    """Where lines along ``directions (K, 3)`` meet the picture: (K, 2) source pixels, NaN within 1 deg of its plane."""
    z = directions[:, 2]
    forward = np.where(np.abs(z) < INFINITY_COSINE, np.nan, np.sign(z))[:, None] * directions
    return pixels_from_rays(camera, forward)


def with_times(rows: list[ClusterRow], camera: Camera) -> list[ClusterRow]:
    """The times of all rows that have a state, and how they move; the others as they are."""
    stated = [place for place, row in enumerate(rows) if row.state_abc_hz is not None and row.ref_px is not None]
    if not stated:
        return rows
    xy = rays_from_pixels(camera, np.array([rows[place].ref_px for place in stated]))[:, :2]
    abc_hz = np.array([rows[place].state_abc_hz for place in stated])
    cov = np.array([rows[place].state_cov for place in stated])
    # The reference point is where the tracks are, by definition: it has no error of its own.
    sigma_norm = np.full(len(stated), _EXACT)
    times = collision_times_from_state(xy[:, 0], xy[:, 1], abc_hz, cov, sigma_norm)
    rates, rates_cov = radial_and_transverse_rate(xy[:, 0], xy[:, 1], abc_hz, cov, sigma_norm)
    sigmas = np.sqrt(np.diagonal(rates_cov, axis1=1, axis2=2))
    rows = list(rows)
    for i, (place, rate, sigma) in enumerate(zip(stated, rates.tolist(), sigmas.tolist(), strict=True)):
        rows[place] = rows[place].changed(times=times.take(slice(i, i + 1)), motion_state=_motion_state(rate, sigma))
    return rows


def _motion_state(rates: Sequence[float], sigmas: Sequence[float]) -> MotionState:
    """Test of the radial rate q (negative: nearer) and the transverse rate u at 95 %."""
    (q, u), (q_sigma, u_sigma) = rates, sigmas
    moves_across = u > _SIGMAS_95_OF_TWO * u_sigma
    if q < -_SIGMAS_95 * q_sigma:
        return MotionState.approaching if moves_across else MotionState.constant_bearing
    if q > _SIGMAS_95 * q_sigma:
        return MotionState.receding
    return MotionState.unknown if moves_across else MotionState.no_relative_motion


def _directions_of_states(
    motions: Sequence[ClusterMotion], joint: JointStates, believed: Floats, believed_cov: Floats
) -> list[tuple[int, Floats, Floats, Status]]:
    """Objects whose states contradict their directions: which, and the directions of the states with their covariances.

    The direction was found as if all tracks were straight, which is the surer way where they are. In a bend it lags,
    and the curve is taken for depth. (On a horizon the plane says more than either.) What the states vary by over the
    places of things that turn is no reason to keep a direction found as if nothing did.
    """
    asked = np.array([not motions[place].method.endswith(ON_HORIZON) for place in joint.owner], dtype=bool)
    if not asked.any():
        return []
    owner, abc_hz = joint.owner[asked], joint.abc_hz[asked]
    speed_hz = np.linalg.norm(abc_hz, axis=1)[:, None]
    direction = abc_hz / speed_hz
    across = (np.eye(3) - direction[:, :, None] * direction[:, None, :]) / speed_hz[:, :, None]
    cov_here = across @ (joint.cov - joint.place_cov)[asked] @ across
    # Without a covariance of the belief (NaN) it stays.
    is_other = direction_chi2(direction, believed[owner], cov_here + believed_cov[owner]) >= _SAME_DIRECTION_CHI2
    found = []
    for i in np.flatnonzero(is_other):
        status = motions[owner[i]].status
        if status in _VALUED:
            status = Status.epipole_at_infinity if abs(direction[i, 2]) < INFINITY_COSINE else Status.ok
        found.append((int(owner[i]), direction[i], across[i] @ joint.cov[asked][i] @ across[i], status))
    return found


def _have_same_direction(direction: Floats, cov: Floats) -> Bools:
    """Which pairs of clusters (K, K) have one direction within their errors, and not only because these are large."""
    is_one = direction_chi2(direction, direction[:, None], cov + cov[:, None]) < _SAME_DIRECTION_CHI2
    is_known = cov[:, 0, 0] + cov[:, 1, 1] + cov[:, 2, 2] < _KNOWN_DIRECTION_RAD**2
    return np.asarray(is_one & is_known & is_known[:, None])


def _directions(motions: Sequence[ClusterMotion]) -> tuple[Floats, Floats]:
    """Directions (K, 3) and their covariances (K, 3, 3), NaN where one of them is not known."""
    direction, cov = np.full((len(motions), 3), np.nan), np.full((len(motions), 3, 3), np.nan)
    for place, one in enumerate(motions):
        if one.direction is not None and one.direction_cov is not None:
            direction[place], cov[place] = one.direction, one.direction_cov
    return direction, cov
