"""Masks: which pixels are left out, of any kind of picture."""

import cv2
import numpy as np
import pytest

from ttcvid.calibration import read_mask
from ttcvid.errors import CalibrationError
from ttcvid.model import ImageSize

SIZE = ImageSize(64, 48)


def half_black(value=255, dtype=np.uint8, channels=None):
    shape = (48, 64) if channels is None else (48, 64, channels)
    picture = np.full(shape, value, dtype)
    picture[40:] = 0
    return picture


def save(folder, picture, name="mask.png"):
    path = folder / name
    path.write_bytes(cv2.imencode(path.suffix, picture)[1].tobytes())
    return path


def opaque(picture):
    return np.dstack([picture, np.full(picture.shape[:2], np.iinfo(picture.dtype).max, picture.dtype)])


@pytest.mark.parametrize(
    ("picture", "name"),
    [
        (half_black(), "mask.png"),
        (half_black(1), "mask.png"),
        (half_black(1, np.uint16), "mask.png"),
        (half_black(channels=3), "mask.png"),
        (half_black(channels=3), "mask.bmp"),
        (half_black(channels=3), "mask.jpg"),
        (half_black(), "mask.tif"),
        (opaque(half_black(channels=3)), "mask.png"),
        (half_black(channels=3) * np.array([0, 0, 1], np.uint8), "mask.png"),
    ],
    ids=["grey", "ones", "16 bit", "colour", "bmp", "jpeg", "tiff", "opaque alpha", "red"],
)
def test_black_is_left_out_and_anything_else_is_looked_at(tmp_path, picture, name):
    mask = read_mask(save(tmp_path, picture, name), SIZE)
    assert mask.dtype == np.uint8
    np.testing.assert_array_equal(mask, half_black())


def test_a_white_mask_leaves_nothing_out(tmp_path):
    assert read_mask(save(tmp_path, np.full((48, 64), 255, np.uint8)), SIZE).all()


@pytest.mark.parametrize(
    ("picture", "words"),
    [
        (np.zeros((48, 64), np.uint8), "the mask is all black"),
        (np.full((48, 65), 255, np.uint8), "the mask is 65x48; expected 64x48, the size of the clip"),
        (np.dstack([half_black(channels=3), half_black()]), "transparent parts"),
    ],
)
def test_masks_that_cannot_be_meant_are_refused(tmp_path, picture, words):
    path = save(tmp_path, picture)
    with pytest.raises(CalibrationError) as caught:
        read_mask(path, SIZE)
    assert words in str(caught.value)
    assert str(path) in str(caught.value)


def test_values_that_are_no_levels_of_grey_are_refused(tmp_path):
    with pytest.raises(CalibrationError, match="float32; expected 8 or 16 bit"):
        read_mask(save(tmp_path, half_black(1, np.float32), "mask.tif"), SIZE)


@pytest.mark.parametrize(
    ("content", "words"), [(b"", "empty"), (b"hello", "no picture"), (b"\x89PNG\r\n", "no picture")]
)
def test_other_files_are_refused_in_one_line(tmp_path, content, words):
    path = tmp_path / "mask.png"
    path.write_bytes(content)
    with pytest.raises(CalibrationError, match=words) as caught:
        read_mask(path, SIZE)
    assert "\n" not in str(caught.value)


def test_missing_mask(tmp_path):
    with pytest.raises(CalibrationError, match="no such file"):
        read_mask(tmp_path / "mask.png", SIZE)
    with pytest.raises(CalibrationError, match="is a folder"):
        read_mask(tmp_path, SIZE)
