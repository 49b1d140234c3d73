"""Which tracks are part of a mover by how far away they are, and which neighbours have a say in that."""

import numpy as np
import pytest

from ttcvid.stages.segmentation.data_association import are_nearer, sureness

OWN = np.array([True] * 5 + [False] * 3)


def nearer(rates, asked, sigma_hz=0.01):
    rate_hz = np.array([*rates, *asked])
    return are_nearer(rate_hz, np.full(8, sigma_hz), np.zeros(8, dtype=np.int64), OWN, 1)


def test_the_road_before_a_car_that_keeps_its_distance_is_no_part_of_it():
    assert nearer([0.0, 0.01, -0.01, 0.005, -0.005], [0.7, 0.3, 0.02]).tolist() == [False] * 5 + [True, True, False]


def test_the_far_end_and_the_near_end_of_a_bus_are_parts_of_it():
    assert not nearer([0.5, 0.6, 0.7, 0.8, 0.9], [0.45, 1.0, 1.3]).any()


def test_a_rate_that_is_hardly_known_says_nothing():
    assert not nearer([0.1] * 5, [0.3, 0.4, 0.5], sigma_hz=0.2).any()
    assert not nearer([0.1] * 5, [np.nan, 0.1, 0.1]).any()
    assert not nearer([np.nan] * 5, [0.3, 0.4, 0.5]).any()
    assert nearer([0.1, 0.11, np.nan, np.nan, np.nan], [0.3, 0.1, 0.1]).tolist() == [False] * 5 + [True, False, False]


def test_each_mover_is_asked_for_itself():
    rate_hz, thing = np.array([0.1, 0.1, 0.1, 1.0, 1.0, 1.0, 0.5, 0.5]), np.array([0, 0, 0, 1, 1, 1, 0, 1])
    own = np.array([True] * 6 + [False] * 2)
    assert np.flatnonzero(are_nearer(rate_hz, np.full(8, 0.01), thing, own, 2)).tolist() == [6]


def test_a_neighbour_has_a_say_by_how_much_better_one_body_explains_it():
    alike, in_scene, in_mover, in_none, alone = [1.0, 1.0], [1.0, 9.0], [9.0, 1.0], [80.0, 60.0], [1.0, np.inf]
    say = sureness(np.array([alike, in_scene, in_mover, in_none, alone]), np.array([0, 0, 1, 1, 0]))
    # A Cauchy residual of chi-square 9 is five times as improbable as one of 1: probabilities 5/6 and 1/6.
    assert say == pytest.approx([0.0, 4 / 6, 4 / 6, 0.0, 49 / 53])


def test_a_track_that_is_about_to_change_is_as_sure():
    assert sureness(np.array([[1.0, 9.0, 40.0]]), np.array([1])) == pytest.approx(4 / 6)
