"""Camera files of ROS, Kalibr, OpenCV and KITTI: spellings of the wild, and what is refused in which words."""

import numpy as np
import pytest

from ttcvid.calibration import read_camera_image_size
from ttcvid.model import ImageSize

K = "[500, 0, 320, 0, 500, 240, 0, 0, 1]"
OPENCV_K = "camera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: " + K + "\n"
ROS = f"image_width: 640\nimage_height: 480\ncamera_matrix: {{rows: 3, cols: 3, data: {K}}}\n"


@pytest.mark.parametrize(
    ("rest", "model", "distortion"),
    [
        ("distortion_model: plumb_bob\ndistortion_coefficients: {data: []}", "none", ()),
        ("distortion_model: ''\ndistortion_coefficients: {data: []}", "none", ()),
        ("distortion_model: plumb_bob\nD: [0.1, 0, 0, 0]", "plumb_bob", (0.1, 0, 0, 0, 0)),
        ("distortion_model: rational_polynomial\nD: [.1, 0, 0, 0, 0, 0, 0, 0.2]", "rational", (0.1, *[0] * 6, 0.2)),
        ("distortion_model: equidistant\nD: [0.1, 0, 0, 0]", "fisheye", (0.1, 0, 0, 0)),
    ],
)
def test_ros_lens_models(read, rest, model, distortion):
    camera = read(ROS + rest)
    assert (camera.distortion_model, camera.distortion) == (model, distortion)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (ROS, "distortion_coefficients: missing"),
        (ROS + "D: [0.1, 0, 0, 0]", "distortion_model: missing"),
        (ROS.replace("camera_matrix", "camera_matirx") + "D: []", "did you mean it by 'camera_matirx'?"),
        (ROS.replace("data", "dta") + "D: []", "camera_matrix.data: missing"),
        (ROS.replace("0, 0, 1]", "0, 1]") + "D: []", "camera_matrix: got 8 numbers"),
        (ROS.replace("0, 0, 1]", "0, 1, 0]") + "D: []", "row by row and without skew"),
        (ROS.replace("[500, 0,", "[500, 2,") + "D: []", "without skew"),
        (ROS.replace("500", "0") + "D: []", "camera_matrix fx: got 0 px"),
        (ROS.replace("image_height: 480", "") + "D: []", "image_height: missing"),
        (ROS + "distortion_model: thin_prism\nD: [0.1, 0, 0, 0]", "unknown distortion model 'thin_prism'"),
    ],
)
def test_wrong_ros_files(message, text, words):
    assert words in message(text)


def test_plain_lists_of_lists_are_a_camera_matrix(read):
    rows = "[[500, 0, 320], [0, 500, 240], [0, 0, 1]]"
    assert read(f"image_width: 640\nimage_height: 480\ncamera_matrix: {rows}\nD: []").cx_px == 320


KALIBR = """cam{}:
  camera_model: {}
  intrinsics: [{}, 500, 320, 240]
  distortion_model: none
  resolution: [640, 480]
"""


def test_of_several_kalibr_cameras_the_lowest_number_is_taken(read):
    text = KALIBR.format(10, "pinhole", 510) + KALIBR.format(2, "pinhole", 502) + KALIBR.format(3, "pinhole", 503)
    assert read(text).fx_px == 502


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (KALIBR.format(0, "omni", 500), "cam0.camera_model: got 'omni'; expected pinhole"),
        (KALIBR.format(0, "pinhole", "500, 500"), "cam0.intrinsics: got 5 numbers; expected [fu, fv, pu, pv]"),
        (KALIBR.format(0, "pinhole", "-500"), "cam0.intrinsics fu: got -500 px"),
        (KALIBR.format(0, "pinhole", 500).replace("resolution", "res"), "cam0.resolution: missing"),
        (KALIBR.format(0, "pinhole", 500).replace("none", "fov"), "unknown distortion model 'fov'"),
        (KALIBR.format(0, "pinhole", 500).replace("none", "radtan"), "cam0.distortion_coeffs: missing"),
        ("cam0: 5", "cam0: got 5"),
    ],
)
def test_wrong_kalibr_files(message, text, words):
    assert words in message(text)


@pytest.mark.parametrize(
    "text",
    [
        f"%YAML:1.0\n---\nK: {K}\nD: [ 0.1, 0., 0., 0., 0. ]\nimage_size: [ 640, 480 ]\n",
        f"%YAML:1.0\n---\nM1: {K}\nD1: [ 0.1, 0., 0., 0. ]\nM2: {K.replace('500', '1')}\nD2: [ 0.9, 0., 0., 0. ]\n",
        "%YAML:1.0\n---\n"
        + OPENCV_K.replace("camera_matrix", "cameraMatrix")
        + "dist_coeffs: [ 0.1, 0., 0., 0., 0. ]\n",
        OPENCV_K.replace("camera_matrix", "Camera_Matrix") + "Distortion_Coefficients: [ 0.1, 0., 0., 0. ]\n",
        f"%YAML:1.0\n---\nmtx: {K}\ndist: [ 0.1, 0., 0., 0. ]\nimageSize: [ 640, 480 ]\n",
        f"%YAML:1.0\n---\nK: {K}\nD: [ 0.1, 0., 0., 0. ]\ncorners: [ {', '.join(['1'] * 1000)} ]\n",
    ],
    ids=["K", "stereo", "camel case", "no header", "mtx", "corners"],
)
def test_opencv_spellings(read, text):
    camera = read(text)
    assert (camera.fx_px, camera.cx_px, camera.cy_px) == (500, 320, 240)
    assert camera.distortion == (0.1, 0, 0, 0, 0)


def test_opencv_files_without_size_are_taken_for_the_clip(read, tmp_path):
    text = f"%YAML:1.0\n---\nK: {K}\nD: [ 0.1, 0., 0., 0. ]\n"
    assert read(text, ImageSize(700, 500)).image_size == ImageSize(700, 500)
    assert read_camera_image_size(tmp_path / "cam.yaml") is None


@pytest.mark.parametrize(
    ("rest", "model"),
    [
        ("D: [ 0.1, 0., 0., 0. ]\nfisheye_model: 0", "plumb_bob"),
        ("D: [ 0.1, 0., 0., 0. ]\nfisheye_model: 1", "fisheye"),
        ('D: [ 0.1, 0., 0., 0. ]\ndistortion_model: "equidistant"', "fisheye"),
        ("D: [ 0.1, 0., 0., 0., 0., 0., 0., 0. ]", "rational"),
        ("D: [ 0.1, 0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 0. ]", "rational"),
    ],
)
def test_opencv_lens_models(read, rest, model):
    camera = read(f"%YAML:1.0\n---\nK: {K}\n{rest}\n")
    assert camera.distortion_model == model
    assert np.count_nonzero(camera.distortion) == 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f"%YAML:1.0\n---\nK: {K}\n", "distortion_coefficients: missing"),
        ("%YAML:1.0\n---\nD: [ 0., 0., 0., 0. ]\n", "camera_matrix: missing"),
        (f"%YAML:1.0\n---\nK: {K}\nD: [ 0., 0., 0. ]\n", "got 3 coefficients"),
        (f"%YAML:1.0\n---\nK: {K}\nD: [ {', '.join(['0.1'] * 14)} ]\n", "got 14 coefficients; expected 8"),
        (f"%YAML:1.0\n---\nK: {K}\nD: [ {', '.join(['0.1'] * 999)} ]\n", "got 'a long list'"),
        (f"%YAML:1.0\n---\nK: {K}\nD: [ .Nan, 0., 0., 0. ]\n", "got nan"),
        (f"%YAML:1.0\n---\nK: {K}\nD: [ 0., 0., 0., 0. ]\nimage_width: 640\n", "image_height: missing"),
        ("%YAML:1.0\n---\nK: fine\nD: [ 0., 0., 0., 0. ]\n", "got 'fine'"),
        (
            "%YAML:1.0\n---\n" + OPENCV_K.replace("rows: 3", "rows: 2000000000") + "D: [ .Inf, 0., 0., 0. ]\n",
            "got inf",
        ),
    ],
)
def test_wrong_opencv_files(message, text, words):
    assert words in message(text)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("P0: 1 2 3", "P0: got 3 numbers; expected 12 numbers"),
        ("500 0 320\n0 500 240\n0 0 1\n", "P0: got 3 numbers; expected 12"),
        ("P0: 500 0 320 0 0 500 240 0 0 0 1 x", "P0[11]: got 'x'"),
        ("P2: nan 0 320 0 0 500 240 0 0 0 1 0", "P2[0]: got nan"),
        ("1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0.1 0 1 0 0 0 0 1 0", "P0 fx: got 1 px"),
        ("0.9 0.1 0 0 -0.1 0.9 0 0 0 0 1 0", "give calib.txt, not poses"),
    ],
)
def test_wrong_kitti_files(message, text, words):
    assert words in message(text)


def test_kitti_object_files_start_where_they_like(read):
    assert read("P2: 500 0 320 45.7 0 500 240 0 0 0 1 0\nR0_rect: 1 0 0 0 1 0 0 0 1\n").fx_px == 500
