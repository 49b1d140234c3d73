"""Bundle adjustment of a rigid body over a window of views of a known camera: every view's rotation and place.

Two views tell the direction of a short step badly, and a mean over longer gaps is not that of the last step of a camera
that sways. All views together give each step its own direction, with its own covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.geometry.estimation.bundle import N_POSE, N_SHARED, Bundle, BundleFit, Views, adjust_bundle
from ttcvid.geometry.estimation.rigid_motion import RigidPaths
from ttcvid.geometry.rotation import skew, tangent_basis
from ttcvid.model import Floats, Ints

# A step of the search that lowers the cost by less than this part is the last one: noise makes more.
_CONVERGED = 1e-3
_TINY = 1e-9


@dataclass(frozen=True)
class WindowFit:
    """A body over L views: its ``paths`` (one body), and its last step ``step (3,)`` in the present camera's axes.

    ``direction_cov (3, 3)`` of the direction of that step, rad^2, and ``rotation_cov (3, 3)`` of the rotation in it.
    """

    paths: RigidPaths
    step: Floats
    direction_cov: Floats
    rotation_cov: Floats


def adjust_window(
    xy: Floats, sigma_norm: Floats, region: Ints, paths: RigidPaths, point: Floats, n_steps: int
) -> WindowFit:
    """All views and points by robust least squares from a start; the length of the path is any.

    Parameters
    ----------
    xy : (L, N, 2) places in the plane z = 1 of each view's own camera, the present one last; NaN where not seen.
    sigma_norm, region : (N,) noise of one coordinate, and the part of the picture that each point lies in.
    paths : of the body over these views, a start.
    point : (N, 3) present place in the plane z = 1 and inverse depth of each point, a start.
    n_steps : at most so many steps.
    """
    frame, index = np.nonzero(np.isfinite(xy[..., 0]))
    rotation = paths.cam_R_past[0].transpose(0, 2, 1)
    place = (rotation @ paths.path[0][..., None])[..., 0]
    ray = np.column_stack([point[:, :2], np.ones(len(point))])
    length, known = np.linalg.norm(ray, axis=1), np.zeros(N_SHARED)
    start = Bundle(rotation, place, ray / length[:, None], point[:, 2] / length, known)
    views, present = Views(xy[frame, index], frame, index, region), len(xy) - 1
    fit = adjust_bundle(views, start, sigma_norm, (known, known), n_steps, reference=present, converged=_CONVERGED)
    return _with_covariances(fit)


def _with_covariances(fit: BundleFit) -> WindowFit:
    """The fit with the covariance of its last step.

    Points of one part of the picture err together, and a track errs the same way for long: the influences of a part's
    points on the direction are summed before they are squared (a cluster-robust "sandwich"), and the covariance is no
    smaller than they say. Six unknowns of a view are fitted to the parts.
    """
    place, back = fit.bundle.translation, fit.bundle.rotation.transpose(0, 2, 1)
    path = (back @ place[..., None])[..., 0]
    information, score = fit.information
    # The scale is free: the path keeps its length.
    scale = np.zeros((len(place) - 1, N_POSE))
    scale[:, 3:] = place[:-1] / max(float(np.linalg.norm(place)), _TINY)
    most = float(information.diagonal().max())
    information = information + most * (np.outer(scale, scale) + _TINY * np.eye(len(information)))
    of_step = np.linalg.inv(information)[:, -N_POSE:]
    cov = of_step[-N_POSE:]
    length = max(float(np.linalg.norm(path[-2])), _TINY)
    across = tangent_basis(path[-2] / length)
    by_step = across.T @ back[-2] @ np.concatenate([skew(place[-2]), np.eye(3)], axis=1) / length
    influence = score @ of_step @ by_step.T
    parts = np.stack([np.bincount(fit.region, column) for column in influence.T])
    n_parts = np.count_nonzero(np.bincount(fit.region))
    plain = by_step @ cov @ by_step.T
    more = 1.0
    if n_parts > 2 * N_POSE:
        together = parts @ parts.T * n_parts / (n_parts - N_POSE)
        more = max(1.0, 0.5 * float(np.trace(np.linalg.solve(plain, together))))
    turn = back[-2] @ cov[:3, :3] @ back[-2].T
    # The other way past points behind the camera looks the same: most of them lie ahead.
    path = -path if float(np.sign(fit.bundle.inverse).sum()) < 0.0 else path
    return WindowFit(
        RigidPaths(back[None], path[None]),
        -path[-2],
        np.asarray(more * across @ plain @ across.T),
        np.asarray(more * turn),
    )
