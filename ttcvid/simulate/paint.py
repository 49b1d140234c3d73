"""Brushes of the procedural textures: noise, blotches, patterns. All chance comes from the caller's generator."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.random import Generator

from ttcvid.model import Floats, Picture
from ttcvid.simulate.ripmap import Float32s

Colour = tuple[int, int, int]
"""Blue, green, red."""
ASPHALT: Colour = (96, 94, 92)
GRAIN_TEXELS = (1, 3, 9, 40)
"""Sizes of the grain of every surface."""


def canvas(size_px: tuple[int, int], colour: Colour, rng: Generator, grain_grey: float) -> Picture:
    """A picture (width, height) of one colour with grain of several sizes, seamless where it is repeated."""
    grain = seamless_noise(size_px, GRAIN_TEXELS[0], rng)
    for cell in GRAIN_TEXELS[1:]:
        grain += seamless_noise(size_px, cell, rng)
    grain *= np.float32(0.5 * grain_grey)
    return np.stack([np.clip(grain + channel, 0, 255).astype(np.uint8) for channel in colour], axis=-1)


def seamless_noise(size_px: tuple[int, int], cell_px: int, rng: Generator) -> Float32s:
    """Smooth noise ``(H, W)`` of about unit size with features of ``cell_px``, seamless at its borders."""
    width, height = size_px
    cells = rng.standard_normal((max(2, height // cell_px), max(2, width // cell_px)), dtype=np.float32)
    margin = 2
    framed = cv2.copyMakeBorder(cells, margin, margin, margin, margin, cv2.BORDER_WRAP)
    sx, sy = width / cells.shape[1], height / cells.shape[0]
    inverse = np.array([[1 / sx, 0, 0.5 / sx - 0.5 + margin], [0, 1 / sy, 0.5 / sy - 0.5 + margin]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(framed, inverse, size_px, flags=flags))


def blotches(picture: Picture, n: int, size_px: tuple[float, float], contrast_grey: int, rng: Generator) -> None:
    """Paint ``n`` small irregular quadrilaterals, brighter or darker than what is below: sharp corners to follow."""
    height, width = picture.shape[:2]
    colours = picture[rng.integers(0, height, n), rng.integers(0, width, n), :3].astype(int)
    shift = rng.choice([-1, 1], n) * rng.integers(contrast_grey // 2, contrast_grey + 1, n)
    turn = rng.uniform(0, 2 * np.pi, (n, 1)) + np.array([0, 0.5, 1, 1.5]) * np.pi + rng.uniform(-0.5, 0.5, (n, 4))
    radius = rng.uniform(*size_px, (n, 1)) * rng.uniform(0.5, 1.0, (n, 4))
    centre = rng.uniform(0, 1, (n, 1, 2)) * (width, height)
    corners = centre + radius[..., None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    shaded = np.clip(colours + shift[:, None], 0, 255)
    for polygon, colour in zip(corners, shaded.tolist(), strict=True):
        fill(picture, polygon, tuple(colour))


def fill(picture: Picture, polygon_px: Floats, colour: Colour) -> None:
    """Fill a polygon ``(N, 2)`` in pixels of the picture, with smooth edges; opacity stays full."""
    bits = 4
    fixed = np.round(np.asarray(polygon_px) * 2**bits).astype(np.int32)
    cv2.fillPoly(picture, [fixed], (*colour, 255)[: picture.shape[2]], cv2.LINE_AA, bits)


def rectangle(picture: Picture, box: tuple[float, float, float, float], colour: Colour) -> None:
    """Fill the box (left, top, right, bottom), given as fractions of the picture."""
    height, width = picture.shape[:2]
    x0, y0, x1, y1 = box
    corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]) * (width, height) - 0.5
    fill(picture, corners, colour)


def disc(picture: Picture, centre: tuple[float, float], radius_px: float, colour: Colour) -> None:
    """Fill a disc; the centre is given as fractions of the picture."""
    height, width = picture.shape[:2]
    turn = np.linspace(0, 2 * np.pi, 28, endpoint=False)
    rim = radius_px * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    fill(picture, np.asarray(centre) * (width, height) + rim, colour)


def varied(colour: Colour, amount: int, rng: Generator) -> Colour:
    """A colour brighter or darker than the given one by up to ``amount``."""
    blue, green, red = (np.asarray(colour) + rng.integers(-amount, amount + 1)).clip(0, 255).tolist()
    return blue, green, red


def asphalt(size_px: tuple[int, int], rng: Generator) -> Picture:
    """Asphalt with repairs, cracks, stains and covers."""
    picture = canvas(size_px, ASPHALT, rng, 9.0)
    n_tenths = size_px[0] * size_px[1] // 10000
    blotches(picture, max(1, n_tenths // 16), (14.0, 50.0), 22, rng)
    blotches(picture, 6 * n_tenths, (1.6, 5.0), 60, rng)
    for _ in range(n_tenths // 5):
        _crack(picture, rng)
    for _ in range(max(1, n_tenths // 50)):
        centre = (rng.uniform(0.03, 0.97), rng.uniform(0.03, 0.97))
        for radius_px, grey in ((14, 60), (11, 112), (5, 56)):
            disc(picture, centre, radius_px, (grey, grey, grey))
    return picture


def _crack(picture: Picture, rng: Generator) -> None:
    """A thin dark line with kinks."""
    height, width = picture.shape[:2]
    steps = rng.normal(0, 13, (7, 2)) + rng.normal(0, 16, 2)
    line = rng.uniform(0, 1, 2) * (width, height) + np.cumsum(steps, axis=0)
    normal = np.stack([-steps[:, 1], steps[:, 0]], axis=-1) / np.linalg.norm(steps, axis=1, keepdims=True)
    fill(picture, np.concatenate([line, (line + 1.8 * normal)[::-1]]), varied((58, 57, 56), 8, rng))
