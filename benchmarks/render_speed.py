"""Frames per second of the simulator on one core, textures included and not: bar 10 at 640x360.

python benchmarks/render_speed.py [SCENE.yaml ...]
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import cv2

from ttcvid.simulate import Renderer, build_world, load_scene

SCENES = Path(__file__).resolve().parent.parent / "sample_configs" / "scenes"


def main(paths: list[Path]) -> None:
    """Print a line for each scene: CPU time, not elapsed time, so that other processes do not count."""
    cv2.setNumThreads(1)
    print(f"{'scene':24} {'frames/s':>8} {'with painting':>14}   (CPU time, one core; python {' '.join(sys.argv)})")
    for path in paths:
        scene = load_scene(path)
        start = time.process_time()
        renderer = Renderer(build_world(scene))
        n_frames = renderer.world.n_frames
        for frame in range(n_frames):
            renderer.render(frame)
        first_pass_s = time.process_time() - start
        start = time.process_time()
        for frame in range(n_frames):
            renderer.render(frame)
        second_pass_s = time.process_time() - start
        print(f"{scene.name:24} {n_frames / second_pass_s:8.1f} {n_frames / first_pass_s:14.1f}")


if __name__ == "__main__":
    main([Path(argument) for argument in sys.argv[1:]] or sorted(SCENES.glob("*.yaml")))
