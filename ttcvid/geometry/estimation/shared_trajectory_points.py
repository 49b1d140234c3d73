"""The points that tell a path, and which of their views: see `shared_trajectory`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.geometry.compiled import compiled_for
from ttcvid.geometry.estimation.shared_trajectory_descent import LEAST_VIEWS
from ttcvid.model import Bools, Floats, Ints

MOST_POINTS = 150
"""With more points, use every n-th: errors shared by neighbours limit the path, not their number."""


@dataclass(frozen=True)
class PathPoints:
    """M points that tell K paths, path by path: ``first (K + 1,)`` is where each begins, and where the last one ends.

    ``xy (L, M, 2)`` views at the times ``t_s (L,)``, with the noise ``sigma_norm (M,)``; point i is seen at the places
    ``seen[i, : n_views[i]]``, nearest first; ``path_of (M,)``, ascending.
    """

    xy: Floats
    t_s: Floats
    sigma_norm: Floats
    seen: Ints
    n_views: Ints
    path_of: Ints
    first: Ints

    def views(self, xy: Floats) -> tuple[Floats, Floats, Floats, Ints, Ints, Ints]:
        """What the descent asks for, with the views ``xy (L, M, 2)``."""
        return xy, self.t_s, self.sigma_norm, self.seen, self.n_views, self.first

    def of(self, is_asked: Bools) -> PathPoints:
        """The points of the paths for which ``is_asked (K,)`` holds, as points of these paths alone."""
        kept, n_points = np.flatnonzero(is_asked[self.path_of]), np.diff(self.first)[is_asked]
        return PathPoints(
            self.xy.take(kept, axis=1),
            self.t_s,
            self.sigma_norm[kept],
            self.seen[kept],
            self.n_views[kept],
            np.repeat(np.arange(len(n_points)), n_points),
            np.append(0, np.cumsum(n_points)),
        )


def points_of_paths(
    xy: Floats,
    t_s: Floats,
    sigma_norm: Floats,
    base: Floats,
    path_of: Ints,
    max_frames: int | None = None,
    most_points: int = MOST_POINTS,
) -> PathPoints:
    """Those of N points that are seen often enough to tell of their path; of more than ``most_points`` an even part.

    Parameters
    ----------
    xy, t_s, sigma_norm, path_of, max_frames
        As for `fit_rates_on_paths`.
    base
        ``(K, L, 3)`` believed paths: a view at which its path is not known is none.
    """
    longest = len(t_s) if max_frames is None else min(max_frames, len(t_s))
    seen, n_views = np.empty((len(path_of), longest), dtype=np.int64), np.empty(len(path_of), dtype=np.int64)
    index, first = np.empty(len(path_of), dtype=np.int64), np.empty(len(base) + 1, dtype=np.int64)
    _list_views(xy, np.argsort(np.abs(t_s), kind="stable"), base, path_of, seen, n_views)
    _pick_some_of_each(path_of, n_views, LEAST_VIEWS, most_points, index, first)
    index = index[: first[-1]]
    return PathPoints(
        xy.take(index, axis=1),
        t_s,
        sigma_norm[index],
        seen[index],
        n_views[index],
        path_of[index],
        first,
    )


@compiled_for("(f8[:, :, ::1], i8[::1], f8[:, :, ::1], i8[::1], i8[:, ::1], i8[::1])")
def _list_views(xy: Floats, order: Ints, paths: Floats, path_of: Ints, seen: Ints, n_views: Ints) -> None:
    """Fills ``seen (N, M)`` with the first M places in ``order`` at which a point and its path are known.

    ``n_views (N,)`` says how many there are; none for a point without a path.
    """
    n_views[:] = 0
    for i in range(xy.shape[1]):
        if path_of[i] < 0:
            continue
        path, count = paths[path_of[i]], 0
        for place in order:
            if count == seen.shape[1]:
                break
            # A sum is finite where all of its terms are.
            if np.isfinite(xy[place, i, 0] + xy[place, i, 1] + path[place, 0] + path[place, 2]):
                seen[i, count] = place
                count += 1
        n_views[i] = count


@compiled_for("(i8[::1], i8[::1], i8, i8, i8[::1], i8[::1])")
def _pick_some_of_each(path_of: Ints, n_views: Ints, least_views: int, most: int, index: Ints, first: Ints) -> None:
    """Fills ``index`` with an even part of the points of each path, no more than ``most``, path by path.

    ``first (K + 1,)`` is where each path begins, and where the last one ends. Points of fewer views have no part.
    """
    first[:] = 0
    for i in range(len(path_of)):
        if n_views[i] >= least_views:
            first[path_of[i] + 1] += 1
    every, passed, place = np.empty_like(first), np.zeros_like(first), np.empty_like(first)
    for k in range(len(first) - 1):
        every[k] = max(-(-first[k + 1] // most), 1)
        place[k] = first[k]
        first[k + 1] = first[k] + -(-first[k + 1] // every[k])
    for i in range(len(path_of)):
        if n_views[i] >= least_views:
            k = path_of[i]
            if passed[k] % every[k] == 0:
                index[place[k]] = i
                place[k] += 1
            passed[k] += 1
