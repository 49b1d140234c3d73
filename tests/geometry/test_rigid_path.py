"""Points on the path of one rigid thing, and what they show to be wrong with that path: exact, honest, robust."""

from dataclasses import dataclass

import numpy as np
import pytest

from ttcvid.geometry.estimation.rigid_motion import (
    PathPriors,
    Points,
    RigidPaths,
    fit_on_paths,
    refined_paths,
    surprise_of_newest,
    views_by_track,
)
from ttcvid.geometry.estimation.track_on_trajectory import straight_path
from ttcvid.geometry.rotation import normalize, rotation_from_vector, vector_from_rotation

T_S = -0.05 * np.arange(12.0)[::-1]
SIGMA = 0.2 / 720.0
NO_PRIOR = np.full(len(T_S), 1e3)
STRAIGHT = straight_path(normalize(np.array([0.2, 0.05, -1.0])), T_S)
BENT = STRAIGHT + 0.5 * T_S[:, None] ** 2 * np.array([0.6, 0.0, 0.3])
SPEED_M_S = 8.0
EYES = np.broadcast_to(np.eye(3), (len(T_S), 3, 3))


def points(n, rng):
    return np.column_stack([rng.uniform(-6, 6, n), rng.uniform(-3, 3, n), rng.uniform(8, 40, n)])


def seen(position, path, sigma=0.0, rng=None):
    """Views (L, N, 2) of points of a thing that was at `path` s of its speed."""
    place = position + SPEED_M_S * path[:, None]
    xy = place[..., :2] / place[..., 2:]
    return xy if rng is None else xy + sigma * rng.normal(size=xy.shape)


def sigmas(n, sigma=SIGMA):
    return np.full(n, sigma)


def points_of(xy, sigma_norm, thing=None):
    """All points of one thing, or each of its own."""
    n_views, n = xy.shape[:2]
    rays = normalize(np.concatenate([xy, np.ones((n_views, n, 1))], axis=2))
    thing = np.zeros(n, dtype=np.int64) if thing is None else thing
    return Points(views_by_track(rays), sigma_norm, T_S[-n_views:], np.arange(n), thing)


def not_turned(paths):
    return RigidPaths(np.broadcast_to(np.eye(3), (*paths.shape[:2], 3, 3)).copy(), paths)


def fit_on_path(xy, path, sigma_norm, rate_hz=None, least_rate_hz=0.0):
    """All points on the path of one thing."""
    return fit_on_paths(points_of(xy, sigma_norm), not_turned(path[None]), rate_hz, least_rate_hz)


def converged(xy, path, sigma=SIGMA):
    """Fitted from the last rates, as frame follows frame."""
    fit = fit_on_path(xy, path, sigmas(xy.shape[1], sigma))
    for _ in range(5):
        fit = fit_on_path(xy, path, sigmas(xy.shape[1], sigma), fit.rate_hz)
    return fit


def turned(xy, turn_rad):
    """Each view as a camera sees it that is turned by a small rotation."""
    rays = np.concatenate([xy, np.ones((*xy.shape[:2], 1))], axis=2)
    rays = np.einsum("lij,lnj->lni", rotation_from_vector(turn_rad), rays)
    return rays[..., :2] / rays[..., 2:]


@pytest.mark.parametrize("path", [STRAIGHT, BENT, -STRAIGHT, straight_path(np.array([1.0, 0.0, 0.0]), T_S)])
def test_places_and_rates_are_exact_without_noise(path):
    position = points(40, np.random.default_rng(1)) + np.array([0.0, 0.0, 6.0])
    fit = converged(seen(position, path), path)
    np.testing.assert_allclose(fit.place, position[:, :2] / position[:, 2:], atol=1e-9)
    np.testing.assert_allclose(fit.rate_hz, SPEED_M_S / position[:, 2], rtol=1e-9)
    np.testing.assert_allclose(fit.redchi, 0.0, atol=1e-9)
    assert (fit.n_views == len(T_S)).all()


def test_one_fit_from_nothing_is_near_enough_for_the_next_frame():
    position = points(40, np.random.default_rng(2))
    fit = fit_on_path(seen(position, STRAIGHT), STRAIGHT, sigmas(40))
    assert (np.abs(fit.rate_hz * position[:, 2] / SPEED_M_S - 1.0) < 0.01).all()


def test_errors_of_rates_are_as_large_as_is_said_and_the_misfit_of_what_moves_along_is_one():
    rng, pulls, redchi_of = np.random.default_rng(3), [], []
    position = points(50, rng)
    for _ in range(60):
        fit = converged(seen(position, BENT, SIGMA, rng), BENT)
        pulls.append((fit.rate_hz - SPEED_M_S / position[:, 2]) / fit.rate_sigma_hz)
        redchi_of.append(fit.redchi)
    # 3000 squares of normal variables: their mean is 1 within 0.026, 1 sigma.
    assert np.mean(np.square(pulls)) == pytest.approx(1.0, abs=0.11)
    assert np.mean(pulls) == pytest.approx(0.0, abs=0.08)
    assert np.mean(redchi_of) == pytest.approx(1.0, abs=0.05)


def test_a_point_that_moves_otherwise_has_a_large_misfit():
    rng = np.random.default_rng(4)
    position = points(30, rng)
    across = straight_path(normalize(np.array([1.0, 0.0, -1.0])), T_S)
    assert fit_on_path(seen(position, across, SIGMA, rng), STRAIGHT, sigmas(30)).redchi.min() > 5.0


def test_a_wild_view_hardly_moves_the_rate_and_does_not_count_by_its_square():
    position = points(30, np.random.default_rng(5))
    xy = seen(position, STRAIGHT)
    xy[4] += 100.0 * SIGMA
    fit = converged(xy, STRAIGHT)
    assert (np.abs(fit.rate_hz - SPEED_M_S / position[:, 2]) < 2.0 * fit.rate_sigma_hz).all()
    assert (fit.redchi < 2.0 * 3.0 * np.sqrt(2.0) * 100.0 / (2 * len(T_S) - 3)).all()


def test_views_that_are_missing_do_not_matter():
    position = points(30, np.random.default_rng(6))
    xy = seen(position, BENT)
    xy[:5] = np.nan
    xy[7] = np.nan
    fit = converged(xy, BENT)
    np.testing.assert_allclose(fit.rate_hz, SPEED_M_S / position[:, 2], rtol=1e-9)
    assert (fit.n_views == len(T_S) - 6).all()


def test_a_point_seen_once_or_not_now_has_no_result_and_no_misfit():
    xy = seen(points(3, np.random.default_rng(7)), STRAIGHT)
    xy[:-1, 0] = np.nan
    xy[-1, 1] = np.nan
    fit = fit_on_path(xy, STRAIGHT, sigmas(3))
    for values in (fit.place[:, 0], fit.rate_hz, fit.rate_sigma_hz):
        np.testing.assert_array_equal(np.isnan(values), [True, True, False])
    np.testing.assert_array_equal(fit.redchi[:2], 0.0)
    assert fit.n_views[0] == 1


def test_no_points_and_a_single_view_are_no_errors():
    none = fit_on_path(np.empty((len(T_S), 0, 2)), STRAIGHT, np.empty(0))
    assert none.place.shape == (0, 2)
    single = fit_on_path(np.zeros((1, 4, 2)), np.zeros((1, 3)), sigmas(4))
    assert np.isnan(single.rate_hz).all()
    after = refined(np.zeros((1, 4, 2)), np.zeros((1, 3)), np.ones(1), np.ones(1))
    assert not after.turn_rad.any()
    assert not after.path.any()


def test_a_thing_that_rests_beside_us_has_no_rate_and_that_is_said():
    xy = np.broadcast_to(np.array([[0.1, 0.0], [-0.2, 0.1]]), (len(T_S), 2, 2))
    fit = fit_on_path(xy, np.zeros_like(STRAIGHT), sigmas(2))
    assert np.isinf(fit.rate_sigma_hz).all()
    np.testing.assert_allclose(fit.place, xy[-1])
    np.testing.assert_allclose(fit.redchi, 0.0, atol=1e-12)


def test_nothing_lies_behind_the_camera():
    position = points(20, np.random.default_rng(8))
    fit = converged(seen(position, STRAIGHT), -STRAIGHT)
    assert (fit_on_path(seen(position, STRAIGHT), -STRAIGHT, sigmas(20), None, 0.0).rate_hz >= 0.0).all()
    assert (fit.rate_hz >= 0.0).all()
    least = 2.0 * float((SPEED_M_S / position[:, 2]).max())
    np.testing.assert_allclose(fit_on_path(seen(position, STRAIGHT), STRAIGHT, sigmas(20), None, least).rate_hz, least)


@dataclass(frozen=True)
class Refined:
    """One path after refinement: how far each view turned from where it was expected, in rad; path; rates."""

    turn_rad: np.ndarray
    path: np.ndarray
    rate_hz: np.ndarray


def refined(xy, path, turn_sigma_rad=NO_PRIOR, shift_sigma=NO_PRIOR, weight=None, n_steps=1, rate_hz=None):
    paths = not_turned(path[None])
    priors = PathPriors(paths.cam_R_past[0], turn_sigma_rad, shift_sigma)
    points = points_of(xy, sigmas(xy.shape[1]))
    after, rate_hz = refined_paths(points, paths, priors, np.array([n_steps]), weight, rate_hz)
    return Refined(-vector_from_rotation(after.cam_R_past[0]), after.path[0], rate_hz)


def test_nothing_is_corrected_where_nothing_is_wrong():
    position = points(60, np.random.default_rng(9))
    after = refined(seen(position, BENT), BENT, rate_hz=SPEED_M_S / position[:, 2])
    np.testing.assert_allclose(after.turn_rad, 0.0, atol=1e-8)
    np.testing.assert_allclose(after.path, BENT, atol=1e-8)
    np.testing.assert_allclose(after.rate_hz, SPEED_M_S / position[:, 2], rtol=1e-9)


def test_rotations_put_in_on_purpose_are_found_view_by_view():
    rng = np.random.default_rng(10)
    position = points(80, rng)
    turn_rad = 1e-4 * rng.normal(size=(len(T_S), 3))
    turn_rad[-1] = 0.0
    xy = turned(seen(position, STRAIGHT), turn_rad)
    after = refined(xy, STRAIGHT, np.full(len(T_S), 1e-2), np.full(len(T_S), 1e-4), n_steps=30)
    np.testing.assert_allclose(after.turn_rad, turn_rad, atol=2e-5)
    assert not after.turn_rad[-1].any()
    assert not after.path[-1].any()


def test_the_path_of_a_bend_comes_out_and_the_rotation_is_gone():
    rng = np.random.default_rng(11)
    position = points(80, rng)
    turn_rad = np.zeros((len(T_S), 3))
    turn_rad[:-1] = 3e-4 * rng.normal(size=(len(T_S) - 1, 3))
    xy = turned(seen(position, BENT), turn_rad)
    start = STRAIGHT * np.linalg.norm(BENT[0]) / np.linalg.norm(STRAIGHT[0])
    after = refined(xy, start, np.full(len(T_S), 1e-2), np.full(len(T_S), 0.3), n_steps=150)
    np.testing.assert_allclose(after.path, BENT, atol=1e-4)
    np.testing.assert_allclose(after.turn_rad, turn_rad, atol=1e-4)


def test_errors_of_corrections_fall_with_the_number_of_points():
    rng, spread = np.random.default_rng(12), {}
    for n in (40, 640):
        position = points(n, rng)
        rate_hz = SPEED_M_S / position[:, 2]
        found = [
            refined(seen(position, STRAIGHT, SIGMA, rng), STRAIGHT, rate_hz=rate_hz).turn_rad[:-1] for _ in range(25)
        ]
        spread[n] = np.sqrt(np.mean(np.square(found)))
    assert spread[40] / spread[640] == pytest.approx(4.0, rel=0.4)


@pytest.mark.parametrize("part", [0.1, 0.25])
def test_points_that_move_otherwise_hardly_turn_the_views(part):
    rng = np.random.default_rng(13)
    position = points(100, rng)
    rate_hz = SPEED_M_S / position[:, 2]
    xy = seen(position, STRAIGHT, SIGMA, rng)
    n_wild = int(100 * part)
    xy[:-1, :n_wild] += 0.1
    priors = np.full(len(T_S), 0.01), np.full(len(T_S), 0.1)
    assert np.abs(refined(xy, STRAIGHT, *priors, rate_hz=rate_hz).turn_rad).max() < 0.002
    without = np.arange(100) >= n_wild
    left_out = refined(xy, STRAIGHT, weight=without.astype(float), rate_hz=rate_hz)
    alone = refined(xy[:, without], STRAIGHT, rate_hz=rate_hz[without])
    np.testing.assert_allclose(left_out.turn_rad, alone.turn_rad, rtol=1e-9, atol=1e-15)


def test_without_points_a_thing_keeps_its_motion():
    after = refined(np.full((len(T_S), 5, 2), np.nan), BENT, n_steps=3)
    assert not after.turn_rad.any()
    np.testing.assert_array_equal(after.path, BENT)
    assert np.isnan(after.rate_hz).all()


def test_a_sharp_prior_holds_the_views_and_a_wide_one_lets_them_go():
    rng = np.random.default_rng(15)
    position = points(60, rng)
    turn_rad = np.zeros((len(T_S), 3))
    turn_rad[:-1, 1] = 1e-3
    xy, narrow, rate_hz = (
        turned(seen(position, STRAIGHT), turn_rad),
        np.full(len(T_S), 1e-8),
        SPEED_M_S / position[:, 2],
    )
    held = refined(xy, STRAIGHT, narrow, narrow, rate_hz=rate_hz, n_steps=20)
    free = refined(xy, STRAIGHT, np.full(len(T_S), 1e-1), narrow, rate_hz=rate_hz, n_steps=300)
    assert np.abs(held.turn_rad).max() < 1e-6
    np.testing.assert_allclose(free.turn_rad, turn_rad, atol=5e-5)


def test_a_sharp_prior_draws_a_path_straight_that_no_point_shows():
    """Points at infinity say nothing of a path."""
    xy = np.zeros((len(T_S), 5, 2))
    after = refined(xy, BENT, shift_sigma=np.full(len(T_S), 1e-3), rate_hz=np.zeros(5))
    np.testing.assert_allclose(after.path, BENT[0] * (T_S / T_S[0])[:, None], atol=1e-12)


def test_each_of_several_things_gets_what_it_would_get_alone():
    rng = np.random.default_rng(16)
    paths, thing = np.stack([STRAIGHT, BENT, -STRAIGHT]), rng.integers(0, 3, 60)
    position = points(60, rng) + np.array([0.0, 0.0, 6.0])
    xy = np.empty((len(T_S), 60, 2))
    for number, path in enumerate(paths):
        xy[:, thing == number] = seen(position[thing == number], path + 1e-3 * rng.normal(size=path.shape), SIGMA, rng)
    least, weight = rng.uniform(0.0, 0.5, 60), rng.uniform(0.0, 1.0, 60)
    priors = np.full(len(T_S), 1e-2), np.full(len(T_S), 1e-1)
    every = points_of(xy, sigmas(60), thing)
    fit = fit_on_paths(every, not_turned(paths), None, least)
    n_steps = np.array([2, 0, 1])
    after, rate_hz = refined_paths(every, not_turned(paths), PathPriors(EYES, *priors), n_steps, weight)
    for number, path in enumerate(paths):
        own = thing == number
        alone = fit_on_path(xy[:, own], path, sigmas(own.sum()), None, least[own])
        for name in ("place", "rate_hz", "rate_sigma_hz", "redchi", "n_views"):
            np.testing.assert_array_equal(getattr(fit, name)[own], getattr(alone, name))
        by_own = refined(xy[:, own], path, *priors, weight[own], n_steps[number])
        np.testing.assert_array_equal(-vector_from_rotation(after.cam_R_past[number]), by_own.turn_rad)
        np.testing.assert_array_equal(after.path[number], by_own.path)
        np.testing.assert_array_equal(rate_hz[own], by_own.rate_hz)


def test_a_thing_that_has_turned_is_expected_where_it_was_said_to_be():
    """Rotations far from the expected ones come back to them where the points say nothing against it."""
    turn_rad = np.linspace(1.2, 0.0, len(T_S))[:, None] * np.array([0.1, 0.9, -0.2])
    paths = RigidPaths(rotation_from_vector(turn_rad)[None], np.zeros((1, len(T_S), 3)))
    every = points_of(np.zeros((len(T_S), 5, 2)), sigmas(5, 1e6))
    priors = PathPriors(EYES, np.full(len(T_S), 1e-3), NO_PRIOR)
    after, _ = refined_paths(every, paths, priors, np.array([2]))
    np.testing.assert_allclose(after.cam_R_past[0], EYES, atol=1e-9)


def test_a_point_off_the_path_that_it_followed_is_told_from_one_that_goes_its_own_way():
    rng = np.random.default_rng(12)
    position = points(300, rng)
    on_path = seen(position, STRAIGHT, SIGMA, rng)
    displaced = on_path.copy()
    displaced[-1] += 30.0 * SIGMA
    other = seen(position, straight_path(normalize(np.array([1.0, 0.0, -0.2])), T_S), SIGMA, rng)
    rate_hz = SPEED_M_S / position[:, 2]
    calm, far, stray = (
        surprise_of_newest(points_of(xy, sigmas(300)), not_turned(STRAIGHT[None]), rate_hz)
        for xy in (on_path, displaced, other)
    )
    # The last view has no part in how well the earlier ones fit.
    np.testing.assert_array_equal(calm.past_redchi, far.past_redchi)
    assert 0.85 < calm.past_redchi.mean() < 1.15
    assert 1.5 < calm.chi2.mean() < 2.5
    assert np.median(far.chi2) > 300.0
    assert np.median(stray.past_redchi) > 100.0
    assert np.median(stray.line_chi2) < 2.5 < 100.0 < np.median(stray.chi2)
    few = surprise_of_newest(points_of(on_path[-3:], sigmas(300)), not_turned(STRAIGHT[None, -3:]), rate_hz)
    assert not few.chi2.any()
    assert not few.past_redchi.any()


def test_displaced_views_are_marked_where_later_ones_are_on_the_path_again():
    rng = np.random.default_rng(4)
    position = points(200, rng)
    xy = seen(position, STRAIGHT, SIGMA, rng)
    # Three views of twelve, none of them the last: 10 px in any direction.
    is_wrong = np.zeros(xy.shape[:2], dtype=bool)
    for track in range(200):
        is_wrong[rng.choice(len(T_S) - 1, 3, replace=False), track] = True
    angle = rng.uniform(0.0, 2.0 * np.pi, xy.shape[:2])
    displaced = xy + np.where(is_wrong, 10.0 / 720.0, 0.0)[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=2)
    rate_hz = SPEED_M_S / position[:, 2]
    marked = surprise_of_newest(points_of(displaced, sigmas(200)), not_turned(STRAIGHT[None]), rate_hz).is_past_off.T
    assert np.mean(marked[is_wrong]) > 0.9
    assert np.mean(marked[~is_wrong]) < 0.01


def test_hardly_a_view_of_what_has_left_the_path_for_good_is_displaced():
    """It stood with the scene, and has begun to move in the last five views. Some paths cross its own once more."""
    rng = np.random.default_rng(5)
    position = points(200, rng)
    xy = seen(position, STRAIGHT, SIGMA, rng)
    begun_s = np.maximum(T_S - T_S[-5], 0.0)
    xy[..., 0] += 40.0 / 720.0 * begun_s[:, None]
    marked = surprise_of_newest(
        points_of(xy, sigmas(200)), not_turned(STRAIGHT[None]), SPEED_M_S / position[:, 2]
    ).is_past_off
    assert np.mean(marked) < 0.02
