"""What every camera format comes down to, and the checks that all of them share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.calibration.fields import Fields
from ttcvid.geometry.camera.pinhole import rays_from_pixels
from ttcvid.model import Camera, ImageSize

MODEL_OF_NAME = {
    "none": "none",
    "plumb_bob": "plumb_bob",
    "radtan": "plumb_bob",
    "rational": "rational",
    "rational_polynomial": "rational",
    "fisheye": "fisheye",
    "equidistant": "fisheye",
}
"""Names of distortion models in all formats, and ours for each."""

MIN_FOCAL_WIDTHS, MAX_FOCAL_WIDTHS = 0.04, 60.0
"""Bounds of the focal length in picture widths, 171 and 1 deg of view; lengths in mm and poses lie outside."""
MAX_FOCAL_RATIO = 4.0
"""Pixels that are longer than wide by more than this are a slip of the pen."""
MAX_CENTRE_OFFSET = 1.0
"""How far from the picture's centre the principal point may lie, in picture widths or heights (cropped pictures)."""
MIN_SEEN_FRACTION = 0.25
"""Part of the picture that must have rays: a wrong order of coefficients folds the lens over early; the black corners
of a round fisheye picture are fine."""


@dataclass(frozen=True)
class Intrinsics:
    """A camera as its file has it.

    ``image_size`` is None where the format does not say; ``fields`` is the place in the file, and ``labels`` are the
    names of fx, fy, cx, cy there.
    """

    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    image_size: ImageSize | None
    distortion_model: str
    distortion: tuple[float, ...]
    fields: Fields
    labels: tuple[str, str, str, str]


def matrix_labels(name: str) -> tuple[str, str, str, str]:
    """Names, for messages, of what `matrix_entries` takes out of a field."""
    return f"{name} fx", f"{name} fy", f"{name} cx", f"{name} cy"


def matrix_entries(fields: Fields, name: str) -> tuple[float, float, float, float]:
    """(fx, fy, cx, cy) of a 3x3 camera matrix."""
    expected = "a 3x3 matrix [fx, 0, cx, 0, fy, cy, 0, 0, 1]"
    k = fields.numbers(name, expected)
    if len(k) != 9:
        raise fields.error(name, f"got {len(k)} numbers", f"{expected}: give all 9")
    if k[1] != 0 or k[3] != 0 or k[6:] != (0, 0, 1):
        got = ", ".join(f"{x:g}" for x in k)
        raise fields.error(name, f"got [{got}]", f"{expected}, row by row and without skew: correct it")
    return k[0], k[4], k[2], k[5]


def canonical_model(fields: Fields, name: str) -> str:
    """Our name of the distortion model in a field."""
    expected = f"one of {', '.join(MODEL_OF_NAME)}"
    given = fields.text(name, expected)
    model = MODEL_OF_NAME.get(given.strip().lower())
    if model is None:
        raise fields.error(
            name, f"unknown distortion model {given!r}", f"{expected}: calibrate again with one of these"
        )
    return model


def canonical_coefficients(fields: Fields, name: str, model: str) -> tuple[float, ...]:
    """The coefficients of a field in the number that the model has; missing k3, and zeros at the end, count as zero."""
    given = fields.numbers(name, f"the coefficients of {model}")
    n_wanted, allowed = {
        "none": (0, "no coefficient"),
        "plumb_bob": (5, "4 or 5 (k1 k2 p1 p2 [k3])"),
        "rational": (8, "8 (k1 k2 p1 p2 k3 k4 k5 k6)"),
        "fisheye": (4, "4 (k1 k2 k3 k4)"),
    }[model]
    wanted = given[:n_wanted] + (0.0,) * (5 - len(given) if model == "plumb_bob" and len(given) == 4 else 0)
    if len(wanted) != n_wanted or any(given[n_wanted:]):
        raise fields.error(name, f"got {len(given)} coefficients", f"{allowed} for {model}: add or remove some")
    return wanted


def camera_from_intrinsics(intrinsics: Intrinsics, image_size: ImageSize, origin: str) -> Camera:
    """The camera of a file for pictures of ``image_size``.

    Raises
    ------
    CalibrationError
        The file is for another size, or a value is out of bounds.
    """
    _check_size(intrinsics, image_size)
    _check_bounds(intrinsics, image_size)
    i = intrinsics
    camera = Camera(i.fx_px, i.fy_px, i.cx_px, i.cy_px, image_size, i.distortion_model, i.distortion, origin)
    _check_lens(camera, i.fields)
    return camera


def _check_size(intrinsics: Intrinsics, image_size: ImageSize) -> None:
    size = intrinsics.image_size
    if size is None or size == image_size:
        return
    scale = image_size.width_px / size.width_px
    remedy = "give the camera file of this clip"
    if abs(size.height_px * scale - image_size.height_px) < 1.0:
        # Pixels are counted from the centre of the first one.
        remedy += (
            f", or, if the clip was scaled, multiply fx, fy, cx, cy by {scale:.6g}, add {(scale - 1.0) / 2.0:.6g} to "
            f"cx and cy, and write {image_size} into it"
        )
    raise intrinsics.fields.error(
        "image size", f"the file is for {size}", f"{image_size}, the size of the clip: {remedy}"
    )


def _check_bounds(intrinsics: Intrinsics, size: ImageSize) -> None:
    i, fields = intrinsics, intrinsics.fields
    fx_label, fy_label, cx_label, cy_label = i.labels
    for name, focal in ((fx_label, i.fx_px), (fy_label, i.fy_px)):
        if focal <= 0:
            raise fields.error(name, f"got {focal:g} px", "a focal length above 0: calibrate again or correct it")
    low, high = MIN_FOCAL_WIDTHS * size.width_px, MAX_FOCAL_WIDTHS * size.width_px
    if not low < i.fx_px < high:
        bounds = f"{low:.4g} to {high:.4g} px for pictures {size.width_px} px wide"
        raise fields.error(fx_label, f"got {i.fx_px:g} px", f"{bounds}: give the focal length in px, not in mm or m")
    if not 1 / MAX_FOCAL_RATIO < i.fx_px / i.fy_px < MAX_FOCAL_RATIO:
        near = f"about {fx_label}, which is {i.fx_px:g} px: correct one of them"
        raise fields.error(fy_label, f"got {i.fy_px:g} px", near)
    for name, centre, side in ((cx_label, i.cx_px, size.width_px), (cy_label, i.cy_px, size.height_px)):
        if abs(centre - (side - 1) / 2) > MAX_CENTRE_OFFSET * side:
            near = f"a place near the centre of the picture, {(side - 1) / 2:g} px: calibrate again or correct it"
            raise fields.error(name, f"got {centre:g} px, far outside the picture ({size})", near)


def _check_lens(camera: Camera, fields: Fields) -> None:
    size = camera.image_size
    x, y = np.meshgrid(np.linspace(0, size.width_px - 1, 17), np.linspace(0, size.height_px - 1, 17))
    rays = rays_from_pixels(camera, np.stack([x.ravel(), y.ravel()], axis=1))
    seen = float(np.isfinite(rays[:, 2]).mean())
    if seen < MIN_SEEN_FRACTION:
        given = ", ".join(f"{k:g}" for k in camera.distortion)
        raise fields.error(
            "distortion",
            f"{camera.distortion_model} [{given}] folds over: only {seen:.0%} of the picture has rays",
            f"at least {MIN_SEEN_FRACTION:.0%}: check the order and the signs of the coefficients, or the model",
        )
