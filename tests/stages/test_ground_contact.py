"""What lies under the road, or hangs over it, if it stood still: it goes our way, or comes towards us."""

import numpy as np
import pytest
from relative_motion import CAMERA, FOCAL_PX
from rigid_worlds import LINK_PX, Thing, bodies_of, car

from ttcvid.stages.segmentation.ground_contact import OnGround, find_contacts
from ttcvid.stages.segmentation.road import Road

SPEED_M_S, CAMERA_M = 10.0, 1.4
BUMPS_RAD = float(np.radians(0.05))
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


def contacts_of(ground, *things, apparent=(), sigma_hz=0.002, camera_m=CAMERA_M):
    """What is said of things over the road, each with ``apparent`` times the rate that it would have if it stood still.

    Of each thing: shares of its points that the ground contradicts, and that are borne by it; and of the road.
    """
    position = np.concatenate([ground, *things])
    part = np.repeat(np.arange(1 + len(things)), [len(ground), *map(len, things)])
    rate_hz = np.array([1.0, *apparent])[part] * SPEED_M_S / position[:, 2]
    place, n = position[:, :2] / position[:, 2:], len(position)
    xy_px = place * FOCAL_PX + (CAMERA.cx_px, CAMERA.cy_px)
    level = Road(np.array([0.0, 0.0, SPEED_M_S / camera_m]))
    seen = OnGround(place, rate_hz, np.full(n, sigma_hz), level, np.ones(n, dtype=bool), 0.0)
    found = find_contacts(xy_px, LINK_PX, seen, np.zeros(n, dtype=int))
    is_thing = found.thing >= 0
    odd, borne = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
    odd[is_thing], borne[is_thing] = (said[found.thing[is_thing]] for said in (found.contradicts, found.is_borne))
    odd, borne = (np.bincount(part, said) / np.bincount(part) for said in (odd, borne))
    return odd[1:], borne[1:], odd[0]


def test_the_road_is_seen_below_a_car_that_comes_as_fast_as_we_drive():
    oncoming = upright((0.2, 1.4), 20.0, (-8.0, -6.2))
    odd, _, road_odd = contacts_of(without_hidden(road(), oncoming), oncoming, apparent=(2.0,))
    assert (odd[0], road_odd) == (1.0, 0.0)


def test_where_no_road_is_seen_nothing_bears_a_car_that_comes_over_our_lane():
    oncoming = upright((0.2, 1.4), 20.0, (-4.0, -2.2), n=5)
    plain = road()[[0, 12, -1]]
    odd, _, _ = contacts_of(plain, oncoming, apparent=(2.0,))
    assert odd[0] == 1.0


def test_windows_of_a_parked_car_over_its_plain_door_do_not_hang():
    windows = upright((0.8, 1.4), 12.0, (1.9, 3.3), n=8)
    odd, _, _ = contacts_of(road()[[0, 12, -1]], windows, apparent=(1.0,))
    assert odd[0] == 0.0


@pytest.mark.parametrize(("height_m", "depth_m"), [((0.8, 6.0), 24.0), ((0.55, 2.9), 14.0)])
def test_a_house_across_the_end_of_the_road_does_not_hang_over_its_plain_base(height_m, depth_m):
    house = upright(height_m, depth_m, (-4.0, 4.0))
    odd, _, _ = contacts_of(road()[[0, 12, -1]], house, apparent=(1.0,))
    assert odd[0] == 0.0


@pytest.mark.parametrize("apparent", [1.5, 2.0, 2.5])
def test_a_lorry_that_comes_towards_a_low_camera_hangs(apparent):
    camera_m = 0.6
    lower = np.array([0.0, camera_m - CAMERA_M, 0.0])
    ground, lorry = road() + lower, upright((0.5, 4.0), 20.0, (-4.7, -2.2)) + lower
    odd, _, _ = contacts_of(without_hidden(ground, lorry), lorry, apparent=(apparent,), camera_m=camera_m)
    assert odd[0] == 1.0


def test_a_bridge_does_not_hang_though_the_road_is_seen_between_its_pillars():
    deck = upright((4.5, 6.0), 20.0, (-6.0, 6.0))
    pillars = [upright((0.8, 4.5), 20.0, (x_m, x_m + 0.6)) for x_m in (-6.0, 5.4)]
    odd, _, _ = contacts_of(road(), np.concatenate([deck, *pillars]), apparent=(1.0,))
    assert odd[0] == 0.0


@pytest.mark.parametrize("height_m", [(0.2, 1.4), (0.0, 6.0)])
@pytest.mark.parametrize("x_m", [(-4.0, -2.2), (-1.0, 0.8)])
def test_what_stands_on_the_road_is_borne_by_it(height_m, x_m):
    parked = upright(height_m, 12.0, x_m)
    odd, borne, road_odd = contacts_of(without_hidden(road(), parked), parked, apparent=(1.0,))
    assert borne[0] > 0.8
    assert (odd[0], road_odd) == (0.0, 0.0)


def test_what_a_nearer_thing_hides_the_foot_of_does_not_hang():
    behind, before = upright((0.7, 1.4), 12.0, (-2.0, 0.0)), upright((0.0, 0.6), 9.0, (-2.2, 0.2))
    odd, _, _ = contacts_of(road()[[0, 12, -1]], behind, before, apparent=(1.0, 1.0))
    np.testing.assert_array_equal(odd, 0.0)


def test_a_plain_wall_below_a_row_of_windows_is_no_hole():
    windows, wall = upright((0.7, 2.0), 12.0, (-6.0, -2.0)), upright((0.0, 2.0), 12.0, (-6.0, -2.0))
    odd, borne, _ = contacts_of(without_hidden(road(), wall), windows, apparent=(1.0,))
    assert (odd[0], borne[0]) == (0.0, 0.0)


def test_the_road_seen_beside_the_trunk_of_a_tree_below_its_crown_is_no_hole():
    trunk, crown = upright((0.6, 2.0), 12.0, (-3.2, -3.1), n=4), upright((2.0, 5.0), 12.0, (-5.0, -1.0))
    whole_trunk = upright((0.0, 2.0), 12.0, (-3.2, -3.1))
    tree = np.concatenate([trunk, crown])
    odd, _, _ = contacts_of(without_hidden(road(), whole_trunk), tree, apparent=(1.0,))
    assert odd[0] == 0.0


def test_a_row_of_houses_is_no_thing_that_hangs():
    house = [upright((0.7, 5.0), depth, (-6.0, -5.0)) for depth in np.geomspace(10.0, 30.0, 20)]
    odd, _, _ = contacts_of(road(), np.concatenate(house), apparent=(1.0,))
    assert odd[0] == 0.0


def rear(top_m=1.6, x_m=(-0.9, 0.9), depth_m=20.0, n=12):
    """The rear of what is ahead of us, from its bumper up."""
    return upright((0.3, top_m), depth_m, x_m, n)


def far_points(x_m, height_m, depth_m=2000.0, n=400):
    """Points of a ridge far away."""
    return np.column_stack([np.linspace(*x_m, n), np.full(n, CAMERA_M - height_m), np.full(n, depth_m)])


@pytest.mark.parametrize("apparent", [0.0, 0.3, 0.5, 0.53])
@pytest.mark.parametrize("top_m", [1.6, 3.5])
def test_what_goes_our_way_would_lie_under_the_road_from_its_bumper_to_its_roof(apparent, top_m):
    ahead = rear(top_m)
    odd, _, road_odd = contacts_of(without_hidden(road(), ahead), ahead, apparent=(apparent,))
    assert odd[0] == 1.0
    # Of the road only what is seen beside it, at the depth that it appears to have, is ever taken along.
    assert road_odd < 0.01


def test_our_own_bonnet_would_lie_under_the_road_and_does_not_move():
    bonnet = upright((0.3, 0.6), 3.0, (-1.0, 1.0))
    odd, _, _ = contacts_of(road(), bonnet, apparent=(0.0,))
    assert odd[0] == 0.0


def test_houses_far_behind_it_would_not():
    ahead, house = rear(), far_points((-20.0, 20.0), 4.4, 100.0)
    odd, _, _ = contacts_of(without_hidden(road(), ahead), ahead, house, apparent=(0.0, 1.0))
    assert odd[1] == 0.0


def test_a_wall_that_has_the_static_depth_of_a_car_ahead_stays_where_it_stands():
    """The car, at 20 m with half of our speed, looks as far away as the wall across the road, at 40 m."""
    car_ahead, wall = rear(), upright((0.0, 3.0), 40.0, (-12.0, 12.0), n=40)
    odd, _, road_odd = contacts_of(without_hidden(road(), car_ahead), car_ahead, wall, apparent=(0.5, 1.0))
    assert odd[0] == 1.0
    # But for what is seen over the roof of the car, and within half a camera's height beside; of the road as well.
    assert odd[1] < 0.25
    assert road_odd < 0.05


def test_what_stands_behind_a_car_ahead_and_beside_it_stays_over_the_horizon():
    car_ahead, front = rear(), upright((0.0, 12.0), 40.0, (-12.0, 12.0), n=40)
    odd, _, _ = contacts_of(without_hidden(road(), car_ahead), car_ahead, front, apparent=(0.5, 1.0))
    assert odd[1] < 0.05


def test_a_low_hedge_beside_it_takes_nothing_off_a_lorry_ahead():
    lorry = rear(3.8, (-1.25, 1.25))
    hedges = [upright((0.0, 0.9), 40.0, x_m, n=30) for x_m in ((-12.0, -3.5), (3.5, 12.0))]
    odd, _, _ = contacts_of(without_hidden(road(), lorry), lorry, *hedges, apparent=(0.5, 1.0, 1.0))
    assert odd[0] > 0.9


def test_a_tree_with_the_static_depth_of_a_cyclist_beside_it_stays_though_one_of_its_points_is_wrong():
    """At 12 m he looks 20 m away, as the tree does: a point under its foot, an error, would make it a part of him."""
    cyclist = upright((0.2, 1.7), 12.0, (1.2, 1.7), n=6)
    tree = upright((0.1, 5.0), 20.0, (3.7, 6.5), n=14)
    error = np.array([[5.4, CAMERA_M + 0.6, 20.0]])
    things = cyclist, np.concatenate([tree, error])
    odd, _, _ = contacts_of(without_hidden(road(), cyclist), *things, apparent=(0.6, 1.0))
    assert odd[0] == 1.0
    assert odd[1] < 0.05


def test_a_ridge_at_the_horizon_that_goes_on_to_the_sides_would_not_and_nothing_is_said_of_the_roof():
    ahead, ridge = rear(), far_points((-600.0, 600.0), 41.4)
    odd, _, _ = contacts_of(without_hidden(road(), ahead), ahead, ridge, apparent=(0.0, 0.0))
    assert 0.3 < odd[0] < 1.0
    assert odd[1] == 0.0


def test_rates_that_are_not_known_say_nothing():
    odd, _, _ = contacts_of(without_hidden(road(), rear()), rear(), apparent=(0.5,), sigma_hz=3.0)
    assert odd[0] == 0.0


def at_static_depth(n_road, post_x_m, n_posts, low=0.75, depth_m=14.0):
    """A strip of the road across our way, posts beside it, and two points of the strip's rate that lie too low."""
    strip = np.column_stack([np.linspace(-2.0, 2.0, n_road), np.full(n_road, CAMERA_M), np.full(n_road, depth_m)])
    posts = np.concatenate([upright((0.3, 1.2), depth_m, (x_m, x_m + 0.3), n=n_posts) for x_m in post_x_m])
    too_low = np.column_stack([[-0.1, 0.1], [CAMERA_M] * 2, [low * depth_m] * 2])
    return contacts_of(road(), strip, posts, too_low, apparent=(1.0, 1.0, low))[0]


def test_most_of_a_kerb_may_be_road_and_is_not_taken_along():
    assert at_static_depth(80, (-0.4, 0.1), n_posts=2)[0] == 0.0
    # The middle of a car is.
    assert at_static_depth(40, (-0.4, 0.1), n_posts=4)[0] > 0.1


def test_where_nothing_stands_over_points_under_the_road_nothing_moves():
    assert (at_static_depth(80, (-2.0, 1.7), n_posts=5, low=0.81, depth_m=10.0)[:2] == 0.0).all()


def street(rng, n_frames, *movers):
    """Road and house fronts on both sides, all that is seen between the first frame and the last."""
    far_m = 50.0 + SPEED_M_S * 0.1 * n_frames
    ground = np.column_stack([rng.uniform(-5.0, 5.0, 900), np.full(900, CAMERA_M), rng.uniform(6.0, far_m, 900)])
    sides = np.column_stack([rng.choice([-9.0, 9.0], 300), rng.uniform(-5.0, 1.0, 300), rng.uniform(9.0, far_m, 300)])
    return [Thing(np.concatenate([ground, sides])), *movers]


@pytest.mark.parametrize("seed", [5, 8])
def test_an_oncoming_car_in_its_own_lane_is_a_mover_that_keeps_its_key(seed):
    rng = np.random.default_rng(seed)
    oncoming = car(rng, (-3.5, CAMERA_M - 0.9, 45.0), (0.0, 0.0, -9.0), size_m=(1.8, 1.4, 4.0))
    frames = bodies_of(street(rng, 20, oncoming), 20, (0.0, 0.0, SPEED_M_S))
    # Also when it is near, grows fast, and the path that its growth shows lags behind.
    later = frames[5:]
    assert np.median([np.mean(frame.key[frame.truth == 1] == 1) for frame in later]) >= 0.6
    assert min(np.count_nonzero(frame.key[frame.truth == 1] == 1) for frame in later) >= 10
    assert max(np.count_nonzero(frame.key[frame.truth == 0] != 0) for frame in frames) <= 3


@pytest.mark.parametrize(("seed", "shake_rad"), [(1, 0.0), (2, BUMPS_RAD), (3, 0.0), (4, BUMPS_RAD)])
def test_dirt_on_the_lens_is_no_car_ahead(seed, shake_rad):
    rng = np.random.default_rng(seed)
    places = [(0.25, 0.12), (-0.3, 0.1), (0.02, 0.08), (-0.1, 0.15)]
    spots = [np.column_stack([rng.normal(xy, 0.02, (20, 2)), np.ones(20)]) for xy in places]
    dirt = [Thing(2.0 * spot, rides=True) for spot in spots]
    frames = bodies_of(street(rng, 30, *dirt), 30, (0.0, 0.0, SPEED_M_S), opaque=True, shake_rad=shake_rad)
    assert all(not frame.mover_keys for frame in frames)


def test_a_car_that_is_parked_there_stays_with_the_scene():
    rng = np.random.default_rng(6)
    parked = car(rng, (-3.5, CAMERA_M - 0.9, 30.0), (0.0, 0.0, 0.0), size_m=(1.8, 1.4, 4.0))
    frames = bodies_of(street(rng, 20, parked), 20, (0.0, 0.0, SPEED_M_S))
    assert all(not frame.mover_keys for frame in frames)


@pytest.mark.parametrize("seed", [1, 5])
def test_a_car_ahead_as_fast_as_we_are_is_one_mover_up_to_its_roof_and_takes_nothing_of_the_road(seed):
    rng = np.random.default_rng(seed)
    ahead = car(rng, (0.0, CAMERA_M - 0.95, 18.0), (0.0, 0.0, SPEED_M_S), n=40, size_m=(1.8, 1.4, 0.5))
    frames = bodies_of(street(rng, 40, ahead), 40, (0.0, 0.0, SPEED_M_S), opaque=True, shake_rad=BUMPS_RAD)
    later = frames[15:]
    keys = {frame.keys_of(1)[0] for frame in later}
    assert len(keys) == 1
    assert 0 not in keys
    assert np.median([frame.keys_of(1)[1] for frame in later]) >= 0.9
    assert max(np.count_nonzero(frame.key[frame.truth == 0] != 0) for frame in frames) <= 5


@pytest.mark.parametrize("seed", [1, 4, 5])
def test_a_slower_car_ahead_is_whole_though_its_middle_has_the_static_depth_of_the_road_there(seed):
    rng = np.random.default_rng(seed)
    ahead = car(rng, (0.0, CAMERA_M - 0.95, 26.0), (0.0, 0.0, 0.4 * SPEED_M_S), n=80, size_m=(1.8, 1.7, 0.5))
    frames = bodies_of(street(rng, 24, ahead), 24, (0.0, 0.0, SPEED_M_S), opaque=True)
    later = frames[12:]
    assert {frame.keys_of(1)[0] for frame in later} == {1}
    assert np.median([frame.keys_of(1)[1] for frame in later]) >= 0.95
    assert max(np.count_nonzero(frame.key[frame.truth == 0] != 0) for frame in frames) <= 10


def test_a_slower_car_ahead_of_noisy_tracks_is_found_within_0_8_seconds():
    """Its tracks share the depth that they would have at rest; their flows, which diverge, are not alike."""
    is_found = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        ahead = car(rng, (0.0, CAMERA_M - 0.95, 12.0), (0.0, 0.0, 7.0), n=32, size_m=(1.8, 1.4, 0.5))
        frames = bodies_of(street(rng, 9, ahead), 9, (0.0, 0.0, SPEED_M_S), sigma_px=0.5, seed=seed, opaque=True)
        is_found.append(any(frame.keys_of(1)[0] for frame in frames))
    assert sum(is_found) >= 11


@pytest.mark.parametrize("seed", range(3))
def test_two_cars_side_by_side_are_not_one_where_their_depths_at_rest_differ(seed):
    """By a half: one is slower than we are by 3 m/s, the other by 6. They are nearer to each other than neighbours."""
    rng = np.random.default_rng(seed)
    cars = [
        car(rng, (x_m, CAMERA_M - 0.95, 14.0), (0.0, 0.0, speed_m_s), n=40, size_m=(1.8, 1.4, 0.5))
        for x_m, speed_m_s in ((-1.0, 7.0), (1.0, 4.0))
    ]
    frames = bodies_of(street(rng, 12, *cars), 12, (0.0, 0.0, SPEED_M_S), sigma_px=0.2, seed=seed, opaque=True)
    assert frames[-1].keys_of(1)[0] or frames[-1].keys_of(2)[0]
    for frame in frames:
        for key in frame.mover_keys:
            one, other = (np.mean(frame.key[frame.truth == number] == key) for number in (1, 2))
            assert min(one, other) < 0.1


@pytest.mark.parametrize("seed", range(3))
def test_a_road_that_falls_away_does_not_move(seed):
    """By 3 % beyond 26 m: there its points lie under the plane of the road before us."""
    rng = np.random.default_rng(seed)
    depth_m = 1.0 / rng.uniform(1.0 / 90.0, 1.0 / 6.0, 260) + rng.uniform(0.0, 36.0, 260)
    fall_m = np.minimum(0.03 * np.maximum(depth_m - 26.0, 0.0), 2.8)
    ground = np.column_stack([rng.uniform(-7.0, 7.0, 260), CAMERA_M + fall_m, depth_m])
    depth_m = 18.0 + 1.0 / rng.uniform(1.0 / 70.0, 1.0 / 8.0, 160)
    sides = np.column_stack(
        [rng.choice([-1.0, 1.0], 160) * rng.uniform(5.0, 15.0, 160), rng.uniform(-6.0, 1.2, 160), depth_m]
    )
    things = [Thing(np.concatenate([ground, sides]))]
    frames = bodies_of(things, 30, (0.0, 0.0, 12.0), sigma_px=0.3, seed=seed)
    assert all(not frame.mover_keys for frame in frames)
