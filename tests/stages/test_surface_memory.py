"""An obstacle keeps its number from frame to frame while it keeps its tracks."""

import numpy as np

from ttcvid.config import BodiesConfig
from ttcvid.stages.segmentation.surface_memory import Obstacle, are_confirmed, remembered

CONFIG = BodiesConfig()
TRACKS = np.arange(100, 130)
CAR = Obstacle(7, TRACKS[:10], n_found=9)


def after_a_frame(before, is_free, surfaces=()):
    return remembered(before, TRACKS, list(surfaces), is_free, 8, CONFIG)


def test_an_obstacle_is_remembered_without_being_seen_while_a_mover_has_its_tracks():
    taken = np.arange(len(TRACKS)) >= 10
    memory = (CAR,)
    for _ in range(3):
        public, memory, next_id = after_a_frame(memory, taken)
        assert public == {}
    public, _, next_id = after_a_frame(memory, np.ones(len(TRACKS), dtype=bool), [np.arange(10)])
    assert list(public) == [7]
    assert next_id == 8


def test_an_obstacle_that_a_mover_has_a_part_of_is_seen_by_the_rest_of_its_tracks():
    public, _, _ = after_a_frame((CAR,), np.arange(len(TRACKS)) >= 3)
    np.testing.assert_array_equal(public[7], np.arange(3, 10))


def test_an_obstacle_that_another_covers_ends_with_its_tracks():
    """Tracks of both are those of the one that is seen, though the other is remembered."""
    memory = (Obstacle(5, np.arange(20), 9), Obstacle(6, np.arange(12, 42), 9))
    for frame in range(6):
        track_id = np.arange(min(3 * frame, 12), 42)
        nearer = np.flatnonzero(track_id >= 12)
        public, memory, _ = remembered(memory, track_id, [nearer], track_id < 12, 7, CONFIG)
        np.testing.assert_array_equal(track_id[public[6]], np.arange(12, 42))


def test_the_more_tracks_a_thing_has_the_fewer_frames_confirm_it():
    n_tracks = np.array([3, 4, 6, 11, 12, 40])
    confirmed_after = [next(n for n in range(1, 9) if are_confirmed(n, k, CONFIG)) for k in n_tracks]
    assert confirmed_after == [4, 3, 2, 2, 1, 1]
