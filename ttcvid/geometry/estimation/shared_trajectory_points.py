"""The points that tell a path, and which of their views: see `shared_trajectory`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.model import Bools, Floats, Ints

MOST_POINTS = 150
"""With more points, use every n-th: errors shared by neighbours limit the path, not their number."""
LEAST_VIEWS = 3
"""Fewer views say nothing of a path beside the place and the rate of their point."""


@dataclass(frozen=True)
class PathPoints:
    """M points that tell K paths, path by path: ``first (K + 1,)`` is where each begins, and where the last one ends.

    ``xy (L, M, 2)`` views at the times ``t_s (L,)``, NaN where not used, with the noise ``sigma_norm (M,)``; ``n_views
    (M,)`` of each point; ``path_of (M,)``, ascending.
    """

    xy: Floats
    t_s: Floats
    sigma_norm: Floats
    n_views: Ints
    path_of: Ints
    first: Ints

    def views(self, xy: Floats) -> tuple[Floats, Floats, Floats, Ints, Ints]:
        """What the descent asks for, with the views ``xy (L, M, 2)``."""
        return xy, self.t_s, self.sigma_norm, nearest_first(self.t_s), self.first

    def of(self, is_asked: Bools) -> PathPoints:
        """The points of the paths for which ``is_asked (K,)`` holds, as points of these paths alone."""
        kept, n_points = np.flatnonzero(is_asked[self.path_of]), np.diff(self.first)[is_asked]
        return PathPoints(
            self.xy.take(kept, axis=1),
            self.t_s,
            self.sigma_norm[kept],
            self.n_views[kept],
            np.repeat(np.arange(len(n_points)), n_points),
            np.append(0, np.cumsum(n_points)),
        )


def nearest_first(t_s: Floats) -> Ints:
    """The order (L,) of views at times ``t_s (L,)`` by how far they are from time 0."""
    return np.argsort(np.abs(t_s), kind="stable")


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
    xy, t_s, sigma_norm, path_of, max_frames : As for `fit_rates_on_paths`.
    base : ``(K, L, 3)`` believed paths: a view at which its path is not known is none.
    """
    of_path = np.flatnonzero(path_of >= 0)
    is_seen = np.isfinite(xy[..., 0]).take(of_path, axis=1) & np.isfinite(base[..., 2]).T[:, path_of[of_path]]
    if max_frames is not None and max_frames < len(t_s):
        order = nearest_first(t_s)
        is_seen[order] &= np.cumsum(is_seen[order], axis=0) <= max_frames
    n_views = np.sum(is_seen, axis=0)
    tells = np.flatnonzero(n_views >= LEAST_VIEWS)
    tells = tells[np.argsort(path_of[of_path[tells]], kind="stable")]
    path_of_each = path_of[of_path[tells]]
    n_points = np.bincount(path_of_each, minlength=len(base))
    every = np.maximum(-(-n_points // most_points), 1)
    rank = np.arange(len(tells)) - (np.cumsum(n_points) - n_points)[path_of_each]
    some = rank % every[path_of_each] == 0
    tells, path_of_each = tells[some], path_of_each[some]
    index = of_path[tells]
    return PathPoints(
        np.where(is_seen[:, tells, None], xy.take(index, axis=1), np.nan),
        t_s,
        sigma_norm[index],
        n_views[tells],
        path_of_each,
        np.searchsorted(path_of_each, np.arange(len(base) + 1)),
    )
