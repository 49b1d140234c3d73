"""Own motion: first pairs, movers, rest, platforms and the noise of the scene, against exact truth."""

from dataclasses import replace

import numpy as np
import pytest
from two_views import FOCAL_PX, angle_deg, two_views

from ttcvid.geometry.paper.epipole import MAX_DIRECTION_SIGMA_RAD
from ttcvid.geometry.rotation import normalize, vector_from_rotation
from ttcvid.model import Camera, ImageSize, Platform
from ttcvid.stages.egomotion.motion_prior import EgomotionMemory, UsualDirection
from ttcvid.stages.egomotion.relative_pose import (
    RayPairs,
    egomotion_of,
    estimate_egomotion,
    picture_region,
    region_side_of,
    with_doubt,
)

FORWARD = np.array([0.0, 0.0, -1.0])
LEAST_PARALLAX_RAD = 0.25 / FOCAL_PX
TURN_DEG, TRAVEL_M = (0.05, 0.3, 0.02), (0.05, 0.02, 1.0)
LAST = EgomotionMemory(np.radians([0.03, 0.25, 0.0]), FORWARD)
FIRST = EgomotionMemory()
MOVING_PLATFORMS = [Platform.vehicle, Platform.aircraft, Platform.free]


def fitted(views, memory=LAST, platform=Platform.vehicle):
    pairs = RayPairs(*views.observed)
    return with_doubt(estimate_egomotion(pairs, LEAST_PARALLAX_RAD, memory, platform), pairs, memory, platform)


def estimate(views, memory=LAST, platform=Platform.vehicle):
    return egomotion_of(fitted(views, memory, platform))


def turn_error_deg(egomotion, views):
    return np.degrees(np.linalg.norm(vector_from_rotation(egomotion.cam_R_prev @ views.cam_R_prev.T)))


def assert_is_true(egomotion, views, turn_deg=0.06, direction_deg=0.5):
    assert turn_error_deg(egomotion, views) < turn_deg
    assert egomotion.direction is not None
    assert angle_deg(egomotion.direction, views.direction) < direction_deg


def test_parts_of_a_picture_are_as_large_however_the_camera_is_held():
    lying, standing = (Camera(900.0, 900.0, 0.0, 0.0, ImageSize(*size)) for size in ((1280, 720), (720, 1280)))
    assert region_side_of(standing) == region_side_of(lying)


@pytest.mark.parametrize("platform", MOVING_PLATFORMS)
@pytest.mark.parametrize("yaw_deg", [-3.5, -2.5, 0.0, 1.7, 3.5])
def test_first_pair_of_a_turning_camera_needs_no_former_rotation(platform, yaw_deg):
    for seed in range(2):
        views = two_views(
            np.random.default_rng(seed), 250, (0.05, yaw_deg, 0.02), TRAVEL_M, movers=[((0.6, 0.8), (-0.6, 0, -0.5))]
        )
        assert_is_true(estimate(views, FIRST, platform), views)


@pytest.mark.parametrize("travel_m", [(0, 0, -1.0), (1.0, 0, 0), (-0.7, -0.3, 0.7), (0, 1.0, 0.2)])
def test_a_free_camera_may_travel_in_any_direction(travel_m):
    views = two_views(np.random.default_rng(1), 300, TURN_DEG, travel_m)
    assert_is_true(estimate(views, FIRST, Platform.free), views)


@pytest.mark.parametrize("platform", MOVING_PLATFORMS)
def test_a_camera_that_went_ahead_and_now_goes_back_has_the_opposite_direction(platform):
    """The residuals are those of the way ahead: what tells is on which side of the camera the points would lie."""
    for travel_m in ((0.05, 0.02, -1.0), (0.0, 0.0, -0.3)):
        views = two_views(np.random.default_rng(2), 300, TURN_DEG, travel_m, movers=[((0.0, 0.2), (0.5, 0, 0))])
        assert_is_true(estimate(views, LAST, platform), views, direction_deg=1.0)


MOVERS = {
    "two across": [((0.3, 0.5), (0.8, 0, 0)), ((0.6, 0.8), (-0.6, 0, -0.5))],
    "one ahead, faster": [((0.0, 0.4), (0, 0, 2.2))],
    "one from the right": [((0.6, 1.0), (-1.2, 0, 0.3))],
}


@pytest.mark.parametrize("movers", MOVERS.values(), ids=MOVERS)
@pytest.mark.parametrize("platform", MOVING_PLATFORMS)
def test_two_fifths_of_movers_do_not_turn_the_camera(movers, platform):
    for seed in range(4):
        views = two_views(np.random.default_rng(seed), 300, TURN_DEG, TRAVEL_M, movers=movers)
        assert views.is_mover.mean() > 0.3
        assert_is_true(estimate(views, LAST, platform), views)


@pytest.mark.parametrize(
    ("movers", "memory"),
    [([((0.6, 1.0), (-1.2, 0, 0.3))], FIRST), ([((0.3, 0.7), (0.8, 0, 0))], LAST)],
    ids=["first pair", "in the middle of the picture"],
)
def test_a_lorry_that_crosses_two_fifths_of_the_picture_is_not_taken_for_the_scene(movers, memory):
    errors = []
    for seed in range(8):
        views = two_views(np.random.default_rng(seed), 400, TURN_DEG, TRAVEL_M, movers=movers)
        egomotion = estimate(views, memory)
        errors.append(180.0 if egomotion.direction is None else angle_deg(egomotion.direction, views.direction))
    assert max(errors) < 1.0


RESTING_MOVERS = {
    "nothing moves": [],
    "a lorry across": [((0.3, 0.63), (0.8, 0, 0))],
    "a lorry comes": [((0.3, 0.63), (0.1, 0, -0.8))],
    "two cars": [((0.0, 0.2), (0.5, 0, 0)), ((0.5, 0.63), (-0.3, 0, -0.5))],
}


@pytest.mark.parametrize("movers", RESTING_MOVERS.values(), ids=RESTING_MOVERS)
@pytest.mark.parametrize("turn_deg", [(0.0, 0.0, 0.0), (0.02, 0.8, 0.0)], ids=["at rest", "turning"])
def test_movers_in_a_third_of_the_picture_do_not_make_a_resting_camera_travel(movers, turn_deg):
    for seed in range(2):
        views = two_views(np.random.default_rng(seed), 250, turn_deg, (0, 0, 0), movers=movers)
        for platform in MOVING_PLATFORMS:
            egomotion = estimate(views, FIRST, platform)
            assert egomotion.direction is None
            assert egomotion.direction_cov is None
            assert turn_error_deg(egomotion, views) < 0.02


def test_a_car_that_waits_does_not_go_sideways_with_the_traffic_that_fills_most_of_its_picture():
    """Three of five points cross: a camera that goes the other way would explain every one, the rest far away."""
    crossing = [((0.1, 0.75), (-0.8, 0, 0))]
    for memory in (FIRST, replace(LAST, rotation_rad=np.zeros(3))):
        for seed in range(6):
            views = two_views(np.random.default_rng(seed), 250, (0, 0, 0), (0, 0, 0), movers=crossing)
            assert views.is_mover.mean() > 0.5
            assert estimate(views, memory).direction is None


@pytest.mark.parametrize("turn_deg", [(0.0, 0.3, 0.0), (0.2, 0.0, 0.0), (0.3, -0.4, 0.1)])
def test_dirt_on_the_lens_is_no_scene_that_goes_across_as_the_camera_turns(turn_deg):
    """Far ground without parallax; two fifths of the points are fixed to the camera, all over the picture."""
    rng = np.random.default_rng(4)
    for _ in range(5):
        views = two_views(rng, 150, turn_deg, TRAVEL_M, depth_m=(3000.0, 9000.0))
        is_dirt, rays_cam = rng.random(150) < 0.4, views.rays_cam.copy()
        rays_cam[is_dirt] = views.rays_prev[is_dirt]
        for platform in (Platform.vehicle, Platform.aircraft):
            assert estimate(replace(views, rays_cam=rays_cam), platform=platform).direction is None


@pytest.mark.parametrize(("n", "off_deg"), [(70, 20.0), (70, 40.0), (150, 30.0)])
def test_a_direction_that_the_search_left_in_a_side_valley_is_known_to_be_doubtful(n, off_deg):
    """Three tenths of the points are displaced, and the last direction was ``off_deg`` off."""
    sigmas = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        views = two_views(rng, n, TURN_DEG, TRAVEL_M, depth_m=(20.0, 100.0))
        off_rad = rng.normal(size=(n, 3)) * 5.0 / FOCAL_PX * (rng.random(n) < 0.3)[:, None]
        angle, tangent = rng.uniform(0.0, 2.0 * np.pi), np.tan(np.radians(off_deg))
        last = normalize(np.array([tangent * np.cos(angle), tangent * np.sin(angle), -1.0]))
        memory = EgomotionMemory(LAST.rotation_rad, last)
        egomotion = estimate(replace(views, rays_cam=normalize(views.rays_cam + off_rad)), memory, Platform.aircraft)
        sigma_deg = np.degrees(np.sqrt(np.trace(egomotion.direction_cov)))
        sigmas.append(angle_deg(egomotion.direction, views.direction) / sigma_deg)
    assert np.mean(np.array(sigmas) < 3.0) > 0.85


def test_a_direction_known_to_less_than_half_a_radian_is_not_told():
    """Four fifths of few points are displaced at random."""
    told = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        views = two_views(rng, 40, TURN_DEG, TRAVEL_M, depth_m=(20.0, 100.0))
        off_rad = rng.normal(size=(40, 3)) * 10.0 / FOCAL_PX * (rng.random(40) < 0.8)[:, None]
        views = replace(views, rays_cam=normalize(views.rays_cam + off_rad))
        egomotion = estimate(views, platform=Platform.aircraft)
        if egomotion.direction is not None:
            is_sure = np.trace(egomotion.direction_cov) < MAX_DIRECTION_SIGMA_RAD**2
            assert egomotion.is_told == is_sure
            told.append(is_sure)
    assert 0 < np.count_nonzero(told) < len(told)


def test_a_camera_that_travels_does_not_rest():
    for seed in range(10):
        views = two_views(np.random.default_rng(seed), 300, travel_m=(0, 0, 0.1))
        assert estimate(views, FIRST).direction is not None


def test_flow_within_the_least_parallax_is_no_travel_however_small_the_noise():
    """The nearest point flows by 0.2 px, a hundred times its stated noise."""
    views = two_views(np.random.default_rng(1), 300, travel_m=(0, 0, 0.002), sigma_px=0.0, told_sigma_px=0.002)
    assert estimate(views).direction is None
    much = two_views(np.random.default_rng(1), 300, travel_m=(0, 0, 0.2), sigma_px=0.0, told_sigma_px=0.002)
    assert estimate(much).direction is not None


def test_a_camera_on_a_mast_shakes_but_never_travels():
    views = two_views(np.random.default_rng(2), 300, (0.05, 0.05, 0.0), (0, 0, 0.5))
    assert estimate(views, FIRST, Platform.static).direction is None
    shaken = two_views(np.random.default_rng(2), 300, (0.05, -0.04, 0.02), (0, 0, 0), movers=[((0.0, 0.3), (1, 0, 0))])
    # What it did last says nothing of what it does now: it swings back.
    last = EgomotionMemory(np.radians([-0.1, 0.2, 0.0]), None)
    assert turn_error_deg(estimate(shaken, last, Platform.static), shaken) < 0.02


@pytest.mark.parametrize("part", [0.7, 0.9, 1.0])
@pytest.mark.parametrize("velocity_m", [(0.4, 0.0, 0.0), (-0.5, 0.02, 0.1)], ids=["to the right", "to the left"])
def test_a_lorry_that_fills_the_picture_does_not_turn_a_camera_on_a_mast(part, velocity_m):
    views = two_views(
        np.random.default_rng(4), 300, travel_m=(0, 0, 0), movers=[((0.0, part), velocity_m)], depth_m=(5, 6)
    )
    egomotion = estimate(views, EgomotionMemory(np.zeros(3), None), Platform.static)
    assert turn_error_deg(egomotion, views) < 0.03
    # Its flow is no measure of the noise.
    assert egomotion.residual_spread < 1.5


@pytest.mark.parametrize("turn_deg", [(0.02, 0.8, 0.0), (0.0, -2.5, 0.0)])
def test_a_camera_on_a_mast_that_is_panned_all_the_same_turns(turn_deg):
    last = EgomotionMemory(np.zeros(3), None)
    views = two_views(np.random.default_rng(5), 300, turn_deg, (0, 0, 0), movers=[((0.3, 0.5), (1, 0, 0))])
    assert turn_error_deg(estimate(views, last, Platform.static), views) < 0.03


def test_priors_hold_a_vehicle_closer_to_forward_than_an_aircraft_than_a_hand():
    """A far scene in strong noise leaves the direction open: then the platform decides."""
    error = {platform: [] for platform in MOVING_PLATFORMS}
    for seed in range(15):
        views = two_views(np.random.default_rng(seed), 60, travel_m=(0, 0, 1.0), sigma_px=0.6, depth_m=(25, 200))
        for platform in MOVING_PLATFORMS:
            egomotion = estimate(views, EgomotionMemory(np.zeros(3), FORWARD), platform)
            if egomotion.direction is not None:
                error[platform].append(angle_deg(egomotion.direction, FORWARD))
    vehicle, aircraft, free = (np.sqrt(np.mean(np.square(error[p]))) for p in MOVING_PLATFORMS)
    assert len(error[Platform.vehicle]) >= 10
    assert vehicle < aircraft < free


def test_a_prior_does_not_overrule_a_clear_picture():
    """A car in a drift of 20 deg, seen clearly."""
    views = two_views(np.random.default_rng(3), 400, TURN_DEG, (0.36, 0, 1.0))
    assert_is_true(estimate(views, LAST, Platform.vehicle), views, direction_deg=0.7)


@pytest.mark.parametrize("movers", [[], [((0.0, 0.3), (0.8, 0, 0))]], ids=["scene alone", "with movers"])
@pytest.mark.parametrize("ratio", [0.5, 1.0, 2.0])
def test_residual_spread_is_the_true_noise_over_the_assumed_one(ratio, movers):
    spread = []
    for seed in range(8):
        views = two_views(
            np.random.default_rng(seed), 600, TURN_DEG, TRAVEL_M, 0.2 * ratio, movers=movers, told_sigma_px=0.2
        )
        spread.append(estimate(views).residual_spread)
    assert np.mean(spread) == pytest.approx(ratio, rel=0.08)


def test_residual_spread_of_a_resting_camera_is_the_same_measure():
    views = two_views(np.random.default_rng(4), 800, (0, 0.2, 0), (0, 0, 0), 0.3, told_sigma_px=0.2)
    egomotion = estimate(views, FIRST)
    assert egomotion.direction is None
    assert egomotion.residual_spread == pytest.approx(1.5, rel=0.08)


def test_the_next_search_starts_from_this_result():
    views = two_views(np.random.default_rng(5), 300, TURN_DEG, TRAVEL_M)
    fit = fitted(views)
    memory = LAST.after(fit)
    np.testing.assert_array_equal(memory.rotation_rad, egomotion_of(fit).rotation_rad)
    np.testing.assert_array_equal(memory.direction, fit.direction)


def test_a_stop_keeps_the_direction_for_when_it_goes_on():
    views = two_views(np.random.default_rng(6), 300, (0, 0, 0), (0, 0, 0))
    memory = EgomotionMemory(np.zeros(3), np.array([0.1, 0.0, -0.995]))
    after = memory.after(fitted(views, memory))
    np.testing.assert_array_equal(after.direction, memory.direction)


def test_order_of_the_points_does_not_matter():
    views = two_views(np.random.default_rng(7), 300, TURN_DEG, TRAVEL_M)
    order = np.random.default_rng(8).permutation(300)
    one = estimate(views)
    pairs = RayPairs(*(observed[order] for observed in views.observed))
    other = estimate_egomotion(pairs, LEAST_PARALLAX_RAD, LAST, Platform.vehicle)
    np.testing.assert_allclose(other.cam_R_prev, one.cam_R_prev, atol=1e-9)
    np.testing.assert_allclose(other.direction, one.direction, atol=1e-8)
    np.testing.assert_allclose(other.residual, one.residual[order], atol=1e-4)


def test_parts_of_the_picture_are_squares_of_a_tenth_of_the_focal_length_or_of_the_width():
    rays = np.array([[0.01, 0.01, 1.0], [0.09, 0.09, 1.0], [0.11, 0.01, 1.0], [-0.01, 0.01, 1.0], [0.02, 0.18, 2.0]])
    one, same, right, left, deep = picture_region(rays)
    assert one == same == deep
    assert len({one, right, left}) == 3
    ordinary, wide, long = (
        Camera(focal_px, focal_px, 639.5, 359.5, ImageSize(1280, 720)) for focal_px in (1200.0, 500.0, 12000.0)
    )
    assert region_side_of(ordinary) == region_side_of(wide) == 0.1
    assert region_side_of(long) * 12000.0 == pytest.approx(128.0)


def beside_far_away(rng, travel_m, n_near=300, n_far=250):
    """Two views of things nearby and of others beside them that are too far away to show any travel."""
    near = two_views(rng, n_near, TURN_DEG, travel_m, sigma_px=0.1, depth_m=(4.0, 12.0))
    far = two_views(rng, n_far, TURN_DEG, travel_m, sigma_px=0.1, depth_m=(200.0, 400.0))
    joined = {name: np.concatenate([getattr(near, name), getattr(far, name)]) for name in near.__dataclass_fields__}
    rays = joined["rays_prev"], joined["rays_cam"], joined["sigma_rad"]
    return replace(near, rays_prev=rays[0], rays_cam=rays[1], sigma_rad=rays[2], region=picture_region(rays[1]))


@pytest.mark.parametrize("angle_of_travel_deg", range(0, 360, 40))
@pytest.mark.parametrize("before", [FORWARD, np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])])
def test_a_free_camera_that_sways_before_a_far_background_has_its_direction_whatever_the_last_one(
    angle_of_travel_deg, before
):
    """The far half of the points fits any direction: from the wrong side no search comes round."""
    angle = np.radians(angle_of_travel_deg)
    travel_m = 0.03 * np.array([np.cos(angle), np.sin(angle), 0.1])
    views = beside_far_away(np.random.default_rng(angle_of_travel_deg), travel_m)
    found = estimate(views, EgomotionMemory(np.radians([0.03, 0.25, 0.0]), before), Platform.free)
    assert_is_true(found, views, turn_deg=0.02, direction_deg=4.0)


GOES_ON = EgomotionMemory(np.zeros(3), FORWARD, n_moving=6, usual=UsualDirection(FORWARD, float(np.radians(1.0)) ** 2))


def with_still_part(part, seed):
    """A camera that travels, and a part of the picture from the left that is too far away to move."""
    return two_views(np.random.default_rng(seed), 400, travel_m=(0, 0, 1.0), movers=[((0.0, part), (0, 0, 1.0))])


@pytest.mark.parametrize("seed", range(3))
def test_what_is_too_far_away_to_move_does_not_say_that_a_camera_has_stopped(seed):
    views = with_still_part(0.58, seed)

    def direction(memory, had_moved):
        pairs = RayPairs(*views.observed, had_moved)
        return egomotion_of(estimate_egomotion(pairs, LEAST_PARALLAX_RAD, memory, Platform.vehicle)).direction

    assert angle_deg(direction(GOES_ON, ~views.is_mover), FORWARD) < 1.0
    # What had moved and is still now says so; and a camera at rest does not move off with two fifths of the picture.
    assert direction(GOES_ON, np.ones(400, dtype=bool)) is None
    assert direction(FIRST, None) is None


@pytest.mark.parametrize("seed", range(3))
def test_what_moves_in_a_quarter_of_the_picture_may_be_movers_before_a_camera_that_has_stopped(seed):
    views = with_still_part(0.75, seed)
    pairs = RayPairs(*views.observed, ~views.is_mover)
    assert estimate_egomotion(pairs, LEAST_PARALLAX_RAD, GOES_ON, Platform.vehicle).direction is None


def test_the_usual_direction_of_a_camera_is_learned_in_what_the_flow_shows_and_forgotten():
    usual, step_s = UsualDirection(FORWARD, float(np.radians(15.0)) ** 2), 0.1
    true_dir = np.array([np.sin(np.radians(8.0)), 0.0, -np.cos(np.radians(8.0))])
    across = np.diag([1.0, 1.0, 0.0])
    for _ in range(600):
        usual = usual.after(true_dir, np.radians(1.0) ** 2 * across, float(np.radians(1.5)), step_s)
    assert angle_deg(usual.direction, true_dir) < 0.5
    # The same backwards; then flow that shows nothing in one coordinate; then another mounting.
    assert angle_deg(usual.after(-true_dir, across * 1e-4, 0.03, step_s).direction, true_dir) < 0.5
    before = usual.variance
    for _ in range(600):
        expected = usual.variance + np.radians(1.5) ** 2
        usual = usual.after(true_dir, np.diag([1e-5, expected, 0.0]), float(np.radians(1.5)), step_s)
    assert usual.variance > before
    for _ in range(3000):
        usual = usual.after(FORWARD, np.radians(1.0) ** 2 * across, float(np.radians(1.5)), step_s)
    assert angle_deg(usual.direction, FORWARD) < 1.0
