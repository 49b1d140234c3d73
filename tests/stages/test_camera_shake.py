"""Movers seen by a camera that sways, as a steady one would have seen them: exact truth."""

from dataclasses import replace

import numpy as np
import pytest
from relative_motion import box_of_points, history_of

from ttcvid.stages.objects.camera_shake import stabilised
from ttcvid.stages.segmentation.bodies import shake_of

TIMES_S = 0.04 * np.arange(20.0)
SINCE_S = TIMES_S - TIMES_S[-1]
AT_M, DRONE_M = np.array([1.5, -0.4, 9.0]), (0.5, 0.2, 0.1)
TO_US_M_S = np.array([-0.4, 0.1, -3.3])
# To and fro across the view, in 3 s, by a tenth of a speed of 2.5 m/s; without the part that is a constant velocity.
OWN_M_S, RATE_HZ = 2.5, 2.0
SWAY_M = np.outer((np.sin(RATE_HZ * SINCE_S) / RATE_HZ - SINCE_S) * 0.9, [1.0, 0.0, 0.0])
N = 8


def seen(rng, sway_m, sigma_px=0.0):
    """The history of a drone's tracks before a camera that sways."""
    places = box_of_points(rng, N, AT_M, DRONE_M)
    history = history_of(places, np.broadcast_to(TO_US_M_S, places.shape), TIMES_S, sigma_px=sigma_px, rng=rng)
    where = places + SINCE_S[:, None, None] * TO_US_M_S + sway_m[:, None]
    noise = sigma_px * history.plane_per_px[:, None] * rng.normal(size=(len(SINCE_S), N, 2))
    rays = where / where[..., 2:] + np.pad(noise, ((0, 0), (0, 0), (0, 1)))
    return replace(
        history, rays=rays / np.linalg.norm(rays, axis=2, keepdims=True), sigma_px=np.full(N, max(sigma_px, 0.1))
    )


def test_places_are_those_that_a_steady_camera_sees():
    rng = np.random.default_rng(3)
    steady = seen(np.random.default_rng(3), np.zeros((len(SINCE_S), 3)))
    swayed = seen(rng, SWAY_M)
    off = np.abs(swayed.xy - steady.xy).max()
    found = stabilised(swayed, SWAY_M / OWN_M_S, np.arange(N), np.zeros(N, dtype=np.int64))
    assert off > 0.01
    # Its nearest part is a hundredth nearer than its middle.
    assert np.abs(found - steady.xy).max() < 0.02 * off


def test_a_thing_that_does_not_sway_with_us_stays_as_it_is_seen():
    """What the scene swayed by is none of what its tracks show: a thing so far away that it makes no difference."""
    history = seen(np.random.default_rng(5), np.zeros((len(SINCE_S), 3)), sigma_px=0.1)
    found = stabilised(history, SWAY_M / OWN_M_S, np.arange(N), np.zeros(N, dtype=np.int64))
    np.testing.assert_array_equal(found, history.xy)


@pytest.mark.parametrize("members", [[], [0, 1]], ids=["no mover", "too few tracks"])
def test_tracks_of_no_mover_stay_as_they_are_seen(members):
    history = seen(np.random.default_rng(5), SWAY_M)
    members = np.array(members, dtype=np.int64)
    found = stabilised(history, SWAY_M / OWN_M_S, members, np.zeros_like(members))
    np.testing.assert_array_equal(found, history.xy)


def test_what_goes_on_as_it_did_does_not_sway():
    path = np.outer(SINCE_S, [0.1, 0.0, -1.0])
    np.testing.assert_allclose(shake_of(path, SINCE_S), 0.0, atol=1e-12)
    np.testing.assert_array_equal(shake_of(path[-5:], SINCE_S[-5:]), 0.0)


def test_the_sway_has_no_velocity_now():
    """Of a velocity that changes evenly nothing but half of the change by the square of the time is left."""
    path = np.outer(SINCE_S, [0.0, 0.0, -1.0]) + np.outer(0.5 * SINCE_S**2, [0.3, 0.0, 0.0])
    expected = np.outer(0.5 * SINCE_S**2, [0.3, 0.0, 0.0])
    np.testing.assert_allclose(shake_of(path, SINCE_S), expected, atol=1e-12)
