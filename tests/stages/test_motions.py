"""The direction of a mover is that of the velocity which its tracks share, where that is known."""

from dataclasses import replace

import numpy as np
import pytest
from relative_motion import CAMERA, box_of_points, history_of, unit

from ttcvid.config import CollisionTimesConfig
from ttcvid.model import Status
from ttcvid.stages.objects.motions import FrameMotions, motions_of
from ttcvid.stages.rows import cluster_rows, track_rows

TIMES_S = 0.1 * np.arange(12)
POSITION_M = box_of_points(np.random.default_rng(31), 20, (1.0, 0.5, 18.0), (1.8, 1.4, 0.0))
VELOCITY_M_S = np.array([-2.0, 0.1, -4.0])
V_HZ = VELOCITY_M_S / 18.0
SURE = 1e12 * np.eye(3)


def seen(velocity_m_s=VELOCITY_M_S):
    return history_of(POSITION_M, velocity_m_s, TIMES_S, sigma_px=0.1)


def motion_of(velocity_hz, info=SURE, history=None):
    history = seen() if history is None else history
    members = {7: np.arange(history.n_tracks)}
    (motion,) = motions_of(members, np.array([velocity_hz]), np.array([info]), history, None, CAMERA)
    return motion


def test_it_is_that_of_the_velocity_with_the_number_and_the_tracks_that_were_given():
    motion = motion_of(V_HZ)
    assert (motion.cluster_id, motion.status, motion.members.tolist()) == (7, Status.ok, list(range(20)))
    np.testing.assert_allclose(motion.direction, unit(VELOCITY_M_S), rtol=1e-12)


def test_its_covariance_is_that_of_draws_of_the_velocity_and_of_a_rotation_left_in_the_views():
    rng, history, info = np.random.default_rng(32), seen(), np.diag([1e3, 2e3, 3e2])
    ray = np.append(history.xy[history.now].mean(axis=0), 1.0)
    turns = history.rotation_rate_sigma_rad_s * rng.normal(size=(100_000, 3))
    velocity_hz = 8.0 * V_HZ
    drawn = velocity_hz + rng.normal(size=(100_000, 3)) / np.sqrt(np.diag(info)) + np.cross(turns, ray)
    off = drawn / np.linalg.norm(drawn, axis=1)[:, None] - unit(VELOCITY_M_S)
    cov = motion_of(velocity_hz, info, history).direction_cov
    np.testing.assert_allclose(cov, off.T @ off / len(off), atol=0.03 * np.trace(cov))


@pytest.mark.parametrize(
    ("velocity_hz", "info"),
    [
        (np.zeros(3), SURE),
        (V_HZ, np.zeros((3, 3))),
        # Across it is known well; whether it comes or goes is not.
        (np.array([0.02, 0.0, 1.0]), np.diag([1e4, 1e4, 1.0])),
    ],
    ids=["rests", "nothing is known", "comes or goes"],
)
def test_what_may_not_move_has_no_direction(velocity_hz, info):
    motion = motion_of(velocity_hz, info)
    assert motion.direction is None
    assert motion.status == Status.no_parallax


def test_a_track_without_a_ray_takes_the_direction_from_no_other():
    history = seen()
    rays = history.rays.copy()
    rays[-1, 3] = np.nan
    np.testing.assert_allclose(
        motion_of(V_HZ, history=replace(history, rays=rays)).direction, unit(VELOCITY_M_S), rtol=1e-12
    )


def test_no_movers_have_no_motions():
    assert motions_of({}, np.empty((0, 3)), np.empty((0, 3, 3)), seen(), None, CAMERA) == []


def test_neither_an_object_without_a_direction_nor_its_tracks_have_times():
    """Its tracks come nearer, as they may seem to by chance."""
    history, n = seen(), len(POSITION_M)
    motion = motion_of(np.zeros(3), history=history)
    motions = FrameMotions(np.full(n, 7), np.full(n, int(motion.status)), (motion,), 32.0, np.ones(n, bool))
    states, tracks = track_rows(history, motions, CollisionTimesConfig())
    assert set(tracks.status.tolist()) == {int(Status.no_parallax)}
    assert np.isnan(tracks.times.ttc_z_s).all()
    (row,) = cluster_rows(history, motions, states, CAMERA, {})[0]
    assert row.status == Status.no_parallax
    assert row.state_abc_hz is None


def test_tracks_before_an_assumed_lens_have_wider_intervals_of_tcpa_and_no_others_of_ttc_z():
    history, n = seen(), len(POSITION_M)
    motion = motion_of(V_HZ, history=history)
    motions = FrameMotions(np.full(n, 7), np.full(n, int(motion.status)), (motion,), 32.0, np.ones(n, bool))
    assumed = replace(history, camera=replace(CAMERA, origin="assumed"))
    given, wide = (track_rows(one, motions, CollisionTimesConfig())[1].times for one in (history, assumed))
    assert np.median((wide.tcpa_hi_s - wide.tcpa_lo_s) / (given.tcpa_hi_s - given.tcpa_lo_s)) > 1.3
    np.testing.assert_array_equal(wide.ttc_z_hi_s, given.ttc_z_hi_s)
