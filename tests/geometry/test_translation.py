"""The direction of a moving body: exact without noise, honest with it, also where errors hang together."""

import numpy as np
import pytest
from bodies import body_tracks

from ttcvid.geometry.estimation.moving_body import direction_from_lines
from ttcvid.geometry.estimation.translation import fit_translation

SPEED_CHANGE_HZ, TURN_RAD_S, MEMORY_S = 0.15, 0.012, 0.6


def fitted(tracks, turn_sigma_rad_s=TURN_RAD_S):
    return fit_translation(tracks, direction_from_lines(tracks), SPEED_CHANGE_HZ, turn_sigma_rad_s, MEMORY_S)


def heights_in_sigmas(n, **options):
    """How far above the true horizon the epipoles of n bodies are found, in their own standard deviations."""
    result = []
    for seed in range(n):
        rng = np.random.default_rng([seed, 5])
        tracks, _ = body_tracks(rng, rng.uniform(0, 2 * np.pi), **options)
        found = fitted(tracks)
        result.append(found.direction[1] / np.sqrt(found.covariance[1, 1]))
    return np.array(result)


@pytest.mark.parametrize("heading_deg", [0.0, 35.0, 90.0, 140.0, 180.0, 260.0])
def test_without_noise_the_direction_is_exact(heading_deg):
    tracks, direction = body_tracks(np.random.default_rng(1), np.radians(heading_deg), sigma_px=0.0)
    found = fitted(tracks)
    np.testing.assert_allclose(found.direction, direction, atol=1e-6)
    assert found.turn_rad_s == pytest.approx(0.0, abs=1e-6)
    assert (found.rate_hz > 0).all()


def test_a_single_pair_of_points_tells_the_direction():
    tracks, direction = body_tracks(np.random.default_rng(2), 0.6, sigma_px=0.0, n_tracks=2)
    np.testing.assert_allclose(fitted(tracks).direction, direction, atol=1e-5)


def test_the_error_is_what_the_covariance_says():
    heights = heights_in_sigmas(40)
    assert 0.75 < np.sqrt(np.mean(heights**2)) < 1.25


def test_noise_is_found_whatever_is_assumed():
    tracks, _ = body_tracks(np.random.default_rng(3), 1.0, sigma_px=0.6)
    assert fitted(tracks).noise == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("options", [{"bob_px": 1.5}, {"slide_px_s": 1.0}], ids=["bobbing", "sliding"])
def test_errors_that_hang_together_make_the_direction_less_certain(options):
    rng = np.random.default_rng(4)
    rigid, _ = body_tracks(np.random.default_rng(4), 1.0)
    loose, _ = body_tracks(rng, 1.0, **options)
    assert fitted(loose).covariance[1, 1] > 2.0 * fitted(rigid).covariance[1, 1]
    assert np.sqrt(np.mean(heights_in_sigmas(16, **options) ** 2)) < 2.2


def test_a_turn_is_found():
    tracks, _ = body_tracks(np.random.default_rng(5), 1.0, turn_rad_s=0.12, n_frames=75)
    found = fitted(tracks, turn_sigma_rad_s=1.0)
    assert abs(found.turn_rad_s) == pytest.approx(0.12, rel=0.15)
    assert abs(found.turn_rad_s) > 3.0 * found.turn_sigma_rad_s


def test_mirroring_mirrors():
    tracks, _ = body_tracks(np.random.default_rng(6), 0.8)
    mirrored = type(tracks)(tracks.track, tracks.t_s, tracks.xy * (-1, 1), tracks.sigma)
    np.testing.assert_allclose(fitted(mirrored).direction, fitted(tracks).direction * (-1, 1, 1), atol=1e-4)


def test_tracks_can_be_left_out():
    tracks, _ = body_tracks(np.random.default_rng(7), 0.8)
    chosen = np.arange(tracks.n_tracks) % 2 == 0
    half = tracks.take(chosen)
    assert half.n_tracks == chosen.sum()
    np.testing.assert_array_equal(np.unique(half.track), np.arange(half.n_tracks))
