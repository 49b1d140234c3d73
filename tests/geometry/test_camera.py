"""Pixels to rays and back: round trips, agreement with OpenCV, and what has no answer."""

import time

import cv2
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from ttcvid.geometry.camera.pinhole import pixels_from_rays, rays_from_pixels
from ttcvid.model import Camera, ImageSize

SIZE = ImageSize(1280, 720)
LENSES = {
    "none": ("none", ()),
    "dashcam": ("plumb_bob", (-0.31, 0.11, 0.0008, -0.0004, -0.019)),
    "four coefficients": ("plumb_bob", (-0.25, 0.07, 0.001, 0.002)),
    "pincushion": ("plumb_bob", (0.12, 0.05, -0.001, 0.0007, 0.01)),
    "azure kinect": ("rational", (0.52, -2.62, 0.0007, -0.0001, 1.49, 0.40, -2.45, 1.42)),
    "wide rational": ("rational", (2.1, 0.6, 0.0003, -0.0002, 0.01, 2.45, 1.13, 0.08)),
    "action camera": ("fisheye", (0.06, -0.012, 0.009, -0.004)),
    "ideal equidistant": ("fisheye", (0.0, 0.0, 0.0, 0.0)),
}


def camera_with(lens, fx=900.0, fy=890.0):
    model, coefficients = LENSES[lens]
    return Camera(fx, fy, 633.2, 366.8, SIZE, model, coefficients)


def grid_px(step=40):
    x, y = np.meshgrid(np.arange(0.0, SIZE.width_px, step), np.arange(0.0, SIZE.height_px, step))
    return np.stack([x.ravel(), y.ravel()], axis=1)


def cv2_project(camera, rays):
    K = np.array([[camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px], [0, 0, 1]])
    still = np.zeros(3)
    if camera.distortion_model == "fisheye":
        plane = (rays[:, :2] / rays[:, 2:])[:, None]
        return cv2.fisheye.distortPoints(plane, K, np.array(camera.distortion))[:, 0]
    coefficients = np.array(camera.distortion) if camera.distortion else None
    return cv2.projectPoints(rays[:, None], still, still, K, coefficients)[0][:, 0]


def test_ray_of_the_principal_point_is_the_optical_axis():
    for lens in LENSES:
        camera = camera_with(lens)
        ray = rays_from_pixels(camera, np.array([[camera.cx_px, camera.cy_px]]))
        np.testing.assert_allclose(ray, [[0, 0, 1]], atol=1e-15)


def test_ray_without_distortion_is_the_inverse_camera_matrix_times_the_pixel():
    camera = camera_with("none")
    K = np.array([[camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px], [0, 0, 1]])
    xy = grid_px()
    rays = np.linalg.solve(K, np.column_stack([xy, np.ones(len(xy))]).T).T
    np.testing.assert_allclose(rays_from_pixels(camera, xy), rays, rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize("lens", LENSES)
def test_every_pixel_of_the_picture_comes_back_to_itself(lens):
    camera = camera_with(lens)
    xy = grid_px()
    rays = rays_from_pixels(camera, xy)
    assert np.all(rays[:, 2] == 1.0)
    np.testing.assert_allclose(pixels_from_rays(camera, rays), xy, rtol=0, atol=1e-10)


@pytest.mark.parametrize("lens", LENSES)
def test_pixels_are_those_of_opencv(lens):
    camera = camera_with(lens)
    rays = np.random.default_rng(3).uniform([-0.6, -0.4, 1.0], [0.6, 0.4, 1.0], (500, 3)) * 7.3
    np.testing.assert_allclose(pixels_from_rays(camera, rays), cv2_project(camera, rays), rtol=0, atol=1e-9)


def test_rays_of_a_fisheye_are_those_of_opencv():
    camera = camera_with("action camera")
    K = np.array([[camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px], [0, 0, 1]])
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-15)
    theirs = cv2.fisheye.undistortPoints(grid_px()[:, None], K, np.array(camera.distortion), criteria=criteria)
    np.testing.assert_allclose(rays_from_pixels(camera, grid_px())[:, :2], theirs[:, 0], atol=1e-9)


@given(
    st.sampled_from(["plumb_bob", "rational", "fisheye"]),
    st.lists(st.floats(-0.3, 0.3), min_size=8, max_size=8),
    st.floats(-0.9, 0.9),
    st.floats(-0.9, 0.9),
    st.floats(100, 5000),
)
def test_a_ray_that_has_a_pixel_is_the_ray_of_that_pixel(model, k, x, y, focal_px):
    k[2:4] = (k[2] / 30, k[3] / 30) if model != "fisheye" else k[2:4]
    camera = Camera(
        focal_px, focal_px, 600.0, 300.0, SIZE, model, tuple(k[: {"plumb_bob": 5, "fisheye": 4}.get(model)])
    )
    ray = np.array([[x, y, 1.0]])
    pixel = pixels_from_rays(camera, ray)
    nearby = pixels_from_rays(camera, ray * (1.02, 1.02, 1.0))
    assume(np.isfinite(pixel).all() and np.isfinite(nearby).all())
    sharpness = np.abs(nearby - pixel).max() / max(0.02 * focal_px * np.abs(ray[0, :2]).max(), 1e-9)
    assume(sharpness > 0.02)
    back = rays_from_pixels(camera, pixel)
    np.testing.assert_allclose(back, ray, rtol=0, atol=1e-9)


@given(st.floats(0.01, 1e6), st.sampled_from(sorted(LENSES)))
def test_the_length_of_a_ray_does_not_matter(length, lens):
    camera, ray = camera_with(lens), np.array([[0.3, -0.2, 1.0]])
    np.testing.assert_allclose(pixels_from_rays(camera, ray * length), pixels_from_rays(camera, ray), rtol=1e-12)


@pytest.mark.parametrize("lens", LENSES)
def test_no_pixel_for_rays_behind_or_in_the_picture_plane_or_not_finite(lens):
    rays = np.array([[1, 2, -3], [1, 2, 0], [0, 0, 0], [np.nan, 0, 1], [0, 0, np.nan], [0, 0, np.inf - np.inf]])
    assert np.isnan(pixels_from_rays(camera_with(lens), rays.astype(float))).all()


@pytest.mark.parametrize("lens", LENSES)
def test_not_finite_pixels_have_no_ray_and_do_not_disturb_the_others(lens):
    camera = camera_with(lens)
    xy = np.array([[np.nan, 1.0], [100.0, 200.0], [3.0, np.inf]])
    rays = rays_from_pixels(camera, xy)
    assert np.isnan(rays[[0, 2]]).all()
    np.testing.assert_array_equal(rays[1], rays_from_pixels(camera, xy[1:2])[0])


def test_a_barrel_lens_folds_over_where_its_radius_turns_back():
    camera = Camera(100.0, 100.0, 0.0, 0.0, SIZE, "plumb_bob", (-0.3, 0.0, 0.0, 0.0, 0.0))
    fold = np.sqrt(1 / 0.9)
    rays = np.array([[fold - 1e-3, 0, 1], [fold + 1e-3, 0, 1], [1.7, 0, 1], [5, 0, 1]])
    assert np.isfinite(pixels_from_rays(camera, rays)).all(axis=1).tolist() == [True, False, False, False]
    furthest_px = 100 * fold * (1 - 0.3 * fold**2)
    pixels = np.array([[furthest_px - 1e-3, 0], [furthest_px + 1e-3, 0], [-200.0, 0]])
    assert np.isfinite(rays_from_pixels(camera, pixels)).all(axis=1).tolist() == [True, False, False]


def test_beyond_the_fold_there_is_no_pixel_even_where_the_lens_model_rises_again():
    camera = Camera(100.0, 100.0, 0.0, 0.0, SIZE, "plumb_bob", (-0.5, 0.1, 0.0, 0.0, 0.0))
    assert np.isnan(pixels_from_rays(camera, np.array([[2.5, 0.0, 1.0], [4.0, 0.0, 1.0]]))).all()
    assert np.isnan(rays_from_pixels(camera, np.array([[250.0, 0.0]]))).all()


def test_no_pixel_beyond_the_pole_of_a_rational_lens():
    camera = Camera(100.0, 100.0, 0.0, 0.0, SIZE, "rational", (0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0))
    pixels = pixels_from_rays(camera, np.array([[0.9, 0, 1], [1.1, 0, 1], [3.0, 0, 1]]))
    assert np.isfinite(pixels).all(axis=1).tolist() == [True, False, False]


def test_ideal_fisheye_has_rays_up_to_90_degrees_and_none_beyond():
    camera = Camera(100.0, 100.0, 0.0, 0.0, SIZE, "fisheye", (0.0, 0.0, 0.0, 0.0))
    pixels = np.array([[100 * np.radians(89.0), 0], [100 * np.radians(91.0), 0]])
    rays = rays_from_pixels(camera, pixels)
    np.testing.assert_allclose(rays[0], [np.tan(np.radians(89.0)), 0, 1], rtol=1e-12)
    assert np.isnan(rays[1]).all()


def test_zero_points_give_zero_rays():
    for lens in LENSES:
        assert rays_from_pixels(camera_with(lens), np.empty((0, 2))).shape == (0, 3)
        assert pixels_from_rays(camera_with(lens), np.empty((0, 3))).shape == (0, 2)


def test_the_input_is_not_changed():
    for lens in LENSES:
        xy = grid_px()
        rays_from_pixels(camera_with(lens), xy)
        np.testing.assert_array_equal(xy, grid_px())


@pytest.mark.parametrize(("model", "coefficients"), [("omni", ()), ("plumb_bob", (0.1,)), ("fisheye", (0.1,) * 5)])
def test_unknown_models_and_wrong_numbers_of_coefficients_are_refused(model, coefficients):
    camera = Camera(100.0, 100.0, 0.0, 0.0, SIZE, model, coefficients)
    with pytest.raises(ValueError, match="distortion model"):
        rays_from_pixels(camera, grid_px())


@pytest.mark.parametrize("lens", LENSES)
def test_1500_points_take_little_time(lens):
    # The bars on an idle machine are 0.3 ms and 1.5 ms; a busy one gets four times as much and the best of many tries.
    camera, xy = camera_with(lens), np.random.default_rng(0).uniform(0, 1, (1500, 2)) * (1279, 719)
    rays_from_pixels(camera, xy)
    best_s = min(_seconds(rays_from_pixels, camera, xy) for _ in range(30))
    assert best_s < 4 * (0.3e-3 if lens == "none" else 1.5e-3)


def _seconds(function, *arguments):
    start = time.perf_counter()
    function(*arguments)
    return time.perf_counter() - start
