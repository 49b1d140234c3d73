"""The last step of a rigid thing, by all of its points at once."""

import numpy as np
import pytest

from ttcvid.geometry.estimation.pose_update import StepPriors, with_newest_steps
from ttcvid.geometry.estimation.rigid_motion import Points, RigidPaths, fit_on_paths, views_by_track
from ttcvid.geometry.rotation import normalize, rotation_from_vector

N_VIEWS, SIGMA = 15, 0.1 / 700.0
T_S = 0.05 * np.arange(1.0 - N_VIEWS, 1.0)
AHEAD = np.array([0.1, 0.05, -1.0])


def braking_path(last_speed):
    """A way along `AHEAD` whose speed falls evenly from 1 to ``last_speed``."""
    speed = np.linspace(1.0, last_speed, N_VIEWS - 1)
    steps = speed[:, None] * np.diff(T_S)[:, None] * AHEAD
    return np.append(-np.cumsum(steps[::-1], axis=0)[::-1], np.zeros((1, 3)), axis=0)


def seen(path, rng, n_old=60, n_new=60, sigma=0.0):
    """Points before a camera that turns a little, a part of them since the last two views only, and the rotations."""
    n = n_old + n_new
    # The new ones are near: they come into the picture on the road before us.
    depth = np.where(np.arange(n) < n_old, rng.uniform(2.0, 8.0, n), rng.uniform(0.6, 2.0, n))
    place = np.column_stack([rng.uniform(-0.5, 0.5, n), rng.uniform(-0.3, 0.3, n), np.ones(n)]) * depth[:, None]
    rotations = rotation_from_vector(np.radians([[0.02, 0.1, 0.0]]) * np.arange(N_VIEWS)[::-1, None])
    rays = np.einsum("lji,lnj->lni", rotations, place + path[:, None])
    rays = rays / rays[..., 2:]
    rays[..., :2] += sigma * rng.normal(size=rays[..., :2].shape)
    rays = normalize(rays)
    rays[: N_VIEWS - 2, n_old:] = np.nan
    points = Points(views_by_track(rays), np.full(n, SIGMA), T_S, np.arange(n), np.zeros(n, dtype=np.int64))
    return points, rotations


def with_last_step(path, factor):
    return path + (factor - 1.0) * np.append(np.broadcast_to(path[-2], (N_VIEWS - 1, 3)), np.zeros((1, 3)), axis=0)


def mean_step(paths):
    return np.linalg.norm(paths.path, axis=2).max(axis=1) / (N_VIEWS - 1)


def corrected(points, paths, n_times, weight=None):
    weight = np.ones(len(points.track)) if weight is None else weight
    for _ in range(n_times):
        paths = with_newest_steps(points, paths, fit_on_paths(points, paths), weight, StepPriors(mean_step(paths)))
    return paths


@pytest.mark.parametrize("factor", [0.3, 0.8, 1.5, 3.0])
@pytest.mark.parametrize("last_speed", [1.0, 0.4, 0.1])
def test_a_wrong_last_step_becomes_the_right_one(factor, last_speed):
    path = braking_path(last_speed)
    points, rotations = seen(path, np.random.default_rng(1))
    wrong = RigidPaths(rotations[None], with_last_step(path, factor)[None])
    np.testing.assert_allclose(corrected(points, wrong, 6).path[0], path, atol=1e-7)


@pytest.mark.parametrize("last_speed", [0.5, 0.1])
def test_one_correction_leaves_a_twentieth_of_what_was_wrong(last_speed):
    path = braking_path(last_speed)
    points, rotations = seen(path, np.random.default_rng(2))
    wrong = RigidPaths(rotations[None], with_last_step(path, 1.5)[None])
    after = corrected(points, wrong, 1)
    assert np.linalg.norm(after.path[0, -2] - path[-2]) < 0.05 * np.linalg.norm(wrong.path[0, -2] - path[-2])


def test_all_views_before_move_alike():
    path = braking_path(0.5)
    points, rotations = seen(path, np.random.default_rng(3))
    before = RigidPaths(rotations[None], with_last_step(path, 1.2)[None])
    moved = corrected(points, before, 1).path[0] - before.path[0]
    np.testing.assert_allclose(moved[:-1], np.broadcast_to(moved[0], (N_VIEWS - 1, 3)), atol=1e-15)
    np.testing.assert_array_equal(moved[-1], 0.0)


def test_movers_among_the_points_have_little_say():
    rng = np.random.default_rng(4)
    path = braking_path(0.6)
    points, rotations = seen(path, rng, sigma=SIGMA)
    mover, _ = seen(braking_path(1.0) * [-1.0, 0.0, 0.3], rng, n_old=30, n_new=0)
    both = Points(
        np.concatenate([points.rays, mover.rays]),
        np.full(150, SIGMA),
        T_S,
        np.arange(150),
        np.zeros(150, dtype=np.int64),
    )
    after = corrected(both, RigidPaths(rotations[None], with_last_step(path, 1.2)[None]), 3)
    assert np.linalg.norm(after.path[0, -2] - path[-2]) < 0.1 * np.linalg.norm(path[-2])


@pytest.mark.parametrize("turn_deg", [(0.0, 1.5, 0.0), (0.4, -0.6, 0.8)])
def test_a_thing_that_turned_in_its_last_step_is_turned(turn_deg):
    rng = np.random.default_rng(6)
    points, rotations = seen(braking_path(0.6), rng)
    true = RigidPaths(rotations[None], braking_path(0.6)[None])
    # As if it had not turned about its middle, and gone a little less far.
    middle, back = np.array([0.1, 0.0, 2.0]), rotation_from_vector(-np.radians(turn_deg))
    path = (true.path[0, :-1] + middle) @ back.T - middle - 0.1 * true.path[0, -2]
    wrong = RigidPaths(true.cam_R_past.copy(), np.append(path, np.zeros((1, 3)), axis=0)[None])
    wrong.cam_R_past[0, :-1] = back @ rotations[:-1]
    paths, weight = wrong, np.ones(120)
    for _ in range(8):
        priors = StepPriors(mean_step(paths), np.zeros((1, 3)), 1.0, middle[None])
        paths = with_newest_steps(points, paths, fit_on_paths(points, paths), weight, priors)
    np.testing.assert_allclose(paths.path, true.path, atol=1e-5)
    np.testing.assert_allclose(paths.cam_R_past, true.cam_R_past, atol=1e-5)


def test_a_thing_is_expected_to_turn_as_it_is_said():
    points, rotations = seen(braking_path(0.6), np.random.default_rng(7))
    paths, turned = RigidPaths(rotations[None], braking_path(0.6)[None]), np.array([[0.0, 0.01, 0.0]])
    priors = StepPriors(mean_step(paths), turned, 1e-9, np.zeros((1, 3)))
    after = with_newest_steps(points, paths, fit_on_paths(points, paths), np.ones(120), priors)
    turn = after.cam_R_past[0, 0] @ rotations[0].T
    np.testing.assert_allclose(turn, rotation_from_vector(turned[0]), atol=1e-6)


def test_each_of_several_things_is_corrected_as_if_alone():
    rng = np.random.default_rng(8)
    one, rotations = seen(braking_path(0.6), rng)
    other, _ = seen(braking_path(0.2), rng)
    both = Points(
        np.concatenate([one.rays, other.rays]), np.full(240, SIGMA), T_S, np.arange(240), np.repeat([0, 1], 120)
    )
    wrong = RigidPaths(rotations[None], with_last_step(braking_path(0.4), 1.2)[None])
    together = corrected(both, wrong.joined(wrong), 1, np.ones(240))
    for place, points in enumerate((one, other)):
        np.testing.assert_allclose(together.path[place], corrected(points, wrong, 1).path[0], rtol=1e-12, atol=1e-15)


def test_points_without_weight_and_a_path_of_one_step_change_nothing():
    path = braking_path(0.6)
    points, rotations = seen(path, np.random.default_rng(5))
    wrong = RigidPaths(rotations[None], with_last_step(path, 1.2)[None])
    assert corrected(points, wrong, 1, np.zeros(120)) is wrong
    short = RigidPaths(rotations[None, -2:], path[None, -2:])
    few = Points(
        views_by_track(np.ones((2, 120, 3)) / np.sqrt(3.0)),
        points.sigma_norm,
        T_S[-2:],
        np.arange(120),
        np.zeros(120, dtype=np.int64),
    )
    assert (
        with_newest_steps(few, short, fit_on_paths(points, wrong), np.ones(120), StepPriors(mean_step(short))) is short
    )
