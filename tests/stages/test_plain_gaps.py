"""Gaps between parts of a thing: plain, or with something else in them."""

import numpy as np
import pytest

from ttcvid.stages.segmentation.plain_gaps import across_plain_gaps

# Shoulders and legs of somebody 100 px high, with a plain coat between them; in the order of the tracks.
SHOULDERS, LEGS = [(0.0, 0.0), (8.0, 4.0), (2.0, 30.0)], [(-4.0, 50.0), (9.0, 60.0), (0.0, 95.0)]


def is_plain(*others, shoulders=SHOULDERS, others_are_told=True, least_px=0.0, order=None):
    xy_px = np.array([*shoulders, *LEGS, *others])
    part = np.array([0] * len(shoulders) + [1] * len(LEGS) + [-1] * len(others))
    thing = np.where(part < 0, 0, 1)
    is_told = (part >= 0) | others_are_told
    order = np.arange(len(part)) if order is None else order
    pair = np.array([0]), np.array([1])
    return bool(across_plain_gaps(xy_px[order], thing[order], is_told[order], part[order], *pair, least_px)[0])


def test_with_nothing_between_them_parts_are_one():
    assert is_plain()
    assert is_plain((60.0, 40.0), (-50.0, 40.0), (0.0, 120.0))


def test_with_something_else_between_them_they_are_not():
    assert not is_plain((0.0, 41.0))


def test_what_is_seen_beside_a_neck_is_not_between():
    assert is_plain((14.0, 40.0))


def test_a_track_that_has_just_begun_says_nothing():
    assert is_plain((0.0, 41.0), others_are_told=False)


def test_a_gap_wider_than_three_quarters_of_the_larger_part_stays_one():
    assert not is_plain(shoulders=[(x, y - 16.0) for x, y in SHOULDERS])


def test_parts_nearer_than_asked_for_have_no_gap():
    assert is_plain(least_px=15.0)
    assert not is_plain(least_px=25.0)


@pytest.mark.parametrize("seed", range(3))
def test_the_order_of_the_tracks_does_not_matter(seed):
    order = np.random.default_rng(seed).permutation(7)
    assert not is_plain((0.0, 41.0), order=order)
    assert is_plain((60.0, 40.0), order=order)


def test_no_pairs_are_no_error():
    none = np.empty(0, dtype=np.int64)
    found = across_plain_gaps(
        np.zeros((1, 2)), np.zeros(1, np.int64), np.ones(1, bool), np.zeros(1, np.int64), none, none
    )
    assert found.shape == (0,)
