"""Pictures of a texture that is known as a formula: warped by any affine map without an interpolation error."""

import numpy as np

WIDTH, HEIGHT = 240, 160
CENTRE_PX = np.array([(WIDTH - 1) / 2, (HEIGHT - 1) / 2])
N_WAVES = 80


class Warp:
    """An affine map about the picture's centre: texture place to picture place, and back."""

    def __init__(self, scale=1.0, turn_deg=0.0, shift_px=(0.0, 0.0)):
        turn = np.radians(turn_deg)
        self.matrix = scale * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        self.shift_px = np.asarray(shift_px, dtype=float)

    def to_picture(self, xy_px):
        return (xy_px - CENTRE_PX) @ self.matrix.T + CENTRE_PX + self.shift_px

    def to_texture(self, xy_px):
        return (xy_px - CENTRE_PX - self.shift_px) @ np.linalg.inv(self.matrix).T + CENTRE_PX


def wave_picture(warp: Warp | None = None, seed: int = 0) -> np.ndarray:
    """The texture as a camera sees it through a warp: (HEIGHT, WIDTH) uint8.

    The texture is a sum of waves of 6 to 160 px, the longer the stronger. Seen through an affine map, each is a wave
    along the columns times one along the rows.
    """
    rng = np.random.default_rng(seed)
    length_px = 6 * (160 / 6) ** rng.random(N_WAVES)
    angle, phase = rng.uniform(0, 2 * np.pi, (2, N_WAVES))
    strength = np.sqrt(length_px)
    wave = 2 * np.pi / length_px * np.stack([np.cos(angle), np.sin(angle)])
    corner, right, below = (warp or Warp()).to_texture(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])) @ wave
    down = strength * np.exp(1j * (corner + phase + np.arange(HEIGHT)[:, None] * (below - corner)))
    grey = (down @ np.exp(1j * np.arange(WIDTH)[:, None] * (right - corner)).T).real
    return np.clip(np.rint(128 + 40 * grey / np.sqrt(0.5 * np.sum(strength**2))), 0, 255).astype(np.uint8)
