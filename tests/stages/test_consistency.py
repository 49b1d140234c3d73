"""Covariances of states hold where the model does not: their own contradictions widen them."""

import numpy as np
import pytest

from ttcvid.stages.objects.consistency import with_consistent_covariances
from ttcvid.stages.objects.joint_states import JointStates

SIGMA_HZ = 0.01
APPROACH_HZ = np.array([0.02, -0.01, -0.25])
ACROSS_HZ = np.array([0.2, -0.01, 0.0])


def state_of(abc_hz, cov):
    return JointStates(np.array([0]), np.zeros((1, 2)), np.zeros((1, 2)), abc_hz[None], cov[None])


def variances_of(errors_hz, step_s=0.05, start_hz=ACROSS_HZ, number=lambda k: 7):
    """Variances (L,) of c, widened, of an object at constant velocity, whose states err so."""
    past, found = {}, []
    for k, error_hz in enumerate(errors_hz):
        t_s = k * step_s
        abc_hz = start_hz / (1.0 + start_hz[2] * t_s) + error_hz
        joint, past = with_consistent_covariances(state_of(abc_hz, SIGMA_HZ**2 * np.eye(3)), [number(k)], t_s, past)
        found.append(joint.cov[0, 2, 2])
    return np.array(found)


def test_states_that_follow_from_each_other_are_as_sure_as_they_say():
    for start_hz in (APPROACH_HZ, ACROSS_HZ):
        assert variances_of(np.zeros((40, 3)), start_hz=start_hz) == pytest.approx(SIGMA_HZ**2)


def test_states_that_err_by_what_they_say_are_hardly_widened():
    errors_hz = SIGMA_HZ * np.random.default_rng(1).standard_normal((400, 3))
    assert np.median(variances_of(errors_hz)) < 1.3 * SIGMA_HZ**2


@pytest.mark.parametrize("times", [3.0, 10.0])
def test_states_that_err_by_more_than_they_say_get_the_variance_of_their_errors(times):
    errors_hz = times * SIGMA_HZ * np.random.default_rng(2).standard_normal((400, 3))
    found = variances_of(errors_hz)
    assert np.median(found[10:]) == pytest.approx((times * SIGMA_HZ) ** 2, rel=0.25)
    within = np.abs(errors_hz[10:, 2]) < 1.645 * np.sqrt(found[10:])
    assert 0.85 < np.mean(within) < 0.95


def test_what_is_past_is_forgotten():
    errors_hz = np.zeros((40, 3))
    errors_hz[10:15, 2] = 0.2
    found = variances_of(errors_hz)
    assert found[12] > 10.0 * SIGMA_HZ**2
    assert found[-1] == pytest.approx(SIGMA_HZ**2)


def test_more_frames_a_second_make_no_difference():
    def widened(rate_hz):
        t_s = np.arange(0.0, 2.0, 1.0 / rate_hz)
        sway = 0.1 * np.column_stack([np.zeros_like(t_s), np.zeros_like(t_s), np.sin(8.0 * t_s)])
        return variances_of(sway, 1.0 / rate_hz)[-1]

    assert widened(60.0) == pytest.approx(widened(20.0), rel=0.2)


def test_objects_are_compared_with_themselves_only():
    errors_hz = np.zeros((40, 3))
    errors_hz[20:, 2] = 0.2
    assert variances_of(errors_hz, number=lambda k: k // 20) == pytest.approx(SIGMA_HZ**2)


def test_an_object_that_passes_the_camera_is_not_compared_across_the_passing():
    """1 + c t is zero on the way: a state before tells nothing about one after."""
    past, variance = {}, []
    for t_s, c_hz in ((0.0, -5.0), (0.3, 2.0)):
        state = state_of(np.array([0.0, 0.0, c_hz]), SIGMA_HZ**2 * np.eye(3))
        joint, past = with_consistent_covariances(state, [1], t_s, past)
        variance.append(joint.cov[0, 2, 2])
    assert variance == pytest.approx([SIGMA_HZ**2] * 2)


def test_clips_of_a_few_frames_a_second_have_nothing_to_compare():
    assert variances_of(np.random.default_rng(3).standard_normal((20, 3)), 1.0) == pytest.approx(SIGMA_HZ**2)


def test_a_state_that_was_hidden_for_a_moment_is_compared_again():
    errors_hz = np.zeros((12, 3))
    errors_hz[11, 2] = 0.2
    past, last = {}, None
    for k, error_hz in enumerate(errors_hz):
        t_s = 0.05 * k
        seen = [] if 7 <= k <= 9 else [1]
        joint = state_of(ACROSS_HZ + error_hz, SIGMA_HZ**2 * np.eye(3))
        joint = JointStates(*(getattr(joint, one)[: len(seen)] for one in JointStates.__dataclass_fields__))
        last, past = with_consistent_covariances(joint, seen, t_s, past)
    assert last.cov[0, 2, 2] > 3.0 * SIGMA_HZ**2
