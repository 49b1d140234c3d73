"""A mover that most of its tracks contradict becomes a turning body, at the distance that it had; others stay."""

from types import SimpleNamespace

import numpy as np
import pytest
from rigid_worlds import CAMERA, DT_S, FOCAL_PX, LINK_PX, Thing, car, pixels

from ttcvid.config import BodiesConfig
from ttcvid.geometry.estimation.rigid_motion import RigidPaths
from ttcvid.geometry.estimation.track_on_trajectory import straight_path
from ttcvid.geometry.rotation import normalize
from ttcvid.model import PointSet
from ttcvid.stages.segmentation.body_views import body_views, fit_on_movers
from ttcvid.stages.segmentation.turning_movers import with_turning_bodies
from ttcvid.stages.tracking.history import empty_history, extended, with_egomotion

N_VIEWS, N, SIGMA_PX, SCALE = 15, 30, 0.1, 0.25
GATE = BodiesConfig().scene_gate
BUS = {"velocity_m_s": (5.0, 0.0, -4.0), "yaw_rad_s": -0.45, "size_m": (11.0, 2.6, 2.4)}
CAR = {"velocity_m_s": (-3.0, 0.0, -6.0)}


def views_of(things, rng):
    """Views of the points of some things before a resting camera, one after the other, and which thing each is."""
    history = empty_history(CAMERA, SIGMA_PX)
    for frame in range(N_VIEWS):
        xy_px = pixels(np.concatenate([thing.at(frame * DT_S) for thing in things]))
        xy_px += SIGMA_PX * rng.normal(size=xy_px.shape)
        rays = normalize(np.column_stack([(xy_px - (CAMERA.cx_px, CAMERA.cy_px)) / FOCAL_PX, np.ones(len(xy_px))]))
        history = extended(history, frame, frame * DT_S, PointSet(np.arange(len(xy_px)), xy_px), rays, N_VIEWS)
        if frame:
            history = with_egomotion(history, np.eye(3), None, 1e-5)
    number = np.repeat(np.arange(len(things)), [len(thing.points) for thing in things])
    return body_views(history, np.ones(len(number), dtype=bool), LINK_PX, can_translate=True), number


def straight_bodies(things, since_s):
    """Trajectories of things that do not turn, in units of which a unit of speed is `SCALE`."""
    ways = [straight_path(normalize(np.array([thing.velocity_m_s]))[0], since_s) for thing in things]
    return RigidPaths(np.tile(np.eye(3), (len(things), N_VIEWS, 1, 1)), SCALE * np.stack(ways))


@pytest.mark.parametrize("seed", range(4))
def test_a_bus_that_turns_becomes_a_turning_body_and_a_car_stays(seed):
    rng = np.random.default_rng(seed)
    things: list[Thing] = [car(rng, (-4.0, -0.5, 24.0), n=N, **BUS), car(rng, (5.0, 0.0, 20.0), n=N, **CAR)]
    views, number = views_of(things, rng)
    points, before = views.points(np.arange(len(number)), number), straight_bodies(things, views.since_s)
    rest = RigidPaths(np.tile(np.eye(3), (1, N_VIEWS, 1, 1)), np.zeros((1, N_VIEWS, 3)))
    rate_hz = np.array([np.linalg.norm(thing.velocity_m_s) for thing in things]) / (24.0, 20.0) / SCALE
    seen = SimpleNamespace(scene=rest, median_redchi=1.0)
    after = with_turning_bodies(views, seen, points, before, rate_hz, GATE)
    by_straight, by_turning = (fit_on_movers(points, bodies, rate_hz) for bodies in (before, after))
    assert np.median(by_straight.redchi[number == 0]) > GATE
    assert np.median(by_turning.redchi[number == 0]) < 2.0
    # At the distance that it had.
    assert np.median(by_turning.rate_hz[number == 0]) == pytest.approx(rate_hz[0], rel=0.05)
    np.testing.assert_array_equal(after.path[1], before.path[1])
    # The movers of before are as they were.
    np.testing.assert_array_equal(before.path, straight_bodies(things, views.since_s).path)


def test_things_that_do_not_move_alike_become_no_turning_body():
    """A mover of two cars that drive apart."""
    rng = np.random.default_rng(0)
    cars = [car(rng, (-3.0, 0.0, 20.0), (-4.0, 0.0, -6.0), N), car(rng, (3.0, 0.0, 20.0), (4.0, 0.0, 3.0), N)]
    views, number = views_of(cars, rng)
    points, before = (
        views.points(np.arange(len(number)), np.zeros_like(number)),
        straight_bodies(cars[:1], views.since_s),
    )
    rest = RigidPaths(np.tile(np.eye(3), (1, N_VIEWS, 1, 1)), np.zeros((1, N_VIEWS, 3)))
    seen, rate_hz = SimpleNamespace(scene=rest, median_redchi=1.0), np.array([7.2 / 20.0 / SCALE])
    after = with_turning_bodies(views, seen, points, before, rate_hz, GATE)
    np.testing.assert_array_equal(after.path, before.path)
