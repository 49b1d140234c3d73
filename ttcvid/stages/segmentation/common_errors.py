"""The common error of the tracks of an object: by how much they may drift together.

The errors of an object's tracks are correlated: they drift together. Without relative motion the state fits that drift:
at a red light the mean inverse time to collision of 300 tracks of a resting car claims a fiftieth of the error of one
track, and is wrong.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ttcvid.geometry.camera.pinhole import rays_from_pixels
from ttcvid.geometry.estimation.closing import Closing, depths_over_time, fit_braking
from ttcvid.model import Camera, Floats, Ints
from ttcvid.stages.tracking.groups import TrackSets
from ttcvid.stages.tracking.history import TrackHistory
from ttcvid.stages.tracking.tracker import COMMON_ERROR_PX

SIGMAS_999 = 3.090
"""Approach and recession are significant at 99.9 % (one side): 99 % of frames with ten objects have no false one."""
# The common error of tracks (`COMMON_ERROR_PX`) is that of a drift over at most this time, s.
_DRIFT_S = 0.6
# This share of the drift is a random walk, which looks like a change of speed; the rest is steady. From one car with
# lidar truth (kitti_sfnd_ttc), whose accelerations err by about half of what the whole drift would give.
_WALKING_PART = 0.5
# Least root mean square radius of a set of tracks as a divisor, px.
_LEAST_RADIUS_PX = 1e-3


def common_covariances(
    ref_px: Floats,
    members: TrackSets,
    radius_px: Floats,
    age_s: Floats,
    gap_s: float,
    error_px: float,
    camera: Camera,
) -> Floats:
    """What the common error of its tracks adds to the covariance of each of K states: ``(K, 3, 3)``, 1/s^2.

    ``ref_px (K, 2)`` are the reference points of the objects, ``members, radius_px (K,)`` their tracks and
    `TrackSets.radii`, ``age_s (N,)`` the age of each track, ``gap_s`` the time over which expansions are measured,
    ``error_px`` the `PointSet.common_error_px`.
    """
    if not len(ref_px):
        return np.empty((0, 3, 3))
    rays = rays_from_pixels(camera, ref_px)
    drift_hz = common_growth_hz(radius_px, members.medians(age_s[members.index]), gap_s, error_px)
    # An apparent expansion is an apparent velocity along the ray.
    return np.asarray(drift_hz[:, None, None] ** 2 * rays[:, :, None] * rays[:, None, :])


def common_growth_hz(
    radius_px: Floats, seen_s: Floats, least_s: float = 0.0, error_px: float = COMMON_ERROR_PX
) -> Floats:
    """Standard deviation ``(K,)`` of the expansion of objects by the common matching error of their tracks, 1/s.

    Their `TrackSets.radii` are ``radius_px (K,)``, and they are ``seen_s (K,)`` old; the expansion is measured over
    ``least_s`` at least, with an error of ``error_px`` at the outline.
    """
    looked_s = np.maximum(np.minimum(seen_s, _DRIFT_S), least_s)
    return np.asarray(error_px / (np.maximum(radius_px, _LEAST_RADIUS_PX) * looked_s))


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
