"""The lines of top and bottom of a straight mover meet at its epipole."""

import numpy as np
import pytest

from ttcvid.geometry.horizon.outline import fit_outline

F_PX = 600.0


def outlines(velocity_m_s, pace=None, n=100, start_m=(-2.0, 0.0, 9.0), camera_m=1.6, height_m=1.75):
    """x, top and bottom (n, 3) of somebody who walks before a level camera, and the times."""
    t_s = np.linspace(0.0, 4.0, n)
    way = t_s if pace is None else pace(t_s)
    place = np.array(start_m) + way[:, None] * np.array(velocity_m_s)
    x, z = place[:, 0], place[:, 2]
    return np.column_stack([x / z, (camera_m - height_m) / z, camera_m / z]), t_s


def fitted(outline, t_s, border_sigma=0.0):
    return fit_outline(outline, t_s, (t_s * 1.999).astype(int), 7.0, border_sigma)


@pytest.mark.parametrize("velocity", [(1.2, 0, 0.8), (1.2, 0, -0.8), (-0.3, 0, 1.0), (0.1, 0, -1.2)])
def test_the_epipole_is_the_direction_of_motion(velocity):
    fit = fitted(*outlines(velocity))
    np.testing.assert_allclose(fit.direction, np.array(velocity) / np.linalg.norm(velocity), atol=1e-6)


def test_no_steady_pace_is_needed():
    fit = fitted(*outlines((1.2, 0, 0.8), pace=lambda t: t + 0.15 * np.sin(2 * np.pi * t)))
    np.testing.assert_allclose(fit.direction, np.array([1.2, 0, 0.8]) / np.hypot(1.2, 0.8), atol=1e-6)


def test_straight_across_the_epipole_is_at_infinity():
    fit = fitted(*outlines((1.2, 0.0, 0.0)))
    np.testing.assert_allclose(np.abs(fit.direction), [1.0, 0.0, 0.0], atol=1e-6)


def test_outlines_that_run_into_others_are_left_aside():
    outline, t_s = outlines((1.2, 0, 0.8))
    outline[30:50, 2] += 40 / F_PX  # the feet of somebody nearer
    outline[70:80, 1] -= 30 / F_PX
    outline += np.random.default_rng(1).normal(0, 0.5 / F_PX, outline.shape)
    fit = fitted(outline, t_s)
    assert np.degrees(np.arccos(fit.direction @ np.array([1.2, 0, 0.8]) / np.hypot(1.2, 0.8))) < 2.0


def test_the_covariance_is_as_large_as_the_error():
    """Distance from the horizon in its standard deviations, over 14 noisy walks: about one."""
    rng = np.random.default_rng(5)
    ratio = []
    for _ in range(14):
        outline, t_s = outlines((1.2, 0, rng.choice([-0.8, 0.8])))
        fit = fitted(outline + rng.normal(0, 1.5 / F_PX, outline.shape), t_s)
        ratio.append(fit.direction[1] / np.sqrt(fit.covariance[1, 1]))
    assert 0.2 < np.sqrt(np.mean(np.square(ratio))) < 1.2


def test_a_border_that_is_seen_elsewhere_all_the_time_is_in_the_covariance():
    sure, unsure = (fitted(*outlines((1.2, 0, 0.8)), border_sigma=s) for s in (0.0, 1.0 / F_PX))
    assert unsure.covariance[1, 1] > 100 * sure.covariance[1, 1] + 1e-8


def test_what_is_hidden_by_and_by_does_not_go_on_steadily():
    outline, t_s = outlines((0.0, 0, 0.0))
    outline[:, 2] -= 20 / F_PX * (np.arange(len(t_s)) // 12 % 2)
    outline += np.random.default_rng(1).normal(0, 0.5 / F_PX, outline.shape)
    fit = fitted(outline, t_s)
    assert fit is None or fit.steadiness < 0.5


def test_too_few_blocks_tell_nothing():
    outline, t_s = outlines((1.2, 0, 0.8))
    assert fit_outline(outline, t_s, (t_s > 2).astype(int), 2.0, 0.0) is None


def bobbing(outline, t_s, rng, part=0.013, steps_hz=1.9):
    """The outline of somebody whose head goes up and down with the steps, seen with some noise."""
    height = outline[:, 2] - outline[:, 1]
    bobbed = outline + rng.normal(0, 0.5 / F_PX, outline.shape)
    bobbed[:, 1] -= part * height * np.sin(2 * np.pi * steps_hz * t_s + rng.uniform(0, 6.3))
    return bobbed


def test_a_head_that_bobs_with_the_steps_costs_little():
    rng = np.random.default_rng(3)
    outline, t_s = outlines((1.2, 0, 0.8))
    still, bobs = (fitted(bobbing(outline, t_s, rng, part), t_s) for part in (0.0, 0.013))
    assert bobs.noise < 1.3 * still.noise
    assert np.sqrt(bobs.covariance[1, 1]) < 1.5 * np.sqrt(still.covariance[1, 1])


def test_the_covariance_of_those_who_bob_is_as_large_as_the_error():
    rng = np.random.default_rng(6)
    ratio, error = [], []
    for _ in range(15):
        outline, t_s = outlines((1.2, 0, rng.choice([-0.8, 0.8])))
        fit = fitted(bobbing(outline, t_s, rng, steps_hz=rng.uniform(1.5, 2.2)), t_s)
        ratio.append(fit.direction[1] / np.sqrt(fit.covariance[1, 1]))
        error.append(fit.direction[1])
    assert 0.2 < np.sqrt(np.mean(np.square(ratio))) < 1.2
    assert np.degrees(np.sqrt(np.mean(np.square(error)))) < 0.3
