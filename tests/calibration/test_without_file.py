"""Cameras from a focal length, a field of view, or nothing."""

import numpy as np
import pytest

from ttcvid.calibration import ASSUMED_HFOV_DEG, assumed_camera, camera_from_focal, camera_from_hfov
from ttcvid.errors import UsageError
from ttcvid.geometry.camera.pinhole import rays_from_pixels
from ttcvid.model import Camera, ImageSize

SIZE = ImageSize(1242, 375)


def test_focal_length_gives_square_pixels_about_the_centre_of_the_picture():
    assert camera_from_focal(721.5, SIZE) == Camera(721.5, 721.5, 620.5, 187.0, SIZE, origin="focal_px")


@pytest.mark.parametrize("hfov_deg", [1.5, 55.0, 90.0, 178.0])
def test_field_of_view_lies_between_the_outer_borders_of_the_picture(hfov_deg):
    camera = camera_from_hfov(hfov_deg, SIZE)
    left, right = rays_from_pixels(camera, np.array([[-0.5, 187.0], [SIZE.width_px - 0.5, 187.0]]))
    angle = np.arctan(right[0]) - np.arctan(left[0])
    assert np.degrees(angle) == pytest.approx(hfov_deg)
    assert camera.origin == "hfov_deg"
    assert not camera.is_assumed


def test_without_anything_the_camera_says_that_it_is_assumed():
    assert assumed_camera(SIZE).is_assumed
    assert assumed_camera(SIZE).fx_px == camera_from_hfov(ASSUMED_HFOV_DEG, SIZE).fx_px


@pytest.mark.parametrize("focal_px", [float("nan"), float("inf"), 0.0, -700.0, 4.2, 1e6])
def test_impossible_focal_lengths_are_refused(focal_px):
    with pytest.raises(UsageError, match=r"focal_px: got .*; expected a focal length from .* px") as caught:
        camera_from_focal(focal_px, SIZE)
    assert caught.value.exit_code == 2


@pytest.mark.parametrize("hfov_deg", [float("nan"), float("inf"), 0.0, 1.0, -55.0, 179.0, 360.0])
def test_impossible_fields_of_view_are_refused(hfov_deg):
    with pytest.raises(
        UsageError, match=r"hfov_deg: got .*; expected a horizontal field of view between 1 and 179 deg"
    ):
        camera_from_hfov(hfov_deg, SIZE)
