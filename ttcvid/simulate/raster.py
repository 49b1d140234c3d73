"""Drawing planes and rectangles into a picture with depth: one ray per sample, nearest surface wins.

With the ray d = (x, y, 1) of a sample and a plane n . P = c, the inverse depth (n . d) / c and, times that, the
place on the plane are linear in x and y: a surface costs a few multiplications per sample, lens distortion nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ttcvid.geometry.camera.pinhole import rays_from_pixels
from ttcvid.model import Bools, Camera, Floats, Picture
from ttcvid.simulate.ripmap import Float32s
from ttcvid.simulate.world import SKY_LABEL

NEAR_M = 0.05
"""What is nearer than this to the picture plane is not drawn."""
FAR_M = 1e5
BLOCK_SAMPLES = 16
"""Side of the blocks of samples whose ray bounds tell which part of the picture a surface can touch."""
EDGE_ON_M = 1e-4
"""A surface whose plane passes the camera at less than this is seen edge-on: nothing is seen of it."""

Window = tuple[slice, slice]


@dataclass(frozen=True)
class Plane:
    """Linear forms (3,) of a surface in the camera: inverse depth, and u and v times inverse depth."""

    inverse_depth: Floats
    u: Floats
    v: Floats


def plane_of(origin_m: Floats, along_u: Floats, along_v: Floats, normal: Floats) -> Plane | None:
    """The plane through ``origin_m`` with unit vectors along it and ``normal`` = u x v, all (3,) in the camera.

    None where the plane is seen edge-on or from the side that the normal points to.
    """
    distance = float(normal @ origin_m)
    if distance < EDGE_ON_M:
        return None
    inverse_depth = normal / distance
    return Plane(
        inverse_depth,
        along_u - (along_u @ origin_m) * inverse_depth,
        along_v - (along_v @ origin_m) * inverse_depth,
    )


class Samples:
    """The rays of all samples of a camera, ``supersampling`` per pixel and axis."""

    def __init__(self, camera: Camera, supersampling: int) -> None:
        width, height = camera.image_size.width_px, camera.image_size.height_px
        self.shape = (height * supersampling, width * supersampling)
        x = (np.arange(self.shape[1]) + 0.5) / supersampling - 0.5
        y = (np.arange(self.shape[0]) + 0.5) / supersampling - 0.5
        grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        rays = rays_from_pixels(camera, grid)[:, :2].reshape(*self.shape, 2)
        if camera.distortion_model == "none":
            self._x, self._y = rays[:1, :, 0].astype(np.float32), rays[:, :1, 1].astype(np.float32)
        else:
            self._x, self._y = rays[:, :, 0].astype(np.float32), rays[:, :, 1].astype(np.float32)
        self._row_starts = np.arange(0, self.shape[0], BLOCK_SAMPLES)
        self._column_starts = np.arange(0, self.shape[1], BLOCK_SAMPLES)
        self._block_low = [self._blocks(rays[:, :, axis], np.minimum) for axis in (0, 1)]
        self._block_high = [self._blocks(rays[:, :, axis], np.maximum) for axis in (0, 1)]

    def linear(self, form: Floats, window: Window) -> Float32s:
        """Value ``(H, W)`` of a linear form of the rays (x, y, 1) in a window."""
        a, b, c = form.astype(np.float32)
        x = self._x[window] if self._x.shape[0] > 1 else self._x[:, window[1]]
        y = self._y[window] if self._y.shape[1] > 1 else self._y[window[0]]
        return np.asarray((a * x + c) + b * y, dtype=np.float32)

    def window_of(self, corners_m: Floats) -> Window | None:
        """Window that holds what can be seen of a polygon ``(N, 3)`` in the camera; None where nothing can."""
        polygon = _clip_near(corners_m)
        if len(polygon) == 0:
            return None
        rays = polygon[:, :2] / polygon[:, 2:]
        touched = np.ones_like(self._block_low[0], bool)
        for low, high, ray in zip(self._block_low, self._block_high, rays.T, strict=True):
            touched &= low <= ray.max()
            touched &= high >= ray.min()
        rows, columns = np.flatnonzero(touched.any(axis=1)), np.flatnonzero(touched.any(axis=0))
        if len(rows) == 0:
            return None
        return (
            slice(int(self._row_starts[rows[0]]), min(int(self._row_starts[rows[-1]]) + BLOCK_SAMPLES, self.shape[0])),
            slice(
                int(self._column_starts[columns[0]]),
                min(int(self._column_starts[columns[-1]]) + BLOCK_SAMPLES, self.shape[1]),
            ),
        )

    def _blocks(self, rays: Floats, bound: np.ufunc) -> Floats:
        return np.asarray(bound.reduceat(bound.reduceat(rays, self._row_starts, axis=0), self._column_starts, axis=1))


class Canvas:
    """A picture being drawn: colours ``(H, W, 3)``, inverse depths and labels ``(H, W)`` of all samples."""

    def __init__(self, background: Picture) -> None:
        self.bgr = background
        self.inverse_depth = np.full(background.shape[:2], 1 / FAR_M, np.float32)
        self.labels = np.full(background.shape[:2], SKY_LABEL, np.uint16)

    def draw(self, window: Window, mask: Bools, bgr: Picture, inverse_depth: Float32s, label: int) -> None:
        """Draw the samples of a window that ``mask`` names; the caller has compared the depths."""
        cv2.copyTo(bgr, mask.view(np.uint8), self.bgr[window])
        np.copyto(self.inverse_depth[window], inverse_depth, where=mask)
        np.copyto(self.labels[window], np.uint16(label), where=mask)


@dataclass(frozen=True)
class Outline:
    """The samples ``covered (H, W)`` of a window that a body would show if nothing stood before it."""

    window: Window
    covered: Bools


def bounds_of(mask: Bools, window: Window) -> tuple[Window, Window] | None:
    """Bounds of the true samples ``(H, W)`` of a window, in the window and in the whole picture; None: there are none.

    One sample more to the right and below, where there is one: a texture's footprint is a difference of neighbours.
    """
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if len(rows) == 0:
        return None
    top, bottom = int(rows[0]), min(int(rows[-1]) + 2, mask.shape[0])
    left, right = int(columns[0]), min(int(columns[-1]) + 2, mask.shape[1])
    first_row, first_column = window[0].start, window[1].start
    return (slice(top, bottom), slice(left, right)), (
        slice(first_row + top, first_row + bottom),
        slice(first_column + left, first_column + right),
    )


def outline_of(drawn: list[tuple[Window, Bools]]) -> Outline:
    """The outline of a body from the samples that each of its faces covers in its window."""
    top, left = (min(window[axis].start for window, _ in drawn) for axis in (0, 1))
    bottom, right = (max(window[axis].stop for window, _ in drawn) for axis in (0, 1))
    covered = np.zeros((bottom - top, right - left), bool)
    for (rows, columns), mask in drawn:
        covered[rows.start - top : rows.stop - top, columns.start - left : columns.stop - left] |= mask
    return Outline((slice(top, bottom), slice(left, right)), covered)


def _clip_near(corners_m: Floats) -> Floats:
    """The part of a polygon ``(N, 3)`` that lies beyond ``NEAR_M``."""
    is_near = corners_m[:, 2] < NEAR_M
    if is_near.all():
        return corners_m[:0]
    if not is_near.any():
        return corners_m
    kept: list[Floats] = []
    for here, after in zip(corners_m, np.roll(corners_m, -1, axis=0), strict=True):
        if here[2] >= NEAR_M:
            kept.append(here)
        if (here[2] >= NEAR_M) != (after[2] >= NEAR_M):
            part = (NEAR_M - here[2]) / (after[2] - here[2])
            kept.append(here + part * (after - here))
    return np.array(kept).reshape(-1, 3)
