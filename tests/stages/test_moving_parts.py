"""Movers are cut out of a resting camera's pictures, and a track lies where the content of its window does."""

import cv2
import numpy as np
import pytest

from ttcvid.model import PointSet
from ttcvid.stages.horizon.whole_tracks import joined, observations_of, recentred
from ttcvid.stages.tracking.moving_parts import StreetSample, background_of, moving_part, street_sample

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
    return background_of(samples_of(passing)), picture(empty, rng, 70)


def samples_of(pictures):
    return [street_sample(*three) for three in zip(pictures, pictures[1:], pictures[2:], strict=False)]


def test_the_background_is_what_is_seen_most_of_the_time(scene):
    background, _ = scene
    assert background.smooth.max() < 125


def test_a_place_where_coats_pass_most_of_the_time_is_still_seen_as_the_street():
    """Plain dark coats, 24 px wide and 10 px apart, pass before a wall."""
    rng = np.random.default_rng(2)
    wall = cv2.GaussianBlur(rng.integers(60, 120, (120, 640)).astype(np.float32), (0, 0), 1.5)
    columns = np.arange(640)
    pictures = []
    for k in range(60):
        one = wall + rng.normal(0, 1, wall.shape)
        one[40:80, (columns + 7 * k) % 34 < 24] = 20
        pictures.append(np.clip(one, 0, 255).astype(np.uint8))
    assert np.median(pictures, axis=0)[60].max() < 30
    always = background_of([StreetSample(one, np.zeros((60, 320), np.uint8)) for one in pictures])
    assert always.sharp[60].max() < 30
    samples = [StreetSample(one, moves_of(k)) for k, one in enumerate(pictures)]
    np.testing.assert_allclose(background_of(samples).sharp[45:75], wall[45:75], atol=15)


def moves_of(k):
    """Where the coats of picture ``k`` are, and 2 px about them."""
    moves = np.zeros((120, 640), np.uint8)
    moves[38:82, (np.arange(640) + 7 * k + 2) % 34 < 28] = 1
    return moves[::2, ::2]


def test_what_an_outline_encloses_moves_as_well():
    rng = np.random.default_rng(3)
    wall = cv2.GaussianBlur(rng.integers(60, 120, (120, 640)).astype(np.float32), (0, 0), 1.5)
    pictures = []
    for k in range(3):
        one = wall + rng.normal(0, 1, wall.shape)
        one[40:80, 300 + 7 * k : 330 + 7 * k] = 20
        pictures.append(np.clip(one, 0, 255).astype(np.uint8))
    moves = street_sample(*pictures).moves
    assert moves.shape == (60, 320)
    assert moves[22:38, 154:168].all()
    assert not moves[:, :130].any()
    assert not moves[:, 190:].any()


def test_an_exposure_that_follows_the_traffic_is_no_motion(scene):
    background, _ = scene
    brighter = np.clip(1.12 * background.sharp, 0, 255).astype(np.uint8)
    assert not moving_part(brighter, background)[0].any()


def test_only_the_mover_is_left_and_its_border_is_where_it_is(scene):
    background, grey = scene
    cut_out = moving_part(grey, background)[1].astype(int)
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
    mask, cut_out = moving_part(empty, background)
    assert not mask.any()
    assert (cut_out == background.plain).all()


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
