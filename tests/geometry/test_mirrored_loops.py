"""Loops that stand in several files, since a compiled function may call only those of its own, say the same."""

import numpy as np
import pytest

from ttcvid.geometry import rigid_path_descent, shared_direction, shared_path_descent, two_view_descent
from ttcvid.geometry import whole_track_on_path as on_path
from ttcvid.geometry.rotation import normalize, rotation_from_vector, tangent_basis

DIRECTIONS = normalize(
    np.concatenate(
        [np.random.default_rng(1).normal(size=(20, 3)), [[0, -1, 0], [0, -1, 0.03], [0, -1, 0.06]], np.eye(3)]
    )
)


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_tangents_of_two_views_are_the_tangent_basis_and_those_of_a_shared_direction_are_a_basis(direction):
    mirrored, other = np.empty((3, 2)), np.empty((3, 2))
    two_view_descent._tangents(direction, mirrored)
    shared_direction._tangents(direction, other)
    np.testing.assert_allclose(mirrored, tangent_basis(direction), atol=1e-14)
    np.testing.assert_allclose(other.T @ other, np.eye(2), atol=1e-14)
    np.testing.assert_allclose(other.T @ direction, 0.0, atol=1e-14)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.01, 2.0])
def test_rotations_are_those_of_the_rotation_vector(angle):
    rng = np.random.default_rng(2)
    vector, before = angle * normalize(rng.normal(size=3)), rotation_from_vector(rng.normal(size=3))
    turned, back = np.empty((3, 3)), before.copy()
    two_view_descent._turn(vector, before, turned)
    rigid_path_descent._turn_back(vector, back)
    np.testing.assert_allclose(turned, rotation_from_vector(vector) @ before, atol=1e-14)
    np.testing.assert_allclose(back, rotation_from_vector(-vector) @ before, atol=1e-14)
    t_s, path, rotations = np.array([-0.7, 0.0]), np.empty((2, 3)), np.empty((2, 3, 3))
    offset = np.append(np.zeros(5), vector)
    shared_path_descent._set_path(t_s, np.zeros((2, 3)), np.eye(3), offset, path, rotations)
    np.testing.assert_allclose(rotations, rotation_from_vector(-t_s[:, None] * vector), atol=1e-14)


def test_solvers_solve():
    rng = np.random.default_rng(3)
    for n, solve in ((8, shared_path_descent._solve), (5, two_view_descent._solve), (6, None)):
        root, right = rng.normal(size=(n, n)), rng.normal(size=n)
        matrix, solution = root @ root.T + np.eye(n), np.empty(n)
        expected = np.linalg.solve(matrix, right)
        if solve is None:
            solution = right.copy()
            rigid_path_descent._solve(np.tril(matrix), solution)
        else:
            solve(matrix, right, solution)
        np.testing.assert_allclose(solution, expected, rtol=1e-10)


def test_what_a_point_says_of_its_place_and_rate_is_the_same_alone_and_together():
    """With one view far off, so that the robust weight is the same, too."""
    rng = np.random.default_rng(4)
    n, s, inverse = 6, np.array([0.2, -0.1, 0.3]), 1.0 / 3e-4
    path = np.column_stack([0.1 * rng.normal(size=(n, 2)), np.linspace(0.0, 0.8, n)])
    seen = (s[:2] + s[2] * path[:, :2]) / (1.0 + s[2] * path[:, 2:]) + 3e-4 * rng.normal(size=(n, 2))
    seen[2] += 0.01
    sums = np.zeros((n + 1, on_path._N_SUMS))
    on_path._add_up(seen, path, n, s, inverse, False, sums)
    row, n_local = sums[n], shared_path_descent.N_LOCAL
    own, coupling = np.empty((1, shared_path_descent._N_OWN)), np.empty((1, 3, n_local))
    scratch = np.empty((n_local + 3, n_local))
    information, score = np.zeros((n_local, n_local)), np.zeros(n_local)
    mean_square = shared_path_descent._add_point(
        seen,
        -0.1 * np.arange(n),
        path,
        np.eye(3),
        0,
        np.arange(n)[None],
        n,
        s[None].copy(),
        np.array([1.0 / inverse]),
        shared_path_descent._ROBUST_SIGMAS**2,
        own,
        coupling,
        scratch,
    )
    shared_path_descent._eliminate(0, own, coupling, scratch, information, score)
    rate = row[3] - (row[1] ** 2 + row[2] ** 2) / row[0], row[6] - (row[1] * row[4] + row[2] * row[5]) / row[0]
    np.testing.assert_allclose(own[0, :7], [row[0], row[1], row[2], rate[0], row[4], row[5], rate[1]], rtol=1e-9)
    assert mean_square == pytest.approx(row[7] / (2 * n - 3))
