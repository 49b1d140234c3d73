"""Gauss-Newton on one point over the longest window of its views, nearest first, that one motion explains."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ttcvid.compiled import ZERO, compiled_part
from ttcvid.geometry.kernels.path_point import ROBUST_SIGMAS
from ttcvid.model import Floats

TAIL = 3
"""So many of a window's farthest views are tested also by themselves.

Where a velocity has changed they are the ones that do not fit, and in a long window they drown.
"""

# Gauss-Newton ends after so many steps, or after one shorter than this (squared, in sigmas of the estimate).
_MAX_STEPS, _CONVERGED_CHI2 = 8, 1e-2
# The window is chosen anew in the first steps; then it only becomes shorter, so that the rest converges.
_WINDOW_STEPS = 3
_LIMIT = ROBUST_SIGMAS**2


def window_descent(
    add: Callable[..., None], solve: Callable[..., float], solve_last: Callable[..., float]
) -> Callable[..., tuple[int, float]]:
    """The compiled descent of one kind of point.

    Parameters
    ----------
    add : ``add(views, first, stop, state, limit, sign, sums)`` adds the normal equations of a range of views, or takes
        them away again; squared residuals above the ``limit`` lose weight; the last of the ``sums`` is chi-square.
    solve : ``solve(sums, state, belief, step)`` fills the step and returns by how much chi-square falls;
        ``solve_last`` that which is taken, once the window is chosen.
    """

    @compiled_part
    def descend(
        views: Floats,
        n_views: int,
        least: int,
        belief: Any,
        gates: tuple[Floats, Floats],
        state: Floats,
        sums: Floats,
        work: tuple[Floats, Floats],
    ) -> tuple[int, float]:
        """Move ``state`` to where the views have it; return how many are kept, ``least`` or more, and chi-square.

        ``gates`` are chi-square inside which so many views are kept, and likewise of the farthest ones alone; ``sums``
        stay those of the views that are kept; ``work`` are arrays like ``sums`` and ``state``.
        """
        window_gates, tail_gates = gates
        near, step = work
        n, chi2, last = n_views, 0.0, len(sums) - 1
        for count in range(_MAX_STEPS):
            n = n_views if count < _WINDOW_STEPS else n
            sums[:] = 0.0
            add(views, ZERO, n, state, _LIMIT, 1.0, sums)
            while n > least:
                left = sums[last] - solve(sums, state, belief, step)
                if left <= window_gates[n]:
                    k = max(n - TAIL, least)
                    for j in range(last + 1):
                        near[j] = sums[j]
                    add(views, k, n, state, _LIMIT, -1.0, near)
                    if left - near[last] + solve(near, state, belief, step) <= tail_gates[n - k]:
                        break
                n -= 1
                add(views, n, n + 1, state, _LIMIT, -1.0, sums)
            fall = solve_last(sums, state, belief, step)
            for j in range(len(state)):
                state[j] += step[j]
            chi2 = max(sums[last] - fall, 0.0)
            if fall < _CONVERGED_CHI2:
                break
        return n, chi2

    return descend
