"""Movers from frame to frame: their paths keep up with them, and one that turns the wrong way is begun anew."""

import numpy as np
import pytest

from ttcvid.geometry.rigid_path import Points, RigidPaths, fit_on_paths, views_by_track
from ttcvid.geometry.rotation import normalize, rotation_from_vector
from ttcvid.stages.bodies import carried_forward, refined_movers
from ttcvid.stages.last_steps import begun_anew, stepped_movers

N_VIEWS, N_FRAMES, DT_S = 20, 32, 0.1
SIGMA = 0.1 / 700.0
SCENE = RigidPaths(np.broadcast_to(np.eye(3), (1, N_VIEWS, 3, 3)).copy(), np.zeros((1, N_VIEWS, 3)))
ONE_STEP = np.array([1])


def braking(t_s):
    return np.array([-1.5, 0.5, 34.0 - 2.0 * t_s - 2.5 * t_s**2]), 0.0


def coming_near(t_s):
    return np.array([-3.0, 0.5, 48.0 - 14.0 * t_s]), 0.0


def turning(t_s):
    angle = 0.4 * t_s
    return np.array([-4.0 + 12.0 * np.sin(angle), 0.5, 22.0 - 12.0 * (1.0 - np.cos(angle))]), angle


def turned(angle):
    return rotation_from_vector(np.array([0.0, angle, 0.0]))


def box(rng, n=40):
    return rng.uniform([-2.0, -0.7, -0.9], [2.0, 0.7, 0.9], (n, 3))


def rays_of(motion, points, rng):
    """What a camera at rest sees of points about the middle of a thing: (F, N, 3)."""
    rays = np.empty((N_FRAMES, len(points), 3))
    for frame in range(N_FRAMES):
        middle, angle = motion(frame * DT_S)
        place = points @ turned(angle).T + middle
        xy = place[:, :2] / place[:, 2:] + SIGMA * rng.normal(size=(len(points), 2))
        rays[frame] = normalize(np.column_stack([xy, np.ones(len(points))]))
    return rays


def true_path(motion, frame):
    """Where the thing was, in its own present axes, in the N_VIEWS up to a frame, at a mean speed of 1."""
    middle, angle = motion(frame * DT_S)
    rotations, path = np.empty((N_VIEWS, 3, 3)), np.empty((N_VIEWS, 3))
    for k in range(N_VIEWS):
        before, angle_before = motion((frame - N_VIEWS + 1 + k) * DT_S)
        rotations[k] = turned(angle - angle_before)
        path[k] = rotations[k] @ before - middle
    length = np.linalg.norm(path, axis=1).max()
    return RigidPaths(rotations[None], path[None] * (N_VIEWS - 1) * DT_S / length)


def seen(rays, frame):
    n, views = rays.shape[1], rays[frame - N_VIEWS + 1 : frame + 1]
    since_s = DT_S * np.arange(1.0 - N_VIEWS, 1.0)
    return Points(views_by_track(views), np.full(n, SIGMA), since_s, np.arange(n), np.zeros(n, dtype=np.int64))


def converged(points, paths):
    fit = fit_on_paths(points, paths)
    return fit_on_paths(points, paths, fit.rate_hz)


def usual_misfit(points, paths):
    return np.median(converged(points, paths).misfit)


def followed(motion, rng, step):
    """The misfits of a thing that is followed from its true path on, frame by frame."""
    rays, paths, rate_hz, misfits = rays_of(motion, box(rng), rng), true_path(motion, N_VIEWS - 1), None, []
    rate_hz = np.array([np.median(converged(seen(rays, N_VIEWS - 1), paths).rate_hz)])
    for frame in range(N_VIEWS, N_FRAMES):
        points = seen(rays, frame)
        carried = carried_forward(paths, np.eye(3), points.since_s)
        paths, rate_hz = step(carried, SCENE, points, ONE_STEP, rate_hz)
        misfits.append(usual_misfit(points, paths))
    return misfits


@pytest.mark.parametrize(("motion", "most"), [(braking, 1.3), (coming_near, 1.3), (turning, 3.0)])
def test_a_path_keeps_up_with_what_brakes_comes_near_or_turns(motion, most):
    misfits = followed(motion, np.random.default_rng(1), stepped_movers)
    assert max(misfits) < most


@pytest.mark.parametrize("motion", [braking, coming_near, turning])
def test_points_and_views_in_turn_would_stay_behind(motion):
    misfits = followed(motion, np.random.default_rng(1), lambda *of: refined_movers(*of[:4]))
    assert max(misfits) > 20.0


def turned_the_other_way(paths, middle):
    back = paths.cam_R_past[0].transpose(0, 2, 1)
    gone = np.einsum("lij,lj->li", back, middle + paths.path[0])
    return RigidPaths(back[None], (np.einsum("lij,lj->li", back, gone) - middle)[None])


def turning_box(rng):
    """Points of a thing that turns, its true path, the same as if it turned the other way, and its usual rate."""
    rays = rays_of(turning, box(rng), rng)
    points, truth = seen(rays, N_FRAMES - 1), true_path(turning, N_FRAMES - 1)
    rate_hz = np.median(converged(points, truth).rate_hz)
    middle = np.append(np.median(rays[-1, :, :2] / rays[-1, :, 2:], axis=0), 1.0) / rate_hz
    return points, truth, turned_the_other_way(truth, middle), np.array([rate_hz])


def test_what_turned_the_other_way_is_begun_anew():
    points, _, wrong, rate_hz = turning_box(np.random.default_rng(2))
    more, _ = refined_movers(wrong, SCENE, points, np.array([12]))
    anew, anew_hz = begun_anew(wrong, rate_hz, SCENE, points, 1.0)
    assert usual_misfit(points, anew) < 0.5 * min(usual_misfit(points, wrong), usual_misfit(points, more))
    assert anew_hz[0] > 0.0


def test_what_explains_its_points_as_usual_or_did_not_turn_stays_as_it_is():
    rng = np.random.default_rng(3)
    points, truth, wrong, rate_hz = turning_box(rng)
    straight, path = seen(rays_of(braking, box(rng), rng), N_FRAMES - 1), true_path(coming_near, N_FRAMES - 1)
    for is_seen, paths, usual in ((points, truth, 1.5), (points, wrong, 1e9), (straight, path, 1.5)):
        after, after_hz = begun_anew(paths, rate_hz, SCENE, is_seen, usual)
        np.testing.assert_array_equal(after.path, paths.path)
        np.testing.assert_array_equal(after.cam_R_past, paths.cam_R_past)
        np.testing.assert_array_equal(after_hz, rate_hz)


def test_of_several_movers_only_what_went_astray_is_begun_anew():
    points, truth, wrong, rate_hz = turning_box(np.random.default_rng(4))
    both = Points(points.rays, points.sigma_norm, points.since_s, np.tile(points.track, 2), np.repeat([0, 1], 40))
    after, after_hz = begun_anew(truth.joined(wrong), np.repeat(rate_hz, 2), SCENE, both, 3.0)
    np.testing.assert_array_equal(after.path[0], truth.path[0])
    alone, alone_hz = begun_anew(wrong, rate_hz, SCENE, points, 3.0)
    np.testing.assert_allclose(after.path[1], alone.path[0], rtol=1e-9, atol=1e-12)
    assert after_hz[0] == rate_hz[0]
    assert after_hz[1] == pytest.approx(alone_hz[0], rel=1e-9)
