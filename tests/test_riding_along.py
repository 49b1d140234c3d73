"""What rides along with the camera fills most of its picture: bonnet, dashboard, text, reflections."""

import numpy as np
import pytest
from tables_of_points import CAMERA, FOCAL_PX, HEIGHT_PX, STILL, WIDTH_PX, Body, driving, results_of, street, table

from ttcvid.model import FrameStatus

SPEED_M_S, FPS = 12.0, 20.0


def bonnet(n=700, top=0.4, seed=3):
    """Points all over the picture below a part of its height, which keep their distance from the camera."""
    rng = np.random.default_rng(seed)
    xy_px = rng.uniform((0.0, top * HEIGHT_PX), (WIDTH_PX, HEIGHT_PX), (n, 2)) - (CAMERA.cx_px, CAMERA.cy_px)
    depth_m = rng.uniform(1.0, 2.0, n)[:, None]
    return Body(np.hstack([xy_px / FOCAL_PX * depth_m, depth_m]), driving(SPEED_M_S))


@pytest.mark.parametrize("seed", [5, 6])
def test_the_scene_is_what_flows_past_not_what_rides_along(seed):
    drive = table([street(400, seed=seed), bonnet()], driving(SPEED_M_S), n_frames=30, fps=FPS, sigma_px=0.05)
    late = results_of(drive)[25:]
    assert all(result.status == FrameStatus.ok for result in late)
    assert all(result.events == () for result in late)
    for result in late:
        scene = next(row for row in result.clusters if row.cluster_id == 0)
        assert scene.direction @ [0.0, 0.0, -1.0] > np.cos(np.radians(0.5))


def test_a_stream_of_oncoming_cars_is_no_scene():
    """From a camera at rest they flow out of one point, too, but to one side of it."""
    lane = street(500, depth_m=(8.0, 60.0), seed=7)
    stream = Body(lane.points_m[lane.points_m[:, 0] < -4.0], driving(-SPEED_M_S))
    results = results_of(table([street(200), stream], STILL, n_frames=30, fps=FPS, sigma_px=0.05))
    assert {result.status for result in results[4:]} == {FrameStatus.rotation_only}
