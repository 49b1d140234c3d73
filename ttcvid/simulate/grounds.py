"""The textures of the ground and the sky: seamless tiles."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.random import Generator

from ttcvid.model import Picture
from ttcvid.simulate.paint import asphalt, blotches, canvas, fill, rectangle, seamless_noise, varied
from ttcvid.simulate.scene import Ground

STREET_TILE_M = 48.0
FIELDS_TILE_M = 1500.0
CLOUD_TILE_M = 60000.0
TILE_TEXELS = 2048
GRASS = (62, 104, 82)
PAVEMENT = (142, 146, 148)
SKY_BLUE, CLOUD_WHITE = np.array([216.0, 190, 165]), np.array([240.0, 238, 236])
WHITE = (222, 224, 224)
DASH_M = 3.0
KERB_M = 0.15
HEDGE_TEXELS = np.array([[3, 3], [-3, 3], [-3, -3], [3, -3]])
"""From the corners of a parcel of land to those of what grows on it."""


def ground_tile(ground: Ground, rng: Generator) -> tuple[Picture, float]:
    """Picture of a square tile of the ground and its side in m; its rows run along x, its columns along y."""
    if ground.kind == "fields":
        return _fields(rng), FIELDS_TILE_M
    if ground.kind == "street":
        return _street(ground, rng), STREET_TILE_M
    return asphalt((TILE_TEXELS, TILE_TEXELS), rng), STREET_TILE_M


def cloud_tile(rng: Generator) -> Picture:
    """Soft clouds: low contrast, nothing that a corner detector takes for near."""
    size = (1024, 1024)
    noise = sum(weight * seamless_noise(size, cell, rng) for cell, weight in ((256, 1.0), (96, 0.7), (32, 0.4)))
    cover = np.clip(0.5 + 0.45 * np.reshape(noise, (*size, 1)), 0, 1)
    return np.asarray((1 - cover) * SKY_BLUE + cover * CLOUD_WHITE, dtype=np.uint8)


def _street(ground: Ground, rng: Generator) -> Picture:
    """Road with lane marks, kerbs, pavements of slabs, grass beyond; y grows with the column of the tile."""
    texel_m = STREET_TILE_M / TILE_TEXELS
    middle, half = STREET_TILE_M / 2 + ground.road_offset_m, ground.road_width_m / 2
    picture = canvas((TILE_TEXELS, TILE_TEXELS), GRASS, rng, 14.0)
    blotches(picture, 16000, (1.6, 5.0), 45, rng)
    edge = half + KERB_M
    for low, high in (
        (middle - edge - ground.pavement_width_m, middle - edge),
        (middle + edge, middle + edge + ground.pavement_width_m),
    ):
        _pavement(picture, round(low / texel_m) - 1, round(high / texel_m) + 1, rng)
    low, high = round((middle - half) / texel_m), round((middle + half) / texel_m)
    kerb = round(KERB_M / texel_m)
    picture[:, low - kerb : high + kerb] = canvas((high - low + 2 * kerb, TILE_TEXELS), (172, 172, 170), rng, 8.0)
    picture[:, low:high] = asphalt((high - low, TILE_TEXELS), rng)
    mark = 0.06 / STREET_TILE_M
    for start in np.arange(0, STREET_TILE_M, 2 * DASH_M):
        across = middle / STREET_TILE_M
        along = start / STREET_TILE_M
        rectangle(picture, (across - mark, along, across + mark, along + DASH_M / STREET_TILE_M), WHITE)
    for side in (-1, 1):
        across = (middle + side * (half - 0.25)) / STREET_TILE_M
        rectangle(picture, (across - mark, 0, across + mark, 1), WHITE)
    return picture


def _pavement(picture: Picture, low: int, high: int, rng: Generator) -> None:
    """Slabs of about 0.5 m, each with its own shade, between the columns ``low`` and ``high``."""
    if high - low < 4:
        return
    strip = canvas((high - low, TILE_TEXELS), PAVEMENT, rng, 7.0)
    slab = TILE_TEXELS // 96
    for row in range(0, TILE_TEXELS, slab):
        for column in range(0, high - low, slab):
            area = strip[row : row + slab - 1, column : column + slab - 1]
            area[:] = np.clip(area.astype(int) + int(rng.normal(0, 13)), 0, 255)
    blotches(strip, strip.size // 900, (1.6, 4.0), 50, rng)
    picture[:, low:high] = strip


def _fields(rng: Generator) -> Picture:
    """Farmland from the air: parcels, hedges, lanes, farmsteads."""
    picture = canvas((TILE_TEXELS, TILE_TEXELS), (72, 108, 100), rng, 8.0)
    n = 16
    side = TILE_TEXELS / n
    shift = rng.uniform(-0.3, 0.3, (n, n, 2)) * side
    crops = ((60, 110, 90), (80, 140, 150), (70, 125, 110), (62, 92, 70), (96, 128, 140))
    colours = [[varied(crops[rng.integers(5)], 14, rng) for _ in range(n)] for _ in range(n)]
    # One row and column more than fit: what sticks out on one side of the tile comes in on the other.
    for row, column in product(range(-1, n + 1), repeat=2):
        places = np.array([[column, row], [column + 1, row], [column + 1, row + 1], [column, row + 1]])
        corners = places * side + shift[places[:, 1] % n, places[:, 0] % n]
        fill(picture, corners + HEDGE_TEXELS, colours[row % n][column % n])
    blotches(picture, 9000, (1.5, 5.0), 50, rng)
    blotches(picture, 900, (4.0, 9.0), 90, rng)
    return picture
