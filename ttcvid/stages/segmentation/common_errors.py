"""Whether an object approaches or recedes significantly beyond the tracker's common error, and expands accordingly.

The errors of an object's tracks are correlated: they drift together. Without relative motion the state fits that drift:
at a red light the mean inverse time to collision of 300 tracks of a resting car claims a fiftieth of the error of one
track, and is wrong.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ttcvid.geometry.camera.pinhole import rays_from_pixels
from ttcvid.geometry.estimation.closing import Closing, depths_over_time, fit_braking
from ttcvid.geometry.paper.expansion import expansion_of_neighbourhood
from ttcvid.model import APPROACHING, Camera, ClusterRow, Floats, Ints, MotionState
from ttcvid.stages.tracking.groups import TrackSets
from ttcvid.stages.tracking.history import TrackHistory
from ttcvid.stages.tracking.tracker import COMMON_ERROR_PX

SIGMAS_999 = 3.090
"""Approach and recession are significant at 99.9 % (one side): 99 % of frames with ten objects have no false one."""
# Expansion is contradicted, or significant, at 95 % (one side).
_SIGMAS_95 = 1.645
# The common error of tracks (`COMMON_ERROR_PX`) is that of a drift over at most this time, s.
_DRIFT_S = 0.6
# This share of the drift is a random walk, which looks like a change of speed; the rest is steady. From one car with
# lidar truth (kitti_sfnd_ttc), whose accelerations err by about half of what the whole drift would give.
_WALKING_PART = 0.5
# Least root mean square radius of a set of tracks as a divisor, px.
_LEAST_RADIUS_PX = 1e-3


@dataclass(frozen=True)
class CommonViews:
    """Rays ``(N, 3)`` of all N tracks before and after a common gap (NaN: not observed), and the gap in s."""

    first: Floats
    now: Floats
    gap_s: float

    def expansions(self, members: Sequence[Ints]) -> tuple[Floats, Floats]:
        """Expansion of each of K sets of tracks and its standard deviation: ``(K,)`` each, 1/s; NaN where unknown."""
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
    """The K rows with the common error of the tracks of an object added to the covariance of its state.

    ``members, radius_px (K,)`` are tracks of the rows and their `TrackSets.radii`, ``age_s (N,)`` the age of each
    track, ``gap_s`` that of `CommonViews`, ``error_px`` the `PointSet.common_error_px`.
    """
    stated = [k for k, row in enumerate(rows) if row.state_cov is not None]
    if not stated:
        return rows
    rays = rays_from_pixels(camera, np.array([rows[k].ref_px for k in stated]))
    has_state = np.zeros(len(rows), dtype=bool)
    has_state[stated] = True
    of_stated, _ = members.where(has_state[members.set_of])
    drift_hz = common_growth_hz(radius_px[stated], of_stated.medians(age_s[of_stated.index]), gap_s, error_px)
    # An apparent expansion is an apparent velocity along the ray.
    common = drift_hz[:, None, None] ** 2 * rays[:, :, None] * rays[:, None, :]
    rows = list(rows)
    for k, cov in zip(stated, common, strict=True):
        rows[k] = rows[k].changed(state_cov=rows[k].state_cov + cov)
    return rows


def common_growth_hz(
    radius_px: Floats, seen_s: Floats, least_s: float = 0.0, error_px: float = COMMON_ERROR_PX
) -> Floats:
    """Standard deviation ``(K,)`` of the expansion of objects by the common matching error of their tracks, 1/s.

    Their `TrackSets.radii` are ``radius_px (K,)``, and they are ``seen_s (K,)`` old; the expansion is measured over
    ``least_s`` at least, with an error of ``error_px`` at the outline.
    """
    looked_s = np.maximum(np.minimum(seen_s, _DRIFT_S), least_s)
    return np.asarray(error_px / (np.maximum(radius_px, _LEAST_RADIUS_PX) * looked_s))


def with_seen_motion(
    rows: list[ClusterRow], radius_px: Floats, growth: tuple[Floats, Floats], gap_s: float, camera: Camera
) -> list[ClusterRow]:
    """The K rows; an approach or recession that is not significant, or that the expansion contradicts, is unknown.

    ``growth`` are `CommonViews.expansions` of their tracks, over the time ``gap_s``; ``radius_px (K,)`` their
    `TrackSets.radii`.
    """
    asked = [k for k, row in enumerate(rows) if row.motion_state in {*APPROACHING, MotionState.receding}]
    if not asked:
        return rows
    rays = rays_from_pixels(camera, np.array([rows[k].ref_px for k in asked]))
    abc_hz, cov = np.array([rows[k].state_abc_hz for k in asked]), np.array([rows[k].state_cov for k in asked])
    nearer_hz, sigma_hz = _radial_rates(rays, abc_hz, cov)
    grows, said = np.column_stack(growth).tolist(), np.column_stack([-abc_hz[:, 2], np.sqrt(cov[:, 2, 2])]).tolist()
    seen = list(rows)
    for i, k in enumerate(asked):
        is_contradicted = _is_contradicted(rows[k].motion_state, gap_s, grows[k], said[i], float(radius_px[k]))
        state = _seen_state(rows[k].motion_state, nearer_hz[i], sigma_hz[i], is_contradicted=is_contradicted)
        if state != rows[k].motion_state:
            seen[k] = rows[k].changed(motion_state=state)
    return seen


def braking_of(xy: Floats, since_s: Floats, focal_px: float, least_s: float) -> Closing | None:
    """Change of the depth of an object that may have begun to brake within the views; None with too few views.

    Parameters
    ----------
    xy : ``(L, M, 2)`` observations of its tracks in the plane z = 1 of the present camera; the last view is now.
    since_s : ``(L,)`` times of the views, s, up to 0.
    least_s : least time since the beginning, s.
    """
    depth, variance, radius = depths_over_time(xy)
    # Variance of the log size by the common matching error, gained per second.
    drift_hz = (COMMON_ERROR_PX / max(radius * focal_px, _LEAST_RADIUS_PX)) ** 2 / _DRIFT_S
    found = fit_braking(depth, variance, since_s, _WALKING_PART**2 * drift_hz, least_s)
    if found is None:
        return None
    steady_hz2 = (1.0 - _WALKING_PART**2) * drift_hz / _DRIFT_S
    return replace(found, cov=found.cov + np.diag([steady_hz2, 0.0]))


def braking_of_tracks(history: TrackHistory, members: Ints, least_s: float) -> Closing | None:
    """As `braking_of`, for some of the tracks, ``members (M,)``."""
    past = slice(0, history.n_past + 1)
    return braking_of(history.xy[past].take(members, axis=1), history.since_s[past], history.focal_px, least_s)


def _seen_state(state: MotionState, nearer_hz: float, sigma_hz: float, *, is_contradicted: bool) -> MotionState:
    if abs(nearer_hz) < SIGMAS_999 * sigma_hz:
        return MotionState.no_relative_motion if state == MotionState.constant_bearing else MotionState.unknown
    return MotionState.unknown if is_contradicted else state


def _radial_rates(rays: Floats, abc_hz: Floats, cov: Floats) -> tuple[list[float], list[float]]:
    """Relative rates at which the distances along ``rays (K, 3)`` decrease, and their standard deviations, 1/s."""
    along = rays / np.einsum("ki,ki->k", rays, rays)[:, None]
    variance = np.einsum("ki,kij,kj->k", along, cov, along)
    return (-np.einsum("ki,ki->k", along, abc_hz)).tolist(), np.sqrt(variance).tolist()


def _is_contradicted(
    state: MotionState, gap_s: float, grows: Sequence[float], said: Sequence[float], radius_px: float
) -> bool:
    """Whether an object that is said to approach (recede) expands (shrinks) significantly less than that.

    Distances between points are invariant to camera rotation, unlike the trajectories. ``grows`` (expansion) and
    ``said`` (inverse time to collision) are rates in 1/s with their standard deviations.
    """
    grows_hz, sigma_hz = grows
    if not (math.isfinite(grows_hz) and math.isfinite(sigma_hz) and radius_px > 0.0):
        return False
    sigma_hz = math.hypot(sigma_hz, COMMON_ERROR_PX / (radius_px * gap_s))
    said_hz, said_sigma_hz = said
    side = 1.0 if state in APPROACHING else -1.0
    is_seen = side * grows_hz > _SIGMAS_95 * sigma_hz
    return not is_seen and side * (said_hz - grows_hz) > _SIGMAS_95 * math.hypot(sigma_hz, said_sigma_hz)
