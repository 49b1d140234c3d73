"""Camera, horizon and mask files, and cameras without a file."""

from ttcvid.calibration.camera_file import read_camera, read_camera_image_size
from ttcvid.calibration.horizon_file import read_horizon, write_horizon
from ttcvid.calibration.mask_file import read_mask
from ttcvid.calibration.own import write_camera
from ttcvid.calibration.without_file import (
    ASSUMED_HFOV_DEG,
    assumed_camera,
    camera_from_focal,
    camera_from_hfov,
    found_camera,
)

__all__ = [
    "ASSUMED_HFOV_DEG",
    "assumed_camera",
    "camera_from_focal",
    "camera_from_hfov",
    "found_camera",
    "read_camera",
    "read_camera_image_size",
    "read_horizon",
    "read_mask",
    "write_camera",
    "write_horizon",
]
