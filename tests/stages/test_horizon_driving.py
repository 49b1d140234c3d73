"""The horizon from own motion: a straight drive tells the height, one that turns the slope too."""

import numpy as np
import pytest

from ttcvid.config import HorizonCalibrationConfig
from ttcvid.geometry.horizon.plane import horizon_px, pitch_roll_rad
from ttcvid.geometry.rotation import normalize, rotation_from_vector
from ttcvid.model import Camera, ImageSize
from ttcvid.stages.horizon.driving import OwnStep, driving_horizon, own_motions

CAMERA = Camera(500.0, 500.0, 319.5, 179.5, ImageSize(640, 360))
CONFIG = HorizonCalibrationConfig()
SIGMA_RAD = 0.004


def drive(pitch_deg, roll_deg, yaw_rate_rad_s=0.0, nod_rad=0.0, n_frames=200, rng=None, dt_s=0.05):
    """Steps of a car that goes where it points, with a camera of that mounting, which nods on its springs."""
    pitch, roll = np.radians([pitch_deg, roll_deg])
    up = np.array([-np.sin(roll) * np.cos(pitch), -np.cos(roll) * np.cos(pitch), -np.sin(pitch)])
    ahead = normalize(np.array([0.05, 0.0, 1.0]) - up * (up @ [0.05, 0.0, 1.0]))
    steps, nod_R = [], np.eye(3)
    for frame in range(n_frames):
        nod = nod_rad * np.sin(2 * np.pi * 1.2 * frame * dt_s)
        nod_R_before, nod_R = nod_R, rotation_from_vector(nod * np.cross(up, ahead))
        turn_R = rotation_from_vector(yaw_rate_rad_s * dt_s * up)
        cam_R_prev = nod_R @ turn_R @ nod_R_before.T
        direction = -nod_R @ ahead
        covariance = SIGMA_RAD**2 * (np.eye(3) - np.outer(direction, direction))
        if rng is not None:
            direction = normalize(direction + SIGMA_RAD * rng.standard_normal(3))
        steps.append(OwnStep(frame, frame * dt_s, cam_R_prev, direction, covariance))
    return steps, up


def test_a_straight_drive_tells_the_height_with_the_roll_taken_as_zero():
    steps, up = drive(2.0, 0.0, rng=np.random.default_rng(1))
    result = driving_horizon(own_motions(steps), CAMERA, CONFIG)
    assert result.roll_zero
    assert result.notes == ("roll taken as zero",)
    pitch, roll = np.degrees(pitch_roll_rad(result.fit.normal))
    assert pitch == pytest.approx(2.0, abs=0.15)
    assert roll == pytest.approx(0.0, abs=0.01)
    assert horizon_px(CAMERA, up)[0] == pytest.approx(horizon_px(CAMERA, result.fit.normal)[0], abs=2.0)


def test_a_drive_that_turns_tells_the_roll():
    steps, _ = drive(2.0, 3.0, yaw_rate_rad_s=0.3, rng=np.random.default_rng(2))
    result = driving_horizon(own_motions(steps), CAMERA, CONFIG)
    assert not result.roll_zero
    np.testing.assert_allclose(np.degrees(pitch_roll_rad(result.fit.normal)), (2.0, 3.0), atol=0.4)


def test_a_car_that_nods_does_so_about_its_horizon():
    steps, _ = drive(-1.0, 0.0, nod_rad=np.radians(0.8), rng=np.random.default_rng(3))
    result = driving_horizon(own_motions(steps), CAMERA, CONFIG)
    assert np.degrees(pitch_roll_rad(result.fit.normal))[0] == pytest.approx(-1.0, abs=0.2)


def test_a_drive_of_a_second_is_undetermined():
    steps, _ = drive(2.0, 0.0, n_frames=20)
    result = driving_horizon(own_motions(steps), CAMERA, CONFIG)
    assert result.fit is None
    assert "2 s needed" in result.reason


@pytest.mark.parametrize("fps", [1, 2, 4, 5.99, 6.01, 10])
def test_at_any_frame_rate_the_whole_drive_counts(fps):
    steps, _ = drive(2.0, 0.0, n_frames=int(12 * fps), rng=np.random.default_rng(5), dt_s=1 / fps)
    motions = own_motions(steps)
    covered_s = sum(motion.duration_s for motion in motions)
    assert 0.6 * 12 < covered_s < 12 + 1e-9
    result = driving_horizon(motions, CAMERA, CONFIG)
    assert result.reason == ""
    assert np.degrees(pitch_roll_rad(result.fit.normal))[0] == pytest.approx(2.0, abs=0.2)


def test_gaps_and_standstill_are_left_out():
    steps, _ = drive(2.0, 0.0, rng=np.random.default_rng(4))
    nothing = np.full(3, np.nan), np.full((3, 3), np.nan)
    for k in range(60, 90):
        steps[k] = OwnStep(k, steps[k].t_s, steps[k].cam_R_prev, *nothing)
    with_gap = [*steps[:120], None, *steps[140:]]
    motions = own_motions(with_gap)
    frames = np.concatenate([motion.track_id for motion in motions])
    assert not set(range(60, 90)) & set(frames.tolist())
    assert len(set(frames.tolist())) == len(frames)
    assert driving_horizon(motions, CAMERA, CONFIG).fit is not None
