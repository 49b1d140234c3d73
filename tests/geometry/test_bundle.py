"""Gauss-Newton's equations of the bundle against finite differences, and its exactness on exact views."""

from dataclasses import replace

import numpy as np
import pytest

from ttcvid.geometry.estimation.bundle import (
    N_POSE,
    N_SHARED,
    Bundle,
    Views,
    _behind,
    _capped,
    _cost,
    _equations,
    adjust_bundle,
)
from ttcvid.geometry.rotation import normalize, rotation_from_vector, tangent_basis

N_FRAMES, N_POINTS = 6, 40
FREE = np.zeros(N_SHARED)
STEP = 1e-6


@pytest.fixture
def truth() -> Bundle:
    rng = np.random.default_rng(1)
    middle = N_FRAMES // 2
    turns = np.column_stack([0.02 * rng.normal(size=N_FRAMES), 0.1 * np.arange(N_FRAMES), 0.02 * np.ones(N_FRAMES)])
    rotation = rotation_from_vector(turns - turns[middle])
    translation = np.column_stack([0.3 * np.arange(N_FRAMES), 0.1 * rng.normal(size=N_FRAMES), np.arange(N_FRAMES)])
    translation -= translation[middle]
    place = rng.uniform((-4.0, -2.0, 8.0), (4.0, 2.0, 20.0), (N_POINTS, 3))
    distance = np.linalg.norm(place, axis=1)
    return Bundle(rotation, translation, normalize(place), 1.0 / distance, np.array([np.log(600.0), 3.0, -2.0, 0.01]))


def views_of(bundle: Bundle) -> Views:
    frame, point = (index.ravel() for index in np.meshgrid(np.arange(N_FRAMES), np.arange(N_POINTS), indexing="ij"))
    xy_px = _cost(np.zeros((N_FRAMES, 2, N_POINTS)), bundle, 1.0)[1].transpose(0, 2, 1).reshape(-1, 2)
    return Views(xy_px, frame, point, np.arange(N_POINTS) % 10)


def whole_cost(xy_px: np.ndarray, bundle: Bundle) -> float:
    return _cost(xy_px, bundle, 1.0)[0] + _capped(_behind(bundle)[0] ** 2).sum()


def moved(bundle: Bundle, step: np.ndarray, point_step: np.ndarray) -> Bundle:
    poses = step[:-N_SHARED].reshape(-1, N_POSE)
    ray = normalize(bundle.ray + np.einsum("nab,nb->na", tangent_basis(bundle.ray), point_step[:, :2]))
    return Bundle(
        rotation_from_vector(poses[:, :3]) @ bundle.rotation,
        bundle.translation + poses[:, 3:],
        ray,
        bundle.inverse + point_step[:, 2],
        bundle.shared + step[-N_SHARED:],
    )


def test_gradient_is_that_of_the_robust_cost(truth):
    """Half of the cost's slope, along every unknown of the frames and of a few points, one of them behind."""
    rng = np.random.default_rng(2)
    views = views_of(truth)
    xy_px = (views.xy_px + rng.normal(0.0, 2.0, views.xy_px.shape)).reshape(N_FRAMES, N_POINTS, 2).transpose(0, 2, 1)
    bundle = replace(truth, inverse=np.where(np.arange(N_POINTS) == 3, -0.01, truth.inverse))
    equations = _equations(bundle, 1.0, _cost(xy_px, bundle, 1.0)[1], bundle.shared, FREE)
    n_pose = N_POSE * N_FRAMES + N_SHARED
    for place in range(n_pose + 3 * 6):
        step, point_step = np.zeros(n_pose), np.zeros((N_POINTS, 3))
        scale = 1e3 if n_pose - N_SHARED < place < n_pose - 1 else 1.0
        if place < n_pose:
            step[place], downhill = scale * STEP, equations.pose_gradient[place]
        else:
            n, axis = divmod(place - n_pose, 3)
            point_step[n, axis], downhill = STEP, equations.point_gradient[axis, n]
        # The focal length also sets what counts as behind: held here.
        if place == n_pose - N_SHARED:
            continue
        ahead, behind = (whole_cost(xy_px, moved(bundle, s * step, s * point_step)) for s in (1.0, -1.0))
        assert -0.25 * (ahead - behind) / (scale * STEP) == pytest.approx(downhill, rel=1e-4, abs=1e-3)


def test_score_of_the_points_adds_up_to_the_gradient(truth):
    views = views_of(replace(truth, shared=truth.shared + 0.01))
    xy_px = views.xy_px.reshape(N_FRAMES, N_POINTS, 2).transpose(0, 2, 1)
    equations = _equations(truth, 1.0, _cost(xy_px, truth, 1.0)[1], truth.shared, FREE)
    np.testing.assert_allclose(equations.score.sum(axis=1), equations.pose_gradient, rtol=1e-9, atol=1e-9)


def test_exact_views_give_back_focal_length_centre_and_distortion(truth):
    views = views_of(truth)
    start = replace(truth, shared=np.array([np.log(700.0), 0.0, 0.0, 0.0]), inverse=1.1 * truth.inverse)
    fit = adjust_bundle(views, start, 1.0, np.zeros(N_SHARED), np.full(N_SHARED, 1e6), 100)
    np.testing.assert_allclose(fit.bundle.shared, truth.shared, rtol=1e-4)
    assert fit.cost < 1e-6
    assert not fit.behind.any()


def test_a_camera_that_only_turns_keeps_its_place(truth):
    turning = replace(truth, translation=np.zeros((N_FRAMES, 3)), inverse=np.zeros(N_POINTS))
    views = views_of(turning)
    start = replace(turning, shared=turning.shared + np.array([0.1, 0.0, 0.0, 0.0]))
    fit = adjust_bundle(views, start, 1.0, np.zeros(N_SHARED), np.full(N_SHARED, 1e6), 50, can_move=False)
    assert fit.bundle.shared[0] == pytest.approx(turning.shared[0], abs=1e-6)
    assert not fit.bundle.translation.any()


def test_without_turning_nothing_is_told(truth):
    """Straight ahead past points: any focal length explains it, and the standard deviation says so."""
    straight = replace(
        truth,
        rotation=np.repeat(np.eye(3)[None], N_FRAMES, axis=0),
        translation=np.column_stack([np.zeros((N_FRAMES, 2)), np.arange(N_FRAMES) - N_FRAMES // 2]),
        shared=np.array([np.log(600.0), 0.0, 0.0, 0.0]),
    )
    sigma = np.array([10.0, 0.0, 0.0, 0.0])
    views = views_of(straight)
    noisy = replace(views, xy_px=views.xy_px + np.random.default_rng(3).normal(0.0, 0.2, views.xy_px.shape))
    fit = adjust_bundle(noisy, straight, 0.2, np.zeros(N_SHARED), sigma, 30)
    assert fit.log_focal_sigma > 0.2
