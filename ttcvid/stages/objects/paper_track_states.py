"""State and times of every track, by the paper's two-frame and three-frame estimators."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ttcvid.geometry.estimation.intervals import collision_times_from_state
from ttcvid.geometry.estimation.shared_trajectory import N_SHARED
from ttcvid.geometry.paper.collision import angles_from_epipoles
from ttcvid.geometry.paper.expansion import expansion_of_neighbourhood
from ttcvid.geometry.paper.three_frames import three_frame_direction
from ttcvid.geometry.paper.two_view_state import rate_from_direction, state_from_direction
from ttcvid.geometry.rotation import cross, normalize, tangent_basis
from ttcvid.model import Bools, CollisionTimes, Floats, Ints, Status
from ttcvid.stages.egomotion.flows import Flows
from ttcvid.stages.tracking.history import TrackHistory

# Step of the numerical derivatives of the three-frame solution, in sigmas of the points.
_DERIVATIVE_STEP_SIGMAS = 0.3
EXPANSION_NEIGHBOURS = 8
"""Tracks around a point, itself among them, whose expansion is that of its surroundings."""
# An expansion is taken for one above so many of its standard deviations.
_EXPANSION_SIGMAS = 3.0
# As plain numbers, with which arrays are compared in a third of the time.
_OK, _AT_INFINITY = int(Status.ok), int(Status.epipole_at_infinity)


@dataclass(frozen=True)
class SharedErrors:
    """What is a track's own in the error of its (a, b, c), and what it shares with others of its path.

    ``path_of (N,)`` the path of each track, negative for none; ``along (K, 3)`` the direction in which the noise of a
    track's own views counts; ``rate_hz (N,)`` speed along the path over depth, with ``rate_variance (N,)``, 1/s^2, by
    that noise; ``jacobian (N, 3, 9)`` of (a, b, c) and ``rate_jacobian (N, 9)`` of the rates by the shared unknowns, in
    the order of `shared_trajectory`, and their covariance ``cov (K, 9, 9)``; ``turn_rad_s (K, 3)`` how the things on
    them turn themselves.
    """

    path_of: Ints
    along: Floats
    rate_hz: Floats
    rate_variance: Floats
    jacobian: Floats
    rate_jacobian: Floats
    cov: Floats
    turn_rad_s: Floats


def nothing_shared(n: int) -> SharedErrors:
    """Of N tracks of which each has a direction of its own."""
    return SharedErrors(
        np.full(n, -1),
        np.zeros((1, 3)),
        np.zeros(n),
        np.zeros(n),
        np.zeros((n, 3, N_SHARED)),
        np.zeros((n, N_SHARED)),
        np.zeros((1, N_SHARED, N_SHARED)),
        np.zeros((1, 3)),
    )


@dataclass(frozen=True)
class TrackStates:
    """States of N tracks: ``xy (N, 2)`` normalised, ``abc_hz (N, 3)`` = V / Z with ``cov (N, 3, 3)`` in 1/s^2.

    ``sigma_norm (N,)`` noise of x and y, ``direction (N, 3)`` the track's ``dir``, ``status (N,)``. NaN: no result.
    ``shared`` says what of the covariance of tracks with one direction is common to them; None where each has its own.
    """

    xy: Floats
    abc_hz: Floats
    cov: Floats
    sigma_norm: Floats
    direction: Floats
    status: Ints
    shared: SharedErrors | None = None

    @property
    def has_value(self) -> Bools:
        """Tracks with a result: (N,)."""
        return has_value(self.status)

    @property
    def alpha_rad(self) -> Floats:
        """Angle between the ray and ``-dir``: (N,) in [0, pi], NaN where there is no direction."""
        return angles_from_epipoles(np.column_stack([self.xy, np.ones(len(self.xy))]), self.direction)

    def with_status(self, status: Ints) -> TrackStates:
        """The same states with other reasons."""
        return replace(self, status=status)

    def without(self, index: Bools, status: Ints) -> TrackStates:
        """No result for the tracks of ``index (N,)``, for the reason ``status (N,)``."""
        if not index.any():
            return self
        gone = index[:, None]
        return replace(
            self,
            abc_hz=np.where(gone, np.nan, self.abc_hz),
            cov=np.where(gone[..., None], np.nan, self.cov),
            direction=np.where(gone, np.nan, self.direction),
            status=np.where(index, status, self.status),
        )

    def times(self) -> CollisionTimes:
        """The three times with their intervals: N rows."""
        x, y = self.xy.T
        return collision_times_from_state(x, y, self.abc_hz, self.cov, self.sigma_norm)


def has_value(status: Ints) -> Bools:
    """Which of the tracks with ``status (N,)`` have a result: (N,)."""
    return np.asarray((status == _OK) | (status == _AT_INFINITY))


def two_frame_states(flows: Flows, direction: Floats, direction_cov: Floats) -> TrackStates:
    """States from two views and the epipole of each track's cluster (the paper's (2) and (3)).

    The covariance holds the error of the rotation over the gap: it moves the first view, ds = (q x ds/dq) . omega.

    Parameters
    ----------
    direction : (N, 3), NaN where a track has none.
    direction_cov : (N, 3, 3) rad^2.
    """
    sigma_norm = _sigma_norm(flows)
    state, cov, status = state_from_direction(
        flows.first, flows.second, direction, flows.gap_s, sigma_norm, direction_cov
    )
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
    jacobian[:, :, 6:] = direction[:, :, None] * (flows.rotation_error_rad[:, None] * by_rotation)[:, None, :]
    shared_cov = np.zeros((len(first), N_SHARED, N_SHARED))
    shared_cov[:, :3, :3], shared_cov[:, 6:, 6:] = direction_cov[first], np.eye(3)
    rate_jacobian = np.sum(direction[:, :, None] * jacobian, axis=1)
    path_of = np.where(np.isfinite(direction[:, 0]), path_of, -1)
    shared = SharedErrors(
        path_of,
        direction[first],
        rate_hz,
        own,
        jacobian,
        rate_jacobian,
        shared_cov,
        np.zeros((len(first), 3)),
    )
    return replace(states, shared=shared)


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
        state, _, two_status = state_from_direction(
            views[0], views[2], direction, gap_1 + gap_2, _sigma_norm(flows), None
        )
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


def with_constant_bearing(
    states: TrackStates, history: TrackHistory, neighbours: Ints, gap_frames: int, may_expand: Bools
) -> TrackStates:
    """Give tracks without a flow of their own the time of the expansion around them (the paper's section 2.1).

    The expansion gives c = V_z / Z, the point's own flow, however small, the sideways part of V.

    Parameters
    ----------
    neighbours : (N, m) indices of tracks of the same cluster around each track, negative: absent.
    gap_frames : steps of the history over which the expansion is measured.
    may_expand : (N,) tracks that are asked (at the epipole, or without parallax).
    """
    asked = np.flatnonzero(may_expand)
    if not len(asked) or gap_frames < 1:
        return states
    past_rays, gap_s = history.derotated(history.now - gap_frames), -history.since_s[history.now - gap_frames]
    eta_hz, sigma_hz = expansion_of_neighbourhood(past_rays, history.rays[history.now], neighbours[asked], gap_s)
    sigma_hz = np.maximum(sigma_hz, _expansion_noise_hz(states, neighbours[asked], gap_s))
    past = past_rays[asked]
    is_sure = (eta_hz > _EXPANSION_SIGMAS * sigma_hz) & (past[:, 2] > 0.0)
    asked, eta_hz, sigma_hz, past = asked[is_sure], eta_hz[is_sure], sigma_hz[is_sure], past[is_sure]
    xy, stretch = states.xy[asked], 1.0 + eta_hz * gap_s
    # x_past = (x - a T) / (1 - c T) with c = -eta, solved for a; y and b likewise.
    w = np.column_stack([(xy - past[:, :2] / past[:, 2:] * stretch[:, None]) / gap_s, -eta_hz])
    # What the expansion errs by moves a point along its ray; across, its own noise does.
    ray = np.column_stack([xy, np.ones(len(xy))])
    across_hz2 = 2.0 * (states.sigma_norm[asked] / gap_s) ** 2
    abc_hz, cov = states.abc_hz.copy(), states.cov.copy()
    direction, status = states.direction.copy(), states.status.copy()
    abc_hz[asked], direction[asked], status[asked] = w, normalize(w), Status.ok
    cov[asked] = (sigma_hz**2)[:, None, None] * ray[:, :, None] * ray[:, None, :]
    cov[asked] += across_hz2[:, None, None] * np.diag([1.0, 1.0, 0.0])
    shared = states.shared
    if shared is not None:
        # On a path they are no longer.
        path_of = shared.path_of.copy()
        path_of[asked] = -1
        shared = replace(shared, path_of=path_of)
    return replace(states, abc_hz=abc_hz, cov=cov, direction=direction, status=status, shared=shared)


def _expansion_noise_hz(states: TrackStates, neighbours: Ints, gap_s: float) -> Floats:
    """What the noise of the tracks alone does to the expansion of each neighbourhood (Q, m): (Q,), else infinite.

    By the noisiest of each neighbourhood, over its size. The residuals of the similarity may be smaller by chance, or
    where pictures repeat exactly.
    """
    is_there = neighbours >= 0
    count = np.maximum(np.sum(is_there, axis=1), 1)
    xy = np.where(is_there[..., None], states.xy[neighbours], 0.0)
    off = np.where(is_there[..., None], xy - (np.sum(xy, axis=1) / count[:, None])[:, None], 0.0)
    sigma = np.max(np.where(is_there, states.sigma_norm[neighbours], 0.0), axis=1)
    size = np.sqrt(np.sum(off**2, axis=(1, 2)))
    noise_hz: Floats = np.divide(np.sqrt(2.0) * sigma, size * gap_s, out=np.full(len(size), np.inf), where=size > 0.0)
    return noise_hz


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
    sigma: Floats = flows.sigma_rad / np.clip(flows.second[:, 2], 0.1, 1.0) ** 1.5
    return sigma


def _rays_at(history: TrackHistory, entry: Ints) -> Floats:
    """Derotated ray of each track at its own entry of the history: (N, 3), NaN before its first."""
    column = np.arange(history.n_tracks)
    place = np.maximum(entry, 0)
    rays = np.einsum("nij,nj->ni", history.cam_R_past[place], history.rays[place, column])
    return np.where((entry >= 0)[:, None], rays, np.nan)
