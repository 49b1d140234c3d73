"""The direction that points share, from the states of their whole tracks: exact, honest, robust."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ttcvid.geometry.estimation.shared_direction import shared_directions
from ttcvid.geometry.estimation.track_state import fit_whole_tracks
from ttcvid.geometry.rotation import normalize, rotation_from_vector, tangent_basis

DIRECTIONS = [(0.0, 0.0, -1.0), (0.3, 0.0, -1.0), (1.0, 0.0, 0.0), (-0.7, 0.1, 0.1), (0.0, -0.2, 1.0)]


def informations(n, rng):
    """Random positive definite (N, 3, 3), some 100 times better known along one axis than along another."""
    factors = rng.normal(size=(n, 3, 3)) * np.array([30.0, 100.0, 300.0])
    return factors @ np.swapaxes(factors, 1, 2)


def noisy(velocity_hz, info, rng):
    noise = np.linalg.solve(np.swapaxes(np.linalg.cholesky(info), 1, 2), rng.normal(size=(*velocity_hz.shape, 1)))
    return velocity_hz + noise[..., 0]


def shared_direction(velocity_hz, info, by_shared=None):
    """The direction of one thing that all points belong to."""
    thing = np.zeros(len(velocity_hz), dtype=np.int64)
    places = np.zeros((len(thing), 2))
    direction, covariance, chi2, _ = shared_directions(places, velocity_hz, info, thing, 1, by_shared)
    return direction[0], covariance[0], chi2


def off(found, direction):
    """Error in the two tangent coordinates of the true direction, rad."""
    return tangent_basis(direction).T @ found


@pytest.mark.parametrize("direction", DIRECTIONS)
@pytest.mark.parametrize("n", [1, 2, 40])
def test_the_direction_is_exact_without_noise(direction, n):
    rng, direction = np.random.default_rng(1), normalize(np.array(direction))
    velocity_hz = rng.uniform(0.1, 2.0, (n, 1)) * direction
    found, covariance, chi2 = shared_direction(velocity_hz, informations(n, rng))
    np.testing.assert_allclose(found, direction, atol=1e-9)
    np.testing.assert_allclose(chi2, 0.0, atol=1e-9)
    np.testing.assert_allclose(covariance @ found, 0.0, atol=1e-12)
    np.testing.assert_allclose(covariance, covariance.T, atol=1e-15)


@pytest.mark.parametrize("direction", DIRECTIONS[:4])
def test_the_covariance_is_that_of_many_draws(direction):
    rng, direction = np.random.default_rng(2), normalize(np.array(direction))
    truth, info = rng.uniform(0.3, 2.0, (25, 1)) * direction, informations(25, rng)
    squares, chi2s = [], []
    for _ in range(400):
        found, covariance, chi2 = shared_direction(noisy(truth, info, rng), info)
        basis = tangent_basis(direction)
        error = off(found, direction)
        squares.append(error @ np.linalg.solve(basis.T @ covariance @ basis, error))
        chi2s.append(chi2.sum())
    # Chi-square with two degrees of freedom; widening by chance makes it a little less.
    assert 1.6 < np.mean(squares) < 2.3
    assert 0.86 < np.mean(np.array(squares) < 4.61) < 0.96
    assert np.mean(chi2s) == pytest.approx(2 * 25 - 2, rel=0.06)


def test_errors_that_all_points_share_are_in_the_covariance():
    rng, direction = np.random.default_rng(3), normalize(np.array([0.1, 0.0, -1.0]))
    truth, info = np.full((60, 1), 0.5) * direction, informations(60, rng)
    by_shared = np.broadcast_to(0.02 * rng.normal(size=(3, 2)), (60, 3, 2))
    with_shared, without = [], []
    for _ in range(300):
        velocity_hz = noisy(truth, info, rng) + by_shared @ rng.normal(size=2)
        for squares, shared in ((with_shared, by_shared), (without, None)):
            found, covariance, _ = shared_direction(velocity_hz, info, shared)
            basis = tangent_basis(direction)
            error = off(found, direction)
            squares.append(error @ np.linalg.solve(basis.T @ covariance @ basis, error))
    assert 0.84 < np.mean(np.array(with_shared) < 4.61) < 0.97
    assert np.mean(np.array(without) < 4.61) < 0.3


@pytest.mark.parametrize("part", [0.1, 0.3])
def test_points_that_move_otherwise_hardly_pull_and_are_told_by_their_chi_square(part):
    rng, direction = np.random.default_rng(4), normalize(np.array([0.4, 0.0, -1.0]))
    info = informations(60, rng)
    velocity_hz = noisy(rng.uniform(0.3, 2.0, (60, 1)) * direction, info, rng)
    n_wild = int(60 * part)
    velocity_hz[:n_wild] = normalize(np.array([-0.5, 0.2, -1.0]))
    found, covariance, chi2 = shared_direction(velocity_hz, info)
    assert np.linalg.norm(found - direction) < 0.01
    assert chi2[:n_wild].min() > 100.0
    assert np.median(chi2[n_wild:]) < 3.0
    assert np.sqrt(np.trace(covariance)) > 0.0


def test_what_fits_worse_than_noise_allows_widens_the_covariance():
    rng, direction = np.random.default_rng(5), normalize(np.array([0.4, 0.0, -1.0]))
    info = informations(40, rng)
    velocity_hz = noisy(direction * np.ones((40, 1)), info / 4.0, rng)
    _, honest, chi2 = shared_direction(velocity_hz, info / 4.0)
    _, boastful, _ = shared_direction(velocity_hz, info)
    # Noise twice what is said: nearly as wide as if it had been said (wild points count at most 3 sigmas).
    assert np.trace(boastful) > 0.5 * np.trace(honest)
    assert np.mean(chi2) < 3.0


@given(seed=st.integers(0, 2**32 - 1))
def test_order_does_not_matter_and_turning_the_world_turns_the_result(seed):
    rng = np.random.default_rng(seed)
    direction = normalize(rng.normal(size=3))
    info = informations(12, rng)
    velocity_hz = noisy(rng.uniform(0.5, 2.0, (12, 1)) * direction, info, rng)
    found, covariance, chi2 = shared_direction(velocity_hz, info)
    order, turn = rng.permutation(12), rotation_from_vector(rng.normal(size=3))
    for other, expected, cov, values in (
        (shared_direction(velocity_hz[order], info[order]), found, covariance, chi2[order]),
        (
            shared_direction(velocity_hz @ turn.T, turn @ info @ turn.T),
            turn @ found,
            turn @ covariance @ turn.T,
            chi2,
        ),
    ):
        np.testing.assert_allclose(other[0], expected, atol=1e-5)
        np.testing.assert_allclose(other[1], cov, rtol=1e-3, atol=1e-3 * np.abs(cov).max())
        np.testing.assert_allclose(other[2], values, rtol=1e-2, atol=1e-2)


def test_each_of_several_things_gets_what_it_would_get_alone():
    rng = np.random.default_rng(8)
    thing, info, by_shared = rng.integers(0, 3, 30), informations(30, rng), rng.normal(size=(30, 3, 2))
    velocity_hz = noisy(normalize(rng.normal(size=(3, 3)))[thing], info, rng)
    directions, covariances, chi2, _ = shared_directions(np.zeros((30, 2)), velocity_hz, info, thing, 4, by_shared)
    for number in range(3):
        own = thing == number
        found, covariance, own_chi2 = shared_direction(velocity_hz[own], info[own], by_shared[own])
        np.testing.assert_array_equal(directions[number], found)
        np.testing.assert_array_equal(covariances[number], covariance)
        np.testing.assert_array_equal(chi2[own], own_chi2)
    assert np.isnan(directions[3]).all()
    assert np.isnan(covariances[3]).all()


def test_points_that_say_nothing_are_left_out():
    rng, direction = np.random.default_rng(6), normalize(np.array([0.2, 0.0, -1.0]))
    velocity_hz, info = rng.uniform(0.5, 1.0, (6, 1)) * direction, informations(6, rng)
    velocity_hz[0] = np.nan
    info[1] = 0.0
    info[2] = np.nan
    found, covariance, chi2 = shared_direction(velocity_hz, info)
    np.testing.assert_allclose(found, direction, atol=1e-9)
    assert np.isfinite(covariance).all()
    np.testing.assert_array_equal(chi2[:3], 0.0)


@pytest.mark.parametrize("n", [0, 3])
def test_nothing_known_gives_no_direction(n):
    found, covariance, chi2 = shared_direction(np.full((n, 3), np.nan), np.zeros((n, 3, 3)))
    assert np.isnan(found).all()
    assert np.isnan(covariance).all()
    assert chi2.shape == (n,)


def test_points_that_do_not_move_leave_the_direction_open():
    _, covariance, _ = shared_direction(np.zeros((5, 3)), np.broadcast_to(1e4 * np.eye(3), (5, 3, 3)))
    assert not np.trace(covariance) < 1.0


def test_whole_tracks_of_a_car_give_its_direction():
    rng, direction = np.random.default_rng(7), normalize(np.array([-1.0, 0.0, -0.4]))
    t_s = -0.05 * np.arange(12.0)[::-1]
    position = np.column_stack([rng.uniform(2, 6, 40), rng.uniform(-1, 1, 40), rng.uniform(14, 16, 40)])
    place = position + 8.0 * t_s[:, None, None] * direction
    sigma = 0.2 / 720.0
    xy = place[..., :2] / place[..., 2:] + sigma * rng.normal(size=(12, 40, 2))
    tracks = fit_whole_tracks(xy, t_s, np.full(40, sigma))
    found, covariance, _ = shared_direction(tracks.state[:, 2:], tracks.info_w)
    basis = tangent_basis(direction)
    error = off(found, direction)
    assert error @ np.linalg.solve(basis.T @ covariance @ basis, error) < 13.8
    assert np.linalg.norm(error) < 0.05


def tracks_of_a_car_ahead(change_hz, rng):
    """States of 40 points of a rear, fitted over 0.6 s as if its velocity (0.3, 0.05, -2) m/s were constant.

    The velocity grows by ``change_hz`` of itself a second. The noise is that of 0.1 px at a focal length of 700 px.
    """
    velocity, sigma = np.array([0.3, 0.05, -2.0]), 1.4e-4
    t_s = np.arange(-6, 1) / 10.0
    here = rng.uniform([-0.9, -0.5, 6.0], [0.9, 0.6, 6.6], (40, 3))
    way = (t_s + change_hz * t_s**2 / 2.0)[:, None, None] * velocity + here
    xy = way[..., :2] / way[..., 2:] + rng.normal(size=(7, 40, 2)) * sigma
    return normalize(velocity), fit_whole_tracks(xy, t_s, np.full(40, sigma), 7, has_covariance=False)


@pytest.mark.parametrize("change_hz", [-1.0, -0.4, 0.0, 0.4, 1.0])
def test_what_changes_its_speed_does_not_seem_to_come_from_where_it_is(change_hz):
    """Each track alone takes a change of speed for depth; the lines in which the tracks move still meet in one point.

    From the main axis of the velocities one search in a hundred of these ends on the other side of the sky.
    """
    rng, thing = np.random.default_rng(11), np.zeros(40, dtype=np.int64)
    for _ in range(20):
        truth, tracks = tracks_of_a_car_ahead(change_hz, rng)
        found, *_ = shared_directions(tracks.state[:, :2], tracks.state[:, 2:], tracks.info_w, thing, 1)
        assert np.rad2deg(np.linalg.norm(off(found[0], truth))) < 1.5


def test_what_an_error_of_all_points_does_to_the_direction_is_part_of_its_covariance():
    rng, n = np.random.default_rng(31), 40
    velocity_hz = rng.uniform(0.1, 2.0, (n, 1)) * normalize(np.array(DIRECTIONS[0]))
    info, by_shared = informations(n, rng), 0.01 * rng.normal(size=(n, 3, 2))
    thing, places = np.zeros(n, dtype=np.int64), np.zeros((n, 2))
    _, alone, _, nothing = shared_directions(places, velocity_hz, info, thing, 1)
    _, covariance, _, by_errors = shared_directions(places, velocity_hz, info, thing, 1, by_shared)
    assert nothing.shape == (1, 3, 0)
    added = by_errors[0] @ by_errors[0].T
    assert np.trace(added) > 0.0
    np.testing.assert_allclose(covariance[0], alone[0] + added, rtol=1e-9, atol=1e-15)
