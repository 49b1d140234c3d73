"""Camera files one by one: samples, real ones, our own format, and what is refused in which words."""

import os
from pathlib import Path

import pytest
from camera_texts import SIZE

from ttcvid.calibration import read_camera, read_camera_image_size, write_camera
from ttcvid.errors import CalibrationError, OutputError
from ttcvid.model import Camera, ImageSize

SAMPLES = Path(__file__).resolve().parents[2] / "sample_configs" / "cameras"
SAMPLE_SIZE = ImageSize(1280, 720)
UNDISTORTED = {"own_without_distortion", "kitti_odometry", "kitti_without_labels", "kitti_raw_calib_cam_to_cam"}
FLAT = "image_size: [640, 480]\nfx_px: 500\nfy_px: 500\ncx_px: 320\ncy_px: 240\n"


@pytest.mark.parametrize("path", sorted(SAMPLES.iterdir()), ids=lambda path: path.name)
def test_every_sample_is_the_same_camera(path):
    camera = read_camera(path, SAMPLE_SIZE)
    assert (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px) == (1004.5, 1002.25, 641.75, 355.5)
    if path.stem in UNDISTORTED:
        assert camera.distortion_model == "none"
    else:
        assert camera.distortion_model == "plumb_bob"
        assert camera.distortion == (-0.29, 0.085, 0.0004, -0.0003, 0.0)


def test_there_is_a_sample_of_every_format():
    kinds = {path.name.split("_")[0].split(".")[0] for path in SAMPLES.iterdir()}
    assert kinds == {"own", "ros", "ros1", "ros2", "kalibr", "opencv", "kitti"}
    assert {path.suffix for path in SAMPLES.glob("opencv.*")} == {".yml", ".xml", ".json"}


@pytest.mark.data
@pytest.mark.parametrize(
    ("folder", "size", "focal_px", "centre_px"),
    [
        ("kitti_sfnd_ttc", ImageSize(1242, 375), 721.5377, (609.5593, 172.854)),
        ("kitti_odom_straight50", ImageSize(1226, 370), 707.0912, (601.8873, 183.1104)),
        ("kt3dmoseg", ImageSize(1242, 375), 721.5377, (609.5593, 172.854)),
    ],
)
def test_real_kitti_files_give_their_known_camera(data_dir, folder, size, focal_px, centre_px):
    path = data_dir / folder / "calib.txt"
    camera = read_camera(path, size)
    assert (camera.fx_px, camera.fy_px) == (focal_px, focal_px)
    assert (camera.cx_px, camera.cy_px) == centre_px
    assert camera.distortion_model == "none"
    assert camera.image_size == size
    assert read_camera_image_size(path) is None


@pytest.mark.data
def test_kitti_poses_are_no_camera(data_dir):
    with pytest.raises(CalibrationError, match="P0"):
        read_camera(data_dir / "kitti_odom_straight50" / "poses.txt", ImageSize(1226, 370))


def test_missing_file_folder_and_unreadable_file(tmp_path):
    with pytest.raises(CalibrationError, match=r"nope.yaml: no such file; expected a camera file"):
        read_camera(tmp_path / "nope.yaml", SIZE)
    with pytest.raises(CalibrationError, match="not a file"):
        read_camera(tmp_path, SIZE)
    with pytest.raises(CalibrationError, match="cannot be read"):
        read_camera(tmp_path / ("x" * 5000), SIZE)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_file_without_permission(tmp_path):
    path = tmp_path / "cam.yaml"
    path.write_text(FLAT)
    path.chmod(0)
    with pytest.raises(CalibrationError, match="cannot be read"):
        read_camera(path, SIZE)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "empty"),
        (" \n\n", "empty"),
        ("\u2028\x1c", "empty"),
        ('"fo\\ncal": 3', r"found the keys fo\ncal"),
        (b"\x89PNG\r\n\x1a\n\x00\x00\xff", "binary"),
        (b"abc\0def", "binary"),
        (FLAT.encode("utf-16"), "not UTF-8"),
        ("hello world", "only plain text"),
        ("- 1\n- 2\n", "only plain text"),
        ("fx_px: [1, 2\nfy_px: }", "line 2: not acceptable as YAML"),
        ("a: *b", "aliases"),
        ("a: !!opencv-matrix [1, 2]", "without keys"),
        ("a: !!map 3", "not acceptable as YAML"),
        ("a: !!timestamp x", "the tag tag:yaml.org,2002:timestamp is not accepted"),
        ("a: !mine x", "the tag !mine is not accepted"),
        (FLAT + "fx_px: 600\n", "'fx_px' is given twice"),
        (FLAT + "? [1]\n: 2\n", "not acceptable as YAML"),
        (FLAT + "when: 2020-99-99\n", "not acceptable as YAML"),
        ("a: b\n" * 60_000, "over 200 kB"),
        ("a: b\n" * 300_000, "over 1 MB"),
        ("image_width: " + "9" * 5000, "not acceptable as YAML"),
        ("%YAML:1.0\n---\ncamera_matrix: [1, 2", "line 3: not acceptable as YAML"),
        ("%YAML:1.0\n---\n- 1\n", "FileStorage without names"),
        ("<?xml version='1.0'?>\n<html></html>", "outermost tag is <html>"),
        ('{"a": "opencv-matrix", ', "not acceptable as YAML"),
        ("%YAML:1.0\n---\na:\n  " + "- " * 300_000 + "1", "over 200 kB"),
        ("%YAML:1.0\n---\na:\n  " + "- " * 3_000 + "1", "not acceptable as YAML"),
        ("<?xml version='1.0'?>\n<opencv_storage>" + "<a>" * 200_000, "not acceptable as XML"),
        ("a: " + "[" * 4000, "not acceptable as YAML"),
    ],
    ids=lambda value: None if isinstance(value, str) and len(value) < 45 else "text",
)
def test_what_is_no_camera_file_is_refused_in_one_line(message, text, words):
    assert words in message(text)


def test_hostile_yaml_runs_nothing(message, tmp_path):
    victim = tmp_path / "victim"
    assert "not acceptable as YAML" in message(FLAT + f"x: !!python/object/apply:os.system ['touch {victim}']\n")
    assert "not acceptable as YAML" in message(f"!!python/object/apply:pathlib.Path.touch [!!python/name:x {victim}]")
    assert not victim.exists()


def test_billion_laughs_are_refused_before_they_grow(message):
    lines = ["a0: &a0 [lol, lol]"] + [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 30)]
    assert "aliases" in message("\n".join(lines))


def test_xml_entities_are_not_expanded(message):
    entities = '<!DOCTYPE x [<!ENTITY a "lol"><!ENTITY b "&a;&a;&a;">]>'
    text = f"<?xml version='1.0'?>{entities}<opencv_storage><K>&b;</K></opencv_storage>"
    assert "entities are not accepted" in message(text)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("fx_px: 500", "fx_px: .nan", "fx_px: got nan; expected a number of px, which must be finite"),
        ("fx_px: 500", "fx_px: -500", "fx_px: got -500 px; expected a focal length above 0"),
        ("fx_px: 500", "fx_px: 0", "fx_px: got 0 px"),
        ("fy_px: 500", "fy_px: -1", "fy_px: got -1 px"),
        ("fx_px: 500", "fx_px: 4.2", "fx_px: got 4.2 px; expected"),
        ("fx_px: 500", "fx_px: 0.5", "in px, not in mm"),
        ("fx_px: 500", "fx_px: 1e9", "fx_px: got 1e+09 px"),
        ("fx_px: 500", "fx_px: " + "9" * 400, "finite"),
        ("fy_px: 500", "fy_px: 50", "fy_px: got 50 px; expected about fx_px, which is 500 px"),
        ("fx_px: 500", "fx_px: five", "fx_px: got 'five'"),
        ("fx_px: 500", "fx_px: true", "fx_px: got True"),
        ("fx_px: 500", "fx_px: [500]", "fx_px: got [500]"),
        ("fx_px: 500\n", "", "fx_px: missing; expected the key fx_px: "),
        ("cx_px: 320", "cx_px: 3200", "cx_px: got 3200 px, far outside the picture (640x480)"),
        ("cy_px: 240", "cy_px: -999", "cy_px: got -999 px, far outside"),
        ("[640, 480]", "[640]", "image_size: got 1 numbers; expected [width, height]"),
        ("[640, 480]", "[640.5, 480]", "image_size: got 640.5"),
        ("[640, 480]", "[0, 480]", "image_size: got 0"),
        ("[640, 480]", "640x480", "image_size: got '640x480'"),
        ("[640, 480]", "[640, x]", "image_size[1]: got 'x'"),
        ("fx_px", "fx", "fx: unknown key; expected image_size, fx_px, fy_px, cx_px, cy_px, distortion_model"),
        ("fx_px", "fx", "did you mean 'fx_px'?"),
        ("cy_px: 240", "cy_px: 240\nskew: 0", "skew: unknown key"),
        ("cy_px: 240", "cy_px: 240\ndistortion: [0.1, 0, 0, 0]", "distortion_model: missing"),
        ("cy_px: 240", "cy_px: 240\ndistortion_model: plumb_bob", "distortion: missing"),
        (
            "cy_px: 240",
            "cy_px: 240\ndistortion_model: brown",
            "unknown distortion model 'brown'; expected one of none, plumb_bob, radtan, rational",
        ),
        ("cy_px: 240", "cy_px: 240\ndistortion_model: 5", "distortion_model: got 5"),
        (
            "cy_px: 240",
            "cy_px: 240\ndistortion_model: plumb_bob\ndistortion: [0.1, 0.2]",
            "distortion: got 2 coefficients; expected 4 or 5",
        ),
        (
            "cy_px: 240",
            "cy_px: 240\ndistortion_model: fisheye\ndistortion: [0.1, 0, 0, 0, 0.1]",
            "distortion: got 5 coefficients; expected 4",
        ),
        (
            "cy_px: 240",
            "cy_px: 240\ndistortion_model: plumb_bob\ndistortion: [.nan, 0, 0, 0]",
            "distortion[0]: got nan",
        ),
        (
            "cy_px: 240",
            "cy_px: 240\ndistortion_model: plumb_bob\ndistortion: [-30.0, 0, 0, 0, 0]",
            "plumb_bob [-30, 0, 0, 0, 0] folds over",
        ),
    ],
)
def test_wrong_values_are_refused_with_field_value_and_expectation(message, old, new, words):
    assert old in FLAT
    assert words in message(FLAT.replace(old, new, 1))


def test_size_mismatch_of_a_scaled_clip_says_how_to_scale(message):
    text = message(FLAT, ImageSize(1280, 960))
    assert "640x480" in text
    assert "1280x960" in text
    assert "multiply fx, fy, cx, cy by 2, add 0.5 to cx and cy, and write 1280x960" in text


@pytest.mark.parametrize("text", ["horizon: {y_left_px: 1, y_right_px: 2}\nimage_size: [640, 480]", "focal: 3", "{}"])
def test_other_yaml_is_no_camera_and_its_keys_are_named(message, text):
    assert "found" in message(text)


def test_own_keys_without_unit_alone_are_hinted_at(message):
    assert "did you mean 'fx_px' by 'fx'?" in message("fx: 500\nfy: 500\ncx: 320\ncy: 240\n")


def test_a_key_that_is_missing_is_not_taken_for_a_right_one_beside_it(message):
    assert "cy_px: missing; expected the key cy_px: add it" in message(FLAT.replace("cy_px: 240\n", ""))


def test_coefficients_without_a_point_are_numbers(read):
    camera = read(FLAT + "distortion_model: plumb_bob\ndistortion: [-1e-05, 2E3e, 0, 0]\n".replace("2E3e", "2e-3"))
    assert camera.distortion == (-1e-05, 2e-3, 0.0, 0.0, 0.0)


def test_a_camera_that_cannot_be_written_names_the_place(tmp_path):
    camera = Camera(500.0, 500.0, 320.0, 240.0, SIZE)
    with pytest.raises(OutputError, match="cannot be written"):
        write_camera(tmp_path / "no" / "such" / "folder.yaml", camera)
