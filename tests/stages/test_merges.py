"""Parts of a thing that were found as movers of their own become one, and things that move alike do not."""

from dataclasses import replace

import numpy as np
import pytest
from rigid_worlds import bodies_of, car, static_points, world

from ttcvid.model import SCENE_CLUSTER, Platform
from ttcvid.stages.segmentation import labels
from ttcvid.stages.segmentation.merges import merged

N_FRAMES, SLOWLY = 16, (0.0, 0.0, 4.0)


def test_two_halves_that_were_found_separately_become_one():
    """A lorry whose middle is seen only later: its ends are too far apart to be one thing until then."""
    rng = np.random.default_rng(5)
    velocity, height = (-4.0, 0.0, 0.0), (0.5, 30.0)
    front, rear = (car(rng, (x, *height), velocity, 24, (2.0, 1.8, 1.5)) for x in (2.0, 8.0))
    middle = car(rng, (5.0, *height), velocity, 60, (6.5, 1.8, 1.5), frames=(10, 99))
    frames = bodies_of(world(rng, SLOWLY, 24, front, rear, middle), 24, camera_m_s=SLOWLY)
    apart, joined = frames[8], frames[-1]
    assert apart.keys_of(1)[0] != apart.keys_of(2)[0]
    assert 0 not in (apart.keys_of(1)[0], apart.keys_of(2)[0])
    assert {joined.keys_of(number)[0] for number in (1, 2, 3)} == {apart.keys_of(1)[0]}
    assert min(joined.keys_of(number)[1] for number in (1, 2, 3)) > 0.85


def test_halves_become_one_also_while_new_tracks_are_born_on_them_in_every_frame():
    rng = np.random.default_rng(5)
    velocity, height = (-4.0, 0.0, 0.0), (0.5, 30.0)
    front, rear = (car(rng, (x, *height), velocity, 24, (2.0, 1.8, 1.5)) for x in (2.0, 8.0))
    middle = car(rng, (5.0, *height), velocity, 60, (6.5, 1.8, 1.5), frames=(10, 99))
    newborn = [
        car(rng, (x, *height), velocity, 2, (1.5, 1.5, 1.0), frames=(frame, 99))
        for frame in range(11, 24)
        for x in (2.0, 8.0)
    ]
    frames = bodies_of(world(rng, SLOWLY, 24, front, rear, middle, *newborn), 24, camera_m_s=SLOWLY)
    assert frames[8].keys_of(1)[0] != frames[8].keys_of(2)[0]
    assert frames[-1].keys_of(1)[0] == frames[-1].keys_of(2)[0] != 0


def in_other_units(movers, times):
    """The movers, those of odd keys with trajectories in units `times` smaller."""
    factor = np.where(movers.key % 2, times, 1.0)
    paths = replace(movers.paths, path=movers.paths.path * factor[:, None, None])
    return replace(movers, paths=paths, rate_hz=movers.rate_hz / factor)


def test_the_units_of_trajectories_decide_no_merge(monkeypatch):
    """A mover that has sped up, and a piece of it found since then, have other units of length."""

    def merged_in_other_units(views, scene, key, movers, *others):
        key, movers = merged(views, scene, key, in_other_units(movers, 5.0), *others)
        return key, in_other_units(movers, 0.2)

    monkeypatch.setattr(labels, "merged", merged_in_other_units)
    test_two_halves_that_were_found_separately_become_one()


@pytest.mark.parametrize("seed", range(4))
def test_a_long_lorry_beside_us_is_one_though_its_cab_is_twice_as_far_away(seed):
    """Cab and tank are two things as far as can be seen, until what is between them is."""
    rng = np.random.default_rng(seed)
    velocity, beside = (0.0, 0.0, 12.0), (3.0, -0.5)
    cab, tank, middle = (
        car(rng, (*beside, z_m), velocity, n, (1.0, 3.0, length_m), frames=(first, 99))
        for z_m, n, length_m, first in ((18.0, 60, 5.0, 0), (7.0, 80, 4.0, 0), (12.25, 100, 6.5, 8))
    )
    frames = bodies_of(world(rng, SLOWLY, N_FRAMES, cab, tank, middle), N_FRAMES, camera_m_s=SLOWLY)
    assert frames[7].keys_of(1)[0] != frames[7].keys_of(2)[0]
    for frame in frames[12:]:
        assert len({frame.keys_of(number)[0] for number in (1, 2, 3)}) == 1
        assert min(frame.keys_of(number)[1] for number in (1, 2, 3)) > 0.9


STILL = (0.0, 0.0, 0.0)


def queue(seed, camera_m_s, *others, n_tracks=30):
    """Frames of two cars that drive the same way, one behind the other: one trajectory explains both."""
    rng = np.random.default_rng(seed)
    cars = [car(rng, place, (-4.0, 0.0, 0.0), n_tracks) for place in ((2.0, 0.5, 20.0), (6.6, 0.5, 27.0))]
    more = [car(rng, place, (-4.0, 0.0, 0.0), n, size, frames=frames) for place, n, size, frames in others]
    platform = Platform.vehicle if any(camera_m_s) else Platform.static
    things = world(rng, camera_m_s, N_FRAMES, *cars, *more)
    return bodies_of(things, N_FRAMES, camera_m_s, platform=platform, seed=seed)


def assert_apart(frames, part=0.8):
    """Both cars have a key of their own, the same ones in all of these frames."""
    keys = [{frame.keys_of(number)[0] for frame in frames} for number in (1, 2)]
    assert [len(own) for own in keys] == [1, 1]
    assert SCENE_CLUSTER not in keys[0] | keys[1]
    assert keys[0] != keys[1]
    assert min(frame.keys_of(number)[1] for frame in frames for number in (1, 2)) > part


@pytest.mark.parametrize("camera_m_s", [STILL, SLOWLY])
@pytest.mark.parametrize("seed", range(4))
def test_a_car_behind_another_one_that_drives_the_same_way_is_a_mover_of_its_own(camera_m_s, seed):
    assert_apart(queue(seed, camera_m_s)[8:])


@pytest.mark.parametrize("seed", range(4))
def test_single_tracks_far_off_do_not_make_a_queue_one(seed):
    """A gap may be as wide as what has tracks is apart: a single track is no part of that."""
    bridge = ((9.7, 0.5, 27.0), 30, (7.5, 1.4, 1.8), (0, 3))
    stray = ((13.0, 0.5, 27.0), 1, (0.1, 0.1, 0.1), (0, 99))
    assert_apart(queue(seed, STILL, bridge, stray)[8:])


@pytest.mark.parametrize("seed", range(4))
def test_what_is_left_of_a_split_is_seen_as_a_whole(seed):
    frames = queue(seed, STILL)
    for number in (1, 2):
        movers = frames[-1].found.movers.take(frames[-1].found.movers.key == frames[-1].keys_of(number)[0])
        on_it = frames[-1].truth == number
        assert movers.last.n_tracks[0] == pytest.approx(on_it.sum(), rel=0.2)
        assert movers.last.extent[0] * movers.rate_hz[0] < 0.15


@pytest.mark.parametrize("seed", range(3))
def test_a_small_mover_that_one_trajectory_explains_badly_is_not_hidden_by_a_large_one_that_it_explains_well(seed):
    """Most tracks of both together are those of the large one."""
    rng = np.random.default_rng(seed)
    large = car(rng, (2.0, 0.5, 20.0), (-4.0, 0.0, 0.0), 60, (4.2, 1.4, 1.8))
    small = car(rng, (6.1, 0.5, 20.0), (-4.5, 0.0, -2.0), 14, (1.5, 1.4, 1.8))
    things = world(rng, STILL, 24, large, small)
    frames = bodies_of(things, 24, STILL, sigma_px=0.5, platform=Platform.static, seed=seed)
    assert_apart(frames[8:])


def side_by_side(seed, camera_m_s, velocity_m_s, apart_m, depth_m):
    """Last frame of two cars of one motion at one depth; for eight frames tracks all over the gap make them one."""
    rng = np.random.default_rng(seed)
    both = [car(rng, (x, 0.5, depth_m), velocity_m_s, 24, (2.5, 1.4, 1.8)) for x in (0.0, apart_m)]
    bridge = car(rng, (0.5 * apart_m, 0.5, depth_m), velocity_m_s, 30, (apart_m, 1.4, 1.8), frames=(0, 8))
    street = static_points(rng, camera_m_s, 20, n=900, depth_m=(depth_m + 20.0, depth_m + 60.0))
    platform = Platform.vehicle if any(camera_m_s) else Platform.static
    return bodies_of([street, *both, bridge], 20, camera_m_s, platform=platform, seed=seed, opaque=True)[-1]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("camera_m_s", "velocity_m_s", "apart_m", "depth_m"),
    [
        (STILL, (0.5, 0.0, -5.0), 7.0, 40.0),
        (STILL, (-3.0, 0.0, 0.0), 9.0, 40.0),
        ((0, 0, 8.0), (-2.0, 0, 6.0), 8.0, 40.0),
    ],
)
def test_two_cars_of_one_motion_come_apart_where_the_street_is_seen_between_them(
    camera_m_s, velocity_m_s, apart_m, depth_m, seed
):
    assert_apart([side_by_side(seed, camera_m_s, velocity_m_s, apart_m, depth_m)])


@pytest.mark.parametrize("seed", range(3))
def test_a_long_thing_with_a_smooth_middle_stays_one(seed):
    """Corners of its ends only; what made them one is seen for six frames."""
    rng, velocity = np.random.default_rng(seed), (-4.0, 0.0, 0.0)
    ends = [car(rng, (x, 0.5, 20.0), velocity, 20, (1.5, 1.4, 1.8)) for x in (2.0, 9.0)]
    middle = car(rng, (5.5, 0.5, 20.0), velocity, 40, (7.0, 1.4, 1.8), frames=(0, 6))
    outline = car(rng, (5.5, 0.5, 20.0), velocity, 40, (8.5, 1.6, 2.0))
    street = static_points(rng, STILL, 20, [outline], n=500)
    last = bodies_of([street, *ends, middle], 20, STILL, platform=Platform.static, seed=seed)[-1]
    assert last.keys_of(1)[0] == last.keys_of(2)[0] != SCENE_CLUSTER
