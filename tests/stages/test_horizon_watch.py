"""A warning where epipoles drift off the calibrated horizon, and none for noise."""

import numpy as np
import pytest

from ttcvid.config import HorizonCalibrationConfig
from ttcvid.model import HorizonOffset
from ttcvid.stages.horizon.watch import MoverOffset, complaint_about_movers, complaint_about_own_epipoles

RNG = np.random.default_rng(9)
NOISE_PX = 4.0 * RNG.standard_normal(400)


def test_noise_about_the_horizon_is_no_complaint():
    assert complaint_about_own_epipoles(NOISE_PX, 3.0) == ""


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_mount_that_slips_is_told(sense):
    text = complaint_about_own_epipoles(NOISE_PX + sense * np.linspace(0.0, 20.0, 400), 3.0)
    assert "drift by" in text
    assert "calibrate the horizon again" in text


@pytest.mark.parametrize(("offset_px", "side"), [(12.0, "below"), (-12.0, "above")])
def test_a_wrong_calibration_is_told(offset_px, side):
    assert f"12 px {side} the horizon" in complaint_about_own_epipoles(NOISE_PX + offset_px, 3.0)


def test_what_the_calibration_allows_for_is_no_complaint():
    assert complaint_about_own_epipoles(NOISE_PX + 12.0, 15.0) == ""


def test_a_second_of_nonsense_is_no_drift():
    offset_px = NOISE_PX.copy()
    offset_px[-30:] += 60.0
    assert complaint_about_own_epipoles(offset_px, 3.0) == ""


def test_a_few_frames_say_nothing():
    assert complaint_about_own_epipoles(np.full(60, 50.0), 3.0) == ""
    assert complaint_about_own_epipoles(np.empty(0), 3.0) == ""


def movers(below_deg, sigma_deg=1.0, scatter_deg=0.0, n_frames=50):
    """Six movers there and back, and one that goes across; of scatter_deg each has its own, all its life."""
    rng, found = np.random.default_rng(3), []
    for ahead in (1.0, 0.9, 0.8, 0.9, 1.0, 0.7, 0.0):
        mover, own_deg = MoverOffset(), scatter_deg * rng.standard_normal()
        for _ in range(n_frames):
            off_deg = ahead * below_deg + own_deg + 0.3 * rng.standard_normal()
            mover.add(HorizonOffset(np.radians(off_deg), np.radians(sigma_deg), ahead))
        found.append(mover)
    return found


def complaint(found, horizon_sigma_deg=0.3):
    return complaint_about_movers(found, np.radians(horizon_sigma_deg), np.radians(0.3), HorizonCalibrationConfig())


@pytest.mark.parametrize(("below_deg", "side"), [(8.0, "below"), (-8.0, "above")])
def test_movers_that_all_lie_off_the_horizon_are_told_with_the_error(below_deg, side):
    text = complaint(movers(below_deg))
    assert "the epipoles of 7 movers lie 8.0 +- 1.0 deg" in text
    assert f"deg {side} the horizon" in text


def test_walkers_that_err_by_some_degrees_each_do_not_accuse_the_calibration():
    assert complaint(movers(0.0, scatter_deg=4.0)) == ""
    assert complaint(movers(2.0, scatter_deg=4.0)) == ""


def test_what_the_calibration_itself_may_be_off_by_is_no_complaint():
    assert complaint(movers(6.0), horizon_sigma_deg=2.0) == ""
    assert complaint(movers(6.0), horizon_sigma_deg=0.3) != ""


def test_two_movers_and_short_ones_tell_nothing():
    assert complaint(movers(8.0)[:2]) == ""
    assert complaint(movers(8.0, n_frames=9)) == ""
