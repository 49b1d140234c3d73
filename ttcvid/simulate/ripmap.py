"""Textures that can be looked up at any distance and slant without shimmer.

A ripmap holds a picture reduced by 2^i in one direction and by 2^j in the other, for all i and j, so that a road
seen at a grazing angle is averaged along the road only. All reductions lie in one atlas: one lookup per sample.
Williams, "Pyramidal Parametrics" (1983), extended to two directions.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from ttcvid.model import Bools, Picture

Float32s = NDArray[np.float32]
GUTTER_TEXELS = 1
"""Border around each reduction that bilinear lookup reaches into."""
SHARPNESS = np.float32(1.2)
"""A reduction is taken up to this many texels per sample; the samples of a pixel are averaged afterwards."""
OPAQUE = 128


class Ripmap:
    """A picture of ``size_m`` (u to the right, v down), repeated in both directions where ``wraps``.

    ``picture`` (H, W, 3) BGR or (H, W, 4) with opacity.
    """

    def __init__(self, picture: Picture, size_m: tuple[float, float], *, wraps: bool) -> None:
        height, width = picture.shape[:2]
        self.size_m = size_m
        self.wraps = wraps
        self._texels = (width, height)
        self._u_size, self._u_start = _reductions(width)
        self._v_size, self._v_start = _reductions(height)
        atlas = self._fill_atlas(picture)
        self._bgr = np.ascontiguousarray(atlas[:, :, :3])
        self._opacity = np.ascontiguousarray(atlas[:, :, 3]) if picture.shape[2] == 4 else None

    def sample(self, u_m: Float32s, v_m: Float32s) -> tuple[Picture, Bools | None]:
        """Colours ``(H, W, 3)`` at a grid of texture coordinates ``(H, W)``, and where it is opaque (None: all over).

        The footprint of a sample is the difference to its neighbours in the grid.
        """
        map_x = self._atlas_coordinate(u_m, 0, self._u_size, self._u_start)
        map_y = self._atlas_coordinate(v_m, 1, self._v_size, self._v_start)
        bgr = cv2.remap(self._bgr, map_x, map_y, cv2.INTER_LINEAR)
        if self._opacity is None:
            return np.asarray(bgr), None
        return np.asarray(bgr), np.asarray(cv2.remap(self._opacity, map_x, map_y, cv2.INTER_LINEAR)) >= OPAQUE

    def _atlas_coordinate(self, at_m: Float32s, axis: int, sizes: Float32s, starts: Float32s) -> Float32s:
        part = at_m * np.float32(1 / self.size_m[axis])
        level = _level(_footprint(part, self.wraps) * np.float32(self._texels[axis]) / SHARPNESS, len(sizes))
        if self.wraps:
            part -= np.floor(part)
        else:
            np.clip(part, 0, 1, out=part)
        least, most = int(level.min()), int(level.max())
        if least == most:  # usual for small faces, and three times as fast
            part *= sizes[least]
            part += starts[least]
        else:
            part *= sizes.take(level)
            part += starts.take(level)
        return part

    def _fill_atlas(self, picture: Picture) -> Picture:
        last_u, last_v = len(self._u_size) - 1, len(self._v_size) - 1
        width = int(self._u_start[last_u] + self._u_size[last_u] + GUTTER_TEXELS + 1)
        height = int(self._v_start[last_v] + self._v_size[last_v] + GUTTER_TEXELS + 1)
        atlas = np.zeros((height, width, picture.shape[2]), np.uint8)
        border = cv2.BORDER_WRAP if self.wraps else cv2.BORDER_REPLICATE
        for v_size, v_start in zip(self._v_size, self._v_start, strict=True):
            flat = cv2.resize(picture, (self._texels[0], int(v_size)), interpolation=cv2.INTER_AREA)
            for u_size, u_start in zip(self._u_size, self._u_start, strict=True):
                size = (int(u_size), int(v_size))
                reduced = cv2.resize(flat, size, interpolation=cv2.INTER_AREA)
                framed = cv2.copyMakeBorder(reduced, *(GUTTER_TEXELS,) * 4, border)
                top, left = int(v_start + 0.5) - GUTTER_TEXELS, int(u_start + 0.5) - GUTTER_TEXELS
                atlas[top : top + framed.shape[0], left : left + framed.shape[1]] = framed
        return atlas


def _reductions(texels: int) -> tuple[Float32s, Float32s]:
    """Sizes of the reductions and where their coordinate 0 (the outer edge of the first texel) lies in the atlas."""
    sizes = [texels]
    while sizes[-1] > 1:
        sizes.append((sizes[-1] + 1) // 2)
    firsts = np.cumsum([GUTTER_TEXELS, *(size + 2 * GUTTER_TEXELS for size in sizes[:-1])])
    return np.array(sizes, np.float32), (firsts - 0.5).astype(np.float32)


def _footprint(part: Float32s, wraps: bool) -> Float32s:
    """Largest difference ``(H, W)`` of a coordinate to the next sample to the right or below."""
    footprint = np.zeros_like(part)
    for step, nearest in (
        (part[:, 1:] - part[:, :-1], footprint[:, :-1]),
        (part[1:] - part[:-1], footprint[:-1]),
    ):
        if wraps:
            step -= np.rint(step)
        np.abs(step, out=step)
        np.maximum(nearest, step, out=nearest)
    if min(part.shape) > 1:
        footprint[:, -1] = footprint[:, -2]
        footprint[-1] = footprint[-2]
    return footprint


def _level(texels_per_sample: Float32s, n_levels: int) -> NDArray[np.int32]:
    """Reduction to use: the exponent of the footprint, rounded up."""
    exponent: NDArray[np.int32] = (texels_per_sample.view(np.int32) >> 23) - np.int32(126)
    return np.clip(exponent, 0, n_levels - 1, out=exponent)
