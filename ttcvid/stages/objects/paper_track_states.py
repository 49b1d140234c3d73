"""Directions and states of every track, by the paper's two-frame and three-frame estimators."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ttcvid.config import CollisionTimesConfig
from ttcvid.geometry.estimation.shared_trajectory import N_SHARED
from ttcvid.geometry.paper.planar import planar_epipole
from ttcvid.geometry.paper.three_frames import three_frame_direction
from ttcvid.geometry.paper.two_view_state import rate_from_direction, state_from_direction
from ttcvid.geometry.rotation import cross, tangent_basis
from ttcvid.model import NO_CLUSTER, SCENE_CLUSTER, Floats, Ints, Status
from ttcvid.stages.egomotion.flows import Flows, scene_directions, select_flows
from ttcvid.stages.egomotion.relative_pose import DIRECTION_FLOOR_RAD
from ttcvid.stages.horizon.planar_motion import HorizonPlane
from ttcvid.stages.objects.motions import FrameMotions
from ttcvid.stages.objects.states import SharedErrors, TrackStates, has_value
from ttcvid.stages.tracking.history import TrackHistory

# Step of the numerical derivatives of the three-frame solution, in sigmas of the points.
_DERIVATIVE_STEP_SIGMAS = 0.3


def track_directions(
    history: TrackHistory, motions: FrameMotions, plane: HorizonPlane | None, config: CollisionTimesConfig
) -> tuple[Flows, Floats, Floats, Ints]:
    """Each track's flow, and its ``dir`` over that: its cluster's, or with a horizon its own.

    Of the directions ``(N, 3)``, NaN where there is none, also the covariances ``(N, 3, 3)``, and why there is none.
    """
    flows, clusters = select_flows(history, config.max_gap_frames, config.target_flow_px), motions.clusters
    along_scene, n = scene_directions(history, flows), history.n_tracks
    direction, covariance = np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan)
    status = np.full(n, Status.no_epipole, dtype=np.int64)
    if plane is not None:
        views = flows.first, flows.second
        direction, covariance, status = planar_epipole(*views, plane.normal, flows.sigma_rad, plane.covariance)
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
    taken = place > 0
    direction[taken], covariance[taken] = ways[place[taken]], covs[place[taken]]
    # The scene's direction has changed over a gap; with a horizon the present one, corrected, stands for all.
    is_followed = (plane is None) & np.isfinite(ways[:, 0]) & (ids == SCENE_CLUSTER)
    in_scene = is_followed[place]
    direction[in_scene] = along_scene[in_scene]
    return flows, direction, covariance, status


def two_frame_states(flows: Flows, direction: Floats, direction_cov: Floats) -> TrackStates:
    """States from two views and the epipole of each track's cluster (the paper's (2) and (3)).

    The covariance holds the error of the rotation over the gap: it moves the first view, ds = (q x ds/dq) . omega.
    ``direction (N, 3)`` is NaN where a track has none, ``direction_cov (N, 3, 3)`` in rad^2.
    """
    sigma_norm = _sigma_norm(flows)
    views = flows.first, flows.second
    state, cov, status = state_from_direction(*views, direction, flows.gap_s, sigma_norm, direction_cov)
    q, r = flows.first / flows.first[:, 2:], flows.second / flows.second[:, 2:]
    rate_hz, by_q, by_r, by_e = rate_from_direction(q, r, direction, flows.gap_s)
    by_rotation = cross(q, by_q)
    variance = flows.rotation_error_rad**2 * np.sum(by_rotation**2, axis=1)
    cov_abc = cov[:, 2:, 2:] + variance[:, None, None] * np.einsum("ni,nj->nij", direction, direction)
    own = sigma_norm**2 * np.sum(by_q[:, :2] ** 2 + by_r[:, :2] ** 2, axis=1)
    states = _states(flows, state[:, 2:], cov_abc, direction, status)
    # Each track has a gap of its own, but what is wrong with a direction is wrong for all that have it.
    _, first, path_of = np.unique(direction, axis=0, return_index=True, return_inverse=True)
    jacobian = np.zeros((len(direction), 3, N_SHARED))
    jacobian[:, :, :3] = direction[:, :, None] * by_e[:, None, :] + rate_hz[:, None, None] * np.eye(3)
    jacobian[:, :, 6:9] = direction[:, :, None] * (flows.rotation_error_rad[:, None] * by_rotation)[:, None, :]
    shared_cov = np.zeros((len(first), N_SHARED, N_SHARED))
    shared_cov[:, :3, :3], shared_cov[:, 6:9, 6:9] = direction_cov[first], np.eye(3)
    path_of = np.where(np.isfinite(direction[:, 0]), path_of, -1)
    errors, no_turns = (rate_hz, own, jacobian, shared_cov), np.zeros((len(first), 3))
    return replace(states, shared=SharedErrors(path_of, direction[first], *errors, no_turns))


def three_frame_states(history: TrackHistory, flows: Flows) -> TrackStates:
    """States from three views, each track with an epipole of its own (the paper's (6)).

    The middle view lies half-way in the gap of `Flows`, which is at least two steps here.
    """
    gap = np.where(flows.has_flow, np.maximum(flows.gap_frames, 2), 0)
    last = len(history.frame) - 1
    rays = np.stack([_rays_at(history, last - gap), _rays_at(history, last - gap // 2), flows.second])
    t_s = history.t_s[np.stack([np.maximum(last - gap, 0), last - gap // 2, np.full_like(gap, last)])]
    gap_1, gap_2 = t_s[1] - t_s[0], t_s[2] - t_s[1]

    def solve(views: Floats) -> tuple[Floats, Floats, Ints]:
        direction, _, status = three_frame_direction(views, gap_1, gap_2, flows.sigma_rad)
        ends = views[0], views[2]
        state, _, two_status = state_from_direction(*ends, direction, gap_1 + gap_2, _sigma_norm(flows), None)
        return state[:, 2:], direction, np.where(np.isfinite(direction[:, 0]), two_status, status)

    abc_hz, direction, status = solve(rays)
    cov = np.zeros((len(abc_hz), 3, 3))
    step = (_DERIVATIVE_STEP_SIGMAS * flows.sigma_rad)[:, None]
    # Across each ray: along x or y one far off the axis would turn by less than the step.
    across = tangent_basis(rays)
    for view in range(3):
        for axis in range(2):
            offset = np.zeros_like(rays)
            offset[view] = step * across[view, :, :, axis]
            slope = (solve(rays + offset)[0] - solve(rays - offset)[0]) / (2.0 * step)
            cov += np.einsum("ni,nj->nij", slope, slope) * (flows.sigma_rad**2)[:, None, None]
    return _states(flows, abc_hz, cov, direction, status)


def _states(flows: Flows, abc_hz: Floats, cov: Floats, direction: Floats, status: Ints) -> TrackStates:
    xy = flows.second[:, :2] / flows.second[:, 2:]
    # A number of which nobody can say how sure it is is none: three views within noise of a degenerate case.
    is_known = np.isfinite(abc_hz).all(axis=1) & np.isfinite(cov).all(axis=(1, 2))
    status = np.where(~is_known & has_value(status), Status.no_parallax, status)
    is_known &= has_value(status)
    abc_hz = np.where(is_known[:, None], abc_hz, np.nan)
    cov = np.where(is_known[:, None, None], cov, np.nan)
    return TrackStates(xy, abc_hz, cov, _sigma_norm(flows), direction, status)


def _sigma_norm(flows: Flows) -> Floats:
    """Noise of normalised coordinates: the angle's, divided by cos^1.5 as in `TrackHistory.sigma_rad`."""
    return np.asarray(flows.sigma_rad / np.clip(flows.second[:, 2], 0.1, 1.0) ** 1.5)


def _rays_at(history: TrackHistory, entry: Ints) -> Floats:
    """Derotated ray of each track at its own entry of the history: (N, 3), NaN before its first."""
    place = np.maximum(entry, 0)
    rays = np.einsum("nij,nj->ni", history.cam_R_past[place], history.rays[place, np.arange(history.n_tracks)])
    return np.where((entry >= 0)[:, None], rays, np.nan)
