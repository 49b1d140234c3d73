"""Masks: pictures that are black where nothing is to be analysed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ttcvid.errors import CalibrationError
from ttcvid.model import ImageSize, Picture
from ttcvid.picture_header import size_in_header
from ttcvid.plain_files import read_plain

_JPEG_START = b"\xff\xd8\xff"
JPEG_BLACK_LEVEL = 32
"""JPEG leaves ripples of this height, of 255, in what was painted black."""
MAX_FILE_BYTES = 200_000_000


def read_mask(path: Path, image_size: ImageSize) -> Picture:
    """The mask ``(H, W)``, uint8: 0 where nothing is to be looked at, 255 elsewhere.

    Any picture that OpenCV can read: 8 or 16 bit, grey or colour. Exactly black is left out (JPEG: nearly black),
    anything else is looked at.

    Raises
    ------
    CalibrationError
        The file cannot be read, is no picture, has transparent parts (what do they mean?), has another size than the
        clip, or is all black.
    """
    content = _content(path)
    claimed = size_in_header(content)
    if claimed is None:
        raise CalibrationError(
            f"{path}: no picture that can be read; expected a mask of {image_size}, black where nothing is to be "
            "analysed: save it as PNG"
        )
    _require_size(path, claimed, image_size)  # before it is decoded: a few bytes can claim gigabytes
    try:
        picture: Any = cv2.imdecode(np.frombuffer(content, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise CalibrationError(
            f"{path}: the mask cannot be decoded ({error.err}); expected a picture of {image_size}"
        ) from error
    if picture is None:
        raise CalibrationError(
            f"{path}: no picture; expected a mask of {image_size}, black where nothing is to be analysed"
        )
    _require_size(path, (picture.shape[1], picture.shape[0]), image_size)
    return _black_or_white(path, picture, JPEG_BLACK_LEVEL if content.startswith(_JPEG_START) else 0)


def _require_size(path: Path, size: tuple[int, int], image_size: ImageSize) -> None:
    width, height = size
    if (width, height) != (image_size.width_px, image_size.height_px):
        raise CalibrationError(
            f"{path}: the mask is {width}x{height}; expected {image_size}, the size of the clip: paint it on one "
            "of its frames"
        )


def _content(path: Path) -> bytes:
    try:
        if path.is_dir():
            raise CalibrationError(f"{path}: is a folder; expected a mask, one picture: name the file")
        if not path.exists():
            raise CalibrationError(
                f"{path}: no such file; expected a mask, a picture of the clip's size: check the path"
            )
        content = read_plain(path, MAX_FILE_BYTES)
    except OSError as error:
        raise CalibrationError(
            f"{path}: the mask cannot be read ({error.strerror}): give a picture that can be, as PNG"
        ) from error
    if not content:
        raise CalibrationError(f"{path}: the file is empty; expected a mask, a picture of the clip's size")
    return content


def _black_or_white(path: Path, picture: Any, black_level: int) -> Picture:
    if picture.dtype not in (np.uint8, np.uint16):
        raise CalibrationError(
            f"{path}: the mask has values of type {picture.dtype}; expected 8 or 16 bit: save it as PNG"
        )
    channels = picture.reshape(*picture.shape[:2], -1)
    if channels.shape[2] in (2, 4):
        if np.any(channels[:, :, -1] != np.iinfo(picture.dtype).max):
            raise CalibrationError(
                f"{path}: the mask has transparent parts; expected black and white: flatten the picture"
            )
        channels = channels[:, :, :-1]
    mask: Picture = np.where(np.any(channels > black_level, axis=2), 255, 0).astype(np.uint8)
    if not mask.any():
        raise CalibrationError(
            f"{path}: the mask is all black; expected some of the picture left: invert or repaint it"
        )
    return mask
