"""ROS camera_info: the files of ``camera_calibration``, and messages printed by ROS 1 (K, D) and ROS 2 (k, d).

The raw picture is meant, so the camera matrix and the distortion count, not ``projection_matrix``. Of several printed
messages the first is taken. An empty list of coefficients means a lens without distortion, as simulators send it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ttcvid.calibration.fields import Fields
from ttcvid.calibration.intrinsics import (
    Intrinsics,
    canonical_coefficients,
    canonical_model,
    matrix_entries,
    matrix_labels,
)

MATRIX_NAMES = ("camera_matrix", "K", "k")
COEFFICIENTS_NAMES = ("distortion_coefficients", "D", "d")
WIDTH_NAMES = ("image_width", "width")
HEIGHT_NAMES = ("image_height", "height")


def recognises(values: Mapping[Any, Any]) -> bool:
    """Whether the keys are those of a camera_info, if only some of them."""
    return any(key in values for key in (*MATRIX_NAMES, "distortion_coefficients", "image_width", "image_height"))


def read(fields: Fields) -> Intrinsics:
    """Read the fields of a camera_info."""
    size = fields.image_size_of(fields.first_name(WIDTH_NAMES), fields.first_name(HEIGHT_NAMES))
    matrix = fields.first_name(MATRIX_NAMES)
    entries, labels = matrix_entries(fields, matrix), matrix_labels(matrix)
    name = fields.first_name(COEFFICIENTS_NAMES, "write an empty list for a lens without distortion")
    if not fields.numbers(name):
        return Intrinsics(*entries, size, "none", (), fields, labels)
    model = canonical_model(fields, fields.first_name(["distortion_model"], "write plumb_bob where it is unknown"))
    return Intrinsics(*entries, size, model, canonical_coefficients(fields, name, model), fields, labels)
