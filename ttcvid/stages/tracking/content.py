"""Where the content lies that a Lucas-Kanade window follows."""

from __future__ import annotations

import cv2
import numpy as np

from ttcvid.model import Floats, Picture

# A window is a corner when the lesser of its two gradients is at least this part of the greater one.
_LEAST_CORNER = 1e-3


def content_offsets(grey: Picture, xy_px: Floats, window_px: int) -> Floats:
    """From points to the content that windows about them follow.

    A Lucas-Kanade step is ``H^-1 sum(g g' d)`` over the window, with gradients g, ``H = sum(g g')`` and the
    displacement d of each pixel. Where d is a shift and an expansion about any point, that is d at
    ``H^-1 sum(g g' x)``: where something approaches, the middle of a window leaves the point that it began on, by
    the expansion times this offset, and the content does not. Offsets ``(N, 2)`` px, NaN where a window has no corner.

    Parameters
    ----------
    grey : (H, W) uint8.
    xy_px : (N, 2) points.
    window_px : side of the windows, odd. What lies beyond the border is as its last pixels are.

    Source: the normal equations of Lucas and Kanade (1981); the point is that of Foerstner and Guelch (1987).
    """
    if not len(xy_px):
        return np.empty((0, 2))
    (gx, gy), reach = _window_gradients(grey, xy_px, window_px // 2), window_px // 2
    from_middle = np.arange(-reach, reach + 1, dtype=np.float64)
    along = gx * from_middle + gy * from_middle[:, None]
    xx, xy, yy = (np.einsum("nvu,nvu->n", *pair) for pair in ((gx, gx), (gx, gy), (gy, gy)))
    side_x, side_y = (np.einsum("nvu,nvu->n", one, along) for one in (gx, gy))
    determinant = xx * yy - xy * xy
    determinant = np.where(determinant > _LEAST_CORNER * (xx + yy) ** 2, determinant, np.nan)
    offset = np.stack([yy * side_x - xy * side_y, xx * side_y - xy * side_x], axis=1) / determinant[:, None]
    offset[~(np.abs(offset).max(axis=1) <= window_px / 2)] = np.nan
    return offset


def _window_gradients(grey: Picture, xy_px: Floats, reach: int) -> Floats:
    """Gradients (2, N, side, side) in N windows: Scharr's at whole pixels, between them bilinear, as OpenCV has it."""
    corner = np.floor(xy_px).astype(np.intp)
    part = (xy_px - corner)[:, :, None, None]
    beside = np.arange(-reach, reach + 2)
    row = np.clip(corner[:, 1, None] + beside, 0, grey.shape[0] - 1)
    column = np.clip(corner[:, 0, None] + beside, 0, grey.shape[1] - 1)
    at_pixels = np.stack(
        [
            cv2.Scharr(grey, cv2.CV_16S, *along, borderType=cv2.BORDER_REPLICATE)[row[:, :, None], column[:, None, :]]
            for along in ((1, 0), (0, 1))
        ]
    ).astype(np.float64)
    upper_lower = at_pixels[..., :-1] + part[:, 0] * np.diff(at_pixels, axis=3)
    return np.asarray(upper_lower[:, :, :-1] + part[:, 1] * np.diff(upper_lower, axis=2))
