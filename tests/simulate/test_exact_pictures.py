"""Rendered pictures against the analytic paths of their points, to hundredths of a pixel."""

from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from ttcvid.geometry.camera.pinhole import pixels_from_rays, rays_from_pixels
from ttcvid.simulate import Renderer, Scene, build_world
from ttcvid.simulate.casting import NOTHING, cast, face_stack, points_in_camera

SCENES = Path(__file__).resolve().parents[2] / "sample_configs" / "scenes"
DISTORTION = {"distortion_model": "plumb_bob", "distortion": [-0.25, 0.06, 0.001, -0.0005, 0.0]}
pytestmark = pytest.mark.slow
STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.001)


CLIPS = {
    "demo": ("demo", 60, {}),
    "swinging, bent lens": ("swinging_drive", 40, DISTORTION),
    "turning": ("turning_jitter", 40, {}),
}
MOST_TREES, MOST_OTHERS = 2, 4
"""So many bodies of a row: to paint one takes longer than to draw it in all pictures."""
WINDOW = (slice(110, 300), slice(120, 560))
"""Part of the picture in which every pixel is followed: casting all of them takes long."""


@cache
def grey_pictures(clip):
    """World, first frame and four pictures of a clip."""
    name, first, camera = CLIPS[clip]
    content = yaml.safe_load((SCENES / f"{name}.yaml").read_text())
    content["camera"].update(camera)
    content["picture"] = {"noise_grey": 0.5}
    for body in content["bodies"]:
        if "repeat" in body:
            most = MOST_TREES if body["kind"] == "tree" else MOST_OTHERS
            body["repeat"]["count"] = min(body["repeat"]["count"], most)
    world = build_world(Scene.model_validate(content))
    renderer = Renderer(world)
    grey = [cv2.cvtColor(renderer.render(frame).bgr, cv2.COLOR_BGR2GRAY) for frame in range(first, first + 4)]
    return world, first, grey


def follow(before, after, xy_px):
    """KLT with a forward-backward check: places, and which of them to believe."""
    there, found, _ = cv2.calcOpticalFlowPyrLK(before, after, xy_px, None, winSize=(9, 9), maxLevel=3, criteria=STOP)
    back, found_back, _ = cv2.calcOpticalFlowPyrLK(
        after, before, there, None, winSize=(9, 9), maxLevel=3, criteria=STOP
    )
    good = (found[:, 0] > 0) & (found_back[:, 0] > 0) & (np.hypot(*(back - xy_px).T) < 0.5)
    return there, good


@pytest.mark.parametrize("clip", CLIPS)
def test_corner_followed_by_klt_lies_on_its_true_path(clip):
    world, first, pictures = grey_pictures(clip)
    xy = cv2.goodFeaturesToTrack(pictures[0], 1500, 0.005, 5).reshape(-1, 2)
    hit = cast(face_stack(world, first), rays_from_pixels(world.camera, xy.astype(float)))
    alive = hit.actor != NOTHING
    # A window shifts as a whole; near the camera it grows too, and the tracker's error adds up from frame to frame.
    is_far = hit.depth_m > 20
    for step, kept in ((1, hit.depth_m > 0), (2, is_far), (3, is_far)):
        xy, good = follow(pictures[step - 1], pictures[step], xy)
        alive &= good
        true_xy = np.full((len(xy), 2), np.nan)
        seen = hit.actor != NOTHING
        points = points_in_camera(face_stack(world, first + step), hit.actor[seen], hit.place_m[seen])
        true_xy[seen] = pixels_from_rays(world.camera, points)
        error = np.hypot(*(xy - true_xy).T)[alive & kept & np.isfinite(true_xy[:, 0])]
        assert len(error) > 300
        assert np.median(error) < 0.15


@pytest.mark.parametrize("clip", CLIPS)
def test_picture_warped_by_the_exact_motion_is_the_next_picture(clip):
    world, first, (before, after, *_) = grey_pictures(clip)
    rows, columns = np.mgrid[WINDOW]
    pixels = np.stack([columns, rows], axis=-1).reshape(-1, 2).astype(float)
    hit = cast(face_stack(world, first + 1), rays_from_pixels(world.camera, pixels))
    seen = hit.actor != NOTHING
    source = np.full((len(pixels), 2), -100.0)
    source[seen] = pixels_from_rays(
        world.camera, points_in_camera(face_stack(world, first), hit.actor[seen], hit.place_m[seen])
    )
    source = np.nan_to_num(source, nan=-100.0).reshape(*rows.shape, 2).astype(np.float32)
    warped = cv2.remap(before, source, None, cv2.INTER_CUBIC)
    after = np.ascontiguousarray(after[WINDOW])
    corners = cv2.goodFeaturesToTrack(warped, 600, 0.01, 5).reshape(-1, 2)
    moved, _, _ = cv2.calcOpticalFlowPyrLK(warped, after, corners, None, winSize=(9, 9), maxLevel=0, criteria=STOP)
    residual = moved - corners
    assert len(residual) > 200
    assert np.median(np.hypot(*residual.T)) < 0.09
    assert np.all(np.abs(np.median(residual, axis=0)) < 0.03)
