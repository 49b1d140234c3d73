"""What bodies are made of: upright boxes with a painted skin on each face, in the body's own axes.

Body axes: x ahead, y to the left, z up, origin at the centre of the base. A board is a box without thickness.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ttcvid.model import Floats, Ints
from ttcvid.simulate.scene import Body, Vector

DEFAULT_SIZE_M: dict[str, Vector] = {
    "car": (4.3, 1.8, 1.45),
    "lorry": (9.0, 2.5, 3.6),
    "bus": (11.5, 2.55, 3.1),
    "wall": (20.0, 0.3, 2.5),
    "house": (12.0, 9.0, 7.5),
    "box": (1.0, 1.0, 1.0),
    "post": (0.2, 0.2, 3.0),
    "motorcycle": (2.1, 0.8, 1.55),
    "cyclist": (1.8, 0.6, 1.8),
    "walker": (0.0, 0.6, 1.75),
    "tree": (2.8, 2.8, 5.0),
    "aircraft": (9.0, 11.0, 2.8),
    "drone": (0.5, 0.5, 0.18),
    "island": (8.0, 8.0, 0.5),
    "slab": (20.0, 6.0, 0.02),
}
"""Length, width, height of each kind of body."""
SIDES = ("rear", "front", "left", "right")


@dataclass(frozen=True)
class Part:
    """A box ``low_m .. high_m`` (3,) in body axes; ``skins`` names what is painted on each face that is drawn."""

    low_m: Vector
    high_m: Vector
    skins: dict[str, str]


@dataclass(frozen=True)
class Face:
    """A rectangle: top-left corner ``origin_m``, unit vectors ``along_u`` and ``along_v`` (3,), ``size_m`` (u, v).

    Seen from outside, u runs right and v down, so ``along_u x along_v`` points into the body.
    """

    origin_m: Floats
    along_u: Floats
    along_v: Floats
    size_m: tuple[float, float]
    skin: str
    side: str

    @property
    def corners_m(self) -> Floats:
        """The corners ``(4, 3)``, from the top-left one on."""
        across, down = self.along_u * self.size_m[0], self.along_v * self.size_m[1]
        return np.array([self.origin_m + offset for offset in (0 * across, across, across + down, down)])


@dataclass(frozen=True)
class FaceArrays:
    """The rectangles of several bodies: ``origin_m, along_u, along_v (F, 3)`` and ``size_m (F, 2)`` as in `Face`.

    ``body (F,)`` is the place of each one's body among them.
    """

    origin_m: Floats
    along_u: Floats
    along_v: Floats
    size_m: Floats
    body: Ints


def face_arrays(faces_of_bodies: Sequence[Sequence[Face]]) -> FaceArrays:
    """The faces of bodies as arrays."""
    faces = [face for faces in faces_of_bodies for face in faces]
    return FaceArrays(
        np.array([face.origin_m for face in faces], float).reshape(-1, 3),
        np.array([face.along_u for face in faces], float).reshape(-1, 3),
        np.array([face.along_v for face in faces], float).reshape(-1, 3),
        np.array([face.size_m for face in faces], float).reshape(-1, 2),
        np.array([body for body, own in enumerate(faces_of_bodies) for _ in own], np.int64),
    )


def size_of(body: Body) -> Vector:
    """Length, width and height of a body in m."""
    length, width, height = body.size_m or DEFAULT_SIZE_M[body.kind]
    return (0.0 if body.kind == "walker" else length), width, height


def parts_of(body: Body) -> list[Part]:
    """The boxes of a body."""
    length, width, height = size_of(body)
    whole = ((-length / 2, -width / 2, 0.0), (length / 2, width / 2, height))
    match body.kind:
        case "car":
            return _car(length, width, height)
        case "lorry":
            return _lorry(length, width, height)
        case "tree":
            return _tree(length, width, height)
        case "motorcycle" | "cyclist":
            return _two_wheeler(body.kind, length, width, height)
        case "aircraft":
            return _aircraft(length, width, height)
        case "drone":
            return _drone(length, width, height)
        case "walker":
            return [Part(*whole, {"front": "walker", "rear": "walker"})]
        case "bus":
            return [Part(*whole, {**{side: f"bus_{side}" for side in SIDES}, "top": "plain"})]
        case "slab":
            return [Part(*whole, {**dict.fromkeys(SIDES, "plain"), "top": "asphalt"})]
        case "house":
            return [Part(*whole, {**dict.fromkeys(SIDES, "house"), "top": "roof"})]
        case _:
            skin = {"wall": "bricks", "post": "post", "island": "hedge", "box": "patches"}[body.kind]
            return [Part(*whole, {**dict.fromkeys(SIDES, skin), "top": "hedge" if skin == "hedge" else "patches"})]


def faces_of(parts: list[Part]) -> list[Face]:
    """All faces of some parts, in body axes; a board has one face on either side."""
    return [_face(part, side, skin) for part in parts for side, skin in part.skins.items()]


def distance_to_parts_m(parts: list[Part], point_m: Floats) -> Floats:
    """Distance of points ``(N, 3)`` in body axes from the nearest part: ``(N,)``, 0 inside."""
    distances = []
    for part in parts:
        outside = np.maximum(np.asarray(part.low_m) - point_m, point_m - np.asarray(part.high_m))
        distances.append(np.sqrt(np.sum(np.maximum(outside, 0.0) ** 2, axis=-1)))
    return np.asarray(np.min(distances, axis=0))


def _face(part: Part, side: str, skin: str) -> Face:
    (x0, y0, z0), (x1, y1, z1) = part.low_m, part.high_m
    origin, along_u, along_v, size = {
        "rear": ((x0, y1, z1), (0, -1, 0), (0, 0, -1), (y1 - y0, z1 - z0)),
        "front": ((x1, y0, z1), (0, 1, 0), (0, 0, -1), (y1 - y0, z1 - z0)),
        "left": ((x1, y1, z1), (-1, 0, 0), (0, 0, -1), (x1 - x0, z1 - z0)),
        "right": ((x0, y0, z1), (1, 0, 0), (0, 0, -1), (x1 - x0, z1 - z0)),
        "top": ((x1, y1, z1), (0, -1, 0), (-1, 0, 0), (y1 - y0, x1 - x0)),
        "bottom": ((x0, y0, z0), (1, 0, 0), (0, 1, 0), (x1 - x0, y1 - y0)),
    }[side]
    return Face(np.array(origin, float), np.array(along_u, float), np.array(along_v, float), size, skin, side)


def _car(length: float, width: float, height: float) -> list[Part]:
    """A lower body and a narrower cabin on it."""
    belt = 0.58 * height
    lower = Part(
        (-length / 2, -width / 2, 0.0),
        (length / 2, width / 2, belt),
        {**{side: f"car_{side}" for side in SIDES}, "top": "plain"},
    )
    cabin = Part(
        (-0.36 * length, -0.44 * width, belt),
        (0.17 * length, 0.44 * width, height),
        {**dict.fromkeys(SIDES, "windows"), "top": "plain"},
    )
    return [lower, cabin]


def _lorry(length: float, width: float, height: float) -> list[Part]:
    """A cargo box over a dark chassis, and a cabin in front."""
    cabin_from = length / 2 - 1.9
    half = width / 2
    cargo = Part(
        (-length / 2, -half, 0.9),
        (cabin_from - 0.3, half, height),
        {"rear": "cargo_doors", "front": "plain", "left": "cargo", "right": "cargo", "top": "plain"},
    )
    chassis = Part((-length / 2, -0.96 * half, 0.0), (cabin_from, 0.96 * half, 0.9), dict.fromkeys(SIDES, "chassis"))
    cabin = Part(
        (cabin_from, -0.96 * half, 0.0),
        (length / 2, 0.96 * half, 0.8 * height),
        {"front": "cabin_front", "left": "cabin_side", "right": "cabin_side", "rear": "plain", "top": "plain"},
    )
    return [cargo, chassis, cabin]


def _tree(length: float, width: float, height: float) -> list[Part]:
    """A trunk and two crossed boards of leaves."""
    crown = 0.3 * height
    trunk = Part((-0.12, -0.12, 0.0), (0.12, 0.12, 0.55 * height), dict.fromkeys(SIDES, "bark"))
    across = Part((0, -width / 2, crown), (0, width / 2, height), {"front": "leaves", "rear": "leaves"})
    along = Part((-length / 2, 0, crown), (length / 2, 0, height), {"left": "leaves", "right": "leaves"})
    return [trunk, across, along]


def _two_wheeler(kind: str, length: float, width: float, height: float) -> list[Part]:
    """Two crossed cut-out boards: the rider from the side, and from the front or rear."""
    end = f"{kind}_end"
    along = Part((-length / 2, 0, 0), (length / 2, 0, height), {"left": f"{kind}_left", "right": f"{kind}_right"})
    return [along, Part((0, -width / 2, 0), (0, width / 2, height), {"front": end, "rear": end})]


def _aircraft(length: float, width: float, height: float) -> list[Part]:
    """Fuselage (two boxes, so that it looks rounder), wings, tailplane, fin and two engines."""
    all_sides = (*SIDES, "top", "bottom")
    r = 0.42 * height / 2
    z = 0.42 * height
    x = length / 2
    half = width / 2
    skins = dict.fromkeys(all_sides, "hull")
    wing = {**dict.fromkeys(SIDES, "plain"), "top": "hull", "bottom": "hull"}
    parts = [
        Part((-x, -0.7 * r, z - r), (x, 0.7 * r, z + r), {**skins, "front": "nose"}),
        Part((-0.96 * x, -r, z - 0.7 * r), (0.92 * x, r, z + 0.7 * r), {**skins, "front": "nose"}),
        Part((-0.12 * x, -half, z - 0.1), (0.3 * x, half, z + 0.1), wing),
        Part((-0.98 * x, -0.36 * half, z + 0.2 * r), (-0.75 * x, 0.36 * half, z + 0.2 * r + 0.12), wing),
        Part((-x, -0.07, z + r), (-0.72 * x, 0.07, height), skins),
    ]
    for side in (-1, 1):
        y = side * 0.36 * half
        engine = ((0.0, y - 0.45 * r, z - 0.55 * r), (0.48 * x, y + 0.45 * r, z + 0.35 * r))
        parts.append(Part(*engine, {**skins, "front": "engine"}))
    return parts


def _drone(length: float, width: float, height: float) -> list[Part]:
    """A body between four arms, each with a rotor disc's box at its end."""
    skins = dict.fromkeys((*SIDES, "top", "bottom"), "patches")
    x, y = length / 2, width / 2
    parts = [Part((-0.45 * x, -0.4 * y, 0.0), (0.45 * x, 0.4 * y, 0.75 * height), skins)]
    for sx in (-1, 1):
        for sy in (-1, 1):
            cx, cy = 0.7 * x * sx, 0.7 * y * sy
            low = (cx - 0.3 * x, cy - 0.3 * y, 0.6 * height)
            parts.append(Part(low, (cx + 0.3 * x, cy + 0.3 * y, height), skins))
    return parts
