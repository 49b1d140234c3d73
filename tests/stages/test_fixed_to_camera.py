"""What stays on its pixels: fixed to the camera, or a thing that keeps its distance while the camera turns."""

from dataclasses import replace

import numpy as np
import pytest

from ttcvid.geometry.estimation.rigid_motion import views_by_track
from ttcvid.geometry.rotation import normalize, rotation_from_vector
from ttcvid.stages.segmentation.body_views import BodyViews
from ttcvid.stages.segmentation.fixed_to_camera import ride_odds

FOCAL_PX, SIGMA_PX, N_TRACKS = 700.0, 0.1, 40


def turns_of(n_views, shake_px, rng):
    """Rotations from each view to the last, of a camera that shakes: (L, 3, 3)."""
    cam_R_world = rotation_from_vector(rng.normal(scale=shake_px / FOCAL_PX, size=(n_views, 3)))
    return cam_R_world[-1] @ cam_R_world.transpose(0, 2, 1)


def views_of(xy, rng, sigma_px=SIGMA_PX):
    """Tracks at places (L, N, 2) in the plane z = 1, with noise."""
    n_views, n = xy.shape[:2]
    xy = xy + sigma_px / FOCAL_PX * rng.normal(size=xy.shape)
    rays = normalize(np.concatenate([xy, np.ones((n_views, n, 1))], axis=2))
    every, per_px = np.ones(n, dtype=bool), np.full(n, 1.0 / FOCAL_PX)
    t_s = 0.05 * np.arange(n_views)
    return BodyViews(rays, views_by_track(rays), sigma_px * per_px, per_px, xy[-1], t_s, FOCAL_PX, every, 32.0, 0.25)


def outside(cam_R_past, xy_now):
    """Places (L, N, 2) of what does not move but by the turns of the camera."""
    rays = np.column_stack([xy_now, np.ones(len(xy_now))]) @ cam_R_past
    return rays[:, :, :2] / rays[:, :, 2:]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_turns_tell_what_is_fixed_to_the_camera_from_what_keeps_its_distance(seed):
    rng = np.random.default_rng(seed)
    cam_R_past, xy = turns_of(15, 0.2, rng), rng.uniform(-0.3, 0.3, (N_TRACKS, 2))
    fixed = ride_odds(views_of(np.repeat(xy[None], 15, axis=0), rng), cam_R_past)
    ahead = ride_odds(views_of(outside(cam_R_past, xy), rng), cam_R_past)
    assert np.mean(fixed > 1.0) > 0.9
    assert np.mean(ahead < -1.0) > 0.9


@pytest.mark.parametrize(("n_views", "shake_px"), [(15, 0.0), (3, 0.2)])
def test_without_turns_and_with_three_views_nobody_can_tell(n_views, shake_px):
    rng = np.random.default_rng(4)
    cam_R_past, xy = turns_of(n_views, shake_px, rng), rng.uniform(-0.3, 0.3, (N_TRACKS, 2))
    odds = ride_odds(views_of(np.repeat(xy[None], n_views, axis=0), rng, 0.05), cam_R_past)
    np.testing.assert_allclose(odds, 0.0, atol=1e-3)


def test_the_rim_of_a_spot_is_fixed_although_what_passes_behind_it_draws_its_tracks_along():
    rng = np.random.default_rng(7)
    cam_R_past, xy = turns_of(15, 0.2, rng), rng.uniform(-0.3, 0.3, (N_TRACKS, 2))
    steps = 0.1 / FOCAL_PX * np.arange(-14.0, 1.0)[:, None, None] * (1.0, 0.0)
    assert np.mean(ride_odds(views_of(xy + steps, rng), cam_R_past) > 1.0) > 0.9


def test_what_leaves_its_pixel_or_is_seen_twice_only_is_not_fixed():
    rng = np.random.default_rng(5)
    xy = rng.uniform(-0.3, 0.3, (N_TRACKS, 2))
    steps = np.linspace(0.0, 1.0, 10)[:, None, None] * (4.0 / FOCAL_PX, 0.0)
    assert np.isneginf(ride_odds(views_of(xy + steps, rng), np.repeat(np.eye(3)[None], 10, axis=0))).all()
    two = views_of(np.repeat(xy[None], 2, axis=0), rng)
    assert np.isneginf(ride_odds(two, np.repeat(np.eye(3)[None], 2, axis=0))).all()


def test_views_that_are_missing_count_for_nothing():
    """Of tracks that are missing now and then, and at first, the odds are those of a history of their views alone."""
    rng = np.random.default_rng(6)
    cam_R_past, xy = turns_of(15, 0.2, rng), rng.uniform(-0.3, 0.3, (N_TRACKS, 2))
    whole = views_of(np.repeat(xy[None], 15, axis=0), rng)
    is_seen = np.ones(15, dtype=bool)
    is_seen[[1, 6, 7]] = False
    rays = np.where(is_seen[:, None, None], whole.rays, np.nan)
    gaps = replace(whole, rays=rays, rays_by_track=views_by_track(rays))
    seen = replace(whole, rays=rays[is_seen], rays_by_track=views_by_track(rays[is_seen]), t_s=whole.t_s[is_seen])
    odds = ride_odds(gaps, cam_R_past)
    np.testing.assert_allclose(odds, ride_odds(seen, cam_R_past[is_seen]), rtol=1e-6, atol=1e-6)
    assert np.mean(odds > 1.0) > 0.8
