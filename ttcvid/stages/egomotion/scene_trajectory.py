"""The trajectory of the static scene relative to the camera, refined by all views of its tracks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ttcvid.geometry.compiled import compiled_for
from ttcvid.geometry.estimation.shared_trajectory import PathBeliefs, SharedPaths, believed_paths, fit_shared_paths
from ttcvid.geometry.estimation.shared_trajectory_points import MOST_POINTS, points_of_paths
from ttcvid.geometry.rotation import each_turned_into_plane
from ttcvid.model import Bools, Floats
from ttcvid.stages.egomotion.relative_pose import Egomotion
from ttcvid.stages.tracking.history import ROTATION_DRIFT_RAD, TrackHistory

# The prior direction is believed to no better than this angle: it was fitted to some of the same views.
_BELIEF_FLOOR_RAD = float(np.radians(0.02))
# Own acceleration over own speed: 2 m/s^2 at 5 m/s. Across, the single steps have turned already.
_OWN_ALONG_HZ, _OWN_ACROSS_HZ = 0.4, 0.02
# Tracks that the path needs.
_LEAST_TRACKS = 12
# A track of the scene keeps to its direction over so many frames, within three sigmas (chi-square with one degree).
_GAP_FRAMES, _GATE_CHI2 = 5, 9.0


def with_scene_path(history: TrackHistory, is_free: Bools, egomotion: Egomotion) -> TrackHistory:
    """The history with the trajectory of the scene, as its whole tracks show it.

    The sum of single steps keeps three errors that two views cannot resolve: final direction, acceleration and rotation
    rate. All tracks share them. (The epipole stays that of two views, which follows a swinging direction more closely:
    0.07 against 0.13 deg. So do the steps: the next frame's trajectory has to be fitted to views, not to itself.)

    Parameters
    ----------
    history
        Views of all tracks.
    is_free
        ``(N,)`` tracks that are not frozen to their pixel.
    egomotion
        Of the last step. Without a direction there is no trajectory, and nothing changes.
    """
    if egomotion.direction is None or egomotion.direction_cov is None:
        return history
    used = np.flatnonzero(is_free & _follows(history, egomotion.direction))
    if len(used) < _LEAST_TRACKS:
        return history
    # Those that the fit would leave out need not be turned.
    used = used[:: -(-len(used) // MOST_POINTS)]
    belief = _belief(history, egomotion.direction, egomotion.direction_cov)
    path_of = np.zeros(len(used), dtype=np.int64)
    xy = each_turned_into_plane(history.rays, used, history.cam_R_seen[None], path_of)
    points = points_of_paths(xy, history.since_s, history.sigma_norm[used], belief.base, path_of)
    return replace(history, scene=fit_shared_paths(points, belief))


def scene_path(history: TrackHistory, direction: Floats, direction_cov: Floats) -> SharedPaths:
    """Trajectory of the scene: estimated from its tracks together, else the sum of the single steps."""
    if history.scene is not None:
        return history.scene
    return believed_paths(_belief(history, direction, direction_cov))


def _follows(history: TrackHistory, direction: Floats) -> Bools:
    """Tracks (N,) that have been there for some frames and have moved as the scene has: (N,)."""
    gap = min(_GAP_FRAMES, history.n_past)
    place, follows = history.now - gap, np.empty(history.n_tracks, dtype=bool)
    views = history.rays[place], history.rays[history.now], history.cam_R_seen[place]
    _compare_with_line(*views, direction, history.sigma_rad, gap * ROTATION_DRIFT_RAD, follows)
    return follows


@compiled_for("(f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[::1], f8[::1], f8, b1[::1])")
def _compare_with_line(
    first: Floats, now: Floats, cam_R_first: Floats, e: Floats, sigma: Floats, drift_rad: float, follows: Bools
) -> None:
    """Fills ``follows (N,)``: whether `geometry.paper.flow_line.flow_line_chi2` of the direction e is inside the gate.

    For rays ``first, now (N, 3)``, the first of which ``cam_R_first (3, 3)`` turns into the present camera.
    """
    for i in range(len(now)):
        x, y, z = first[i, 0], first[i, 1], first[i, 2]
        qx = cam_R_first[0, 0] * x + cam_R_first[0, 1] * y + cam_R_first[0, 2] * z
        qy = cam_R_first[1, 0] * x + cam_R_first[1, 1] * y + cam_R_first[1, 2] * z
        qz = cam_R_first[2, 0] * x + cam_R_first[2, 1] * y + cam_R_first[2, 2] * z
        px, py, pz = now[i, 0], now[i, 1], now[i, 2]
        p_along, q_along = px * e[0] + py * e[1] + pz * e[2], qx * e[0] + qy * e[1] + qz * e[2]
        mixed = px * qx + py * qy + pz * qz - p_along * q_along
        p_square, q_square = 1.0 - p_along * p_along, 1.0 - q_along * q_along
        difference = p_square - q_square
        largest = 0.5 * (p_square + q_square + np.sqrt(4.0 * mixed * mixed + difference * difference))
        triple = e[0] * (py * qz - pz * qy) + e[1] * (pz * qx - px * qz) + e[2] * (px * qy - py * qx)
        variance = sigma[i] * sigma[i] + drift_rad * drift_rad
        # Where something is not known, it is NaN, and no comparison holds.
        follows[i] = triple * triple < _GATE_CHI2 * variance * largest or largest <= 0.0


def _belief(history: TrackHistory, direction: Floats, direction_cov: Floats) -> PathBeliefs:
    across = np.eye(3) - np.outer(direction, direction)
    cov = direction_cov + _BELIEF_FLOOR_RAD**2 * across
    sigma_rad_s = history.rotation_rate_sigma_rad_s
    return PathBeliefs(
        history.scene_steps[None], direction[None], cov[None], _OWN_ALONG_HZ, _OWN_ACROSS_HZ, sigma_rad_s
    )
