"""Rate and acceleration of a depth from the sizes of pictures, against exact motions."""

import numpy as np
import pytest

from ttcvid.geometry.estimation.closing import Closing, depths_over_time, fit_braking

FOCAL_PX, FPS = 530.0, 20.0
SINCE_S = -np.arange(20)[::-1] / FPS


def depths_m(closing_m_s, braking_m_s2, range_m=16.0):
    """Depths (L,) of what closes in by now with a speed and an acceleration, and has done so for all views."""
    return range_m - closing_m_s * SINCE_S - 0.5 * braking_m_s2 * SINCE_S**2


def views(depth_m, rng, n=40, noise_px=0.0, drift_px=0.0):
    """Places (L, n, 2) of points of a car's rear that also moves to the side; sizes err by a random walk.

    ``drift_px`` is its standard deviation after 0.6 s, at the root mean square radius.
    """
    rear = rng.uniform([-0.85, -0.7], [0.85, 0.7], (n, 2))
    offset = np.stack([1.0 + 0.4 * SINCE_S, np.full(len(SINCE_S), 0.9)], axis=1)
    xy = (rear[None] + offset[:, None]) / depth_m[:, None, None]
    middle = xy.mean(axis=1, keepdims=True)
    radius_px = FOCAL_PX * np.sqrt(np.mean(np.sum((xy[-1] - middle[-1]) ** 2, axis=1)))
    walk = np.cumsum(rng.normal(0.0, drift_px / radius_px / np.sqrt(0.6 * FPS), len(xy)))
    return middle + (xy - middle) * (1.0 + walk[:, None, None]) + rng.normal(0.0, noise_px / FOCAL_PX, xy.shape)


def closing_of(xy, drift_px=0.25):
    """What is found from all views of one thing that has accelerated in all of them."""
    return braking_of(xy, drift_px, np.inf)


@pytest.mark.parametrize(("closing_m_s", "braking_m_s2"), [(2.0, 5.0), (0.0, 5.0), (6.0, 0.0), (6.0, -3.0)])
def test_exact_views_give_rate_and_acceleration_exactly(closing_m_s, braking_m_s2):
    found = closing_of(views(depths_m(closing_m_s, braking_m_s2), np.random.default_rng(1)))
    assert found.rate_hz == pytest.approx(-closing_m_s / 16.0, abs=1e-9)
    assert found.acceleration_hz2 == pytest.approx(-braking_m_s2 / 16.0, abs=1e-9)


def test_tracks_of_the_road_before_a_car_do_not_count():
    rng = np.random.default_rng(2)
    car, road = views(depths_m(2.0, 5.0), rng), views(depths_m(12.0, 0.0), rng, n=9)
    found = closing_of(np.concatenate([car, road + np.array([0.0, 0.06])], axis=1))
    assert found.acceleration_hz2 == pytest.approx(-5.0 / 16.0, abs=0.01)


def test_gaps_are_no_views():
    xy = views(depths_m(2.0, 5.0), np.random.default_rng(3))
    xy[:7, ::2] = np.nan
    xy[10] = np.nan
    depth, variance, _ = depths_over_time(xy)
    assert np.flatnonzero(np.isnan(depth)).tolist() == [10]
    assert fit_braking(depth, variance, SINCE_S, 1e-4, np.inf).acceleration_hz2 == pytest.approx(-5.0 / 16.0, abs=1e-9)


@pytest.mark.parametrize("drift_px", [0.0, 0.25])
def test_noise_is_taken_for_an_acceleration_as_seldom_as_stated(drift_px):
    rng = np.random.default_rng(4)
    found = [closing_of(views(depths_m(2.0, 0.0), rng, noise_px=0.15, drift_px=drift_px)) for _ in range(400)]
    sigmas = np.array([one.acceleration_hz2 / one.acceleration_sigma_hz2 for one in found])
    assert np.mean(sigmas < -2.326) < 0.025
    assert np.std(sigmas) < 1.15


def test_an_acceleration_within_its_noise_is_covered():
    rng = np.random.default_rng(5)
    found = [closing_of(views(depths_m(2.0, 3.0), rng, noise_px=0.15, drift_px=0.25)) for _ in range(400)]
    off = [(one.acceleration_hz2 + 3.0 / 16.0) / one.acceleration_sigma_hz2 for one in found]
    assert 0.86 < np.mean(np.abs(off) < 1.645) < 0.96


def begun_m(began_s, closing_m_s=0.5, braking_m_s2=5.0, range_m=16.0):
    """Depths (L,) of what closed in steadily until it began to brake, and is at the range by now."""
    for_s = np.maximum(SINCE_S - began_s, 0.0)
    return range_m - closing_m_s * SINCE_S - 0.5 * braking_m_s2 * (for_s**2 - began_s**2)


def braking_of(xy, drift_px=0.125, least_s=0.25):
    """What is found from all views of one thing that may have begun to brake so long ago or longer."""
    depth, variance, radius = depths_over_time(xy)
    return fit_braking(depth, variance, SINCE_S, (drift_px / (FOCAL_PX * radius)) ** 2 / 0.6, least_s)


@pytest.mark.parametrize("began_s", [-0.25, -0.4, -0.7])
def test_of_who_has_begun_to_brake_the_present_rate_and_acceleration_are_found_exactly(began_s):
    found = braking_of(views(begun_m(began_s), np.random.default_rng(1)))
    assert found.rate_hz == pytest.approx((-0.5 + 5.0 * began_s) / 16.0, abs=1e-9)
    assert found.acceleration_hz2 == pytest.approx(-5.0 / 16.0, abs=1e-9)


def test_who_has_braked_for_all_views_is_found_as_if_nothing_had_begun():
    xy = views(depths_m(2.0, 5.0), np.random.default_rng(1))
    depth, variance, _ = depths_over_time(xy)
    whole, begun = (fit_braking(depth, variance, SINCE_S, 1e-5, least_s) for least_s in (np.inf, 0.25))
    assert begun.rate_hz == pytest.approx(whole.rate_hz, rel=1e-6)
    assert begun.acceleration_hz2 == pytest.approx(whole.acceleration_hz2, rel=1e-6)
    assert begun.cov == pytest.approx(whole.cov, rel=1e-6)


def test_what_began_later_than_asked_for_is_not_looked_for():
    """A single view that is off by a quarter of a pixel would be a brake as hard as none is."""
    xy = views(depths_m(0.0, 0.0), np.random.default_rng(2), noise_px=0.02)
    xy[-1] = xy[-1].mean(axis=0) + (xy[-1] - xy[-1].mean(axis=0)) * 1.01
    at_once, lasting = braking_of(xy, least_s=0.0), braking_of(xy, least_s=0.25)
    assert at_once.acceleration_hz2 < 2.0 * lasting.acceleration_hz2 < 0.0


def test_brakes_are_told_earlier_by_when_they_began():
    rng = np.random.default_rng(7)
    xy = [views(begun_m(-0.35, closing_m_s=0.0), rng, noise_px=0.1, drift_px=0.06) for _ in range(50)]
    begun = [-one.acceleration_hz2 / one.acceleration_sigma_hz2 - 0.35 for one in map(braking_of, xy)]
    whole = [-one.acceleration_hz2 / one.acceleration_sigma_hz2 for one in (closing_of(one, 0.125) for one in xy)]
    assert np.median(begun) > np.median(whole)
    # 1 s on, the steady way is still ahead; at constant acceleration over all views it seems slower by half.
    rates = np.array([[braking_of(one).rate_hz, closing_of(one, 0.125).rate_hz] for one in xy])
    assert np.median(rates, axis=0) == pytest.approx([-0.35 * 5.0 / 16.0, -0.07], abs=0.02)


@pytest.mark.parametrize("noise_px", [0.02, 0.15, 0.5])
def test_looking_for_when_it_began_makes_noise_as_sure_as_stated(noise_px):
    """Less than 0.35 standard deviations more, at 99 % and at 95 %."""
    rng = np.random.default_rng(8)
    found = [braking_of(views(depths_m(2.0, 0.0), rng, noise_px=noise_px, drift_px=0.125)) for _ in range(300)]
    sigmas = np.array([one.acceleration_hz2 / one.acceleration_sigma_hz2 for one in found])
    assert np.mean(sigmas < -(2.326 + 0.35)) < 0.02
    assert np.mean(sigmas < -(1.645 + 0.35)) < 0.07


def test_too_few_views_or_points_tell_nothing():
    xy = views(depths_m(2.0, 5.0), np.random.default_rng(6))
    few = xy.copy()
    few[:15] = np.nan
    assert closing_of(few) is None
    assert braking_of(few) is None
    depth, _, radius = depths_over_time(xy[:, :2])
    assert np.isnan(depth).sum() == len(SINCE_S) - 1
    assert radius == 0.0


@pytest.mark.parametrize(("rate_hz", "acceleration_hz2"), [(-0.5, 0.0), (-0.2, -0.3), (0.1, -0.4), (-0.5, 0.1)])
@pytest.mark.parametrize("lasting_s", [0.5, 1.0, 9.0])
def test_what_is_left_is_what_the_speed_takes_while_the_acceleration_lasts_and_after(
    rate_hz, acceleration_hz2, lasting_s
):
    one = Closing(rate_hz, acceleration_hz2, np.diag([0.02, 0.05]) ** 2)
    # In the middle of each of so many equal pieces of 2 s.
    speed_hz = rate_hz + acceleration_hz2 * np.minimum((np.arange(1000) + 0.5) * 0.002, lasting_s)
    left, sigma = one.left_after(2.0, lasting_s)
    assert left == pytest.approx(1.0 + 2.0 * speed_hz.mean(), abs=1e-6)
    # It errs as by moving the rate, and the acceleration, each by its standard deviation.
    moved = [
        Closing(rate_hz + by_rate, acceleration_hz2 + by_acceleration, np.eye(2)).left_after(2.0, lasting_s)[0] - left
        for by_rate, by_acceleration in ((0.02, 0.0), (0.0, 0.05))
    ]
    assert sigma == pytest.approx(np.hypot(*moved))
