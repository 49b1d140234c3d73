"""Horizon files (YAML): written by ``calibrate-horizon``, or by hand with the two keys that are needed.

``image_size: [w, h]`` and ``horizon: {y_left_px, y_right_px}``, the line at x = 0 and x = w - 1 in undistorted pixels.
``horizon`` may also have ``sigma_rad``, the standard deviation of the direction of the plane's normal, and
``covariance_rad2``, the 2x2 covariance of (pitch, roll), whose longest axis gives ``sigma_rad`` where that is absent.
The keys of ``INFORMATION_KEYS`` are for the reader and change nothing; any other key is an error.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ttcvid.calibration.fields import Fields
from ttcvid.calibration.text_file import parse_yaml, read_text
from ttcvid.errors import CalibrationError, OutputError
from ttcvid.model import Horizon, ImageSize

DEFAULT_SIGMA_RAD = 0.005
"""Where the file has no sigma: what a hand-drawn line is good for, 3.6 px at a focal length of 720 px."""
MAX_SIGMA_RAD = 0.5
MAX_Y_HEIGHTS = 100.0
"""Farther from the picture than this, in picture heights, is a slip of the pen."""

Covariance = tuple[tuple[float, float], tuple[float, float]]

HORIZON_KEYS = ("y_left_px", "y_right_px", "sigma_rad", "covariance_rad2")
INFORMATION_KEYS = (
    "pitch_deg",
    "roll_deg",
    "band_95_px",
    "n_motions",
    "n_tracks",
    "residuals",
    "roll_zero",
    "source",
    "source_sha256",
    "ttcvid_version",
)
HORIZON_FILE = "a horizon file (image_size: [w, h], horizon: {y_left_px: ..., y_right_px: ...})"


def read_horizon(path: Path, image_size: ImageSize) -> Horizon:
    """The horizon of a file, for pictures of ``image_size``; ``origin`` is the path.

    Raises
    ------
    CalibrationError
        The file cannot be read, is for another picture size, or has a missing, unknown or impossible value.
    """
    values = parse_yaml(path, read_text(path, HORIZON_FILE))
    if not isinstance(values, Mapping):
        raise CalibrationError(f"{path}: no keys in it, only plain text; expected {HORIZON_FILE}")
    fields = Fields(path, values)
    fields.refuse_unknown(("image_size", "horizon", *INFORMATION_KEYS))
    size = fields.image_size("image_size")
    if size != image_size:
        remedy = "calibrate the horizon with clips of this size"
        raise fields.error("image_size", f"the file is for {size}", f"{image_size}, the size of the clip: {remedy}")
    line = fields.section("horizon")
    line.refuse_unknown(HORIZON_KEYS)
    y_left, y_right = (_height_px(line, name, size) for name in ("y_left_px", "y_right_px"))
    covariance = _covariance_rad2(line)
    return Horizon(y_left, y_right, size, _sigma_rad(line, covariance), str(path), covariance)


def write_horizon(path: Path, horizon: Horizon, information: Mapping[str, Any] | None = None) -> None:
    """Write a horizon file that `read_horizon` gives back; ``information`` goes under its own `INFORMATION_KEYS`.

    Raises
    ------
    OutputError
        The file cannot be written.
    ValueError
        ``information`` has another key.
    """
    unknown = set(information or ()) - set(INFORMATION_KEYS)
    if unknown:
        raise ValueError(f"information: unknown keys {sorted(unknown)}; expected some of {', '.join(INFORMATION_KEYS)}")
    line: dict[str, Any] = {name: float(getattr(horizon, name)) for name in ("y_left_px", "y_right_px", "sigma_rad")}
    if horizon.covariance_rad2 is not None:
        line["covariance_rad2"] = [[float(value) for value in row] for row in horizon.covariance_rad2]
    size = [horizon.image_size.width_px, horizon.image_size.height_px]
    values = {"image_size": size, "horizon": line, **(information or {})}
    try:
        path.write_text(yaml.safe_dump(values, sort_keys=False, default_flow_style=None), encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{path}: the horizon cannot be written ({error.strerror}): choose another place") from error


def _height_px(line: Fields, name: str, size: ImageSize) -> float:
    y_px = line.number(name, "a number of px")
    if abs(y_px) > MAX_Y_HEIGHTS * size.height_px:
        bound = MAX_Y_HEIGHTS * size.height_px
        raise line.error(name, f"got {y_px:g}", f"between {-bound:g} and {bound:g} px: correct it")
    return y_px


def _covariance_rad2(line: Fields) -> Covariance | None:
    name = "covariance_rad2"
    if name not in line:
        return None
    entries = line.numbers(name)
    if len(entries) != 4 or entries[1] != entries[2]:
        raise line.error(name, f"got {len(entries)} numbers", "a symmetric [[a, b], [b, c]] in rad^2: correct it")
    smallest, largest = np.linalg.eigvalsh(np.reshape(entries, (2, 2)))
    if not (smallest >= 0 and 0 < largest <= MAX_SIGMA_RAD**2):
        expected = f"a covariance with deviations above 0 and up to {MAX_SIGMA_RAD:g} rad: leave it out if unknown"
        raise line.error(name, f"got {list(entries)}", expected)
    return (entries[0], entries[1]), (entries[2], entries[3])


def _sigma_rad(line: Fields, covariance_rad2: Covariance | None) -> float:
    name = "sigma_rad"
    if name not in line:
        if covariance_rad2 is None:
            return DEFAULT_SIGMA_RAD
        return math.sqrt(np.linalg.eigvalsh(np.array(covariance_rad2))[-1])
    sigma = line.number(name, "a number of rad")
    if not 0 < sigma <= MAX_SIGMA_RAD:
        expected = (
            f"a standard deviation above 0 and up to {MAX_SIGMA_RAD:g} rad: leave it out for {DEFAULT_SIGMA_RAD:g}"
        )
        raise line.error(name, f"got {sigma:g} rad", expected)
    return sigma
