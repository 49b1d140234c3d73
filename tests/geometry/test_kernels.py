"""Building blocks of the compiled estimators against numpy."""

import numpy as np
import pytest

from ttcvid.geometry.kernels.medians import median
from ttcvid.geometry.kernels.normal_equations import add_equations
from ttcvid.geometry.kernels.solve import eliminate, solve

RNG = np.random.default_rng(3)


@pytest.mark.parametrize("n", [1, 3, 9])
def test_a_positive_definite_system_is_solved_by_its_lower_half(n):
    root, right = RNG.normal(size=(n, n)), RNG.normal(size=n)
    matrix, solution = root @ root.T + np.eye(n), right.copy()
    product = solve(np.tril(matrix), solution)
    np.testing.assert_allclose(solution, np.linalg.solve(matrix, right), rtol=1e-10)
    assert product == pytest.approx(right @ solution)


def test_what_is_left_of_equations_when_some_unknowns_follow_has_the_same_solution_for_the_others():
    root, right = RNG.normal(size=(6, 6)), RNG.normal(size=6)
    matrix = root @ root.T + np.eye(6)
    left, of_others = np.tril(matrix), right.copy()
    eliminate(left, of_others, 2)
    others = of_others[2:].copy()
    solve(left[2:, 2:].copy(), others)
    np.testing.assert_allclose(others, np.linalg.solve(matrix, right)[2:], rtol=1e-10)


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
