"""Where the content of a Lucas-Kanade window lies, and that tracks stand there."""

import cv2
import numpy as np
from wave_pictures import HEIGHT, WIDTH, Warp, wave_picture

from ttcvid.config import TrackingConfig
from ttcvid.stages.tracking.content import content_offsets
from ttcvid.stages.tracking.klt import follow_klt, start_klt

SIZE = (120, 160)


def test_content_lies_at_the_only_corner_wherever_the_window_stands():
    grey = np.full(SIZE, 100, np.uint8)
    grey[60, 80] = 200
    at = np.array([[80.0, 60.0], [84.0, 57.0], [76.0, 63.0]])
    np.testing.assert_allclose(at + content_offsets(grey, at, 13), [[80.0, 60.0]] * 3, atol=1e-6)


def test_a_window_between_pixels_has_its_content_where_its_neighbours_have_it():
    grey = cv2.GaussianBlur(np.random.default_rng(4).uniform(0, 255, SIZE).astype(np.float32), (0, 0), 2.0)
    grey = cv2.normalize(grey, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    offset = content_offsets(grey, np.column_stack([np.linspace(70.0, 71.0, 5), np.full(5, 60.3)]), 13)
    assert np.abs(np.diff(offset, axis=0)).max() < 0.5


def test_a_window_without_a_corner_has_no_content():
    grey = np.full(SIZE, 100, np.uint8)
    grey[:, 80:] = 200  # an edge
    assert np.isnan(content_offsets(grey, np.array([[80.0, 60.0], [20.0, 60.0]]), 13)).all()


def test_no_points_have_no_content():
    assert content_offsets(np.zeros(SIZE, np.uint8), np.empty((0, 2)), 9).shape == (0, 2)


def test_what_lucas_kanade_follows_expands_about_the_content_not_about_the_window():
    """A texture that grows by 6 % about a fixed point: its step is that of where the content lies."""
    rng = np.random.default_rng(3)
    one = cv2.GaussianBlur(rng.uniform(0, 255, SIZE).astype(np.float32), (0, 0), 2.0)
    one = cv2.normalize(one, None, 0, 255, cv2.NORM_MINMAX)
    fixed, scale = np.array([80.0, 60.0]), 1.06
    matrix = np.array([[scale, 0, fixed[0] * (1 - scale)], [0, scale, fixed[1] * (1 - scale)]])
    other = cv2.warpAffine(one, matrix, SIZE[::-1], flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    one, other = one.astype(np.uint8), other.astype(np.uint8)
    at = rng.uniform([30, 30], [130, 90], (60, 2))
    to, status, _ = cv2.calcOpticalFlowPyrLK(one, other, at.astype(np.float32), None, winSize=(21, 21), maxLevel=2)
    ok = status.ravel() > 0
    step = to[ok] - at[ok]
    by_content = (at[ok] + content_offsets(one, at, 21)[ok] - fixed) * (scale - 1)
    by_window = (at[ok] - fixed) * (scale - 1)
    good, naive = (np.sqrt(np.nanmean(np.sum((step - expected) ** 2, axis=1))) for expected in (by_content, by_window))
    assert good < 0.03
    assert naive > 5.0 * good


def test_tracks_on_what_comes_nearer_stay_with_their_surface():
    """A texture that grows by 1.5 % a frame for 12 frames: where the tracks stand, they drift half as far."""
    config = TrackingConfig(max_tracks=200)
    warps = [Warp(scale=1.015**k) for k in range(13)]
    memory = start_klt(wave_picture(warps[0]), None, config)
    first = memory.points
    for warp in warps[1:]:
        memory, _ = follow_klt(memory, wave_picture(warp), None, config)
    last = memory.points
    _, one, other = np.intersect1d(first.track_id, last.track_id, return_indices=True)
    assert len(one) > 80
    assert (last.xy_px >= 0).all()
    assert (last.xy_px <= [WIDTH - 1, HEIGHT - 1]).all()

    def drift_px(begun: np.ndarray, ended: np.ndarray) -> float:
        return float(np.median(np.linalg.norm(ended[other] - warps[-1].to_picture(begun[one]), axis=1)))

    by_content = drift_px(first.xy_px, last.xy_px)
    by_window = drift_px(first.windows_px, last.windows_px)
    assert by_content < 0.5 * by_window, (by_content, by_window)
