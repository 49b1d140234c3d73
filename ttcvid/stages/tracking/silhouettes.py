"""What moves in each picture of a clip, kept small, and how high it stands at a place."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field

import cv2
import numpy as np

from ttcvid.model import Picture

# The mover at a place is that of most of the pixels within this height about it, px.
_ABOUT_PX = 10


@dataclass(frozen=True)
class Silhouettes:
    """Masks ``(H, W)`` of what moves, by frame; some kilobytes each."""

    packed: dict[int, tuple[bytes, tuple[int, int]]] = field(default_factory=dict)

    def put(self, frame: int, mask: Picture) -> None:
        """Keep the mask of a frame."""
        self.packed[frame] = (zlib.compress(np.packbits(mask > 0).tobytes(), 1), (mask.shape[0], mask.shape[1]))

    def mask(self, frame: int) -> Picture | None:
        """The mask of a frame, uint8 of 0 and 1; None where there is none."""
        if frame not in self.packed:
            return None
        data, shape = self.packed[frame]
        bits = np.frombuffer(zlib.decompress(data), dtype=np.uint8)
        return np.unpackbits(bits, count=shape[0] * shape[1]).reshape(shape)


def extent_px(mask: Picture, x_px: float, y_px: float, half_px: float) -> tuple[float, float] | None:
    """Rows of top and bottom of what stands at a place, within ``half_px`` to either side of it.

    None where nothing is there, or where it is cut off by a border of the picture.
    """
    height, width = mask.shape
    left, right = round(x_px - half_px), round(x_px + half_px)
    if left < 1 or right >= width - 1:
        return None
    _, labels, found, _ = cv2.connectedComponentsWithStats(np.ascontiguousarray(mask[:, left : right + 1]))
    row = round(y_px)
    about = np.bincount(labels[max(0, row - _ABOUT_PX) : row + _ABOUT_PX + 1].ravel(), minlength=len(found))
    about[0] = 0
    if not about.any():
        return None
    part = found[int(np.argmax(about))]
    top, bottom = int(part[cv2.CC_STAT_TOP]), int(part[cv2.CC_STAT_TOP] + part[cv2.CC_STAT_HEIGHT] - 1)
    return (float(top), float(bottom)) if top > 1 and bottom < height - 2 else None
