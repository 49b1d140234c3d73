"""One row a cluster: its epipole, the state of its nearest surface, how it moves, and how urgent it is."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ttcvid.geometry.camera import pixels_from_rays, rays_from_pixels
from ttcvid.geometry.compiled import compiled
from ttcvid.geometry.epipole import INFINITY_COSINE, direction_chi2
from ttcvid.geometry.intervals import collision_times_from_state, radial_and_transverse_rate
from ttcvid.model import SCENE_CLUSTER, Bools, Camera, ClusterRow, Floats, Ints, MotionState, Status
from ttcvid.stages.surfaces import nearest_surface
from ttcvid.stages.track_states import TrackStates, has_value

# Approaching, receding and sideways motion are told at 95 % (one side).
_SIGMAS_95 = 1.645
# Sideways rate, a length of two components, is none below this many sigmas (95 % of a 2-D Gaussian).
_SIGMAS_95_OF_TWO = 2.45
# Two directions are one when their difference is inside 99 % of a 2-D Gaussian.
_SAME_DIRECTION_CHI2 = 9.21
# Variance of a mean over the tracks within 2 sigma of it, relative to their count: the search for them is not free.
_TRIMMED_VARIANCE = 1.35
# Tracks that tell when a thing is reached that is one surface.
_LEAST_OF_SURFACE = 3
# The parts of a car's front lie in depths that differ by this (standard deviation, as a part of the distance).
_RELIEF = 0.025
# Least variance of a rate, 1/s^2, and noise of a point that is exact by definition.
_TINY, _EXACT = 1e-24, 1e-12


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


def scene_row(motion: ClusterMotion, xy_px: Floats) -> ClusterRow:
    """The scene: an epipole, no times (a scene has many depths)."""
    is_resting = motion.status == Status.no_parallax
    return _row(motion, xy_px, motion_state=MotionState.no_relative_motion if is_resting else MotionState.unknown)


def object_row(
    motion: ClusterMotion,
    motion_id: int,
    states: TrackStates,
    xy_px: Floats,
    link_px: float,
    expansion_hz: float,
) -> ClusterRow:
    """An object with the state of its nearest well-supported surface; `with_times` adds what follows from it.

    Parameters
    ----------
    expansion_hz : of all its tracks, NaN where unknown.
    """
    known: dict[str, Any] = {"motion_id": motion_id}
    if np.isfinite(expansion_hz):
        known["expansion_hz"] = float(expansion_hz)
    surface = _nearest_surface(motion, states, xy_px, link_px)
    if len(surface):
        known |= _surface_state(states.take(surface), xy_px[surface])
    elif motion.status in (Status.ok, Status.epipole_at_infinity):
        known["status"] = Status.no_parallax
    return _with_direction_of_state(_row(motion, xy_px, **known))


def _nearest_surface(motion: ClusterMotion, states: TrackStates, xy_px: Floats, link_px: float) -> Ints:
    """The tracks of the nearest surface: those with the largest rate speed / Z, whether it comes, goes or crosses.

    (Of a thing that approaches, the largest rate is also the largest 1 / ttc_z. Of one that recedes it is the smallest,
    and one that crosses has none: its tracks would make no surfaces.) What the tracks have in common moves all surfaces
    alike, and does not make one of two; but no surface is flat.
    """
    usable = motion.members[has_value(states.status[motion.members])]
    if motion.direction is None or not len(usable):
        return np.empty(0, dtype=np.int64)
    rate_hz = states.abc_hz[usable] @ motion.direction
    sigma_hz = np.hypot(states.own_sigma_along(motion.direction, usable), _RELIEF * rate_hz)
    surface = usable[nearest_surface(rate_hz, sigma_hz, xy_px[usable], link_px)]
    # What stands in our way was found as one surface, and may have few tracks.
    is_whole = motion.is_static and not len(surface) and len(usable) >= _LEAST_OF_SURFACE
    return np.asarray(usable if is_whole else surface)


def motion_ids(clusters: tuple[ClusterMotion, ...]) -> list[int]:
    """Number of each cluster's motion: clusters with one epipole share it; 0 is the scene's."""
    is_same = _have_same_direction(clusters)
    numbers: list[int] = []
    next_number = 1
    for place, motion in enumerate(clusters):
        same = np.flatnonzero(is_same[place, :place])
        if motion.cluster_id == SCENE_CLUSTER or motion.is_static:
            numbers.append(0)
        elif len(same):
            numbers.append(numbers[same[0]])
        else:
            numbers.append(next_number)
            next_number += 1
    return numbers


def ranked(rows: list[ClusterRow]) -> list[ClusterRow]:
    """Give approaching objects their urgency, 1 first: by the distance in collision times, abs(P') = abs(P)/abs(V).

    The paper's conclusion: a near car at our own speed is harmless (both its times are long), a far one that closes
    fast is not; one that will pass far off lies between.
    """
    urgent = [
        (float(np.hypot(row.times.tcpa_s[0], row.times.miss_s[0])), row.cluster_id)
        for row in rows
        if row.motion_state in (MotionState.approaching, MotionState.constant_bearing)
    ]
    rank = {cluster_id: place + 1 for place, (_, cluster_id) in enumerate(sorted(urgent))}
    return [replace(row, urgency_rank=rank.get(row.cluster_id)) for row in rows]


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


def _row(motion: ClusterMotion, xy_px: Floats, **known: Any) -> ClusterRow:
    """A row with what its motion and the places of its tracks say, and what else is ``known``."""
    places = xy_px[motion.members]
    low, high = places.min(axis=0), places.max(axis=0)
    row: dict[str, Any] = {
        "cluster_id": motion.cluster_id,
        "motion_id": SCENE_CLUSTER,
        "n_tracks": len(motion.members),
        "box_px": (float(low[0]), float(low[1]), float(high[0]), float(high[1])),
        "status": motion.status,
        "epipole_status": motion.status,
        "method": motion.method,
        "direction": motion.direction,
        "direction_cov": motion.direction_cov,
        "horizon_offset_px": motion.horizon_offset_px,
    }
    return ClusterRow(**(row | known))


def with_times(rows: list[ClusterRow], camera: Camera) -> list[ClusterRow]:
    """The times of all rows that have a state, and how they move; the others as they are."""
    stated = [row for row in rows if row.state_abc_hz is not None and row.ref_px is not None]
    if not stated:
        return rows
    xy = rays_from_pixels(camera, np.array([row.ref_px for row in stated]))[:, :2]
    abc_hz, cov = np.array([row.state_abc_hz for row in stated]), np.array([row.state_cov for row in stated])
    # The reference point is where the tracks are, by definition: it has no error of its own.
    sigma_norm = np.full(len(stated), _EXACT)
    times = collision_times_from_state(xy[:, 0], xy[:, 1], abc_hz, cov, sigma_norm)
    present_cov = np.array([row.present_cov for row in stated])
    rates, rates_cov = radial_and_transverse_rate(xy[:, 0], xy[:, 1], abc_hz, present_cov, sigma_norm)
    done = {
        row.cluster_id: replace(row, times=times.take([i]), motion_state=_motion_state(rates[i], rates_cov[i]))
        for i, row in enumerate(stated)
    }
    return [done.get(row.cluster_id, row) for row in rows]


def _surface_state(states: TrackStates, xy_px: Floats) -> dict[str, Any]:
    """The joint state of a surface's tracks at their centroid: part of its row."""
    weight = 1.0 / np.maximum(states.cov[:, 2, 2], _TINY)
    weight /= weight.sum()
    ref_px = weight @ xy_px
    return {
        "ref_px": (float(ref_px[0]), float(ref_px[1])),
        "state_abc_hz": weight @ states.abc_hz,
        "state_cov": _joint_covariance(states, weight),
        "speed_change": _speed_change(states),
    }


def _with_direction_of_state(row: ClusterRow) -> ClusterRow:
    """Give an object whose state contradicts its direction that of its state.

    The direction was found as if all tracks were straight, which is the surer way where they are. In a bend it lags,
    and the curve is taken for depth. (On a horizon the plane says more than either.)
    """
    if row.state_abc_hz is None or row.state_cov is None or row.horizon_offset_px is not None:
        return row
    if row.direction is None or row.direction_cov is None:
        return row
    speed_hz = float(np.linalg.norm(row.state_abc_hz))
    direction = row.state_abc_hz / speed_hz
    across = (np.eye(3) - np.outer(direction, direction)) / speed_hz
    cov = across @ row.state_cov @ across
    if direction_chi2(direction, row.direction, cov + row.direction_cov) < _SAME_DIRECTION_CHI2:
        return row
    status = row.epipole_status
    if status in (Status.ok, Status.epipole_at_infinity):
        status = Status.epipole_at_infinity if abs(direction[2]) < INFINITY_COSINE else Status.ok
    return replace(row, direction=direction, direction_cov=cov, epipole_status=status)


def _joint_covariance(states: TrackStates, weight: Floats) -> Floats:
    """Covariance of the weighted mean of (a, b, c) = s e: own noise averages out, errors of e and of rotation do not.

    Where each track has a direction of its own (three frames), nothing is common.
    """
    shared = states.shared
    if shared is None or not shared.is_one_path:
        return _TRIMMED_VARIANCE * np.asarray(np.einsum("n,nij->ij", weight**2, states.cov))
    return shared.covariance_of_mean(states.abc_hz, weight, _TRIMMED_VARIANCE)


def _speed_change(states: TrackStates) -> float:
    """By what part the speed may change that the tracks share."""
    shared = states.shared
    return 0.0 if shared is None or not shared.is_one_path else float(shared.change[shared.path_of[0]])


def _motion_state(rates: Floats, cov: Floats) -> MotionState:
    """Test of the radial rate q (negative: nearer) and the transverse rate u at 95 %."""
    q, u = rates
    q_sigma, u_sigma = np.sqrt(np.diag(cov))
    moves_across = u > _SIGMAS_95_OF_TWO * u_sigma
    if q < -_SIGMAS_95 * q_sigma:
        return MotionState.approaching if moves_across else MotionState.constant_bearing
    if q > _SIGMAS_95 * q_sigma:
        return MotionState.receding
    return MotionState.unknown if moves_across else MotionState.no_relative_motion


def _have_same_direction(clusters: tuple[ClusterMotion, ...]) -> Bools:
    """Which pairs of clusters (K, K) have one direction within their errors."""
    nothing = np.full(3, np.nan), np.full((3, 3), np.nan)
    known = [
        nothing if m.direction is None or m.direction_cov is None else (m.direction, m.direction_cov) for m in clusters
    ]
    direction = np.reshape([one for one, _ in known], (len(clusters), 3))
    cov = np.reshape([one for _, one in known], (len(clusters), 3, 3))
    return np.asarray(direction_chi2(direction, direction[:, None], cov + cov[:, None]) < _SAME_DIRECTION_CHI2)


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
