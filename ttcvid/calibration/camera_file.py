"""Camera files of every accepted format, recognised by their content."""

from __future__ import annotations

import reprlib
from collections.abc import Mapping
from pathlib import Path

from ttcvid.calibration import kalibr, kitti, opencv, own, ros
from ttcvid.calibration.fields import Fields, nearest_name
from ttcvid.calibration.intrinsics import Intrinsics, camera_from_intrinsics
from ttcvid.calibration.text_file import parse_yaml, read_text
from ttcvid.errors import CalibrationError
from ttcvid.model import Camera, ImageSize

CAMERA_FILE = "a camera file (own YAML, ROS camera_info, Kalibr camchain, OpenCV FileStorage or KITTI calib)"


def read_camera(path: Path, image_size: ImageSize) -> Camera:
    """The camera of a file, for pictures of ``image_size``; ``origin`` is the path.

    Raises
    ------
    CalibrationError
        The file cannot be read, is of no accepted format, is for another picture size, or has a missing, unknown or
        impossible value. Files that name no size (KITTI odometry, some of OpenCV) are taken for the clip's.
    """
    return camera_from_intrinsics(_read_intrinsics(path), image_size, str(path))


def read_camera_image_size(path: Path) -> ImageSize | None:
    """The picture size that a camera file is for; None where its format does not say.

    Raises
    ------
    CalibrationError
        The file cannot be read, or is of no accepted format.
    """
    return _read_intrinsics(path).image_size


def _read_intrinsics(path: Path) -> Intrinsics:
    text = read_text(path, CAMERA_FILE)
    # OpenCV's and KITTI's texts come first: the one is no YAML, the other is YAML by accident.
    if opencv.recognises(text):
        return opencv.read(path, text)
    if kitti.recognises(text):
        return kitti.read(path, text)
    values = parse_yaml(path, text)
    if not isinstance(values, Mapping):
        raise CalibrationError(f"{path}: no camera in it, only plain text; expected {CAMERA_FILE}")
    fields = Fields(path, values)
    if kalibr.recognises(values):
        return kalibr.read(fields)
    if ros.recognises(values):
        return ros.read(fields)
    if own.recognises(values):
        return own.read(fields)
    raise CalibrationError(f"{path}: no camera in it: {_found(values)}; expected {CAMERA_FILE}")


def _found(values: Mapping[object, object]) -> str:
    keys = [reprlib.repr(key).strip("'") for key in values]
    near = next(((key, hit) for key in keys if (hit := nearest_name(key, own.KEYS))), None)
    hint = f" (did you mean {near[1]!r} by {near[0]!r}?)" if near else ""
    return f"found the keys {', '.join(keys[:8])}{hint}" if keys else "found no keys"
