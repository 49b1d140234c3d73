"""Rigid bodies seen by the camera: the static scene and every mover, each with its own relative path."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ttcvid.geometry.medians import medians
from ttcvid.geometry.rigid_path import PathFit, corrected_views, fit_on_paths
from ttcvid.geometry.rotation import each_turned_into_plane, turned_further, vector_from_rotation
from ttcvid.model import Floats, Ints

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


@dataclass(frozen=True)
class Points:
    """M points, each of one of K bodies: which of the N tracks and which body, ``track, body (M,)``.

    ``rays (L, N, 3)`` unit rays of the tracks, each in the camera of its view, NaN where not observed; ``sigma_norm
    (N,)`` their noise; ``since_s (L,)`` times relative to the present view, s.
    """

    rays: Floats
    sigma_norm: Floats
    since_s: Floats
    track: Ints
    body: Ints

    def in_plane(self, bodies: Sequence[Body]) -> Floats:
        """Where the points were seen, as if their bodies had not turned: (L, M, 2) in the plane z = 1."""
        return each_turned_into_plane(self.rays, self.track, _stacked(bodies)[0], self.body)

    def fit(self, bodies: Sequence[Body], rate_hz: Floats | None, least_rate_hz: float | Floats = 0.0) -> PathFit:
        """How well the motions of their bodies explain the points."""
        cam_R_past, path = _stacked(bodies)
        xy = each_turned_into_plane(self.rays, self.track, cam_R_past, self.body)
        return fit_on_paths(xy, path, self.body, self.sigma_norm[self.track], rate_hz, least_rate_hz)


def carried_forward(bodies: Sequence[Body], cam_R_prev: Floats, t_s: Floats, step: Floats | None = None) -> list[Body]:
    """The bodies as the next camera sees them, their motions going on.

    Parameters
    ----------
    cam_R_prev : (3, 3) rotation from the last camera to this one.
    t_s : (L,) times of the views, the new one last.
    step : (3,) where the things were one step ago, if known; else they move on as they did.
    """
    if not bodies:
        return []
    n_past = len(t_s) - 1
    past_R, past = _stacked(bodies)
    path, cam_R_past = np.zeros((len(bodies), len(t_s), 3)), np.empty((len(bodies), len(t_s), 3, 3))
    past = past[:, -n_past:] @ cam_R_prev.T
    if step is None:
        step = np.zeros(3)
        if past.shape[1] > 1:
            back = max(-1 - _STEADY_VIEWS, -past.shape[1])
            step = past[:, back, None] * ((t_s[-1] - t_s[-2]) / (t_s[-2] - t_s[back - 1]))
    path[:, :-1] = past + step
    cam_R_past[:, :-1], cam_R_past[:, -1] = cam_R_prev @ past_R[:, -n_past:], np.eye(3)
    return [
        replace(body, cam_R_past=turned, path=moved)
        for body, turned, moved in zip(bodies, cam_R_past, path, strict=True)
    ]


def recent_speed(body: Body, t_s: Floats) -> float:
    """Speed over the last few of the views at the times ``t_s (L,)``, in units of the path; 1 with a single view."""
    if len(body.path) < 2:
        return 1.0
    back = max(-1 - _STEADY_VIEWS, -len(body.path))
    return float(np.linalg.norm(body.path[back]) / (t_s[-1] - t_s[back]))


def with_unit_speed(body: Body, since_s: Floats, rate_hz: Floats) -> tuple[Body, Floats]:
    """The same body, and the rates of points on it, in units in which its mean speed over the views is 1."""
    length = float(np.sqrt(np.max(np.sum(body.path**2, axis=1))))
    if length < _NO_LENGTH:
        return body, rate_hz
    speed = length / max(-since_s[0], _LEAST_TIME_S)
    return replace(body, path=body.path / speed), rate_hz * speed


def refined_scene(scene: Body, points: Points, weight: Floats, rate_hz: Floats, n_steps: int) -> Body:
    """The scene's rotations and path, drawn towards what its points show.

    This is what makes rotation noise common to all tracks instead of each track's own (DESIGN section 3).

    Parameters
    ----------
    weight, rate_hz : (M,) of each point.
    """
    n_views = len(points.since_s)
    turn_sigma, not_turned = np.full(n_views, _SCENE_TURN_RAD), np.zeros((1, n_views, 3))
    cam_R_past, path = scene.cam_R_past[None], scene.path[None]
    for _ in range(n_steps):
        cam_R_past, path, rate_hz = _refined_once(cam_R_past, path, points, weight, rate_hz, not_turned, turn_sigma)
    return replace(scene, cam_R_past=cam_R_past[0], path=path[0])


def refined_movers(movers: Sequence[Body], scene: Body, points: Points, n_steps: Ints) -> list[Body]:
    """The turns and paths of movers by their own points; beside the scene's views theirs may turn a little.

    Parameters
    ----------
    n_steps : (K,) of each mover.
    """
    cam_R_past, path = _stacked(movers)
    turn_sigma = _TURN_RATE_RAD_S * np.maximum(-points.since_s, _LEAST_TIME_S)
    rate_hz, weight = np.full(len(points.track), np.nan), np.ones(len(points.track))
    for step in range(n_steps.max(initial=0)):
        asked, place = np.flatnonzero(n_steps > step), np.flatnonzero(n_steps[points.body] > step)
        own = replace(points, track=points.track[place], body=np.searchsorted(asked, points.body[place]))
        turned = vector_from_rotation(scene.cam_R_past @ np.swapaxes(cam_R_past[asked], 2, 3))
        cam_R_past[asked], path[asked], rate_hz[place] = _refined_once(
            cam_R_past[asked], path[asked], own, weight[place], rate_hz[place], turned, turn_sigma
        )
    known = np.isfinite(rate_hz)
    medians_hz = np.nan_to_num(medians(rate_hz[known], points.body[known], len(movers)))
    return [Body(*motion) for motion in zip(cam_R_past, path, medians_hz.tolist(), strict=True)]


def _stacked(bodies: Sequence[Body]) -> tuple[Floats, Floats]:
    """``cam_R_past (K, L, 3, 3)`` and ``path (K, L, 3)`` of bodies."""
    return np.stack([body.cam_R_past for body in bodies]), np.stack([body.path for body in bodies])


def _refined_once(
    cam_R_past: Floats,
    path: Floats,
    points: Points,
    weight: Floats,
    rate_hz: Floats,
    turned_rad: Floats,
    turn_sigma_rad: Floats,
) -> tuple[Floats, Floats, Floats]:
    """Points on the paths, then the views by the points; a path keeps its length, a body without points its motion.

    Parameters
    ----------
    cam_R_past, path : (K, L, 3, 3) and (K, L, 3) of the bodies.
    turned_rad : (K, L, 3) how far each view of each body has turned from where it is expected; ``turn_sigma_rad (L,)``.
    """
    since_s, sigma_norm = points.since_s, points.sigma_norm[points.track]
    xy = each_turned_into_plane(points.rays, points.track, cam_R_past, points.body)
    fit = fit_on_paths(xy, path, points.body, sigma_norm, rate_hz)
    is_used = (weight > 0.0) & (fit.n_views > 1)
    typical = np.maximum(medians(fit.misfit[is_used], points.body[is_used], len(path)), _LEAST_TYPICAL_MISFIT)
    weight = np.where(is_used, weight / (1.0 + fit.misfit / (_HALF_WEIGHT * typical[points.body])), 0.0)
    shifted = path - (since_s / min(since_s[0], -_LEAST_TIME_S))[:, None] * path[:, :1]
    shift_sigma = _SHIFT_FLOOR - _SHIFT_RATE_HZ * since_s
    turn_rad, shift = corrected_views(
        xy, path, points.body, fit, sigma_norm, weight, turned_rad, shifted, turn_sigma_rad, shift_sigma
    )
    has_points = np.isfinite(typical)
    turn_rad[~has_points], shift[~has_points] = 0.0, 0.0
    moved = path + shift
    before, after = (np.sqrt(np.max(np.sum(one**2, axis=2), axis=1)) for one in (path, moved))
    has_length = np.minimum(before, after) > _NO_LENGTH
    moved *= np.divide(before, after, out=np.ones(len(path)), where=has_length)[:, None, None]
    return turned_further(-turn_rad, cam_R_past), moved, fit.rate_hz
