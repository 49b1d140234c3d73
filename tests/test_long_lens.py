"""All stages together through lenses of other lengths: what is in the picture counts, not how wide it is seen."""

import numpy as np
import pytest

from ttcvid.config import EgomotionConfig, PipelineConfig
from ttcvid.model import Camera, Frame, ImageSize, Platform, PointSet
from ttcvid.pipeline import analyze_frames

WIDTH_PX, HEIGHT_PX = 1280, 720
CONFIG = PipelineConfig(egomotion=EgomotionConfig(platform=Platform.vehicle))


def epipole_errors_px(hfov_deg):
    """How far off the scene's epipole is, px, in a drive past static points that fill the picture."""
    focal_px = WIDTH_PX / 2 / np.tan(np.radians(hfov_deg / 2))
    camera = Camera(focal_px, focal_px, (WIDTH_PX - 1) / 2, (HEIGHT_PX - 1) / 2, ImageSize(WIDTH_PX, HEIGHT_PX))
    rng = np.random.default_rng(0)
    z = 1.0 / rng.uniform(1 / 400, 1 / 40, 600)
    xy = rng.uniform(-0.5, 0.5, (600, 2)) * [WIDTH_PX, HEIGHT_PX] / focal_px * z[:, None]
    frames = []
    for index in range(14):
        xy_px = focal_px * xy / (z - 1.5 * index)[:, None] + [camera.cx_px, camera.cy_px]
        seen = ((xy_px >= 0) & (xy_px < [WIDTH_PX, HEIGHT_PX])).all(axis=1)
        xy_px += rng.normal(0.0, 0.2, xy_px.shape)
        frames.append(Frame(index, 0.1 * index, points=PointSet(np.flatnonzero(seen), xy_px[seen])))
    rows = [
        next(r for r in result.clusters if r.cluster_id == 0) for _, result in analyze_frames(frames, camera, CONFIG)
    ]
    return [focal_px * np.hypot(*(row.direction[:2] / row.direction[2])) for row in rows[4:]]


@pytest.mark.parametrize("hfov_deg", [60.0, 20.0, 8.0])
def test_a_long_lens_finds_its_epipole_in_the_picture_as_well_as_an_ordinary_one(hfov_deg):
    assert np.median(epipole_errors_px(hfov_deg)) < 4.0
