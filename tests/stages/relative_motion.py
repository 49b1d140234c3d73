"""Points in constant relative motion as the stages see them: flows, histories and cluster rows with known truth."""

import numpy as np

from ttcvid.geometry.rotation import normalize
from ttcvid.model import Camera, ImageSize, PointSet
from ttcvid.stages.egomotion.flows import Flows
from ttcvid.stages.tracking.history import empty_history, extended, with_egomotion

FOCAL_PX = 720.0
CAMERA = Camera(FOCAL_PX, FOCAL_PX, 319.5, 179.5, ImageSize(640, 360), origin="focal_px")
# Noise that is assumed where points are exact.
EXACT_SIGMA_PX = 1e-3


def unit(vector):
    return normalize(np.asarray(vector, dtype=float))


def pixels(position_m):
    return FOCAL_PX * position_m[:, :2] / position_m[:, 2:] + (CAMERA.cx_px, CAMERA.cy_px)


def box_of_points(rng, n, centre_m, size_m):
    """N points evenly spread over a box about a centre, (N, 3) in m."""
    return np.asarray(centre_m, dtype=float) + rng.uniform(-0.5, 0.5, (n, 3)) * np.asarray(size_m, dtype=float)


def flows_of(position_m, velocity_m_s, gap_s=0.4, sigma_px=EXACT_SIGMA_PX, rng=None):
    """Flows of points that are at `position_m` (N, 3) now; with `rng` both views have noise of `sigma_px`."""
    n = len(position_m)
    views = []
    for t_s in (-gap_s, 0.0):
        point = position_m + np.broadcast_to(velocity_m_s, (n, 3)) * t_s
        xy = point[:, :2] / point[:, 2:]
        if rng is not None:
            xy = xy + sigma_px / FOCAL_PX * rng.normal(size=xy.shape)
        views.append(normalize(np.column_stack([xy, np.ones(n)])))
    sigma_rad = sigma_px / FOCAL_PX * views[1][:, 2] ** 1.5
    return Flows(views[0], views[1], np.full(n, 4), np.full(n, gap_s), sigma_rad, np.zeros(n))


def joined(*flows):
    """Flows of several things in one."""
    names = Flows.__dataclass_fields__
    return Flows(*(np.concatenate([getattr(part, name) for part in flows]) for name in names))


def direction_noise(rng, direction, sigma_rad):
    """A unit vector off `direction` by `sigma_rad` per axis, and the covariance that says so."""
    off = unit(direction + sigma_rad * rng.normal(size=3))
    return off, sigma_rad**2 * (np.eye(3) - np.outer(off, off))


def history_of(position_m, velocity_m_s, times_s, rotations=None, sigma_px=EXACT_SIGMA_PX, rng=None, shift_m=None):
    """History of N points at `position_m` at the last of `times_s`, seen by a camera that turns by `rotations`.

    `rotations` are the cam_R_prev of the steps, known exactly. `shift_m` (L, 3) is where the points were, less where
    they are last; None: they have a constant velocity.
    """
    n, last_s = len(position_m), times_s[-1]
    rotations = [np.eye(3)] * (len(times_s) - 1) if rotations is None else rotations
    cam_R_last = [np.eye(3)]
    for cam_R_prev in rotations[::-1]:
        cam_R_last.append(cam_R_prev.T @ cam_R_last[-1])
    history = empty_history(CAMERA, sigma_px)
    for frame, t_s in enumerate(times_s):
        moved_m = np.broadcast_to(velocity_m_s, (n, 3)) * (t_s - last_s) if shift_m is None else shift_m[frame]
        point = position_m + moved_m
        point = point @ cam_R_last[len(times_s) - 1 - frame].T
        xy_px = pixels(point)
        if rng is not None:
            xy_px = xy_px + sigma_px * rng.normal(size=xy_px.shape)
        rays = normalize(np.column_stack([(xy_px - (CAMERA.cx_px, CAMERA.cy_px)) / FOCAL_PX, np.ones(n)]))
        history = extended(history, frame, float(t_s), PointSet(np.arange(n), xy_px), rays, len(times_s))
        if frame:
            history = with_egomotion(history, rotations[frame - 1], None, 0.0)
    return history
