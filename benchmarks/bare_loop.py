"""The least that any such program does: decode, follow points, draw their flow, encode, one after the other.

python benchmarks/bare_loop.py CLIP OUT.mp4 --tracker klt|akaze

The reference for the speed of ``ttcvid analyze``: PyAV and OpenCV as their documentation uses them, each picture
finished before the next one is begun. OpenCV has its own threads; decoder and encoder have one each, the loop's. No
geometry, no tables, no check of the flow. Grey is the decoded luma plane itself, the cheapest there is.
Prints one JSON object: frames, seconds from opening the clip to closing the video, median number of points.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable
from fractions import Fraction

import av
import cv2
import numpy as np

MAX_POINTS, QUALITY, MIN_DISTANCE_PX = 2000, 0.005, 7
"""Of goodFeaturesToTrack: the quality and distance that ``ttcvid`` has as defaults."""
TOP_UP_FRAMES = 5
"""New corners every so many frames, as in OpenCV's own Lucas-Kanade sample."""
WINDOW_PX, PYRAMID_LEVELS = 15, 3
RATIO = 0.8
PRESET, CRF = "veryfast", "23"
GREEN = (0, 255, 0)

Follow = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""From a grey picture to the two ends (N, 2) of each flow line, px; what was before is remembered inside."""


def follow_by_klt() -> Follow:
    """Corners followed by pyramidal Lucas-Kanade, forth only, and topped up."""
    last, points, n_frames = None, np.empty((0, 1, 2), np.float32), 0

    def follow(grey: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        nonlocal last, points, n_frames
        before = after = np.empty((0, 1, 2), np.float32)
        if last is not None and len(points):
            after, status, _ = cv2.calcOpticalFlowPyrLK(
                last, grey, points, None, winSize=(WINDOW_PX, WINDOW_PX), maxLevel=PYRAMID_LEVELS
            )
            found = status.ravel() > 0
            before, after = points[found], after[found]
        points = _topped_up(grey, after) if n_frames % TOP_UP_FRAMES == 0 else after
        last, n_frames = grey, n_frames + 1
        return before[:, 0], after[:, 0]

    return follow


def _topped_up(grey: np.ndarray, points: np.ndarray) -> np.ndarray:
    n_missing = MAX_POINTS - len(points)
    if n_missing <= 0:
        return points
    allowed = np.full_like(grey, 255)
    for x, y in np.rint(points[:, 0]).astype(int).tolist():
        cv2.circle(allowed, (x, y), MIN_DISTANCE_PX, 0, -1)
    new = cv2.goodFeaturesToTrack(grey, n_missing, QUALITY, MIN_DISTANCE_PX, mask=allowed)
    return points if new is None else np.concatenate([points, new])


def follow_by_akaze() -> Follow:
    """AKAZE features of each picture, matched to those of the one before by the ratio of the two nearest."""
    detector, matcher = cv2.AKAZE.create(), cv2.BFMatcher(cv2.NORM_HAMMING)
    last_xy, last_descriptors = np.empty((0, 2), np.float32), None

    def follow(grey: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        nonlocal last_xy, last_descriptors
        keypoints, descriptors = detector.detectAndCompute(grey, None)
        xy = cv2.KeyPoint.convert(keypoints).reshape(-1, 2)
        before = after = np.empty((0, 2), np.float32)
        if last_descriptors is not None and descriptors is not None:
            pairs = [pair for pair in matcher.knnMatch(last_descriptors, descriptors, k=2) if len(pair) == 2]
            good = [first for first, second in pairs if first.distance < RATIO * second.distance]
            before = last_xy[[match.queryIdx for match in good]]
            after = xy[[match.trainIdx for match in good]]
        last_xy, last_descriptors = xy, descriptors
        return before, after

    return follow


def luma(picture: av.VideoFrame) -> np.ndarray:
    """The luma plane of a decoded picture, without a copy where lines need no padding."""
    plane = picture.planes[0]
    lines = np.frombuffer(plane, np.uint8).reshape(plane.height, plane.line_size)
    return np.ascontiguousarray(lines[:, : plane.width])


def _with_even_sides(bgr: np.ndarray) -> np.ndarray:
    height, width = bgr.shape[:2]
    if height % 2 == 0 and width % 2 == 0:
        return bgr
    return cv2.copyMakeBorder(bgr, 0, height % 2, 0, width % 2, cv2.BORDER_REPLICATE)


def run(clip: str, out: str, follow: Follow) -> dict[str, float]:
    """Decode, follow, draw, encode; returns frames, seconds and the median number of flow lines."""
    n_lines = []
    start_s = time.perf_counter()
    with av.open(clip) as source, av.open(out, "w", format="mp4") as target:
        video = source.streams.video[0]
        video.codec_context.thread_count = 1
        options = {"preset": PRESET, "crf": CRF}
        stream = target.add_stream("libx264", rate=video.average_rate or Fraction(25), options=options)
        stream.width, stream.height = video.width + video.width % 2, video.height + video.height % 2
        stream.pix_fmt = "yuv420p"
        stream.codec_context.thread_count = 1
        for picture in source.decode(video):
            before, after = follow(luma(picture))
            bgr = picture.to_ndarray(format="bgr24")
            lines = np.rint(np.stack([before, after], axis=1)).astype(np.int32)
            cv2.polylines(bgr, list(lines), False, GREEN, 1)
            bgr = _with_even_sides(bgr)
            target.mux(stream.encode(av.VideoFrame.from_ndarray(bgr, format="bgr24")))
            n_lines.append(len(lines))
        target.mux(stream.encode(None))
    loop_s = time.perf_counter() - start_s
    return {"frames": len(n_lines), "loop_s": loop_s, "median_points": statistics.median(n_lines[1:])}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clip")
    parser.add_argument("out")
    parser.add_argument("--tracker", choices=("klt", "akaze"), default="klt")
    arguments = parser.parse_args()
    follow_points = follow_by_klt() if arguments.tracker == "klt" else follow_by_akaze()
    print(json.dumps(run(arguments.clip, arguments.out, follow_points)))
