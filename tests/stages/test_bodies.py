"""Bodies carried from frame to frame and drawn towards what their points show."""

from dataclasses import replace

import numpy as np
import pytest

from ttcvid.geometry.estimation.rigid_motion import Points, RigidPaths, fit_on_paths, views_by_track
from ttcvid.geometry.estimation.track_on_trajectory import straight_path
from ttcvid.geometry.rotation import normalize, rotation_from_vector
from ttcvid.stages.segmentation.bodies import carried_forward, refined_movers, refined_scene, with_unit_speed

N_VIEWS = 12
T_S = -0.05 * np.arange(float(N_VIEWS))[::-1]
DIRECTION = normalize(np.array([0.2, 0.0, -1.0]))
SPEED_M_S, SIGMA = 8.0, 0.2 / 720.0
EVERY_STEP = rotation_from_vector(np.radians([0.1, 0.5, 0.0]))


def turning(n_views):
    """Rotations from each view to the last, of a camera that turns by the same step."""
    turns = [np.eye(3)]
    for _ in range(n_views - 1):
        turns.append(EVERY_STEP @ turns[-1])
    return np.array(turns[::-1])


def body(direction=DIRECTION, n_views=N_VIEWS):
    return RigidPaths(turning(n_views)[None], straight_path(direction, T_S[-n_views:])[None])


def rays_of(position, path, cam_R_past, sigma=0.0, rng=None):
    """Unit rays (L, N, 3) in the camera of each view, which `cam_R_past` turns into the present one."""
    place = position + SPEED_M_S * path[:, None]
    plane = np.einsum("lji,lnj->lni", cam_R_past, place)
    plane = plane / plane[..., 2:]
    if rng is not None:
        plane[..., :2] += sigma * rng.normal(size=plane[..., :2].shape)
    return normalize(plane)


def of_one_body(rays):
    n = rays.shape[1]
    return Points(views_by_track(rays), np.full(n, SIGMA), T_S, np.arange(n), np.zeros(n, dtype=np.int64))


def median_redchi(one, rays):
    return np.median(fit_on_paths(of_one_body(rays), one).redchi)


def points(n, rng):
    return np.column_stack([rng.uniform(-5, 5, n), rng.uniform(-2, 2, n), rng.uniform(10, 40, n)])


@pytest.mark.parametrize("is_step_known", [True, False])
def test_a_steady_motion_is_carried_forward_exactly(is_step_known):
    before = body(EVERY_STEP.T @ DIRECTION)
    step = -0.05 * DIRECTION if is_step_known else None
    after = carried_forward(before, EVERY_STEP, np.append(T_S, 0.05), step)
    np.testing.assert_allclose(after.path[0, 1:], body().path[0], atol=1e-12)
    np.testing.assert_allclose(after.cam_R_past[0, 1:], before.cam_R_past[0], atol=1e-12)
    assert after.path.shape[1] == len(T_S) + 1


def test_a_history_that_is_full_drops_its_oldest_view():
    after = carried_forward(body(EVERY_STEP.T @ DIRECTION), EVERY_STEP, T_S + 0.05)
    np.testing.assert_allclose(after.path[0], body().path[0], atol=1e-12)


def test_a_body_of_one_view_has_no_motion_to_go_on_with():
    after = carried_forward(body(n_views=1), EVERY_STEP, T_S[-2:])
    np.testing.assert_array_equal(after.path, 0.0)


def test_uneven_times_do_not_change_the_speed():
    t_s = np.array([-0.5, -0.38, -0.3, -0.1, 0.0])
    before = RigidPaths(np.broadcast_to(np.eye(3), (1, 4, 3, 3)), straight_path(DIRECTION, t_s[:4] - t_s[3])[None])
    after = carried_forward(before, np.eye(3), t_s)
    np.testing.assert_allclose(after.path[0], straight_path(DIRECTION, t_s), atol=1e-12)


def test_a_right_scene_stays_as_it_is():
    position, scene = points(80, np.random.default_rng(1)), body()
    rays = rays_of(position, scene.path[0], scene.cam_R_past[0])
    rate_hz = SPEED_M_S / position[:, 2]
    after = refined_scene(scene, of_one_body(rays), np.ones(80), np.ones(80, bool), rate_hz, 3)
    np.testing.assert_allclose(after.path, scene.path, atol=1e-9)
    np.testing.assert_allclose(after.cam_R_past, scene.cam_R_past, atol=1e-9)


def test_wrong_rotations_of_the_scene_are_drawn_towards_the_right_ones():
    rng = np.random.default_rng(2)
    position, scene = points(200, rng), body()
    rays = rays_of(position, scene.path[0], scene.cam_R_past[0], SIGMA, rng)
    off_rad = 5e-4 * rng.normal(size=(len(T_S), 3))
    off_rad[-1] = 0.0
    after = replace(scene, cam_R_past=rotation_from_vector(off_rad) @ scene.cam_R_past)
    redchi = [median_redchi(b, rays) for b in (scene, after)]
    for _ in range(10):
        after = refined_scene(after, of_one_body(rays), np.ones(200), np.ones(200, bool), np.full(200, np.nan), 2)
    assert redchi[1] > 2.0 * redchi[0]
    assert median_redchi(after, rays) < 1.1 * redchi[0]
    rotations = after.cam_R_past[0] @ np.swapaxes(after.cam_R_past[0], 1, 2)
    np.testing.assert_allclose(rotations, np.broadcast_to(np.eye(3), rotations.shape), atol=1e-12)
    assert np.linalg.norm(after.path[0, 0]) == pytest.approx(np.linalg.norm(scene.path[0, 0]), rel=1e-2)


def test_in_units_of_its_mean_speed_a_body_goes_as_far_as_the_window_is_long():
    scene = replace(body(), path=0.5 * body().path)
    after, speed = with_unit_speed(scene, T_S)
    assert speed == pytest.approx(0.5)
    np.testing.assert_allclose(after.path, body().path, atol=1e-12)


def test_movers_among_the_tracks_do_not_turn_the_scene():
    rng = np.random.default_rng(3)
    position, scene = points(200, rng), body()
    rays = rays_of(position, scene.path[0], scene.cam_R_past[0], SIGMA, rng)
    across = straight_path(normalize(np.array([1.0, 0.0, -0.2])), T_S)
    rays[:, :60] = rays_of(position[:60], across, scene.cam_R_past[0], SIGMA, rng)
    after = scene
    for _ in range(10):
        after = refined_scene(after, of_one_body(rays), np.ones(200), np.ones(200, bool), np.full(200, np.nan), 2)
    assert median_redchi(after, rays[:, 60:]) < 1.3


@pytest.mark.parametrize("bend_hz", [(0.0, 0.0, 1.5), (0.3, 0.0, 0.0)])
def test_a_mover_that_brakes_or_swerves_gets_a_path_that_explains_it(bend_hz):
    rng = np.random.default_rng(4)
    position, scene = points(60, rng), body(np.array([0.0, 0.0, -1.0]))
    mover = body()
    bent = mover.path[0] + 0.5 * T_S[:, None] ** 2 * np.array(bend_hz)
    rays = rays_of(position, bent, scene.cam_R_past[0], SIGMA, rng)
    before = median_redchi(mover, rays)
    after, rate_hz = refined_movers(mover, scene, of_one_body(rays), np.array([100]))
    assert before > 2.0
    assert median_redchi(after, rays) < 1.3
    # The path keeps its length, and so rates are in units of the speed that it had.
    scale = np.linalg.norm(bent[0]) / np.linalg.norm(mover.path[0, 0])
    assert rate_hz[0] == pytest.approx(scale * np.median(SPEED_M_S / position[:, 2]), rel=0.1)


def test_a_mover_without_usable_points_stays_as_it_is():
    rays = np.full((len(T_S), 4, 3), np.nan)
    after, rate_hz = refined_movers(body(), body(), of_one_body(rays), np.array([3]))
    np.testing.assert_array_equal(after.path, body().path)
    assert rate_hz[0] == 0.0


def test_each_of_several_movers_is_refined_as_if_alone_and_by_its_own_number_of_steps():
    rng = np.random.default_rng(5)
    scene = body(np.array([0.0, 0.0, -1.0]))
    movers = [
        body(normalize(np.array(direction))) for direction in ((0.3, 0.0, -1.0), (1.0, 0.1, 0.0), (0.0, 0.0, 1.0))
    ]
    number, n_steps = rng.integers(0, 3, 60), np.array([1, 3, 0])
    rays = np.empty((N_VIEWS, 60, 3))
    for place, mover in enumerate(movers):
        own, bent = number == place, mover.path[0] + 0.5 * T_S[:, None] ** 2 * np.array([0.0, 0.0, 0.5])
        rays[:, own] = rays_of(points(own.sum(), rng), bent, scene.cam_R_past[0], SIGMA, rng)
    every = movers[0].joined(movers[1]).joined(movers[2])
    together, together_hz = refined_movers(every, scene, replace(of_one_body(rays), thing=number), n_steps)
    for place, mover in enumerate(movers):
        alone = of_one_body(rays[:, number == place])
        expected, expected_hz = refined_movers(mover, scene, alone, n_steps[[place]])
        # But for rounding: what is added up in one instruction or in two depends on the machine code.
        np.testing.assert_allclose(together.path[place], expected.path[0], rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(together.cam_R_past[place], expected.cam_R_past[0], rtol=1e-9, atol=1e-12)
        assert together_hz[place] == pytest.approx(expected_hz[0], rel=1e-9)
