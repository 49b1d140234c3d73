"""OpenCV FileStorage (YAML, XML and JSON), as OpenCV's calibration programs write it.

Names differ from program to program; those of ``NAMES`` are looked for without regard to case and underscores.
4 or 5 coefficients mean plumb_bob, 8 (or 12 or 14 that end with zeros) rational, unless ``fisheye_model`` is 1 or
``distortion_model`` says otherwise: a file of 4 fisheye coefficients looks just like one of plumb_bob.

OpenCV's own parser is not used: it runs on for ever on some truncated lists, and crashes the process on deep nesting.
Its YAML is YAML but for the first line (``%YAML:1.0``) and the tag ``!!opencv-matrix``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from ttcvid.calibration.fields import Fields
from ttcvid.calibration.intrinsics import (
    Intrinsics,
    canonical_coefficients,
    canonical_model,
    matrix_entries,
    matrix_labels,
)
from ttcvid.calibration.text_file import LONG_LIST, MAX_LIST_CHARACTERS, parse_yaml, without_long_lists
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

_YAML_HEADER = re.compile(r"^\s*%YAML[^\n]*")


def recognises(text: str) -> bool:
    """Whether a text is OpenCV's: plain YAML has no colon after %YAML, and no matrices."""
    return text.lstrip().startswith(("%YAML:", "<?xml", "<opencv_storage")) or "opencv-matrix" in text


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
    """What a camera needs, under our names, and all entries under their own."""
    values = _parse_xml(path, text) if text.lstrip().startswith("<") else _parse_yaml_or_json(path, text)
    if not isinstance(values, Mapping):
        raise CalibrationError(f"{path}: OpenCV FileStorage without names; expected camera_matrix: ... in it")
    entries = {str(key): value for key, value in values.items()}
    keys = {key.lower().replace("_", ""): key for key in reversed(list(entries))}
    for name, spellings in NAMES.items():
        key = next((keys[spelling] for spelling in spellings if spelling in keys), None)
        if key is not None:
            entries[name] = entries[key]
    return entries


def _parse_yaml_or_json(path: Path, text: str) -> Any:
    # The line is emptied, not taken out, so that line numbers in messages stay true.
    return parse_yaml(path, _YAML_HEADER.sub("", without_long_lists(text)))


def _parse_xml(path: Path, text: str) -> Any:
    try:
        if "<!DOCTYPE" in text or "<!ENTITY" in text:
            raise ElementTree.ParseError("document types and entities are not accepted")
        root = ElementTree.fromstring(text.lstrip())
        if root.tag != "opencv_storage":
            raise ElementTree.ParseError(f"the outermost tag is <{root.tag[:40]}>")
    except ElementTree.ParseError as error:
        reason = " ".join(str(error).split())
        raise CalibrationError(
            f"{path}: not acceptable as XML: {reason}; expected <opencv_storage> as cv2.FileStorage writes it: "
            "write it again"
        ) from error
    return {child.tag: _plain(child) for child in root}


def _plain(element: ElementTree.Element) -> Any:
    """The content of an XML element: its elements by name, or its words as numbers where they are numbers."""
    if len(element) and element[0].tag != "_":
        return {child.tag: _text_values(child) for child in element}
    if len(element):
        return [_text_values(child) for child in element[: MAX_LIST_CHARACTERS // 2]]
    values = _text_values(element)
    return values[0] if isinstance(values, list) and len(values) == 1 else values


def _text_values(element: ElementTree.Element) -> Any:
    text = element.text or ""
    if len(text) > MAX_LIST_CHARACTERS:
        return LONG_LIST
    quoted = re.fullmatch(r'\s*"(.*)"\s*', text, re.DOTALL)
    return quoted[1] if quoted else [_number_or_word(word) for word in text.split()]


def _number_or_word(word: str) -> float | str:
    """XML spells numbers as OpenCV's YAML does, with .Nan and .Inf."""
    try:
        return float(word.replace(".Nan", "nan").replace(".Inf", "inf"))
    except ValueError:
        return word
