"""State of a whole track: exact without noise, as good as the noise allows with it, over the window that fits."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from moving_points import moving_points, views

from ttcvid.geometry.estimation.track_state import MotionPlane, fit_whole_tracks

SIGMA = 0.2 / 720.0
T_S = -0.1 * np.arange(15.0)[::-1]


def in_plane(rays):
    return rays[..., :2] / rays[..., 2:]


def state_of(position, velocity):
    return np.concatenate([position[:, :2], velocity], axis=1) / position[:, 2:]


def many(position, velocity, n, rng, t_s=T_S, sigma=SIGMA):
    """N noisy tracks of one point, and its true state."""
    position, velocity = np.array([position]), np.array([velocity])
    xy = in_plane(views(position, velocity, t_s))
    return np.repeat(xy, n, axis=1) + sigma * rng.normal(size=(len(t_s), n, 2)), state_of(position, velocity)[0]


@given(moving_points(), st.booleans(), st.booleans())
def test_state_is_exact_without_noise_on_one_side_of_the_reference_and_on_both(scene, both_sides, has_gaps):
    position, velocity = scene
    t_s = np.linspace(-0.5, 0.5, 9) if both_sides else np.array([-1.1, -0.9, -0.4, -0.35, 0.0])
    xy = in_plane(views(position, velocity, t_s))
    if has_gaps:
        xy[1] = np.nan
    found = fit_whole_tracks(xy, t_s, np.full(len(position), 1e-7))
    np.testing.assert_allclose(found.state, state_of(position, velocity), rtol=1e-7, atol=1e-8)
    assert (found.n_frames == len(t_s) - has_gaps).all()


def test_covariance_is_that_of_noisy_draws_and_chi_square_that_of_noise():
    xy, truth = many((6.0, 2.0, 25.0), (-1.0, 0.5, -8.0), 4000, np.random.default_rng(1))
    found = fit_whole_tracks(xy, T_S, np.full(4000, SIGMA))
    error = found.state - truth
    scale = np.sqrt(np.diag(found.cov[0]))
    np.testing.assert_allclose(np.cov((error / scale).T), found.cov[0] / np.outer(scale, scale), atol=0.08)
    assert np.abs(error.mean(axis=0) / scale).max() < 0.1
    assert np.mean(found.chi2) == pytest.approx(2 * found.n_frames[0] - 5, rel=0.03)


def test_information_is_that_of_the_covariance():
    xy, _ = many((6.0, 2.0, 25.0), (-1.0, 0.5, -8.0), 3, np.random.default_rng(2))
    found = fit_whole_tracks(xy, T_S, np.full(3, SIGMA))
    product = found.info_w @ found.cov[:, 2:, 2:]
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(3), (3, 3, 3)), atol=1e-6)


def test_far_away_the_linear_solve_is_biased_and_this_is_not():
    """k = 60 frames, 0.5 px: the linear solve alone loses nine tenths of 1 / ttc_z."""
    xy, truth = many((4.5, 1.0, 60.0), (0.0, 0.0, -10.0), 3000, np.random.default_rng(3), -0.1 * np.arange(20.0), 7e-4)
    found = fit_whole_tracks(xy, -0.1 * np.arange(20.0), np.full(3000, 7e-4))
    bound = np.sqrt(np.median(found.cov[:, 4, 4]))
    assert abs(found.state[:, 4].mean() - truth[4]) < 0.1 * bound
    assert np.sqrt(np.mean((found.state[:, 4] - truth[4]) ** 2)) < 1.1 * bound


def test_two_views_inform_about_all_motions_that_explain_them_alike():
    position, velocity = np.array([[6.0, 2.0, 25.0]]), np.array([[-1.0, 0.5, -8.0]])
    t_s = np.array([-0.4, 0.0])
    found = fit_whole_tracks(in_plane(views(position, velocity, t_s)), t_s, np.array([SIGMA]))
    assert found.state[0, 4] == pytest.approx(0.0, abs=1e-9)
    assert np.isnan(found.cov).all()
    sizes = np.linalg.eigvalsh(found.info_w[0])
    assert sizes[0] < 1e-9 * sizes[1]
    off = state_of(position, velocity)[0, 2:] - found.state[0, 2:]
    assert off @ found.info_w[0] @ off < 1e-12 * np.trace(found.info_w[0])


def test_too_little_to_say_anything_is_no_number():
    xy = np.full((4, 3, 2), np.nan)
    xy[-1, 1] = 0.1
    xy[:, 2] = 0.1
    found = fit_whole_tracks(xy, T_S[-4:], np.array([SIGMA, SIGMA, 0.0]))
    assert np.isnan(found.state).all()
    assert (found.info_w == 0.0).all()
    assert found.n_frames.tolist() == [0, 1, 0]


def test_where_nothing_tells_the_depth_the_covariance_is_not_known_with_a_plane_or_without():
    """A point that keeps its place exactly: any motion along its ray explains it."""
    xy = np.tile([0.3, 0.2], (len(T_S), 1, 1))
    level = np.array([0.0, 1.0, 0.0])
    plane = MotionPlane(level, np.radians(0.5) ** 2 * (np.eye(3) - np.outer(level, level)))
    for found in (
        fit_whole_tracks(xy, T_S, np.array([SIGMA])),
        fit_whole_tracks(xy, T_S, np.array([SIGMA]), plane=plane),
    ):
        np.testing.assert_allclose(found.state[0], [0.3, 0.2, 0.0, 0.0, 0.0], atol=1e-12)
        assert np.isnan(found.cov).all()
        assert np.isfinite(found.info_w).all()


def test_a_plane_leaves_the_covariance_of_noisy_points_at_rest_positive():
    xy = np.array([0.3, 0.2]) + SIGMA * np.random.default_rng(8).normal(size=(len(T_S), 500, 2))
    level = np.array([0.0, 1.0, 0.0])
    plane = MotionPlane(level, np.radians(0.5) ** 2 * (np.eye(3) - np.outer(level, level)))
    cov = fit_whole_tracks(xy, T_S, np.full(500, SIGMA), plane=plane).cov
    assert (np.einsum("njj->nj", cov) > 0.0).all()


def test_a_constant_velocity_keeps_its_window():
    xy, _ = many((6.0, 2.0, 25.0), (-1.0, 0.5, -8.0), 4000, np.random.default_rng(4))
    found = fit_whole_tracks(xy, T_S, np.full(4000, SIGMA))
    assert np.mean(found.n_frames == len(T_S)) > 0.997


def test_the_window_ends_where_the_velocity_changed():
    """Straight ahead, then to the side: six frames of the new velocity are in the window, none of the old."""
    rng, n = np.random.default_rng(5), 500
    position, before, after = np.array([6.0, 2.0, 25.0]), np.array([0.0, 0.0, -8.0]), np.array([6.0, 0.0, -6.0])
    place = position + np.where(T_S > -0.55, T_S, -0.55)[:, None] * after + np.minimum(T_S + 0.55, 0)[:, None] * before
    xy = np.repeat(in_plane(place)[:, None], n, axis=1) + SIGMA * rng.normal(size=(len(T_S), n, 2))
    found = fit_whole_tracks(xy, T_S, np.full(n, SIGMA))
    assert 6 <= np.median(found.n_frames) <= 7
    truth = state_of(position[None], after[None])[0]
    off = (found.state[:, 2] - truth[2]) / np.sqrt(found.cov[:, 2, 2])
    assert np.abs(off).mean() < 1.5


def test_outliers_lose_their_weight():
    rng, n = np.random.default_rng(6), 1000
    xy, truth = many((6.0, 2.0, 25.0), (-1.0, 0.5, -8.0), n, rng)
    xy[rng.integers(1, len(T_S) - 1, n), np.arange(n)] += 12.0 * SIGMA
    found = fit_whole_tracks(xy, T_S, np.full(n, SIGMA))
    off = (found.state[:, 4] - truth[4]) / np.sqrt(found.cov[:, 4, 4])
    assert np.mean(np.abs(off) < 1.645) > 0.8


@given(moving_points(), st.floats(0.1, 10.0))
def test_scaling_time_scales_rates_and_mirroring_mirrors(scene, factor):
    position, velocity = scene
    t_s, sigma = np.array([-0.9, -0.5, -0.2, 0.0]), np.full(len(position), 1e-6)
    xy = in_plane(views(position, velocity, t_s))
    plain = fit_whole_tracks(xy, t_s, sigma).state
    slower = fit_whole_tracks(xy, factor * t_s, sigma).state
    mirrored = fit_whole_tracks(xy * (-1.0, 1.0), t_s, sigma).state
    np.testing.assert_allclose(slower[:, 2:], plain[:, 2:] / factor, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(mirrored, plain * (-1, 1, -1, 1, 1), rtol=1e-6, atol=1e-9)


def test_wrong_shapes_are_named():
    with pytest.raises(ValueError, match=r"expected xy \(L, N, 2\)"):
        fit_whole_tracks(np.zeros((3, 2, 2)), np.zeros(4), np.ones(2))
