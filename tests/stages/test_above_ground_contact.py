"""What stands above the part of a thing that would lie under the road belongs to it; other far things do not."""

import numpy as np
import pytest
from relative_motion import CAMERA, FOCAL_PX
from rigid_worlds import LINK_PX, bodies_of, car
from test_ground_contact import CAMERA_M, SLOPE_HZ, SPEED_M_S, road, street, without_hidden

from ttcvid.geometry.estimation.rigid_motion import PathFit
from ttcvid.stages.segmentation.above_ground_contact import above_under

SIGMA_HZ, MOST_SIGMA_HZ = 0.002, 0.02


def rear(top_m=1.6, x_m=(-0.9, 0.9), depth_m=20.0, n=12):
    """The rear of what is ahead of us, from its bumper up."""
    x, h = np.meshgrid(np.linspace(*x_m, n), np.linspace(0.3, top_m, n))
    return np.column_stack([x.ravel(), CAMERA_M - h.ravel(), np.full(x.size, depth_m)])


def far_points(x_m, height_m, depth_m=2000.0, n=40):
    """Points of a ridge far away."""
    return np.column_stack([np.linspace(*x_m, n), np.full(n, -height_m), np.full(n, depth_m)])


def above_of(*things, rate_hz, sigma_hz=SIGMA_HZ):
    """Which points of things over a road are above what would lie under it, thing by thing.

    `rate_hz` of each thing on the path of the scene, None: it stands still.
    """
    things = (without_hidden(road(), things[0]), *things)
    position = np.concatenate(things)
    given = [
        SPEED_M_S / t[:, 2] if r is None else np.full(len(t), r) for t, r in zip(things, (None, *rate_hz), strict=True)
    ]
    rate, place, n = np.concatenate(given), position[:, :2] / position[:, 2:], len(position)
    road_hz = np.where(place[:, 1] > 0.03, SLOPE_HZ * place[:, 1], np.nan)
    fit = PathFit(place, rate, np.full(n, sigma_hz), np.ones(n), np.full(n, 10))
    xy_px = place * FOCAL_PX + (CAMERA.cx_px, CAMERA.cy_px)
    is_under = rate < 0.7 * road_hz
    found = above_under(xy_px, LINK_PX, fit, np.zeros(n, dtype=int), is_under, road_hz, MOST_SIGMA_HZ)
    assert not (found & np.isfinite(road_hz)).any()
    return np.split(found, np.cumsum([len(t) for t in things])[:-1])[1:], np.isnan(road_hz)[
        -sum(map(len, things[1:])) :
    ]


@pytest.mark.parametrize("rate_hz", [0.0, 0.05])
@pytest.mark.parametrize("top_m", [1.6, 3.5])
def test_windows_and_roof_of_what_goes_our_way_belong_to_its_bumper(rate_hz, top_m):
    (found,), has_no_road = above_of(rear(top_m), rate_hz=[rate_hz])
    assert has_no_road.any()
    np.testing.assert_array_equal(found, has_no_road)


def test_houses_far_behind_it_do_not():
    (_, house), _ = above_of(rear(), far_points((-20.0, 20.0), 3.0, 100.0), rate_hz=[0.0, None])
    assert not house.any()


def test_a_ridge_at_the_horizon_that_goes_on_to_the_sides_does_not_and_nothing_is_said_of_the_roof():
    found, _ = above_of(rear(), far_points((-600.0, 600.0), 40.0), rate_hz=[0.0, 0.0])
    assert not np.concatenate(found).any()


def test_what_stands_on_the_road_has_no_such_part():
    parked = rear(x_m=(-4.0, -2.2), depth_m=12.0)
    (found,), _ = above_of(parked, rate_hz=[None])
    assert not found.any()


def test_rates_that_are_not_known_say_nothing():
    (found,), _ = above_of(rear(), rate_hz=[0.0], sigma_hz=2.0 * MOST_SIGMA_HZ)
    assert not found.any()


@pytest.mark.parametrize("seed", [1, 2, 4, 5])
def test_a_car_ahead_as_fast_as_we_are_is_one_mover_up_to_its_roof_and_takes_nothing_of_the_road(seed):
    rng = np.random.default_rng(seed)
    ahead = car(rng, (0.0, CAMERA_M - 0.95, 18.0), (0.0, 0.0, SPEED_M_S), n=40, size_m=(1.8, 1.4, 0.5))
    frames = bodies_of(street(rng, 40, ahead), 40, (0.0, 0.0, SPEED_M_S), opaque=True)
    later = frames[15:]
    keys = {frame.keys_of(1)[0] for frame in later}
    assert len(keys) == 1
    assert 0 not in keys
    assert np.median([frame.keys_of(1)[1] for frame in later]) >= 0.9
    assert max(np.count_nonzero(frame.key[frame.truth == 0] != 0) for frame in frames) <= 5
