"""What movers did since the last frame, by all of their tracks at once."""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.estimation.pose_update import StepPriors, with_newest_steps
from ttcvid.geometry.estimation.rigid_motion import PathFit, Points, RigidPaths, fit_on_paths
from ttcvid.geometry.medians import medians
from ttcvid.geometry.rotation import vector_from_rotation
from ttcvid.model import Floats, Ints
from ttcvid.stages.segmentation.bodies import mean_step, refined_movers, turn_sigma_rad

# What moves by less than this of its distance a second is as far away as that, for its middle.
_LEAST_RATE_HZ = 0.01


def stepped_movers(
    movers: RigidPaths, scene: RigidPaths, points: Points, n_steps: Ints, rate_hz: Floats
) -> tuple[RigidPaths, Floats]:
    """Movers of the last frame, carried on, as their points show them now; their ``rate_hz (K,)`` before, and now.

    First the last step, by all points at once: nothing else is new, and it takes no turns of points and views, in which
    the points go along with a step that is wrong. Then all views, in turn (`refined_movers`).
    """
    if len(points.since_s) < 2:
        return refined_movers(movers, scene, points, n_steps)
    fit = fit_on_paths(points, movers, rate_hz[points.thing])
    middle = _middles(points, fit, len(movers))
    turned = vector_from_rotation(scene.cam_R_past[:, -2] @ movers.cam_R_past[:, -2].transpose(0, 2, 1))
    length = mean_step(_ways_of_middles(movers, scene, middle), points)
    priors = StepPriors(length, turned, float(turn_sigma_rad(points.since_s)[-2]), middle)
    stepped = with_newest_steps(points, movers, fit, np.ones(len(points.track)), priors)
    return refined_movers(stepped, scene, points, n_steps, fit.rate_hz)


def _middles(points: Points, fit: PathFit, count: int) -> Floats:
    """Where the middle of the points of each thing is now, (K, 3), by medians; 0 of one without any."""
    x, y = (medians(fit.place[:, axis], points.thing, count) for axis in (0, 1))
    depth = 1.0 / np.maximum(medians(fit.rate_hz, points.thing, count), _LEAST_RATE_HZ)
    middle = np.stack([x * depth, y * depth, depth], axis=1)
    return np.where(np.isnan(middle), 0.0, middle)


def _ways_of_middles(movers: RigidPaths, scene: RigidPaths, middle: Floats) -> Floats:
    """Where ``middle (K, 3)`` of each mover was, less where it is now, in the axes of the scene: (K, L, 3)."""
    turn = movers.cam_R_past @ scene.cam_R_past.transpose(0, 1, 3, 2)
    return np.asarray(np.einsum("klji,klj->kli", turn, middle[:, None] + movers.path) - middle[:, None])
