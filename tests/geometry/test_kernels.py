"""Building blocks of the compiled estimators against numpy."""

import numpy as np
import pytest

from ttcvid.geometry.kernels.medians import median
from ttcvid.geometry.kernels.normal_equations import add_equations
from ttcvid.geometry.kernels.solve import eliminate, follow, solve

RNG = np.random.default_rng(3)


@pytest.mark.parametrize("n", [1, 3, 9])
def test_a_positive_definite_system_is_solved_by_its_lower_half(n):
    root, right = RNG.normal(size=(n, n)), RNG.normal(size=n)
    matrix, solution = root @ root.T + np.eye(n), right.copy()
    product = solve(np.tril(matrix), solution)
    np.testing.assert_allclose(solution, np.linalg.solve(matrix, right), rtol=1e-10)
    assert product == pytest.approx(right @ solution)


def eliminated(matrix, right):
    """Information and score of the last four of seven unknowns, and the step of all, the first three following."""
    equations, kept = np.vstack([np.tril(matrix), right]), np.empty((3, 8))
    information, score, step = np.zeros((4, 4)), np.zeros(4), np.full(7, np.nan)
    eliminate(equations, kept, information, score)
    left = information.copy(), score.copy()
    information += np.eye(4) * (np.trace(information) == 0.0)
    solve(information, score)
    step[3:] = score
    follow(kept, step)
    return *left, step


def test_unknowns_that_follow_are_eliminated_and_found_again():
    root, right = RNG.normal(size=(7, 7)), RNG.normal(size=7)
    matrix = root @ root.T + np.eye(7)
    information, score, step = eliminated(matrix, right)
    follow_by = np.linalg.solve(matrix[:3, :3], matrix[:3, 3:]).T
    np.testing.assert_allclose(information, np.tril(matrix[3:, 3:] - follow_by @ matrix[:3, 3:]), rtol=1e-10)
    np.testing.assert_allclose(score, right[3:] - follow_by @ right[:3], rtol=1e-10)
    np.testing.assert_allclose(step, np.linalg.solve(matrix, right), rtol=1e-10)


def test_equations_that_leave_what_follows_open_say_nothing_of_the_others():
    root, right = RNG.normal(size=(7, 7)), RNG.normal(size=7)
    root[2], right[2] = 0.0, 0.0
    information, score, step = eliminated(root @ root.T, right)
    assert not information.any()
    assert not score.any()
    np.testing.assert_array_equal(step, 0.0)


def test_equations_are_products_of_derivatives_and_residuals():
    rows, information, score = RNG.normal(size=(4, 21)), np.zeros((3, 3)), np.zeros(3)
    add_equations(rows, 20, information, score)
    used = rows[:, :20]
    np.testing.assert_allclose(information, np.tril(used[:3] @ used[:3].T), rtol=1e-12)
    np.testing.assert_allclose(score, used[:3] @ used[3], rtol=1e-12)


@pytest.mark.parametrize("n", [1, 2, 7, 50, 51])
@pytest.mark.parametrize("n_values", [2, 1000])
def test_median_is_that_of_numpy(n, n_values):
    values = RNG.integers(n_values, size=n).astype(float)
    assert median(values.copy()) == np.median(values)
