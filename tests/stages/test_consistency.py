"""Covariances of states hold where the model does not: their own contradictions widen them."""

from types import SimpleNamespace

import numpy as np
import pytest
from relative_motion import CAMERA, pixels

from ttcvid.geometry.rotation import rotation_from_vector
from ttcvid.stages.objects.consistency import with_consistent_covariances
from ttcvid.stages.objects.joint_states import JointStates

SIGMA_HZ = 0.01
AHEAD_M = np.array([2.0, 0.5, 20.0])
APPROACH_M_S, ACROSS_M_S = np.array([0.4, -0.2, -5.0]), np.array([4.0, -0.2, 0.0])


def variances_of(errors_hz, step_s=0.05, velocity_m_s=ACROSS_M_S, number=lambda k: 7, turn_rad_s=0.0, n_later=0):
    """Variances (L,) of c, widened, of an object at constant velocity, whose states err so.

    The camera turns, and the history ends ``n_later`` frames after the present one.
    """
    past, found = {}, []
    turn = np.array([0.0, turn_rad_s, 0.0])
    for k, error_hz in enumerate(errors_hz):
        t_s = step_s * np.arange(k + 1 + n_later)
        cam_R_world = rotation_from_vector(turn * t_s[k])
        history = SimpleNamespace(
            t_s=t_s, now=-1 - n_later, camera=CAMERA, cam_R_past=rotation_from_vector(turn * (t_s[k] - t_s)[:, None])
        )
        place_m = cam_R_world @ (AHEAD_M + velocity_m_s * t_s[k])
        abc_hz = cam_R_world @ velocity_m_s / place_m[2] + error_hz
        ref_px, cov = pixels(place_m[None]), SIGMA_HZ**2 * np.eye(3)[None]
        joint = JointStates(np.array([0]), ref_px, np.zeros((1, 2)), abc_hz[None], cov)
        joint, past = with_consistent_covariances(joint, [number(k)], history, past)
        found.append(joint.cov[0, 2, 2])
    return np.array(found)


@pytest.mark.parametrize("turn_rad_s", [0.0, 0.3, -0.3])
@pytest.mark.parametrize("velocity_m_s", [APPROACH_M_S, ACROSS_M_S])
def test_states_that_follow_from_each_other_are_as_sure_as_they_say(velocity_m_s, turn_rad_s):
    found = variances_of(np.zeros((40, 3)), velocity_m_s=velocity_m_s, turn_rad_s=turn_rad_s)
    assert found == pytest.approx(SIGMA_HZ**2)


def test_states_that_err_by_what_they_say_are_hardly_widened():
    errors_hz = SIGMA_HZ * np.random.default_rng(1).standard_normal((200, 3))
    assert np.median(variances_of(errors_hz)) < 1.3 * SIGMA_HZ**2


@pytest.mark.parametrize("times", [3.0, 10.0])
def test_states_that_err_by_more_than_they_say_get_the_variance_of_their_errors(times):
    errors_hz = times * SIGMA_HZ * np.random.default_rng(2).standard_normal((200, 3))
    found = variances_of(errors_hz, velocity_m_s=0.2 * ACROSS_M_S)
    assert np.median(found[10:]) == pytest.approx((times * SIGMA_HZ) ** 2, rel=0.3)
    within = np.abs(errors_hz[10:, 2]) < 1.645 * np.sqrt(found[10:])
    assert 0.84 < np.mean(within) < 0.96


def test_what_is_past_is_forgotten():
    errors_hz = np.zeros((40, 3))
    errors_hz[10:15, 2] = 0.2
    found = variances_of(errors_hz)
    assert found[12] > 10.0 * SIGMA_HZ**2
    assert found[-1] == pytest.approx(SIGMA_HZ**2)


def test_what_jumps_to_and_fro_is_told_from_the_second_frame_on():
    """As often as it is compared with an old state: that has the same error."""
    errors_hz = np.zeros((40, 3))
    errors_hz[::2, 2] = 5.0 * SIGMA_HZ
    found = variances_of(errors_hz)
    assert found[1] > 1.5 * SIGMA_HZ**2
    assert found[-1] > 3.0 * SIGMA_HZ**2


def test_more_frames_a_second_make_no_difference():
    def widened(rate_hz):
        t_s = np.arange(0.0, 2.0, 1.0 / rate_hz)
        sway = 0.1 * np.column_stack([np.zeros_like(t_s), np.zeros_like(t_s), np.sin(8.0 * t_s)])
        return variances_of(sway, 1.0 / rate_hz)[-1]

    assert widened(60.0) == pytest.approx(widened(20.0), rel=0.2)


def test_a_frame_that_is_looked_at_again_has_its_own_time():
    """The history then ends with later views."""
    errors_hz = np.zeros((20, 3))
    errors_hz[12:, 2] = 0.2
    np.testing.assert_allclose(variances_of(errors_hz, n_later=5), variances_of(errors_hz))


def test_objects_are_compared_with_themselves_only():
    errors_hz = np.zeros((40, 3))
    errors_hz[20:, 0] = 0.2
    assert variances_of(errors_hz, number=lambda k: k // 20) == pytest.approx(SIGMA_HZ**2)


def test_an_object_that_passes_the_camera_is_not_compared_across_the_passing():
    assert variances_of(np.zeros((6, 3)), 0.25, 1.2 * np.array([0.0, 0.0, -15.0])) == pytest.approx(SIGMA_HZ**2)


def test_clips_of_a_few_frames_a_second_have_nothing_to_compare():
    errors_hz = np.random.default_rng(3).standard_normal((20, 3))
    assert variances_of(errors_hz, 1.0, velocity_m_s=0.01 * ACROSS_M_S) == pytest.approx(SIGMA_HZ**2)
