"""What a camera sees while its shutter is open: motion blur, and rows that are read one after the other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np

from ttcvid.model import ImageSize, Picture
from ttcvid.simulate.world import World, build_world

N_EXPOSURES = 5
"""Pictures that a blurred one is the mean of."""
N_STRIPS = 16
"""Strips of rows that share a time: the picture jumps between them by a sixteenth of the flow within a readout."""
MARGIN_PX = 4
"""Rows drawn beyond a strip, so that the lens's blur reaches over its edges."""

Draw = Callable[[int], Picture]
"""Makes the ideal picture of a frame."""


class Shutter:
    """Pictures of a world with exposure and readout; a frame's time is the middle of both."""

    def __init__(self, world: World, drawing: Callable[[World], Draw]) -> None:
        parts_s = _parts(world.scene.picture.exposure_s)
        self._strips = [
            (n_rows, skipped, [drawing(self._moved(world, delay_s + part_s, drawn)) for part_s in parts_s])
            for n_rows, skipped, drawn, delay_s in _strips(world, world.scene.picture.readout_s)
        ]

    def picture(self, frame: int) -> Picture:
        """The picture of a frame ``(H, W, 3)``."""
        parts = []
        for n_rows, skipped, exposures in self._strips:
            sum_ = sum(draw(frame)[skipped : skipped + n_rows].astype(np.uint16) for draw in exposures)
            parts.append((np.asarray(sum_) + len(exposures) // 2) // len(exposures))
        return np.concatenate(parts).astype(np.uint8)

    @staticmethod
    def _moved(world: World, delay_s: float, drawn: tuple[int, int]) -> World:
        """The world at later times, seen by some rows of the camera alone."""
        camera = world.camera
        size = ImageSize(camera.image_size.width_px, drawn[1] - drawn[0])
        later = build_world(world.scene, world.path.t_s + delay_s)
        return replace(later, camera=replace(camera, cy_px=camera.cy_px - drawn[0], image_size=size))


def _parts(exposure_s: float) -> list[float]:
    """Times of the pictures that make up an exposure, about its middle."""
    if exposure_s == 0:
        return [0.0]
    return [((k + 0.5) / N_EXPOSURES - 0.5) * exposure_s for k in range(N_EXPOSURES)]


def _strips(world: World, readout_s: float) -> list[tuple[int, int, tuple[int, int], float]]:
    """Of each strip its rows, how many are drawn above it, first and last row drawn, and its delay."""
    height = world.camera.image_size.height_px
    if readout_s == 0:
        return [(height, 0, (0, height), 0.0)]
    edges = np.linspace(0, height, N_STRIPS + 1).round().astype(int).tolist()
    strips = []
    for low, high in pairwise(edges):
        drawn = (max(0, low - MARGIN_PX), min(height, high + MARGIN_PX))
        delay_s = ((low + high) / 2 / height - 0.5) * readout_s
        strips.append((high - low, low - drawn[0], drawn, delay_s))
    return strips
