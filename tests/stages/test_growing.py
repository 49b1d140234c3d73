"""What comes straight at us and is small: found by the few tracks that it has, and nothing else is taken for it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from relative_motion import history_of

from ttcvid.config import BodiesConfig, PipelineConfig
from ttcvid.geometry.estimation.rigid_motion import RigidPaths, fit_on_paths
from ttcvid.geometry.estimation.track_on_trajectory import straight_path
from ttcvid.stages.objects.surface_motions import growing_things
from ttcvid.stages.segmentation.body_views import body_views
from ttcvid.stages.segmentation.expansion import find_growing
from ttcvid.stages.segmentation.labels import BodyMemory

CONFIG, LINK_PX, SIGMA_PX = BodiesConfig(), 32.0, 0.1
# After so many frames four tracks are a thing.
FRAMES = 3
TIMES_S = 0.05 * np.arange(20.0)
OWN_M_S = 40.0
# Of an aircraft its wing tips, nose and fin.
AIRCRAFT_M = np.array([[-5.5, 0.0, 0.0], [5.5, 0.0, 0.0], [0.0, 0.6, 0.0], [0.2, -1.6, 0.0]])
SCENE_M_S = np.array([0.0, 0.0, -OWN_M_S])


def fields(rng, n=120):
    """Ground 250 m below, up to the horizon."""
    below = rng.uniform(0.01, 0.25, n)
    depth_m = 250.0 / below
    return np.column_stack([rng.uniform(-0.4, 0.4, n) * depth_m, np.full(n, 250.0), depth_m])


def found_in(position_m, velocity_m_s, may_be=None, frames=FRAMES, sigma_px=SIGMA_PX, seed=1, least_redchi=0.0):
    """Public things after some frames that look alike, and how well the scene's path explains each track."""
    history = history_of(position_m, velocity_m_s, TIMES_S, sigma_px=sigma_px, rng=np.random.default_rng(seed))
    n, since_s = len(position_m), history.since_s
    views = body_views(history, np.ones(n, dtype=bool), LINK_PX, can_translate=True)
    scene = RigidPaths(
        np.repeat(np.eye(3)[None, None], len(since_s), axis=1), straight_path(SCENE_M_S / OWN_M_S, since_s)[None]
    )
    redchi = np.maximum(fit_on_paths(views.points(np.arange(n)), scene).redchi, least_redchi)
    memory, next_id, public = (), 1, {}
    for _ in range(frames):
        public, memory, next_id = find_growing(
            memory,
            history,
            redchi,
            1.0,
            np.ones(n, dtype=bool) if may_be is None else may_be,
            views,
            next_id,
            CONFIG,
        )
    return public, redchi


def encounter(position_m, velocity_m_s, rng, aircraft_m=AIRCRAFT_M):
    """Fields, and an aircraft with a velocity relative to us."""
    ground = fields(rng)
    where = np.concatenate([np.asarray(position_m) + aircraft_m, ground])
    return where, np.concatenate(
        [np.broadcast_to(velocity_m_s, aircraft_m.shape), np.broadcast_to(SCENE_M_S, ground.shape)]
    )


@pytest.fixture
def rng():
    return np.random.default_rng(4)


@pytest.mark.parametrize("relative_m_s", [(-20.0, 0.0, -75.0), (10.0, 1.0, -70.0)])
def test_an_aircraft_at_constant_bearing_is_found_with_its_direction(rng, relative_m_s):
    relative_m_s = np.asarray(relative_m_s)
    where, velocity = encounter(-2.8 * relative_m_s, relative_m_s, rng)
    assert found_in(where, velocity, frames=FRAMES - 1)[0] == {}
    public, redchi = found_in(where, velocity)
    (thing,) = public.values()
    assert list(public) == [1]
    np.testing.assert_array_equal(thing.members, np.arange(4))
    off = thing.direction - relative_m_s / np.linalg.norm(relative_m_s)
    assert np.linalg.norm(off) < 3.0 * np.sqrt(np.trace(thing.direction_cov))
    assert np.linalg.norm(off) < np.radians(2.0)
    # Most of its tracks by themselves do not contradict the scene.
    assert np.sort(redchi[:4])[0] < CONFIG.scene_gate


def test_four_aircraft_at_once_are_four_things(rng):
    relative_m_s = np.array([0.0, 0.0, -75.0])
    centres_m = -2.8 * relative_m_s + 40.0 * np.array([[x, 0.0, 0.0] for x in (-2, -1, 1, 2)])
    aircraft_m = (centres_m[:, None] + AIRCRAFT_M).reshape(-1, 3)
    ground = fields(rng)
    velocities = [-centres_m / 2.8 for _ in AIRCRAFT_M]
    velocity = np.concatenate([np.stack(velocities, axis=1).reshape(-1, 3), np.tile(SCENE_M_S, (len(ground), 1))])
    public, _ = found_in(np.concatenate([aircraft_m, ground]), velocity, frames=FRAMES + 2)
    assert len(public) == 4


def test_tracks_of_which_only_the_present_view_is_left_are_no_part_of_a_thing(rng):
    relative_m_s = np.array([-20.0, 0.0, -75.0])
    where, velocity = encounter(-2.8 * relative_m_s, relative_m_s, rng)
    history = history_of(where, velocity, TIMES_S, sigma_px=SIGMA_PX, rng=rng)
    rays = history.rays.copy()
    rays[:-1, 1:4] = np.nan
    history, n = replace(history, rays=rays), len(where)
    views = body_views(history, np.ones(n, dtype=bool), LINK_PX, can_translate=True)
    odd, every = np.full(n, 2.0 * CONFIG.scene_gate), np.ones(n, dtype=bool)
    assert find_growing((), history, odd, 1.0, every, views, 1, CONFIG) == ({}, (), 1)


def test_an_earlier_view_that_was_found_displaced_does_not_hide_an_aircraft(rng):
    relative_m_s = np.array([-20.0, 0.0, -75.0])
    where, velocity = encounter(-2.8 * relative_m_s, relative_m_s, rng)
    history = history_of(where, velocity, TIMES_S, sigma_px=SIGMA_PX, rng=rng)
    rays, n = history.rays.copy(), len(where)
    rays[8, :4, 0] += 8.0 / history.focal_px
    views = body_views(replace(history, rays=rays), np.ones(n, dtype=bool), LINK_PX, can_translate=True)
    rays = rays.copy()
    rays[8, :4] = np.nan
    history = replace(history, rays=rays)
    seen = SimpleNamespace(redchi=np.append(np.full(4, 2.0 * CONFIG.scene_gate), np.ones(n - 4)), median_redchi=1.0)
    found, memory = SimpleNamespace(seen=seen, key=np.zeros(n, dtype=int)), BodyMemory()
    for _ in range(FRAMES):
        motions, memory = growing_things(history, views, found, np.ones(n, dtype=bool), memory, PipelineConfig())
    assert [len(motion.members) for motion in motions] == [4]


def test_fields_alone_are_no_thing(rng):
    for seed in range(5):
        ground = fields(np.random.default_rng(seed), 400)
        assert found_in(ground, SCENE_M_S, seed=seed)[0] == {}
        # Not even if the scene did not explain them.
        assert found_in(ground, SCENE_M_S, seed=seed, least_redchi=2.0 * CONFIG.scene_gate)[0] == {}


def test_what_goes_away_is_none(rng):
    where, velocity = encounter((40.0, -5.0, 200.0), (0.0, 0.0, 45.0), rng)
    assert found_in(where, velocity)[0] == {}


def test_what_is_reached_in_eight_seconds_is_none_yet(rng):
    relative_m_s = np.array([-10.0, 0.0, -40.0])
    where, velocity = encounter(-8.0 * relative_m_s, relative_m_s, rng, 3.0 * AIRCRAFT_M)
    assert found_in(where, velocity)[0] == {}


def test_birds_that_fly_each_its_way_are_none(rng):
    where, velocity = encounter((-20.0, 0.0, 210.0), np.zeros(3), rng)
    velocity = velocity.copy()
    velocity[:4] = rng.uniform(-6.0, 6.0, (4, 3))
    assert found_in(where, velocity)[0] == {}


def test_three_tracks_are_not_enough_and_those_of_movers_do_not_count(rng):
    relative_m_s = np.array([-20.0, 0.0, -75.0])
    where, velocity = encounter(-2.8 * relative_m_s, relative_m_s, rng)
    assert found_in(where[1:], velocity[1:])[0] == {}
    may_be = np.arange(len(where)) > 0
    assert found_in(where, velocity, may_be)[0] == {}


def test_nothing_to_see_is_no_thing():
    assert found_in(np.empty((0, 3)), SCENE_M_S)[0] == {}
