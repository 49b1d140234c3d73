"""Fields of a calibration file, taken out one by one; whatever is wrong becomes one line that names the field."""

from __future__ import annotations

import difflib
import math
import reprlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from ttcvid.errors import CalibrationError
from ttcvid.model import ImageSize

MAX_IMAGE_SIDE_PX = 100_000


def nearest_name(name: str, names: Iterable[str]) -> str | None:
    """The name that was probably meant: one that only lacks or adds a part at its end, else the most alike, if any.

    >>> nearest_name("fx", ["fy_px", "fx_px"]), nearest_name("camera_matirx", ["K", "camera_matrix"])
    ('fx_px', 'camera_matrix')
    """
    names = list(names)
    extended = [other for other in names if min(len(other), len(name)) > 1 and _is_start(other, name)]
    return next(iter(extended or difflib.get_close_matches(name, names, n=1, cutoff=0.7)), None)


def _is_start(one: str, other: str) -> bool:
    return one.startswith(other) or other.startswith(one)


class Fields:
    """A mapping inside a calibration file. ``where`` is its place, as in ``cam0.``, for messages."""

    def __init__(self, path: Path, values: Mapping[Any, Any], where: str = "") -> None:
        self.path = path
        self.values = values
        self.where = where
        self._known: frozenset[str] = frozenset()

    def error(self, name: str, problem: str, expected: str) -> CalibrationError:
        """What to raise for a field; ``expected`` ends with the remedy."""
        return CalibrationError(f"{self.path}: {self.where}{name}: {problem}; expected {expected}")

    def __contains__(self, name: str) -> bool:
        return name in self.values

    def refuse_unknown(self, known: Iterable[str]) -> None:
        """Raise for the first key that is not ``known``, with the nearest one."""
        known = list(known)
        self._known = frozenset(known)
        for name in self.values:
            if name not in known:
                near = nearest_name(str(name), known)
                hint = f"did you mean {near!r}?" if near else "remove it"
                raise self.error(reprlib.repr(name).strip("'"), "unknown key", f"{', '.join(known)}: {hint}")

    def first_name(self, names: Iterable[str], remedy: str = "add it") -> str:
        """The first of several names that is there."""
        names = list(names)
        for name in names:
            if name in self.values:
                return name
        found = [str(name) for name in self.values if name not in self._known]
        near = [match for name in names if (match := nearest_name(name, found))]
        hint = f"did you mean it by {near[0]!r}?" if near else remedy
        raise self.error(names[0], "missing", f"the key {' or '.join(names)}: {hint}")

    def number(self, name: str, expected: str = "a number") -> float:
        """A finite number."""
        return self._finite(name, self.values[self.first_name([name])], expected)

    def numbers(self, name: str, expected: str = "a list of numbers") -> tuple[float, ...]:
        """A list of finite numbers, also when written as ``{rows, cols, data}`` or as a list of lists."""
        value = self.values[self.first_name([name])]
        label = name
        if isinstance(value, Mapping):
            inner = Fields(self.path, value, f"{self.where}{name}.")
            value, label = value[inner.first_name(["data"])], f"{name}.data"
        if not isinstance(value, (list, tuple)):
            raise self.error(label, f"got {reprlib.repr(value)}", expected)
        flat = [x for item in value for x in (item if isinstance(item, (list, tuple)) else (item,))]
        return tuple(self._finite(f"{label}[{i}]", x, "a finite number") for i, x in enumerate(flat))

    def text(self, name: str, expected: str) -> str:
        """A piece of text."""
        value = self.values[self.first_name([name])]
        if not isinstance(value, str):
            raise self.error(name, f"got {reprlib.repr(value)}", expected)
        return value

    def section(self, name: str) -> Fields:
        """A mapping inside this one."""
        value = self.values[self.first_name([name])]
        if not isinstance(value, Mapping):
            raise self.error(name, f"got {reprlib.repr(value)}", "keys with values below it")
        return Fields(self.path, value, f"{self.where}{name}.")

    def image_size(self, name: str) -> ImageSize:
        """A list ``[width, height]`` of whole numbers of pixels."""
        sides = self.numbers(name, "[width, height] in px")
        if len(sides) != 2:
            raise self.error(name, f"got {len(sides)} numbers", "[width, height] in px")
        return ImageSize(*(self._side(name, side) for side in sides))

    def image_size_of(self, width_name: str, height_name: str) -> ImageSize:
        """A picture size whose sides stand in two fields."""
        return ImageSize(*(self._side(name, self.number(name)) for name in (width_name, height_name)))

    def _side(self, name: str, side: float) -> int:
        if not (1 <= side <= MAX_IMAGE_SIDE_PX and side == int(side)):
            raise self.error(
                name, f"got {side:g}", f"whole numbers of pixels from 1 to {MAX_IMAGE_SIDE_PX}: correct it"
            )
        return int(side)

    def _finite(self, label: str, value: Any, expected: str) -> float:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self.error(label, f"got {reprlib.repr(value)}", f"{expected}: correct it")
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            raise self.error(label, f"got {number}", f"{expected}, which must be finite: calibrate again or correct it")
        return number
