"""Windows that slip along edges of the static scene: known for what they are, and what moves is not."""

import numpy as np
import pytest
from rigid_worlds import Thing, bodies_of, car, world

from ttcvid.model import Platform
from ttcvid.stages.segmentation.aperture_problem import may_slip

N_FRAMES, SLOWLY = 16, (0.0, 0.0, 4.0)
SINCE_S = np.linspace(-1.0, 0.0, 6)
AHEAD = np.outer(-SINCE_S, [0.0, 0.0, 1.0])
PLACE, SIGMA, GATE = np.array([0.3, -0.2]), 1e-4, 5.0


def edge_across(angle):
    return np.array([[np.cos(2.0 * angle), np.sin(2.0 * angle)]])


def flows(angle, across_hz, along_hz, path=AHEAD):
    """Places (L, 1, 2) of a window whose parts across an edge and along it move as points with these rates do."""
    axes = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    rates = np.array([across_hz, along_hz])
    parts = (axes @ PLACE + rates * (path[:, :2] @ axes.T)) / (1.0 + rates * path[:, 2:])
    return (parts @ axes)[:, None]


def asked(xy, edge, path=AHEAD):
    return bool(may_slip(edge, xy, path, np.array([SIGMA]), GATE)[0])


@pytest.mark.parametrize("angle_deg", range(0, 180, 15))
def test_a_window_between_two_depths_slips_along_its_edge_and_not_on_a_corner(angle_deg):
    angle = np.radians(angle_deg)
    xy = flows(angle, across_hz=0.4, along_hz=0.1)
    assert asked(xy, edge_across(angle))
    assert not asked(xy, 0.5 * edge_across(angle))


@pytest.mark.parametrize("angle_deg", range(0, 180, 15))
def test_what_goes_along_its_edge_against_the_scene_moves_by_itself(angle_deg):
    angle = np.radians(angle_deg)
    assert not asked(flows(angle, across_hz=0.4, along_hz=-0.1), edge_across(angle))


@pytest.mark.parametrize("angle_deg", range(0, 180, 15))
def test_what_no_depth_explains_across_its_edge_moves_by_itself(angle_deg):
    angle = np.radians(angle_deg)
    assert not asked(flows(angle, across_hz=-0.4, along_hz=0.1), edge_across(angle))


def test_views_that_are_missing_say_nothing():
    xy = flows(0.3, across_hz=0.4, along_hz=0.1)
    xy[[0, 2]] = np.nan
    assert asked(xy, edge_across(0.3))


def test_nothing_slips_before_a_camera_at_rest():
    xy = flows(0.3, across_hz=0.4, along_hz=0.1)
    assert not asked(xy, edge_across(0.3), path=np.zeros_like(AHEAD))


def railing(edge):
    """Points of the railing of a bridge, which slip outwards along it by a quarter of our speed."""
    x_m = np.linspace(10.0, 18.0, 14)
    points = np.column_stack([x_m, np.full(14, -5.0), np.full(14, 60.0)])
    return Thing(points, (1.0, 0.0, 0.0), edge=edge)


def test_a_railing_along_which_windows_slip_is_no_mover():
    horizontal = (-0.9, 0.0)
    slips, moves = (
        bodies_of(world(np.random.default_rng(4), SLOWLY, N_FRAMES, railing(edge)), N_FRAMES, camera_m_s=SLOWLY)
        for edge in (horizontal, (0.0, 0.0))
    )
    assert all(not frame.mover_keys for frame in slips)
    assert moves[-1].keys_of(1)[0] != 0


def test_what_crosses_on_edges_is_found():
    """A car of which all windows are on upright edges, which its way goes across."""
    rng = np.random.default_rng(5)
    crossing = car(rng, (6.0, 0.5, 32.0), (-5.0, 0.0, 0.0), edge=(0.9, 0.0))
    frames = bodies_of(world(rng, SLOWLY, N_FRAMES, crossing), N_FRAMES, camera_m_s=SLOWLY)
    assert frames[8].keys_of(1)[0] != 0
    assert frames[8].keys_of(1)[1] > 0.8


@pytest.mark.parametrize(("platform", "yaw_rad_s"), [(Platform.vehicle, 0.0), (Platform.aircraft, 0.1)])
def test_before_a_camera_that_moves_past_nothing_what_goes_along_its_edges_is_found(platform, yaw_rad_s):
    """No surface slips past another then, whatever way is supposed for the camera."""
    rng = np.random.default_rng(0)
    leaves = car(rng, (1.0, -1.0, 25.0), (3.0, 0.0, 0.0), edge=(-0.9, 0.0))
    street = world(rng, (0.0, 0.0, 0.0), N_FRAMES, leaves)
    frames = bodies_of(street, N_FRAMES, camera_m_s=(0.0, 0.0, 0.0), platform=platform, yaw_rad_s=yaw_rad_s)
    assert frames[4].keys_of(1)[0] != 0
    assert frames[4].keys_of(1)[1] > 0.8
