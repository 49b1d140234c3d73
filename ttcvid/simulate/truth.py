"""The true collision times of points whose position and relative velocity are known.

Written from the definitions, without the package's own geometry: a truth in which no estimate has a hand.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.model import Floats

RESTING_M_S = 1e-9
"""Below this relative speed, which is rounding, a point counts as resting: it has no times."""


@dataclass(frozen=True)
class TrueTimes:
    """Times of N points, each ``(N,)`` in s, and ``direction (N, 3)``; NaN where the motion defines none."""

    tcpa_s: Floats
    miss_s: Floats
    ttc_z_s: Floats
    direction: Floats


def true_times(position_m: Floats, velocity_m_s: Floats) -> TrueTimes:
    """Times of points at ``position_m (N, 3)`` with relative velocity ``velocity_m_s (N, 3)``, camera frame.

    tcpa = -P.V / V.V is where d|P + V t|^2/dt vanishes, miss = |P + V tcpa| / |V| the distance there in seconds of
    relative motion, ttc_z = -Z / Vz where the depth vanishes.

    >>> times = true_times(np.array([[20.0, 0.0, 20.0]]), np.array([[-10.0, 0.0, -2.0]]))
    >>> round(times.tcpa_s[0], 2), round(times.ttc_z_s[0], 2)
    (np.float64(2.31), np.float64(10.0))
    """
    speed = np.sqrt(np.sum(velocity_m_s**2, axis=-1))
    speed = np.where(speed < RESTING_M_S, np.nan, speed)
    direction = velocity_m_s / speed[:, None]
    tcpa = -np.sum(position_m * direction, axis=-1) / speed
    nearest = position_m + velocity_m_s * tcpa[:, None]
    depth_rate = np.where(np.abs(velocity_m_s[:, 2]) < RESTING_M_S, np.nan, velocity_m_s[:, 2])
    miss = np.sqrt(np.sum(nearest**2, axis=-1)) / speed
    return TrueTimes(tcpa, miss, -position_m[:, 2] / depth_rate, direction)
