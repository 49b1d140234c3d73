"""The state of an object from its tracks: what they share does not average out, however each of them was timed;
of what turns, the nearest surface is told by depths.
"""

from dataclasses import replace

import numpy as np
import pytest

from ttcvid.model import Status
from ttcvid.stages.joint_states import joint_states
from ttcvid.stages.sets import TrackSets
from ttcvid.stages.track_states import SharedErrors, TrackStates

N, N_SHARED = 40, 9
RATE_HZ, OWN_PART, SHARED_PART, CHANGE = 0.4, 0.05, 0.08, 0.1
AHEAD = np.array([0.0, 0.0, -1.0])
FOCAL_PX, LINK_PX = 700.0, 40.0
TO_US = np.array([0.8, 0.0, -0.6])
N_WALL = 80


def states_on_one_path():
    """Tracks of a plate straight ahead, whose rates have errors of their own and one in common."""
    own = np.full(N, (OWN_PART * RATE_HZ) ** 2)
    jacobian, cov = np.zeros((N, 3, N_SHARED)), np.zeros((N, 3, 3))
    jacobian[:, 2, 2] = RATE_HZ
    shared_cov = np.zeros((1, N_SHARED, N_SHARED))
    shared_cov[0, 2, 2] = SHARED_PART**2
    cov[:, 2, 2] = own + (SHARED_PART * RATE_HZ) ** 2 + (CHANGE * RATE_HZ) ** 2
    cov[:, 0, 0] = cov[:, 1, 1] = 1e-6
    shared = SharedErrors(
        path_of=np.zeros(N, dtype=np.int64),
        along=AHEAD[None],
        rate_hz=np.full(N, RATE_HZ),
        rate_variance=own,
        jacobian=jacobian,
        rate_jacobian=-jacobian[:, 2],
        cov=shared_cov,
        change=np.array([CHANGE]),
        turn_rad_s=np.zeros((1, 3)),
    )
    return TrackStates(
        xy=np.random.default_rng(90).uniform(-0.03, 0.03, (N, 2)),
        abc_hz=np.tile(RATE_HZ * AHEAD, (N, 1)),
        cov=cov,
        sigma_norm=np.full(N, 1e-4),
        direction=np.tile(AHEAD, (N, 1)),
        status=np.zeros(N, dtype=np.int64),
        shared=shared,
    )


def without_path(states, index):
    path_of = states.shared.path_of.copy()
    path_of[index] = -1
    return replace(states, shared=replace(states.shared, path_of=path_of))


def sigma_and_change(states):
    """Standard deviation of the object's rate as a part of it, and by what part its speed may change."""
    members, xy_px = TrackSets.of([np.arange(N)]), FOCAL_PX * states.xy
    joint = joint_states(members, AHEAD[None], np.array([False]), states, xy_px, LINK_PX)
    return float(np.sqrt(joint.cov[0, 2, 2])) / RATE_HZ, float(joint.speed_change[0])


def test_what_tracks_share_does_not_average_out():
    sigma, change = sigma_and_change(states_on_one_path())
    own = OWN_PART / np.sqrt(N)
    assert sigma == pytest.approx(np.sqrt(SHARED_PART**2 + CHANGE**2 + own**2), rel=0.02)
    assert change == CHANGE


@pytest.mark.parametrize("first", [0, 7])
@pytest.mark.parametrize("count", [1, 20])
def test_tracks_timed_by_expansion_do_not_make_an_object_surer_of_the_path_of_the_others(first, count):
    states = states_on_one_path()
    sigma, change = sigma_and_change(without_path(states, np.arange(first, first + count)))
    expected, _ = sigma_and_change(states)
    assert 0.9 * expected < sigma < 1.1 * expected
    assert change == CHANGE


def test_tracks_timed_by_expansion_err_as_one():
    sigma, change = sigma_and_change(without_path(states_on_one_path(), np.arange(N)))
    assert sigma == pytest.approx(np.sqrt(OWN_PART**2 + SHARED_PART**2 + CHANGE**2), rel=0.02)
    assert change == 0.0


def wall(turn_rad_s, seed=1):
    """States of a wall that comes from the left at 5 m/s, its right end at 8 m, its left one at 16 m, and turns."""
    rng = np.random.default_rng(seed)
    xy = np.column_stack([rng.uniform(-0.5, 0.1, N_WALL), rng.uniform(-0.1, 0.1, N_WALL)])
    inverse_depth = np.interp(xy[:, 0], [-0.5, 0.1], [1.0 / 16.0, 1.0 / 8.0])
    rate_hz = 5.0 * inverse_depth
    rays = np.column_stack([xy, np.ones(N_WALL)])
    abc_hz = rate_hz[:, None] * TO_US + np.cross(turn_rad_s, rays)
    jacobian = np.zeros((N_WALL, 3, N_SHARED))
    shared = SharedErrors(
        path_of=np.zeros(N_WALL, dtype=np.int64),
        along=TO_US[None],
        rate_hz=rate_hz,
        rate_variance=np.full(N_WALL, 1e-8),
        jacobian=jacobian,
        rate_jacobian=jacobian[:, 0],
        cov=np.zeros((1, N_SHARED, N_SHARED)),
        change=np.zeros(1),
        turn_rad_s=np.reshape(turn_rad_s, (1, 3)),
    )
    cov = np.broadcast_to(1e-8 * np.eye(3), (N_WALL, 3, 3))
    direction = abc_hz / np.linalg.norm(abc_hz, axis=1)[:, None]
    return TrackStates(xy, abc_hz, cov, np.full(N_WALL, 1e-4), direction, np.full(N_WALL, Status.ok), shared)


def joint_of(states):
    members = TrackSets.of([np.arange(N_WALL)])
    return joint_states(members, TO_US[None], np.array([False]), states, 1000.0 * states.xy, 200.0)


def test_the_nearest_surface_of_a_turning_thing_is_the_nearest_and_not_the_fastest():
    # The turn makes the far left end the one that moves fastest along the direction of the middle.
    turn_rad_s = np.array([0.0, -1.0, 0.0])
    states = wall(turn_rad_s)
    assert states.xy[np.argmax(states.abc_hz @ TO_US), 0] < -0.45
    found = joint_of(states)
    assert found.ref_px[0, 0] > 0.0
    x = found.ref_px[0, 0] / 1000.0
    rate_hz = 5.0 * np.interp(x, [-0.5, 0.1], [1.0 / 16.0, 1.0 / 8.0])
    at_ref = rate_hz * TO_US + np.cross(turn_rad_s, [x, found.ref_px[0, 1] / 1000.0, 1.0])
    np.testing.assert_allclose(found.abc_hz[0], at_ref, rtol=0.02, atol=1e-3)


def test_how_sure_a_turning_thing_is_holds_the_velocities_of_the_places_that_may_be_nearest():
    still, turning = joint_of(wall(np.zeros(3))), joint_of(wall(np.array([0.0, -0.5, 0.0])))
    assert not still.place_cov.any()
    # Of a plane's nearest tenth x spans a tenth of 0.6; its ends differ in c by the turn times that.
    half_span = 0.5 * 0.5 * 0.06
    assert 0.5 * half_span < np.sqrt(turning.place_cov[0, 2, 2]) < 2.0 * half_span
    np.testing.assert_allclose(turning.cov - turning.place_cov, still.cov, atol=1e-6)
