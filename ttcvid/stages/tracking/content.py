"""Where the content lies that a Lucas-Kanade window follows, and whether it is an edge (aperture problem)."""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled_for
from ttcvid.model import Floats, Picture

# A window is a corner when the lesser of its two gradients is at least this part of the greater one.
_LEAST_CORNER = 1e-3


def content_offsets(grey: Picture, xy_px: Floats, window_px: int) -> Floats:
    """From points to the content that windows about them follow: ``(N, 2)`` px, NaN where a window holds no corner.

    A Lucas-Kanade step is ``H^-1 sum(g g' d)`` over the window, with gradients g, ``H = sum(g g')`` and the
    displacement d of each pixel. Where d is a shift and an expansion about any point, that is d at
    ``H^-1 sum(g g' x)``: where something approaches, the middle of a window leaves the point that it began on, by
    the expansion times this offset, and the content does not.

    Parameters
    ----------
    grey : (H, W) uint8.
    xy_px : (N, 2) points.
    window_px : side of the windows, odd. What lies beyond the border is as its last pixels are.

    Source: the normal equations of Lucas and Kanade (1981); the point is that of Foerstner and Guelch (1987).
    """
    return window_contents(grey, xy_px, window_px)[0]


def window_contents(grey: Picture, xy_px: Floats, window_px: int) -> tuple[Floats, Floats]:
    """`content_offsets (N, 2)`, and how far the windows are on edges, (N, 2) as in `PointSet`: 0 on a plain surface.

    Source: the length of the latter is the coherence of Bigun and Granlund (1987).
    """
    reach = window_px // 2
    offset, edge = np.empty((len(xy_px), 2)), np.empty((len(xy_px), 2))
    _fill(np.ascontiguousarray(grey), np.asarray(xy_px, dtype=np.float64), reach, offset, edge)
    offset[~(np.abs(offset).max(axis=1, initial=0.0) <= window_px / 2)] = np.nan
    return offset, edge


@compiled_for("(u1[:, ::1], f8[:, ::1], i8, f8[:, ::1], f8[:, ::1])")
def _fill(grey: Picture, xy: Floats, reach: int, offset: Floats, edge: Floats) -> None:
    """Fills ``offset, edge (N, 2)``: Scharr gradients at whole pixels, between them bilinear, as OpenCV has them."""
    height, width = grey.shape
    side = 2 * reach + 2
    by_x, by_y = np.empty((side, side)), np.empty((side, side))
    for i in range(len(xy)):
        left, top = int(np.floor(xy[i, 0])), int(np.floor(xy[i, 1]))
        right_part, low_part = xy[i, 0] - left, xy[i, 1] - top
        for row in range(side):
            y = min(max(top - reach + row, 0), height - 1)
            above, below = max(y - 1, 0), min(y + 1, height - 1)
            for column in range(side):
                x = min(max(left - reach + column, 0), width - 1)
                before, after = max(x - 1, 0), min(x + 1, width - 1)
                a, b, c = float(grey[above, before]), float(grey[above, x]), float(grey[above, after])
                d, f = float(grey[y, before]), float(grey[y, after])
                g, h, k = float(grey[below, before]), float(grey[below, x]), float(grey[below, after])
                by_x[row, column] = 3.0 * (c - a + k - g) + 10.0 * (f - d)
                by_y[row, column] = 3.0 * (g - a + k - c) + 10.0 * (h - b)
        xx, xy_, yy, side_x, side_y = 0.0, 0.0, 0.0, 0.0, 0.0
        for row in range(side - 1):
            v = row - reach
            for column in range(side - 1):
                u = column - reach
                upper = by_x[row, column] + right_part * (by_x[row, column + 1] - by_x[row, column])
                lower = by_x[row + 1, column] + right_part * (by_x[row + 1, column + 1] - by_x[row + 1, column])
                gx = upper + low_part * (lower - upper)
                upper = by_y[row, column] + right_part * (by_y[row, column + 1] - by_y[row, column])
                lower = by_y[row + 1, column] + right_part * (by_y[row + 1, column + 1] - by_y[row + 1, column])
                gy = upper + low_part * (lower - upper)
                along = gx * u + gy * v
                xx += gx * gx
                xy_ += gx * gy
                yy += gy * gy
                side_x += gx * along
                side_y += gy * along
        both = max(xx + yy, 1.0)
        edge[i, 0], edge[i, 1] = (xx - yy) / both, 2.0 * xy_ / both
        determinant = xx * yy - xy_ * xy_
        if determinant > _LEAST_CORNER * (xx + yy) ** 2:
            offset[i, 0] = (yy * side_x - xy_ * side_y) / determinant
            offset[i, 1] = (xx * side_y - xy_ * side_x) / determinant
        else:
            offset[i] = np.nan
