"""Views of simulated scenes by cameras of all kinds, with the focal length known exactly and movers before them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.geometry.rotation import rotation_from_vector
from ttcvid.model import Floats, ImageSize, PointSet
from ttcvid.stages.egomotion.focal_length import SeenPoints

SIZE = ImageSize(800, 450)
KINDS = ("pan", "pan and step", "curve", "hand", "flight", "straight")
"""What the camera does: turn on the spot; walk meanwhile; drive a bend; be held in a hand; fly; drive straight on."""

_RATE_HZ, _N_POINTS, _SHOWN = 20.0, 6000, 600
_CENTRE_PX = np.array([399.5, 224.5])
# Beyond this nothing is seen, m; the ground lies 1.5 m below the camera.
_NEAREST_M, _FARTHEST_M = 2.0, 90.0


@dataclass(frozen=True)
class FocalDrive:
    """One clip: ``focal_px`` is its truth, ``movers`` the mean part of its points that move on their own."""

    kind: str
    focal_px: float
    movers: float
    frames: list[SeenPoints]


def focal_drive(seed: int) -> FocalDrive:
    """The clip of a seed: kinds take turns; field of view, turn, speed, noise, length and movers are drawn."""
    rng = np.random.default_rng([11, seed])
    kind = KINDS[seed % len(KINDS)]
    focal_px = float(np.exp(rng.uniform(np.log(350.0), np.log(1300.0))))
    sigma_px, n_frames = rng.uniform(0.05, 0.3), int(rng.integers(25, 80))
    poses = _Poses(kind, rng)
    place, velocity, first_mover = _scene(rng)
    offset = int(rng.integers(0, 7))
    frames, movers = [], []
    for t_s in np.arange(n_frames) / _RATE_HZ:
        world_R_cam, at = poses.at(float(t_s))
        seen = (place + velocity * t_s - at) @ world_R_cam
        is_seen = (seen[:, 2] > _NEAREST_M) & (np.linalg.norm(seen, axis=1) < _FARTHEST_M)
        xy_px = np.full((len(place), 2), np.inf)
        xy_px[is_seen] = focal_px * seen[is_seen, :2] / seen[is_seen, 2:] + _CENTRE_PX
        is_seen &= np.all((xy_px > 0.0) & (xy_px < np.array([SIZE.width_px, SIZE.height_px]) - 1.0), axis=1)
        number = np.arange(len(place))
        is_seen &= ((number + offset) % max(1, int(is_seen.sum()) // _SHOWN) == 0) | (number >= first_mover)
        track_id = np.flatnonzero(is_seen)
        noisy = xy_px[track_id] + rng.normal(0.0, sigma_px, (len(track_id), 2))
        frames.append(SeenPoints(float(t_s), PointSet(track_id, noisy)))
        movers.append(float(np.mean(track_id >= first_mover)) if len(track_id) else 0.0)
    return FocalDrive(kind, focal_px, float(np.mean(movers)), frames)


class _Poses:
    """Where the camera of a kind is, and how it is turned, over time."""

    def __init__(self, kind: str, rng: np.random.Generator) -> None:
        self._kind = kind
        self._rate_rad_s = rng.uniform(0.03, 0.4) * rng.choice([-1.0, 1.0])
        self._speed_m_s = rng.uniform(2.0, 12.0)
        self._nod_rad = rng.uniform(0.0, 0.01)
        self._step_m_s = rng.uniform(-1.0, 1.0, 3) * rng.choice([0.05, 0.3, 1.0])
        self._phase = rng.uniform(0.0, 2.0 * np.pi, 6)

    def at(self, t_s: float) -> tuple[Floats, Floats]:
        """``world_R_cam (3, 3)`` and place ``(3,)`` in m at a time."""
        rate, speed, nod, phase = self._rate_rad_s, self._speed_m_s, self._nod_rad, self._phase
        turn, at = np.zeros(3), np.zeros(3)
        if self._kind in ("pan", "pan and step", "curve"):
            turn = np.array([nod * np.sin(3.0 * t_s), rate * t_s, nod * np.sin(2.0 * t_s)])
        if self._kind == "pan and step":
            at = self._step_m_s * t_s
        elif self._kind == "curve":
            at = speed / rate * np.array([1.0 - np.cos(rate * t_s), 0.0, np.sin(rate * t_s)])
        elif self._kind == "straight":
            turn = 0.3 * nod * np.array([np.sin(5.0 * t_s), np.sin(1.3 * t_s + 1.0), 0.0])
            at = np.array([0.0, 0.0, speed * t_s])
        elif self._kind == "hand":
            turn = np.array([0.08, 0.25, 0.05]) * np.sin(np.array([1.5, 1.1, 1.0]) * t_s + phase[:3])
            at = np.array([0.5 * np.sin(t_s + phase[3]), 0.2 * np.sin(1.4 * t_s + phase[4]), 0.4 * t_s])
        elif self._kind == "flight":
            turn = np.array([0.1 * np.sin(t_s + phase[0]), rate * t_s, 0.3 * np.sin(0.8 * t_s + phase[1])])
            at = np.array([0.3 * speed * t_s, 0.5 * np.sin(t_s), speed * t_s])
        return rotation_from_vector(turn), at


def _scene(rng: np.random.Generator) -> tuple[Floats, Floats, int]:
    """Points (N, 3) in m, a third of them on the ground, their velocities in m/s; up to four cars come last."""
    highest_m = rng.choice([-12.0, -40.0])
    place = rng.uniform((-70.0, highest_m, -20.0), (70.0, 1.5, 110.0), (_N_POINTS, 3))
    place[: _N_POINTS // 3, 1] = 1.5
    velocity = np.zeros((_N_POINTS, 3))
    first_mover = _N_POINTS
    for _ in range(int(rng.integers(0, 5))):
        first, last = first_mover - int(rng.integers(40, 200)), first_mover
        centre = np.array([rng.uniform(-12.0, 12.0), 0.6, rng.uniform(6.0, 35.0)])
        place[first:last] = centre + rng.uniform((-1.0, -0.8, -2.0), (1.0, 0.8, 2.0), (last - first, 3))
        velocity[first:last] = (rng.uniform(-8.0, 8.0), 0.0, rng.uniform(-8.0, 12.0))
        first_mover = first
    return place, velocity, first_mover
