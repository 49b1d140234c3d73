"""What lens, windscreen and sensor do to a picture: spots, vignetting, exposure steps, haze, noise."""

from __future__ import annotations

import cv2
import numpy as np

from ttcvid.model import ImageSize, Picture
from ttcvid.simulate.ripmap import Float32s
from ttcvid.simulate.scene import Scene

HAZE_GREY = 150.0
"""What a picture without any contrast shows."""
SPOT_SHARE = (0.006, 0.025)
"""Radius of a spot over the width of the picture."""


class Sensor:
    """Develops the pictures of a scene; all chance comes from its seed and the frame."""

    def __init__(self, scene: Scene, size: ImageSize) -> None:
        self._spec, self._seed = scene.picture, scene.seed
        self._spots = _spots(scene, size) if self._spec.n_spots else None
        self._light = _light(self._spec.vignetting, size)

    def develop(self, bgr: Picture, frame: int, t_s: float) -> Picture:
        """The picture as recorded, ``(H, W, 3)``."""
        spec = self._spec
        gain = [factor for from_s, factor in spec.gain_steps if t_s >= from_s][-1:]
        if self._spots is not None or spec.vignetting or gain or spec.contrast != 1.0:
            value = bgr.astype(np.float32)
            if self._spots is not None:
                colour, opacity = self._spots
                value += opacity * (colour - value)
            value *= self._light * np.float32(gain[0] if gain else 1.0)
            value = HAZE_GREY + np.float32(spec.contrast) * (value - HAZE_GREY)
            bgr = np.clip(np.rint(value), 0, 255).astype(np.uint8)
        if spec.noise_grey == 0:
            return bgr
        rng = np.random.default_rng([self._seed, 5, frame])
        noise = spec.noise_grey * rng.standard_normal(bgr.shape[:2], dtype=np.float32)
        return np.asarray(cv2.add(bgr, cv2.merge([noise] * 3), dtype=cv2.CV_8U))


def _light(vignetting: float, size: ImageSize) -> Float32s:
    """Share of the light that is left ``(H, W, 1)``: falls with the square of the distance from the middle."""
    x = np.linspace(-1.0, 1.0, size.width_px) * size.width_px
    y = np.linspace(-1.0, 1.0, size.height_px) * size.height_px
    square = (x[None, :] ** 2 + y[:, None] ** 2) / (size.width_px**2 + size.height_px**2)
    return np.asarray(1.0 - vignetting * square[:, :, None], dtype=np.float32)


def _spots(scene: Scene, size: ImageSize) -> tuple[Float32s, Float32s]:
    """Colour ``(H, W, 1)`` and opacity ``(H, W, 1)`` of drops and dirt that rest in the picture."""
    rng = np.random.default_rng([scene.seed, 11])
    colour = np.zeros((size.height_px, size.width_px), np.float32)
    opacity = np.zeros_like(colour)
    for _ in range(scene.picture.n_spots):
        centre = rng.uniform((0, 0), (size.width_px, size.height_px)).astype(int).tolist()
        radius = max(2, round(float(rng.uniform(*SPOT_SHARE)) * size.width_px))
        axes = (radius, max(2, round(radius * float(rng.uniform(0.6, 1.0)))))
        shape = (centre, axes, float(rng.uniform(0, 180)), 0, 360)
        cv2.ellipse(colour, *shape, float(rng.choice([rng.uniform(25, 80), rng.uniform(170, 230)])), -1)
        cv2.ellipse(opacity, *shape, float(rng.uniform(0.4, 0.9)), -1)
    covered = cv2.GaussianBlur(opacity, (0, 0), 1.5)
    return colour[:, :, None], np.where(opacity > 0, covered, 0.0).astype(np.float32)[:, :, None]
