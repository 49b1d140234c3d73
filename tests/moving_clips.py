"""Short textured clips of known motion, for the tests of whole analyses."""

from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np

WIDTH, HEIGHT = 192, 128
FPS = 10


def texture(seed: int = 0) -> np.ndarray:
    """A picture (256, 384) full of corners."""
    noise = np.random.default_rng(seed).integers(0, 256, (64, 96), dtype=np.uint8)
    return cv2.resize(noise, (384, 256), interpolation=cv2.INTER_CUBIC)


def picture(scale: float = 1.0, shift_px: float = 0.0) -> np.ndarray:
    """The middle of the texture, magnified about the picture's centre and shifted to the right."""
    x, y = (WIDTH - 1) / 2, (HEIGHT - 1) / 2
    centre = np.array([383 / 2, 255 / 2])
    matrix = np.array([[scale, 0, x + shift_px - scale * centre[0]], [0, scale, y - scale * centre[1]]])
    return cv2.warpAffine(texture(), matrix, (WIDTH, HEIGHT), flags=cv2.INTER_LINEAR)


def approach(n: int, ttc_first_s: float = 4.0) -> list[np.ndarray]:
    """A wall that comes straight at the camera: magnification 1 / (1 - t / ttc)."""
    return [picture(1 / (1 - index / FPS / ttc_first_s)) for index in range(n)]


def swaying(n: int) -> list[np.ndarray]:
    """A wall that sways sideways for as long as one likes."""
    return [picture(shift_px=8 * np.sin(index / 5)) for index in range(n)]


def write_clip(path: Path, pictures: list[np.ndarray], key_every: int = 5) -> Path:
    """Grey pictures as H.264 at 10 frames/s, the index behind the pictures."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=FPS, options={"crf": "10", "preset": "ultrafast"})
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        stream.gop_size = key_every
        stream.codec_context.time_base = Fraction(1, FPS)
        for index, grey in enumerate(pictures):
            neutral = np.full((grey.shape[0] // 2, grey.shape[1]), 128, np.uint8)
            frame = av.VideoFrame.from_ndarray(np.vstack([grey, neutral]), format="yuv420p")
            frame.pts, frame.time_base = index, Fraction(1, FPS)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def write_audio(path: Path) -> Path:
    """A second of silence, and no picture."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("aac", rate=8000, layout="mono")
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 8000), np.float32), format="fltp", layout="mono")
        frame.sample_rate = 8000
        container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def write_frames(folder: Path, pictures: list[np.ndarray]) -> Path:
    """A folder of PNG pictures."""
    folder.mkdir(parents=True, exist_ok=True)
    for index, grey in enumerate(pictures):
        assert cv2.imwrite(str(folder / f"{index:06d}.png"), grey)
    return folder


def write_approaching_tracks(path: Path, n: int = 12, n_tracks: int = 40) -> Path:
    """A table of tracks that spread from the picture's centre."""
    rng = np.random.default_rng(1)
    start = rng.uniform(-60, 60, (n_tracks, 2))
    lines = ["frame,t_s,track_id,x_px,y_px"]
    for frame in range(n):
        xy = start / (1 - frame / FPS / 4.0) + [WIDTH / 2, HEIGHT / 2]
        for track, (x, y) in enumerate(xy):
            lines.append(f"{frame},{frame / FPS},{track},{x:.6f},{y:.6f}")
    path.write_text("\n".join(lines) + "\n")
    return path
