"""What of an object is as near as its nearest surface."""

import numpy as np
import pytest
from relative_motion import FOCAL_PX, box_of_points

from ttcvid.stages.objects.joint_states import joint_states
from ttcvid.stages.objects.near_face import front_boxes
from ttcvid.stages.objects.states import TrackStates
from ttcvid.stages.tracking.groups import TrackSets

V_M_S = np.array([0.0, 0.0, -8.0])
AHEAD = np.array([0.0, 0.0, -1.0])


def states_of(position_m, relative_sigma=0.01):
    n, abc_hz = len(position_m), V_M_S / position_m[:, 2:]
    cov = (np.asarray(relative_sigma) * np.abs(abc_hz[:, 2]))[:, None, None] ** 2 * np.eye(3)
    xy = position_m[:, :2] / position_m[:, 2:]
    return TrackStates(xy, abc_hz, cov, np.full(n, 1e-4), np.tile(AHEAD, (n, 1)), np.zeros(n, dtype=np.int64))


def front_of(position_m, relative_sigma=0.01, has_no_value=()):
    states = states_of(position_m, relative_sigma)
    states.status[list(has_no_value)] = 1
    members = TrackSets.of([np.arange(len(position_m))])
    joint = joint_states(members, AHEAD[None], np.array([False]), states, FOCAL_PX * states.xy, 60.0)
    (box,) = front_boxes(members, members.boxes(FOCAL_PX * states.xy), joint, states, FOCAL_PX * states.xy)
    return box


@pytest.fixture
def rng():
    return np.random.default_rng(4)


def test_of_two_cars_taken_for_one_the_nearer_is_the_front(rng):
    near = box_of_points(rng, 40, (3.6, 0.7, 14.0), (1.8, 1.2, 0.2))
    far = box_of_points(rng, 40, (2.4, 0.7, 24.0), (1.8, 1.2, 0.2))
    box = front_of(np.concatenate([near, far]))
    np.testing.assert_allclose(box, TrackSets.of([np.arange(40)]).boxes(FOCAL_PX * near[:, :2] / near[:, 2:])[0])


def test_tracks_without_a_value_have_no_part_in_it(rng):
    near = box_of_points(rng, 40, (0.0, 0.7, 14.0), (1.8, 1.2, 0.2))
    astray = np.array([[-6.0, 0.0, 14.0]])
    inside = front_of(near)
    np.testing.assert_allclose(front_of(np.concatenate([near, astray]), has_no_value=[40]), inside)


def test_a_track_of_which_nobody_knows_how_deep_it_lies_widens_no_front_that_is_known(rng):
    near = box_of_points(rng, 40, (0.0, 0.7, 14.0), (1.8, 1.2, 0.2))
    beside = np.array([[-6.0, 0.0, 16.5]])
    sigma = np.append(np.full(40, 0.01), 0.2)
    np.testing.assert_allclose(front_of(np.concatenate([near, beside]), sigma), front_of(near))


def test_what_may_be_as_near_belongs_to_it(rng):
    car = box_of_points(rng, 40, (0.0, 0.7, 20.0), (1.8, 1.2, 6.0))
    whole = TrackSets.of([np.arange(40)]).boxes(FOCAL_PX * car[:, :2] / car[:, 2:])[0]
    np.testing.assert_allclose(front_of(car, relative_sigma=0.3), whole)
    assert front_of(car)[1] > whole[1]
