"""Movers whose paths went astray are begun anew as bodies that turn."""

from dataclasses import replace

import numpy as np
import pytest
from watched_things import (
    DT_S,
    N_FRAMES,
    N_VIEWS,
    SCENE,
    box,
    braking,
    coming_near,
    converged,
    median_redchi,
    rays_of,
    seen,
    true_path,
    turning,
)

from ttcvid.geometry.estimation.rigid_motion import Points, RigidPaths
from ttcvid.geometry.rotation import vector_from_rotation
from ttcvid.stages.segmentation.bodies import refined_movers
from ttcvid.stages.segmentation.reinitialisation import reinitialised

ALL = np.array([True])


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
    anew, anew_hz = reinitialised(wrong, rate_hz, ALL, SCENE, points, 1.0)
    assert median_redchi(points, anew) < 0.5 * min(median_redchi(points, wrong), median_redchi(points, more))
    assert anew_hz[0] == pytest.approx(np.median(converged(points, anew).rate_hz), rel=0.05)


def test_a_bus_that_was_followed_without_its_turn_is_found_turning():
    rng = np.random.default_rng(5)
    bus = rng.uniform([-5.5, -1.4, -1.2], [5.5, 1.4, 1.2], (90, 3))
    points, truth = seen(rays_of(turning, bus, rng), N_FRAMES - 1), true_path(turning, N_FRAMES - 1)
    still = RigidPaths(SCENE.cam_R_past, way_of_middle(turning))
    # As many steps as it would have had as an old mover, and more.
    still, rate_hz = refined_movers(still, SCENE, points, np.array([50]))
    anew, _ = reinitialised(still, rate_hz, ALL, SCENE, points, 1.0)
    assert median_redchi(points, still) > 5.0 * median_redchi(points, truth)
    assert median_redchi(points, anew) < 1.2 * median_redchi(points, truth)
    off = vector_from_rotation(anew.cam_R_past[:, 0] @ truth.cam_R_past[0, 0].T)
    assert np.degrees(np.linalg.norm(off)) < 1.0


def way_of_middle(motion):
    """The path (1, N_VIEWS, 3) of a thing's middle, as if it had not turned, at a mean speed of 1."""
    way = np.array([motion((N_FRAMES - N_VIEWS + k) * DT_S)[0] for k in range(N_VIEWS)])
    way = way - way[-1]
    return (way * (N_VIEWS - 1) * DT_S / np.linalg.norm(way, axis=1).max())[None]


def test_what_explains_its_points_as_usual_or_is_not_asked_stays_as_it_is():
    points, truth, wrong, rate_hz = turning_box(np.random.default_rng(3))
    few = replace(points, track=points.track[:7], thing=points.thing[:7])
    for is_seen, paths, is_asked, median_chi2 in (
        (points, truth, True, 1.5),
        # Not clearly better.
        (points, truth, True, 0.5),
        (points, wrong, True, 1e9),
        (points, wrong, False, 1.0),
        (few, wrong, True, 1.0),
    ):
        after, after_hz = reinitialised(paths, rate_hz, np.array([is_asked]), SCENE, is_seen, median_chi2)
        np.testing.assert_array_equal(after.path, paths.path)
        np.testing.assert_array_equal(after.cam_R_past, paths.cam_R_past)
        np.testing.assert_array_equal(after_hz, rate_hz)


def test_what_does_not_turn_is_not_said_to():
    rng = np.random.default_rng(6)
    points, wrong = seen(rays_of(braking, box(rng), rng), N_FRAMES - 1), true_path(coming_near, N_FRAMES - 1)
    rate_hz = np.array([np.median(converged(points, wrong).rate_hz)])
    anew, _ = reinitialised(wrong, rate_hz, ALL, SCENE, points, 1.0)
    assert median_redchi(points, anew) < 1.2
    assert np.degrees(np.linalg.norm(vector_from_rotation(anew.cam_R_past[:, 0]))) < 0.5


def test_of_several_movers_only_what_went_astray_is_begun_anew():
    points, truth, wrong, rate_hz = turning_box(np.random.default_rng(4))
    both = Points(points.rays, points.sigma_norm, points.since_s, np.tile(points.track, 2), np.repeat([0, 1], 40))
    after, after_hz = reinitialised(truth.joined(wrong), np.repeat(rate_hz, 2), np.repeat(ALL, 2), SCENE, both, 3.0)
    np.testing.assert_array_equal(after.path[0], truth.path[0])
    alone, alone_hz = reinitialised(wrong, rate_hz, ALL, SCENE, points, 3.0)
    np.testing.assert_allclose(after.path[1], alone.path[0], rtol=1e-9, atol=1e-12)
    assert after_hz[0] == rate_hz[0]
    assert after_hz[1] == pytest.approx(alone_hz[0], rel=1e-9)
