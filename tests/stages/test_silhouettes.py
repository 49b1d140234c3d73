"""Silhouettes are kept as they are, and tell how high what stands at a place is."""

import numpy as np
import pytest

from ttcvid.stages.tracking.silhouettes import Silhouettes, extent_px


@pytest.fixture
def mask():
    """A body in columns 30 to 49 and rows 20 to 69, and a higher one beside it."""
    result = np.zeros((101, 120), np.uint8)
    result[20:70, 30:50] = 1
    result[5:90, 60:80] = 1
    return result


def test_a_mask_comes_back_as_it_was(mask):
    silhouettes = Silhouettes()
    silhouettes.put(7, mask)
    np.testing.assert_array_equal(silhouettes.mask(7), mask)
    assert silhouettes.mask(8) is None


def test_the_extent_is_that_of_the_body_at_the_place_alone(mask):
    assert extent_px(mask, 40.0, 45.0, 6.0) == (20.0, 69.0)
    assert extent_px(mask, 70.0, 45.0, 6.0) == (5.0, 89.0)


def test_nothing_there_and_what_a_border_cuts_off_have_no_extent(mask):
    assert extent_px(mask, 100.0, 45.0, 6.0) is None
    assert extent_px(mask, 3.0, 45.0, 6.0) is None
    mask[:50, 30:50] = 1
    assert extent_px(mask, 40.0, 45.0, 6.0) is None
