"""The horizon line and its plane's normal, one from the other."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ttcvid.geometry.camera.pinhole import rays_from_pixels
from ttcvid.geometry.horizon.plane import horizon_px, normal_from_horizon
from ttcvid.geometry.rotation import rotation_from_vector
from ttcvid.model import Camera, Horizon, ImageSize

SIZE = ImageSize(1242, 375)
CAMERA = Camera(721.5, 730.0, 609.6, 172.9, SIZE)


def horizon(y_left, y_right):
    return Horizon(y_left, y_right, SIZE, 0.005, "test")


def test_level_camera_has_its_horizon_through_the_principal_point():
    np.testing.assert_allclose(normal_from_horizon(CAMERA, horizon(172.9, 172.9)), [0, -1, 0], atol=1e-15)


def test_camera_that_looks_down_has_the_horizon_high_in_the_picture():
    down = rotation_from_vector(np.array([np.radians(10.0), 0, 0]))
    left, right = horizon_px(CAMERA, down @ [0.0, -1.0, 0.0])
    assert left == pytest.approx(right)
    assert left == pytest.approx(172.9 - 730.0 * np.tan(np.radians(10.0)))


def test_normal_points_to_the_sky():
    normal = normal_from_horizon(CAMERA, horizon(150.0, 190.0))
    above, on, below = rays_from_pixels(CAMERA, np.array([[0.0, 100.0], [0.0, 150.0], [0.0, 200.0]])) @ normal
    assert above > 0 > below
    assert on == pytest.approx(0.0, abs=1e-15)


@given(st.floats(-2000, 2000), st.floats(-2000, 2000))
def test_line_of_normal_of_line_is_the_line(y_left, y_right):
    normal = normal_from_horizon(CAMERA, horizon(y_left, y_right))
    assert np.linalg.norm(normal) == pytest.approx(1.0)
    assert normal[1] < 0
    np.testing.assert_allclose(horizon_px(CAMERA, normal), (y_left, y_right), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(horizon_px(CAMERA, -3.0 * normal), (y_left, y_right), rtol=1e-9, atol=1e-9)


def test_distortion_does_not_matter():
    bent = Camera(721.5, 730.0, 609.6, 172.9, SIZE, "plumb_bob", (-0.3, 0.1, 0.0, 0.0, 0.0))
    np.testing.assert_array_equal(
        normal_from_horizon(bent, horizon(150, 190)), normal_from_horizon(CAMERA, horizon(150, 190))
    )


@given(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.floats(-0.2, 0.2))
def test_turning_the_normal_turns_the_rays_of_the_horizon(x, y, z):
    cam_R_prev = rotation_from_vector(np.array([x, y, z]))
    normal = normal_from_horizon(CAMERA, horizon(150.0, 190.0))
    left, right = horizon_px(CAMERA, cam_R_prev @ normal)
    rays_now = rays_from_pixels(CAMERA, np.array([[0.0, left], [SIZE.width_px - 1.0, right]]))
    np.testing.assert_allclose(rays_now @ cam_R_prev @ normal, 0.0, atol=1e-12)


def test_roll_to_the_right_lowers_the_horizon_on_the_left():
    # A camera that rolls clockwise (seen from behind) sees the world turn anticlockwise.
    cam_R_prev = rotation_from_vector(np.array([0, 0, -np.radians(3.0)]))
    left, right = horizon_px(CAMERA, cam_R_prev @ [0.0, -1.0, 0.0])
    assert left > right


@pytest.mark.parametrize("normal", [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [np.nan, -1.0, 0.0]])
def test_upright_infinite_and_unknown_lines_have_no_y(normal):
    assert np.isnan(horizon_px(CAMERA, np.array(normal))).all()
