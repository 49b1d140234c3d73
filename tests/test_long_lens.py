"""All stages together through lenses of other lengths: what is in the picture counts, not how wide it is seen."""

import numpy as np
import pytest

from ttcvid.config import EgomotionConfig, PipelineConfig
from ttcvid.model import Camera, Frame, ImageSize, Platform, PointSet
from ttcvid.pipeline import analyze_frames

WIDTH_PX, HEIGHT_PX = 1280, 720
CONFIG = PipelineConfig(egomotion=EgomotionConfig(platform=Platform.vehicle))


def camera_of(hfov_deg):
    focal_px = WIDTH_PX / 2 / np.tan(np.radians(hfov_deg / 2))
    size = ImageSize(WIDTH_PX, HEIGHT_PX)
    return Camera(focal_px, focal_px, (WIDTH_PX - 1) / 2, (HEIGHT_PX - 1) / 2, size, origin="focal_px")


def places_m(camera, rng, n, left, right, depth_m):
    """Points (N, 3) in the part of the picture from `left` to `right`, as many at each inverse depth."""
    z = 1.0 / rng.uniform(1 / depth_m[1], 1 / depth_m[0], n)
    part = np.column_stack([rng.uniform(left, right, n), rng.uniform(-0.5, 0.5, n)])
    return np.column_stack([part * [WIDTH_PX, HEIGHT_PX] / camera.fx_px * z[:, None], z])


def results_of(camera, rng, n_frames, *things):
    """Results of the noisy tracks of things: points (N, 3) at the start and their step relative to the camera, m."""
    frames = []
    for index in range(n_frames):
        points = np.concatenate([points_m + np.multiply(step_m, index) for points_m, step_m in things])
        xy_px = camera.fx_px * points[:, :2] / points[:, 2:] + [camera.cx_px, camera.cy_px]
        seen = ((xy_px >= 0) & (xy_px < [WIDTH_PX, HEIGHT_PX])).all(axis=1)
        xy_px += rng.normal(0.0, 0.2, xy_px.shape)
        frames.append(Frame(index, 0.1 * index, points=PointSet(np.flatnonzero(seen), xy_px[seen])))
    return [result for _, result in analyze_frames(frames, camera, CONFIG)]


@pytest.mark.parametrize("hfov_deg", [60.0, 20.0, 8.0])
def test_a_long_lens_finds_its_epipole_in_the_picture_as_well_as_an_ordinary_one(hfov_deg):
    camera, rng = camera_of(hfov_deg), np.random.default_rng(0)
    street = places_m(camera, rng, 600, -0.5, 0.5, (40.0, 400.0))
    results = results_of(camera, rng, 14, (street, (0.0, 0.0, -1.5)))
    scenes = [next(row for row in result.clusters if row.cluster_id == 0) for result in results[4:]]
    off_px = [camera.fx_px * np.hypot(*(row.direction[:2] / row.direction[2])) for row in scenes]
    assert np.median(off_px) < 4.0


def test_a_textured_lorry_is_not_the_world_through_a_long_lens():
    """It has three of five tracks, in a sixth of the picture, and goes ahead of us, a little slower and aside."""
    camera, rng = camera_of(8.0), np.random.default_rng(1)
    street = places_m(camera, rng, 250, -0.5, 0.5, (165.0, 1650.0))
    lorry = places_m(camera, rng, 400, 0.05, 0.4, (206.0, 222.0)) * [1.0, 0.5, 1.0]
    last = results_of(camera, rng, 13, (street, (0.0, 0.0, -4.1)), (lorry, (-0.1, 0.0, -0.8)))[-1]
    of_lorry = last.tracks.track_id >= 250
    assert (last.tracks.cluster_id[of_lorry] == 0).mean() < 0.05
    assert (last.tracks.cluster_id[~of_lorry] == 0).mean() > 0.95
