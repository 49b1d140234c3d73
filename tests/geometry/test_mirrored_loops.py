"""Loops that stand in several files, since a compiled function may call only those of its own, say the same."""

import numpy as np
import pytest

from ttcvid.geometry.estimation import shared_trajectory_descent
from ttcvid.geometry.rotation import normalize, rotation_from_vector


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.01, 2.0])
def test_rotations_are_those_of_the_rotation_vector(angle):
    vector = angle * normalize(np.random.default_rng(2).normal(size=3))
    t_s, way = np.array([-0.7, 0.0]), np.zeros((13, 8))
    shared_trajectory_descent._set_way(t_s, np.zeros((2, 3)), np.eye(3), np.append(np.zeros(5), vector), way)
    rotations = way[:9, -2:].T.reshape(2, 3, 3)
    np.testing.assert_allclose(rotations, rotation_from_vector(-t_s[:, None] * vector), atol=1e-14)


def test_what_a_point_says_of_what_it_shares_is_what_is_left_when_its_own_unknowns_follow():
    """Against the derivatives of the predicted views, taken as differences, without any of the loops."""
    rng = np.random.default_rng(5)
    n, s, sigma = 11, np.array([0.2, -0.1, 0.3]), 3e-4
    t_s, path = -0.1 * np.arange(n), np.column_stack([0.1 * rng.normal(size=(n, 2)), np.linspace(0.0, 0.8, n)])

    def predicted(unknowns):
        x, y, rho = s + unknowns[:3]
        moved = path + t_s[:, None] * unknowns[3:6] + 0.5 * t_s[:, None] ** 2 * unknowns[6:9]
        place = np.array([x, y, 1.0]) + rho * moved
        place = np.einsum("lij,lj->li", rotation_from_vector(t_s[:, None] * unknowns[9:]), place)
        return place[:, :2] / place[:, 2:]

    seen = predicted(np.zeros(12)) + sigma * rng.normal(size=(n, 2))
    seen[2] += 0.01
    step = 1e-6
    slope = [(predicted(step * one) - predicted(-step * one)) / (2.0 * step * sigma) for one in np.eye(12)]
    residual = (seen - predicted(np.zeros(12))) / sigma
    square = np.sum(residual**2, axis=1)
    weight = np.minimum(1.0, shared_trajectory_descent._ROBUST_SIGMAS**2 / square)[:, None]
    by = np.array(slope)
    whole, right = np.einsum("ilc,jlc->ij", by * weight, by), np.einsum("ilc,lc->i", by * weight, residual)
    follow = np.linalg.solve(whole[:3, :3], whole[:3, 3:]).T
    _, _, sums = added_together(seen, t_s, path, s, sigma)
    expected = whole[3:, 3:] - follow @ whole[:3, 3:]
    np.testing.assert_allclose(np.tril(sums[:9]), np.tril(expected), rtol=1e-6, atol=1e-7 * np.abs(expected).max())
    expected = right[3:] - follow @ right[:3]
    np.testing.assert_allclose(sums[9], expected, rtol=1e-6, atol=1e-7 * np.abs(expected).max())


def added_together(seen, t_s, path, s, sigma):
    """What `_add_point` keeps of a point with views (L, 2) on a path, its mean square residual, and the sums."""
    n_lanes = -(-len(t_s) // 8) * 8
    way, views = np.zeros((13, n_lanes)), np.full((1, 2, n_lanes), np.nan)
    views[0, :, n_lanes - len(t_s) :] = seen.T
    shared_trajectory_descent._set_way(t_s, path, np.eye(3), np.zeros(8), way)
    kept, sums = np.zeros((1, 4, 9)), np.zeros((10, 9))
    far = shared_trajectory_descent._ROBUST_SIGMAS**2
    mean_square = shared_trajectory_descent._add_point(views, 0, way, 0, s[None].copy(), sigma, far, kept, sums)
    return kept[0], mean_square, sums
