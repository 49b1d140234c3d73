"""All stages together on a camera that goes backwards: from the start, or after it went ahead and rested."""

import numpy as np
import pytest

from ttcvid.config import EgomotionConfig, PipelineConfig
from ttcvid.model import Camera, Frame, FrameStatus, ImageSize, Platform, PointSet
from ttcvid.pipeline import analyze_frames

WIDTH_PX, HEIGHT_PX, FOCAL_PX = 1280, 720, 720.0
CAMERA = Camera(FOCAL_PX, FOCAL_PX, (WIDTH_PX - 1) / 2, (HEIGHT_PX - 1) / 2, ImageSize(WIDTH_PX, HEIGHT_PX))
DT_S, SIGMA_PX, NEAREST_M = 0.1, 0.1, 4.0
# Frames after a start in which it may still be open where the camera goes.
A_FEW = 4


def ahead_rest_and_back(t_s):
    """Own speed, m/s: ahead at 5, brakes at 3 m/s^2, rests from 3.7 s to 5 s, then back at up to 3."""
    return max(0.0, 5.0 - 3.0 * max(t_s - 2.0, 0.0)) if t_s < 5.0 else -min(3.0, 2.0 * (t_s - 5.0))


def drive(speed_m_s, duration_s):
    """Frames of noisy tracks of static points as a camera passes them along its axis at ``speed_m_s(t_s)``."""
    rng = np.random.default_rng(1)
    z = 1.0 / rng.uniform(1 / 80, 1 / 8, 600)
    xy = rng.uniform(-0.5, 0.5, (600, 2)) * [WIDTH_PX, HEIGHT_PX] / FOCAL_PX * z[:, None]
    steps_s = np.arange(0.0, duration_s, 0.001)
    way_m = np.concatenate([[0.0], np.cumsum([speed_m_s(t) for t in steps_s]) * 0.001])
    frames = []
    for index, at in enumerate(range(0, len(steps_s), 100)):
        depth = z - way_m[at]
        with np.errstate(divide="ignore"):
            xy_px = FOCAL_PX * xy / depth[:, None] + [CAMERA.cx_px, CAMERA.cy_px]
        seen = (depth > NEAREST_M) & ((xy_px >= 0) & (xy_px < [WIDTH_PX, HEIGHT_PX])).all(axis=1)
        xy_px += rng.normal(0.0, SIGMA_PX, xy_px.shape)
        frames.append(Frame(index, index * DT_S, points=PointSet(np.flatnonzero(seen), xy_px[seen])))
    return frames


def results_of(frames, platform):
    config = PipelineConfig(egomotion=EgomotionConfig(platform=platform))
    return [result for _, result in analyze_frames(frames, CAMERA, config)]


def direction_z(result):
    scene = next(row for row in result.clusters if row.cluster_id == 0)
    return None if scene.direction is None else scene.direction[2]


def assert_goes_back(results):
    for result in results:
        assert result.status == FrameStatus.ok
        assert direction_z(result) > 0.99
        assert [row.cluster_id for row in result.clusters] == [0]
        assert result.events == ()
        assert (result.tracks.cluster_id == 0).mean() > 0.9
        told = np.isfinite(result.tracks.times.ttc_z_s)
        assert told.mean() > 0.5
        assert (result.tracks.times.ttc_z_s[told] < 0).mean() > 0.95


@pytest.mark.parametrize("platform", [Platform.vehicle, Platform.free])
def test_a_car_that_backs_out_after_a_rest_sees_a_static_scene_recede(platform):
    results = results_of(drive(ahead_rest_and_back, 8.0), platform)
    assert direction_z(results[15]) < -0.99
    assert [result.status for result in results[45:50]] == [FrameStatus.rotation_only] * 5
    assert_goes_back(results[51 + A_FEW :])


def test_a_camera_that_looks_back_sees_a_static_scene_recede_from_the_first_frames_on():
    assert_goes_back(results_of(drive(lambda t_s: -5.0, 2.0), Platform.vehicle)[A_FEW:])
