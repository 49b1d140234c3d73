"""The painted faces of bodies: each skin is a function of the face's size that returns its picture."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import cv2
import numpy as np
from numpy.random import Generator

from ttcvid.model import Picture
from ttcvid.simulate.paint import Colour, asphalt, blotches, canvas, disc, rectangle, varied

BODY_COLOURS: tuple[Colour, ...] = (
    (40, 40, 170), (150, 80, 30), (200, 200, 205), (60, 60, 65), (70, 120, 60), (40, 150, 200), (130, 130, 140),
)  # fmt: skip
HOUSE_COLOURS: tuple[Colour, ...] = (
    (150, 178, 196), (128, 150, 186), (176, 188, 194), (140, 172, 168), (112, 128, 160), (186, 176, 160),
)  # fmt: skip
DARK: Colour = (34, 32, 30)
GLASS: Colour = (70, 62, 52)
SHADE = {"rear": 0.9, "front": 0.95, "left": 0.82, "right": 1.0, "top": 1.08, "bottom": 0.6}
"""Brightness of a face by the side it lies on: light from the upper right."""
MAX_TEXELS = 2048

Painter = Callable[[Picture, Colour, Generator], None]


def paint_skin(skin: str, side: str, size_m: tuple[float, float], colour: Colour, rng: Generator) -> Picture:
    """Picture of a face of ``size_m`` (width, height): (H, W, 3) BGR, or (H, W, 4) with opacity."""
    texel_m = max(TEXEL_M.get(skin, 0.01), max(size_m) / MAX_TEXELS)
    width, height = (max(4, round(extent / texel_m)) for extent in size_m)
    if skin in CUT_OUT:
        return CUT_OUT[skin]((width, height), rng)
    base = BASE_COLOUR.get(skin, colour)
    shaded = tuple(int(min(255, channel * SHADE[side])) for channel in base)
    picture = canvas((width, height), (shaded[0], shaded[1], shaded[2]), rng, 5.0)
    PAINTERS[skin](picture, (shaded[0], shaded[1], shaded[2]), rng)
    return picture


def _plain(picture: Picture, colour: Colour, rng: Generator) -> None:
    """Sheet metal: joints and a few marks."""
    height, width = picture.shape[:2]
    blotches(picture, 4 + width * height // 4000, (2.0, 7.0), 45, rng)
    for part in (0.3, 0.62):
        rectangle(picture, (part, 0, part + 0.008, 1), varied(colour, 40, rng))


def _car_side(picture: Picture, colour: Colour, rng: Generator) -> None:
    height, width = picture.shape[:2]
    rectangle(picture, (0, 0.78, 1, 1), DARK)
    for part in (0.36, 0.55, 0.72):
        rectangle(picture, (part, 0.02, part + 0.006, 0.78), DARK)
    for part in (0.42, 0.62):
        rectangle(picture, (part, 0.14, part + 0.045, 0.2), (190, 190, 190))
    rectangle(picture, (0, 0.4, 1, 0.46), varied(colour, 50, rng))
    blotches(picture, 22, (2.0, 6.0), 70, rng)
    for part in (0.19, 0.8):
        disc(picture, (part, 0.68), 0.36 * height, DARK)
        disc(picture, (part, 0.68), 0.2 * height, (165, 165, 165))
        for turn in np.arange(5) * 2 * np.pi / 5:
            spoke = (part + 0.13 * height / width * np.cos(turn), 0.68 + 0.13 * np.sin(turn))
            disc(picture, spoke, 0.045 * height, DARK)


def _car_end(picture: Picture, light: Colour, colour: Colour, rng: Generator) -> None:
    """Front or rear: lights, bumper, number plate, joints."""
    rectangle(picture, (0, 0.86, 1, 1), DARK)
    rectangle(picture, (0, 0.6, 1, 0.64), DARK)
    rectangle(picture, (0.02, 0.66, 0.98, 0.83), varied(colour, 35, rng))
    for left in (0.03, 0.79):
        rectangle(picture, (left, 0.2, left + 0.18, 0.46), light)
        rectangle(picture, (left + 0.06, 0.26, left + 0.12, 0.4), (235, 235, 235))
    rectangle(picture, (0.27, 0.16, 0.73, 0.34), varied(colour, 60, rng))
    rectangle(picture, (0.36, 0.4, 0.64, 0.54), (225, 230, 230))
    _lettering(picture, (0.37, 0.52), 0.1, rng)
    blotches(picture, 16, (2.0, 5.0), 60, rng)


def _car_rear(picture: Picture, colour: Colour, rng: Generator) -> None:
    _car_end(picture, (40, 30, 190), colour, rng)


def _car_front(picture: Picture, colour: Colour, rng: Generator) -> None:
    _car_end(picture, (190, 215, 225), colour, rng)
    for row in np.linspace(0.17, 0.31, 4):
        rectangle(picture, (0.29, row, 0.71, row + 0.02), DARK)


def _windows(picture: Picture, colour: Colour, rng: Generator) -> None:
    """Glass between pillars, with what is reflected in it."""
    rectangle(picture, (0.05, 0.12, 0.49, 0.92), GLASS)
    rectangle(picture, (0.53, 0.12, 0.95, 0.92), GLASS)
    blotches(picture, 14, (3.0, 9.0), 45, rng)


def _bus_side(picture: Picture, colour: Colour, rng: Generator) -> None:
    height = picture.shape[0]
    rectangle(picture, (0, 0.9, 1, 1), DARK)
    for left in np.linspace(0.02, 0.86, 8):
        rectangle(picture, (left, 0.12, left + 0.1, 0.48), varied(GLASS, 18, rng))
        rectangle(picture, (left + 0.02, 0.2, left + 0.05, 0.3), varied(GLASS, 70, rng))
    rectangle(picture, (0.0, 0.53, 1, 0.57), (230, 230, 230))
    rectangle(picture, (0.2, 0.6, 0.66, 0.82), (225, 225, 215))
    _lettering(picture, (0.22, 0.79), 0.16, rng)
    blotches(picture, 60, (2.0, 9.0), 60, rng)
    for part in (0.22, 0.76):
        disc(picture, (part, 0.86), 0.14 * height, DARK)
        disc(picture, (part, 0.86), 0.07 * height, (160, 160, 160))


def _bus_front(picture: Picture, colour: Colour, rng: Generator) -> None:
    _bus_end(picture, (190, 215, 225), rng)


def _bus_rear(picture: Picture, colour: Colour, rng: Generator) -> None:
    _bus_end(picture, (50, 40, 190), rng)


def _bus_end(picture: Picture, light: Colour, rng: Generator) -> None:
    rectangle(picture, (0, 0.9, 1, 1), DARK)
    rectangle(picture, (0.06, 0.16, 0.94, 0.52), GLASS)
    rectangle(picture, (0.25, 0.03, 0.75, 0.12), (30, 30, 30))
    _lettering(picture, (0.3, 0.11), 0.06, rng, (60, 200, 240))
    for left in (0.06, 0.8):
        rectangle(picture, (left, 0.7, left + 0.14, 0.8), light)
    rectangle(picture, (0.38, 0.74, 0.62, 0.82), (225, 230, 230))
    blotches(picture, 30, (2.0, 8.0), 60, rng)


def _cargo(picture: Picture, colour: Colour, rng: Generator) -> None:
    rectangle(picture, (0, 0, 1, 0.05), varied(colour, 60, rng))
    rectangle(picture, (0.06, 0.16, 0.94, 0.84), varied(colour, 60, rng))
    _lettering(picture, (0.09, 0.62), 0.36, rng)
    for part in np.linspace(0.02, 0.98, 13):
        rectangle(picture, (part - 0.002, 0, part + 0.002, 1), DARK)
    blotches(picture, 90, (2.0, 11.0), 50, rng)


def _cargo_doors(picture: Picture, colour: Colour, rng: Generator) -> None:
    rectangle(picture, (0.495, 0, 0.505, 1), DARK)
    for part in (0.2, 0.4, 0.6, 0.8):
        rectangle(picture, (part - 0.01, 0.02, part + 0.01, 0.98), (170, 170, 175))
        for row in (0.15, 0.5, 0.86):
            rectangle(picture, (part - 0.03, row, part + 0.03, row + 0.025), DARK)
    rectangle(picture, (0.06, 0.3, 0.36, 0.44), (225, 230, 230))
    _lettering(picture, (0.08, 0.42), 0.08, rng)
    for left in (0.0, 0.86):
        rectangle(picture, (left, 0.93, left + 0.14, 1), (40, 40, 190))
    blotches(picture, 60, (2.0, 8.0), 55, rng)


def _chassis(picture: Picture, colour: Colour, rng: Generator) -> None:
    height, width = picture.shape[:2]
    blotches(picture, 20, (3.0, 9.0), 30, rng)
    n_wheels = 3 if width > 3 * height else 2
    for part in (0.12, 0.3, 0.82)[:n_wheels] if n_wheels == 3 else (0.14, 0.86):
        disc(picture, (part, 0.52), 0.46 * height, (22, 22, 22))
        disc(picture, (part, 0.52), 0.2 * height, (130, 130, 135))


def _cabin_front(picture: Picture, colour: Colour, rng: Generator) -> None:
    rectangle(picture, (0, 0.9, 1, 1), DARK)
    rectangle(picture, (0.06, 0.12, 0.94, 0.46), GLASS)
    for row in np.linspace(0.54, 0.72, 5):
        rectangle(picture, (0.2, row, 0.8, row + 0.02), DARK)
    for left in (0.04, 0.78):
        rectangle(picture, (left, 0.76, left + 0.18, 0.86), (200, 220, 230))
    blotches(picture, 30, (2.0, 7.0), 55, rng)


def _cabin_side(picture: Picture, colour: Colour, rng: Generator) -> None:
    rectangle(picture, (0.25, 0.12, 0.8, 0.42), GLASS)
    rectangle(picture, (0.2, 0.08, 0.21, 0.9), DARK)
    disc(picture, (0.5, 0.84), 0.15 * picture.shape[0], (22, 22, 22))
    blotches(picture, 26, (2.0, 7.0), 55, rng)


def _house(picture: Picture, colour: Colour, rng: Generator) -> None:
    """Storeys of windows over a plinth with doors; stains and fittings on the plaster."""
    height, width = picture.shape[:2]
    texel_m = TEXEL_M["house"]
    blotches(picture, width * height // 900, (2.0, 9.0), 30, rng)
    storeys, columns = max(1, round(height * texel_m / 2.7)), max(1, round(width * texel_m / 2.2))
    for row in range(storeys):
        for column in range(columns):
            left, top = (column + 0.27) / columns, (row + 0.2) / storeys
            right, bottom = left + 0.46 / columns, top + 0.55 / storeys
            if row == storeys - 1 and rng.random() < 0.3:
                bottom = (row + 0.97) / storeys
            margin = 0.05 / columns
            rectangle(picture, (left - margin, top - margin, right + margin, bottom + margin), varied(colour, 70, rng))
            rectangle(picture, (left, top, right, bottom), varied(GLASS, 40, rng))
            middle = (left + right) / 2
            rectangle(picture, (middle - 0.01 / columns, top, middle + 0.01 / columns, bottom), (215, 215, 215))
            cross = top + 0.35 * (bottom - top)
            rectangle(picture, (left, cross, right, cross + 0.012 / storeys), (215, 215, 215))
    rectangle(picture, (0, 0.95, 1, 1), varied((95, 95, 100), 20, rng))


def _roof(picture: Picture, colour: Colour, rng: Generator) -> None:
    _bricks(picture, colour, rng)


def _bricks(picture: Picture, colour: Colour, rng: Generator) -> None:
    """Courses of stones, each with its own shade."""
    height, width = picture.shape[:2]
    course, stone = 11, 26
    for row in range(0, height, course):
        for left in range(-(row // course % 2) * stone // 2, width, stone):
            cv2.rectangle(picture, (left, row), (left + stone - 3, row + course - 3), varied(colour, 45, rng), -1)


def _patches(picture: Picture, colour: Colour, rng: Generator) -> None:
    height, width = picture.shape[:2]
    blotches(picture, 12 + width * height // 300, (2.0, 0.12 * max(width, height) + 3), 90, rng)


def _post(picture: Picture, colour: Colour, rng: Generator) -> None:
    n_rings = 6
    for ring in range(0, n_rings, 2):
        rectangle(picture, (0, ring / n_rings, 1, (ring + 1) / n_rings), (215, 215, 215))
    blotches(picture, 40, (1.5, 5.0), 80, rng)


def _hedge(picture: Picture, colour: Colour, rng: Generator) -> None:
    height, width = picture.shape[:2]
    blotches(picture, width * height // 90, (2.0, 8.0), 55, rng)


def _hull(picture: Picture, colour: Colour, rng: Generator) -> None:
    height, width = picture.shape[:2]
    rectangle(picture, (0, 0.42, 1, 0.52), (150, 60, 30))
    for left in np.linspace(0.15, 0.8, 12):
        rectangle(picture, (left, 0.24, left + 0.025, 0.36), DARK)
    for part in (0.12, 0.5, 0.86):
        rectangle(picture, (part, 0, part + 0.012, 1), varied(colour, 70, rng))
    blotches(picture, 20 + width * height // 2500, (2.0, 9.0), 70, rng)


def _nose(picture: Picture, colour: Colour, rng: Generator) -> None:
    rectangle(picture, (0.12, 0.18, 0.47, 0.45), GLASS)
    rectangle(picture, (0.53, 0.18, 0.88, 0.45), GLASS)
    rectangle(picture, (0, 0.62, 1, 0.7), (150, 60, 30))
    blotches(picture, 16, (2.0, 7.0), 70, rng)


def _engine(picture: Picture, colour: Colour, rng: Generator) -> None:
    disc(picture, (0.5, 0.5), 0.42 * picture.shape[0], DARK)
    disc(picture, (0.5, 0.5), 0.16 * picture.shape[0], (190, 190, 190))


def _lettering(
    picture: Picture, at: tuple[float, float], height: float, rng: Generator, colour: Colour = (40, 30, 30)
) -> None:
    """A random word whose letters are ``height`` high, from ``at`` (left, baseline), fractions of the picture."""
    rows, columns = picture.shape[:2]
    word = "".join(chr(65 + letter) for letter in rng.integers(0, 26, 6))
    scale = height * rows / 22
    place = (int(at[0] * columns), int(at[1] * rows))
    cv2.putText(picture, word, place, cv2.FONT_HERSHEY_SIMPLEX, scale, colour, max(1, round(2.5 * scale)), cv2.LINE_AA)


def _walker(size_px: tuple[int, int], rng: Generator) -> Picture:
    """A standing figure, cut out: head, coat, arms, legs, shoes, bag."""
    picture = np.zeros((size_px[1], size_px[0], 4), np.uint8)
    coat, trousers = (varied(BODY_COLOURS[rng.integers(len(BODY_COLOURS))], 20, rng) for _ in range(2))
    rectangle(picture, (0.3, 0.5, 0.49, 0.97), trousers)
    rectangle(picture, (0.53, 0.5, 0.72, 0.97), varied(trousers, 20, rng))
    rectangle(picture, (0.2, 0.17, 0.8, 0.55), coat)
    rectangle(picture, (0.06, 0.18, 0.19, 0.5), varied(coat, 25, rng))
    rectangle(picture, (0.81, 0.18, 0.94, 0.5), varied(coat, 25, rng))
    rectangle(picture, (0.47, 0.18, 0.53, 0.54), (220, 220, 220))
    rectangle(picture, (0.62, 0.34, 1.0, 0.5), (40, 60, 120))
    for left in (0.24, 0.52):
        rectangle(picture, (left, 0.95, left + 0.24, 1.0), DARK)
    disc(picture, (0.5, 0.085), 0.075 * size_px[1], (120, 150, 200))
    rectangle(picture, (0.36, 0.01, 0.64, 0.05), DARK)
    return _marked(picture, rng)


def _rider_side(size_px: tuple[int, int], rng: Generator, *, is_motorcycle: bool, faces_right: bool) -> Picture:
    """A two-wheeler with its rider from the side, cut out."""
    width, height = size_px
    picture = np.zeros((height, width, 4), np.uint8)
    coat, frame = (varied(BODY_COLOURS[rng.integers(len(BODY_COLOURS))], 20, rng) for _ in range(2))
    radius = (0.2 if is_motorcycle else 0.19) * height
    for part in (0.01 + radius / width, 0.99 - radius / width):
        disc(picture, (part, 1.0 - radius / height), radius, DARK)
        disc(picture, (part, 1.0 - radius / height), 0.75 * radius, (150, 150, 150))
        for turn in np.arange(6) * np.pi / 3:
            spoke = (part + 0.5 * radius / width * np.cos(turn), 1.0 - (radius + 0.5 * radius * np.sin(turn)) / height)
            disc(picture, spoke, 0.12 * radius, DARK)
    if is_motorcycle:
        rectangle(picture, (0.2, 0.52, 0.8, 0.72), frame)
        rectangle(picture, (0.36, 0.7, 0.64, 0.88), DARK)
        rectangle(picture, (0.74, 0.4, 0.86, 0.6), varied(frame, 50, rng))
    else:
        for left, top, right, bottom in ((0.24, 0.6, 0.76, 0.65), (0.44, 0.62, 0.49, 0.84), (0.2, 0.79, 0.5, 0.84)):
            rectangle(picture, (left, top, right, bottom), frame)
        rectangle(picture, (0.7, 0.44, 0.78, 0.8), frame)
    rectangle(picture, (0.34, 0.18, 0.58, 0.56), coat)
    rectangle(picture, (0.5, 0.24, 0.76, 0.34), varied(coat, 30, rng))
    rectangle(picture, (0.4, 0.52, 0.62, 0.78), varied(DARK, 25, rng))
    rectangle(picture, (0.34, 0.26, 0.42, 0.46), varied(coat, 70, rng))
    disc(picture, (0.53, 0.1), 0.095 * height, varied(frame, 40, rng) if is_motorcycle else (120, 150, 200))
    marked = _marked(picture, rng)
    return marked if faces_right else np.ascontiguousarray(marked[:, ::-1])


def _rider_end(size_px: tuple[int, int], rng: Generator, *, is_motorcycle: bool) -> Picture:
    """A two-wheeler with its rider from the front or rear, cut out."""
    picture = np.zeros((size_px[1], size_px[0], 4), np.uint8)
    coat = varied(BODY_COLOURS[rng.integers(len(BODY_COLOURS))], 20, rng)
    rectangle(picture, (0.42, 0.6, 0.58, 1.0), DARK)
    for left in (0.26, 0.6):
        rectangle(picture, (left, 0.5, left + 0.14, 0.8), varied(DARK, 25, rng))
    if is_motorcycle:
        rectangle(picture, (0.24, 0.48, 0.76, 0.66), varied(coat, 60, rng))
        rectangle(picture, (0.42, 0.54, 0.58, 0.6), (40, 30, 190))
    rectangle(picture, (0.2, 0.17, 0.8, 0.54), coat)
    rectangle(picture, (0.02, 0.38, 0.98, 0.44), varied(coat, 30, rng))
    rectangle(picture, (0.36, 0.24, 0.64, 0.42), varied(coat, 70, rng))
    disc(picture, (0.5, 0.09), 0.085 * size_px[1], varied(coat, 40, rng) if is_motorcycle else (120, 150, 200))
    return _marked(picture, rng)


def _marked(picture: Picture, rng: Generator) -> Picture:
    """A cut-out with marks on it, its outline as it was."""
    opacity = picture[:, :, 3].copy()
    blotches(picture, 30, (2.0, 5.0), 70, rng)
    picture[:, :, 3] = opacity
    return picture


def _leaves(size_px: tuple[int, int], rng: Generator) -> Picture:
    """A crown of leaves, cut out."""
    width, height = size_px
    picture = np.zeros((height, width, 4), np.uint8)
    turn, radius = rng.uniform(0, 2 * np.pi, 900), np.sqrt(rng.uniform(0, 1, 900))
    for angle, part in zip(turn, radius, strict=True):
        centre = (0.5 + 0.44 * part * np.cos(angle), 0.5 + 0.44 * part * np.sin(angle))
        disc(picture, centre, rng.uniform(4, 9), varied((40, 92, 60), 38, rng))
    return picture


def _asphalt(picture: Picture, colour: Colour, rng: Generator) -> None:
    picture[:] = asphalt((picture.shape[1], picture.shape[0]), rng)


CUT_OUT: dict[str, Callable[[tuple[int, int], Generator], Picture]] = {
    "walker": _walker,
    "leaves": _leaves,
    "motorcycle_left": partial(_rider_side, is_motorcycle=True, faces_right=False),
    "motorcycle_right": partial(_rider_side, is_motorcycle=True, faces_right=True),
    "motorcycle_end": partial(_rider_end, is_motorcycle=True),
    "cyclist_left": partial(_rider_side, is_motorcycle=False, faces_right=False),
    "cyclist_right": partial(_rider_side, is_motorcycle=False, faces_right=True),
    "cyclist_end": partial(_rider_end, is_motorcycle=False),
}
PAINTERS: dict[str, Painter] = {
    "plain": _plain, "car_rear": _car_rear, "car_front": _car_front, "car_left": _car_side, "car_right": _car_side,
    "windows": _windows, "bus_left": _bus_side, "bus_right": _bus_side, "bus_front": _bus_front, "bus_rear": _bus_rear,
    "cargo": _cargo, "cargo_doors": _cargo_doors, "chassis": _chassis, "cabin_front": _cabin_front,
    "cabin_side": _cabin_side, "house": _house, "roof": _roof, "bricks": _bricks, "patches": _patches, "post": _post,
    "bark": _patches, "hedge": _hedge, "hull": _hull, "nose": _nose, "engine": _engine,
    "asphalt": _asphalt,
}  # fmt: skip
BASE_COLOUR: dict[str, Colour] = {
    "chassis": (48, 46, 44), "bark": (50, 70, 95), "hedge": (50, 96, 68), "roof": (60, 75, 130),
}  # fmt: skip
TEXEL_M = {
    "house": 0.02,
    "bricks": 0.02,
    "roof": 0.03,
    "hedge": 0.02,
    "leaves": 0.015,
    "cargo": 0.012,
    "asphalt": 0.025,
}
"""Size of a texel where it is not 1 cm."""


def default_colour(kind: str, rng: Generator) -> Colour:
    """A colour for a body whose scene file gives none."""
    colours = HOUSE_COLOURS if kind in ("house", "wall") else BODY_COLOURS
    return colours[int(rng.integers(len(colours)))]
