"""The noise of a track with the error of the camera."""

from dataclasses import replace

import numpy as np
import pytest
from relative_motion import CAMERA, FOCAL_PX, history_of

from ttcvid.geometry.rotation import rotation_from_vector
from ttcvid.stages.segmentation.body_views import body_views

N_VIEWS, LINK_PX = 11, 32.0
POINTS_M = np.array([[1.0, 0.0, 20.0], [-2.0, 1.0, 30.0]])


def sigmas_px(axis, origin="focal_px", sigma_px=0.2, views=slice(0, N_VIEWS)):
    """Noise of two tracks, of which the second is seen in some views only, while the camera turns by 0.02 a view."""
    history = history_of(POINTS_M, np.zeros(3), 0.1 * np.arange(N_VIEWS), sigma_px=sigma_px)
    turns = rotation_from_vector(0.02 * np.arange(N_VIEWS)[:, None] * np.asarray(axis))
    rays = history.rays.copy()
    is_hidden = np.ones(N_VIEWS, dtype=bool)
    is_hidden[views] = False
    rays[is_hidden, 1] = np.nan
    camera = replace(CAMERA, origin=origin, focal_sigma_px=10.0 if origin == "found" else None)
    history = replace(history, cam_R_past=turns, rays=rays, sigma_px=np.full(2, sigma_px), camera=camera)
    found = body_views(history, np.ones(2, dtype=bool), LINK_PX)
    return found.sigma_norm * FOCAL_PX


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.6, 0.8, 0.0)])
def test_a_turn_adds_three_per_cent_of_its_spread_over_the_views_of_a_track(axis):
    spread_rad = [0.02 * np.std(np.arange(n)) / np.sqrt(2.0) for n in (N_VIEWS, 4)]
    expected_px = np.hypot(0.2, 0.03 * FOCAL_PX * np.array(spread_rad))
    np.testing.assert_allclose(sigmas_px(axis, views=slice(3, 7)), expected_px, rtol=1e-6)


@pytest.mark.parametrize("views", [slice(0, 1), slice(0, 0)])
def test_a_turn_about_the_optical_axis_or_of_one_view_adds_nothing(views):
    np.testing.assert_allclose(sigmas_px((0.0, 0.0, 1.0)), 0.2, rtol=1e-6)
    assert sigmas_px((0.0, 1.0, 0.0), views=views)[1] == pytest.approx(0.2)


@pytest.mark.parametrize(("origin", "least_px"), [("focal_px", 0.1), ("assumed", 640 / 1920), ("found", 640 / 1920)])
def test_positions_have_the_error_of_the_lens_at_least(origin, least_px):
    np.testing.assert_allclose(sigmas_px((0.0, 0.0, 0.0), origin, sigma_px=0.01), least_px, rtol=1e-6)
