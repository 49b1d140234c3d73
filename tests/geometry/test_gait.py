"""The steps of whoever walks, and what is none."""

import numpy as np
import pytest

from ttcvid.geometry.horizon.gait import find_steps

SIZE = np.ones(75)
T_S = np.arange(75) / 25.0


def scatter(rng, memory_s=0.1, n=75):
    """Scatter of standard deviation 1 that hangs together for some frames."""
    keep = np.exp(-0.04 / memory_s)
    out = rng.normal(size=n)
    for i in range(1, n):
        out[i] = keep * out[i - 1] + np.sqrt(1 - keep**2) * out[i]
    return out


def rate_hz(terms):
    """Frequency of a cosine and a sine."""
    return np.polyfit(T_S, np.unwrap(np.arctan2(terms[:, 1], terms[:, 0])), 1)[0] / (2 * np.pi)


@pytest.mark.parametrize("steps_hz", [1.5, 1.8, 2.2])
def test_bobbing_is_found_at_the_rate_of_the_steps(steps_hz):
    bob = 2.0 * np.sin(2 * np.pi * steps_hz * T_S + 0.4)
    wave = find_steps(bob + 0.3 * scatter(np.random.default_rng(1)), T_S, SIZE, SIZE)
    assert wave is not None
    assert abs(rate_hz(wave) - steps_hz) < 0.07
    left = bob - wave @ np.linalg.lstsq(wave, bob, rcond=None)[0]
    assert np.std(left) < 0.25 * np.std(bob)


def test_scatter_that_hangs_together_is_no_steps():
    rng = np.random.default_rng(2)
    found = [find_steps(scatter(rng, rng.uniform(0.05, 0.25)), T_S, SIZE, SIZE) for _ in range(200)]
    assert sum(wave is not None for wave in found) <= 8


def test_slow_and_fast_waves_are_no_steps():
    for hz in (0.5, 3.5):
        noisy = 2.0 * np.sin(2 * np.pi * hz * T_S) + 0.3 * scatter(np.random.default_rng(3))
        assert find_steps(noisy, T_S, SIZE, SIZE) is None


def test_too_few_steps_or_pictures_or_nothing_that_bobs_tell_none():
    bob = np.sin(2 * np.pi * 1.8 * T_S)
    assert find_steps(bob[:30], T_S[:30], SIZE[:30], SIZE[:30]) is None
    assert find_steps(bob[::5], T_S[::5], SIZE[::5], SIZE[::5]) is None
    assert find_steps(np.zeros(75), T_S, SIZE, SIZE) is None


def test_what_has_no_weight_does_not_count():
    bob, weight = 2.0 * np.sin(2 * np.pi * 1.8 * T_S), SIZE.copy()
    bob[30:40], weight[30:40] = 40.0, 0.0
    wave = find_steps(bob + 0.3 * scatter(np.random.default_rng(4)), T_S, SIZE, weight)
    assert wave is not None
    assert abs(rate_hz(wave) - 1.8) < 0.07
