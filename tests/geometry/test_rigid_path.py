"""Points on the path of one rigid thing, and what they show to be wrong with that path: exact, honest, robust."""

import numpy as np
import pytest

from ttcvid.geometry.rigid_path import corrected_views, fit_on_paths
from ttcvid.geometry.rotation import normalize, rotation_from_vector
from ttcvid.geometry.whole_track_on_path import straight_path

T_S = -0.05 * np.arange(12.0)[::-1]
SIGMA = 0.2 / 720.0
NO_PRIOR = np.full(len(T_S), 1e3)
STRAIGHT = straight_path(normalize(np.array([0.2, 0.05, -1.0])), T_S)
BENT = STRAIGHT + 0.5 * T_S[:, None] ** 2 * np.array([0.6, 0.0, 0.3])
SPEED_M_S = 8.0


def points(n, rng):
    return np.column_stack([rng.uniform(-6, 6, n), rng.uniform(-3, 3, n), rng.uniform(8, 40, n)])


def seen(position, path, sigma=0.0, rng=None):
    """Views (L, N, 2) of points of a thing that was at `path` s of its speed."""
    place = position + SPEED_M_S * path[:, None]
    xy = place[..., :2] / place[..., 2:]
    return xy if rng is None else xy + sigma * rng.normal(size=xy.shape)


def sigmas(n, sigma=SIGMA):
    return np.full(n, sigma)


def one_thing(xy):
    return np.zeros(xy.shape[1], dtype=np.int64)


def fit_on_path(xy, path, sigma_norm, rate_hz=None, least_rate_hz=0.0):
    """All points on the path of one thing."""
    return fit_on_paths(xy, path[None], one_thing(xy), sigma_norm, rate_hz, least_rate_hz)


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
    np.testing.assert_allclose(fit.misfit, 0.0, atol=1e-9)
    assert (fit.n_views == len(T_S)).all()


def test_one_fit_from_nothing_is_near_enough_for_the_next_frame():
    position = points(40, np.random.default_rng(2))
    fit = fit_on_path(seen(position, STRAIGHT), STRAIGHT, sigmas(40))
    assert (np.abs(fit.rate_hz * position[:, 2] / SPEED_M_S - 1.0) < 0.01).all()


def test_errors_of_rates_are_as_large_as_is_said_and_the_misfit_of_what_moves_along_is_one():
    rng, pulls, misfits = np.random.default_rng(3), [], []
    position = points(50, rng)
    for _ in range(60):
        fit = converged(seen(position, BENT, SIGMA, rng), BENT)
        pulls.append((fit.rate_hz - SPEED_M_S / position[:, 2]) / fit.rate_sigma_hz)
        misfits.append(fit.misfit)
    # 3000 squares of normal variables: their mean is 1 within 0.026, 1 sigma.
    assert np.mean(np.square(pulls)) == pytest.approx(1.0, abs=0.11)
    assert np.mean(pulls) == pytest.approx(0.0, abs=0.08)
    assert np.mean(misfits) == pytest.approx(1.0, abs=0.05)


def test_a_point_that_moves_otherwise_has_a_large_misfit():
    rng = np.random.default_rng(4)
    position = points(30, rng)
    across = straight_path(normalize(np.array([1.0, 0.0, -1.0])), T_S)
    assert fit_on_path(seen(position, across, SIGMA, rng), STRAIGHT, sigmas(30)).misfit.min() > 5.0


def test_a_wild_view_hardly_moves_the_rate_and_does_not_count_by_its_square():
    position = points(30, np.random.default_rng(5))
    xy = seen(position, STRAIGHT)
    xy[4] += 100.0 * SIGMA
    fit = converged(xy, STRAIGHT)
    assert (np.abs(fit.rate_hz - SPEED_M_S / position[:, 2]) < 2.0 * fit.rate_sigma_hz).all()
    assert (fit.misfit < 2.0 * 3.0 * np.sqrt(2.0) * 100.0 / (2 * len(T_S) - 3)).all()


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
    np.testing.assert_array_equal(fit.misfit[:2], 0.0)
    assert fit.n_views[0] == 1


def test_no_points_and_a_single_view_are_no_errors():
    none = fit_on_path(np.empty((len(T_S), 0, 2)), STRAIGHT, np.empty(0))
    assert none.place.shape == (0, 2)
    single = fit_on_path(np.zeros((1, 4, 2)), np.zeros((1, 3)), sigmas(4))
    assert np.isnan(single.rate_hz).all()
    turn, shift = corrections(np.zeros((1, 4, 2)), np.zeros((1, 3)), single, np.ones(1), np.ones(1))
    assert not turn.any()
    assert not shift.any()


def test_a_thing_that_rests_beside_us_has_no_rate_and_that_is_said():
    xy = np.broadcast_to(np.array([[0.1, 0.0], [-0.2, 0.1]]), (len(T_S), 2, 2))
    fit = fit_on_path(xy, np.zeros_like(STRAIGHT), sigmas(2))
    assert np.isinf(fit.rate_sigma_hz).all()
    np.testing.assert_allclose(fit.place, xy[-1])
    np.testing.assert_allclose(fit.misfit, 0.0, atol=1e-12)


def test_nothing_lies_behind_the_camera():
    position = points(20, np.random.default_rng(8))
    fit = converged(seen(position, STRAIGHT), -STRAIGHT)
    assert (fit_on_path(seen(position, STRAIGHT), -STRAIGHT, sigmas(20), None, 0.0).rate_hz >= 0.0).all()
    assert (fit.rate_hz >= 0.0).all()
    least = 2.0 * float((SPEED_M_S / position[:, 2]).max())
    np.testing.assert_allclose(fit_on_path(seen(position, STRAIGHT), STRAIGHT, sigmas(20), None, least).rate_hz, least)


def _none(n_views):
    return np.zeros((n_views, 3)), np.zeros((n_views, 3))


def corrections(xy, path, fit, turn_sigma_rad=NO_PRIOR, shift_sigma=NO_PRIOR, weight=None, off=None):
    n = xy.shape[1]
    weight = np.ones(n) if weight is None else weight
    turned_rad, shifted = _none(len(path)) if off is None else off
    turn, shift = corrected_views(
        xy,
        path[None],
        one_thing(xy),
        fit,
        sigmas(n),
        weight,
        turned_rad[None],
        shifted[None],
        turn_sigma_rad,
        shift_sigma,
    )
    return turn[0], shift[0]


def test_nothing_is_corrected_where_nothing_is_wrong():
    xy = seen(points(60, np.random.default_rng(9)), BENT)
    turn, shift = corrections(xy, BENT, converged(xy, BENT))
    np.testing.assert_allclose(turn, 0.0, atol=1e-8)
    np.testing.assert_allclose(shift, 0.0, atol=1e-8)


def test_a_rotation_and_a_shift_put_in_on_purpose_are_found_view_by_view():
    """One Gauss-Newton step: what remains is of second order."""
    rng = np.random.default_rng(10)
    position = points(80, rng)
    fit = converged(seen(position, STRAIGHT), STRAIGHT)
    turn_rad, shift = 1e-4 * rng.normal(size=(len(T_S), 3)), 1e-3 * rng.normal(size=(len(T_S), 3))
    turn_rad[-1] = shift[-1] = 0.0
    xy = turned(seen(position, STRAIGHT + shift), turn_rad)
    found_turn, found_shift = corrections(xy, STRAIGHT, fit)
    np.testing.assert_allclose(found_turn, turn_rad, atol=3e-6)
    np.testing.assert_allclose(found_shift, shift, atol=3e-5)
    assert not found_turn[-1].any()
    assert not found_shift[-1].any()


def test_fitted_and_corrected_in_turn_the_path_of_a_bend_comes_out_and_the_rotation_is_gone():
    rng = np.random.default_rng(11)
    position = points(80, rng)
    turn_rad = np.zeros((len(T_S), 3))
    turn_rad[:-1] = 3e-4 * rng.normal(size=(len(T_S) - 1, 3))
    xy, path, rate_hz = turned(seen(position, BENT), turn_rad), STRAIGHT.copy(), None
    shift_sigma, turn_sigma = np.full(len(T_S), 0.3), np.full(len(T_S), 1e-2)
    gone, moved = _none(len(T_S))
    for _ in range(150):
        fit = fit_on_path(xy, path, sigmas(80), rate_hz)
        turn, shift = corrections(xy, path, fit, turn_sigma, shift_sigma, off=(gone, moved))
        xy, path, rate_hz = turned(xy, -turn), path + shift, fit.rate_hz
        gone, moved = gone + turn, moved + shift
        path = path * np.linalg.norm(BENT[0]) / np.linalg.norm(path[0])
    assert np.median(fit_on_path(xy, path, sigmas(80), rate_hz).misfit) < 1e-4
    np.testing.assert_allclose(path, BENT, atol=1e-4)
    np.testing.assert_allclose(gone, turn_rad, atol=1e-4)


def test_errors_of_corrections_fall_with_the_number_of_points():
    rng, spread = np.random.default_rng(12), {}
    for n in (40, 640):
        position = points(n, rng)
        fit = converged(seen(position, STRAIGHT), STRAIGHT)
        found = [corrections(seen(position, STRAIGHT, SIGMA, rng), STRAIGHT, fit)[0][:-1] for _ in range(25)]
        spread[n] = np.sqrt(np.mean(np.square(found)))
    assert spread[40] / spread[640] == pytest.approx(4.0, rel=0.4)


@pytest.mark.parametrize("part", [0.1, 0.25])
def test_points_that_move_otherwise_hardly_turn_the_views(part):
    rng = np.random.default_rng(13)
    position = points(100, rng)
    fit = converged(seen(position, STRAIGHT), STRAIGHT)
    xy = seen(position, STRAIGHT, SIGMA, rng)
    n_wild = int(100 * part)
    xy[:-1, :n_wild] += 0.1
    turn, _ = corrections(xy, STRAIGHT, fit, np.full(len(T_S), 0.01), np.full(len(T_S), 0.1))
    assert np.abs(turn).max() < 0.002
    without = np.arange(100) >= n_wild
    turn, _ = corrections(xy, STRAIGHT, fit, weight=without.astype(float))
    np.testing.assert_array_equal(turn, corrections(xy[:, without], STRAIGHT, fit_of(fit, without))[0])


def fit_of(fit, mask):
    return type(fit)(*(getattr(fit, name)[mask] for name in type(fit).__dataclass_fields__))


def test_without_points_views_go_back_to_where_they_are_expected():
    xy = np.full((len(T_S), 5, 2), np.nan)
    fit = fit_on_path(xy, STRAIGHT, sigmas(5))
    rng = np.random.default_rng(14)
    off = rng.normal(size=(2, len(T_S), 3))
    turn, shift = corrections(xy, STRAIGHT, fit, np.full(len(T_S), 0.1), np.full(len(T_S), 0.1), off=tuple(off))
    np.testing.assert_allclose(turn[:-1], -off[0, :-1])
    np.testing.assert_allclose(shift[:-1], -off[1, :-1])


def test_a_sharp_prior_holds_the_views_and_a_wide_one_lets_them_go():
    rng = np.random.default_rng(15)
    position = points(60, rng)
    fit = converged(seen(position, STRAIGHT), STRAIGHT)
    turn_rad = np.zeros((len(T_S), 3))
    turn_rad[:-1, 1] = 1e-3
    xy = turned(seen(position, STRAIGHT), turn_rad)
    held, _ = corrections(xy, STRAIGHT, fit, np.full(len(T_S), 1e-8), np.full(len(T_S), 1e-8))
    free, _ = corrections(xy, STRAIGHT, fit, np.full(len(T_S), 1e-1), np.full(len(T_S), 1e-8))
    assert np.abs(held).max() < 1e-6
    np.testing.assert_allclose(free, turn_rad, atol=2e-5)


def test_each_of_several_things_gets_what_it_would_get_alone():
    rng = np.random.default_rng(16)
    paths, thing = np.stack([STRAIGHT, BENT, -STRAIGHT]), rng.integers(0, 3, 60)
    position = points(60, rng) + np.array([0.0, 0.0, 6.0])
    xy = np.empty((len(T_S), 60, 2))
    for number, path in enumerate(paths):
        xy[:, thing == number] = seen(position[thing == number], path + 1e-3 * rng.normal(size=path.shape), SIGMA, rng)
    least, weight = rng.uniform(0.0, 0.5, 60), rng.uniform(0.0, 1.0, 60)
    turned_rad, shifted = 1e-3 * rng.normal(size=(2, *paths.shape))
    priors = np.full(len(T_S), 1e-2), np.full(len(T_S), 1e-1)
    fit = fit_on_paths(xy, paths, thing, sigmas(60), None, least)
    turn, shift = corrected_views(xy, paths, thing, fit, sigmas(60), weight, turned_rad, shifted, *priors)
    for number, path in enumerate(paths):
        own = thing == number
        alone = fit_on_path(xy[:, own], path, sigmas(own.sum()), None, least[own])
        for name in ("place", "rate_hz", "rate_sigma_hz", "misfit", "n_views"):
            np.testing.assert_array_equal(getattr(fit, name)[own], getattr(alone, name))
        off = turned_rad[number], shifted[number]
        by_own = corrections(xy[:, own], path, alone, *priors, weight[own], off)
        np.testing.assert_array_equal(turn[number], by_own[0])
        np.testing.assert_array_equal(shift[number], by_own[1])
