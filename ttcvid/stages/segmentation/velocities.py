"""Velocities of movers in units of their depth, also while they are hidden."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ttcvid.geometry.estimation.rigid_motion import Points
from ttcvid.geometry.estimation.shared_translation import common_velocities
from ttcvid.model import Bools, Floats, Ints

# A velocity is that of the last views, s: cars brake within a second. So many views in any case, at low frame rates.
_RECENT_S, _LEAST_RECENT = 0.6, 4
_LEAST_DEPTH_RATIO = 0.05


@dataclass(frozen=True)
class Velocities:
    """V / Z of K movers relative to the camera now, ``v_hz (K, 3)`` in 1/s, as of when they were last found.

    ``info (K, 3, 3)`` is its information matrix; 0 where nothing is known.
    """

    v_hz: Floats
    info: Floats

    def take(self, index: Ints | Bools) -> Velocities:
        """Those of the movers that an index array or a mask picks."""
        return Velocities(self.v_hz[index], self.info[index])

    def with_new(self, count: int) -> Velocities:
        """These, and as many again at unknown velocities."""
        new = unknown_velocities(count)
        return Velocities(np.concatenate([self.v_hz, new.v_hz]), np.concatenate([self.info, new.info]))

    def carried_forward(self, cam_R_prev: Floats, centre: Floats, dt_s: float) -> Velocities:
        """As the next camera, turned by ``cam_R_prev (3, 3)``, sees them: V is the same, the depth another.

        ``centre (K, 3)`` where they were; NaN: not known.
        """
        place = centre / centre[:, 2:]
        ratio = (place + dt_s * self.v_hz) @ cam_R_prev[2]
        ratio = np.where(ratio > _LEAST_DEPTH_RATIO, ratio, 1.0)
        info = cam_R_prev @ self.info @ cam_R_prev.T * (ratio**2)[:, None, None]
        return Velocities(self.v_hz @ cam_R_prev.T / ratio[:, None], info)

    def seen_again(self, points: Points, cam_R_past: Floats, is_seen: Bools, n_steps: int) -> Velocities:
        """With what the points of those that are seen, ``is_seen (K,)``, show; ``cam_R_past (L, 3, 3)``."""
        v_hz, info = recent_velocities(points, cam_R_past, self.v_hz, n_steps)
        v_hz = np.where(is_seen[:, None], v_hz, self.v_hz)
        return Velocities(v_hz, np.where(is_seen[:, None, None], info, self.info))


def recent_velocities(points: Points, cam_R_past: Floats, start_hz: Floats, n_steps: int) -> tuple[Floats, Floats]:
    """`common_velocities` by the last views, `_LEAST_RECENT` in any case."""
    first = max(0, min(int(np.searchsorted(points.since_s, -_RECENT_S)), len(points.since_s) - _LEAST_RECENT))
    recent = replace(points, since_s=points.since_s[first:])
    return common_velocities(recent, cam_R_past[first:], start_hz, n_steps)


def unknown_velocities(count: int) -> Velocities:
    """Unknown velocities of ``count`` movers."""
    return Velocities(np.zeros((count, 3)), np.zeros((count, 3, 3)))
