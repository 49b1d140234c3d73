"""Decoded video frames as upright pictures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from av.sidedata.sidedata import Type as SideDataType
from av.video.format import VideoFormat
from av.video.frame import VideoFrame

from ttcvid.model import ImageSize, Picture

CONVERSION_THREADS = 1
"""More of them are slower on small pictures, and gave other pixels in 1 of 150 runs (PyAV 18, gray16le)."""


@dataclass(frozen=True)
class Orientation:
    """How a stored picture is brought upright: transposed first, then turned over along its rows and columns."""

    transposed: bool = False
    flip_y: bool = False
    flip_x: bool = False
    is_exact: bool = True

    @classmethod
    def of(cls, frame: VideoFrame) -> Orientation:
        """The orientation that the frame's display matrix asks for.

        The matrix maps a stored pixel (p, q) to the shown one (a p + c q, b p + d q), y down. An angle that is no
        multiple of 90 deg is rounded to the nearest one and ``is_exact`` is False.
        """
        side_data: Any = frame.side_data  # PyAV's stub mistakes it for packet data
        matrix = next((data for data in side_data if data.type == SideDataType.DISPLAYMATRIX), None)
        if matrix is None:
            return cls()
        (a, b), (c, d) = np.frombuffer(memoryview(matrix), dtype=np.int32).reshape(3, 3)[:2, :2].astype(np.int64)
        if abs(b) + abs(c) > abs(a) + abs(d):
            return cls(True, flip_y=bool(b < 0), flip_x=bool(c < 0), is_exact=bool(a == 0 and d == 0))
        return cls(False, flip_y=bool(d < 0), flip_x=bool(a < 0), is_exact=bool(b == 0 and c == 0))

    def upright(self, picture: Picture) -> Picture:
        """The picture (H, W) or (H, W, 3) as it is to be seen, contiguous."""
        if self.transposed:
            picture = picture.swapaxes(0, 1)
        if self.flip_y:
            picture = picture[::-1]
        if self.flip_x:
            picture = picture[:, ::-1]
        return np.ascontiguousarray(picture)

    def size(self, frame: VideoFrame) -> ImageSize:
        """Width and height of the upright picture."""
        return ImageSize(frame.height, frame.width) if self.transposed else ImageSize(frame.width, frame.height)


def grey_picture(frame: VideoFrame) -> Picture:
    """The frame's brightness (H, W) uint8, a copy that leaves the decoder's buffer alone.

    8-bit luma is taken as it is stored (limited range too); deeper, packed and RGB formats are converted.
    """
    if not has_luma_plane(frame.format):
        frame = frame.reformat(format="gray", threads=CONVERSION_THREADS)
    plane = frame.planes[0]
    rows: Picture = np.frombuffer(memoryview(plane), dtype=np.uint8).reshape(-1, plane.line_size)
    return rows[: frame.height, : frame.width].copy()


def has_luma_plane(pixel_format: VideoFormat) -> bool:
    """Whether the first plane of a pixel format is 8-bit luma and nothing else."""
    first, *others = pixel_format.components
    alone = all(component.plane != first.plane for component in others)
    return bool(first.is_luma and first.plane == 0 and first.bits == 8 and alone and not pixel_format.has_palette)


def colour_picture(frame: VideoFrame) -> Picture:
    """The frame as (H, W, 3) BGR uint8, a fresh array."""
    converted = frame.reformat(format="bgr24", threads=CONVERSION_THREADS)
    plane = converted.planes[0]
    rows: Picture = np.frombuffer(memoryview(plane), dtype=np.uint8).reshape(-1, plane.line_size)
    picture = np.ascontiguousarray(rows[: frame.height, : 3 * frame.width]).reshape(frame.height, frame.width, 3)
    # what was converted is nobody else's; what needed no conversion is the decoder's own
    return picture.copy() if frame.format.name == "bgr24" else picture
