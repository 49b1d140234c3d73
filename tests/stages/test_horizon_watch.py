"""A warning where epipoles drift off the calibrated horizon, and none for noise."""

import numpy as np
import pytest

from ttcvid.stages.horizon_watch import complaint_about_horizon

RNG = np.random.default_rng(9)
NOISE_PX = 4.0 * RNG.standard_normal(400)


def test_noise_about_the_horizon_is_no_complaint():
    assert complaint_about_horizon(NOISE_PX, 3.0) == ""


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_mount_that_slips_is_told(sense):
    text = complaint_about_horizon(NOISE_PX + sense * np.linspace(0.0, 20.0, 400), 3.0)
    assert "drift by" in text
    assert "calibrate the horizon again" in text


@pytest.mark.parametrize(("offset_px", "side"), [(12.0, "below"), (-12.0, "above")])
def test_a_wrong_calibration_is_told(offset_px, side):
    assert f"12 px {side} the horizon" in complaint_about_horizon(NOISE_PX + offset_px, 3.0)


def test_what_the_calibration_allows_for_is_no_complaint():
    assert complaint_about_horizon(NOISE_PX + 12.0, 15.0) == ""


def test_a_second_of_nonsense_is_no_drift():
    offset_px = NOISE_PX.copy()
    offset_px[-30:] += 60.0
    assert complaint_about_horizon(offset_px, 3.0) == ""


def test_a_few_frames_say_nothing():
    assert complaint_about_horizon(np.full(60, 50.0), 3.0) == ""
    assert complaint_about_horizon(np.empty(0), 3.0) == ""
