"""A mover that changes its speed along our way: what tells it from a static thing at another depth."""

from dataclasses import replace

import numpy as np
import pytest

from ttcvid.config import BodiesConfig
from ttcvid.geometry.estimation.rigid_motion import RigidPaths, fit_on_paths, views_by_track
from ttcvid.geometry.rotation import normalize
from ttcvid.stages.segmentation import scene as scene_module
from ttcvid.stages.segmentation import speed_changes
from ttcvid.stages.segmentation.body_views import BodyViews
from ttcvid.stages.segmentation.road_evidence import RoadMemory, gathered_evidence
from ttcvid.stages.segmentation.speed_changes import change_speed

FOCAL_PX, SIGMA_PX, N_VIEWS, DT_S = 700.0, 0.2, 20, 0.05
SINCE_S = DT_S * np.arange(1 - N_VIEWS, 1)
N_STATIC = 200


def scene_path():
    """Our way over the views: straight on at constant speed, without a turn."""
    path = -SINCE_S[:, None] * normalize(np.array([0.1, -0.05, 1.0]))
    return RigidPaths(np.repeat(np.eye(3)[None, None], N_VIEWS, axis=1), path[None])


def views_of(rng, change_hz, rate_hz=0.3, sigma_px=SIGMA_PX):
    """A track for each of ``change_hz (N,)``, on the path T(t) (1 + change t); ``rate_hz`` is speed over depth."""
    n = len(change_hz)
    place = np.column_stack([rng.uniform(-0.3, 0.3, (n, 2)), np.ones(n)])
    path = scene_path().path[0][:, None] * (1.0 + np.outer(SINCE_S, change_hz))[..., None]
    there = place + np.reshape(rate_hz * np.ones(n), (-1, 1)) * path
    xy = there[..., :2] / there[..., 2:] + sigma_px / FOCAL_PX * rng.normal(size=(N_VIEWS, n, 2))
    rays = normalize(np.concatenate([xy, np.ones((N_VIEWS, n, 1))], axis=2))
    per_px, every, t_s = np.full(n, 1.0 / FOCAL_PX), np.ones(n, dtype=bool), DT_S * np.arange(N_VIEWS)
    noise, xy_px = max(sigma_px, 0.01) * per_px, FOCAL_PX * xy[-1]
    return BodyViews(rays, views_by_track(rays), noise, per_px, xy_px, t_s, FOCAL_PX, every, 32.0, 0.25)


def fit_of(views):
    return fit_on_paths(views.points(np.arange(len(views.xy_px))), scene_path())


def told(views, key, is_asked=None):
    is_asked = np.ones(len(key), dtype=bool) if is_asked is None else is_asked
    return change_speed(views, scene_path(), fit_of(views), key, is_asked)


def a_street(rng, *things, change_hz=0.0, shuffled=True):
    """Changes and bodies of static tracks and of ``things``: how many tracks, and their change, each."""
    changes = [np.full(N_STATIC, change_hz), *(np.full(n, change) for n, change in things)]
    keys = [np.full(len(one), number) for number, one in enumerate(changes)]
    order = rng.permutation(sum(map(len, keys))) if shuffled else slice(None)
    return np.concatenate(changes)[order], np.concatenate(keys)[order]


@pytest.mark.parametrize("change_hz", [1e-3, -2e-3])
def test_the_change_of_exact_tracks_is_found(change_hz):
    views = views_of(np.random.default_rng(1), np.full(40, change_hz), 0.5, 0.0)
    score, info = speed_changes._scores(views, scene_path(), fit_of(views), np.arange(40))
    np.testing.assert_allclose(score.sum() / info.sum(), change_hz, rtol=0.05)


def test_what_static_tracks_show_is_noise_as_large_as_is_said():
    views = views_of(np.random.default_rng(2), np.zeros(2000), 0.4)
    score, info = speed_changes._scores(views, scene_path(), fit_of(views), np.arange(2000))
    sigmas = score / np.sqrt(info)
    assert abs(sigmas.mean()) < 0.1
    # Single large residuals lose weight, in those of noise alone too.
    assert 0.75 < sigmas.std() < 1.05


@pytest.mark.parametrize("change_hz", [0.4, -0.4])
def test_of_known_movers_those_that_change_their_speed_are_told(change_hz):
    rng = np.random.default_rng(3)
    change, key = a_street(rng, (20, 0.0), (20, change_hz), (20, 0.0))
    changes = told(views_of(rng, change), key)
    assert np.mean(changes[key == 2]) > 0.5
    assert not changes[key != 2].any()


def test_a_change_that_no_single_track_shows_is_shared_by_all():
    rng = np.random.default_rng(4)
    change, key = a_street(rng, (40, 0.02))
    views = views_of(rng, change)
    score, info = speed_changes._scores(views, scene_path(), fit_of(views), np.arange(len(key)))
    assert np.median(np.abs(score / np.sqrt(info))[key == 1]) < 1.5
    assert np.mean(told(views, key)[key == 1]) > 0.1


def test_single_tracks_that_do_not_change_are_not_told():
    rng = np.random.default_rng(5)
    change, key = a_street(rng, *[(1, 0.0)] * 200)
    assert np.mean(told(views_of(rng, change), key)[key > 0]) < 0.01


def test_what_no_mover_is_known_for_is_not_asked():
    rng = np.random.default_rng(6)
    change, key = a_street(rng, (20, 0.5))
    assert not told(views_of(rng, change), np.zeros_like(key)).any()


def test_far_background_is_no_part_of_a_mover_that_brakes():
    rng = np.random.default_rng(7)
    change, key = a_street(rng, (20, 0.5), shuffled=False)
    rate_hz = np.full(len(key), 0.3)
    change[-5:], rate_hz[-5:] = 0.0, 0.002
    changes = told(views_of(rng, change, rate_hz), key)
    assert np.mean(changes[N_STATIC:-5]) > 0.5
    assert not changes[-5:].any()


@pytest.mark.parametrize("change_hz", [0.01, 0.1, 0.3])
@pytest.mark.parametrize("n", [20, 80])
def test_where_the_whole_scene_seems_to_change_its_speed_a_mover_that_does_so_too_is_not_told(n, change_hz):
    """Own motion is wrong there."""
    for seed in range(5):
        rng = np.random.default_rng(seed)
        change, key = a_street(rng, (n, change_hz), change_hz=change_hz)
        assert not told(views_of(rng, change), key).any()


def test_noise_is_what_the_scene_shows_not_what_is_said():
    rng, n_told = np.random.default_rng(8), 0
    for _ in range(20):
        change, key = a_street(rng, (40, 0.0))
        views = views_of(rng, change)
        n_told += told(replace(views, sigma_norm=0.25 * views.sigma_norm), key).any()
    assert n_told <= 1


def test_frozen_tracks_short_ones_and_those_not_asked_have_no_say():
    rng = np.random.default_rng(9)
    change, key = a_street(rng, (30, 0.6), shuffled=False)
    views, is_asked = views_of(rng, change), np.ones(len(key), dtype=bool)
    rays, is_free = views.rays.copy(), np.ones(len(key), dtype=bool)
    is_asked[-10:], is_free[-20:-10], rays[:-5, -30:-20] = False, False, np.nan
    views = replace(views, rays=rays, rays_by_track=views_by_track(rays), is_free=is_free)
    assert not told(views, key, is_asked).any()


def test_views_in_which_a_track_is_not_seen_do_not_matter():
    rng = np.random.default_rng(9)
    change, key = a_street(rng, (30, 0.6))
    views = views_of(rng, change)
    rays = views.rays.copy()
    rays[::3, key == 1] = np.nan
    changes = told(replace(views, rays=rays, rays_by_track=views_by_track(rays)), key)
    assert np.mean(changes[key == 1]) > 0.5
    assert not changes[key == 0].any()


def test_a_street_alone_and_no_tracks_at_all():
    rng = np.random.default_rng(10)
    assert not told(views_of(rng, np.zeros(30)), np.ones(30, dtype=np.int64)).any()
    assert told(views_of(rng, np.zeros(0)), np.zeros(0, dtype=np.int64)).shape == (0,)


def test_evidence_of_a_change_goes_with_its_track_and_fades():
    rng = np.random.default_rng(11)
    views, in_scene = views_of(rng, np.zeros(4)), np.zeros(4, dtype=bool)

    def next_frame(memory, track_id):
        key, aim = np.zeros(4, dtype=np.int64), np.zeros(2)
        return gathered_evidence(memory, np.array(track_id), views, fit_of(views), key, in_scene, aim)

    memory = replace(next_frame(RoadMemory(), [3, 5, 8, 9]), by_speed=np.array([0.0, 1.0, 0.0, 1.0]))
    np.testing.assert_array_equal(np.maximum(memory.evidence, memory.by_speed), [0.0, 1.0, 0.0, 1.0])
    memory = next_frame(memory, [5, 6, 9, 12])
    np.testing.assert_allclose(np.maximum(memory.evidence, memory.by_speed), [0.8, 0.0, 0.8, 0.0])
    for _ in range(3):
        memory = next_frame(memory, [5, 6, 9, 12])
    assert (np.maximum(memory.evidence, memory.by_speed) < scene_module._ENOUGH_EVIDENCE).all()


def test_a_track_that_shows_it_does_not_fit_the_scene():
    config, key, n_views = BodiesConfig(), np.array([0, 1, 1]), np.full(3, 20)
    road = RoadMemory(np.arange(3), np.zeros(3), np.array([0.0, 1.0, 0.0]))
    redchi = scene_module._with_contradictions(np.ones(3), road, np.zeros(3, dtype=bool), key, n_views, config)
    assert (redchi > config.scene_gate).tolist() == [False, True, False]
