"""Corners of two surfaces, one behind the other: exact ones are known for what they are, and what moves is not."""

import numpy as np
import pytest
from rigid_worlds import bodies_of, car, world

from ttcvid.geometry.estimation.rigid_motion import PathFit, RigidPaths
from ttcvid.stages.segmentation.occlusions import between_surfaces

N_FRAMES, SLOWLY = 16, (0.0, 0.0, 4.0)
PLACE, NEAR_HZ, FAR_HZ, SINCE_S = np.array([0.3, -0.1]), 0.5, 0.1, np.array([-1.0, -0.5, 0.0])


def asked(was, rate_hz=(NEAR_HZ, FAR_HZ), sigma_hz=0.0, is_static=(True, True)):
    """Whether a track that was at `was` a second ago may be a corner of two surfaces with these rates beside it."""
    places = np.stack([PLACE] * 3)
    ahead = np.outer(-SINCE_S, [0.0, 0.0, 1.0])
    fit = PathFit(places, np.array([0.2, *rate_hz]), np.full(3, sigma_hz), np.ones(3), np.full(3, 10))
    xy = np.stack([was, 0.5 * (was + PLACE), PLACE])[:, None]
    scene = RigidPaths(np.tile(np.eye(3), (1, 3, 1, 1)), ahead[None])
    return bool(between_surfaces(scene, fit, np.array([False, *is_static]), np.array([0]), np.array([[1, 2]]), xy)[0])


def crossing_of(near_normal, far_normal):
    """Where the corner of two outlines with these normals was a second ago, when it is at `PLACE` now."""
    normals = np.stack([near_normal, far_normal])
    were = [PLACE / (1.0 + NEAR_HZ), PLACE / (1.0 + FAR_HZ)]
    return np.linalg.solve(normals, np.einsum("ij,ij->i", normals, were))


@pytest.mark.parametrize("angle_deg", range(0, 180, 15))
def test_outlines_at_right_angles_make_a_corner_of_two_surfaces(angle_deg):
    angle = np.radians(angle_deg)
    near, far = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    assert asked(crossing_of(near, far))


@pytest.mark.parametrize("angle_deg", [45, 60, 120])
def test_outlines_at_other_angles_do_so_too(angle_deg):
    near, far = np.array([1.0, 0.0]), np.array([np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))])
    assert asked(crossing_of(near, far))


def test_what_moves_farther_off_than_two_surfaces_can_tell_moves_by_itself():
    middle, aside = PLACE / (1.0 + 0.5 * (NEAR_HZ + FAR_HZ)), np.array([0.1, 0.3]) / np.hypot(0.1, 0.3)
    apart = np.linalg.norm(PLACE / (1.0 + NEAR_HZ) - PLACE / (1.0 + FAR_HZ))
    assert asked(middle + 0.8 * apart * aside)
    assert not asked(middle + 1.2 * apart * aside)


def test_one_surface_beside_a_track_makes_no_such_corner():
    was = crossing_of(np.array([1.0, 0.0]), np.array([0.0, 1.0]))
    assert not asked(was, rate_hz=(NEAR_HZ, NEAR_HZ))
    assert not asked(was, is_static=(True, False))
    # Depths that are not known are no two depths.
    assert not asked(was, sigma_hz=0.2)


def test_a_car_that_crosses_before_a_street_of_many_depths_is_found():
    rng = np.random.default_rng(5)
    crossing = car(rng, (6.0, 0.5, 32.0), (-5.0, 0.0, 0.0))
    frames = bodies_of(world(rng, SLOWLY, N_FRAMES, crossing, n=900), N_FRAMES, camera_m_s=SLOWLY)
    assert frames[8].keys_of(1)[0] != 0
    assert frames[8].keys_of(1)[1] > 0.8
