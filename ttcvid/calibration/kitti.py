"""KITTI calibration: rectified pinhole cameras as 3x4 projection matrices.

Odometry and object files (``P0: ...``, or the same numbers without labels) do not say the picture size, so that of the
clip is taken; raw files (``calib_cam_to_cam.txt``) have it in ``S_rect_0i``. Of several cameras the one with the lowest
number is taken: rectified, they all have the same intrinsics. Pictures that are not rectified do not fit these files.
"""

from __future__ import annotations

import re
from pathlib import Path

from ttcvid.calibration.fields import Fields
from ttcvid.calibration.intrinsics import Intrinsics, matrix_labels

_LABELLED = re.compile(r"^[ \t]*(P(?:_rect_)?\d+)[ \t]*:(.*)$", re.MULTILINE)
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*(?:[eE][-+]?\d+)?|\.\d+(?:[eE][-+]?\d+)?|nan|inf)", re.IGNORECASE)
N_ENTRIES = 12
MIN_BARE_NUMBERS = 3
"""So many numbers and nothing else in the first line mean a file without labels."""


def recognises(text: str) -> bool:
    """Whether there is a line ``P0:`` or ``P_rect_00:``, or the first line has only numbers."""
    first = text.strip().splitlines()[0].split()
    return bool(_LABELLED.search(text)) or (len(first) >= MIN_BARE_NUMBERS and all(map(_NUMBER.fullmatch, first)))


def read(path: Path, text: str) -> Intrinsics:
    """Read the camera with the lowest number."""
    label, words = _first_projection(text)
    size_label = label.replace("P_", "S_")
    size_line = re.search(rf"^[ \t]*{size_label}[ \t]*:(.*)$", text, re.MULTILINE) if size_label != label else None
    values = {label: [_value(word) for word in words]}
    if size_line:
        values[size_label] = [_value(word) for word in size_line[1].split()]
    fields = Fields(path, values)
    expected = "12 numbers fx 0 cx tx 0 fy cy ty 0 0 1 tz"
    p = fields.numbers(label, expected)
    if len(p) != N_ENTRIES:
        raise fields.error(label, f"got {len(p)} numbers", f"{expected}: give the whole line")
    if p[1] != 0 or p[4] != 0 or p[8:11] != (0, 0, 1):
        raise fields.error(label, f"got {' '.join(words)}", f"{expected}: give calib.txt, not poses")
    size = fields.image_size(size_label) if size_line else None
    return Intrinsics(p[0], p[5], p[2], p[6], size, "none", (), fields, matrix_labels(label))


def _first_projection(text: str) -> tuple[str, list[str]]:
    labelled = sorted(
        (int(re.sub(r"\D", "", match[1])), match[1], match[2].split()) for match in _LABELLED.finditer(text)
    )
    if labelled:
        return labelled[0][1:]
    return "P0", text.strip().splitlines()[0].split()


def _value(word: str) -> float | str:
    """A number; any other word as it is, for the message about it."""
    return float(word) if _NUMBER.fullmatch(word) else word
