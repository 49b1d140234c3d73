"""What every command may rely on in the manifest of a run, checked once, when the run is opened."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ttcvid.errors import InputError, quoted
from ttcvid.model import Camera, ImageSize
from ttcvid.sinks.manifest import MANIFEST_NAME, read_manifest

EXIT_CODES = {"complete": 0, "truncated": 4, "interrupted": 130}
"""Exit code of a run by the ``state`` in its manifest."""

_SIZE = {"width_px": int, "height_px": int}
_TIMES_OF_WORK = {"total_s": float, "frames_per_s": float}
_CAMERA = {
    **dict.fromkeys(("fx_px", "fy_px", "cx_px", "cy_px"), float),
    "distortion_model": str,
    "distortion": list,
    "origin": str,
    "is_assumed": bool,
    "image_size": _SIZE,
}
_COUNTS = dict.fromkeys(("frames", "track_rows", "objects", "events", "skipped_packets"), int)
_HORIZON = {**dict.fromkeys(("y_left_px", "y_right_px", "sigma_rad"), float), "origin": str, "image_size": _SIZE}
_SETTINGS = {"analyze": {"stride": {"value": int}}, "egomotion": {"platform": {"value": str}}}
REQUIRED: dict[str, Any] = {
    "state": str,
    "versions": {},
    "configuration": _SETTINGS,
    "input": {"nominal_dt_s": float, "sha256": str, "n_files": int, "kind": str},
    "camera": _CAMERA,
    "image_size": _SIZE,
    "platform": {"value": str, "is_told_by_clip": bool, "reason": str},
    "counts": _COUNTS,
    "timings": _TIMES_OF_WORK,
    "limits": list,
    "warnings": list,
}
"""Fields that have to be there, with their types; a mapping stands for fields below a field."""
_NEAREST = {"cluster_id": int, "frame": int, **dict.fromkeys(("ttc_z_s", "ttc_z_lo_s", "ttc_z_hi_s"), float)}
_MAY_BE_NULL: dict[str, Any] = {"horizon": _HORIZON, "nearest": _NEAREST}
_KINDS = {str: "text", int: "a whole number", float: "a finite number", bool: "true or false", list: "a list"}
_REMEDY = "give the folder of 'ttcvid analyze', or analyse again"


def read_run_manifest(folder: Path) -> dict[str, Any]:
    """The manifest of a run in ``folder``; InputError where there is none, or one that was cut down or edited."""
    manifest = read_manifest(folder)
    path = folder / MANIFEST_NAME
    _require(path, "", manifest, REQUIRED)
    for name, fields in _MAY_BE_NULL.items():
        if name not in manifest:
            raise InputError(f"{path}: field {name!r} is missing: {_REMEDY}")
        if manifest[name] is not None:
            _require(path, name, manifest[name], fields)
    if manifest["state"] not in EXIT_CODES:
        raise InputError(
            f"{path}: field 'state' = {quoted(manifest['state'])}: expected one of {', '.join(EXIT_CODES)}: {_REMEDY}"
        )
    return manifest


def camera_of(described: Mapping[str, Any]) -> Camera:
    """The camera as a manifest describes it."""
    names = ("fx_px", "fy_px", "cx_px", "cy_px", "distortion_model", "origin")
    return Camera(
        **{name: described[name] for name in names},
        image_size=ImageSize(**described["image_size"]),
        distortion=tuple(described["distortion"]),
        focal_sigma_px=described.get("focal_sigma_px"),
    )


def _require(path: Path, name: str, value: Any, expected: Any) -> None:
    if not isinstance(expected, Mapping):
        if not _is_of(value, expected):
            raise InputError(f"{path}: field {name!r} = {quoted(value)}: expected {_KINDS[expected]}: {_REMEDY}")
        return
    if not isinstance(value, Mapping):
        raise InputError(f"{path}: field {name!r} = {quoted(value)}: expected fields below it: {_REMEDY}")
    for key, inner in expected.items():
        full = f"{name}.{key}".lstrip(".")
        if key not in value:
            raise InputError(f"{path}: field {full!r} is missing: {_REMEDY}")
        _require(path, full, value[key], inner)


def _is_of(value: Any, kind: type) -> bool:
    if kind in (int, float) and isinstance(value, bool):
        return False
    if kind is float:
        return isinstance(value, (int, float)) and math.isfinite(value)
    return isinstance(value, kind)
