"""Our own camera files: a few lines of YAML, easy to write by hand.

``image_size: [w, h]``, ``fx_px``, ``fy_px``, ``cx_px``, ``cy_px``; and, where the lens bends straight lines,
``distortion_model`` (none, plumb_bob, rational, fisheye) with ``distortion``, the list of OpenCV's coefficients.
Any other key is an error.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from ttcvid.calibration.fields import Fields
from ttcvid.calibration.intrinsics import Intrinsics, canonical_coefficients, canonical_model
from ttcvid.errors import OutputError
from ttcvid.model import Camera

NUMBER_KEYS = ("fx_px", "fy_px", "cx_px", "cy_px")
KEYS = ("image_size", *NUMBER_KEYS, "distortion_model", "distortion")


def recognises(values: Mapping[Any, Any]) -> bool:
    """Whether the keys are those of our own format, if only some of them."""
    return any(key in values for key in (*NUMBER_KEYS, "distortion")) or (
        "image_size" in values and "horizon" not in values
    )


def read(fields: Fields) -> Intrinsics:
    """Read the fields of a file of our own format."""
    fields.refuse_unknown(KEYS)
    size = fields.image_size("image_size")
    fx, fy, cx, cy = (fields.number(name, "a number of px") for name in NUMBER_KEYS)
    model = "none"
    coefficients: tuple[float, ...] = ()
    if "distortion_model" in fields or "distortion" in fields:
        model = canonical_model(fields, fields.first_name(["distortion_model"], "name the model of distortion"))
        if model != "none" or "distortion" in fields:
            coefficients = canonical_coefficients(fields, "distortion", model)
    return Intrinsics(fx, fy, cx, cy, size, model, coefficients, fields, NUMBER_KEYS)


def write_camera(path: Path, camera: Camera) -> None:
    """Write a camera file of our own format; `read_camera` gives back the same numbers.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    values: dict[str, Any] = {"image_size": [camera.image_size.width_px, camera.image_size.height_px]}
    values |= {name: float(getattr(camera, name)) for name in NUMBER_KEYS}
    values["distortion_model"] = camera.distortion_model
    values["distortion"] = [float(k) for k in camera.distortion]
    try:
        path.write_text(yaml.safe_dump(values, sort_keys=False, default_flow_style=None), encoding="utf-8")
    except OSError as error:
        raise OutputError(
            f"{path}: the camera file cannot be written ({error.strerror}): choose another place"
        ) from error
