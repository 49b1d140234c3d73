"""One row a cluster: its epipole, the state of its nearest surface, how it moves, and how urgent it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ttcvid.geometry.camera import pixels_from_rays, rays_from_pixels
from ttcvid.geometry.compiled import compiled
from ttcvid.geometry.epipole import INFINITY_COSINE, direction_chi2
from ttcvid.geometry.intervals import collision_times_from_state, radial_and_transverse_rate
from ttcvid.model import APPROACHING, SCENE_CLUSTER, Bools, Camera, ClusterRow, Floats, Ints, MotionState, Status
from ttcvid.stages.joint_states import joint_states
from ttcvid.stages.sets import TrackSets
from ttcvid.stages.track_states import TrackStates

# Approaching, receding and sideways motion are told at 95 % (one side).
_SIGMAS_95 = 1.645
# Sideways rate, a length of two components, is none below this many sigmas (95 % of a 2-D Gaussian).
_SIGMAS_95_OF_TWO = 2.45
# Two directions are one when their difference is inside 99 % of a 2-D Gaussian.
_SAME_DIRECTION_CHI2 = 9.21
# Directions known less well than this could be any, rad.
_KNOWN_DIRECTION_RAD = float(np.radians(10.0))
# Number of the motion of the scene.
_SCENE_MOTION = 0
# A cluster has a direction.
_VALUED = (Status.ok, Status.epipole_at_infinity)
# Noise of a point that is exact by definition.
_EXACT = 1e-12

ON_HORIZON = "+horizon"
"""End of the ``method`` of a direction that was moved onto the horizon."""


@dataclass(frozen=True)
class ClusterMotion:
    """What is known of a cluster before its times: ``members`` index the frame's tracks, ``direction`` is its ``dir``.

    ``horizon_offset_px`` how far off the horizon its epipole was found, before it was moved there; ``window_s`` for how
    long its motion has been what it is; ``is_static`` a thing that moves with the scene.
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
    boxes, lengths = members.boxes(xy_px).tolist(), members.lengths.tolist()
    rows = [_row(*each) for each in zip(motions, boxes, lengths, expansion_hz, strict=True)]
    direction, _ = _directions([replace(m, direction=None) if _is_scene(m) else m for m in motions])
    is_static = np.array([motion.is_static for motion in motions], dtype=bool)
    joint = joint_states(members, direction, is_static, states, xy_px, link_px)
    for k, place in enumerate(joint.owner):
        rows[place] = replace(
            rows[place],
            status=motions[place].status,
            ref_px=(float(joint.ref_px[k, 0]), float(joint.ref_px[k, 1])),
            state_abc_hz=joint.abc_hz[k],
            state_cov=joint.cov[k],
            speed_change=float(joint.speed_change[k]),
        )
    place_cov = np.zeros((len(rows), 3, 3))
    place_cov[joint.owner] = joint.place_cov
    rows = _with_directions_of_states(_with_reasons(rows, members, states), place_cov)
    numbers = motion_ids(
        [replace(m, direction=r.direction, direction_cov=r.direction_cov) for m, r in zip(motions, rows, strict=True)]
    )
    return [replace(row, motion_id=number) for row, number in zip(rows, numbers, strict=True)]


def _is_scene(motion: ClusterMotion) -> bool:
    return motion.cluster_id == SCENE_CLUSTER


def _row(motion: ClusterMotion, box_px: list[float], n_tracks: int, expansion_hz: float) -> ClusterRow:
    """What its motion and the places of its tracks say of a cluster; an object without a state has no parallax."""
    status, motion_state = motion.status, MotionState.unknown
    if _is_scene(motion):
        motion_state = MotionState.no_relative_motion if status == Status.no_parallax else motion_state
    elif status in _VALUED:
        status = Status.no_parallax
    x0, y0, x1, y1 = box_px
    return ClusterRow(
        cluster_id=motion.cluster_id,
        motion_id=_SCENE_MOTION,
        n_tracks=n_tracks,
        box_px=(x0, y0, x1, y1),
        status=status,
        epipole_status=motion.status,
        method=motion.method,
        motion_state=motion_state,
        direction=motion.direction,
        direction_cov=motion.direction_cov,
        horizon_offset_px=motion.horizon_offset_px,
        expansion_hz=float(expansion_hz) if np.isfinite(expansion_hz) else None,
    )


def _with_reasons(rows: list[ClusterRow], members: TrackSets, states: TrackStates) -> list[ClusterRow]:
    """Objects without a state whose tracks have values, but too few of them one value, are not rigid."""
    has_values = members.sums(states.has_value[members.index].astype(np.int64)) > 0
    return [
        replace(row, status=Status.not_rigid)
        if row.status == Status.no_parallax and row.role == "object" and k
        else row
        for row, k in zip(rows, has_values.tolist(), strict=True)
    ]


def motion_ids(clusters: Sequence[ClusterMotion]) -> list[int]:
    """Number of each cluster's motion: that of the scene and of what stands in our way is 0; movers count from 1.

    Movers share a number where their directions, both known well, are one. A mover has none of the scene's, though it
    may go along our own line: who is told that a thing stands still takes our speed for its closing speed.
    """
    is_same = _have_same_direction(clusters)
    numbers: list[int] = []
    for place, motion in enumerate(clusters):
        if _is_scene(motion) or motion.is_static:
            numbers.append(_SCENE_MOTION)
            continue
        same = [numbers[other] for other in np.flatnonzero(is_same[place, :place]) if numbers[other] != _SCENE_MOTION]
        numbers.append(same[0] if same else max([_SCENE_MOTION, *numbers]) + 1)
    return numbers


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
    return [replace(row, urgency_rank=rank[row.cluster_id]) if row.cluster_id in rank else row for row in rows]


def with_epipole_pixels(rows: list[ClusterRow], camera: Camera) -> list[ClusterRow]:
    """The same with the pixel of each epipole: where the line along its direction meets the picture."""
    directed = [place for place, row in enumerate(rows) if row.direction is not None]
    pixels = epipole_pixels(np.reshape([rows[place].direction for place in directed], (-1, 3)), camera)
    rows = list(rows)
    for place, pixel in zip(directed, pixels, strict=True):
        if np.isfinite(pixel[0]):
            rows[place] = replace(rows[place], epipole_px=pixel)
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
    present_cov = np.array([rows[place].present_cov for place in stated])
    rates, rates_cov = radial_and_transverse_rate(xy[:, 0], xy[:, 1], abc_hz, present_cov, sigma_norm)
    sigmas = np.sqrt(np.diagonal(rates_cov, axis1=1, axis2=2))
    rows = list(rows)
    for i, (place, rate, sigma) in enumerate(zip(stated, rates.tolist(), sigmas.tolist(), strict=True)):
        rows[place] = replace(rows[place], times=times.take(slice(i, i + 1)), motion_state=_motion_state(rate, sigma))
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


def _with_directions_of_states(rows: list[ClusterRow], place_cov: Floats) -> list[ClusterRow]:
    """Give objects whose state contradicts their direction that of their state.

    The direction was found as if all tracks were straight, which is the surer way where they are. In a bend it lags,
    and the curve is taken for depth. (On a horizon the plane says more than either.) ``place_cov (N, 3, 3)`` is what
    the states vary by over the places of things that turn: no reason to keep a direction found as if nothing did.
    """
    asked = [k for k, row in enumerate(rows) if row.state_abc_hz is not None and not row.method.endswith(ON_HORIZON)]
    if not asked:
        return rows
    believed, believed_cov = _directions([rows[k] for k in asked])
    abc_hz, state_cov = np.array([rows[k].state_abc_hz for k in asked]), np.array([rows[k].state_cov for k in asked])
    speed_hz = np.linalg.norm(abc_hz, axis=1)[:, None]
    direction = abc_hz / speed_hz
    across = (np.eye(3) - direction[:, :, None] * direction[:, None, :]) / speed_hz[:, :, None]
    cov, cov_here = across @ state_cov @ across, across @ (state_cov - place_cov[asked]) @ across
    # Without a covariance of the belief (NaN) it stays.
    is_other = direction_chi2(direction, believed, cov_here + believed_cov) >= _SAME_DIRECTION_CHI2
    rows = list(rows)
    for i in np.flatnonzero(is_other):
        row, status = rows[asked[i]], rows[asked[i]].epipole_status
        if status in _VALUED:
            status = Status.epipole_at_infinity if abs(direction[i, 2]) < INFINITY_COSINE else Status.ok
        rows[asked[i]] = replace(row, direction=direction[i], direction_cov=cov[i], epipole_status=status)
    return rows


def _have_same_direction(clusters: Sequence[ClusterMotion]) -> Bools:
    """Which pairs of clusters (K, K) have one direction within their errors, and not only because these are large."""
    direction, cov = _directions(clusters)
    is_one = direction_chi2(direction, direction[:, None], cov + cov[:, None]) < _SAME_DIRECTION_CHI2
    is_known = np.trace(cov, axis1=1, axis2=2) < _KNOWN_DIRECTION_RAD**2
    return np.asarray(is_one & is_known & is_known[:, None])


def _directions(things: Sequence[ClusterMotion | ClusterRow]) -> tuple[Floats, Floats]:
    """Directions (K, 3) and their covariances (K, 3, 3), NaN where one of them is not known."""
    unknown = np.full(3, np.nan), np.full((3, 3), np.nan)
    known = [
        unknown if thing.direction is None or thing.direction_cov is None else (thing.direction, thing.direction_cov)
        for thing in things
    ]
    direction = np.reshape([one for one, _ in known], (len(known), 3))
    return direction, np.reshape([one for _, one in known], (len(known), 3, 3))


def neighbours_in_cluster(xy_px: Floats, cluster: Ints, asked: Ints, count: int, radius_px: float) -> Ints:
    """The nearest tracks of the same cluster around each of the ``asked`` tracks, itself the first.

    Returns ``(N, count)`` tracks within the radius, nearest first, -1 where absent and for tracks not asked.
    """
    found = np.full((len(xy_px), count), -1, dtype=np.int64)
    _find_neighbours(np.ascontiguousarray(xy_px), cluster, asked, radius_px, found)
    return found


@compiled
def _find_neighbours(xy: Floats, cluster: Ints, asked: Ints, radius: float, found: Ints) -> None:
    """Fills ``found (N, K)`` of `neighbours_in_cluster`."""
    most = found.shape[1]
    square = np.empty(most)
    for i in asked:
        count = 0
        for j in range(len(xy)):
            distance = (xy[j, 0] - xy[i, 0]) ** 2 + (xy[j, 1] - xy[i, 1]) ** 2
            if cluster[j] != cluster[i] or distance >= radius * radius or (count == most and distance >= square[-1]):
                continue
            place = min(count, most - 1)
            while place > 0 and distance < square[place - 1]:
                square[place], found[i, place] = square[place - 1], found[i, place - 1]
                place -= 1
            square[place], found[i, place] = distance, j
            count = min(count + 1, most)
