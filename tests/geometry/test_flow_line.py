"""Flow against direction: exact zeros, known chi-squares, and the speed that the consensus needs."""

import time

import numpy as np
import pytest
from hypothesis import given
from moving_points import jitter, moving_points, views

from ttcvid.geometry.paper.flow_line import flow_line_chi2, flow_line_distance_px
from ttcvid.geometry.rotation import normalize, tangent_basis


def random_flows(n, rng):
    q = normalize(rng.normal(size=(n, 3)))
    return q, normalize(q + 0.01 * rng.normal(size=(n, 3)))


@given(moving_points())
def test_true_directions_have_chi2_zero(scene):
    position, velocity = scene
    q, p = views(position, velocity, [-0.3, 0.0])
    sigma = np.full(len(q), 1e-4)
    own = normalize(velocity)
    assert np.abs(np.diagonal(flow_line_chi2(own, q, p, sigma))).max() < 1e-12


def test_chi2_is_the_smallest_eigenvalue_in_the_plane_normal_to_the_direction():
    rng = np.random.default_rng(1)
    q, p = random_flows(40, rng)
    directions = normalize(rng.normal(size=(7, 3)))
    sigma = rng.uniform(1e-4, 1e-3, 40)
    u, w = (np.einsum("mij,ni->mnj", tangent_basis(directions), rays) for rays in (q, p))
    scatter = u[..., :, None] * u[..., None, :] + w[..., :, None] * w[..., None, :]
    expected = np.linalg.eigvalsh(scatter)[..., 0] / sigma**2
    chi2 = flow_line_chi2(directions, q, p, sigma)
    np.testing.assert_allclose(chi2, expected, rtol=1e-6, atol=1e-14 / sigma.min() ** 2)
    np.testing.assert_allclose(chi2[3], flow_line_chi2(directions[3], q, p, sigma), rtol=1e-9)


def test_chi2_of_noise_has_one_degree_of_freedom():
    rng = np.random.default_rng(2)
    position = np.column_stack([rng.uniform(5, 15, 4000), rng.uniform(-3, 3, 4000), rng.uniform(20, 50, 4000)])
    direction = normalize(np.array([0.2, 0.1, -1.0]))
    q, p = jitter(views(position, 8 * direction, [-0.3, 0.0]), 2e-4, rng)
    chi2 = flow_line_chi2(direction, q, p, np.full(4000, 2e-4))
    assert chi2.mean() == pytest.approx(1.0, abs=0.08)
    assert (chi2 < 6.635).mean() == pytest.approx(0.99, abs=0.005)


def test_points_on_the_direction_agree_with_it():
    e = np.array([[0.0, 0.0, 1.0]])
    assert flow_line_chi2(e[0], e, e, np.array([1e-4]))[0] == 0


def test_missing_rays_and_sigmas_stay_missing():
    q = np.array([[np.nan, 0, 1], [0, 0, 1], [0, 0, 1.0]])
    p = normalize(np.array([[0.1, 0, 1], [np.nan, 0, 1], [0.1, 0, 1]]))
    assert np.isnan(flow_line_chi2(np.array([1.0, 0, 0]), q, p, np.array([1e-4, 1e-4, 0.0]))).all()


def test_distance_in_the_picture_is_that_of_the_line():
    first, second = np.array([[0.0, 0], [5, 5], [1, 1]]), np.array([[1.0, 1], [5, 9], [1, 1]])
    distance = flow_line_distance_px(np.array([2.0, 0.0]), first, second)
    np.testing.assert_allclose(distance, [np.sqrt(2), 3, np.nan])


def test_two_hundred_directions_against_a_thousand_lines_are_quick():
    rng = np.random.default_rng(3)
    q, p = random_flows(1000, rng)
    directions, sigma = normalize(rng.normal(size=(200, 3))), np.full(1000, 1e-4)
    durations = []
    for _ in range(10):
        start = time.process_time()
        flow_line_chi2(directions, q, p, sigma)
        durations.append(time.process_time() - start)
    assert min(durations) < 0.05, "measured 6 ms; the bound leaves room for a busy machine"
