"""Static points move with the scene as often as the gate says; movers do not."""

from dataclasses import replace

import numpy as np
import pytest
from relative_motion import FOCAL_PX, direction_noise, flows_of, joined, unit
from scipy.stats import chi2

from ttcvid.stages.scene import moves_with_scene

GATE = float(chi2.ppf(0.99, 1))
FORWARD = np.array([0.0, 0.0, -10.0])
STILL_RAD = 0.25 / FOCAL_PX


def static_points(rng, n):
    """Points to both sides of the road, none of them near the epipole."""
    x = rng.uniform(3.0, 12.0, n) * rng.choice([-1.0, 1.0], n)
    return np.column_stack([x, rng.uniform(-3.0, 3.0, n), rng.uniform(12.0, 35.0, n)])


def judged(flows, direction, cov=None, gate=GATE, still_rad=STILL_RAD):
    directions = np.broadcast_to(np.full(3, np.nan) if direction is None else direction, (len(flows.gap_s), 3))
    return moves_with_scene(flows, directions, cov, gate, still_rad)


@pytest.mark.parametrize("probability", [0.9, 0.99])
def test_static_points_are_inside_the_gate_with_its_probability(probability):
    rng = np.random.default_rng(11)
    flows = flows_of(static_points(rng, 8000), FORWARD, sigma_px=0.5, rng=rng)
    belongs = judged(flows, unit(FORWARD), gate=float(chi2.ppf(probability, 1)))
    spread = np.sqrt(probability * (1.0 - probability) / 8000)
    # The floor of the direction's error may let a few more in.
    assert probability - 4.0 * spread < belongs.mean() < probability + 4.0 * spread + 0.1 * (1.0 - probability)


def test_error_of_the_scenes_direction_is_allowed_for():
    rng = np.random.default_rng(12)
    inside = []
    for _ in range(150):
        direction, cov = direction_noise(rng, unit(FORWARD), np.radians(1.0))
        flows = flows_of(static_points(rng, 100), FORWARD, sigma_px=0.2, rng=rng)
        inside.append(judged(flows, direction, cov).mean())
    assert np.mean(inside) > 0.985
    direction = unit([np.tan(np.radians(6.0)), 0.0, -1.0])
    assert judged(flows, direction).mean() < 0.5
    assert judged(flows, direction, np.radians(6.0) ** 2 * np.eye(3)).mean() > 0.97


def test_points_that_cross_our_way_do_not_belong():
    rng = np.random.default_rng(13)
    position = np.column_stack([rng.uniform(-6, 6, 500), rng.uniform(0.5, 3, 500), rng.uniform(10, 25, 500)])
    flows = flows_of(position, FORWARD + np.array([6.0, 0.0, 0.0]), sigma_px=0.2, rng=rng)
    assert judged(flows, unit(FORWARD)).mean() < 0.02


def test_points_that_move_along_our_line_but_away_do_not_belong():
    rng = np.random.default_rng(14)
    flows = flows_of(static_points(rng, 300), -FORWARD, sigma_px=0.2, rng=rng)
    assert not judged(flows, unit(FORWARD)).any()


def test_sense_is_not_asked_for_at_the_epipole():
    position = np.array([[0.005, 0.0, 20.0], [5.0, 0.0, 20.0]])
    flows = flows_of(position, -FORWARD, sigma_px=0.2)
    cov = np.radians(0.3) ** 2 * np.diag([1.0, 1.0, 0.0])
    np.testing.assert_array_equal(judged(flows, unit(FORWARD), cov), [True, False])


def test_before_a_resting_camera_what_moves_does_not_belong_and_noise_does():
    rng = np.random.default_rng(15)
    position = static_points(rng, 4000)
    resting = flows_of(position, np.zeros(3), sigma_px=0.3, rng=rng)
    still = judged(resting, None, still_rad=0.0)
    assert still.mean() == pytest.approx(0.99, abs=0.007)
    moving = flows_of(position, np.array([2.0, 0.0, 0.0]), sigma_px=0.3, rng=rng)
    assert not judged(moving, None).any()


def test_before_a_resting_camera_flow_below_the_least_parallax_belongs_however_small_the_noise():
    position = np.array([[5.0, 1.0, 20.0], [5.0, 1.0, 20.0]])
    flows = flows_of(position, np.array([[0.03, 0.0, 0.0], [0.5, 0.0, 0.0]]))
    np.testing.assert_array_equal(judged(flows, None), [True, False])


@pytest.mark.parametrize("direction", [None, unit(FORWARD)])
def test_tracks_without_a_flow_yet_are_left_to_the_scene(direction):
    flows = flows_of(np.array([[5.0, 1.0, 20.0]] * 2), np.array([4.0, 0.0, 0.0]))
    new = replace(flows, first=np.full((2, 3), np.nan), gap_frames=np.zeros(2, np.int64), gap_s=np.zeros(2))
    np.testing.assert_array_equal(judged(joined(new, flows), direction), [True, True, False, False])
