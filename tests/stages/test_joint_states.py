"""The state of an object from its tracks: what they share does not average out, however each of them was timed."""

from dataclasses import replace

import numpy as np
import pytest

from ttcvid.stages.objects.joint_states import joint_states
from ttcvid.stages.objects.states import SharedErrors, TrackStates, nothing_shared
from ttcvid.stages.tracking.groups import TrackSets

N, N_SHARED = 40, 12
RATE_HZ, OWN_PART, SHARED_PART = 0.4, 0.05, 0.08
AHEAD = np.array([0.0, 0.0, -1.0])
FOCAL_PX, LINK_PX = 700.0, 40.0
TO_US = np.array([0.8, 0.0, -0.6])


def states_on_one_path():
    """Tracks of a plate straight ahead, whose rates have errors of their own and one in common."""
    own = np.full(N, (OWN_PART * RATE_HZ) ** 2)
    jacobian, cov = np.zeros((N, 3, N_SHARED)), np.zeros((N, 3, 3))
    jacobian[:, 2, 2] = RATE_HZ
    shared_cov = np.zeros((1, N_SHARED, N_SHARED))
    shared_cov[0, 2, 2] = SHARED_PART**2
    cov[:, 2, 2] = own + (SHARED_PART * RATE_HZ) ** 2
    cov[:, 0, 0] = cov[:, 1, 1] = 1e-6
    shared = SharedErrors(
        path_of=np.zeros(N, dtype=np.int64),
        along=AHEAD[None],
        rate_hz=np.full(N, RATE_HZ),
        rate_variance=own,
        jacobian=jacobian,
        cov=shared_cov,
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


def relative_sigma(states):
    """Standard deviation of the object's rate as a part of it."""
    members, xy_px = TrackSets.of([np.arange(N)]), FOCAL_PX * states.xy
    joint = joint_states(members, AHEAD[None], np.array([False]), states, xy_px, LINK_PX)
    return float(np.sqrt(joint.cov[0, 2, 2])) / RATE_HZ


def test_what_tracks_share_does_not_average_out():
    sigma = relative_sigma(states_on_one_path())
    own = OWN_PART / np.sqrt(N)
    assert sigma == pytest.approx(np.hypot(SHARED_PART, own), rel=0.02)


@pytest.mark.parametrize("which", [0, 7])
def test_a_track_timed_by_expansion_does_not_make_an_object_surer_of_the_path_of_the_others(which):
    states = states_on_one_path()
    sigma = relative_sigma(without_path(states, np.array([which])))
    expected = relative_sigma(states)
    assert 0.9 * expected < sigma < 1.1 * expected


@pytest.mark.parametrize(("count", "depth"), [(8, 0.2), (5, 0.3)])
def test_tracks_known_better_than_they_agree_have_a_surface_that_may_be_as_near_as_its_nearest(count, depth):
    """A cyclist near by: each track is known to a thousandth, and he is a part of his distance deep."""
    states, own = states_on_one_path(), 1e-3 * RATE_HZ
    rate_hz = RATE_HZ * np.linspace(1.0 - 0.5 * depth, 1.0 + 0.5 * depth, count)
    shared = replace(states.shared, rate_variance=np.full(N, own**2), cov=np.zeros((1, N_SHARED, N_SHARED)))
    shared.rate_hz[:count] = rate_hz
    states = replace(states, shared=shared)
    states.abc_hz[:count] = rate_hz[:, None] * AHEAD
    states.cov[:, 2, 2] = own**2
    members, xy_px = TrackSets.of([np.arange(count)]), FOCAL_PX * states.xy
    joint = joint_states(members, AHEAD[None], np.array([False]), states, xy_px, LINK_PX)
    (found_hz,), (sigma_hz,) = -joint.abc_hz[:, 2], np.sqrt(joint.cov[:, 2, 2])
    assert found_hz >= RATE_HZ
    assert found_hz + sigma_hz == pytest.approx(rate_hz[-1], rel=0.01)


def test_three_tracks_in_our_way_are_as_sure_as_they_are():
    """What is found as one surface has the times of all of its tracks, and no relief that was looked for in vain."""
    states = states_on_one_path()
    members, xy_px = TrackSets.of([np.arange(3)]), FOCAL_PX * states.xy
    joint = joint_states(members, AHEAD[None], np.array([True]), states, xy_px, LINK_PX)
    own = np.sqrt(1.35 / 3.0) * OWN_PART
    assert np.sqrt(joint.cov[0, 2, 2]) / RATE_HZ == pytest.approx(np.hypot(SHARED_PART, own), rel=0.01)


@pytest.mark.parametrize(("count", "independent"), [(6, 1.0), (40, 40 / 8)])
def test_tracks_timed_by_expansion_err_with_their_neighbours(count, independent):
    states = without_path(states_on_one_path(), np.arange(N))
    members, xy_px = TrackSets.of([np.arange(count)]), FOCAL_PX * states.xy
    joint = joint_states(members, AHEAD[None], np.array([False]), states, xy_px, 10 * LINK_PX)
    of_a_track = OWN_PART**2 + SHARED_PART**2
    assert joint.cov[0, 2, 2] / RATE_HZ**2 == pytest.approx(of_a_track / independent, rel=0.02)


def test_tracks_without_a_rate_on_the_path_have_no_part_in_what_the_others_share():
    """Such as a point on the epipole, which nothing but expansion times."""
    states, index = states_on_one_path(), np.arange(3)
    off_path = without_path(states, index)
    expected = relative_sigma(off_path)
    for values in (off_path.shared.jacobian, off_path.shared.rate_variance):
        values[index] = np.nan
    assert relative_sigma(off_path) == expected


@pytest.mark.parametrize("turn_rad_s", [0.0, -0.45])
def test_the_near_end_of_a_side_is_told_by_the_whole_side_and_not_by_its_largest_errors(turn_rad_s):
    rng, turn, count, noise = np.random.default_rng(93), np.array([0.0, turn_rad_s, 0.0]), 60, 0.08 * RATE_HZ
    off_hz, off_rad = [], []
    for _ in range(40):
        xy = rng.uniform([-0.2, -0.1], [0.2, 0.1], (count, 2))
        rate_hz = RATE_HZ * (1.0 - xy[:, 0]) + noise * rng.normal(size=count)
        shared = replace(
            nothing_shared(count),
            path_of=np.zeros(count, dtype=np.int64),
            along=TO_US[None],
            rate_hz=rate_hz,
            rate_variance=np.full(count, noise**2),
            turn_rad_s=turn[None],
        )
        states = TrackStates(
            xy=xy,
            abc_hz=rate_hz[:, None] * TO_US + np.cross(turn, np.column_stack([xy, np.ones(count)])),
            cov=np.tile(noise**2 * np.outer(TO_US, TO_US) + 1e-9 * np.eye(3), (count, 1, 1)),
            sigma_norm=np.full(count, 1e-4),
            direction=np.tile(TO_US, (count, 1)),
            status=np.zeros(count, dtype=np.int64),
            shared=shared,
        )
        members = TrackSets.of([np.arange(count)])
        joint = joint_states(members, TO_US[None], np.array([False]), states, FOCAL_PX * xy, 80.0)
        x, y = joint.ref_px[0] / FOCAL_PX
        there = RATE_HZ * (1.0 - x) * TO_US + np.cross(turn, [x, y, 1.0])
        off_hz.append((joint.abc_hz[0] - there) @ TO_US)
        off_rad.append(np.linalg.norm(np.cross(joint.abc_hz[0], there)) / there.dot(there))
        assert x < -0.12
    assert abs(np.mean(off_hz)) < 0.02 * RATE_HZ
    assert np.median(off_rad) < 0.02


def test_a_mean_over_a_path_and_over_tracks_timed_by_expansion_varies_as_the_plain_formula_says():
    """On a thing that turns a little, with errors of all kinds."""
    rng, count = np.random.default_rng(92), 12
    root = 0.02 * rng.normal(size=(1, N_SHARED, N_SHARED))
    shared = SharedErrors(
        path_of=np.where(np.arange(count) < 9, 0, -1),
        along=TO_US[None],
        rate_hz=np.full(count, RATE_HZ),
        rate_variance=rng.uniform(1e-4, 2e-4, count),
        jacobian=rng.normal(size=(count, 3, N_SHARED)),
        cov=root @ np.swapaxes(root, 1, 2),
        turn_rad_s=np.array([[0.01, -0.03, 0.02]]),
    )
    spread = 0.02 * rng.normal(size=(count, 3, 3))
    states = TrackStates(
        xy=np.tile(rng.uniform(-0.01, 0.01, 2), (count, 1)) + 1e-3 * rng.normal(size=(count, 2)),
        abc_hz=RATE_HZ * TO_US + 0.01 * rng.normal(size=(count, 3)),
        cov=spread @ np.swapaxes(spread, 1, 2) + 1e-4 * np.eye(3),
        sigma_norm=np.full(count, 1e-4),
        direction=np.tile(TO_US, (count, 1)),
        status=np.zeros(count, dtype=np.int64),
        shared=shared,
    )
    members, xy_px = TrackSets.of([np.arange(count)]), FOCAL_PX * states.xy
    joint = joint_states(members, TO_US[None], np.array([False]), states, xy_px, LINK_PX)
    weight = 1.0 / states.cov[:, 2, 2]
    weight /= weight.sum()
    mean = weight @ states.abc_hz
    np.testing.assert_allclose(joint.abc_hz, [mean], rtol=1e-12)
    np.testing.assert_allclose(joint.ref_px, [weight @ xy_px], rtol=1e-12)
    on, off = weight[:9], weight[9:]
    by_shared = np.einsum("n,nij->ij", on, shared.jacobian[:9])
    cov = 1.35 * np.sum(on**2 * shared.rate_variance[:9]) * np.outer(TO_US, TO_US)
    cov += by_shared @ shared.cov[0] @ by_shared.T
    cov += off.sum() ** 2 / np.sum(off**2) * np.einsum("n,nij->ij", off**2, states.cov[9:])
    offset = np.column_stack([states.xy - weight @ states.xy, np.zeros(count)])
    np.testing.assert_allclose(joint.ref_sigma, [np.linalg.norm(weight[:, None] * offset[:, :2], axis=0)], rtol=1e-9)
    by_place = np.cross(shared.turn_rad_s[0], offset)
    place_cov = 3.0 * np.einsum("n,ni,nj->ij", weight, by_place, by_place)
    np.testing.assert_allclose(joint.cov, [cov + place_cov], rtol=1e-9)


def test_all_of_a_rear_is_its_nearest_surface_whatever_slope_noise_lends_it():
    rng = np.random.default_rng(94)
    for _ in range(40):
        states = states_on_one_path()
        rate_hz = RATE_HZ * (1.0 + OWN_PART * rng.normal(size=N))
        states = replace(states, shared=replace(states.shared, rate_hz=rate_hz))
        members, xy_px = TrackSets.of([np.arange(N)]), FOCAL_PX * states.xy
        joint = joint_states(members, AHEAD[None], np.array([False]), states, xy_px, LINK_PX)
        assert np.linalg.norm(joint.ref_px[0] - xy_px.mean(axis=0)) < 0.2 * np.linalg.norm(np.std(xy_px, axis=0))


def test_the_time_of_a_bicycle_ahead_is_that_of_its_end_not_of_its_middle():
    """1.8 m long and 15 m away, its points are at all depths alike: those within a foot or so are hit first."""
    depth_m = 15.0 + 1.8 * np.random.default_rng(95).permutation(N) / (N - 1)
    true_hz, own_hz = 1.0 / depth_m[depth_m < np.quantile(depth_m, 0.1) + 0.15].mean(), 1e-4
    states = states_on_one_path()
    shared = replace(states.shared, rate_hz=1.0 / depth_m, rate_variance=np.full(N, own_hz**2))
    abc_hz, cov = AHEAD / depth_m[:, None], np.tile(own_hz**2 * np.eye(3), (N, 1, 1))
    states = replace(states, abc_hz=abc_hz, cov=cov, shared=shared)
    members, xy_px = TrackSets.of([np.arange(N)]), FOCAL_PX * states.xy
    joint = joint_states(members, AHEAD[None], np.array([False]), states, xy_px, LINK_PX)
    assert -joint.abc_hz[0, 2] / true_hz == pytest.approx(1.0, abs=0.015)
