"""What is said to come nearer has to do so beyond what matching errs by."""

from dataclasses import replace
from statistics import NormalDist

import numpy as np
import pytest
from relative_motion import CAMERA, box_of_points

from ttcvid.geometry.camera.pinhole import pixels_from_rays
from ttcvid.geometry.rotation import normalize
from ttcvid.model import ClusterRow, MotionState, Status
from ttcvid.stages.objects.clusters import with_times
from ttcvid.stages.segmentation.common_errors import common_covariances, common_growth_hz, drift_cost
from ttcvid.stages.tracking.groups import TrackSets
from ttcvid.stages.tracking.tracker import COMMON_ERROR_PX

GAP_S, N = 0.5, 60
AHEAD_M, ASIDE_M = (1.0, 0.5, 20.0), (8.0, 0.5, 20.0)
NEARER = (MotionState.approaching, MotionState.constant_bearing)


def row_seen(abc_hz, sigma_hz, at_m=AHEAD_M, size_m=1.8, age_s=2.0, camera=CAMERA):
    """Row of a car's rear that says ``abc_hz``."""
    now = normalize(box_of_points(np.random.default_rng(1), N, at_m, (size_m, size_m, 0.0)))
    ((x_px, y_px),) = pixels_from_rays(camera, np.array([at_m]))
    row = ClusterRow(
        1,
        1,
        N,
        (0.0, 0.0, 1.0, 1.0),
        Status.ok,
        Status.ok,
        "whole-tracks",
        ref_px=(float(x_px), float(y_px)),
        state_abc_hz=np.asarray(abc_hz, float),
        state_cov=sigma_hz**2 * np.eye(3),
    )
    members = TrackSets.of([np.arange(N)])
    radius_px = members.radii(pixels_from_rays(camera, now))
    ref_px, ages_s = np.array([row.ref_px]), np.full(N, age_s)
    drift_hz = common_growth_hz(radius_px, members.medians(ages_s), GAP_S, COMMON_ERROR_PX)
    (common,) = common_covariances(ref_px, drift_hz, camera)
    (row,) = with_times([row.changed(state_cov=row.state_cov + common)], camera)
    return row


def seen(*args, **options):
    """What the row of `row_seen` says of its motion."""
    return row_seen(*args, **options).motion_state


def test_a_car_that_surely_comes_nearer_approaches():
    assert seen((0.0, 0.0, -0.2), 0.01) in NEARER


def test_what_all_tracks_may_err_by_in_common_is_no_approach_however_sure_they_are():
    # 0.002 of 20 px in 0.6 s: a fiftieth of a pixel.
    assert seen((0.0, 0.0, -0.002), 1e-5) not in NEARER


def test_a_time_that_may_be_a_common_error_of_the_tracks_has_an_interval_by_way_of_infinity():
    times = row_seen((0.0, 0.0, -0.002), 1e-5).times
    assert times.ttc_z_lo_s[0] > times.ttc_z_hi_s[0]
    # Of what is large in the picture, a part of a pixel is nothing: its interval is that of its own noise.
    times = row_seen((0.0, 0.0, -0.5), 0.02, size_m=10.0).times
    assert 1.0 / times.ttc_z_lo_s[0] - 1.0 / times.ttc_z_hi_s[0] == pytest.approx(2 * 1.645 * 0.02, rel=0.05)


def test_points_outside_of_the_lens_have_no_part_in_the_common_error():
    car = box_of_points(np.random.default_rng(2), N, AHEAD_M, (1.8, 1.8, 0.0))
    now = normalize(car)
    members, age_s, ref_px = TrackSets.of([np.arange(N)]), np.full(N, 2.0), np.array([[340.0, 190.0]])

    def cov_of(rays):
        radius_px = members.radii(pixels_from_rays(CAMERA, rays))
        return common_covariances(ref_px, common_growth_hz(radius_px, members.medians(age_s)), CAMERA)

    without_one, unseen = now.copy(), np.full_like(now, np.nan)
    without_one[0] = np.nan
    np.testing.assert_allclose(cov_of(without_one), cov_of(now), rtol=0.1)
    assert np.isfinite(cov_of(unseen)).all()


def test_a_car_that_crosses_before_us_comes_nearer():
    # It comes from the side: nearer by its way across, at the same depth.
    assert seen((-0.8, 0.0, 0.0), 0.01, ASIDE_M) == MotionState.approaching


@pytest.mark.parametrize(("nearer_hz", "is_sure"), [(0.055, False), (0.12, True)])
def test_the_outline_is_as_small_as_it_is_seen_through_a_fisheye_off_its_axis(nearer_hz, is_sure):
    """A car 60 deg off the axis: 12 px, of which the drift is a larger part than of the 27 px without the lens."""
    fisheye = replace(CAMERA, distortion_model="fisheye", distortion=(0.0, 0.0, 0.0, 0.0))
    at_m = np.array([20.0 * np.tan(np.radians(60.0)), 0.5, 20.0])
    assert (seen(-nearer_hz * at_m / at_m[2], 1e-4, at_m, camera=fisheye) in NEARER) == is_sure


@pytest.mark.parametrize("sigma_hz", [0.02, 0.1])
def test_noise_is_said_to_approach_as_rarely_as_stated(sigma_hz):
    """In one of a thousand: between its quantiles at 99.8 % and 99.95 % the noise begins to be an approach."""
    for quantile, is_sure in ((0.998, False), (0.9995, True)):
        noise_hz = (0.0, 0.0, -sigma_hz * NormalDist().inv_cdf(quantile))
        assert (seen(noise_hz, sigma_hz, size_m=40.0) in NEARER) == is_sure


def test_noise_of_a_small_outline_has_to_go_beyond_the_common_error_as_well():
    """0.25 px of 26 px in 0.6 s: 0.016/s, nearly as much as the noise."""
    noise_hz = (0.0, 0.0, -0.02 * NormalDist().inv_cdf(0.9995))
    assert seen(noise_hz, 0.02, size_m=40.0) in NEARER
    assert seen(noise_hz, 0.02, size_m=1.8) not in NEARER


def test_a_drift_costs_by_the_median_track_and_nothing_is_one_without_tracks_or_a_common_error():
    # A jump by 1 px leaves residuals with a mean square of 1/8 px^2 in a coordinate: 3 / 8 / 0.25^2 = 6.
    residual_px2, thing = np.array([0.125, 0.125, 30.0, 0.125, 0.5, 0.5]), np.array([0, 0, 0, 0, 2, 2])
    np.testing.assert_allclose(drift_cost(residual_px2, thing, 3, COMMON_ERROR_PX), [6.0, np.inf, 24.0])
    assert np.isinf(drift_cost(residual_px2, thing, 3, 0.0)).all()
