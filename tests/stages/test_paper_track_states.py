"""States and times of single tracks: exact without noise, honest intervals with it, a reason where there is none."""

from dataclasses import replace

import numpy as np
import pytest
from relative_motion import (
    FOCAL_PX,
    box_of_points,
    direction_noise,
    flows_of,
    history_of,
    unit,
)

from ttcvid.geometry.rotation import normalize, rotation_from_vector
from ttcvid.model import Status
from ttcvid.stages.egomotion.flows import select_flows
from ttcvid.stages.objects.constant_bearing import with_constant_bearing
from ttcvid.stages.objects.paper_track_states import three_frame_states, two_frame_states
from ttcvid.stages.objects.states import TrackStates

# The paper's crossing car, and others: position in m, relative velocity in m/s.
CROSSING = (np.array([[20.0, 0.0, 20.0]]), np.array([-10.0, 0.0, -2.0]))
MOTIONS = [
    CROSSING,
    (np.array([[3.0, 1.0, 30.0]]), np.array([0.0, 0.0, -12.0])),
    (np.array([[-4.0, -2.0, 25.0]]), np.array([1.0, 0.5, 6.0])),
    (np.array([[6.0, 1.0, 15.0]]), np.array([-6.0, 0.5, -4.0])),
]


def truth(position_m, velocity_m_s):
    """tcpa, miss and ttc_z in s from the definitions."""
    speed2 = velocity_m_s @ velocity_m_s
    tcpa_s = -(position_m @ velocity_m_s) / speed2
    miss_s = np.linalg.norm(np.cross(position_m, velocity_m_s), axis=1) / speed2
    return tcpa_s, miss_s, -position_m[:, 2] / velocity_m_s[2]


def two_frame(position_m, velocity_m_s, direction=None, cov=None, **options):
    flows = flows_of(position_m, velocity_m_s, **options)
    n = len(position_m)
    direction = unit(velocity_m_s) if direction is None else direction
    cov = np.zeros((3, 3)) if cov is None else cov
    return two_frame_states(flows, np.broadcast_to(direction, (n, 3)), np.broadcast_to(cov, (n, 3, 3)))


def assert_exact(states, position_m, velocity_m_s, rtol):
    assert (states.status == Status.ok).all()
    n = len(position_m)
    np.testing.assert_allclose(states.xy, position_m[:, :2] / position_m[:, 2:], rtol=rtol, atol=rtol)
    np.testing.assert_allclose(states.abc_hz, velocity_m_s / position_m[:, 2:], rtol=rtol, atol=rtol)
    np.testing.assert_allclose(states.direction, np.tile(unit(velocity_m_s), (n, 1)), atol=rtol)
    times, expected = states.times(), truth(position_m, velocity_m_s)
    for found_s, true_s in zip((times.tcpa_s, times.miss_s, times.ttc_z_s), expected, strict=True):
        np.testing.assert_allclose(found_s, true_s, rtol=rtol)
    cosine = -(position_m @ unit(velocity_m_s)) / np.linalg.norm(position_m, axis=1)
    np.testing.assert_allclose(states.alpha_rad, np.arccos(cosine), atol=10 * rtol)


@pytest.mark.parametrize(("position_m", "velocity_m_s"), MOTIONS)
def test_two_frames_with_the_epipole_are_exact_without_noise(position_m, velocity_m_s):
    assert_exact(two_frame(position_m, velocity_m_s), position_m, velocity_m_s, 1e-9)


def test_the_papers_crossing_car():
    times = two_frame(*CROSSING).times()
    assert times.tcpa_s[0] == pytest.approx(2.31, abs=0.005)
    assert times.ttc_z_s[0] == pytest.approx(10.0)
    assert times.miss_s[0] * np.hypot(10.0, 2.0) == pytest.approx(15.7, abs=0.05)


@pytest.mark.parametrize(("position_m", "velocity_m_s"), MOTIONS)
@pytest.mark.parametrize("turn_rad_per_frame", [(0.0, 0.0, 0.0), (0.004, -0.02, 0.01)])
def test_three_frames_are_exact_without_noise_though_the_camera_turns(position_m, velocity_m_s, turn_rad_per_frame):
    rotations = [rotation_from_vector(np.array(turn_rad_per_frame) * (1 + 0.3 * i)) for i in range(8)]
    history = history_of(position_m, velocity_m_s, 0.05 * np.arange(9), rotations)
    flows = select_flows(history, 8, 1e6)
    assert_exact(three_frame_states(history, flows), position_m, velocity_m_s, 1e-7)


def test_three_frames_are_exact_where_their_gaps_are_uneven():
    position_m, velocity_m_s = CROSSING
    history = history_of(position_m, velocity_m_s, np.array([0.0, 0.05, 0.2, 0.25, 0.6, 0.61, 0.7]))
    assert_exact(three_frame_states(history, select_flows(history, 6, 1e6)), position_m, velocity_m_s, 1e-7)


def test_time_scales_with_time():
    (position_m, velocity_m_s), times = CROSSING, {}
    for factor in (1.0, 10.0):
        times[factor] = two_frame(position_m, velocity_m_s / factor, gap_s=0.4 * factor).times()
    np.testing.assert_allclose(times[10.0].tcpa_s, 10.0 * times[1.0].tcpa_s)
    np.testing.assert_allclose(times[10.0].miss_hi_s, 10.0 * times[1.0].miss_hi_s)
    np.testing.assert_allclose(times[10.0].ttc_z_lo_s, 10.0 * times[1.0].ttc_z_lo_s)


def covered(states, position_m, velocity_m_s, chosen):
    """Part of the chosen tracks whose 90 % interval of ttc_z, tcpa and miss holds the truth."""
    times = states.times()
    tcpa_s, miss_s, ttc_z_s = truth(position_m, velocity_m_s)
    eta_hz = 1.0 / ttc_z_s
    holds_z = (eta_hz <= 1.0 / times.ttc_z_lo_s) & (eta_hz >= 1.0 / times.ttc_z_hi_s)
    # NaN bounds are infinite ones.
    holds_tcpa = ~(tcpa_s < times.tcpa_lo_s) & ~(tcpa_s > times.tcpa_hi_s)
    holds_miss = ~(miss_s < times.miss_lo_s) & ~(miss_s > times.miss_hi_s)
    return [holds[chosen].mean() for holds in (holds_z, holds_tcpa, holds_miss)]


@pytest.mark.parametrize("velocity_m_s", [(5.0, 0.0, -4.0), (0.0, 0.0, -8.0), (-2.0, 0.5, -9.0), (3.0, 0.0, 6.0)])
def test_intervals_with_the_groups_epipole_hold_the_truth_in_nine_of_ten(velocity_m_s):
    rng = np.random.default_rng(61)
    velocity, n = np.array(velocity_m_s), 6000
    position_m = box_of_points(rng, n, (-4.0, 1.0, 20.0), (3.0, 1.5, 2.0))
    flows = flows_of(position_m, velocity, sigma_px=0.3, rng=rng)
    epipoles = [direction_noise(rng, unit(velocity), np.radians(1.0)) for _ in range(n)]
    states = two_frame_states(flows, np.array([e for e, _ in epipoles]), np.array([cov for _, cov in epipoles]))
    in_z, in_tcpa, in_miss = covered(states, position_m, velocity, states.status == Status.ok)
    assert 0.87 <= in_z <= 0.93
    assert in_tcpa >= 0.87
    assert in_miss >= 0.87


def test_intervals_of_three_frames_hold_the_truth_in_nine_of_ten_where_they_are_short():
    rng = np.random.default_rng(62)
    position_m = box_of_points(rng, 800, (-4.0, 1.0, 12.0), (3.0, 1.5, 2.0))
    velocity = np.array([5.0, 0.3, -6.0])
    history = history_of(position_m, velocity, 0.05 * np.arange(13), sigma_px=0.1, rng=rng)
    # The error that grows with the flow is a model of matching in pictures; here there is none.
    flows = replace(select_flows(history, 12, 1e6), sigma_rad=history.sigma_rad)
    states = three_frame_states(history, flows)
    in_z, in_tcpa, in_miss = covered(states, position_m, velocity, states.status == Status.ok)
    assert 0.85 <= in_z <= 0.95
    assert in_tcpa >= 0.87
    assert in_miss >= 0.87


@pytest.mark.parametrize("place_m", [(0.0, 3.0, 12.0), (18.0, 3.0, 12.0), (18.0, -18.0, 12.0)])
def test_covariance_of_three_frames_is_how_noise_of_the_rays_scatters_them_also_far_off_the_axis(place_m):
    rng, n = np.random.default_rng(63), 4000
    position_m, velocity = np.tile(place_m, (n, 1)), np.array([5.0, 0.3, -6.0])
    history = history_of(position_m, velocity, 0.05 * np.arange(13))
    sigma_rad = np.full(n, 1e-6)
    noisy = replace(history, rays=normalize(history.rays + sigma_rad[0] * rng.normal(size=history.rays.shape)))
    states = three_frame_states(noisy, replace(select_flows(noisy, 12, 1e6), sigma_rad=sigma_rad))
    # Three views of one in a hundred or so lie off a plane by chance.
    ok = states.status == Status.ok
    assert ok.mean() > 0.95
    scattered = np.std(states.abc_hz[ok], axis=0)
    told = np.sqrt(np.median(np.einsum("nii->ni", states.cov[ok]), axis=0))
    np.testing.assert_allclose(told, scattered, rtol=0.1)


def test_a_state_of_three_frames_whose_error_nobody_can_say_is_none():
    """Flow so short that a step of the noise leads to views that have no epipole."""
    rng, n = np.random.default_rng(64), 3000
    position_m = box_of_points(rng, n, (0.0, 0.0, 40.0), (40.0, 20.0, 40.0))
    history = history_of(position_m, np.array([0.0, 0.0, -2.0]), 0.05 * np.arange(5), sigma_px=0.2, rng=rng)
    states = three_frame_states(history, select_flows(history, 4, 1e6))
    assert np.isfinite(states.cov[states.has_value]).all()
    times = states.times()
    assert np.isfinite(times.ttc_z_lo_s[states.has_value]).all()
    assert (states.status[np.isnan(states.abc_hz[:, 0])] != Status.ok).all()


def test_every_missing_result_has_its_reason():
    position_m = np.array([[5.0, 1.0, 20.0]] * 5 + [[0.0, 0.0, 20.0]])
    velocity_m_s = np.array([[0, 0, -8.0], [0, 0, -8.0], [0, 0, 0], [0, 0, 8.0], [-5, 0, 0], [0, 0, -8.0]])
    flows = flows_of(position_m, velocity_m_s, sigma_px=0.2)
    flows.first[0] = np.nan
    direction = np.array([[0, 0, -1.0], [np.nan] * 3, [0, 0, -1.0], [0, 0, -1.0], [-1.0, 0, 0], [0, 0, -1.0]])
    states = two_frame_states(flows, direction, np.tile(1e-8 * np.eye(3), (6, 1, 1)))
    assert [Status(s).name for s in states.status] == [
        "short_track",
        "no_epipole",
        "no_parallax",
        "not_rigid",
        "epipole_at_infinity",
        "at_epipole",
    ]
    np.testing.assert_array_equal(states.has_value, [False, False, False, False, True, False])
    has_number = np.isfinite(states.times().tcpa_s)
    np.testing.assert_array_equal(has_number, states.has_value)
    assert np.isnan(states.abc_hz[~states.has_value]).all()
    assert np.isnan(states.cov[~states.has_value]).all()


def test_three_frames_of_a_track_that_has_only_two_are_too_short():
    position_m, velocity_m_s = CROSSING
    history = history_of(position_m, velocity_m_s, np.array([0.0, 0.1]))
    states = three_frame_states(history, select_flows(history, 8, 1e6))
    assert states.status[0] == Status.short_track
    assert not states.has_value[0]


def no_values(history, status=Status.at_epipole):
    n = history.n_tracks
    nothing = np.full(n, np.nan)
    rays = history.rays[-1]
    return TrackStates(
        rays[:, :2] / rays[:, 2:],
        np.full((n, 3), np.nan),
        np.full((n, 3, 3), np.nan),
        np.full(n, history.pool_sigma_px / FOCAL_PX) + 0.0 * np.nan_to_num(nothing),
        np.full((n, 3), np.nan),
        np.full(n, status, dtype=np.int64),
    )


def plate(position_m, half_width_m):
    """A point and eight around it, all at its depth."""
    offsets = half_width_m * np.array([[x, y, 0.0] for x in (-1, 0, 1) for y in (-1, 0, 1) if x or y])
    return np.concatenate([[position_m], position_m + offsets])


AROUND = np.full((9, 8), -1)
AROUND[0] = np.arange(1, 9)
FIRST = np.arange(9) == 0


@pytest.mark.parametrize("position_m", [(0.0, 0.0, 20.0), (6.0, -1.0, 15.0)])
def test_constant_bearing_takes_its_exact_time_from_the_expansion_around(position_m):
    position_m = np.array(position_m)
    velocity_m_s = -0.4 * position_m
    history = history_of(plate(position_m, 0.5), velocity_m_s, 0.05 * np.arange(6))
    states = with_constant_bearing(no_values(history), history, AROUND, 5, FIRST)
    assert states.status[0] == Status.ok
    np.testing.assert_allclose(states.abc_hz[0], velocity_m_s / position_m[2], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(states.direction[0], unit(velocity_m_s), atol=1e-9)
    assert states.alpha_rad[0] == pytest.approx(0.0, abs=1e-7)
    times = states.times()
    assert times.tcpa_s[0] == pytest.approx(2.5)
    assert times.ttc_z_s[0] == pytest.approx(2.5)
    assert times.miss_s[0] == pytest.approx(0.0, abs=1e-9)
    # Nobody asked for the others.
    assert (states.status[1:] == Status.at_epipole).all()


def test_constant_bearing_without_an_expansion_keeps_its_reason():
    position_m = np.array([1.0, 0.0, 20.0])
    for velocity_m_s in (np.zeros(3), 0.4 * position_m):
        history = history_of(plate(position_m, 0.5), velocity_m_s, 0.05 * np.arange(6), sigma_px=0.1)
        states = with_constant_bearing(no_values(history), history, AROUND, 5, FIRST)
        assert states.status[0] == Status.at_epipole
        assert np.isnan(states.abc_hz[0]).all()


def test_noise_around_a_point_is_hardly_ever_taken_for_expansion():
    rng = np.random.default_rng(63)
    n_taken = 0
    for _ in range(300):
        history = history_of(
            plate(np.array([1.0, 0.0, 20.0]), 0.5), np.zeros(3), 0.05 * np.arange(6), sigma_px=0.2, rng=rng
        )
        states = with_constant_bearing(no_values(history), history, AROUND, 5, FIRST)
        n_taken += states.status[0] == Status.ok
    assert n_taken <= 3


def test_an_interval_by_expansion_holds_the_truth():
    rng = np.random.default_rng(64)
    position_m = np.array([2.0, 0.5, 12.0])
    n_held, n_taken = 0, 0
    for _ in range(300):
        history = history_of(plate(position_m, 1.0), -0.5 * position_m, 0.05 * np.arange(6), sigma_px=0.2, rng=rng)
        times = with_constant_bearing(no_values(history), history, AROUND, 5, FIRST).times()
        n_taken += np.isfinite(times.ttc_z_s[0])
        n_held += times.ttc_z_lo_s[0] <= 2.0 <= times.ttc_z_hi_s[0]
    assert n_taken > 290
    assert n_held / n_taken >= 0.87
