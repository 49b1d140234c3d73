"""OpenCV FileStorage (YAML, XML and JSON), as OpenCV's calibration programs write it, read by OpenCV itself.

Names differ from program to program; those of ``NAMES`` are looked for without regard to case and underscores.
4 or 5 coefficients mean plumb_bob, 8 (or 12 or 14 that end with zeros) rational, unless ``fisheye_model`` is 1 or
``distortion_model`` says otherwise: a file of 4 fisheye coefficients looks just like one of plumb_bob.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2

from ttcvid.calibration.fields import Fields
from ttcvid.calibration.intrinsics import (
    Intrinsics,
    canonical_coefficients,
    canonical_model,
    matrix_entries,
    matrix_labels,
)
from ttcvid.errors import CalibrationError
from ttcvid.model import ImageSize

NAMES = {
    "camera_matrix": ("cameramatrix", "k", "k1", "m", "m1", "mtx"),
    "distortion_coefficients": ("distortioncoefficients", "distcoeffs", "d", "d1", "dist"),
    "image_width": ("imagewidth", "width"),
    "image_height": ("imageheight", "height"),
    "image_size": ("imagesize",),
    "distortion_model": ("distortionmodel",),
    "fisheye_model": ("fisheyemodel",),
}
"""Our names of the entries, and the spellings of each, the preferred one first."""

MAX_LIST_LENGTH = 64
"""Longer lists (the corners of all boards) are no part of a camera."""

_HEADERS = ("%YAML", "<?xml", "<opencv_storage", "{")


def recognises(text: str) -> bool:
    """Whether a text is OpenCV's: plain YAML has no colon after %YAML, and no matrices."""
    start = text.lstrip()
    return start.startswith(("%YAML:", "<?xml", "<opencv_storage")) or "opencv-matrix" in text


def read(path: Path, text: str) -> Intrinsics:
    """Read a camera out of the text of a FileStorage."""
    fields = Fields(path, _entries(path, text))
    matrix = matrix_entries(fields, fields.first_name(["camera_matrix"], "write the camera matrix under this name"))
    name = fields.first_name(["distortion_coefficients"], "write zeros for a lens without distortion")
    model = _model(fields, len(fields.numbers(name)))
    coefficients = canonical_coefficients(fields, name, model)
    return Intrinsics(*matrix, _image_size(fields), model, coefficients, fields, matrix_labels("camera_matrix"))


def _model(fields: Fields, n_coefficients: int) -> str:
    if "distortion_model" in fields:
        return canonical_model(fields, "distortion_model")
    if "fisheye_model" in fields and fields.number("fisheye_model"):
        return "fisheye"
    return "plumb_bob" if n_coefficients <= 5 else "rational"


def _image_size(fields: Fields) -> ImageSize | None:
    if "image_size" in fields:
        return fields.image_size("image_size")
    if "image_width" in fields or "image_height" in fields:
        return fields.image_size_of("image_width", "image_height")
    return None


def _entries(path: Path, text: str) -> dict[str, Any]:
    """What a camera needs, under our names; any other entry under its own name, without its content."""
    text = text if text.lstrip().startswith(_HEADERS) else f"%YAML:1.0\n---\n{text}"
    try:
        storage = cv2.FileStorage(text.lstrip(), cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        root = storage.root()
        keys = list(root.keys()) if root.isMap() else []
        entries: dict[str, Any] = dict.fromkeys(keys)
        for name, spellings in NAMES.items():
            keys_of = {key.lower().replace("_", ""): key for key in reversed(keys)}
            key = next((keys_of[spelling] for spelling in spellings if spelling in keys_of), None)
            if key is not None:
                entries[name] = _plain(root.getNode(key))
        storage.release()
    # A constructor that fails in C++ raises SystemError in Python, with cv2.error as its cause.
    except (cv2.error, SystemError, ValueError) as error:
        raise CalibrationError(
            f"{path}: malformed OpenCV FileStorage ({_reason(error)}); expected YAML, XML or JSON as cv2.FileStorage "
            "writes it: write it again"
        ) from error
    return entries


def _plain(node: cv2.FileNode) -> Any:
    """A node as numbers, text, lists and mappings; a list that is too long for a camera becomes its length, as text."""
    if node.isMap():
        return {key: _plain(node.getNode(key)) for key in node.keys()}  # noqa: SIM118 (a FileNode is no mapping)
    if node.isSeq():
        n = int(node.size())
        return [_plain(node.at(i)) for i in range(n)] if n <= MAX_LIST_LENGTH else f"{n} values"
    if node.isInt() or node.isReal():
        return float(node.real())
    return node.string() if node.isString() else None


def _reason(error: BaseException) -> str:
    cause = error.__cause__ or error
    return str(getattr(cause, "err", "") or "it cannot be parsed").strip()[:120]
