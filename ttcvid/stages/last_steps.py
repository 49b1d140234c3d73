"""What movers did since the last frame, by all of their tracks at once; and movers begun anew that went astray."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ttcvid.geometry.medians import medians
from ttcvid.geometry.newest_step import StepPriors, with_newest_steps
from ttcvid.geometry.rigid_path import PathFit, Points, RigidPaths, fit_on_paths
from ttcvid.geometry.rotation import vector_from_rotation
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.bodies import mean_step, refined_movers, turn_sigma_rad

# A mover is begun anew where it has turned by more than this part of what movers turn by, since there is no other way
# to turn nearly as little, and its path explains its points worse than this, over the usual misfit. So many steps of
# refinement: with half of them the misfit of a bus that turns by 25 deg/s is still twice as large. The new way has to
# be better by the factor: of two that fit alike, one is better by chance.
_LEAST_TURN, _BADLY, _ANEW_STEPS, _CLEARLY = 0.3, 1.0, 12, 1.5
# What moves by less than this of its distance a second is as far away as that, for its middle.
_LEAST_RATE_HZ = 0.01


def stepped_movers(
    movers: RigidPaths, scene: RigidPaths, points: Points, n_steps: Ints, rate_hz: Floats
) -> tuple[RigidPaths, Floats]:
    """Movers of the last frame, carried on, as their points show them now.

    First the last step, by all points at once: nothing else is new, and it takes no turns of points and views, in which
    the points go along with a step that is wrong. Then all views, in turn.

    Parameters
    ----------
    n_steps : (K,) of refinement of each mover, after that.
    rate_hz : (K,) usual rate of each.

    Returns
    -------
    The movers, and the median rate of the points of each, (K,); 0 without any.
    """
    if len(points.since_s) < 2:
        return refined_movers(movers, scene, points, n_steps)
    fit = fit_on_paths(points, movers, rate_hz[points.thing])
    middle = _middles(points, fit, len(movers))
    turned = vector_from_rotation(scene.cam_R_past[:, -2] @ movers.cam_R_past[:, -2].transpose(0, 2, 1))
    priors = StepPriors(
        mean_step(_ways_of_middles(movers, scene, middle), points),
        turned,
        float(turn_sigma_rad(points.since_s)[-2]),
        middle,
    )
    stepped = with_newest_steps(points, movers, fit, np.ones(len(points.track)), priors)
    return refined_movers(stepped, scene, points, n_steps, fit.rate_hz)


def begun_anew(
    movers: RigidPaths, rate_hz: Floats, scene: RigidPaths, points: Points, usual_misfit: float
) -> tuple[RigidPaths, Floats]:
    """The movers, those that explain their points badly as if they had not turned, where that explains them better.

    What is small in the picture looks nearly alike turned one way, and turned the other way with near and far exchanged
    (Necker's reversal). Which it was shows when it is near; from the wrong one no small step leads to the other.

    Parameters
    ----------
    rate_hz : (K,) usual rate of each.
    usual_misfit : of tracks on the scene's path: their chi-square over its degrees of freedom.

    Returns
    -------
    The movers, and the rates (K,) that are usual on them.
    """
    turned = vector_from_rotation(movers.cam_R_past[:, 0] @ scene.cam_R_past[:, 0].transpose(0, 2, 1))
    has_turned = np.sqrt((turned * turned).sum(axis=1)) > _LEAST_TURN * turn_sigma_rad(points.since_s)[0]
    if not has_turned.any():
        return movers, rate_hz
    fit, points = _fit_on_some(points, movers, rate_hz, has_turned)
    misfit = medians(fit.misfit, points.thing, len(movers))
    # NaN, without points, is not worse.
    is_bad = misfit > _BADLY * usual_misfit
    if not is_bad.any():
        return movers, rate_hz
    still = _ways_of_middles(movers, scene, _middles(points, fit, len(movers)))
    paths = RigidPaths(np.repeat(scene.cam_R_past, len(movers), axis=0), still)
    anew, anew_hz = refined_movers(paths, scene, points, np.where(is_bad, _ANEW_STEPS, 0))
    anew_fit, points = _fit_on_some(points, anew, anew_hz, is_bad)
    is_better = medians(anew_fit.misfit, points.thing, len(movers)) < misfit / _CLEARLY
    cam_R_past = np.where(is_better[:, None, None, None], anew.cam_R_past, movers.cam_R_past)
    path = np.where(is_better[:, None, None], anew.path, movers.path)
    return RigidPaths(cam_R_past, path), np.where(is_better, anew_hz, rate_hz)


def _fit_on_some(points: Points, movers: RigidPaths, rate_hz: Floats, is_asked: Bools) -> tuple[PathFit, Points]:
    """The points of those of the movers ``is_asked (K,)``, fitted, and these."""
    own = np.flatnonzero(is_asked[points.thing])
    points = replace(points, track=points.track[own], thing=points.thing[own])
    return fit_on_paths(points, movers, rate_hz[points.thing]), points


def _middles(points: Points, fit: PathFit, count: int) -> Floats:
    """Where the middle of the points of each thing is now, (K, 3), by medians; 0 of one without any."""
    x, y = (medians(fit.place[:, axis], points.thing, count) for axis in (0, 1))
    depth = 1.0 / np.maximum(medians(fit.rate_hz, points.thing, count), _LEAST_RATE_HZ)
    middle = np.stack([x * depth, y * depth, depth], axis=1)
    return np.where(np.isnan(middle), 0.0, middle)


def _ways_of_middles(movers: RigidPaths, scene: RigidPaths, middle: Floats) -> Floats:
    """Where ``middle (K, 3)`` of each mover was, less where it is now, in the axes of the scene: (K, L, 3)."""
    turn = movers.cam_R_past @ scene.cam_R_past.transpose(0, 1, 3, 2)
    way = np.einsum("klji,klj->kli", turn, middle[:, None] + movers.path) - middle[:, None]
    return np.asarray(way)
