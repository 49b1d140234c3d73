"""General motion from three views: exact for any gaps, and silent where the views do not determine it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from moving_points import moving_points, views

from ttcvid.geometry.paper.collision import times_from_position_velocity
from ttcvid.geometry.paper.three_frames import epipole_offset_three_frames, three_frame_direction
from ttcvid.geometry.rotation import normalize
from ttcvid.model import Status

GAPS = st.floats(0.2, 0.7)


def papers_offset(A, B, C):
    """The paper's (6), as printed."""
    return np.arctan((A * B - 2 * A * C + B * C) / (A - 2 * B + C))


@given(st.floats(2.5, 80), st.floats(-0.8, 0.8), GAPS, GAPS)
def test_offset_turns_any_reference_into_the_epipole(k, reference, gap_1, gap_2):
    true = np.arctan(1.0 / np.array([[k + gap_1 + gap_2], [k + gap_2], [k]]))
    x = epipole_offset_three_frames(*np.tan(true - reference), gap_1, gap_2)
    assert x[0] == pytest.approx(reference, abs=1e-9)


@given(st.floats(2.5, 80), st.floats(-0.8, 0.8))
def test_equal_gaps_give_the_papers_formula(k, reference):
    A, B, C = np.tan(np.arctan(1.0 / np.array([[k + 2], [k + 1], [k]])) - reference)
    assert epipole_offset_three_frames(A, B, C, 1.0, 1.0)[0] == pytest.approx(papers_offset(A, B, C)[0], abs=1e-9)


@given(moving_points(), GAPS, GAPS)
def test_direction_and_k_are_exact_without_noise(scene, gap_1, gap_2):
    position, velocity = scene
    rays = views(position, velocity, [-gap_1 - gap_2, -gap_2, 0.0])
    direction, k, status = three_frame_direction(rays, gap_1, gap_2, np.full(len(position), 1e-9))
    times = times_from_position_velocity(position, velocity)
    scale = np.hypot(times.tcpa_s, times.miss_s)
    assert np.isin(status, [Status.ok, Status.epipole_at_infinity]).all()
    np.testing.assert_allclose(direction, normalize(velocity), atol=1e-9)
    np.testing.assert_allclose(k / scale, times.tcpa_s / scale, rtol=1e-9, atol=1e-9)


@given(moving_points(), st.floats(0.2, 5))
def test_scaling_time_scales_k_and_keeps_the_direction(scene, factor):
    position, velocity = scene
    rays, sigma = views(position, velocity, [-1.0, -0.4, 0.0]), np.full(len(position), 1e-9)
    direction, k, _ = three_frame_direction(rays, 0.6, 0.4, sigma)
    same, longer, _ = three_frame_direction(rays, 0.6 * factor, 0.4 * factor, sigma)
    np.testing.assert_allclose(same, direction, atol=1e-9)
    np.testing.assert_allclose(longer, factor * k, rtol=1e-7, atol=1e-9)


@given(moving_points())
def test_mirroring_mirrors(scene):
    position, velocity = scene
    mirror, sigma = np.array([-1.0, 1, 1]), np.full(len(position), 1e-9)
    rays = views(position, velocity, [-1.0, -0.5, 0.0])
    direction, k, _ = three_frame_direction(rays, 0.5, 0.5, sigma)
    mirrored, same, _ = three_frame_direction(rays * mirror, 0.5, 0.5, sigma)
    np.testing.assert_allclose(mirrored, direction * mirror, atol=1e-9)
    np.testing.assert_allclose(same, k, rtol=1e-7, atol=1e-9)


def test_degenerate_tracks_have_a_reason_and_no_number():
    at = np.array([[1.0, 1, 20], [1, 1, 20], [1, 1, 20], [5, 0, 20]])
    rays = views(at, np.array([[0.0, 0, 0], [1, 0, -5], [1, 0, -5], [5, 0, 0]]), [-1.0, -0.5, 0.0])
    rays[1, 1] = normalize(rays[1, 1] + [0, 0.01, 0])
    rays[0, 2] = np.nan
    direction, k, status = three_frame_direction(rays, 0.5, 0.5, np.full(4, 1e-4))
    assert status.tolist() == [Status.no_parallax, Status.not_rigid, Status.short_track, Status.epipole_at_infinity]
    assert np.isnan(direction).all(axis=1).tolist() == [True, True, True, False]
    assert np.isnan(k).tolist() == [True, True, True, False]
    assert k[3] == pytest.approx(-1.0, abs=1e-9)
    _, _, unusable = three_frame_direction(rays, 0.0, np.nan, np.full(4, 1e-4))
    assert (unusable == Status.short_track).all()
