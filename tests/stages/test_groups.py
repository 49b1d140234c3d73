"""Sums, medians, boxes and radii over sets of tracks are those of each set by itself."""

import numpy as np

from ttcvid.stages.tracking.groups import TrackSets

VALUES = np.random.default_rng(5).normal(size=(12, 2))
MEMBERS = [np.array([3, 1, 7]), np.array([0]), np.array([11, 2, 5, 8])]
SETS = TrackSets.of(MEMBERS)


def test_figures_of_each_set_are_those_of_its_members():
    of_tracks = VALUES[SETS.index]
    np.testing.assert_allclose(SETS.sums(of_tracks), [VALUES[index].sum(axis=0) for index in MEMBERS])
    np.testing.assert_allclose(SETS.medians(of_tracks[:, 0]), [np.median(VALUES[index, 0]) for index in MEMBERS])
    lowest, highest = SETS.boxes(VALUES)[:, :2], SETS.boxes(VALUES)[:, 2:]
    np.testing.assert_allclose(lowest, [VALUES[index].min(axis=0) for index in MEMBERS])
    np.testing.assert_allclose(highest, [VALUES[index].max(axis=0) for index in MEMBERS])
    np.testing.assert_array_equal(SETS.lengths, [3, 1, 4])


def test_the_radius_of_a_set_is_that_of_its_places_that_are_known():
    places, third = VALUES.copy(), _radius(VALUES[MEMBERS[2]])
    np.testing.assert_allclose(SETS.radii(places), [_radius(VALUES[MEMBERS[0]]), 0.0, third])
    places[MEMBERS[0][1]] = places[MEMBERS[1]] = np.nan
    np.testing.assert_allclose(SETS.radii(places), [_radius(VALUES[MEMBERS[0][[0, 2]]]), 0.0, third])


def _radius(places):
    """Root mean square distance from the middle."""
    return np.sqrt(np.mean(np.sum((places - places.mean(axis=0)) ** 2, axis=1)))


def test_a_set_that_loses_all_its_tracks_is_left_out():
    kept, left = SETS.where(np.array([True, False, True, False, False, True, True, True]))
    np.testing.assert_array_equal(left, [0, 2])
    np.testing.assert_array_equal(kept.index, [3, 7, 2, 5, 8])
    np.testing.assert_array_equal(kept.first, [0, 2])
    none, left = SETS.where(np.zeros(8, dtype=bool))
    assert len(none) == len(left) == len(none.index) == 0


def test_there_may_be_no_sets():
    none = TrackSets.of([])
    assert len(none) == 0
    assert none.boxes(VALUES).shape == (0, 4)
    assert none.medians(np.empty(0)).shape == none.radii(VALUES).shape == (0,)
