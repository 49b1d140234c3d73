"""The horizon through epipoles on the sphere."""

import numpy as np
import pytest

from ttcvid.geometry.horizon.line import (
    band_px,
    fit_horizon,
    is_one_direction,
    pitch_roll_covariance_rad2,
    widest_angle_rad,
)
from ttcvid.geometry.horizon.plane import horizon_px, normal_by_pitch_roll, normal_from_horizon, pitch_roll_rad
from ttcvid.geometry.rotation import normalize, tangent_basis
from ttcvid.model import Camera, Horizon, ImageSize
from ttcvid.simulate.poses import mean_horizon_px
from ttcvid.simulate.scene import CameraSpec, Scene, camera_of

SIZE = ImageSize(640, 480)
CAMERA = Camera(600.0, 600.0, 319.5, 239.5, SIZE)
TRUE = Horizon(113.0, 95.0, SIZE, 0.01, "test")
NORMAL = normal_from_horizon(CAMERA, TRUE)
FLOOR_RAD = 1e-4


def epipoles(headings_rad, sigma_rad, rng=None, along=5.0):
    """Directions on the true horizon with covariances ``along`` times as long along it as across, and noise."""
    level = normalize(np.cross(NORMAL, [0.0, 0.0, 1.0]))
    ahead = np.cross(level, NORMAL)
    true = np.cos(headings_rad)[:, None] * ahead + np.sin(headings_rad)[:, None] * level
    across = normalize(np.cross(NORMAL, true))
    covariance = sigma_rad**2 * (np.outer(NORMAL, NORMAL) + along**2 * across[:, :, None] * across[:, None, :])
    if rng is None:
        return true, covariance
    up, aside = rng.standard_normal((2, len(true), 1)) * sigma_rad
    return normalize(true + up * NORMAL + along * aside * across), covariance


def test_exact_epipoles_give_the_exact_line():
    """One of them straight ahead, one at infinity, one behind."""
    directions, covariances = epipoles(np.radians([0.0, 90.0, 200.0]), 0.01)
    fit = fit_horizon(directions, covariances, FLOOR_RAD)
    np.testing.assert_allclose(horizon_px(CAMERA, fit.normal), (113.0, 95.0), atol=1e-6)
    assert fit.is_used.all()


def test_the_sign_of_an_epipole_does_not_matter():
    directions, covariances = epipoles(np.radians([10.0, 60.0, 130.0]), 0.01, np.random.default_rng(1))
    one, other = (fit_horizon(directions * sign, covariances, FLOOR_RAD) for sign in (1.0, [[1.0], [-1.0], [1.0]]))
    np.testing.assert_allclose(one.normal, other.normal, atol=1e-9)


def test_an_epipole_off_the_line_is_left_out():
    directions, covariances = epipoles(np.radians([0.0, 40.0, 80.0, 120.0, 160.0]), 0.003, np.random.default_rng(2))
    directions[2] = normalize(directions[2] + 0.2 * NORMAL)
    fit = fit_horizon(directions, covariances, FLOOR_RAD)
    assert fit.is_used.tolist() == [True, True, False, True, True]
    assert np.degrees(np.arccos(fit.normal @ NORMAL)) < 0.5
    assert fit.residual_rad[2] == pytest.approx(0.2, abs=0.02)


def test_the_band_holds_the_true_line_as_often_as_it_says():
    x_px, inside = np.array([0.0, 319.5, 639.0]), []
    for seed in range(200):
        rng = np.random.default_rng([seed, 3])
        directions, covariances = epipoles(rng.uniform(0, np.pi, rng.integers(3, 9)), 0.004, rng)
        y_px, half_px = band_px(CAMERA, fit_horizon(directions, covariances, FLOOR_RAD), x_px)
        inside.append(np.abs(y_px - [113.0, 104.0, 95.0]) <= half_px)
    assert (np.mean(inside, axis=0) > 0.9).all()
    assert (np.mean(inside, axis=0) < 0.99).all()


def test_epipoles_that_scatter_more_than_they_say_widen_the_band():
    directions, covariances = epipoles(np.radians(np.arange(0.0, 180.0, 20.0)), 0.01, np.random.default_rng(4))
    vain = fit_horizon(directions, covariances / 4.0, FLOOR_RAD)
    exact = fit_horizon(epipoles(np.radians(np.arange(0.0, 180.0, 20.0)), 0.01)[0], covariances / 4.0, FLOOR_RAD)
    assert exact.scatter_rad == FLOOR_RAD
    assert vain.scatter_rad > 10 * FLOOR_RAD
    assert np.trace(vain.covariance) > 1.5 * np.trace(exact.covariance)


def test_one_direction_is_told_from_several():
    rng = np.random.default_rng(5)
    same = epipoles(np.radians([30.0, 30.0, 210.0, 30.0]), 0.004, rng)
    several = epipoles(np.radians([30.0, 30.0, 210.0, 70.0]), 0.004, rng)
    assert is_one_direction(*same, FLOOR_RAD, 0.9999)
    assert not is_one_direction(*several, FLOOR_RAD, 0.9999)
    assert np.degrees(widest_angle_rad(*several)) == pytest.approx(40.0 - 3 * np.sqrt(2) * np.degrees(0.02), abs=3.0)
    assert widest_angle_rad(*same) == 0.0


def test_with_roll_zero_one_epipole_is_enough():
    fit = fit_horizon(*epipoles(np.array([0.0]), 0.004), FLOOR_RAD, roll_sigma_rad=1e-4)
    left, right = horizon_px(CAMERA, fit.normal)
    assert left == pytest.approx(right, abs=0.2)
    assert left == pytest.approx(104.0, abs=0.3)
    assert fit_horizon(*epipoles(np.array([0.0]), 0.004), FLOOR_RAD) is None


@pytest.mark.parametrize(("pitch_deg", "roll_deg"), [(6.0, 0.0), (-12.0, 4.0), (3.0, -5.0)])
def test_pitch_and_roll_are_those_of_the_simulator(pitch_deg, roll_deg):
    camera = CameraSpec(hfov_deg=70, pitch_deg=pitch_deg, roll_deg=roll_deg, fps=10, n_frames=1)
    scene = Scene(name="test", camera=camera)
    left, right = mean_horizon_px(scene)
    normal = normal_from_horizon(camera_of(scene), Horizon(left, right, ImageSize(640, 360), 0.01, ""))
    np.testing.assert_allclose(np.degrees(pitch_roll_rad(normal)), (pitch_deg, roll_deg), atol=1e-6)


def test_derivative_by_pitch_and_roll():
    def normal(pitch, roll):
        return np.array([-np.sin(roll) * np.cos(pitch), -np.cos(roll) * np.cos(pitch), -np.sin(pitch)])

    step, derivative = 1e-6, normal_by_pitch_roll(0.1, -0.05)
    np.testing.assert_allclose(derivative[:, 0], (normal(0.1 + step, -0.05) - normal(0.1, -0.05)) / step, atol=1e-5)
    np.testing.assert_allclose(derivative[:, 1], (normal(0.1, -0.05 + step) - normal(0.1, -0.05)) / step, atol=1e-5)


def test_covariance_of_pitch_and_roll_is_that_of_the_normal():
    fit = fit_horizon(*epipoles(np.radians([0.0, 50.0, 100.0]), 0.004), FLOOR_RAD)
    by_angles = normal_by_pitch_roll(*pitch_roll_rad(fit.normal))
    np.testing.assert_allclose(by_angles @ pitch_roll_covariance_rad2(fit) @ by_angles.T, fit.covariance, atol=1e-12)
    assert tangent_basis(fit.normal).shape == (3, 2)
