"""How far rigid things have gone and turned in the last step, where their ways before that are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.geometry.estimation.rigid_motion import PathFit, Points, RigidPaths, ways_of, weights_by_redchi
from ttcvid.geometry.kernels.rigid_points import NO_LENGTH, add_last_steps
from ttcvid.geometry.rotation import rotation_from_vector
from ttcvid.model import Floats

# The last step is its own length where there were two before it.
_LEAST_VIEWS = 3


@dataclass(frozen=True)
class StepPriors:
    """How the last steps of K things may leave what is expected: Gaussian.

    ``shift_sigma (K,)`` of where a thing was before it, per axis. ``turn_sigma_rad`` of how it has turned in it, about
    ``middle (K, 3)``, where that is now, from ``turned_rad (K, 3)`` beyond what its path says; None: as that says.
    """

    shift_sigma: Floats
    turned_rad: Floats | None = None
    turn_sigma_rad: float = 0.0
    middle: Floats | None = None


def with_newest_steps(
    points: Points, paths: RigidPaths, fit: PathFit, weight: Floats, priors: StepPriors
) -> RigidPaths:
    """The paths of K things, the last step of each corrected by all of its points, that are free to follow.

    A step that is wrong moves all past views alike. Where points and views are corrected in turn
    (`rigid_motion.refined_paths`), the points go along: each lies where most of its views have it, and one that began a
    moment ago fits any step. A scene before a camera that brakes would keep its speed, and what brakes or turns before
    it would lag behind.

    Parameters
    ----------
    points : M points of the things.
    paths : of the things, their last steps roughly known.
    fit : of the points on the paths.
    weight : (M,) of each point, 0 leaves it out.

    Source: weighted least squares for where a thing is now and how it is turned, as against all views before; the
    unknowns x, y, rho of each point are eliminated (Schur complement).
    """
    count, n_lanes = len(paths), points.rays.shape[2]
    weight, has_points = weights_by_redchi(points, fit, weight, count)
    if len(points.since_s) < _LEAST_VIEWS or not has_points.any():
        return paths
    middle, equations = np.zeros((count, 3)) if priors.middle is None else priors.middle, np.zeros((count, 7, 6))
    ways, of_point = ways_of(paths, n_lanes), (fit.place, fit.rate_hz, weight)
    add_last_steps(points.rays, points.track, points.thing, ways, points.sigma_norm, of_point, middle, equations)
    information, score = equations[:, :6], equations[:, 6]
    precision = np.maximum(priors.shift_sigma, NO_LENGTH)[:, None] ** -2.0
    information[:, [3, 4, 5], [3, 4, 5]] += precision
    path, cam_R_past = paths.path.copy(), paths.cam_R_past
    if priors.turned_rad is None:
        path[:, :-1] -= np.linalg.solve(information[:, 3:, 3:], score[:, 3:, None]).transpose(0, 2, 1)
        return RigidPaths(cam_R_past, path)
    information[:, [0, 1, 2], [0, 1, 2]] += priors.turn_sigma_rad**-2.0
    score[:, :3] += priors.turned_rad / priors.turn_sigma_rad**2
    # Unknowns are brought to one scale.
    scale = 1.0 / np.sqrt(np.diagonal(information, axis1=1, axis2=2))
    information *= scale[:, :, None] * scale[:, None]
    change = scale * np.linalg.solve(information, (scale * score)[..., None])[..., 0]
    turn = rotation_from_vector(change[:, :3])
    path[:, :-1] = (path[:, :-1] + middle[:, None]) @ turn.transpose(0, 2, 1) - (middle + change[:, 3:])[:, None]
    cam_R_past = cam_R_past.copy()
    cam_R_past[:, :-1] = turn[:, None] @ cam_R_past[:, :-1]
    return RigidPaths(cam_R_past, path)
