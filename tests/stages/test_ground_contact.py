"""What nothing bears: the road is seen where an oncoming car, taken for a static thing, would have to stand."""

import numpy as np
import pytest
from relative_motion import CAMERA, FOCAL_PX
from rigid_worlds import LINK_PX, Thing, bodies_of, car

from ttcvid.geometry.estimation.rigid_motion import PathFit
from ttcvid.stages.segmentation.ground_contact import find_floating

SPEED_M_S, CAMERA_M = 10.0, 1.4
SLOPE_HZ = SPEED_M_S / CAMERA_M


def road():
    x, z = np.meshgrid(np.linspace(-6.0, 6.0, 13), np.linspace(8.0, 40.0, 40))
    return np.column_stack([x.ravel(), np.full(x.size, CAMERA_M), z.ravel()])


def upright(height_m, depth_m, x_m, n=16):
    """Points of a surface across our way, at heights from and to, over the road."""
    x, h = np.meshgrid(np.linspace(*x_m, n), np.linspace(*height_m, n))
    return np.column_stack([x.ravel(), CAMERA_M - h.ravel(), np.full(x.size, depth_m)])


def without_hidden(ground, thing):
    """The road but for what the thing hides of it."""
    seen, box = ground[:, :2] / ground[:, 2:], thing[:, :2] / thing[:, 2:]
    return ground[~np.all((seen > box.min(axis=0)) & (seen < box.max(axis=0)), axis=1)]


def floating_of(ground, *things, closing=1.0):
    """What is found where the last thing comes ``closing`` times as fast as the static scene, and where it is."""
    position = np.concatenate([ground, *things])
    rate_hz = SPEED_M_S / position[:, 2]
    last = np.arange(len(position)) >= len(position) - len(things[-1])
    rate_hz[last] *= closing
    place, n = position[:, :2] / position[:, 2:], len(position)
    xy_px = place * FOCAL_PX + (CAMERA.cx_px, CAMERA.cy_px)
    fit = PathFit(place, rate_hz, 0.01 * rate_hz, np.ones(n), np.full(n, 10))
    road_hz = np.where(place[:, 1] > 0.03, SLOPE_HZ * place[:, 1], np.nan)
    every = np.ones(n, dtype=bool)
    return find_floating(xy_px, LINK_PX, fit, np.zeros(n, dtype=int), road_hz, SLOPE_HZ, every), last


def test_the_road_is_seen_below_a_car_that_comes_as_fast_as_we_drive():
    oncoming = upright((0.2, 1.4), 20.0, (-4.0, -2.2))
    floating, is_car = floating_of(without_hidden(road(), oncoming), oncoming, closing=2.0)
    thing = floating.thing[is_car]
    assert (thing == thing[0]).all()
    assert not floating.is_borne[is_car].any()
    assert np.count_nonzero(floating.below == thing[0]) > 5


@pytest.mark.parametrize("height_m", [(0.2, 1.4), (0.0, 6.0)])
def test_what_stands_on_the_road_is_borne_by_it(height_m):
    parked = upright(height_m, 12.0, (-4.0, -2.2))
    floating, is_car = floating_of(without_hidden(road(), parked), parked)
    assert floating.is_borne[is_car & (floating.thing >= 0)].all()
    assert (floating.below < 0).all()


def test_a_plain_wall_below_a_row_of_windows_is_no_hole():
    windows, wall = upright((0.7, 2.0), 12.0, (-6.0, -2.0)), upright((0.0, 2.0), 12.0, (-6.0, -2.0))
    floating, is_window = floating_of(without_hidden(road(), wall), windows)
    assert not floating.is_borne[is_window].any()
    assert (floating.below < 0).all()


def test_the_road_seen_beside_the_trunk_of_a_tree_below_its_crown_is_no_hole():
    trunk, crown = upright((0.6, 2.0), 12.0, (-3.2, -3.1), n=4), upright((2.0, 5.0), 12.0, (-5.0, -1.0))
    whole_trunk = upright((0.0, 2.0), 12.0, (-3.2, -3.1))
    floating, is_tree = floating_of(without_hidden(road(), whole_trunk), np.concatenate([trunk, crown]))
    assert len(np.unique(floating.thing[is_tree])) == 1
    assert (floating.below < 0).all()


def test_a_row_of_houses_is_no_thing_that_floats():
    house = [upright((0.7, 5.0), depth, (-6.0, -5.0)) for depth in np.geomspace(10.0, 30.0, 20)]
    floating, _ = floating_of(road(), np.concatenate(house))
    assert (floating.below < 0).all()


def street(rng, n_frames, *movers):
    """Road and house fronts on both sides, all that is seen between the first frame and the last."""
    far_m = 50.0 + SPEED_M_S * 0.1 * n_frames
    ground = np.column_stack([rng.uniform(-5.0, 5.0, 900), np.full(900, CAMERA_M), rng.uniform(6.0, far_m, 900)])
    sides = np.column_stack([rng.choice([-9.0, 9.0], 300), rng.uniform(-5.0, 1.0, 300), rng.uniform(9.0, far_m, 300)])
    return [Thing(np.concatenate([ground, sides])), *movers]


@pytest.mark.parametrize("seed", [5, 6, 7, 8])
def test_an_oncoming_car_in_its_own_lane_is_a_mover_that_keeps_its_key(seed):
    rng = np.random.default_rng(seed)
    oncoming = car(rng, (-3.5, CAMERA_M - 0.9, 45.0), (0.0, 0.0, -9.0), size_m=(1.8, 1.4, 4.0))
    frames = bodies_of(street(rng, 20, oncoming), 20, (0.0, 0.0, SPEED_M_S))
    # Also when it is near, grows fast, and the path that its growth shows lags behind.
    later = frames[5:]
    assert np.median([np.mean(frame.key[frame.truth == 1] == 1) for frame in later]) >= 0.6
    assert min(np.count_nonzero(frame.key[frame.truth == 1] == 1) for frame in later) >= 10
    assert max(np.count_nonzero(frame.key[frame.truth == 0] != 0) for frame in frames) <= 3


def test_a_car_that_is_parked_there_stays_with_the_scene():
    rng = np.random.default_rng(6)
    parked = car(rng, (-3.5, CAMERA_M - 0.9, 30.0), (0.0, 0.0, 0.0), size_m=(1.8, 1.4, 4.0))
    frames = bodies_of(street(rng, 20, parked), 20, (0.0, 0.0, SPEED_M_S))
    assert all(not frame.mover_keys for frame in frames)
