"""What was found as one surface keeps its number when it turns out to move."""

import numpy as np

from ttcvid.config import BodiesConfig
from ttcvid.stages.segmentation.surface_memory import Obstacle, number_of_taken, remembered, without_numbers

CONFIG = BodiesConfig()
TRACKS = np.arange(100, 130)
CAR = Obstacle(7, TRACKS[:10], n_found=9)


def after_a_frame(before, is_free, surfaces=()):
    return remembered(before, TRACKS, list(surfaces), is_free, 8, CONFIG)


def test_a_mover_that_has_most_tracks_of_an_obstacle_is_that_obstacle():
    assert number_of_taken((CAR,), TRACKS, np.arange(4, 25)) == 7
    assert number_of_taken((CAR,), TRACKS, np.arange(5, 25)) is None


def test_of_the_tracks_of_an_obstacle_only_those_that_live_count():
    old = Obstacle(7, np.concatenate([np.arange(50), TRACKS[:10]]))
    assert number_of_taken((old,), TRACKS, np.arange(10)) == 7


def test_a_mover_far_from_any_obstacle_or_on_one_that_was_never_public_is_a_new_thing():
    assert number_of_taken((), TRACKS, np.arange(10)) is None
    assert number_of_taken((CAR,), TRACKS, np.arange(10, 20)) is None
    assert number_of_taken((Obstacle(None, TRACKS[:10]),), TRACKS, np.arange(10)) is None
    gone = Obstacle(7, np.arange(5))
    assert number_of_taken((gone,), TRACKS, np.arange(10)) is None


def test_an_obstacle_is_remembered_without_being_seen_while_a_mover_has_its_tracks():
    """A mover is confirmed after some frames: until then the number waits for it, or for the obstacle itself."""
    taken = np.arange(len(TRACKS)) >= 10
    memory = (CAR,)
    for _ in range(CONFIG.confirm_frames):
        public, memory, next_id = after_a_frame(memory, taken)
        assert public == {}
    assert number_of_taken(memory, TRACKS, np.arange(10)) == 7
    public, _, next_id = after_a_frame(memory, np.ones(len(TRACKS), dtype=bool), [np.arange(10)])
    assert list(public) == [7]
    assert next_id == 8


def test_an_obstacle_that_a_mover_has_a_part_of_is_seen_by_the_rest_of_its_tracks():
    public, _, _ = after_a_frame((CAR,), np.arange(len(TRACKS)) >= 3)
    np.testing.assert_array_equal(public[7], np.arange(3, 10))


def test_what_has_given_its_number_to_a_mover_is_forgotten():
    other = Obstacle(3, TRACKS[20:])
    young = Obstacle(None, TRACKS[10:20])
    assert without_numbers((CAR, other, young), np.array([7, 9])) == (other, young)


def test_one_track_that_what_passes_drags_along_gives_no_number():
    left = Obstacle(7, np.concatenate([np.arange(29), TRACKS[:1]]))
    assert number_of_taken((left,), TRACKS, np.arange(20)) is None


def test_of_two_obstacles_the_mover_is_that_of_which_it_has_most():
    small = Obstacle(3, TRACKS[10:14])
    assert number_of_taken((small, CAR), TRACKS, np.arange(30)) == 7


def test_an_obstacle_that_another_covers_ends_with_its_tracks():
    """Tracks of both are those of the one that is seen, though the other is remembered."""
    memory = (Obstacle(5, np.arange(20), 9), Obstacle(6, np.arange(12, 42), 9))
    for frame in range(6):
        track_id = np.arange(min(3 * frame, 12), 42)
        nearer = np.flatnonzero(track_id >= 12)
        public, memory, _ = remembered(memory, track_id, [nearer], track_id < 12, 7, CONFIG)
        np.testing.assert_array_equal(track_id[public[6]], np.arange(12, 42))
