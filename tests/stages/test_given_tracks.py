"""Tables of another tracker get the statuses that our own would give."""

import numpy as np

from ttcvid.model import FrameStatus, PointSet
from ttcvid.stages.tracking.tracked_frames import compare_table_points


def points(ids, shift_px=0.0):
    ids = np.array(ids, dtype=np.int64)
    return PointSet(ids, np.column_stack([ids + shift_px, 2.0 * ids]))


def test_the_first_frame_is_first():
    assert compare_table_points(None, points([1, 2])) == FrameStatus.first


def test_some_tracks_that_go_on_are_a_continuation():
    assert compare_table_points(points([1, 2, 3]), points([3, 4, 5], 1.0)) == FrameStatus.ok


def test_no_track_that_goes_on_is_a_cut():
    assert compare_table_points(points([1, 2, 3]), points([4, 5])) == FrameStatus.cut


def test_the_same_tracks_in_the_same_places_are_a_duplicate():
    assert compare_table_points(points([1, 2]), points([1, 2])) == FrameStatus.duplicate
    assert compare_table_points(points([1, 2]), points([1, 2], 1e-9)) == FrameStatus.ok
    assert compare_table_points(points([1, 2]), points([1])) == FrameStatus.ok


def test_tracks_after_a_frame_without_any_are_no_cut():
    assert compare_table_points(points([]), points([1, 2])) == FrameStatus.ok
