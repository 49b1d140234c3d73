"""The nearest part of a surface that slopes away from us: the plane's nearest tenth, not the luckiest of its tracks."""

import numpy as np
import pytest

from ttcvid.stages.objects.slant import nearest_parts
from ttcvid.stages.tracking.groups import TrackSets

NO_ERRORS = np.zeros((1, 2, 2))


def one_set(n):
    return TrackSets.of([np.arange(n)])


def parts(rate_hz, sigma_hz, xy, needed, is_in=None, by_shared=None, shared_cov=NO_ERRORS, own_hz=None, turns=False):
    n = len(rate_hz)
    is_in = np.ones(n, dtype=bool) if is_in is None else is_in
    by_shared = np.zeros((n, 2)) if by_shared is None else by_shared
    own_hz = sigma_hz if own_hz is None else own_hz
    turning = np.array([turns])
    return nearest_parts(
        one_set(n), rate_hz, own_hz, sigma_hz, by_shared, shared_cov, xy, np.array([needed]), is_in, turning
    )


def places(rng, n):
    return rng.uniform(-0.2, 0.2, (n, 2))


def sloping(xy, slope=0.5):
    """Rates of a wall whose left end is nearer, 0.2 Hz in its middle."""
    return 0.2 * (1.0 - slope * xy[:, 0] / 0.2)


def test_of_a_sloping_wall_the_nearest_tenth_is_kept():
    rng = np.random.default_rng(1)
    xy = places(rng, 100)
    rate_hz = sloping(xy)
    is_near, above_hz, variance, centre = parts(rate_hz, np.full(100, 0.002), xy, 10)
    tenth = sloping(np.array([[-0.16, 0.0]]))[0]
    assert is_near[rate_hz >= tenth].all()
    assert not is_near[rate_hz < 0.985 * tenth].any()
    np.testing.assert_allclose((rate_hz + above_hz)[is_near], sloping(centre)[0], atol=0.002)
    assert 0.0 < variance[0] < 0.002**2


def test_the_nearest_tenth_is_one_of_the_picture_however_tracks_crowd_elsewhere():
    """Of a bus that leaves the picture, the nearest end has few tracks."""
    rng = np.random.default_rng(3)
    xy = np.concatenate([places(rng, 40), rng.uniform([0.0, -0.2], [0.2, 0.2], (160, 2))])
    rate_hz = sloping(xy)
    is_near, *_ = parts(rate_hz, np.full(200, 0.002), xy, 20)
    assert xy[is_near, 0].max() < -0.15
    assert xy[is_near, 0].mean() == pytest.approx(-0.18, abs=0.01)


def test_the_place_of_the_nearest_part_is_its_middle_wherever_in_it_the_tracks_are():
    rng = np.random.default_rng(15)
    top = rng.uniform([-0.2, -0.2], [-0.15, -0.1], (30, 2))
    xy = np.concatenate([[[-0.2, -0.2], [-0.2, 0.2]], top, rng.uniform([-0.1, -0.2], [0.2, 0.2], (60, 2))])
    is_near, _, _, centre = parts(sloping(xy), np.full(len(xy), 0.002), xy, 10)
    np.testing.assert_allclose(centre[0], [-0.175, 0.0], atol=0.01)
    assert xy[is_near, 1].mean() < -0.1


def test_a_wall_parallel_to_the_picture_is_hardly_nearer_than_it_is():
    """What noise makes of its slope is less than what it makes of its rate, and mostly nothing."""
    rng = np.random.default_rng(2)
    kept, too_high = 0, []
    for _ in range(300):
        rate_hz = 0.2 + 0.01 * rng.standard_normal(40)
        is_near, above_hz, *_ = parts(rate_hz, np.full(40, 0.01), places(rng, 40), 5)
        kept += is_near.all() and not above_hz.any()
        too_high.append((rate_hz + above_hz)[is_near].mean() - 0.2)
    assert kept > 150
    assert np.mean(too_high) < 0.01 / np.sqrt(40)


def test_the_rear_of_a_car_at_an_angle_slopes_by_less_than_other_rears_are_not_flat_by():
    rng = np.random.default_rng(9)
    xy = places(rng, 20)
    rate_hz = sloping(xy, slope=0.025) + 0.001 * rng.standard_normal(20)
    is_near, above_hz, *_ = parts(rate_hz, np.full(20, 0.005), xy, 5, own_hz=np.full(20, 0.001))
    assert not is_near[xy[:, 0] > 0.0].any()
    assert (rate_hz + above_hz)[is_near].mean() == pytest.approx(sloping(xy, 0.025)[is_near].mean(), abs=0.001)


def test_of_two_sides_that_meet_at_an_edge_the_nearest_part_is_at_the_edge():
    """A bus that turns shows its flank and its front: a plane through both would put the front's far end nearest."""
    rng = np.random.default_rng(12)
    place_errors, rate_errors = [], []
    for _ in range(100):
        xy = places(rng, 120)
        x = xy[:, 0]
        # The edge, at x = 0.1, is nearest: 0.2 Hz. The flank falls off to the left, the front faster to the right.
        true_hz = 0.2 * np.where(x < 0.1, 1.0 + 0.4 * (x - 0.1), 1.0 - 0.8 * (x - 0.1))
        rate_hz = true_hz + 0.0002 * rng.standard_normal(120)
        is_near, above_hz, *_ = parts(rate_hz, 0.025 * rate_hz, xy, 12, own_hz=np.full(120, 0.0002))
        tenth = np.sort(true_hz)[-12] * 0.99
        place_errors.append(x[is_near].mean() - x[true_hz >= tenth].mean())
        rate_errors.append((rate_hz + above_hz)[is_near].mean() / true_hz[is_near].mean() - 1.0)
    # With one plane through both sides: 0.053 and 1.8 %.
    assert abs(np.mean(place_errors)) < 0.02
    assert abs(np.mean(rate_errors)) < 0.005


def test_a_plane_that_too_few_tracks_lie_on_is_none():
    """Of two sides in all positions: a rate of the nearest part is a number, whatever the tracks are."""
    rng = np.random.default_rng(14)
    for _ in range(3000):
        n = int(rng.integers(6, 30))
        xy = places(rng, n)
        x = xy[:, 0] - rng.uniform(-0.15, 0.15)
        rate_hz = 0.2 * np.where(x < 0.0, 1.0 + rng.uniform(0, 2) * x, 1.0 - rng.uniform(0, 3) * x)
        own_hz = rng.uniform(0.0001, 0.02)
        rate_hz += own_hz * rng.standard_normal(n)
        sigma_hz = np.hypot(own_hz, 0.025 * np.abs(rate_hz))
        needed = int(rng.integers(4, max(5, 2 * n // 3)))
        _, above_hz, variance, _ = parts(rate_hz, sigma_hz, xy, needed, own_hz=np.full(n, own_hz))
        assert np.isfinite(above_hz).all()
        assert np.isfinite(variance).all()


@pytest.mark.parametrize("sigma_hz", [0.002, 0.01, 0.02])
def test_the_rate_of_the_nearest_part_is_not_that_of_its_luckiest_tracks(sigma_hz):
    rng = np.random.default_rng(3)
    errors = []
    for _ in range(200):
        xy = places(rng, 80)
        true_hz = sloping(xy)
        rate_hz = true_hz + sigma_hz * rng.standard_normal(80)
        is_near, above_hz, variance, centre = parts(rate_hz, np.full(80, sigma_hz), xy, 8)
        errors.append(((rate_hz + above_hz)[is_near].mean() - sloping(centre)[0]) / np.sqrt(variance[0]))
    assert abs(np.mean(errors)) < 0.4
    assert 0.7 < np.std(errors) < 1.3


def test_the_rest_of_a_wall_is_found_where_only_a_part_of_it_was_taken_for_the_surface():
    rng = np.random.default_rng(4)
    xy = places(rng, 200)
    rate_hz, is_in = sloping(xy), np.abs(xy[:, 0]) < 0.05
    is_near, *_ = parts(rate_hz, np.full(200, 0.002), xy, 20, is_in)
    assert xy[is_near, 0].max() < -0.15


def test_what_lies_off_the_plane_of_a_wall_is_no_part_of_it():
    rng = np.random.default_rng(5)
    xy = places(rng, 60)
    rate_hz, is_in = sloping(xy), np.arange(60) >= 10
    rate_hz[:10] += 0.1
    is_near, *_ = parts(rate_hz, np.full(60, 0.002), xy, 6, is_in)
    assert is_near.any()
    assert not is_near[:10].any()


def test_a_slope_that_an_error_of_all_tracks_may_be_is_none():
    rng = np.random.default_rng(6)
    xy = places(rng, 60)
    rate_hz, sigma_hz = sloping(xy, slope=0.1), np.full(60, 0.002)
    by_shared = np.column_stack([np.zeros(60), xy[:, 0]])
    shared_cov = np.diag([0.0, 0.1**2])[None]
    assert not parts(rate_hz, sigma_hz, xy, 6)[0].all()
    is_near, above_hz, *_ = parts(rate_hz, sigma_hz, xy, 6, None, by_shared, shared_cov)
    assert is_near.all()
    assert not above_hz.any()


def test_the_side_of_what_turns_keeps_its_slope_though_a_wrong_turn_would_look_like_some_of_it():
    """Sides of cars at angles of up to 45 deg; a turn that is a little off slopes all rates by 0.1 of themselves."""
    rng = np.random.default_rng(16)
    errors = {False: [], True: []}
    for _ in range(300):
        xy = places(rng, 30)
        by_shared = np.column_stack([np.zeros(30), 0.2 * xy[:, 0]])
        shared_cov = np.diag([0.0, 0.1**2])[None]
        true_hz = 0.2 * (1.0 + np.tan(rng.uniform(-0.78, 0.78)) * xy[:, 0])
        rate_hz = true_hz + 0.1 * rng.standard_normal() * by_shared[:, 1] + 0.002 * rng.standard_normal(30)
        for turns, off in errors.items():
            is_near, *_ = parts(rate_hz, np.full(30, 0.002), xy, 5, None, by_shared, shared_cov, turns=turns)
            off.append(true_hz[is_near].mean() / np.sort(true_hz)[-6:].mean() - 1.0)
    assert np.mean(errors[False]) < -0.004
    assert abs(np.mean(errors[True])) < 0.002


@pytest.mark.parametrize("sigma_hz", [0.002, 0.01])
def test_what_is_said_of_the_nearest_part_of_what_turns_holds(sigma_hz):
    rng = np.random.default_rng(17)
    errors = []
    for _ in range(200):
        xy = places(rng, 80)
        slope = 0.1 * rng.standard_normal()
        rate_hz = sloping(xy, slope) + sigma_hz * rng.standard_normal(80)
        is_near, above_hz, variance, centre = parts(rate_hz, np.full(80, sigma_hz), xy, 8, turns=True)
        errors.append(((rate_hz + above_hz)[is_near].mean() - sloping(centre, slope)[0]) / np.sqrt(variance[0]))
    assert abs(np.mean(errors)) < 0.4
    assert 0.7 < np.std(errors) < 1.3


def test_tracks_on_a_line_tell_no_slope_across_it():
    rng = np.random.default_rng(7)
    x = rng.uniform(-0.2, 0.2, 40)
    xy = np.column_stack([x, 0.5 * x])
    is_near, *_ = parts(sloping(xy), np.full(40, 0.002), xy, 5)
    assert is_near.all()


def test_each_set_has_a_plane_of_its_own():
    rng = np.random.default_rng(8)
    xy = places(rng, 100)
    rate_hz = np.concatenate([sloping(xy[:50]), np.full(50, 0.3)])
    sets = TrackSets.of([np.arange(50), np.arange(50, 100)])
    nothing = np.zeros((100, 2)), np.zeros((2, 2, 2))
    needed = np.array([5, 5])
    is_near, _, variance, _ = nearest_parts(
        sets,
        rate_hz,
        *2 * (np.full(100, 0.002),),
        *nothing,
        xy,
        needed,
        np.ones(100, dtype=bool),
        np.zeros(2, dtype=bool),
    )
    alone, *_ = parts(rate_hz[:50], np.full(50, 0.002), xy[:50], 5)
    np.testing.assert_array_equal(is_near[:50], alone)
    assert is_near[50:].all()
    assert variance[1] == 0.0
