"""What many points say of their common path: found without noise, with an honest covariance in noise."""

from dataclasses import replace

import numpy as np
import pytest

from ttcvid.geometry.estimation.shared_trajectory import (
    PathBeliefs,
    believed_paths,
    fit_paths,
    joined_paths,
    turned_back,
)
from ttcvid.geometry.estimation.shared_trajectory_points import points_of_paths
from ttcvid.geometry.estimation.track_on_trajectory import NO_PATH, fit_rates_on_paths, straight_path
from ttcvid.geometry.estimation.trajectory_velocity import velocities_on_paths
from ttcvid.geometry.kernels.path_point import ROBUST_SIGMAS
from ttcvid.geometry.kernels.shared_path import add_windows
from ttcvid.geometry.rotation import normalize, rotation_from_vector, tangent_basis

T_S = -0.05 * np.arange(20.0)[::-1]
BOTH_SIDES_S = T_S - T_S[10]
DIRECTION = normalize(np.array([0.3, 0.02, -1.0]))
SPEED_M_S = 6.0
SIGMA = 0.2 / 720.0


def body(n, rng, depth_m=(12.0, 14.0)):
    return np.column_stack([rng.uniform(-3, 3, n), rng.uniform(-1, 1, n), rng.uniform(*depth_m, n)])


def seen(position, bend_hz=(0.0, 0.0, 0.0), turn_rad_s=(0.0, 0.0, 0.0), t_s=T_S, change_hz2=(0.0, 0.0, 0.0)):
    """Views of points that move along DIRECTION with an acceleration that changes, turned about the camera."""
    path = t_s[:, None] * DIRECTION + 0.5 * t_s[:, None] ** 2 * np.array(bend_hz)
    path += t_s[:, None] ** 3 / 6.0 * np.array(change_hz2)
    turn = rotation_from_vector(t_s[:, None] * np.array(turn_rad_s))
    place = np.einsum("lij,lnj->lni", turn, position + SPEED_M_S * path[:, None])
    return place[..., :2] / place[..., 2:]


def belief(direction=DIRECTION, direction_sigma_rad=0.02, bend_hz=0.3, turn_rad_s=1e-6, t_s=T_S):
    cov = direction_sigma_rad**2 * (np.eye(3) - np.outer(direction, direction))
    base = straight_path(direction, t_s)
    return PathBeliefs(base[None], direction[None], cov[None], bend_hz, bend_hz, turn_rad_s)


def fitted(xy, beliefs, sigma=SIGMA, t_s=T_S):
    n = xy.shape[1]
    points = points_of_paths(xy, t_s, np.full(n, sigma), beliefs.base, np.zeros(n, np.int64))
    return fit_paths(points, beliefs).paths()


@pytest.mark.parametrize("t_s", [T_S, BOTH_SIDES_S], ids=["past", "both sides"])
@pytest.mark.parametrize("bend_hz", [(0.0, 0.0, 0.0), (-0.08, 0.0, 0.25), (0.2, 0.02, 0.0)])
def test_braking_and_turning_are_found_by_all_points_together(bend_hz, t_s):
    found = fitted(seen(body(60, np.random.default_rng(1)), bend_hz, t_s=t_s), belief(t_s=t_s), 1e-6, t_s)
    np.testing.assert_allclose(found.offset[0, 3:6], bend_hz, atol=2e-3)
    np.testing.assert_allclose(found.direction[0], DIRECTION, atol=1e-4)


def test_an_acceleration_that_changes_is_in_what_is_said_of_a_direction():
    """Brakes that come and go within the window: a path of constant acceleration errs by four standard deviations."""
    rng, squares = np.random.default_rng(9), []
    position, plane = body(30, rng), tangent_basis(DIRECTION)
    for _ in range(60):
        bend_hz, change_hz2 = 0.2 * rng.normal(size=3), 0.5 * rng.normal(size=3)
        xy = seen(position, bend_hz, change_hz2=change_hz2) + SIGMA * rng.normal(size=(20, 30, 2))
        found = fitted(xy, belief(direction_sigma_rad=0.2, bend_hz=0.2))
        off, cov = plane.T @ found.direction[0], plane.T @ found.cov[0, :3, :3] @ plane
        squares.append(off @ np.linalg.solve(cov, off))
    assert 0.8 <= np.mean(np.array(squares) < 4.605) <= 0.98  # 90 % of chi-square with two degrees of freedom


def test_views_on_both_sides_tell_direction_and_acceleration_better_than_those_of_the_past():
    xy, both = (seen(body(30, np.random.default_rng(8)), t_s=t_s) for t_s in (T_S, BOTH_SIDES_S))
    past, around = fitted(xy, belief()), fitted(both, belief(t_s=BOTH_SIDES_S), t_s=BOTH_SIDES_S)
    assert np.trace(around.cov[0, :3, :3]) < 0.5 * np.trace(past.cov[0, :3, :3])


def test_a_direction_that_was_believed_wrongly_is_put_right():
    wrong = normalize(DIRECTION + np.array([0.02, -0.01, 0.0]))
    found = fitted(seen(body(60, np.random.default_rng(2))), belief(wrong), 1e-6)
    np.testing.assert_allclose(found.direction[0], DIRECTION, atol=2e-4)


def test_a_direction_that_is_believed_to_lie_in_a_plane_is_found_there():
    ahead, across = np.array([0.0, 0.0, -1.0]), np.array([1.0, 0.0, 0.0])
    true = normalize(ahead + 0.03 * across)
    place = body(60, np.random.default_rng(2)) + SPEED_M_S * T_S[:, None, None] * true
    believed = replace(belief(ahead), direction_cov=0.02**2 * np.outer(across, across)[None])
    found = fitted(place[..., :2] / place[..., 2:], believed, 1e-6)
    np.testing.assert_allclose(found.direction[0], true, atol=1e-4)
    assert abs(found.direction[0, 1]) < 1e-9


@pytest.mark.parametrize("t_s", [T_S, BOTH_SIDES_S], ids=["past", "both sides"])
def test_a_rotation_left_in_the_views_is_found_and_taken_out(t_s):
    rng, turn = np.random.default_rng(3), np.array([0.001, 0.003, -0.002])
    position = body(80, rng, (8.0, 60.0))
    xy = seen(position, turn_rad_s=turn, t_s=t_s)
    found = fitted(xy, belief(turn_rad_s=0.003, t_s=t_s), 1e-6, t_s)
    np.testing.assert_allclose(found.turn_rad_s[0], turn, atol=1e-4)
    back = turned_back(xy, t_s, turn[None], np.zeros(80, np.int64))
    np.testing.assert_allclose(back, seen(position, t_s=t_s), atol=1e-12)


def test_covariance_of_rates_holds_what_the_path_does_not_say():
    """Rates of all points err together: the covariance of their mean is that of draws."""
    rng, squares = np.random.default_rng(4), []
    position, number = body(30, rng), np.zeros(30, np.int64)
    for _ in range(150):
        off = 0.02 * rng.normal(size=3)
        believed = normalize(DIRECTION + off - DIRECTION * (off @ DIRECTION))
        bend_hz = 0.1 * rng.normal(size=3)
        xy = seen(position, bend_hz) + SIGMA * rng.normal(size=(20, 30, 2))
        found = fitted(xy, belief(believed, 0.02, 0.1))
        rates = fit_rates_on_paths(xy, T_S, np.full(30, SIGMA), found.path, number)
        velocities = velocities_on_paths(
            rates, rates.cov[:, 2, 2], number, found.direction, np.zeros((1, 3)), np.array([False]), found.cov
        )
        mean = velocities.jacobian.mean(axis=0)
        own = np.mean(rates.cov[:, 2, 2]) / 30 * np.outer(found.direction[0], found.direction[0])
        error = (velocities.abc_hz - SPEED_M_S * DIRECTION / position[:, 2:]).mean(axis=0)
        squares.append(error @ np.linalg.solve(mean @ found.cov[0] @ mean.T + own, error))
        assert (np.linalg.eigvalsh(velocities.cov) > -1e-12).all()
    assert 0.85 <= np.mean(np.array(squares) < 6.25) <= 0.96  # 90 % of chi-square with three degrees of freedom


def test_the_velocity_of_a_turning_thing_is_that_of_its_points():
    rng, turn = np.random.default_rng(5), np.array([0.0, 0.15, 0.0])
    position, number = body(40, rng), np.zeros(40, np.int64)
    xy = seen(position, turn_rad_s=turn)
    back = turned_back(xy, T_S, turn[None], number)
    paths = straight_path(DIRECTION, T_S)[None]
    rates = fit_rates_on_paths(back, T_S, np.full(40, 1e-6), paths, number)
    found = velocities_on_paths(
        rates, rates.cov[:, 2, 2], number, DIRECTION[None], turn[None], np.array([True]), np.zeros((1, 12, 12))
    )
    velocity = SPEED_M_S * DIRECTION + np.cross(turn, position)
    np.testing.assert_allclose(found.abc_hz, velocity / position[:, 2:], rtol=1e-6, atol=1e-9)


def test_points_that_move_otherwise_do_not_bend_the_path():
    rng = np.random.default_rng(6)
    position = body(60, rng)
    xy = seen(position)
    xy[:, :12] = seen(position[:12], bend_hz=(3.0, -2.0, 4.0))
    found = fitted(xy + SIGMA * rng.normal(size=xy.shape), belief())
    assert np.abs(found.offset[0, 3:6]).max() < 0.1


def test_paths_without_points_stay_as_believed():
    xy = seen(body(10, np.random.default_rng(7)))
    points = points_of_paths(xy, T_S, np.full(10, SIGMA), belief().base, np.full(10, NO_PATH))
    found = fit_paths(points, belief()).paths()
    believed = believed_paths(belief())
    np.testing.assert_allclose(found.path, believed.path)
    np.testing.assert_allclose(found.cov, believed.cov, atol=1e-9)
    assert joined_paths([found, believed]).path.shape == (2, 20, 3)


def seen_turning(position, turn_rad_s, velocity):
    """Views of a body that moves straight on and turns about its middle."""
    middle = position.mean(axis=0)
    turn = rotation_from_vector(T_S[:, None] * np.array(turn_rad_s))
    place = middle + T_S[:, None, None] * velocity + np.einsum("lij,nj->lni", turn, position - middle)
    return place[..., :2] / place[..., 2:]


def states_of(xy, found, sigma):
    """(a, b, c) of all points on a path of a thing that turns itself."""
    number = np.zeros(xy.shape[1], np.int64)
    rates = fit_rates_on_paths(
        turned_back(xy, T_S, found.turn_rad_s, number), T_S, np.full(len(number), sigma), found.path, number
    )
    return velocities_on_paths(
        rates, rates.cov[:, 2, 2], number, found.direction, found.turn_rad_s, np.array([True]), found.cov
    ).abc_hz


@pytest.mark.parametrize("depth_m", [8.0, 25.0])
def test_the_direction_of_what_turns_itself_is_that_of_its_middle(depth_m):
    rng, turn = np.random.default_rng(5), np.array([0.0, -0.02, 0.0])
    position = np.array([1.0, 0.0, depth_m]) + 0.3 * body(40, rng, (-3.0, 3.0))
    velocity, sigma = SPEED_M_S * DIRECTION, 0.1 * SIGMA
    xy = seen_turning(position, turn, velocity) + sigma * rng.normal(size=(20, 40, 2))
    found = fitted(xy, replace(belief(direction_sigma_rad=0.02, turn_rad_s=0.02), turns_itself=True), sigma)
    abc_hz = states_of(xy, found, sigma)
    assert np.degrees(np.arccos(normalize(np.median(abc_hz, axis=0)) @ DIRECTION)) < 0.5
    own = velocity + np.cross(turn, position - position.mean(axis=0))
    np.testing.assert_allclose(np.median(abc_hz[:, 2] * position[:, 2] / own[:, 2]), 1.0, atol=0.02)


def test_a_turn_that_cannot_be_seen_leaves_a_direction_as_sure_as_it_was():
    """At 60 m a turn of 0.02 rad/s about the camera would be 1.2 m/s to the side, 11 deg of this direction."""
    errors_deg = {True: [], False: []}
    for seed in range(20):
        rng = np.random.default_rng(seed)
        position = np.array([1.0, 0.0, 60.0]) + 0.3 * body(10, rng, (-3.0, 3.0))
        xy = seen(position) + SIGMA * rng.normal(size=(20, 10, 2))
        for turns_itself, errors in errors_deg.items():
            believed = replace(
                belief(direction_sigma_rad=0.02, bend_hz=0.1, turn_rad_s=0.02), turns_itself=turns_itself
            )
            found = fitted(xy, believed)
            mean = np.median(states_of(xy, found, SIGMA), axis=0)
            errors.append(np.degrees(np.arccos(normalize(mean) @ DIRECTION)))
    assert np.median(errors_deg[True]) < 2.0
    assert np.median(errors_deg[False]) > 2.0 * np.median(errors_deg[True])


def test_a_path_keeps_its_speed_however_wrong_its_direction_was_believed():
    """Rates are speeds along the path over depth: along a direction 20 deg off they would be 6 % too small."""
    rng = np.random.default_rng(6)
    position = body(60, rng)
    believed = DIRECTION @ rotation_from_vector(np.radians([0.0, 20.0, 0.0])).T
    xy = seen(position)
    found = fitted(xy, belief(believed, 0.5), 1e-6)
    np.testing.assert_allclose(found.direction[0], DIRECTION, atol=1e-3)
    rates = fit_rates_on_paths(xy, T_S, np.full(60, 1e-6), found.path, np.zeros(60, np.int64))
    np.testing.assert_allclose(rates.rate_hz, SPEED_M_S / position[:, 2], rtol=5e-3)


def test_what_a_point_says_of_its_path_is_what_is_left_when_its_own_unknowns_follow():
    """Against the derivatives of the predicted views, taken as differences, without any of the loops."""
    rng = np.random.default_rng(5)
    n, s, sigma = 11, np.array([0.2, -0.1, 0.3]), 3e-4
    t_s, path = -0.1 * np.arange(n), np.column_stack([0.1 * rng.normal(size=(n, 2)), np.linspace(0.0, 0.8, n)])
    basis = np.column_stack([tangent_basis(DIRECTION), DIRECTION])

    def predicted(own, shared):
        x, y, rho = s + own
        moved = path + t_s[:, None] * (basis[:, :2] @ shared[:2]) + 0.5 * t_s[:, None] ** 2 * (basis @ shared[2:5])
        moved += t_s[:, None] ** 3 / 6.0 * (basis @ shared[5:8])
        place = np.array([x, y, 1.0]) + rho * moved
        place = np.einsum("lij,lj->li", rotation_from_vector(t_s[:, None] * shared[8:]), place)
        return place[:, :2] / place[:, 2:]

    seen_xy = predicted(np.zeros(3), np.zeros(11)) + sigma * rng.normal(size=(n, 2))
    seen_xy[2] += 0.01
    both_ways = [(predicted(d[:3], d[3:]), predicted(-d[:3], -d[3:])) for d in 1e-6 * np.eye(14)]
    by = np.array([(after - before) / (2e-6 * sigma) for after, before in both_ways])
    residual = (seen_xy - predicted(np.zeros(3), np.zeros(11))) / sigma
    weight = np.minimum(1.0, ROBUST_SIGMAS**2 / np.sum(residual**2, axis=1))[:, None]
    whole, right = np.einsum("ilc,jlc->ij", by * weight, by), np.einsum("ilc,lc->i", by * weight, residual)
    follow = np.linalg.solve(whole[:3, :3], whole[:3, 3:]).T

    information, score = np.zeros((1, 11, 11)), np.zeros((1, 11))
    points = seen_xy[:, None].copy(), t_s, np.array([sigma]), np.arange(n), np.array([0, 1])
    add_windows(points, path[None], basis[None], np.array([n]), s[None], information, score)
    expected = np.tril(whole[3:, 3:] - follow @ whole[:3, 3:])
    np.testing.assert_allclose(information[0], expected, rtol=1e-6, atol=1e-7 * np.abs(expected).max())
    expected = right[3:] - follow @ right[:3]
    np.testing.assert_allclose(score[0], expected, rtol=1e-6, atol=1e-7 * np.abs(expected).max())
