"""Horizon files: by hand, written and read back, and refused."""

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ttcvid.calibration import read_horizon, write_horizon
from ttcvid.calibration.horizon_file import DEFAULT_SIGMA_RAD
from ttcvid.errors import CalibrationError, OutputError
from ttcvid.model import Horizon, ImageSize

SIZE = ImageSize(640, 480)
BY_HAND = "image_size: [640, 480]\nhorizon: {y_left_px: 113.2, y_right_px: 103.2}\n"


def save(folder, text):
    path = folder / "horizon.yaml"
    path.write_text(text)
    return path


def test_two_keys_are_enough(tmp_path):
    path = save(tmp_path, BY_HAND)
    assert read_horizon(path, SIZE) == Horizon(113.2, 103.2, SIZE, DEFAULT_SIGMA_RAD, str(path))


def test_the_sample_is_read():
    path = Path(__file__).resolve().parents[2] / "sample_configs" / "horizon.yaml"
    size = ImageSize(1280, 720)
    assert read_horizon(path, size) == Horizon(318.0, 324.5, size, 0.004, str(path))


def test_sigma_of_the_file_is_taken(tmp_path):
    assert read_horizon(save(tmp_path, BY_HAND.replace("}", ", sigma_rad: 0.01}")), SIZE).sigma_rad == 0.01


def test_a_covariance_gives_sigma_along_its_longest_axis(tmp_path):
    text = BY_HAND.replace("}", ", covariance_rad2: [[5.0e-5, 4.0e-5], [4.0e-5, 5.0e-5]]}")
    assert read_horizon(save(tmp_path, text), SIZE).sigma_rad == pytest.approx(9e-5**0.5)


def test_a_line_above_or_below_the_picture_is_a_horizon(tmp_path):
    path = save(tmp_path, BY_HAND.replace("113.2", "-300").replace("103.2", "900"))
    assert (read_horizon(path, SIZE).y_left_px, read_horizon(path, SIZE).y_right_px) == (-300, 900)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(st.floats(-40000, 40000), st.floats(-40000, 40000), st.floats(1e-6, 0.5))
def test_what_is_written_is_read_back_exactly(tmp_path, y_left, y_right, sigma):
    path = tmp_path / "horizon.yaml"
    horizon = Horizon(y_left, y_right, SIZE, sigma, "somewhere")
    write_horizon(path, horizon)
    assert read_horizon(path, SIZE) == replace(horizon, origin=str(path))


def test_information_is_written_and_changes_nothing(tmp_path):
    path = tmp_path / "horizon.yaml"
    horizon = Horizon(1.0, 2.0, SIZE, 0.01, str(path))
    write_horizon(path, horizon, {"pitch_deg": -3.5, "n_motions": 7, "source": "a.mp4"})
    assert "n_motions: 7" in path.read_text()
    assert read_horizon(path, SIZE) == horizon


def test_information_outside_the_list_is_refused(tmp_path):
    with pytest.raises(ValueError, match="colour"):
        write_horizon(tmp_path / "horizon.yaml", Horizon(1.0, 2.0, SIZE, 0.01, ""), {"colour": "red"})


def test_a_place_that_cannot_be_written_is_named(tmp_path):
    with pytest.raises(OutputError, match="cannot be written"):
        write_horizon(tmp_path / "no" / "horizon.yaml", Horizon(1.0, 2.0, SIZE, 0.01, ""))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[640, 480]", "[1242, 375]", "the file is for 1242x375; expected 640x480, the size of the clip"),
        ("113.2", ".nan", "horizon.y_left_px: got nan"),
        ("103.2", ".inf", "horizon.y_right_px: got inf"),
        ("113.2", "1e9", "horizon.y_left_px: got 1e+09"),
        ("113.2", "high", "horizon.y_left_px: got 'high'"),
        ("y_left_px: 113.2, ", "", "horizon.y_left_px: missing"),
        ("y_left_px", "y_left", "horizon.y_left: unknown key; expected y_left_px, y_right_px"),
        ("y_left_px", "y_left", "did you mean 'y_left_px'?"),
        ("103.2", "103.2, sigma_rad: -1", "horizon.sigma_rad: got -1 rad"),
        ("103.2", "103.2, sigma_rad: 3", "horizon.sigma_rad: got 3 rad"),
        ("103.2", "103.2, covariance_rad2: [1, 2, 3]", "horizon.covariance_rad2: got 3 numbers"),
        ("103.2", "103.2, covariance_rad2: [1, 2, 2, 1]", "horizon.covariance_rad2: got [1.0, 2.0, 2.0, 1.0]"),
        ("image_size: [640, 480]\n", "", "image_size: missing"),
        ("image_size", "imagesize", "did you mean 'image_size'?"),
        ("horizon: {", "line: {", "line: unknown key"),
        ("horizon: {y_left_px: 113.2, y_right_px: 103.2}", "horizon: 110", "horizon: got 110"),
        ("horizon: {y_left_px: 113.2, y_right_px: 103.2}\n", "", "horizon: missing"),
        (BY_HAND, "", "empty"),
        (BY_HAND, "113.2 103.2", "only plain text"),
        (BY_HAND, "horizon: [", "not acceptable as YAML"),
        (BY_HAND, BY_HAND + "source: !!python/object/apply:os.system [ls]", "not acceptable as YAML"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(tmp_path, old, new, words):
    path = save(tmp_path, BY_HAND.replace(old, new, 1))
    with pytest.raises(CalibrationError) as caught:
        read_horizon(path, SIZE)
    assert words in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_file(tmp_path):
    with pytest.raises(CalibrationError, match="no such file; expected a horizon file"):
        read_horizon(tmp_path / "horizon.yaml", SIZE)
