"""A group keeps its number by its tracks, and a number is given once."""

import numpy as np
import pytest

from ttcvid.geometry.rotation import rotation_from_vector
from ttcvid.model import Status
from ttcvid.stages.group_identity import GroupMemory, former_groups, named, restarted
from ttcvid.stages.motion_groups import MotionGroup

AHEAD = np.array([0.0, 0.0, -1.0])


class Watcher:
    """Groups given as sets of track numbers, frame after frame."""

    def __init__(self):
        self.memory = GroupMemory()

    def frame(self, *groups, others=()):
        """Public numbers of the groups of this frame; `others` are live tracks of no group."""
        track_id = np.unique(np.concatenate([np.array(sorted(g), dtype=np.int64) for g in (*groups, set(others))]))
        found = [
            MotionGroup(np.searchsorted(track_id, sorted(g)), AHEAD, 1e-6 * np.diag([1.0, 1.0, 0.0]), Status.ok)
            for g in groups
        ]
        names, self.memory = named(found, track_id, self.memory, np.eye(3))
        return names

    def frames(self, n, *groups, others=()):
        return [self.frame(*groups, others=others) for _ in range(n)][-1]


def tracks(first, last):
    return set(range(first, last))


def test_a_group_is_confirmed_in_its_third_frame():
    watcher = Watcher()
    assert [watcher.frame(tracks(0, 10)) for _ in range(4)] == [[None], [None], [1], [1]]


def test_numbers_count_from_one_without_holes_though_chance_groups_come_and_go():
    watcher = Watcher()
    for i in range(6):
        watcher.frame(tracks(1000 + 10 * i, 1005 + 10 * i))
    assert watcher.frames(3, tracks(0, 10)) == [1]
    for i in range(6):
        watcher.frame(tracks(0, 10), tracks(2000 + 10 * i, 2005 + 10 * i))
    assert watcher.frames(3, tracks(0, 10), tracks(20, 30)) == [1, 2]
    assert watcher.frames(3, tracks(40, 50), tracks(0, 10), tracks(20, 30)) == [3, 1, 2]


def test_a_group_keeps_its_number_while_its_tracks_are_replaced_and_it_is_lost_for_five_frames():
    watcher = Watcher()
    numbers = []
    for i in range(30):
        present = tracks(i, i + 12)
        if 12 <= i < 17:
            watcher.frame(others=present)
        else:
            numbers.append(watcher.frame(present)[0])
    assert numbers == [None, None] + [1] * 23


def test_order_of_groups_does_not_matter():
    one, other = Watcher(), Watcher()
    one.frames(3, tracks(0, 10), tracks(20, 28))
    other.frames(3, tracks(0, 10), tracks(20, 28))
    assert one.frame(tracks(0, 10), tracks(20, 28)) == other.frame(tracks(20, 28), tracks(0, 10))[::-1]


def test_when_a_group_splits_the_larger_part_keeps_the_number():
    watcher = Watcher()
    watcher.frames(3, tracks(0, 20))
    assert watcher.frame(tracks(0, 7), tracks(7, 20)) == [None, 1]
    assert watcher.frames(2, tracks(0, 7), tracks(7, 20)) == [2, 1]


def test_when_groups_merge_the_one_with_more_tracks_goes_on():
    watcher = Watcher()
    assert watcher.frames(3, tracks(0, 6), tracks(20, 40)) == [1, 2]
    assert watcher.frame(tracks(0, 6) | tracks(20, 40)) == [2]


def test_two_groups_never_have_one_number():
    rng = np.random.default_rng(41)
    watcher = Watcher()
    everything = np.arange(60)
    for _ in range(60):
        cuts = np.sort(rng.choice(60, 4, replace=False))
        groups = [set(part.tolist()) for part in np.split(everything, cuts) if len(part) >= 3]
        names = [name for name in watcher.frame(*groups, others=set(everything.tolist())) if name is not None]
        assert len(set(names)) == len(names)


def test_a_group_that_is_gone_for_long_does_not_come_back_under_its_number():
    watcher = Watcher()
    watcher.frames(3, tracks(0, 10))
    watcher.frames(20, others=tracks(0, 10))
    assert watcher.frames(3, tracks(0, 10)) == [2]


def test_tracks_that_end_are_forgotten():
    watcher = Watcher()
    for i in range(50):
        watcher.frame(tracks(10 * i, 10 * i + 10))
    assert len(watcher.memory.track_id) == 10
    assert len(watcher.memory.groups) < 15


@pytest.mark.parametrize("n_before", [1, 4])
def test_no_number_is_given_again_after_a_cut(n_before):
    watcher = Watcher()
    watcher.frames(n_before + 2, tracks(0, 10), tracks(20, 30))
    watcher.memory = restarted(watcher.memory)
    assert watcher.memory.groups == ()
    assert watcher.frames(3, tracks(0, 10)) == [3]


def test_the_next_search_starts_from_the_groups_turned_into_the_present_camera():
    watcher = Watcher()
    watcher.frames(3, tracks(0, 10), tracks(20, 30))
    cam_R_prev = rotation_from_vector(np.array([0.0, 0.1, 0.0]))
    # Track 3 has ended, track 15 is new.
    track_id = np.array(sorted((tracks(0, 10) | tracks(20, 30) | {15}) - {3}))
    former = former_groups(watcher.memory, track_id, cam_R_prev)
    assert [sorted(track_id[g.members].tolist()) for g in former] == [
        sorted(tracks(0, 10) - {3}),
        sorted(tracks(20, 30)),
    ]
    for group in former:
        np.testing.assert_allclose(group.direction, cam_R_prev @ AHEAD, atol=1e-12)
