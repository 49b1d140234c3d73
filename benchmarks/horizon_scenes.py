"""Streets and squares before a resting camera, at random: the scenes that `benchmarks/horizon.py` calibrates from."""

from __future__ import annotations

import numpy as np

from ttcvid.simulate.scene import Body, CameraSpec, Ground, Scene

IMAGE_SIZE, HFOV_DEG, FPS, N_FRAMES = (640, 360), 70.0, 25.0, 100
PITCH_DEG, ROLL_DEG = (-15.0, 10.0), (-5.0, 5.0)
HEIGHT_M, HEIGHT_LOOKING_UP_M = (1.5, 6.0), (1.5, 2.5)
"""A camera that looks up sees the ground from afar only, and not at all from high above."""
N_MOVERS = (3, 8)
SPEED_M_S = {"car": (4.0, 12.0), "walker": (0.9, 1.8)}
DISTANCE_M = {"car": (14.0, 60.0), "walker": (7.0, 32.0)}
"""Depth of the middle of the path."""
MOST_BELOW_DEG = 20.0
"""Half the vertical field of view, less a little: the foot of a mover stands in the picture."""


def resting_scene(seed: int, one_direction: bool = False) -> Scene:
    """A camera of random height, pitch and roll over 3 to 8 cars and walkers, each on a straight way of its own.

    With ``one_direction`` all move along one line, some forth and some back.
    """
    rng = np.random.default_rng([seed, 71])
    pitch_deg = float(rng.uniform(*PITCH_DEG))
    camera = CameraSpec(
        image_size=IMAGE_SIZE,
        hfov_deg=HFOV_DEG,
        height_m=float(rng.uniform(*(HEIGHT_M if pitch_deg > -5.0 else HEIGHT_LOOKING_UP_M))),
        pitch_deg=pitch_deg,
        roll_deg=float(rng.uniform(*ROLL_DEG)),
        fps=FPS,
        n_frames=N_FRAMES,
    )
    n_movers = int(rng.integers(N_MOVERS[0], N_MOVERS[1] + 1))
    common_deg = float(rng.uniform(0, 360))
    bodies = []
    for number in range(n_movers):
        kind = "car" if rng.random() < 0.5 else "walker"
        heading_deg = common_deg + 180.0 * rng.integers(2) if one_direction else float(rng.uniform(0, 360))
        bodies.append(_mover(rng, camera, f"{kind} {number + 1}", kind, heading_deg))
    name = f"{'one direction' if one_direction else 'resting'} {seed}"
    return Scene(name=name, seed=seed, camera=camera, ground=Ground(kind="square"), bodies=tuple(bodies))


def _mover(rng: np.random.Generator, camera: CameraSpec, name: str, kind: str, heading_deg: float) -> Body:
    """A mover that is in view in the middle of its path, and never nearer to the camera than 5 m."""
    heading = np.radians(heading_deg)
    along = np.array([np.cos(heading), np.sin(heading)])
    duration_s = N_FRAMES / FPS
    while True:
        speed_m_s = float(rng.uniform(*SPEED_M_S[kind]))
        depth_m = float(rng.uniform(*DISTANCE_M[kind]))
        middle = np.array([depth_m, depth_m * np.tan(np.radians(HFOV_DEG / 2)) * rng.uniform(-0.7, 0.7)])
        ways = middle + np.linspace(-0.5, 0.5, 50)[:, None] * duration_s * speed_m_s * along
        below_deg = np.degrees(np.arctan2(camera.height_m, depth_m)) - camera.pitch_deg
        if np.linalg.norm(ways, axis=1).min() > 5.0 and abs(below_deg) < MOST_BELOW_DEG:
            break
    x, y = ways[0]
    return Body(name=name, kind=kind, at_m=(float(x), float(y), 0.0), heading_deg=heading_deg, speed_m_s=speed_m_s)
