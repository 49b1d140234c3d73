"""The rows of ``motions.parquet``."""

from __future__ import annotations

from typing import Any

import numpy as np

from ttcvid.geometry.horizon.line import HorizonFit
from ttcvid.geometry.paper.epipole import INFINITY_COSINE
from ttcvid.model import Camera
from ttcvid.stages.horizon.straight_motion import Motion

_UPPER_TRIANGLE = np.triu_indices(3)


def motion_row(motion: Motion, fit: HorizonFit, camera: Camera) -> tuple[Any, ...]:
    """The row of ``motions`` for one motion, NaN where there is no value."""
    direction, covariance = motion.direction, motion.covariance
    ahead = -direction if direction[2] < 0 else direction
    x_px = y_px = np.nan
    if abs(direction[2]) > INFINITY_COSINE:
        x_px = camera.fx_px * direction[0] / direction[2] + camera.cx_px
        y_px = camera.fy_px * direction[1] / direction[2] + camera.cy_px
    variance = fit.normal @ covariance @ fit.normal + fit.scatter_rad**2
    return (
        motion.clip,
        motion.mover,
        motion.status,
        motion.first_frame,
        motion.last_frame,
        motion.duration_s,
        len(motion.track_id),
        *direction.tolist(),
        *covariance[_UPPER_TRIANGLE].tolist(),
        float(x_px),
        float(y_px),
        float(np.degrees(np.arcsin(np.clip(ahead @ fit.normal, -1.0, 1.0)))),
        float(np.degrees(np.sqrt(variance))),
        float(np.degrees(motion.turned_rad)),
        motion.noise_px,
        motion.correlation,
    )
