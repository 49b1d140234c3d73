"""Whether an object approaches or recedes by more than the tracker's common error, and whether its picture agrees.

A state says what the paths of the tracks are best explained by. Where nothing moves, that is what their errors are best
explained by, and these are not independent: they drift, together and in one direction. At a red light each of three
hundred tracks of a resting car has a rate of its own, their mean is fifty times as sure as any of them, and wrong.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ttcvid.geometry.camera.pinhole import rays_from_pixels
from ttcvid.geometry.estimation.closing import Closing, depths_over_time, fit_braking
from ttcvid.geometry.paper.expansion import expansion_of_neighbourhood
from ttcvid.model import APPROACHING, Bools, Camera, ClusterRow, Floats, Ints, MotionState
from ttcvid.stages.tracking.groups import TrackSets
from ttcvid.stages.tracking.history import TrackHistory
from ttcvid.stages.tracking.tracker import COMMON_ERROR_PX

# Nearer and farther are told at 99.9 % (one side): in 99 % of frames of ten objects none is told wrongly.
_SIGMAS_999 = 3.090
# A growth of the picture is contradicted, or sure, at 95 % (one side).
_SIGMAS_95 = 1.645
# Tracks drift together (`COMMON_ERROR_PX`) over this time at the most, s, since a longer look is not less wrong.
_DRIFT_S = 0.6
# Most of that grows evenly: what lies deeper than it seems grows less. By this part of it errors walk, and only that
# looks like a change of speed: judged from one car beside lidar (kitti_sfnd_ttc), whose accelerations err by about half
# of what they would by all of it.
_WALKING_PART = 0.5
# Tracks all in one place tell nothing of its growth, px.
_LEAST_RADIUS_PX = 1e-3


@dataclass(frozen=True)
class CommonViews:
    """Rays of all N tracks a common gap ago and now, ``(N, 3)`` each, NaN where not seen, and that gap in s."""

    first: Floats
    now: Floats
    gap_s: float

    def expansions(self, members: Sequence[Ints]) -> tuple[Floats, Floats]:
        """How each of K sets of tracks expands, and its standard deviation: (K,) each, 1/s; NaN where unknown."""
        padded = np.full((len(members), max((len(index) for index in members), default=0)), -1, dtype=np.int64)
        for row, index in zip(padded, members, strict=True):
            row[: len(index)] = index
        return expansion_of_neighbourhood(self.first, self.now, padded, self.gap_s)


def with_common_errors(
    rows: list[ClusterRow],
    members: TrackSets,
    radius_px: Floats,
    age_s: Floats,
    gap_s: float,
    error_px: float,
    camera: Camera,
) -> list[ClusterRow]:
    """The same K rows; their states no surer than what all tracks of an object may err by in common leaves them.

    Parameters
    ----------
    members, radius_px : tracks of the rows, and their `radii_px`.
    age_s : (N,) for how long each track has been seen.
    gap_s : time over which all tracks are looked at (`CommonViews`).
    error_px : `PointSet.common_error_px`.
    """
    stated = [k for k, row in enumerate(rows) if row.state_cov is not None]
    if not stated:
        return rows
    rays = rays_from_pixels(camera, np.array([rows[k].ref_px for k in stated]))
    has_state = np.zeros(len(rows), dtype=bool)
    has_state[stated] = True
    of_stated, _ = members.where(has_state[members.set_of])
    drift_hz = common_growth_hz(radius_px[stated], of_stated.medians(age_s[of_stated.index]), gap_s, error_px)
    # What seems to grow, seems to come along its ray.
    common = drift_hz[:, None, None] ** 2 * rays[:, :, None] * rays[:, None, :]
    rows = list(rows)
    for k, cov in zip(stated, common, strict=True):
        rows[k] = rows[k].changed(state_cov=rows[k].state_cov + cov)
    return rows


def common_growth_hz(
    radius_px: Floats, seen_s: Floats, least_s: float = 0.0, error_px: float = COMMON_ERROR_PX
) -> Floats:
    """Growth that tracks show by what matching errs by in common: its standard deviation, 1/s.

    Parameters
    ----------
    radius_px : root mean square distance of the tracks of each thing from their centre.
    seen_s, least_s : for how long they have been seen, and for how long they are looked at, at the least.
    error_px : at their outline.
    """
    looked_s = np.maximum(np.minimum(seen_s, _DRIFT_S), least_s)
    return np.asarray(error_px / (np.maximum(radius_px, _LEAST_RADIUS_PX) * looked_s))


def with_seen_motion(
    rows: list[ClusterRow], radius_px: Floats, growth: tuple[Floats, Floats], gap_s: float, camera: Camera
) -> list[ClusterRow]:
    """The same K rows; what is said to approach or recede without its picture showing it is not said to.

    Parameters
    ----------
    radius_px : `radii_px` of the tracks of the rows.
    growth : (K,) each, how the pictures of the rows expand, and its standard deviation (`CommonViews.expansions`).
    gap_s : time over which they do.
    """
    asked = [k for k, row in enumerate(rows) if row.motion_state in {*APPROACHING, MotionState.receding}]
    if not asked:
        return rows
    rays = rays_from_pixels(camera, np.array([rows[k].ref_px for k in asked]))
    abc_hz, cov = np.array([rows[k].state_abc_hz for k in asked]), np.array([rows[k].state_cov for k in asked])
    nearer = zip(*_radial_rates(rays, abc_hz, cov), strict=True)
    grows = np.column_stack(growth).tolist()
    seen = list(rows)
    for k, (nearer_hz, sigma_hz), c_hz, c_variance in zip(
        asked, nearer, abc_hz[:, 2].tolist(), cov[:, 2, 2].tolist(), strict=True
    ):
        said = (-c_hz, math.sqrt(c_variance))
        is_contradicted = _is_contradicted(rows[k].motion_state, gap_s, grows[k], said, float(radius_px[k]))
        state = _seen_state(rows[k].motion_state, nearer_hz, sigma_hz, is_contradicted=is_contradicted)
        if state != rows[k].motion_state:
            seen[k] = rows[k].changed(motion_state=state)
    return seen


def braking_of(xy: Floats, since_s: Floats, focal_px: float, least_s: float) -> Closing | None:
    """How the depth of a thing changes that may have begun to brake within what is seen; None with too few views.

    Parameters
    ----------
    xy, since_s : (L, M, 2) places of its tracks in the plane z = 1 of the present camera, the last view the present
        one, and (L,) when that was.
    least_s : how long ago it began, at the least.
    """
    depth, variance, radius = depths_over_time(xy)
    drift_hz = _drift_hz(radius * focal_px)
    found = fit_braking(depth, variance, since_s, _WALKING_PART**2 * drift_hz, least_s)
    if found is None:
        return None
    steady_hz2 = (1.0 - _WALKING_PART**2) * drift_hz / _DRIFT_S
    return replace(found, cov=found.cov + np.diag([steady_hz2, 0.0]))


def braking_of_tracks(history: TrackHistory, members: Ints, least_s: float) -> Closing | None:
    """How it changes where it may have begun to brake just now; None without enough views."""
    return braking_of(*_views(history, members), history.focal_px, least_s)


def _views(history: TrackHistory, members: Ints) -> tuple[Floats, Floats]:
    """Places (L, M, 2) of some tracks (M,) in the plane z = 1 without rotation, and when these were, (L,) up to 0."""
    past = slice(0, history.n_past + 1)
    return history.xy[past].take(members, axis=1), history.since_s[past]


def _drift_hz(radius_px: float) -> float:
    """Variance of the size of a thing by what its matching errs by in common, gained in a second."""
    return (COMMON_ERROR_PX / max(radius_px, _LEAST_RADIUS_PX)) ** 2 / _DRIFT_S


def _seen_state(state: MotionState, nearer_hz: float, sigma_hz: float, *, is_contradicted: bool) -> MotionState:
    if abs(nearer_hz) < _SIGMAS_999 * sigma_hz:
        return MotionState.no_relative_motion if state == MotionState.constant_bearing else MotionState.unknown
    return MotionState.unknown if is_contradicted else state


def _radial_rates(rays: Floats, abc_hz: Floats, cov: Floats) -> tuple[list[float], list[float]]:
    """Rates at which distances along ``rays (K, 3)`` shrink, over themselves, and their standard deviations, 1/s."""
    along = rays / np.einsum("ki,ki->k", rays, rays)[:, None]
    variance = np.einsum("ki,kij,kj->k", along, cov, along)
    return (-np.einsum("ki,ki->k", along, abc_hz)).tolist(), np.sqrt(variance).tolist()


def radii_px(xy_px: Floats, rays: Floats, members: TrackSets, is_asked: Bools) -> Floats:
    """Root mean square distance (K,) of the tracks of each set from their centre, px; 0 without any, and if not asked.

    Points ``xy_px (N, 2)`` outside of what the lens maps have no ray (of ``rays (N, 3)``), and no part in it.
    ``is_asked (K,)``.
    """
    return members.radii(np.where(np.isfinite(rays[:, :1]), xy_px, np.nan), is_asked)


def _is_contradicted(
    state: MotionState, gap_s: float, grows: Sequence[float], said: tuple[float, float], radius_px: float
) -> bool:
    """Whether the picture of an object that is said to come nearer (go away) surely grows (shrinks) too little.

    The distances between its own points are blind to rotation, which the paths are not. ``grows`` and ``said`` are
    rates with their standard deviations.
    """
    grows_hz, sigma_hz = grows
    if not (math.isfinite(grows_hz) and math.isfinite(sigma_hz) and radius_px > 0.0):
        return False
    sigma_hz = math.hypot(sigma_hz, COMMON_ERROR_PX / (radius_px * gap_s))
    said_hz, said_sigma_hz = said
    side = 1.0 if state in APPROACHING else -1.0
    is_seen = side * grows_hz > _SIGMAS_95 * sigma_hz
    return not is_seen and side * (said_hz - grows_hz) > _SIGMAS_95 * math.hypot(sigma_hz, said_sigma_hz)
