"""With a horizon an epipole lies on it: moved there along its covariance, and single tracks find theirs alone."""

import numpy as np
import pytest
from relative_motion import CAMERA, FOCAL_PX, flows_of, unit

from ttcvid.geometry.paper.planar import planar_epipole
from ttcvid.geometry.rotation import rotation_from_vector, tangent_basis
from ttcvid.model import Horizon, Status
from ttcvid.stages.horizon.planar_motion import (
    followed_plane,
    horizon_offset_px,
    horizon_plane,
    onto_horizon,
)

LEVEL_PX = CAMERA.cy_px
SIGMA_RAD = 0.002


def plane_at(y_left_px=LEVEL_PX, y_right_px=LEVEL_PX, sigma_rad=SIGMA_RAD):
    return horizon_plane(CAMERA, Horizon(y_left_px, y_right_px, CAMERA.image_size, sigma_rad, "test"))


def plane_of(covariance_rad2):
    """A level plane whose pitch and roll have a covariance."""
    return horizon_plane(
        CAMERA, Horizon(LEVEL_PX, LEVEL_PX, CAMERA.image_size, SIGMA_RAD, "test", covariance_rad2=covariance_rad2)
    )


def tangent_cov(direction, along_rad, across_rad, turn_rad=0.0):
    """Covariance in the tangent plane of a direction, with axes turned by an angle."""
    basis = tangent_basis(direction)
    turn = np.array([[np.cos(turn_rad), -np.sin(turn_rad)], [np.sin(turn_rad), np.cos(turn_rad)]])
    return basis @ turn @ np.diag([along_rad**2, across_rad**2]) @ turn.T @ basis.T


def test_the_plane_holds_the_line():
    plane = plane_at(150.0, 190.0)
    assert plane.line_px == (150.0, 190.0)
    for x_px, y_px in ((0.0, 150.0), (639.0, 190.0)):
        ray = np.array([(x_px - CAMERA.cx_px) / FOCAL_PX, (y_px - CAMERA.cy_px) / FOCAL_PX, 1.0])
        assert plane.normal @ ray == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("turn_rad", [0.0, 0.4, 1.1, 2.0])
def test_an_epipole_comes_to_lie_on_the_horizon(turn_rad):
    plane, direction = plane_at(140.0, 200.0), unit([0.2, 0.05, -1.0])
    moved, cov = onto_horizon(direction, tangent_cov(direction, 0.03, 0.01, turn_rad), plane)
    assert np.linalg.norm(moved) == pytest.approx(1.0)
    # The height over a tangent plane is linear in the step: on a sphere it is exact to second order.
    assert plane.normal @ moved == pytest.approx(0.0, abs=0.05 * abs(plane.normal @ direction))
    np.testing.assert_allclose(cov @ moved, 0.0, atol=1e-12)
    assert (np.linalg.eigvalsh(cov) > -1e-15).all()


def test_an_epipole_moves_along_its_own_uncertainty():
    """One whose error runs at 45 deg goes down that way; a round one goes the shortest way."""
    plane, direction = plane_at(), unit([0.0, 0.05, -1.0])
    straight, _ = onto_horizon(direction, tangent_cov(direction, 0.02, 0.02), plane)
    assert straight[0] == pytest.approx(0.0, abs=1e-9)
    basis = tangent_basis(direction)
    slanted_axis = unit([1.0, 1.0, 0.0])
    turn = np.arctan2(*(basis.T @ slanted_axis)[::-1])
    slanted, _ = onto_horizon(direction, tangent_cov(direction, 0.05, 1e-4, turn), plane)
    assert slanted[0] == pytest.approx(-0.05, rel=0.02)


def test_what_is_left_of_the_covariance_is_the_horizons_own_error_upright():
    plane, direction = plane_at(sigma_rad=0.004), unit([0.0, 0.03, -1.0])
    moved, cov = onto_horizon(direction, tangent_cov(direction, 0.02, 0.02), plane)
    along = unit(np.cross(plane.normal, moved))
    assert np.sqrt(plane.normal @ cov @ plane.normal) == pytest.approx(0.004, rel=0.01)
    assert np.sqrt(along @ cov @ along) == pytest.approx(0.02, rel=0.01)


def test_the_horizon_makes_a_noisy_epipole_better_along_it_too_where_its_errors_are_linked():
    rng = np.random.default_rng(91)
    plane, true = plane_at(sigma_rad=1e-4), unit([0.1, 0.0, -1.0])
    cov = tangent_cov(true, 0.04, 0.005, 0.9)
    basis = tangent_basis(true)
    steps = rng.multivariate_normal(np.zeros(2), basis.T @ cov @ basis, 300)
    before = np.array([unit(true + basis @ step) for step in steps])
    after, covs = zip(*(onto_horizon(one, cov - np.outer(one, one @ cov), plane) for one in before), strict=True)
    across = unit(np.cross(plane.normal, true))
    left_rad = np.std(np.array(after) @ across)
    assert left_rad < 0.5 * np.std(before @ across)
    assert left_rad == pytest.approx(np.sqrt(np.mean([across @ one @ across for one in covs])), rel=0.15)


def test_an_exactly_known_epipole_does_not_break_anything():
    plane, direction = plane_at(), unit([0.0, 0.03, -1.0])
    moved, cov = onto_horizon(direction, np.zeros((3, 3)), plane)
    assert np.isfinite(moved).all()
    assert np.isfinite(cov).all()


@pytest.mark.parametrize("sense", [1.0, -1.0])
@pytest.mark.parametrize("below_px", [-20.0, 0.0, 35.0])
def test_offset_from_the_horizon_is_positive_below_it(below_px, sense):
    direction = sense * unit([0.1, below_px / FOCAL_PX, 1.0])
    assert horizon_offset_px(direction, plane_at(), CAMERA) == pytest.approx(below_px, abs=1e-9)


def test_offset_is_the_distance_from_a_slanted_horizon():
    plane = plane_at(100.0, 739.0)
    direction = unit([(200.0 - CAMERA.cx_px) / FOCAL_PX, (310.0 - CAMERA.cy_px) / FOCAL_PX, 1.0])
    assert horizon_offset_px(direction, plane, CAMERA) == pytest.approx(10.0 / np.sqrt(2.0))


def test_an_epipole_at_infinity_has_no_offset():
    assert horizon_offset_px(unit([1.0, 0.0, 0.01]), plane_at(), CAMERA) is None
    assert horizon_offset_px(unit([1.0, 0.0, 0.03]), plane_at(), CAMERA) is not None


def directions_by(flows, plane):
    """Direction, covariance and status of each flow where its line meets the horizon."""
    return planar_epipole(flows.first, flows.second, plane.normal, flows.sigma_rad, plane.covariance)


def test_a_single_track_gets_its_epipole_from_the_horizon():
    position_m = np.array([[20.0, 1.0, 20.0], [-4.0, 1.5, 12.0], [3.0, -2.0, 30.0]])
    velocity_m_s = np.array([[-10.0, 0.0, -2.0], [1.0, 0.0, -9.0], [0.5, 0.0, 7.0]])
    direction, cov, status = directions_by(flows_of(position_m, velocity_m_s), plane_at())
    np.testing.assert_allclose(direction, unit(velocity_m_s), atol=1e-8)
    assert (status == Status.ok).all()
    np.testing.assert_allclose(np.einsum("nij,nj->ni", cov, direction), 0.0, atol=1e-12)


def test_a_single_tracks_epipole_is_off_by_what_its_covariance_says():
    rng = np.random.default_rng(92)
    n, true = 2000, unit([-0.5, 0.0, -1.0])
    flows = flows_of(np.tile([[5.0, 1.5, 12.0]], (n, 1)), 9.0 * true, sigma_px=0.2, rng=rng)
    direction, cov, status = directions_by(flows, plane_at(sigma_rad=1e-5))
    assert (status == Status.ok).all()
    along = unit([-1.0, 0.0, 0.5])
    errors, predicted = (direction - true) @ along, np.einsum("i,nij,j->n", along, cov, along)
    assert np.mean(errors**2 / predicted) == pytest.approx(1.0, abs=0.12)


def test_a_track_without_an_epipole_says_why():
    position_m = np.array([[5.0, 0.0, 20.0], [5.0, 1.0, 20.0], [5.0, 1.0, 20.0]])
    velocity_m_s = np.array([[-3.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, -9.0]])
    flows = flows_of(position_m, velocity_m_s, sigma_px=0.2)
    flows.first[2] = np.nan
    direction, cov, status = directions_by(flows, plane_at())
    assert [Status(s).name for s in status] == ["parallel_to_horizon", "no_parallax", "short_track"]
    assert np.isnan(direction).all()
    assert np.isnan(cov).all()


def test_a_track_that_crosses_has_its_epipole_at_infinity_and_a_direction():
    flows = flows_of(np.array([[5.0, 1.0, 20.0]]), np.array([-9.0, 0.0, 0.0]), sigma_px=0.2)
    direction, _, status = directions_by(flows, plane_at())
    assert status[0] == Status.epipole_at_infinity
    np.testing.assert_allclose(direction[0], [-1.0, 0.0, 0.0], atol=1e-9)


def test_an_uncertain_roll_counts_at_the_sides_only():
    """Straight ahead only the pitch matters, to the right only the roll."""
    plane = plane_of(((1e-6, 0.0), (0.0, 4e-4)))
    directions = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], unit([1.0, 0.0, 1.0])])
    np.testing.assert_allclose(plane.sigma_rad(directions), [1e-3, 2e-2, np.sqrt(0.5 * (1e-6 + 4e-4))])


def test_the_plane_goes_along_with_a_pitching_camera():
    """Looking down by 1 deg within a frame raises the horizon by 1 deg in the picture: y becomes smaller."""
    calibrated, nod_rad = plane_at(), np.radians(1.0)
    cam_R_prev = rotation_from_vector(np.array([nod_rad, 0.0, 0.0]))
    assert (cam_R_prev @ [0.0, 0.0, 1.0])[1] < 0.0
    plane = followed_plane(calibrated, calibrated, cam_R_prev, 1e-6, CAMERA)
    assert plane.line_px == pytest.approx([LEVEL_PX - FOCAL_PX * np.tan(nod_rad)] * 2, abs=1e-3)


def test_the_plane_returns_to_where_it_was_calibrated():
    calibrated = plane_at(150.0, 190.0)
    plane = followed_plane(calibrated, calibrated, rotation_from_vector(np.array([0.03, 0.0, 0.02])), 0.04, CAMERA)
    before = np.linalg.norm(plane.normal - calibrated.normal)
    for _ in range(50):
        plane = followed_plane(plane, calibrated, np.eye(3), 0.04, CAMERA)
    assert np.linalg.norm(plane.normal - calibrated.normal) == pytest.approx(before * np.exp(-1.0), rel=0.02)


def test_turning_about_the_normal_leaves_the_plane_alone():
    calibrated = plane_at(150.0, 190.0)
    turned = followed_plane(calibrated, calibrated, rotation_from_vector(0.4 * calibrated.normal), 0.04, CAMERA)
    np.testing.assert_allclose(turned.line_px, calibrated.line_px, atol=1e-9)


def test_the_plane_stays_while_the_rotation_is_unknown_and_begins_anew_after_a_cut():
    calibrated = plane_at()
    assert followed_plane(calibrated, calibrated, None, 0.04, CAMERA).line_px == pytest.approx(calibrated.line_px)
    assert followed_plane(None, calibrated, np.eye(3), None, CAMERA) is calibrated
    assert followed_plane(None, None, np.eye(3), 0.04, CAMERA) is None
