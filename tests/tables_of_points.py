"""Tables of exact point tracks with noise: a street, things that move in it, and a camera that drives.

Camera frame at the start: x to the right, y down, z ahead, in m.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ttcvid.config import EgomotionConfig, PipelineConfig
from ttcvid.model import Camera, Frame, ImageSize, Platform, PointSet
from ttcvid.pipeline import analyze_frames

WIDTH_PX, HEIGHT_PX, FOCAL_PX = 1280, 720, 720.0
CAMERA = Camera(
    FOCAL_PX, FOCAL_PX, (WIDTH_PX - 1) / 2, (HEIGHT_PX - 1) / 2, ImageSize(WIDTH_PX, HEIGHT_PX), origin="focal_px"
)
VEHICLE = PipelineConfig(egomotion=EgomotionConfig(platform=Platform.vehicle))
# No point is nearer than this, m.
_LEAST_DEPTH_M = 0.5


def STILL(t_s):
    return np.zeros(3)


def moving(*velocity_m_s):
    return lambda t_s: np.array(velocity_m_s) * t_s


def driving(speed_m_s):
    return moving(0.0, 0.0, speed_m_s)


@dataclass(frozen=True)
class Body:
    """Points (N, 3) at time 0, and by how much they have moved at a time."""

    points_m: np.ndarray
    moved_m: Callable = STILL


def box(centre_m, size_m, n=60, seed=1):
    return np.asarray(centre_m) + np.random.default_rng(seed).uniform(-0.5, 0.5, (n, 3)) * size_m


def street(n=500, depth_m=(8.0, 90.0), travel_m=30.0, seed=5, *, free_way=False):
    """Static points all over the picture, as many at each inverse depth; `free_way`: none close before us."""
    rng = np.random.default_rng(seed)
    z = 1.0 / rng.uniform(1.0 / depth_m[1], 1.0 / depth_m[0], n)
    xy = rng.uniform(-0.5, 0.5, (n, 2)) * (WIDTH_PX, HEIGHT_PX) / FOCAL_PX
    points = np.column_stack([xy * z[:, None], z + rng.uniform(0.0, travel_m, n)])
    if free_way:
        points = points[(np.abs(points[:, 0]) > 2.5) | (points[:, 2] > 70.0)]
    return Body(points)


def table(bodies, camera_m, n_frames=30, fps=10.0, sigma_px=0.15, seed=0, hidden=None, renumbered=None):
    """Frames of the tracks of all bodies as a camera at ``camera_m(t_s)`` sees them.

    `hidden`: for a frame and the number of each track's body, which tracks are not seen. `renumbered`: frame
    from which on all tracks have other numbers.
    """
    rng = np.random.default_rng(seed)
    body = np.repeat(np.arange(len(bodies)), [len(b.points_m) for b in bodies])
    frames = []
    for index in range(n_frames):
        t_s = index / fps
        position = np.concatenate([b.points_m + b.moved_m(t_s) for b in bodies]) - camera_m(t_s)
        is_before = position[:, 2] > _LEAST_DEPTH_M
        z = np.where(is_before, position[:, 2], 1.0)
        xy_px = FOCAL_PX * position[:, :2] / z[:, None] + (CAMERA.cx_px, CAMERA.cy_px)
        is_seen = is_before & np.all((xy_px >= 0.0) & (xy_px <= (WIDTH_PX - 1, HEIGHT_PX - 1)), axis=1)
        xy_px = xy_px + rng.normal(0.0, sigma_px, xy_px.shape)
        if hidden is not None:
            is_seen &= ~hidden(index, body)
        track_id = np.flatnonzero(is_seen)
        if renumbered is not None and index >= renumbered:
            track_id = track_id + len(body)
        frames.append(Frame(index, t_s, points=PointSet(track_id, xy_px[is_seen])))
    return frames


def results_of(frames, config=VEHICLE):
    return [result for _, result in analyze_frames(frames, CAMERA, config)]


def ids_of(result):
    return [row.cluster_id for row in result.clusters if row.cluster_id]
