"""Noise-free points in constant relative motion, as hypothesis strategies, and noisy views of them."""

import numpy as np
from hypothesis import strategies as st

from ttcvid.geometry.rotation import normalize


def views(position, velocity, times_s):
    """Unit rays (T, N, 3) of points that are at `position` at time 0."""
    times_s = np.asarray(times_s, dtype=float)[:, None, None]
    return normalize(position + velocity * times_s)


def jitter(rays, sigma_rad, rng):
    """Unit rays with isotropic noise of their direction."""
    return normalize(rays + sigma_rad * rng.normal(size=rays.shape))


@st.composite
def moving_points(draw, planar=False):
    """(position, velocity), each (N, 3): in front of the camera for 1.5 s, with a flow, off the epipole."""
    n = draw(st.integers(1, 8))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    position = np.column_stack([rng.uniform(-20, 20, n), rng.uniform(-4, 4, n), rng.uniform(15, 60, n)])
    velocity = np.column_stack([rng.uniform(-4, 4, n), rng.uniform(-2, 2, n), rng.uniform(-10, 4, n)])
    if planar:
        velocity[:, 1] = 0.0
        position[:, 1] = np.copysign(np.maximum(np.abs(position[:, 1]), 0.5), position[:, 1])
    ray = normalize(position)
    sine = np.linalg.norm(np.cross(ray, velocity), axis=1)
    keep = sine > 0.2
    if not keep.any():
        return np.array([[20.0, 1.0, 20.0]]), np.array([[-10.0, 0.0, -2.0]])
    return position[keep], velocity[keep]
