"""A mover that changes its speed along our way: what tells it from a static thing at another depth."""

import numpy as np
import pytest

from ttcvid.geometry.estimation.rigid_motion import RigidPaths, fit_on_paths, views_by_track
from ttcvid.geometry.rotation import normalize
from ttcvid.stages.segmentation import speed_changes
from ttcvid.stages.segmentation.body_views import BodyViews
from ttcvid.stages.segmentation.speed_changes import change_speed

FOCAL_PX, SIGMA_PX, N_VIEWS, DT_S = 700.0, 0.2, 20, 0.05
AHEAD = np.array([0.1, -0.05, 1.0])


def scene_path():
    """Our way over the views: straight on at constant speed, without a turn."""
    since_s = DT_S * np.arange(1 - N_VIEWS, 1)
    path = -since_s[:, None] * normalize(AHEAD)
    return RigidPaths(np.repeat(np.eye(3)[None, None], N_VIEWS, axis=1), path[None])


def views_of(rng, n, change_hz, rate_hz, sigma_px):
    """N tracks whose closing speed was ``1 + change_hz t`` times the present one; speed over depth is ``rate_hz``."""
    since_s = DT_S * np.arange(1 - N_VIEWS, 1)
    place = np.column_stack([rng.uniform(-0.3, 0.3, (n, 2)), np.ones(n)])
    path = scene_path().path[0][:, None] * (1.0 + np.outer(since_s, change_hz * np.ones(n)))[..., None]
    there = place + rate_hz * path
    xy = there[..., :2] / there[..., 2:] + sigma_px / FOCAL_PX * rng.normal(size=(N_VIEWS, n, 2))
    rays = normalize(np.concatenate([xy, np.ones((N_VIEWS, n, 1))], axis=2))
    per_px, every = np.full(n, 1.0 / FOCAL_PX), np.ones(n, dtype=bool)
    xy_px, t_s = FOCAL_PX * xy[-1], DT_S * np.arange(N_VIEWS)
    noise = max(sigma_px, 0.01) * per_px
    return BodyViews(rays, views_by_track(rays), noise, per_px, xy_px, t_s, FOCAL_PX, every, 32.0, 0.25)


def told(views, key):
    every = np.arange(len(views.xy_px))
    fit = fit_on_paths(views.points(every), scene_path())
    return change_speed(views, scene_path(), fit, key, np.ones(len(every), dtype=bool))


def scores(views):
    every = np.arange(len(views.xy_px))
    return speed_changes._scores(views, scene_path(), fit_on_paths(views.points(every), scene_path()), every)


@pytest.mark.parametrize("change_hz", [1e-3, -2e-3])
def test_the_change_of_exact_tracks_is_found(change_hz):
    score, info = scores(views_of(np.random.default_rng(1), 40, change_hz, 0.5, 0.0))
    np.testing.assert_allclose(score.sum() / info.sum(), change_hz, rtol=0.05)


def test_what_static_tracks_show_is_noise_as_large_as_is_said():
    score, info = scores(views_of(np.random.default_rng(2), 2000, 0.0, 0.4, SIGMA_PX))
    sigmas = score / np.sqrt(info)
    assert abs(sigmas.mean()) < 0.1
    # Single large residuals lose weight, in those of noise alone too.
    assert 0.75 < sigmas.std() < 1.05


def test_a_known_mover_that_brakes_is_told_from_the_scene_and_one_that_does_not_is_not():
    rng = np.random.default_rng(3)
    change_hz = np.where(np.arange(240) < 20, 0.5, 0.0)
    views = views_of(rng, 240, change_hz, 0.3, SIGMA_PX)
    key = np.where(np.arange(240) < 40, 1 + np.arange(240) // 20, 0)
    changes = told(views, key)
    assert np.mean(changes[:20]) > 0.5
    assert not changes[20:].any()


def test_what_no_mover_is_known_for_is_not_asked():
    views = views_of(np.random.default_rng(4), 60, 0.5, 0.3, SIGMA_PX)
    assert not told(views, np.zeros(60, dtype=np.int64)).any()


def test_where_the_whole_scene_seems_to_change_its_speed_a_mover_that_does_so_too_is_not_told():
    """Own motion is wrong there."""
    views = views_of(np.random.default_rng(5), 240, 0.3, 0.3, SIGMA_PX)
    assert not told(views, (np.arange(240) < 20).astype(np.int64)).any()
