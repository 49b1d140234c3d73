"""A camera rests where most parts of the picture stay, however much texture a lorry has."""

import numpy as np

from ttcvid.model import ImageSize, PointSet
from ttcvid.stages.egomotion.rest import RESTING_SHARE, Look, compare_looks, complaint_about_motion

SIZE = ImageSize(640, 360)


def points(xy_px):
    return PointSet(np.arange(len(xy_px)), xy_px)


def grid_px():
    return np.stack(np.meshgrid(np.arange(10.0, 640, 40), np.arange(10.0, 360, 40)), axis=-1).reshape(-1, 2)


def test_a_lorry_full_of_texture_does_not_outvote_the_street():
    lorry_px = np.random.default_rng(1).uniform([200, 100], [400, 250], (1000, 2))
    before = np.concatenate([grid_px(), lorry_px])
    after = np.concatenate([grid_px() + 0.2, lorry_px + np.array([8.0, 0.0])])
    assert compare_looks(points(before), points(after), 1.0, SIZE).still_share > RESTING_SHARE


def test_a_camera_that_pans_does_not_rest():
    moved_px = grid_px() + np.array([3.0, 0.0])
    assert compare_looks(points(grid_px()), points(moved_px), 1.0, SIZE).still_share <= RESTING_SHARE


def test_too_few_points_in_common_say_nothing():
    assert compare_looks(points(grid_px()[:5]), points(grid_px()[:5]), 1.0, SIZE) is None
    assert "too few points" in complaint_about_motion([])


def test_the_complaint_says_when_it_moves_and_what_to_do():
    looks = [Look(0.1 * i, 0.9 if i < 50 else 0.1) for i in range(100)]
    text = complaint_about_motion(looks)
    assert "50 %" in text
    assert "between 5.00 s and 9.90 s" in text
    assert "--moving" in text
    assert complaint_about_motion(looks[:55]) == ""
