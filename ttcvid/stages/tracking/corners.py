"""Corners, well spread over the picture."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from ttcvid.compiled import compiled_for
from ttcvid.config import TrackingConfig
from ttcvid.geometry.medians import median
from ttcvid.geometry.quotient import quotient
from ttcvid.model import Bools, Floats, Ints, Picture

# Side of the gradient window of the corner response, px.
_BLOCK_PX = 3
# A picture of more pixels than the first is looked through in bands of the second.
_WHOLE_PIXELS, _BAND_PIXELS = 2_500_000, 500_000
# Least smaller eigenvalue of the gradient matrix (in cv2.cornerMinEigenVal's units, grey levels scaled to
# 0..1): below it a "corner" is sensor noise of a plain surface. Of noise that shows it is so many times the variance
# in squared grey levels: white noise exceeds that at 3 of a million pixels.
_MIN_RESPONSE, _RESPONSE_PER_VARIANCE = 2e-5, 6e-5
# The noise is looked for in blocks of the first, in rows of them that begin every so many px, and is that of this part
# of the blocks: the others have texture.
_BLOCK_OF_NOISE_PX, _STRIPS_PX, _PLAIN_PART = 16, 64, 0.1
_SECOND_DIFFERENCES = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]])
# Standard deviation over the mean absolute second difference: the weights' root sum of squares is 6.
_SIGMA_PER_ROUGHNESS = math.sqrt(math.pi / 2.0) / 6.0

# A corner has gradients in two directions within a square of this side at half of the resolution, between a tracker's
# window of 9 px and what that covers in the next coarser picture. The constant is that of Harris and Stephens: the
# greater eigenvalue of the gradient matrix is at most 18 times the lesser, for k = r / (1 + r)^2.
_HALF_WINDOW_PX, _HARRIS_K = 7, 0.05
# Corners are weighed against what is around them within this square, px.
_AROUND_PX = 65
# What is around a grid cell is a square of so many, the size of the smallest things that bear an object. Where less
# than this part of the corners in it is followed, something new is to be seen.
_AROUND_CELLS, _BARE_PART = (5, 5), 0.5
# Close corners stand this part of the full distance apart.
_CLOSE_PART = 0.57


def occupied_cells(xy_px: Floats, shape: tuple[int, int], cell_px: float) -> Bools:
    """Grid cells of side ``cell_px`` that hold one of ``xy_px (N, 2)`` or touch the cell of one.

    The points lie inside the picture, of ``shape`` rows and columns.
    """
    rows, columns = int(shape[0] / cell_px) + 1, int(shape[1] / cell_px) + 1
    cells = np.zeros((rows, columns), dtype=np.uint8)
    row = np.clip(xy_px[:, 1] / cell_px, 0, rows - 1).astype(np.intp)
    column = np.clip(xy_px[:, 0] / cell_px, 0, columns - 1).astype(np.intp)
    cells[row, column] = 1
    return np.asarray(cv2.dilate(cells, np.ones((3, 3), np.uint8)) > 0)


def find_corners(
    grey: Picture,
    allowed: Picture | None,
    xy_taken_px: Floats,
    n_wanted: int,
    config: TrackingConfig,
    *,
    only_new_places: bool = False,
    step_px: Floats | None = None,
) -> Floats:
    """Strongest corners that keep their distance from each other and from the points already there.

    First each cell of a grid of side ``min_distance_px`` gives at most its strongest corner, and none where a point
    stands in it or next to it; so plain regions get the few corners they have instead of a tree getting all. A part of
    what is wanted may stand closer, those first that stand out of their surroundings: a car far away is two cells wide,
    an aircraft less. A small part: windows that overlap err together, and pass for several witnesses. Another part goes
    first where the picture moves least, far away: things are small there (one of a hundred too close to close tracks).

    Parameters
    ----------
    grey : (H, W) uint8.
    allowed : (H, W) uint8, 0 where nothing is to be looked at, or None.
    xy_taken_px : (N, 2) points already there.
    config : its ``close_share`` is the part of ``n_wanted`` that may stand at 0.57 of the distance, its ``far_share``
        the part that goes where the picture moves least, once that is known.
    only_new_places : corners where few of those around are followed, and no others: where most have their tracks,
        something has come into the picture there.
    step_px : (N, 2) last steps of the points already there, NaN where unknown.

    Returns (M, 2) float64 corners, px: those of the grid first, in order of choice, M <= n_wanted.
    """
    if n_wanted <= 0:
        return np.empty((0, 2))
    shape, min_distance_px = (grey.shape[0], grey.shape[1]), config.min_distance_px
    response = _response(grey)
    # A stride of 4 in both axes leaves the percentile as it is and takes a sixteenth of the time.
    least = config.corner_quality * float(np.percentile(response[::4, ::4], 99.9))
    threshold = max(_response_to_noise(grey, allowed), least)
    x, y = _peaks(grey, response, threshold, allowed)
    taken = occupied_cells(xy_taken_px, shape, min_distance_px)
    cell = row, column = (y / min_distance_px).astype(np.intp), (x / min_distance_px).astype(np.intp)
    first = np.argsort(-response[y, x], kind="stable")
    if only_new_places:
        first = first[_bare_cells(cell, taken)[cell][first]]
    # The first of each cell that is free and has no taken neighbour, in their order.
    free = first[~taken[row, column][first]]
    _, best = np.unique((row * taken.shape[1] + column)[free], return_index=True)
    coarse = free[np.sort(best)]
    xy = _refined(response, x[coarse], y[coarse])
    # Without those that an earlier one is closer to.
    keeps = np.ones(len(xy), dtype=bool)
    keeps[KDTree(xy).query_pairs(min_distance_px, output_type="ndarray").max(axis=1)] = False
    if only_new_places:
        return xy[keeps][:n_wanted]
    is_known = np.zeros(0, dtype=bool) if step_px is None else np.isfinite(step_px[:, 0])
    n_close = int(config.close_share * n_wanted)
    n_far = min(int(config.far_share * n_wanted), n_wanted - n_close) if is_known.any() else 0
    xy = xy[keeps][: n_wanted - n_close - n_far]
    more = list[tuple[Floats, float, int]]()
    if n_close:
        standing_out = response[y, x] / (_mean_around(response, x, y) + threshold)
        more.append((-standing_out, _CLOSE_PART * min_distance_px, n_close))
    if step_px is not None and n_far:
        flow_px = _flow_of_cells(xy_taken_px[is_known], step_px[is_known], taken.shape, min_distance_px)
        more.append((flow_px[cell], min_distance_px, n_far))
    for rank, distance_px, n in more:
        taken_px = np.concatenate([xy_taken_px, xy])
        xy = np.concatenate([xy, _best(response, (x, y), rank, taken_px, distance_px, n)])
    return xy


def _flow_of_cells(xy_px: Floats, step_px: Floats, shape: tuple[int, ...], cell_px: float) -> Floats:
    """Mean length of the steps ``(N, 2)`` of points in the picture about each cell, less the median; NaN: none."""
    length_px = np.hypot(*(step_px.T - [[median(along)] for along in step_px.T]))
    column, row = (xy_px / cell_px).astype(np.intp).T
    cell, n_cells = row * shape[1] + column, shape[0] * shape[1]
    sums = (np.bincount(cell, weight, n_cells).reshape(shape) for weight in (length_px, np.ones(len(cell))))
    length, n_steps = (np.asarray(cv2.boxFilter(one, -1, _AROUND_CELLS, normalize=False), np.float64) for one in sums)
    return quotient(length, np.rint(n_steps))


def find_corners_where(
    grey: Picture, where: Picture, xy_taken_px: Floats, n_wanted: int, min_distance_px: float
) -> Floats:
    """Strongest corners at certain places that keep their distance from each other and from the points already there.

    However weak beside those of the whole picture; at the least distance first, then closer: at 0.57 of it. None
    stands where ``where (H, W)`` uint8 is 0; the rest, and the result in order of choice, is as in `find_corners`.
    """
    if n_wanted <= 0:
        return np.empty((0, 2))
    response = _response(grey)
    x, y = _peaks(grey, response, _response_to_noise(grey, None), where)
    xy = np.empty((0, 2))
    for distance_px in (min_distance_px, _CLOSE_PART * min_distance_px):
        taken_px = np.concatenate([xy_taken_px, xy])
        xy = np.concatenate([xy, _best(response, (x, y), np.zeros(len(x)), taken_px, distance_px, n_wanted - len(xy))])
    return xy


def _best(
    response: NDArray[Any], peaks: tuple[Ints, Ints], rank: Floats, xy_taken_px: Floats, distance_px: float, n: int
) -> Floats:
    """Up to n peaks (M, 2), lowest rank and then strongest first, that keep their distance from the points there."""
    x, y = peaks
    order = np.lexsort((-response[y, x], rank))
    chosen = order[_spread(x[order], y[order], xy_taken_px, response.shape, distance_px, n)]
    return _refined(response, x[chosen], y[chosen])


def _bands(shape: tuple[int, ...], margin_px: int) -> Iterator[tuple[slice, slice, slice]]:
    """Rows of a picture (H, W), those that have to be looked at for them, and where among these they lie.

    A picture of up to 2.5 million pixels is one band. What OpenCV and numpy take on the way, 20 bytes a pixel and more,
    would be 170 MB of a 4K picture at once.
    """
    height, width = shape
    n_rows = height if height * width <= _WHOLE_PIXELS else max(1, _BAND_PIXELS // width)
    for top in range(0, height, n_rows):
        bottom, first = min(top + n_rows, height), max(0, top - margin_px)
        yield slice(top, bottom), slice(first, bottom + margin_px), slice(top - first, bottom - first)


def _response(grey: Picture) -> NDArray[Any]:
    """The smaller eigenvalue of the gradient matrix around each pixel, (H, W) float32."""
    response = np.empty(grey.shape, dtype=np.float32)
    for rows, around, inner in _bands(grey.shape, _BLOCK_PX + 1):
        response[rows] = cv2.cornerMinEigenVal(grey[around], _BLOCK_PX)[inner]
    return response


def _response_to_noise(grey: Picture, allowed: Picture | None) -> float:
    """The greatest response that the noise of a picture makes.

    The noise is that of the plainest blocks, by second differences along both axes. Source: Immerkaer (1996). Blocks of
    one grey level tell none: bars above and below the picture, a sky that is clipped; nor do those not ``allowed``.
    """
    side_px, roughness = _BLOCK_OF_NOISE_PX, [np.empty(0)]
    width = grey.shape[1] // side_px * side_px
    for top in range(0, grey.shape[0] - side_px + 1, _STRIPS_PX):
        strip = cv2.convertScaleAbs(cv2.filter2D(grey[top : top + side_px], cv2.CV_16S, _SECOND_DIFFERENCES))
        roughness.append(strip[:, :width].sum(axis=0, dtype=np.float64).reshape(-1, side_px).mean(axis=1) / side_px)
        if allowed is not None:
            roughness[-1] *= allowed[top + side_px // 2, side_px // 2 : width : side_px] > 0
    blocks = np.concatenate(roughness)
    blocks = blocks[blocks > 0.0]
    if not len(blocks):
        return _MIN_RESPONSE
    sigma_grey = _SIGMA_PER_ROUGHNESS * float(np.quantile(blocks, _PLAIN_PART))
    return max(_MIN_RESPONSE, _RESPONSE_PER_VARIANCE * sigma_grey * sigma_grey)


def _on_corners(grey: Picture, x: Ints, y: Ints) -> Bools:
    """Which of the pixels (N,) have gradients in two directions about them, and not in one only (aperture problem).

    On an edge a window goes along it wherever noise leads: the kerb of a bend stands still in the picture of whoever
    drives along it, and takes the turn out of own motion. Source: Harris and Stephens (1988).
    """
    size = max(grey.shape[1] // 2, 1), max(grey.shape[0] // 2, 1)
    half = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    response = np.empty(half.shape, dtype=np.float32)
    for rows, around, inner in _bands(half.shape, _HALF_WINDOW_PX):
        found = cv2.cornerHarris(half[around], _HALF_WINDOW_PX, 3, _HARRIS_K, borderType=cv2.BORDER_REPLICATE)
        response[rows] = found[inner]
    row, column = np.minimum(y // 2, half.shape[0] - 1), np.minimum(x // 2, half.shape[1] - 1)
    return np.asarray(response[row, column] > 0.0)


def _mean_around(response: NDArray[Any], x: Ints, y: Ints) -> NDArray[Any]:
    """Mean response (N,) in the square around each place; the places in order of their rows."""
    mean = np.empty(len(x), dtype=np.float32)
    for rows, around, inner in _bands(response.shape, _AROUND_PX // 2 + 1):
        here = slice(*np.searchsorted(y, [rows.start, rows.stop]))
        mean[here] = cv2.boxFilter(response[around], -1, (_AROUND_PX, _AROUND_PX))[inner][y[here] - rows.start, x[here]]
    return mean


def _peaks(grey: Picture, response: NDArray[Any], threshold: float, allowed: Picture | None) -> tuple[Ints, Ints]:
    """Columns and rows (N,) of the local maxima above a threshold that are no edges."""
    is_peak = np.empty(response.shape, dtype=bool)
    for rows, around, inner in _bands(response.shape, 1):
        highest = cv2.dilate(response[around], np.ones((3, 3), np.uint8))[inner]
        is_peak[rows] = (response[rows] >= highest) & (response[rows] > threshold)
    margin = _BLOCK_PX + 1
    is_peak[:margin] = is_peak[-margin:] = False
    is_peak[:, :margin] = is_peak[:, -margin:] = False
    if allowed is not None:
        is_peak &= allowed > 0
    # As fast as np.nonzero of two axes is slow.
    y, x = np.divmod(np.flatnonzero(is_peak), response.shape[1])
    is_corner = _on_corners(grey, x, y)
    return x[is_corner], y[is_corner]


def _bare_cells(with_corner: tuple[Ints, Ints], taken: Bools) -> Bools:
    """Cells (like ``taken``) around which fewer than half of those ``with_corner``, rows and columns, are taken."""
    corners = np.zeros(taken.shape, dtype=np.float32)
    corners[with_corner] = 1.0
    both = corners, corners * taken
    n_corners, n_taken = (cv2.boxFilter(cells, -1, _AROUND_CELLS, normalize=False) for cells in both)
    return np.asarray(n_taken < _BARE_PART * n_corners)


def _spread(x: Ints, y: Ints, xy_taken_px: Floats, shape: tuple[int, ...], distance_px: float, n_wanted: int) -> Ints:
    """Which of the pixels (N,), best first, keep their distance from each other and from the points already there."""
    cell_px = distance_px / np.sqrt(2.0)
    # Two rows and columns more on each side, so that every cell has its neighbours.
    grid = np.full((int(shape[0] / cell_px) + 5, int(shape[1] / cell_px) + 5, 2), np.inf)
    chosen = np.empty(n_wanted, dtype=np.int64)
    n = _choose(x.astype(np.float64), y.astype(np.float64), xy_taken_px, distance_px, cell_px, grid, chosen)
    return chosen[:n]


@compiled_for("(f8[::1], f8[::1], f8[:, ::1], f8, f8, f8[:, :, ::1], i8[::1])")
def _choose(x: Floats, y: Floats, taken: Floats, distance: float, cell: float, grid: Floats, chosen: Ints) -> int:
    """Fills ``chosen`` by greedy choice; how many. ``grid`` holds one point a cell, of close ones the last."""
    for k in range(len(taken)):
        row, column = int(taken[k, 1] / cell) + 2, int(taken[k, 0] / cell) + 2
        grid[row, column, 0], grid[row, column, 1] = taken[k, 0], taken[k, 1]
    n = 0
    for k in range(len(x)):
        if n == len(chosen):
            break
        row, column = int(y[k] / cell) + 2, int(x[k] / cell) + 2
        is_free = True
        for i in range(row - 2, row + 3):
            for j in range(column - 2, column + 3):
                off_x, off_y = grid[i, j, 0] - x[k], grid[i, j, 1] - y[k]
                if off_x * off_x + off_y * off_y < distance * distance:
                    is_free = False
        if is_free:
            grid[row, column, 0], grid[row, column, 1] = x[k], y[k]
            chosen[n] = k
            n += 1
    return n


def _refined(response: NDArray[Any], x: Ints, y: Ints) -> Floats:
    """Peaks (M,) to sub-pixel by a parabola through the response along each axis: (M, 2) px."""
    here = response[y, x].astype(np.float64)
    xy = np.stack([x, y], axis=1).astype(np.float64)
    for axis, (dy, dx) in enumerate(((0, 1), (1, 0))):
        before, after = response[y - dy, x - dx], response[y + dy, x + dx]
        curvature = 2.0 * here - before - after
        offset = np.divide(0.5 * (after - before), curvature, out=np.zeros_like(here), where=curvature > 1e-12)
        xy[:, axis] += np.clip(offset, -0.5, 0.5)
    return xy
