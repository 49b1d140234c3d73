"""A clip with its calibration, opened as the options say."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ttcvid.calibration import (
    ASSUMED_HFOV_DEG,
    assumed_camera,
    camera_from_focal,
    camera_from_hfov,
    read_camera,
    read_camera_image_size,
)
from ttcvid.calibration import read_horizon as read_horizon_file
from ttcvid.calibration import read_mask as read_mask_file
from ttcvid.errors import OutputError, UsageError
from ttcvid.jobs.settings.options import AnalyzeOptions
from ttcvid.model import Camera, Horizon, ImageSize, Picture
from ttcvid.sources import Selection, Source, open_source
from ttcvid.sources.images import is_pattern
from ttcvid.sources.tracks import TABLE_SUFFIXES

ASSUMED_CAMERA_WARNING = (
    f"the focal length is assumed ({ASSUMED_HFOV_DEG:g} deg horizontal field of view): directions and miss distances "
    "are only as good as that; give --camera, --focal-px or --hfov"
)


def camera_warnings(camera: Camera) -> list[str]:
    """What to know of a camera that nobody gave, before trusting the numbers."""
    if camera.is_assumed:
        return [ASSUMED_CAMERA_WARNING]
    if camera.focal_sigma_px is None:
        return []
    return [
        f"the focal length was found in the clip, {camera.fx_px:.0f} +- {camera.focal_sigma_px:.0f} px: better give "
        "--camera, --focal-px or --hfov"
    ]


@dataclass(frozen=True)
class Calibration:
    """What is known of the camera: ``mask`` (H, W) is 0 where nothing is to be looked at."""

    camera: Camera
    horizon: Horizon | None
    mask: Picture | None


def open_clip(input_: str, options: AnalyzeOptions) -> Source:
    """Open INPUT; a track table takes its picture size from the camera file where ``--image-size`` is not given."""
    image_size = options.image_size
    if image_size is None and options.camera is not None and Path(input_).suffix.lower() in TABLE_SUFFIXES:
        image_size = read_camera_image_size(options.camera)
        if image_size is None:
            raise UsageError(f"{options.camera}: tells no picture size, which {input_} needs: give --image-size WxH")
    return open_source(
        input_,
        selection=Selection(options.start, options.end, options.stride),
        fps=options.fps,
        timestamps=options.timestamps,
        image_size=image_size,
        max_image_mpx=options.max_image_mpx,
    )


def read_calibration(options: AnalyzeOptions, image_size: ImageSize) -> Calibration:
    """Camera, horizon and mask for pictures of ``image_size``; CalibrationError where a file does not fit them."""
    horizon_file = None if options.wants_auto_horizon else options.horizon
    return Calibration(
        _camera(options, image_size),
        read_horizon_file(horizon_file, image_size) if horizon_file is not None else None,
        read_mask_file(options.mask, image_size) if options.mask is not None else None,
    )


def _camera(options: AnalyzeOptions, image_size: ImageSize) -> Camera:
    if options.camera is not None:
        return read_camera(options.camera, image_size)
    if options.focal_px is not None:
        return camera_from_focal(options.focal_px, image_size, "focal_px")
    if options.hfov is not None:
        return camera_from_hfov(options.hfov, image_size, "hfov_deg")
    return assumed_camera(image_size)


def default_folder(input_: str) -> Path:
    """``INPUTSTEM_ttc`` in the working folder; a folder of pictures, or the one of a pattern, gives its own name."""
    path = Path(input_)
    if path.is_dir():
        stem = path.resolve().name
    elif not path.exists() and is_pattern(input_):
        stem = path.parent.resolve().name
    else:
        stem = path.stem
    return Path(f"{stem or 'clip'}_ttc")


def refuse_folder_of_input(folder: Path, source: Source) -> None:
    """OutputError where the input lies in the output folder: overwriting it could remove what is analysed."""
    if folder.resolve() in {file.resolve().parent for file in source.files}:
        raise OutputError(f"{folder}: holds the input {source.info.path}: choose another output folder with -o")
