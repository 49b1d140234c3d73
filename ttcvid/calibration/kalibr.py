"""Kalibr camera chains (``camchain.yaml``). Of several cameras the one with the lowest number is taken, so cam0.

To use another one, copy its block into a file of its own. Only pinhole cameras: omni, ds and eucm are refused.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from ttcvid.calibration.fields import Fields
from ttcvid.calibration.intrinsics import Intrinsics, canonical_coefficients, canonical_model

_CAMERA_KEY = re.compile(r"cam(\d+)")


def recognises(values: Mapping[Any, Any]) -> bool:
    """Whether there is a block cam0, cam1, ..."""
    return any(_number(key) is not None for key in values)


def read(fields: Fields) -> Intrinsics:
    """Read the camera with the lowest number."""
    names = {number: key for key in fields.values if (number := _number(key)) is not None}
    camera = fields.section(names[min(names)])
    kind = camera.text("camera_model", "pinhole")
    if kind != "pinhole":
        raise camera.error(
            "camera_model", f"got {kind!r}", "pinhole: calibrate again with pinhole-radtan or pinhole-equi"
        )
    numbers = camera.numbers("intrinsics", "[fu, fv, pu, pv] in px")
    if len(numbers) != 4:
        raise camera.error("intrinsics", f"got {len(numbers)} numbers", "[fu, fv, pu, pv] in px: correct it")
    model = canonical_model(camera, "distortion_model")
    coefficients: tuple[float, ...] = ()
    if model != "none":
        coefficients = canonical_coefficients(camera, "distortion_coeffs", model)
    fx, fy, cx, cy = numbers
    labels = ("intrinsics fu", "intrinsics fv", "intrinsics pu", "intrinsics pv")
    return Intrinsics(fx, fy, cx, cy, camera.image_size("resolution"), model, coefficients, camera, labels)


def _number(key: Any) -> int | None:
    match = _CAMERA_KEY.fullmatch(key) if isinstance(key, str) else None
    return int(match[1]) if match else None
