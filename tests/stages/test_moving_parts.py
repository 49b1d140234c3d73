"""Movers are cut out of a resting camera's pictures, and a track lies where the content of its window does."""

import cv2
import numpy as np
import pytest

from ttcvid.model import PointSet
from ttcvid.stages.tracking.moving_parts import background_of, only_moving
from ttcvid.stages.whole_tracks import joined, observations_of, recentred

SIZE = (120, 160)


def street(rng):
    return cv2.GaussianBlur(rng.integers(60, 120, SIZE).astype(np.float32), (0, 0), 1.5)


def picture(background, rng, left_px=None):
    """The street with noise, and a bright block of 24 x 16 px."""
    result = background + rng.normal(0, 1, SIZE)
    if left_px is not None:
        result[50:66, left_px : left_px + 24] = 220 + 20 * (np.arange(24) // 6 % 2)
    return np.clip(result, 0, 255).astype(np.uint8)


@pytest.fixture
def scene():
    """Background and a picture with the block, its columns 70 to 93 and rows 50 to 65."""
    rng = np.random.default_rng(1)
    empty = street(rng)
    passing = [picture(empty, rng, left_px) for left_px in range(4, 130, 6)]
    return background_of(passing), picture(empty, rng, 70)


def test_the_background_is_what_is_seen_most_of_the_time(scene):
    background, _ = scene
    assert background.smooth.max() < 125


def test_only_the_mover_is_left_and_its_border_is_where_it_is(scene):
    background, grey = scene
    cut_out = only_moving(grey, background).astype(int)
    is_painted = np.abs(cut_out - background.plain) <= 1
    inside = np.zeros(SIZE, dtype=bool)
    inside[51:65, 71:93] = True
    outside = np.ones(SIZE, dtype=bool)
    outside[48:68, 68:96] = False
    assert is_painted[outside].all()
    np.testing.assert_allclose(cut_out[inside], grey[inside], atol=12)


def test_nothing_is_left_of_a_street_without_traffic(scene):
    background, _ = scene
    empty = np.clip(background.sharp, 0, 255).astype(np.uint8)
    assert (only_moving(empty, background) == background.plain).all()


def test_tracks_are_moved_to_the_median_of_their_content():
    points = [PointSet(np.array([4, 7]), np.array([[10.0 + k, 20.0], [50.0, 60.0]])) for k in range(5)]
    rows = joined([observations_of(part, k, 0.04 * k) for k, part in enumerate(points)])
    found = []
    for k, shift_px in ((0, 2.0), (2, 3.0), (4, 9.0)):
        content = PointSet(points[k].track_id, points[k].xy_px + np.array([[shift_px, -1.0], [np.nan, np.nan]]))
        found.append(observations_of(content, k, 0.04 * k))
    centres = joined(found)
    moved = recentred(rows, centres)
    assert set(moved.track_id) == {4}
    np.testing.assert_allclose(moved.xy_px, [[13.0 + k, 19.0] for k in range(5)])
    assert moved.frame.tolist() == [0, 1, 2, 3, 4]
    assert len(recentred(rows, joined([])).frame) == 0
