"""The trajectory of the static scene relative to the camera, refined by all views of its tracks."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ttcvid.geometry.estimation.shared_trajectory import CHANGE_SIGMA_HZ2, PathBeliefs, believed_paths, fit_paths
from ttcvid.geometry.estimation.shared_trajectory_points import MOST_POINTS, points_of_paths
from ttcvid.geometry.paper.flow_line import flow_line_chi2
from ttcvid.geometry.rotation import each_turned_into_plane
from ttcvid.model import Bools, Floats, Platform
from ttcvid.stages.egomotion.relative_pose import MOTION_PRIORS, Egomotion
from ttcvid.stages.tracking.history import ROTATION_DRIFT_RAD, TrackHistory

# The prior direction is believed to no better than this angle: it was fitted to some of the same views.
_BELIEF_FLOOR_RAD = float(np.radians(0.02))
# Tracks that the path needs.
_LEAST_TRACKS = 12
# A track of the scene keeps to its direction over so many frames, within three sigmas (chi-square with one degree).
_GAP_FRAMES, _GATE_CHI2 = 5, 9.0


@dataclass(frozen=True)
class _Steadiness:
    """How steadily a camera moves, beyond what its single steps have told already.

    Standard deviations of its acceleration over its speed, 1/s, ``along_hz`` and per axis ``across_hz`` its direction,
    and ``change_hz2`` of how that changes, per axis, 1/s^2. These unknowns describe its path for ``window_s``.
    """

    along_hz: float
    across_hz: float
    change_hz2: float
    window_s: float


# A car brakes with 2 m/s^2 at 5 m/s. Across, the single steps have turned already.
_DRIVEN = _Steadiness(0.4, 0.02, CHANGE_SIGMA_HZ2, np.inf)
# A hand sways within T = 2 s or more: its acceleration is about 2 pi / T of its speed, that of its acceleration again;
# over T / 4 these describe its path. Its single steps are short, and noisy.
_HELD = _Steadiness(2.0, 0.5, 10.0, 0.5)


def with_scene_path(history: TrackHistory, is_free: Bools, egomotion: Egomotion, platform: Platform) -> TrackHistory:
    """The history with the trajectory of the scene, as its whole tracks show it.

    The sum of single steps keeps three errors that two views cannot resolve: final direction, acceleration and rotation
    rate. All tracks share them. (The epipole stays that of two views, which follows a swinging direction more closely:
    0.07 against 0.13 deg. So do the steps: the next frame's trajectory has to be fitted to views, not to itself.)
    Where few tracks follow it, the steps and what they leave open are the trajectory. Views are NaN in it over which a
    camera in free motion changes its speed in ways that it has no unknowns for.

    Nothing changes without a direction of the last step, ``egomotion``. ``is_free (N,)`` tracks not frozen to a pixel.
    """
    if egomotion.direction is None or egomotion.direction_cov is None:
        return history
    steadiness = _HELD if MOTION_PRIORS[platform].is_open else _DRIVEN
    belief = _belief(history, egomotion.direction, egomotion.direction_cov, steadiness)
    used = np.flatnonzero(is_free & _follows(history, egomotion.direction))
    if len(used) < _LEAST_TRACKS:
        return replace(history, scene=believed_paths(belief))
    # Those that the fit would leave out need not be turned.
    used = used[:: -(-len(used) // MOST_POINTS)]
    path_of = np.zeros(len(used), dtype=np.int64)
    xy = each_turned_into_plane(history.rays, used, history.cam_R_seen[None], path_of)
    points = points_of_paths(xy, history.since_s, history.sigma_norm[used], belief.base, path_of)
    return replace(history, scene=fit_paths(points, belief).paths())


def _follows(history: TrackHistory, direction: Floats) -> Bools:
    """Tracks (N,) that have been there for some frames and have moved as the scene has: (N,)."""
    gap = min(_GAP_FRAMES, history.n_past)
    sigma_rad = np.hypot(history.sigma_rad, gap * ROTATION_DRIFT_RAD)
    before, now = history.derotated(history.now - gap), history.rays[history.now]
    return np.asarray(flow_line_chi2(direction, before, now, sigma_rad) < _GATE_CHI2)


def _belief(history: TrackHistory, direction: Floats, direction_cov: Floats, steadiness: _Steadiness) -> PathBeliefs:
    across = np.eye(3) - np.outer(direction, direction)
    cov = direction_cov + _BELIEF_FLOOR_RAD**2 * across
    steps, views = np.full((len(history.t_s), 3), np.nan), history.views_within(steadiness.window_s)
    steps[views] = history.scene_steps[views]
    of_path = steps[None], direction[None], cov[None], steadiness.along_hz, steadiness.across_hz
    return PathBeliefs(*of_path, history.rotation_rate_sigma_rad_s, change_sigma_hz2=steadiness.change_hz2)
