"""New movers that keep their bearing: found by how they grow, and nothing that stands still is taken for one."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from relative_motion import box_of_points, history_of

from ttcvid.config import BodiesConfig
from ttcvid.geometry.estimation.rigid_motion import RigidPaths, fit_on_paths, views_by_track
from ttcvid.geometry.estimation.track_on_trajectory import straight_path
from ttcvid.stages.segmentation.births import new_movers
from ttcvid.stages.segmentation.body_views import body_views
from ttcvid.stages.segmentation.expansion import LEAST_VIEWS, expanding_movers, least_tracks
from ttcvid.stages.segmentation.road_evidence import RoadMemory
from ttcvid.stages.segmentation.scene import SeenScene

CONFIG, LINK_PX, SIGMA_PX = BodiesConfig(), 32.0, 0.1
TIMES_S = 0.05 * np.arange(20.0)
OWN_M_S = np.array([0.0, 0.0, -10.0])
CAR_M, ROAD_Y_M = (4.3, 1.2, 0.2), 1.4
# A car from the left that is where we will be in 2.8 s.
TO_US_M_S = np.array([5.0, 0.0, -10.0])
AT_M = -2.8 * TO_US_M_S + [0.0, 0.7, 0.0]


def houses_and_road(rng, n=150):
    """A wall across, 60 m ahead, and the road up to it."""
    depth_m = 8.0 / rng.uniform(0.14, 1.0, n)
    road = np.column_stack([rng.uniform(-0.5, 0.5, n) * depth_m, np.full(n, ROAD_Y_M), depth_m])
    return np.concatenate([box_of_points(rng, n, (-10.0, -3.0, 60.0), (60.0, 8.0, 0.5)), road])


def views_and_fit(position_m, velocity_m_s, rng, sigma_px=SIGMA_PX):
    """Views of tracks, the path of the scene, and how that explains them."""
    history = history_of(position_m, velocity_m_s, TIMES_S, sigma_px=sigma_px, rng=rng)
    every = np.arange(len(position_m))
    views = body_views(history, np.ones(len(every), dtype=bool), LINK_PX, can_translate=True)
    way = straight_path(OWN_M_S / np.linalg.norm(OWN_M_S), views.since_s)
    scene = RigidPaths(np.repeat(np.eye(3)[None, None], len(TIMES_S), axis=1), way[None])
    return views, scene, fit_on_paths(views.points(every), scene)


def street_with(thing_m, velocity_m_s, rng):
    """A street with a thing before it: places (N, 3), the thing's first, and velocities relative to us."""
    scene = houses_and_road(rng)
    velocities = np.broadcast_to(velocity_m_s, thing_m.shape), np.broadcast_to(OWN_M_S, scene.shape)
    return np.concatenate([thing_m, scene]), np.concatenate(velocities)


def body_views_of(views, rays):
    """The views with other rays (L, N, 3)."""
    return replace(views, rays=rays, rays_by_track=views_by_track(rays))


def found_in(views, scene, fit, seeds=None):
    seeds = np.flatnonzero(fit.redchi > CONFIG.scene_gate) if seeds is None else seeds
    may_be = fit.n_views >= LEAST_VIEWS
    seen = SimpleNamespace(scene=scene, redchi=fit.redchi, median_redchi=1.0)
    return expanding_movers(views, seen, may_be, seeds, CONFIG)


def new_in(views, scene, fit):
    nowhere, redchi = np.zeros(len(fit.redchi), dtype=bool), fit.redchi
    of_scene = fit.rate_hz, fit, redchi, redchi, 1.0
    seen = SeenScene(scene, 1.0, *of_scene, RoadMemory(), False, np.full(len(redchi), -np.inf))
    members, paths, _ = new_movers(views, seen, ~nowhere, views.neighbours(), CONFIG)
    return members, paths


@pytest.fixture
def rng():
    return np.random.default_rng(18)


@pytest.mark.parametrize("seed", range(5))
def test_a_car_at_constant_bearing_is_found_with_its_direction_by_eight_tracks(seed):
    rng = np.random.default_rng(seed)
    views, scene, fit = views_and_fit(*street_with(box_of_points(rng, 8, AT_M, CAR_M), TO_US_M_S, rng), rng)
    ((members, path),) = found_in(views, scene, fit)
    direction = path[0] / -np.linalg.norm(path[0])
    assert np.count_nonzero(members < 8) >= least_tracks(CONFIG)
    # What else is taken for a part of it moves as it does, as far as can be seen.
    assert np.count_nonzero(members >= 8) <= 1
    assert np.degrees(np.arccos(direction @ TO_US_M_S / np.linalg.norm(TO_US_M_S))) < 4.0


def test_six_of_its_tracks_are_enough_in_nineteen_of_twenty_draws():
    n_found = 0
    for seed in range(100, 120):
        rng = np.random.default_rng(seed)
        views, scene, fit = views_and_fit(*street_with(box_of_points(rng, 6, AT_M, CAR_M), TO_US_M_S, rng), rng)
        things = found_in(views, scene, fit)
        n_found += any(np.count_nonzero(members < 6) >= least_tracks(CONFIG) for members, _ in things)
    assert n_found >= 19


def test_three_of_its_tracks_are_enough_where_new_movers_need_no_more():
    # As before a camera on a mast.
    n_found, config = 0, CONFIG.model_copy(update={"min_tracks": 3})
    for seed in range(20):
        rng = np.random.default_rng(seed)
        views, scene, fit = views_and_fit(*street_with(box_of_points(rng, 3, AT_M, CAR_M), TO_US_M_S, rng), rng)
        seen = SimpleNamespace(scene=scene, redchi=fit.redchi, median_redchi=1.0)
        seeds = np.flatnonzero(fit.redchi > config.scene_gate)
        things = expanding_movers(views, seen, fit.n_views >= LEAST_VIEWS, seeds, config)
        n_found += any(np.count_nonzero(members < 3) == 3 for members, _ in things)
    assert n_found >= 10


def test_a_walker_is_found_by_all_his_tracks_together_where_few_contradict_the_scene_one_by_one():
    # 4.4 s before he is hit, on collision course; at this distance head and feet alone leave the scene's paths.
    n_found, velocity_m_s, n = 0, np.array([1.2, 0.0, -10.0]), 16
    for seed in range(20):
        rng = np.random.default_rng(seed)
        walker = box_of_points(rng, n, -4.4 * velocity_m_s + [0.0, 0.5, 0.0], (0.5, 1.7, 0.3))
        views, scene, fit = views_and_fit(*street_with(walker, velocity_m_s, rng), rng, sigma_px=0.2)
        members, _ = new_in(views, scene, fit)
        n_found += any(np.count_nonzero(tracks < n) >= least_tracks(CONFIG) for tracks in members)
    assert n_found >= 18


def test_it_is_found_though_tracks_all_over_the_street_contradict_the_scene_worse(rng):
    # Along the outlines of posts and trees tracks slide, each its own way.
    sliding = np.array([[x, y, 12.0] for x in (-6.0, -3.0, 3.0, 6.0) for y in (-2.5, -1.0)])
    thing, (where, velocity) = box_of_points(rng, 8, AT_M, CAR_M), street_with(sliding, TO_US_M_S, rng)
    velocity = velocity.copy()
    velocity[: len(sliding)] += rng.uniform(-4.0, 4.0, (len(sliding), 3))
    where, velocity = np.concatenate([thing, where]), np.concatenate([np.tile(TO_US_M_S, (8, 1)), velocity])
    views, scene, fit = views_and_fit(where, velocity, rng)
    assert np.count_nonzero(fit.redchi[8:16] > fit.redchi[:8].max()) > 5
    ((members, _),) = found_in(views, scene, fit)
    assert np.count_nonzero(members < 8) >= least_tracks(CONFIG)


def test_it_is_a_new_mover_though_the_flows_of_its_tracks_are_not_alike(rng):
    views, scene, fit = views_and_fit(*street_with(box_of_points(rng, 10, AT_M, CAR_M), TO_US_M_S, rng), rng)
    (members,), paths = new_in(views, scene, fit)
    assert np.count_nonzero(members < 10) >= least_tracks(CONFIG)
    assert np.count_nonzero(members >= 10) == 0
    assert len(paths) == 1


@pytest.mark.parametrize("seed", range(5))
def test_what_stands_still_is_none_though_it_errs_three_times_as_much_as_is_said(seed):
    rng = np.random.default_rng(seed)
    street = houses_and_road(rng)
    views, scene, _ = views_and_fit(street, OWN_M_S, rng, sigma_px=3.0 * SIGMA_PX)
    every = np.arange(len(street))
    views = replace(views, sigma_norm=views.sigma_norm / 3.0)
    fit = fit_on_paths(views.points(every), scene)
    # Enough tracks contradict the scene for a thing to be looked for.
    assert np.count_nonzero(fit.redchi > CONFIG.gain) > least_tracks(CONFIG)
    assert found_in(views, scene, fit, every) == []


@pytest.mark.parametrize("velocity_m_s", [(0.0, 0.0, 6.0), (8.0, 0.0, 0.0)], ids=["goes away", "just crosses"])
def test_what_does_not_come_nearer_is_none(rng, velocity_m_s):
    views, scene, fit = views_and_fit(*street_with(box_of_points(rng, 10, AT_M, CAR_M), velocity_m_s, rng), rng)
    assert found_in(views, scene, fit) == []


def test_tracks_that_go_each_its_way_are_none(rng):
    where, velocity = street_with(box_of_points(rng, 10, AT_M, CAR_M), TO_US_M_S, rng)
    velocity = velocity.copy()
    velocity[:10] += rng.uniform(-3.0, 3.0, (10, 3))
    views, scene, fit = views_and_fit(where, velocity, rng)
    assert found_in(views, scene, fit) == []


def test_nothing_to_see_is_none(rng):
    views, scene, fit = views_and_fit(np.empty((0, 3)), OWN_M_S, rng)
    assert found_in(views, scene, fit) == []


@pytest.mark.parametrize("n_displaced", [0, 8])
def test_what_crosses_is_a_new_mover_though_the_oldest_observation_of_most_tracks_is_displaced(rng, n_displaced):
    velocity_m_s, n = np.array([1.5, 0.0, -10.0]), 12
    car = box_of_points(rng, n, (-2.0, 0.7, 18.0), (1.5, 1.2, 0.2))
    views, scene, fit = views_and_fit(*street_with(car, velocity_m_s, rng), rng)
    rays = views.rays.copy()
    # By 24 px, up and down in turn: a flow measured from there alone would be that of no neighbour.
    aside = 24.0 / views.focal_px * np.resize([1.0, -1.0], n_displaced)
    rays[0, :n_displaced, 1] += aside
    views = body_views_of(views, rays)
    fit = fit_on_paths(views.points(np.arange(len(fit.redchi))), scene)
    found, _ = new_in(views, scene, fit)
    assert any(np.count_nonzero(members < n) >= n - 4 for members in found)
