"""Rigid bodies seen by the camera: the static scene and every mover, each with its own relative path."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ttcvid.geometry.rigid_path import PathFit, corrected_views, fit_on_path
from ttcvid.geometry.rotation import rotation_from_vector, turned_into_plane, vector_from_rotation
from ttcvid.model import Floats

# Own rotation is known from own motion; a frame corrects it by about this much, rad.
_SCENE_TURN_RAD = float(np.radians(0.05))
# A mover turns on its own by about this rate. Every body leaves a straight steady path by this part of its length a
# second (3 m/s^2 at 10 m/s): a car in a bend, a braking one. The floor is there at once.
_TURN_RATE_RAD_S, _SHIFT_RATE_HZ, _SHIFT_FLOOR = float(np.radians(10.0)), 0.3, 0.02
# A body goes on as it did over so many views.
_STEADY_VIEWS = 5
# A turn prior needs some width at the present view too.
_LEAST_TIME_S = 1e-3
# Weight of a point falls to a half where its misfit is twice the typical one, which counts as this at the least.
_HALF_WEIGHT, _LEAST_TYPICAL_MISFIT = 2.0, 0.25
# Paths shorter than this have no scale to keep.
_NO_LENGTH = 1e-9


@dataclass(frozen=True)
class Body:
    """A rigid thing over the L views of the history, up to the scale of its path.

    ``cam_R_past (L, 3, 3)`` turns a ray of view l into the present camera as if the thing had not turned since;
    ``path (L, 3)`` is where it was, less where it is now, in s of its speed; ``rate_hz`` the median rate of its points.
    """

    cam_R_past: Floats
    path: Floats
    rate_hz: float = 0.0

    def fit(self, rays: Floats, sigma_norm: Floats, rate_hz: Floats | None, least_rate_hz: float) -> PathFit:
        """How well the body's motion explains points of ``rays (L, N, 3)``."""
        return fit_on_path(turned_into_plane(rays, self.cam_R_past), self.path, sigma_norm, rate_hz, least_rate_hz)


def carried_forward(body: Body, cam_R_prev: Floats, t_s: Floats, step: Floats | None = None) -> Body:
    """The body as the next camera sees it, its motion going on.

    Parameters
    ----------
    cam_R_prev : (3, 3) rotation from the last camera to this one.
    t_s : (L,) times of the views, the new one last.
    step : (3,) where the thing was one step ago, if known; else it moves on as it did.
    """
    n_past = len(t_s) - 1
    path = body.path[-n_past:] @ cam_R_prev.T
    if step is None:
        step = np.zeros(3)
        if len(path) > 1:
            back = max(-1 - _STEADY_VIEWS, -len(path))
            step = path[back] * (t_s[-1] - t_s[-2]) / (t_s[-2] - t_s[back - 1])
    return replace(
        body,
        cam_R_past=np.concatenate([cam_R_prev @ body.cam_R_past[-n_past:], np.eye(3)[None]]),
        path=np.concatenate([path + step, np.zeros((1, 3))]),
    )


def recent_speed(body: Body, t_s: Floats) -> float:
    """Speed over the last few of the views at the times ``t_s (L,)``, in units of the path; 1 with a single view."""
    if len(body.path) < 2:
        return 1.0
    back = max(-1 - _STEADY_VIEWS, -len(body.path))
    return float(np.linalg.norm(body.path[back]) / (t_s[-1] - t_s[back]))


def with_unit_speed(body: Body, since_s: Floats, rate_hz: Floats) -> tuple[Body, Floats]:
    """The same body, and the rates of points on it, in units in which its mean speed over the views is 1."""
    length = float(np.linalg.norm(body.path[0]))
    if length < _NO_LENGTH:
        return body, rate_hz
    speed = length / max(-since_s[0], _LEAST_TIME_S)
    return replace(body, path=body.path / speed), rate_hz * speed


def refined_scene(
    scene: Body, rays: Floats, sigma_norm: Floats, weight: Floats, rate_hz: Floats, since_s: Floats, n_steps: int
) -> Body:
    """The scene's rotations and path, drawn towards what its points show.

    This is what makes rotation noise common to all tracks instead of each track's own (DESIGN section 3).

    Parameters
    ----------
    rays : (L, N, 3) unit rays, each in the camera of its view; ``sigma_norm, weight, rate_hz (N,)``.
    since_s : (L,) times relative to the present view, s.
    """
    turn_sigma, not_turned = np.full(len(since_s), _SCENE_TURN_RAD), np.zeros((len(since_s), 3))
    for _ in range(n_steps):
        scene, rate_hz = _refined_once(scene, rays, sigma_norm, weight, rate_hz, since_s, not_turned, turn_sigma)
    return scene


def refined_mover(mover: Body, scene: Body, rays: Floats, sigma_norm: Floats, since_s: Floats, n_steps: int) -> Body:
    """A mover's turns and path by its own points ``rays (L, M, 3)``; beside the scene's it may turn a little.

    Parameters
    ----------
    since_s : (L,) times relative to the present view, s.
    """
    turn_sigma = _TURN_RATE_RAD_S * np.maximum(-since_s, _LEAST_TIME_S)
    weight, rate_hz = np.ones(rays.shape[1]), np.full(rays.shape[1], np.nan)
    for _ in range(n_steps):
        turned = vector_from_rotation(scene.cam_R_past @ np.swapaxes(mover.cam_R_past, 1, 2))
        mover, rate_hz = _refined_once(mover, rays, sigma_norm, weight, rate_hz, since_s, turned, turn_sigma)
    known = rate_hz[np.isfinite(rate_hz)]
    return replace(mover, rate_hz=float(np.median(known)) if len(known) else 0.0)


def _refined_once(
    body: Body,
    rays: Floats,
    sigma_norm: Floats,
    weight: Floats,
    rate_hz: Floats,
    since_s: Floats,
    turned_rad: Floats,
    turn_sigma_rad: Floats,
) -> tuple[Body, Floats]:
    """Points on the path, then the views by the points; the path keeps its length."""
    xy = turned_into_plane(rays, body.cam_R_past)
    fit = fit_on_path(xy, body.path, sigma_norm, rate_hz)
    is_used = (weight > 0.0) & (fit.n_views > 1)
    if not is_used.any():
        return body, rate_hz
    typical = max(float(np.median(fit.misfit[is_used])), _LEAST_TYPICAL_MISFIT)
    weight = np.where(is_used, weight / (1.0 + fit.misfit / (_HALF_WEIGHT * typical)), 0.0)
    shifted = body.path - np.outer(since_s / min(since_s[0], -_LEAST_TIME_S), body.path[0])
    shift_sigma = _SHIFT_FLOOR - _SHIFT_RATE_HZ * since_s
    turn_rad, shift = corrected_views(
        xy, body.path, fit, sigma_norm, weight, turned_rad, shifted, turn_sigma_rad, shift_sigma
    )
    path = body.path + shift
    before, after = np.linalg.norm(body.path[0]), np.linalg.norm(path[0])
    if min(before, after) > _NO_LENGTH:
        path = path * (before / after)
    # By way of rotation vectors: products that go on for ever would cease to be rotations.
    turned = rotation_from_vector(vector_from_rotation(rotation_from_vector(-turn_rad) @ body.cam_R_past))
    return replace(body, cam_R_past=turned, path=path), fit.rate_hz
