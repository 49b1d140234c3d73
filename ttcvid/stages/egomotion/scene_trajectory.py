"""The trajectory of the static scene relative to the camera, refined by all views of its tracks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ttcvid.geometry.estimation.shared_trajectory import PathBeliefs, SharedPaths, believed_paths, fit_paths
from ttcvid.geometry.estimation.shared_trajectory_points import MOST_POINTS, points_of_paths
from ttcvid.geometry.paper.flow_line import flow_line_chi2
from ttcvid.geometry.rotation import each_turned_into_plane
from ttcvid.model import Bools, Floats, Platform
from ttcvid.stages.egomotion.motion_prior import MOTION_PRIORS
from ttcvid.stages.egomotion.relative_pose import Egomotion
from ttcvid.stages.tracking.history import ROTATION_DRIFT_RAD, TrackHistory

# The prior direction is believed to no better than this angle: it was fitted to some of the same views.
_BELIEF_FLOOR_RAD = float(np.radians(0.02))
# Own acceleration over own speed: 2 m/s^2 at 5 m/s. Across, the single steps have turned already.
_OWN_ALONG_HZ, _OWN_ACROSS_HZ = 0.4, 0.02
# Tracks that the path needs.
_LEAST_TRACKS = 12
# A hand sways within T = 2 s or more, with accelerations of 2 pi / T times its speed, and changes of the square of that
# times it. Over T / 4 these describe its path, if so many views are that near. Across, noisy steps have turned already.
_SWAY_ALONG_HZ, _SWAY_ACROSS_HZ, _SWAY_CHANGE_HZ2, _SWAY_WINDOW_S, _LEAST_VIEWS = 3.0, 0.5, 10.0, 0.5, 4
# A track of the scene keeps to its direction over so many frames, within three sigmas (chi-square with one degree).
_GAP_FRAMES, _GATE_CHI2 = 5, 9.0


def with_scene_path(history: TrackHistory, is_free: Bools, egomotion: Egomotion, platform: Platform) -> TrackHistory:
    """The history with the trajectory of the scene, as its whole tracks show it.

    The sum of single steps keeps three errors that two views cannot resolve: final direction, acceleration and rotation
    rate. All tracks share them. (The epipole stays that of two views, which follows a swinging direction more closely:
    0.07 against 0.13 deg. So do the steps: the next frame's trajectory has to be fitted to views, not to itself.)

    A camera in free motion has the path of a hand, over a shorter time, NaN at views farther away. One that moves
    steadily is known less well so. But to choose by how steady the views look would make intervals too narrow.

    Nothing changes where ``egomotion`` has no direction. ``is_free (N,)`` tracks not frozen to a pixel.
    """
    if egomotion.direction is None or egomotion.direction_cov is None:
        return history
    used = np.flatnonzero(is_free & _follows(history, egomotion.direction))
    if len(used) < _LEAST_TRACKS:
        return history
    # Those that the fit would leave out need not be turned.
    used = used[:: -(-len(used) // MOST_POINTS)]
    belief = _belief(history, egomotion.direction, egomotion.direction_cov)
    if MOTION_PRIORS[platform].is_open:
        belief = _swaying(history, belief)
    path_of = np.zeros(len(used), dtype=np.int64)
    xy = each_turned_into_plane(history.rays, used, history.cam_R_seen[None], path_of)
    points = points_of_paths(xy, history.since_s, history.sigma_norm[used], belief.base, path_of)
    return replace(history, scene=fit_paths(points, belief).paths())


def _swaying(history: TrackHistory, belief: PathBeliefs) -> PathBeliefs:
    """The belief in the path of a hand, at near views; as it is, where these are too few."""
    is_near = np.abs(history.since_s) <= _SWAY_WINDOW_S + 0.5 * history.step_s
    if np.count_nonzero(is_near) < _LEAST_VIEWS:
        return belief
    return replace(
        belief,
        base=np.where(is_near[:, None], belief.base, np.nan),
        along_sigma_hz=_SWAY_ALONG_HZ,
        across_sigma_hz=_SWAY_ACROSS_HZ,
        change_sigma_hz2=_SWAY_CHANGE_HZ2,
    )


def scene_path(history: TrackHistory, direction: Floats, direction_cov: Floats) -> SharedPaths:
    """Trajectory of the scene: estimated from its tracks together, else the sum of the single steps."""
    if history.scene is not None:
        return history.scene
    return believed_paths(_belief(history, direction, direction_cov))


def _follows(history: TrackHistory, direction: Floats) -> Bools:
    """Tracks (N,) that have been there for some frames and have moved as the scene has: (N,)."""
    gap = min(_GAP_FRAMES, history.n_past)
    sigma_rad = np.hypot(history.sigma_rad, gap * ROTATION_DRIFT_RAD)
    before, now = history.derotated(history.now - gap), history.rays[history.now]
    return np.asarray(flow_line_chi2(direction, before, now, sigma_rad) < _GATE_CHI2)


def _belief(history: TrackHistory, direction: Floats, direction_cov: Floats) -> PathBeliefs:
    across = np.eye(3) - np.outer(direction, direction)
    cov = direction_cov + _BELIEF_FLOOR_RAD**2 * across
    steps, turn_rad_s = history.scene_steps, history.rotation_rate_sigma_rad_s
    return PathBeliefs(steps[None], direction[None], cov[None], _OWN_ALONG_HZ, _OWN_ACROSS_HZ, turn_rad_s)
