"""The velocity of a thing by all its points: exact without noise, and as sure as it says with it."""

from dataclasses import replace

import numpy as np
import pytest

from ttcvid.geometry.estimation.rigid_motion import Points, views_by_track
from ttcvid.geometry.estimation.shared_translation import common_velocities
from ttcvid.geometry.rotation import normalize, rotation_from_vector

SINCE_S = -0.1 * np.arange(6.0)[::-1]
TURNS = rotation_from_vector(SINCE_S[:, None] * np.array([0.02, -0.2, 0.05]))
CENTRE_M, SIZE_M, N_POINTS, SIGMA = np.array([4.0, 0.5, 40.0]), np.array([4.0, 1.5, 2.0]), 8, 0.1 / 720.0


def points_of(rng, velocities_m_s, size_m=SIZE_M, sigma=0.0):
    """Things side by side, each with its velocity, seen by a camera that turns."""
    rays, thing = [], np.repeat(np.arange(len(velocities_m_s)), N_POINTS)
    where = CENTRE_M + rng.uniform(-0.5, 0.5, (len(thing), 3)) * size_m
    for since_s, turn in zip(SINCE_S, TURNS, strict=True):
        plane = where + since_s * np.asarray(velocities_m_s)[thing]
        plane = plane / plane[:, 2:]
        plane[:, :2] += sigma * rng.normal(size=(len(thing), 2))
        rays.append(normalize(plane) @ turn)
    by_track = views_by_track(np.stack(rays))
    return Points(by_track, np.full(len(thing), SIGMA), SINCE_S, np.arange(len(thing)), thing)


def test_velocities_over_depth_of_flat_things_are_exact_without_noise():
    velocities = np.array([[-3.0, 0.0, -8.0], [5.0, 1.0, 2.0]])
    points = points_of(np.random.default_rng(1), velocities, SIZE_M * (1.0, 1.0, 0.0))
    v_hz, _ = common_velocities(points, TURNS, np.zeros((2, 3)), 8)
    np.testing.assert_allclose(v_hz, velocities / CENTRE_M[2], rtol=1e-9, atol=1e-9)


def test_a_velocity_is_as_sure_as_it_says():
    velocity = np.array([-3.0, 0.0, -8.0])
    # Twice as deep as wide, root mean square of width and height.
    size_m = np.array([2.0, 1.5, 5.0])
    chi2 = []
    for seed in range(300):
        points = points_of(np.random.default_rng(seed), velocity[None], size_m, SIGMA)
        v_hz, info = common_velocities(points, TURNS, np.zeros((1, 3)), 4)
        off = v_hz[0] - velocity / CENTRE_M[2]
        chi2.append(off @ info[0] @ off)
    # Three degrees of freedom.
    assert 2.0 < np.mean(chi2) < 4.0
    assert np.mean(np.array(chi2) < 11.3) > 0.97


def test_what_is_believed_of_an_approach_holds_where_the_points_do_not_tell_it():
    """A small thing that passes: without it, its velocity towards us is mostly noise."""
    velocity, size_m, ahead_hz, free_hz = np.array([-3.0, 0.0, 0.0]), SIZE_M * 0.1, [], []
    for seed in range(60):
        points = points_of(np.random.default_rng(seed), velocity[None], size_m, 20.0 * SIGMA)
        points = replace(points, sigma_norm=20.0 * points.sigma_norm)
        for found, sigma_hz in ((ahead_hz, 0.075), (free_hz, np.inf)):
            v_hz, info = common_velocities(points, TURNS, np.zeros((1, 3)), 5, np.array([sigma_hz]))
            found.append(v_hz[0, 2])
            assert info[0, 2, 2] >= (0.0 if sigma_hz == np.inf else sigma_hz**-2.0)
    assert np.std(free_hz) > 2.0 * 0.075
    assert np.std(ahead_hz) < 0.075


@pytest.mark.parametrize("n_seen", [0, 1])
def test_what_is_not_seen_twice_keeps_the_velocity_that_it_had(n_seen):
    points = points_of(np.random.default_rng(2), [[-3.0, 0.0, -8.0]])
    points.rays[:, :, : points.rays.shape[2] - n_seen] = np.nan
    v_hz, info = common_velocities(points, TURNS, np.full((1, 3), 0.1), 3)
    np.testing.assert_array_equal(v_hz, np.full((1, 3), 0.1))
    assert np.linalg.det(info[0]) == 0.0
