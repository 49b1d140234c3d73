"""Tracks of one moving thing are gathered; what is dragged along, or moves otherwise, is not."""

import numpy as np
import pytest

from ttcvid.config import HorizonCalibrationConfig
from ttcvid.model import PointSet
from ttcvid.stages.horizon.movers import group_movers, moving_tracks
from ttcvid.stages.horizon.whole_tracks import joined, observations_of, without_ended_at_rest

DT_S, N_FRAMES = 0.04, 50
CONFIG = HorizonCalibrationConfig()


def tracks(*paths_px):
    """Tracks 0, 1, ... with the positions ``(N_FRAMES, 2)``, seen from frame 0 on."""
    numbers = np.arange(len(paths_px))
    frames = [np.array([path[k] for path in paths_px]) for k in range(N_FRAMES)]
    return joined([observations_of(PointSet(numbers, xy), k, DT_S * k) for k, xy in enumerate(frames)])


def line(start, step):
    return np.asarray(start, float) + np.arange(N_FRAMES)[:, None] * np.asarray(step, float)


def test_what_moves_steadily_is_taken():
    braking = line([0, 0], [0, 0]) + np.linspace(0, 1, N_FRAMES)[:, None] ** 0.6 * [60.0, 5.0]
    assert moving_tracks(tracks(line([10, 10], [1.0, 0.2]), braking), CONFIG).tolist() == [True, True]


def test_what_stays_is_dragged_along_or_swings_is_not():
    stays = line([10, 10], [0, 0])
    dragged = line([10, 10], [0, 0])
    dragged[20:26] += np.arange(6)[:, None] * [4.0, 0.0]
    dragged[26:] += [20.0, 0.0]
    swings = line([10, 10], [0.3, 0.0]) + 15 * np.sin(np.arange(N_FRAMES) / 5.0)[:, None] * [1.0, 0.0]
    assert not moving_tracks(tracks(stays, dragged, swings), CONFIG).any()


def test_neighbours_that_move_alike_belong_together_and_chains_of_them():
    car = [line([10 + 20 * i, 50], [2.0, 0.1 * i / 5]) for i in range(5)]
    oncoming = [line([100 + 20 * i, 60], [-2.0, 0.0]) for i in range(3)]
    labels = group_movers(tracks(*car, *oncoming), 30.0)
    assert len(set(labels[:5])) == 1
    assert len(set(labels[5:])) == 1
    assert labels[0] != labels[5]


@pytest.mark.parametrize("kept", [slice(None, None, 3), slice(None, None, 4), slice(None, None, 7)])
def test_movers_are_gathered_in_every_third_frame_as_in_all(kept):
    """Frames keep their numbers in the source, and the times are theirs."""
    assert_gathers(np.arange(N_FRAMES)[kept])


def test_movers_are_gathered_where_frames_are_missing_here_and_there():
    """What is compared is the time between two frames: in some 40 % of cases the one just a step later is missing."""
    rng = np.random.default_rng(1)
    assert_gathers(np.flatnonzero(rng.random(N_FRAMES) < 0.6))


def assert_gathers(kept):
    car = [line([10 + 20 * i, 50], [2.0, 0.1 * i / 5]) for i in range(5)]
    oncoming = [line([100 + 20 * i, 60], [-2.0, 0.0]) for i in range(3)]
    rows = tracks(*car, *oncoming)
    labels = group_movers(rows.take(np.isin(rows.frame, kept)), 30.0)
    assert len(set(labels[:5])) == 1
    assert len(set(labels[5:])) == 1
    assert labels[0] != labels[5]


def test_the_order_of_tracks_does_not_matter():
    paths = [line([10 + 20 * i, 50], [2.0, 0.0]) for i in range(3)] + [line([12, 80], [0.0, 2.0])]
    one, other = (group_movers(tracks(*order), 30.0) for order in (paths, paths[::-1]))
    assert (one[:, None] == one).tolist() == (other[::-1, None] == other[::-1]).tolist()


def test_no_tracks_make_no_movers():
    assert len(group_movers(joined([]), 30.0)) == 0


def test_tracks_at_rest_are_forgotten_when_they_end():
    rows = tracks(line([10, 10], [0, 0]), line([10, 10], [1.0, 0.0]))
    assert set(without_ended_at_rest(rows, N_FRAMES).track_id) == {1}
    assert set(without_ended_at_rest(rows, N_FRAMES - 1).track_id) == {0, 1}
    assert len(without_ended_at_rest(joined([]), 0).frame) == 0
