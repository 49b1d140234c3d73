"""The common error of the tracks of an object: by how much they may drift together.

The errors of an object's tracks are correlated: they drift together, where a codec moves a block by a part of a pixel
or an outline slides. Without relative motion the state fits that drift: at a red light the mean inverse time to
collision of 300 tracks of a resting car claims a fiftieth of the error of one track, and is wrong. And a part of the
scene that drifts is no mover, however many tracks agree on it.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.camera.pinhole import rays_from_pixels
from ttcvid.geometry.medians import medians
from ttcvid.model import Camera, Floats, Ints
from ttcvid.stages.tracking.tracker import COMMON_ERROR_PX

SIGMAS_999 = 3.090
"""Approach and recession are significant at 99.9 % (one side): 99 % of frames with ten objects have no false one."""
# The common error of tracks (`COMMON_ERROR_PX`) is that of a drift over at most this time, s.
_DRIFT_S = 0.6
# A drift by D, of standard deviation S, costs D^2 / (2 S^2). The mean square of its residuals in the scene, of one
# coordinate, is D^2 / 24 where it is steady and D^2 / 8 where it is a jump: the cost is 12 or 4 mean squares over S^2.
# Less than that, since blocks of strong compression jump by more than S = 0.25 px.
_DRIFT_FACTOR = 3.0
# Least root mean square radius of a set of tracks as a divisor, px.
_LEAST_RADIUS_PX = 1e-3


def common_covariances(ref_px: Floats, drift_hz: Floats, camera: Camera) -> Floats:
    """What the common errors of their tracks add to the covariances of the states (a, b, c) of K objects, 1/s^2.

    ``(K, 3, 3)``. ``ref_px (K, 2)`` are the reference points of the objects, ``drift_hz (K,)`` their
    `common_growth_hz`.
    """
    rays = rays_from_pixels(camera, ref_px)
    # An apparent expansion is an apparent velocity along the ray.
    return np.asarray(drift_hz[:, None, None] ** 2 * rays[:, :, None] * rays[:, None, :])


def drift_cost(residual_px2: Floats, thing: Ints, count: int, common_px: float) -> Floats:
    """Cost ``(K,)``, minus log likelihood, of explaining the residuals of K sets of tracks by a common drift of each.

    ``residual_px2 (M,)`` is the mean squared residual of a coordinate of each track in the scene, px^2, beyond its
    noise; ``thing (M,)`` the set that it is in. The median track of a set decides. Infinite for tracks without a common
    error, ``common_px`` 0, and for sets without tracks.
    """
    if not common_px > 0.0:
        return np.full(count, np.inf)
    cost = _DRIFT_FACTOR * medians(residual_px2, thing, count) / common_px**2
    return np.where(np.isnan(cost), np.inf, cost)


def common_growth_hz(
    radius_px: Floats, seen_s: Floats, least_s: float = 0.0, error_px: float = COMMON_ERROR_PX
) -> Floats:
    """Standard deviation ``(K,)`` of the expansion of objects by the common matching error of their tracks, 1/s.

    Their `TrackSets.radii` are ``radius_px (K,)``, and they are ``seen_s (K,)`` old; the expansion is measured over
    ``least_s`` at least, with an error of ``error_px`` at the outline.
    """
    looked_s = np.maximum(np.minimum(seen_s, _DRIFT_S), least_s)
    return np.asarray(error_px / (np.maximum(radius_px, _LEAST_RADIUS_PX) * looked_s))
