"""Rigid things that brake, come near or turn, and what a camera at rest sees of them over some frames."""

import numpy as np

from ttcvid.geometry.estimation.rigid_motion import Points, RigidPaths, fit_on_paths, views_by_track
from ttcvid.geometry.rotation import normalize, rotation_from_vector

N_VIEWS, N_FRAMES, DT_S = 20, 32, 0.1
SIGMA = 0.1 / 700.0
SCENE = RigidPaths(np.broadcast_to(np.eye(3), (1, N_VIEWS, 3, 3)).copy(), np.zeros((1, N_VIEWS, 3)))


def braking(t_s):
    return np.array([-1.5, 0.5, 34.0 - 2.0 * t_s - 2.5 * t_s**2]), 0.0


def coming_near(t_s):
    return np.array([-3.0, 0.5, 48.0 - 14.0 * t_s]), 0.0


def turning(t_s):
    angle = 0.4 * t_s
    return np.array([-4.0 + 12.0 * np.sin(angle), 0.5, 22.0 - 12.0 * (1.0 - np.cos(angle))]), angle


def turned(angle):
    return rotation_from_vector(np.array([0.0, angle, 0.0]))


def box(rng, n=40):
    return rng.uniform([-2.0, -0.7, -0.9], [2.0, 0.7, 0.9], (n, 3))


def rays_of(motion, points, rng):
    """What a camera at rest sees of points about the middle of a thing: (F, N, 3)."""
    rays = np.empty((N_FRAMES, len(points), 3))
    for frame in range(N_FRAMES):
        middle, angle = motion(frame * DT_S)
        place = points @ turned(angle).T + middle
        xy = place[:, :2] / place[:, 2:] + SIGMA * rng.normal(size=(len(points), 2))
        rays[frame] = normalize(np.column_stack([xy, np.ones(len(points))]))
    return rays


def true_path(motion, frame):
    """Where the thing was, in its own present axes, in the N_VIEWS up to a frame, at a mean speed of 1."""
    middle, angle = motion(frame * DT_S)
    rotations, path = np.empty((N_VIEWS, 3, 3)), np.empty((N_VIEWS, 3))
    for k in range(N_VIEWS):
        before, angle_before = motion((frame - N_VIEWS + 1 + k) * DT_S)
        rotations[k] = turned(angle - angle_before)
        path[k] = rotations[k] @ before - middle
    length = np.linalg.norm(path, axis=1).max()
    return RigidPaths(rotations[None], path[None] * (N_VIEWS - 1) * DT_S / length)


def seen(rays, frame):
    n, views = rays.shape[1], rays[frame - N_VIEWS + 1 : frame + 1]
    since_s = DT_S * np.arange(1.0 - N_VIEWS, 1.0)
    return Points(views_by_track(views), np.full(n, SIGMA), since_s, np.arange(n), np.zeros(n, dtype=np.int64))


def converged(points, paths):
    fit = fit_on_paths(points, paths)
    return fit_on_paths(points, paths, fit.rate_hz)


def median_redchi(points, paths):
    return np.median(converged(points, paths).redchi)
