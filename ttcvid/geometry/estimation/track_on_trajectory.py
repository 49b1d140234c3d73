"""Place and rate of points whose relative path is known up to its scale, by maximum likelihood from their whole tracks.

All points of the static scene move along the camera's own path, all points of a translating object along one
direction; each has a depth of its own, which is all that its views have to tell beside where it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.geometry.estimation.track_state import window_gates
from ttcvid.geometry.kernels.known_path import fit_points_on_known_paths
from ttcvid.geometry.kernels.windows import TAIL
from ttcvid.model import Floats, Ints

NO_PATH = -1
"""Number of the path of a point that has none."""


@dataclass(frozen=True)
class PathRates:
    """Places and rates of N points at time 0; NaN for a point without a path or with fewer than two views.

    ``state (N, 3)`` x, y and rho = (speed along the path) / Z in 1/s, so that (a, b, c) = rho e with e the path's
    direction at time 0; ``cov (N, 3, 3)`` of (x, y, rho) by the noise of the point's own views. What errors that
    points share do to rho, to first order, is ``by_shared (N, 12)``: its change in 1/s per unit of the vectors u (3),
    v (3), a rotation rate (3) and w (3). The path has ``u t + v t^2 / 2 + w t^3 / 6`` too much: a wrong direction,
    acceleration (1/s) and change of it (1/s^2), over the speed; or the views were turned back at a constant rate,
    rad/s, that is not there.
    ``chi2, dof, n_frames (N,)`` of the window, as in `WholeTracks`, with 2 n_frames - 3 degrees of freedom.
    """

    state: Floats
    cov: Floats
    by_shared: Floats
    chi2: Floats
    dof: Ints
    n_frames: Ints

    @property
    def rate_hz(self) -> Floats:
        """Rates (N,)."""
        return np.ascontiguousarray(self.state[:, 2])


def straight_path(direction: Floats, t_s: Floats) -> Floats:
    """Path ``(L, 3)`` of a constant velocity along ``direction (3,)``, in s of it."""
    return np.asarray(t_s[:, None] * direction)


def fit_rates_on_paths(
    xy: Floats,
    t_s: Floats,
    sigma_norm: Floats,
    paths: Floats,
    path_of: Ints,
    max_frames: int | None = None,
    gate_probability: float = 0.999,
    start: Floats | None = None,
) -> PathRates:
    """Place and rate of each point on its path, over the longest window that fits it (two views at the least).

    A point at (x, y, 1) now is seen at ``(x + rho T_x) / (1 + rho T_z)`` at a time with the path at T, and likewise in
    y: robust Gauss-Newton on the reprojection error.

    Parameters
    ----------
    xy, t_s, sigma_norm, max_frames, gate_probability : As for `fit_whole_tracks`.
    paths : ``(K, L, 3)``: where K things were relative to the camera, less where they are at time 0, in the axes of the
        camera at time 0, at each of the L times; in s: its derivative at time 0 is the unit vector e = dir. For a
        thing that moves straight ahead this is `straight_path`; for the static scene seen from a turning car it is the
        sum of the steps, each along its own direction. NaN where not known: those views are not used.
    start : ``(N, 3)`` x, y, rho to start from; NaN rows, or None: from the linear solve.
    path_of : ``(N,)`` path of each point, `NO_PATH` for none.

    Source: DESIGN section 3 ("w_i = s_i e with one shared e").

    >>> z, t = np.array([10.0, 11.0, 12.0]), np.array([0.0, -0.1, -0.2])
    >>> xy = np.column_stack([1.0 / z, 0.0 * z])[:, None]
    >>> path = straight_path(np.array([0.0, 0.0, -1.0]), t)[None]
    >>> fit_rates_on_paths(xy, t, np.array([1e-5]), path, np.array([0])).rate_hz.round(9)
    array([1.])
    """
    n = xy.shape[1]
    if xy.shape != (len(t_s), n, 2) or paths.shape[1:] != (len(t_s), 3) or path_of.shape != (n,):
        raise ValueError(
            "expected xy (L, N, 2), t_s (L,), paths (K, L, 3) and path_of (N,), "
            f"got {xy.shape}, {t_s.shape}, {paths.shape} and {path_of.shape}"
        )
    longest = len(t_s) if max_frames is None else min(max_frames, len(t_s))
    state, cov, by_shared = np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan), np.full((n, 12), np.nan)
    chi2, n_frames = np.zeros(n), np.zeros(n, dtype=np.int64)
    fit_points_on_known_paths(
        np.ascontiguousarray(xy, dtype=np.float64),
        np.asarray(t_s, dtype=np.float64),
        np.asarray(sigma_norm, dtype=np.float64),
        np.argsort(np.abs(t_s), kind="stable"),
        (np.ascontiguousarray(paths, dtype=np.float64), np.asarray(path_of, dtype=np.int64)),
        (window_gates(longest, 3, gate_probability), window_gates(TAIL, 0, gate_probability)),
        np.empty((0, 3)) if start is None else np.asarray(start, dtype=np.float64),
        (state, cov, by_shared, chi2, n_frames),
    )
    dof = np.maximum(2 * n_frames - 3, 0)
    return PathRates(state, cov, by_shared, chi2, dof, n_frames)
