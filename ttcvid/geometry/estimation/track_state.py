"""The image state (x, y, a, b, c) of points by maximum likelihood from all views of their tracks.

(x, y) = (X, Y) / Z is where the point is at time 0, (a, b, c) = V / Z its velocity in units of its depth, in 1/s. Seen
by a camera that does not turn, it moves along x(t) = (x + a t) / (1 + c t), y(t) = (y + b t) / (1 + c t).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import chdtri

from ttcvid.geometry.kernels.free_point import fit_free_points
from ttcvid.geometry.kernels.windows import TAIL
from ttcvid.model import Floats, Ints


@dataclass(frozen=True)
class MotionPlane:
    """The plane in which everything moves: its unit ``normal (3,)`` with ``covariance (3, 3)`` in rad^2."""

    normal: Floats
    covariance: Floats


@dataclass(frozen=True)
class WholeTracks:
    """States of N tracks at time 0.

    ``state (N, 5)`` x, y without unit, a, b, c in 1/s, with ``cov (N, 5, 5)``, NaN with fewer than three views and
    where these say nothing of c (a point that keeps its place exactly moves along its ray, or not at all: c = 0);
    ``info_w (N, 3, 3)`` in s^2: information on w = (a, b, c) alone, x and y marginalised out, so that the
    likelihood of any other w is ``exp(-(w - state[2:])' info_w (w - state[2:]) / 2)``. Two views have rank 2 (their
    state has c = 0, one of the w that explain them), one view has none. ``chi2 (N,)`` of the robust residuals over
    the window of ``n_frames (N,)`` views, with 2 n_frames - 5 degrees of freedom.
    """

    state: Floats
    cov: Floats
    info_w: Floats
    chi2: Floats
    n_frames: Ints


def fit_whole_tracks(
    xy: Floats,
    t_s: Floats,
    sigma_norm: Floats,
    max_frames: int | None = None,
    gate_probability: float = 0.999,
    plane: MotionPlane | None = None,
) -> WholeTracks:
    """State of each track by robust Gauss-Newton on the reprojection error, over a window that fits it.

    The window is the longest run of views around time 0 that one constant velocity explains, three views at the least:
    chi-square tests of the whole window, and of what its farthest views add to it. Jacobians stand at the predicted
    positions: at the observed ones, which the linear solve that starts the search uses, noise enters a column and
    biases c towards zero.

    Parameters
    ----------
    xy : ``(L, N, 2)`` derotated positions in the plane z = 1 of the camera at time 0; NaN where not observed.
    t_s : ``(L,)`` times relative to the reference, in s: 0 and before, or on both sides; in any order.
    sigma_norm : ``(N,)`` standard deviation of a coordinate of one observation.
    max_frames : Most views of a window; None: all.
    gate_probability : Probability with which a constant velocity keeps its whole window.
    plane : Planar motion, as the Gaussian prior ``normal . w ~ N(0, w' covariance w)``: then two views suffice. It is
        part of ``cov`` and ``info_w`` then.

    The state is NaN where the views are fewer than two, or sigma is not positive.

    Source: DESIGN section 3, the general estimator.

    A point at (1, 0, 10) m that comes nearer by 1 m in 0.1 s has ttc_z = 1 s, that is c = -1 / s:

    >>> z = np.array([10.0, 11.0, 12.0, 13.0])
    >>> xy = np.column_stack([1.0 / z, 0.0 * z])[:, None]
    >>> fit_whole_tracks(xy, np.array([0.0, -0.1, -0.2, -0.3]), np.array([1e-6])).state.round(6) + 0.0
    array([[ 0.1,  0. ,  0. ,  0. , -1. ]])
    """
    n = xy.shape[1]
    if xy.shape != (len(t_s), n, 2) or sigma_norm.shape != (n,):
        raise ValueError(
            f"expected xy (L, N, 2), t_s (L,) and sigma_norm (N,), got {xy.shape}, {t_s.shape}, {sigma_norm.shape}"
        )
    order = np.argsort(np.abs(t_s), kind="stable")
    longest = len(t_s) if max_frames is None else min(max_frames, len(t_s))
    nothing = np.empty(0), np.empty((0, 0))
    state, cov = np.full((n, 5), np.nan), np.full((n, 5, 5), np.nan)
    info_w, chi2 = np.zeros((n, 3, 3)), np.zeros(n)
    n_frames = np.zeros(n, dtype=np.int64)
    fit_free_points(
        np.ascontiguousarray(xy, dtype=np.float64),
        np.asarray(t_s, dtype=np.float64),
        np.asarray(sigma_norm, dtype=np.float64),
        order,
        (window_gates(longest, 5, gate_probability), window_gates(TAIL, 0, gate_probability)),
        nothing if plane is None else (plane.normal, plane.covariance),
        (state, cov, info_w, chi2, n_frames),
    )
    if plane is not None:
        _add_plane(plane, state, cov, info_w)
    return WholeTracks(state, cov, info_w, chi2, n_frames)


@lru_cache(maxsize=32)
def window_gates(max_frames: int, n_unknowns: int, probability: float) -> Floats:
    """Chi-square ``(max_frames + 1,)`` inside which so many views are kept; infinite without a degree of freedom."""
    dof = 2 * np.arange(max_frames + 1) - n_unknowns
    gates = np.full(max_frames + 1, np.inf)
    gates[dof > 0] = chdtri(dof[dof > 0], 1.0 - probability)
    return gates


def _add_plane(plane: MotionPlane, state: Floats, cov: Floats, info_w: Floats) -> None:
    """Add what the plane says to the covariances and the information, in place."""
    variance = np.einsum("ni,ij,nj->n", state[:, 2:], plane.covariance, state[:, 2:])
    has_rate = variance > 0.0
    info_w[has_rate] += np.outer(plane.normal, plane.normal) / variance[has_rate, None, None]
    # NaN, where a covariance is not known, stays NaN.
    towards = cov[:, :, 2:] @ plane.normal
    spread = variance + towards[:, 2:] @ plane.normal
    cov -= np.einsum("ni,nj->nij", towards, towards) / spread[:, None, None]
