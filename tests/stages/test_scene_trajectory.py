"""The trajectory of the scene: times of its tracks that are right, and as sure as they say, before any camera."""

from dataclasses import replace

import numpy as np
import pytest
from relative_motion import FOCAL_PX, history_of, unit

from ttcvid.config import CollisionTimesConfig
from ttcvid.model import Platform, Status
from ttcvid.stages.egomotion.relative_pose import Egomotion
from ttcvid.stages.egomotion.scene_trajectory import with_scene_path
from ttcvid.stages.objects.clusters import ClusterMotion
from ttcvid.stages.objects.motions import FrameMotions
from ttcvid.stages.rows import track_rows
from ttcvid.studies.evaluation.times import is_within

N_POINTS, SIGMA_PX = 60, 0.1
TIMES_S = 0.1 * np.arange(-19.0, 1.0)


def rows_of_scene(path_m, velocity_m_s, rng, platform, told_deg):
    """Rows of still points before a camera that was at `path_m` (L, 3), less where it is, and now has a velocity.

    Its direction in each step is told as two views tell it: true to `told_deg`.
    """
    side = rng.choice([-1.0, 1.0], N_POINTS)
    position_m = np.column_stack(
        [side * rng.uniform(1, 4, N_POINTS), rng.uniform(-2, 2, N_POINTS), rng.uniform(4, 20, N_POINTS)]
    )
    history = history_of(position_m, None, TIMES_S, sigma_px=SIGMA_PX, rng=rng, shift_m=-path_m)
    told = unit(unit(-np.diff(path_m, axis=0)) + np.radians(told_deg) * rng.normal(size=(len(path_m) - 1, 3)))
    history = replace(history, scene_direction=np.concatenate([np.full((1, 3), np.nan), told]))
    cov = np.radians(told_deg) ** 2 * (np.eye(3) - np.outer(told[-1], told[-1]))
    everything = np.ones(N_POINTS, dtype=bool)
    own = Egomotion(np.eye(3), (0.1 * SIGMA_PX / FOCAL_PX) ** 2 * np.eye(3), told[-1], cov, 1.0)
    history = with_scene_path(history, everything, own, platform)
    scene = ClusterMotion(0, np.arange(N_POINTS), told[-1], cov, Status.ok, "egomotion")
    motions = FrameMotions(np.zeros(N_POINTS, np.int64), np.full(N_POINTS, Status.ok), (scene,), 32.0, everything)
    _, rows = track_rows(history, motions, CollisionTimesConfig())
    return rows, position_m[:, 2] / velocity_m_s[2]


def sway(phase):
    """A hand that is carried on, and sways once in two seconds: its path (L, 3) and its velocity now."""
    per_s, speed_m_s, along_m, across_m = np.pi, 1.0, 0.15, 0.05
    angle = per_s * TIMES_S + phase
    path_m = np.column_stack(
        [across_m * np.sin(1.3 * angle), 0.0 * angle, speed_m_s * TIMES_S + along_m * np.sin(angle)]
    )
    velocity = per_s * np.array([1.3 * across_m * np.cos(1.3 * phase), 0.0, along_m * np.cos(phase)])
    velocity[2] += speed_m_s
    return path_m - path_m[-1], velocity


def test_before_a_hand_that_sways_the_intervals_of_the_scenes_tracks_hold():
    held, errors = [], []
    for seed in range(24):
        rng = np.random.default_rng(seed)
        path_m, velocity_m_s = sway(rng.uniform(0.0, 2.0) * np.pi)
        rows, true_s = rows_of_scene(path_m, velocity_m_s, rng, Platform.free, 0.5)
        value_s, bounds_s = rows.times.ttc_z_s, (rows.times.ttc_z_lo_s, rows.times.ttc_z_hi_s)
        told = np.isfinite(value_s)
        assert np.count_nonzero(told) > 0.5 * N_POINTS
        held.append(np.mean(is_within("ttc_z", true_s, *bounds_s)[told]))
        errors.append(np.median(np.abs(true_s / value_s - 1.0)[told]))
    assert np.mean(held) > 0.75
    assert np.median(errors) < 0.03


@pytest.mark.parametrize("brake_m_s2", [0.0, 4.0])
def test_a_car_that_brakes_is_told_by_all_its_views(brake_m_s2):
    held = []
    for seed in range(12):
        speed_m_s = 8.0
        path_m = np.column_stack([0.0 * TIMES_S, 0.0 * TIMES_S, speed_m_s * TIMES_S - 0.5 * brake_m_s2 * TIMES_S**2])
        velocity_m_s = np.array([0.0, 0.0, speed_m_s])
        rows, true_s = rows_of_scene(path_m, velocity_m_s, np.random.default_rng(seed), Platform.vehicle, 0.1)
        value_s, bounds_s = rows.times.ttc_z_s, (rows.times.ttc_z_lo_s, rows.times.ttc_z_hi_s)
        told = np.isfinite(value_s)
        held.append(np.mean(is_within("ttc_z", true_s, *bounds_s)[told]))
        assert np.median(np.abs(true_s / value_s - 1.0)[told]) < 0.03
    assert np.mean(held) > 0.8
