"""Groups of one relative motion: found, told apart, and not made of chance."""

import numpy as np
import pytest
from relative_motion import CAMERA, FOCAL_PX, box_of_points, flows_of, joined, pixels, unit

from ttcvid.config import MotionGroupsConfig
from ttcvid.geometry.epipole import epipole_maximum_likelihood
from ttcvid.geometry.rotation import normalize, tangent_basis
from ttcvid.stages.flows import Flows
from ttcvid.stages.motion_groups import FormerGroup, find_motion_groups

LINK_PX = 0.05 * CAMERA.image_size.width_px
CAR_M = (2.4, 1.4, 1.0)
# Centre in m, relative velocity in m/s.
LEFT, RIGHT, FAR = ((-6, 0.5, 18), (5, 0, -4)), ((5, 0.5, 16), (-6, 0, 1)), ((0.5, -3, 25), (0, 2, -8))


def movers(rng, *centre_and_velocity, n=30, sigma_px=0.2, noisy=True):
    """Flows, places and true group (N,) of boxes of points."""
    flows, xy_px = [], []
    for centre, velocity in centre_and_velocity:
        position = box_of_points(rng, n, centre, CAR_M)
        flows.append(flows_of(position, np.asarray(velocity, float), sigma_px=sigma_px, rng=rng if noisy else None))
        xy_px.append(pixels(position))
    return joined(*flows), np.concatenate(xy_px), np.repeat(np.arange(len(flows)), n)


def found(flows, xy_px, former=(), seed=0, is_candidate=None, config=None):
    is_candidate = np.ones(len(xy_px), dtype=bool) if is_candidate is None else is_candidate
    rng = np.random.default_rng([seed, 7])
    return find_motion_groups(flows, xy_px, is_candidate, LINK_PX, list(former), rng, config or MotionGroupsConfig())


def random_flows(rng, n, shortest_px=2.0, longest_px=12.0, sigma_px=0.2):
    """Flows of random place, length and orientation, and their places in px."""
    xy_px = rng.uniform([150, 80], [490, 280], (n, 2))
    ray = normalize(np.column_stack([(xy_px - (CAMERA.cx_px, CAMERA.cy_px)) / FOCAL_PX, np.ones(n)]))
    angle, length = rng.uniform(0, 2 * np.pi, n), rng.uniform(shortest_px, longest_px, n) / FOCAL_PX
    flow = np.einsum("nij,nj->ni", tangent_basis(ray), np.column_stack([np.cos(angle), np.sin(angle)]))
    first = normalize(ray - length[:, None] * flow)
    return Flows(first, ray, np.full(n, 4), np.full(n, 0.4), np.full(n, sigma_px / FOCAL_PX), np.zeros(n)), xy_px


def matched(groups, truth):
    """Group that holds most of each true group's tracks, with the part that it holds."""
    held = np.array([[np.isin(np.flatnonzero(truth == k), g.members).mean() for g in groups] for k in np.unique(truth)])
    return held.argmax(axis=1), held.max(axis=1)


@pytest.mark.parametrize("things", [(LEFT,), (LEFT, RIGHT), (LEFT, RIGHT, FAR)])
def test_each_mover_is_a_group_of_its_own_tracks(things):
    trials, right_number, parts = 40, 0, []
    for trial in range(trials):
        flows, xy_px, truth = movers(np.random.default_rng([21, trial]), *things)
        groups = found(flows, xy_px, seed=trial)
        right_number += len(groups) == len(things)
        owner, part = matched(groups, truth)
        parts.extend(part)
        assert len(set(owner)) == len(things)
        assert all(len(np.unique(truth[group.members])) == 1 for group in groups)
    # A box of 30 random points falls apart now and then: its connection may hang on a track outside the gate.
    assert right_number >= 0.9 * trials
    assert np.mean(parts) >= 0.96


def test_direction_is_as_good_as_if_the_tracks_of_each_mover_were_known():
    found_square, known_square = [], []
    for trial in range(60):
        flows, xy_px, truth = movers(np.random.default_rng([5, trial]), LEFT, RIGHT)
        groups = found(flows, xy_px, seed=trial)
        owner, _ = matched(groups, truth)
        for k, (_, velocity) in enumerate((LEFT, RIGHT)):
            own = flows.take(truth == k)
            known, *_ = epipole_maximum_likelihood(own.first, own.second, own.sigma_rad)
            found_square.append(np.sum((groups[owner[k]].direction - unit(velocity)) ** 2))
            known_square.append(np.sum((known - unit(velocity)) ** 2))
    assert np.sqrt(np.mean(found_square)) < 1.2 * np.sqrt(np.mean(known_square))


def test_direction_is_exact_on_exact_flows():
    flows, xy_px, _ = movers(np.random.default_rng(22), LEFT, noisy=False)
    (group,) = found(flows, xy_px)
    np.testing.assert_array_equal(np.sort(group.members), np.arange(30))
    np.testing.assert_allclose(group.direction, unit(LEFT[1]), atol=1e-7)


def test_direction_is_off_by_what_its_covariance_says():
    rng = np.random.default_rng(23)
    square = []
    for trial in range(60):
        flows, xy_px, _ = movers(rng, LEFT)
        groups = found(flows, xy_px, seed=trial)
        group = max(groups, key=lambda g: len(g.members))
        basis = tangent_basis(unit(LEFT[1]))
        off = basis.T @ group.direction
        square.append(off @ np.linalg.solve(basis.T @ group.direction_cov @ basis, off))
    # The gate cuts the tails of the flows off: a mean of two degrees of freedom, or a little more.
    assert 1.2 < np.mean(square) < 3.0


def test_tracks_of_a_group_are_found_with_the_probability_of_the_gate():
    rng = np.random.default_rng(24)
    parts = []
    for trial in range(30):
        flows, xy_px, truth = movers(rng, LEFT, RIGHT, n=40)
        parts.append(matched(found(flows, xy_px, seed=trial), truth)[1].mean())
    assert np.mean(parts) > 0.95


def test_order_of_tracks_does_not_matter():
    rng = np.random.default_rng(25)
    flows, xy_px, _ = movers(rng, LEFT, RIGHT, FAR)
    expected = {frozenset(g.members.tolist()) for g in found(flows, xy_px)}
    assert len(expected) == 3
    for trial in range(5):
        order = rng.permutation(len(xy_px))
        groups = found(flows.take(order), xy_px[order], seed=trial)
        assert {frozenset(order[g.members].tolist()) for g in groups} == expected


def test_two_cars_with_one_epipole_in_different_places_are_two_groups():
    velocity = (1.0, 0.0, -8.0)
    rng = np.random.default_rng(26)
    for trial in range(5):
        flows, xy_px, truth = movers(rng, ((-5, 0.5, 18), velocity), ((5, 0.5, 18), velocity), sigma_px=0.1)
        groups = found(flows, xy_px, seed=trial)
        assert len(groups) == 2
        assert all(len(np.unique(truth[g.members])) == 1 for g in groups)


def test_two_cars_with_one_epipole_side_by_side_but_with_different_times_are_two_groups():
    rng = np.random.default_rng(27)
    for trial in range(5):
        near, far = ((-2.2, 0.5, 15), (0.6, 0.0, -6.0)), ((2.5, 0.5, 30), (0.3, 0.0, -3.0))
        flows, xy_px, truth = movers(rng, near, far, n=40, sigma_px=0.1)
        groups = found(flows, xy_px, seed=trial)
        assert len(groups) == 2
        assert all(np.mean(truth[g.members] == truth[g.members[0]]) > 0.95 for g in groups)


def test_two_cars_that_touch_in_the_picture_but_move_differently_are_two_groups():
    for trial in range(20):
        one, other = ((-1.6, 0.5, 16), (4.0, 0.0, -5.0)), ((1.6, 0.5, 16), (1.5, 0.0, -6.0))
        flows, xy_px, truth = movers(np.random.default_rng([35, trial]), one, other, n=40)
        owner, part = matched(found(flows, xy_px, seed=trial), truth)
        assert len(set(owner)) == 2
        assert part.min() > 0.8


@pytest.mark.parametrize(("n", "shortest_px"), [(6, 2.0), (25, 2.0), (80, 1.0), (80, 6.0)])
def test_chance_alone_makes_a_group_in_at_most_one_frame_of_twenty(n, shortest_px):
    rng = np.random.default_rng([28, n])
    trials = 120
    with_group = sum(bool(found(*random_flows(rng, n, shortest_px=shortest_px), seed=trial)) for trial in range(trials))
    assert with_group <= 0.05 * trials


def test_three_exact_tracks_make_a_group_and_two_do_not():
    position = np.array([[-3.0, 0.5, 18.0], [-2.6, 0.9, 18.5], [-2.8, 0.3, 17.5]])
    velocity = np.array([4.0, 0.5, -3.0])
    (group,) = found(flows_of(position, velocity, sigma_px=0.02), pixels(position))
    np.testing.assert_array_equal(group.members, [0, 1, 2])
    np.testing.assert_allclose(group.direction, unit(velocity), atol=1e-6)
    assert found(flows_of(position[:2], velocity, sigma_px=0.02), pixels(position[:2])) == []


def test_a_mover_is_found_among_outliers():
    n_found, off_deg = [], []
    for trial in range(30):
        rng = np.random.default_rng([29, trial])
        moving, xy_px, _ = movers(rng, LEFT)
        wild, wild_px = random_flows(rng, 40)
        groups = found(joined(moving, wild), np.concatenate([xy_px, wild_px]), seed=trial)
        best = max(groups, key=lambda g: len(g.members))
        assert np.count_nonzero(best.members >= 30) <= 4
        n_found.append(np.count_nonzero(best.members < 30))
        off_deg.append(np.degrees(np.arccos(best.direction @ unit(LEFT[1]))))
    assert np.mean(n_found) >= 27
    assert np.median(off_deg) < 1.5


def test_only_candidates_with_a_flow_become_members():
    rng = np.random.default_rng(30)
    flows, xy_px, truth = movers(rng, LEFT, RIGHT, noisy=False)
    flows.gap_frames[:5] = 0
    groups = found(flows, xy_px, is_candidate=truth == 0)
    assert [sorted(g.members.tolist()) for g in groups] == [list(range(5, 30))]


def test_a_known_group_goes_on_where_it_would_not_be_found_anew():
    """Four short flows are no evidence by themselves; with the direction of the last frame they are."""
    rng = np.random.default_rng(31)
    position = box_of_points(rng, 4, (-3, 0.5, 18), (1.0, 1.0, 0.5))
    velocity = np.array([0.2, 0.0, -0.3])
    flows, xy_px = flows_of(position, velocity, sigma_px=0.5), pixels(position)
    assert found(flows, xy_px) == []
    former = FormerGroup(np.arange(4), unit(velocity))
    (group,) = found(flows, xy_px, former=[former])
    np.testing.assert_array_equal(group.members, np.arange(4))


def test_a_known_group_does_not_keep_tracks_that_now_move_otherwise():
    rng = np.random.default_rng(32)
    flows, xy_px, truth = movers(rng, LEFT, RIGHT)
    groups = found(flows, xy_px, former=[FormerGroup(np.arange(60), unit(LEFT[1]))])
    assert len(groups) == 2
    assert all(np.mean(truth[g.members] == truth[g.members[0]]) == 1.0 for g in groups)


def test_no_more_groups_than_allowed():
    rng = np.random.default_rng(33)
    flows, xy_px, _ = movers(rng, LEFT, RIGHT, FAR)
    assert len(found(flows, xy_px, config=MotionGroupsConfig(max_groups=2))) == 2


def test_nothing_to_look_at_gives_no_group():
    flows, xy_px, truth = movers(np.random.default_rng(34), LEFT)
    assert found(flows, xy_px, is_candidate=truth < 0) == []
