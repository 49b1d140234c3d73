"""False corners that two surfaces of the scene make together, one behind the other.

Where the outline of a post crosses a line of the wall behind it, the picture has a corner that is a point of neither. A
tracker follows it well, and it moves as nothing in the scene does: it slides along both.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.estimation.rigid_motion import PathFit, RigidPaths
from ttcvid.model import Bools, Floats, Ints

# Views of a track whose depth counts; a surface is as near or as far as is sure by so many standard deviations.
_LEAST_VIEWS, _SIGMAS = 3, 2.0
# A point may have been nearer than now (driving backwards), but never at the camera.
_LEAST_DEPTH_RATIO = 0.05


def between_surfaces(scene: RigidPaths, fit: PathFit, is_static: Bools, track: Ints, beside: Ints, xy: Floats) -> Bools:
    """Which tracks (M,) may be corners of two surfaces of the scene at different depths: both are seen beside them.

    A window that sees both moves as ``H^-1 (H_1 v_1 + H_2 v_2)`` with their gradient matrices, ``H = H_1 + H_2``, and
    their flows. What has a say in both is in no order of size, so that v need not lie between v_1 and v_2: for two
    outlines at right angles it lies on the circle with ends v_1 and v_2 (Thales), for others farther off. Allowed is
    twice that circle. A track outside of it moves by itself.

    Parameters
    ----------
    fit : of all N tracks on the path of the scene; ``is_static (N,)`` those that it explains.
    track, beside : (M,) the tracks asked about, and their neighbours (M, K), themselves where there is none.
    xy : (L, M, 2) their places in the plane z = 1 of the present camera.
    """
    rate, sigma = fit.rate_hz, fit.rate_sigma_hz
    is_known = is_static & (fit.n_views >= _LEAST_VIEWS) & np.isfinite(rate)
    counts = is_known[beside] & (beside != track[:, None])
    near_hz = np.where(counts, rate[beside] - _SIGMAS * sigma[beside], -np.inf).max(axis=1)
    far_hz = np.where(counts, rate[beside] + _SIGMAS * sigma[beside], np.inf).min(axis=1)
    are_two = (near_hz > far_hz) & (far_hz > 0.0) & np.isfinite(near_hz)
    oldest = np.argmax(np.isfinite(xy[:, :, 0]), axis=0)
    since = scene.path[0][oldest]

    def was(rate_hz: Floats) -> Floats:
        """Where a point with this rate was in the oldest view of each track: (M, 2)."""
        rho = np.where(are_two, rate_hz, 0.0)[:, None]
        return np.asarray((xy[-1] + rho * since[:, :2]) / np.maximum(1.0 + rho * since[:, 2:], _LEAST_DEPTH_RATIO))

    near, far = was(near_hz), was(far_hz)
    off = np.linalg.norm(xy[oldest, np.arange(len(track))] - 0.5 * (near + far), axis=1)
    return np.asarray(are_two & (off < np.linalg.norm(near - far, axis=1)))
