"""Rigid bodies seen by the camera, the static scene and movers: carried on, and refined by their tracks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ttcvid.geometry.estimation.pose_update import StepPriors, with_newest_steps
from ttcvid.geometry.estimation.rigid_motion import PathFit, PathPriors, Points, RigidPaths, fit_on_paths, refined_paths
from ttcvid.geometry.kernels.rigid_points import NO_LENGTH
from ttcvid.geometry.medians import medians
from ttcvid.geometry.rotation import vector_from_rotation
from ttcvid.model import Bools, Floats, Ints

# Own rotation is known from own motion; a frame corrects it by about this much, rad.
_SCENE_TURN_RAD = float(np.radians(0.05))
# A mover turns on its own by about this rate. Every body leaves a straight steady path by this part of its length a
# second (3 m/s^2 at 10 m/s): a car in a bend, a braking one. The floor is there at once.
_TURN_RATE_RAD_S, SHIFT_RATE_HZ, _SHIFT_FLOOR = float(np.radians(10.0)), 0.3, 0.02
# A body goes on as it did over so many views.
_STEADY_VIEWS = 5
# A velocity changes evenly for so long, s: a hand sways with periods of 2 to 5 s. Four leave scatter about three terms.
_EVEN_S, _LEAST_EVEN = 0.4, 4
ROUNDING_S = 1e-3
"""Presentation times are rounded to the clock of their container."""
# What moves by less than this of its distance a second is as far away as that, for its middle.
_LEAST_RATE_HZ = 0.01
# A turn prior needs some width at the present view too.
_LEAST_TIME_S = 1e-3


def carried_forward(bodies: RigidPaths, cam_R_prev: Floats, t_s: Floats, step: Floats | None = None) -> RigidPaths:
    """The bodies as the next camera sees them, their motions going on.

    Parameters
    ----------
    cam_R_prev : (3, 3) rotation from the last camera to this one.
    t_s : (L,) times of the views, the new one last.
    step : (3,) where the things were one step ago, if known; else they move on as they did.
    """
    n_past = len(t_s) - 1
    path, cam_R_past = np.zeros((len(bodies), len(t_s), 3)), np.empty((len(bodies), len(t_s), 3, 3))
    past = bodies.path[:, -n_past:] @ cam_R_prev.T
    if step is None:
        step = np.zeros(3)
        if past.shape[1] > 1:
            back = max(-1 - _STEADY_VIEWS, -past.shape[1])
            step = past[:, back, None] * ((t_s[-1] - t_s[-2]) / (t_s[-2] - t_s[back - 1]))
    path[:, :-1] = past + step
    cam_R_past[:, :-1], cam_R_past[:, -1] = cam_R_prev @ bodies.cam_R_past[:, -n_past:], np.eye(3)
    return RigidPaths(cam_R_past, path)


def recent_speed(path: Floats, t_s: Floats) -> float:
    """Speed over the last few of the views ``path (L, 3)`` at the times ``t_s (L,)``, in units of the path; 1 with a
    single view.
    """
    if len(path) < 2:
        return 1.0
    back = max(-1 - _STEADY_VIEWS, -len(path))
    return float(np.linalg.norm(path[back]) / (t_s[-1] - t_s[back]))


def direction_of_last_step(path: Floats, since_s: Floats) -> tuple[Floats, Floats] | None:
    """Direction of a body's last step and its covariance in the tangent plane, rad^2; None with too few views.

    A step alone is as long as the errors of its ends where it is short: a velocity that changes evenly is fitted to the
    views within `_EVEN_S` of the ``path (L, 3)``, whose scatter about it tells how well it is known.
    """
    n_views = max(_LEAST_EVEN, int(np.count_nonzero(since_s >= -_EVEN_S - ROUNDING_S)))
    if len(path) < n_views:
        return None
    powers = np.vander(since_s[-n_views:], 3, increasing=True)
    inverse = np.linalg.inv(powers.T @ powers)
    terms = inverse @ powers.T @ path[-n_views:]
    # Halfway through the step.
    slope = np.array([0.0, 1.0, since_s[-2]])
    velocity = slope @ terms
    speed = float(np.linalg.norm(velocity))
    if not speed > NO_LENGTH:
        return None
    direction, left = velocity / speed, path[-n_views:] - powers @ terms
    variance = float((left * left).sum()) / (3.0 * (n_views - 3)) * float(slope @ inverse @ slope) / speed**2
    return direction, variance * (np.eye(3) - np.outer(direction, direction))


def with_unit_speed(scene: RigidPaths, since_s: Floats) -> tuple[RigidPaths, float]:
    """The same body in units in which its mean speed over the views is 1, and by what its rates grow with that."""
    length = float(np.sqrt(np.einsum("li,li->l", scene.path[0], scene.path[0]).max()))
    if length < NO_LENGTH:
        return scene, 1.0
    speed = length / max(-since_s[0], _LEAST_TIME_S)
    return RigidPaths(scene.cam_R_past, scene.path / speed), speed


def refined_scene(
    scene: RigidPaths, points: Points, weight: Floats, in_scene: Bools, rate_hz: Floats, n_steps: int
) -> RigidPaths:
    """The scene's rotations and path, drawn towards what its points show.

    This is what makes rotation noise common to all tracks instead of each track's own (DESIGN section 3).

    Parameters
    ----------
    weight : (M,) of each point, 1 / sqrt(n) where it shares its part of the picture with n.
    in_scene : (M,) points of no known mover: these tell how far the last step was. (Past views are corrected by all: if
        pieces of the scene were taken for movers, it has to find them again.)
    rate_hz : (M,) of each point.
    """
    # Each part of the picture has the same say in the last step: a bus that is not known as a mover yet may fill half.
    unmoved = replace(points, track=points.track[in_scene], thing=points.thing[in_scene])
    fit = fit_on_paths(unmoved, scene, rate_hz[in_scene])
    scene = with_newest_steps(unmoved, scene, fit, weight[in_scene] ** 2, StepPriors(_mean_step(scene.path, points)))
    turn_sigma = np.full(len(points.since_s), _SCENE_TURN_RAD)
    priors = PathPriors(None, turn_sigma, _own_shift_sigma(points.since_s, scene.path[0]))
    return refined_paths(points, scene, priors, np.array([n_steps]), weight, rate_hz)[0]


def _mean_step(path: Floats, points: Points) -> Floats:
    """Mean length of the steps of each ``path (K, L, 3)``, over the last one's time: (K,); 0 with a single view."""
    length = np.sqrt((path * path).sum(axis=2).max(axis=1))
    return np.asarray(length * (points.since_s[-2] / points.since_s[0] if len(points.since_s) > 1 else 0.0))


def refined_movers(
    movers: RigidPaths, scene: RigidPaths, points: Points, n_steps: Ints, start_hz: Floats | None = None
) -> tuple[RigidPaths, Floats]:
    """The turns and paths of movers by their own points, and the median rate of these, (K,); 0 without any.

    Beside the scene's views theirs may turn a little. ``n_steps (K,)`` of each mover, ``start_hz (M,)`` rates to start
    from; None or NaN: none.
    """
    shift_sigma = _SHIFT_FLOOR - SHIFT_RATE_HZ * points.since_s
    priors = PathPriors(scene.cam_R_past[0], _turn_sigma_rad(points.since_s), shift_sigma)
    movers, rate_hz = refined_paths(points, movers, priors, n_steps, rate_hz=start_hz)
    median_hz = medians(rate_hz, points.thing, len(movers))
    return movers, np.where(np.isnan(median_hz), 0.0, median_hz)


def stepped_movers(
    movers: RigidPaths, scene: RigidPaths, points: Points, n_steps: Ints, rate_hz: Floats
) -> tuple[RigidPaths, Floats]:
    """Movers of the last frame, carried on, as their points show them now; their ``rate_hz (K,)`` before, and now.

    First the last step, by all points at once: nothing else is new, and it takes no turns of points and views, in which
    the points go along with a step that is wrong. Then all views, in turn (`refined_movers`).
    """
    fit = fit_on_paths(points, movers, rate_hz[points.thing])
    middle = _middles(points, fit, len(movers))
    turned = vector_from_rotation(scene.cam_R_past[:, -2] @ movers.cam_R_past[:, -2].transpose(0, 2, 1))
    # Where the middle of each was, less where it is now, in the axes of the scene.
    turn = movers.cam_R_past @ scene.cam_R_past.transpose(0, 1, 3, 2)
    ways = np.einsum("klji,klj->kli", turn, middle[:, None] + movers.path) - middle[:, None]
    priors = StepPriors(_mean_step(ways, points), turned, float(_turn_sigma_rad(points.since_s)[-2]), middle)
    stepped = with_newest_steps(points, movers, fit, np.ones(len(points.track)), priors)
    return refined_movers(stepped, scene, points, n_steps, fit.rate_hz)


def _middles(points: Points, fit: PathFit, count: int) -> Floats:
    """Where the middle of the points of each thing is now, (K, 3), by medians; 0 of one without any."""
    x, y = (medians(fit.place[:, axis], points.thing, count) for axis in (0, 1))
    depth = 1.0 / np.maximum(medians(fit.rate_hz, points.thing, count), _LEAST_RATE_HZ)
    middle = np.stack([x * depth, y * depth, depth], axis=1)
    return np.where(np.isnan(middle), 0.0, middle)


def _turn_sigma_rad(since_s: Floats) -> Floats:
    """How far a mover may have turned beside the scene since each view (L,)."""
    return np.asarray(_TURN_RATE_RAD_S * np.maximum(-since_s, _LEAST_TIME_S))


def _own_shift_sigma(since_s: Floats, path: Floats) -> Floats:
    """What of its length (L,) each view of the scene's ``path (L, 3)`` may lie off a steady one to the farthest view.

    Own speed may fall to nothing within the views, or start from it: the last steps then differ from the mean by all of
    it. A part of their own length would hold on to it the more tightly the slower we are.
    """
    part, length = since_s / min(since_s[0], -_LEAST_TIME_S), np.sqrt((path * path).sum(axis=1))
    usual = np.maximum(part * length[0], length) + NO_LENGTH
    return np.asarray((_SHIFT_FLOOR + 1.0 - part) * usual / (length + NO_LENGTH))
