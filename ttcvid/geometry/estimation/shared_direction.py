"""The direction of motion shared by the points of one translating object, from the states of whole tracks."""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled, compiled_for
from ttcvid.geometry.kernels.medians import median
from ttcvid.model import Floats, Ints

# A point off by more sigmas than this loses weight (Cauchy).
_CAUCHY_SIGMAS = 3.0
# Gauss-Newton ends after so many steps, or after one shorter than this (squared, in sigmas of the direction).
_MAX_STEPS, _CONVERGED_CHI2 = 12, 1e-3
# In the vote on the sense a point counts at most this many sigmas.
_MAX_VOTE_SIGMAS = 3.0
# A step is cut to this length.
_LONGEST_STEP_RAD = 0.3
# What keeps the normal matrix of points that say nothing from being singular, as a part of its trace.
_RIDGE = 1e-12
# The main axis is the first column of the matrix to the power of 2 to this.
_SQUARINGS = 6
# Numbers of a point: w (3), the upper half of its information (6), and its place x, y.
_N_POINT = 11


def shared_directions(
    xy: Floats, velocity_hz: Floats, info_w: Floats, thing: Ints, n_things: int, by_shared: Floats | None = None
) -> tuple[Floats, Floats, Floats]:
    """Maximum-likelihood ``dir`` of K things whose points move alike, each at its own rate: w_i = s_i e.

    Minimises ``sum rho(min_s (w_i - s e)' info_i (w_i - s e))`` over the sphere, Cauchy's rho; chi-square with two
    degrees of freedom a point. Where the points fit worse than their noise allows, the covariance is widened by that.

    Parameters
    ----------
    xy : (N, 2) where the points are: the lines along which they move say where to begin.
    velocity_hz, info_w : (N, 3) and (N, 3, 3) of `track_state.WholeTracks`: (a, b, c) and its information, in s^2.
    thing : (N,) which of the ``n_things`` K each point belongs to, from 0.
    by_shared : (N, 3, E) what one standard deviation of each of E errors that all points share does to w; None: none.

    Returns
    -------
    direction : (K, 3) unit vectors, NaN where no point says anything.
    covariance : (K, 3, 3) in the tangent plane of each, rad^2.
    chi2 : (N,) of each point.

    Source: DESIGN section 3 (w_i = s_i e with one shared e).

    >>> xy, w = np.array([[0.1, 0.0], [0.0, 0.2]]), np.array([[0.0, 0.0, -1.0], [0.0, 0.0, -0.5]])
    >>> shared_directions(xy, w, np.broadcast_to(np.eye(3) * 1e4, (2, 3, 3)), np.array([0, 0]), 1)[0].round(9) + 0.0
    array([[ 0.,  0., -1.]])
    """
    n = len(velocity_hz)
    direction, covariance = np.full((n_things, 3), np.nan), np.full((n_things, 3, 3), np.nan)
    chi2 = np.zeros(n)
    order = np.argsort(thing, kind="stable")
    _fit_each(
        np.ascontiguousarray(xy),
        np.ascontiguousarray(velocity_hz),
        np.ascontiguousarray(info_w),
        np.zeros((n, 3, 0)) if by_shared is None else np.ascontiguousarray(by_shared),
        order,
        np.searchsorted(thing[order], np.arange(n_things + 1)),
        direction,
        covariance,
        chi2,
    )
    return direction, covariance, chi2


@compiled_for(
    "(f8[:, ::1], f8[:, ::1], f8[:, :, ::1], f8[:, :, ::1], i8[::1], i8[::1], f8[:, ::1], f8[:, :, ::1], f8[::1])"
)
def _fit_each(
    xy: Floats,
    w: Floats,
    info: Floats,
    shared: Floats,
    order: Ints,
    start: Ints,
    direction: Floats,
    covariance: Floats,
    chi2: Floats,
) -> None:
    """Fill the results of `shared_directions`; the points of thing k are ``order[start[k] : start[k + 1]]``."""
    e, basis, errors = np.empty(3), np.empty((3, 2)), np.empty((3, shared.shape[2]))
    normal, score, mixed = np.empty((2, 2)), np.empty(2), np.empty((2, shared.shape[2]))
    points, off, usable = np.empty((_N_POINT, len(order))), np.empty(len(order)), np.empty_like(order)
    for number in range(len(direction)):
        members = order[start[number] : start[number + 1]]
        n_usable = _list_usable(xy, w, info, members, points, usable)
        if n_usable == 0:
            continue
        _begin(points, n_usable, e, basis, normal, score, off)
        votes, one, other, both, determinant, is_converged = 0.0, 0.0, 0.0, 0.0, 0.0, False
        for step in range(_MAX_STEPS + 1):
            _tangents(e, basis)
            votes = _add_up(points, n_usable, e, basis, normal, score, off)
            ridge = _RIDGE * (normal[0, 0] + normal[1, 1] + 1e-300)
            one, other, both = normal[0, 0] + ridge, normal[1, 1] + ridge, normal[0, 1]
            determinant = one * other - both * both
            if is_converged or step == _MAX_STEPS:
                break
            p = (other * score[0] - both * score[1]) / determinant
            q = (one * score[1] - both * score[0]) / determinant
            is_converged = p * score[0] + q * score[1] < _CONVERGED_CHI2
            cut = min(1.0, _LONGEST_STEP_RAD / max(np.sqrt(p * p + q * q), 1e-300))
            for a in range(3):
                e[a] += cut * (p * basis[a, 0] + q * basis[a, 1])
            length = np.sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2])
            for a in range(3):
                e[a] /= length
        total = 0.0
        for c in range(n_usable):
            chi2[usable[c]] = off[c]
            total += min(off[c], _CAUCHY_SIGMAS * _CAUCHY_SIGMAS)
        widened = max(total / max(2 * n_usable - 2, 1), 1.0) / determinant
        _add_up_shared(points, n_usable, usable, shared, e, basis, off, mixed)
        for a in range(3):
            to_p = (basis[a, 0] * other - basis[a, 1] * both) / determinant
            to_q = (basis[a, 1] * one - basis[a, 0] * both) / determinant
            for k in range(shared.shape[2]):
                errors[a, k] = to_p * mixed[0, k] + to_q * mixed[1, k]
        for a in range(3):
            for b in range(3):
                value = widened * (
                    other * basis[a, 0] * basis[b, 0]
                    + one * basis[a, 1] * basis[b, 1]
                    - both * (basis[a, 0] * basis[b, 1] + basis[a, 1] * basis[b, 0])
                )
                for k in range(shared.shape[2]):
                    value += errors[a, k] * errors[b, k]
                covariance[number, a, b] = value
        for a in range(3):
            # The fit knows a line; in which sense the points move along it, they vote.
            direction[number, a] = -e[a] if votes < 0.0 else e[a]


@compiled
def _list_usable(xy: Floats, w: Floats, info: Floats, members: Ints, points: Floats, usable: Ints) -> int:
    """Fill ``points (11, M)``, side by side: the numbers of a point (`_N_POINT`), of those that say anything.

    Returns how many these are, and fills which, ``usable (M,)``.
    """
    n = 0
    for i in members:
        # A sum is finite where all of its terms are.
        has_velocity = np.isfinite(w[i, 0] + w[i, 1] + w[i, 2])
        if not (has_velocity and info[i, 0, 0] + info[i, 1, 1] + info[i, 2, 2] > 0.0):
            continue
        points[0, n], points[1, n], points[2, n] = w[i, 0], w[i, 1], w[i, 2]
        points[3, n], points[4, n], points[5, n] = info[i, 0, 0], info[i, 0, 1], info[i, 0, 2]
        points[6, n], points[7, n], points[8, n] = info[i, 1, 1], info[i, 1, 2], info[i, 2, 2]
        points[9, n], points[10, n] = xy[i, 0], xy[i, 1]
        usable[n] = i
        n += 1
    return n


@compiled
def _begin(points: Floats, n: int, e: Floats, basis: Floats, normal: Floats, score: Floats, off: Floats) -> None:
    """Fill ``e`` with the better of two guesses, by the median misfit of the first n points.

    The main axis of their velocities, each counted by how well it is known; and where the lines meet along which they
    move in the picture. Of single tracks the former knows little: brakes are taken for depth, which turns the velocity
    of each point towards its own ray, so that the descent ended in a minimum near the thing itself. The lines stay.
    """
    spread, lines, cofactors = np.zeros((3, 3)), np.zeros((3, 3)), np.empty((3, 3))
    w, ray, across, pull = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    ray[2] = 1.0
    for c in range(n):
        ray[0], ray[1] = points[9, c], points[10, c]
        for a in range(3):
            w[a] = points[a, c]
        _times(points, c, w[0], w[1], w[2], pull)
        known, length2, line2 = 0.0, 1e-300, 1e-300
        for a in range(3):
            known, length2 = known + pull[a] * w[a], length2 + w[a] * w[a]
            # The line is normal to the ray of the point and to its velocity.
            b, d = (a + 1) % 3, (a + 2) % 3
            across[a] = ray[b] * w[d] - ray[d] * w[b]
            line2 += across[a] * across[a]
        _times(points, c, across[0], across[1], across[2], pull)
        sure = (across[0] * pull[0] + across[1] * pull[1] + across[2] * pull[2]) / line2
        for a in range(3):
            for b in range(3):
                spread[a, b] += known / length2 * w[a] * w[b]
                lines[a, b] += sure * across[a] * across[b]
    for a in range(3):
        for b in range(3):
            i, j, k, m = (a + 1) % 3, (a + 2) % 3, (b + 1) % 3, (b + 2) % 3
            cofactors[a, b] = lines[i, k] * lines[j, m] - lines[i, m] * lines[j, k]
    _fill_main_axis(cofactors, e)
    _tangents(e, basis)
    _add_up(points, n, e, basis, normal, score, off)
    misfit = median(off[:n])
    _fill_main_axis(spread, w)
    _tangents(w, basis)
    _add_up(points, n, w, basis, normal, score, off)
    if median(off[:n]) <= misfit:
        for a in range(3):
            e[a] = w[a]


@compiled
def _fill_main_axis(matrix: Floats, axis: Floats) -> None:
    """Fill ``axis (3,)`` with the main axis of a symmetric ``matrix (3, 3)``, which is changed."""
    square = np.empty((3, 3))
    for _ in range(_SQUARINGS):
        scale = 1.0 / max(matrix[0, 0] + matrix[1, 1] + matrix[2, 2], 1e-300)
        for a in range(3):
            for b in range(3):
                square[a, b] = (
                    matrix[a, 0] * matrix[0, b] + matrix[a, 1] * matrix[1, b] + matrix[a, 2] * matrix[2, b]
                ) * (scale * scale)
        matrix, square = square, matrix
    best = 0
    for a in range(1, 3):
        best = a if matrix[a, a] > matrix[best, best] else best
    x, y, z = matrix[best, 0], matrix[best, 1], matrix[best, 2]
    length = np.sqrt(x * x + y * y + z * z)
    if length > 0.0:
        axis[0], axis[1], axis[2] = x / length, y / length, z / length
    else:
        axis[0], axis[1], axis[2] = 0.0, 0.0, 1.0


@compiled
def _tangents(e: Floats, basis: Floats) -> None:
    """Fill ``basis (3, 2)`` with two unit vectors normal to ``e`` and to each other.

    Not those of `rotation.tangent_basis`: any will do here, and `_add_up` and `_fit_each` use one and the same.
    """
    least = 0
    for a in range(1, 3):
        least = a if abs(e[a]) < abs(e[least]) else least
    after, last = (least + 1) % 3, (least + 2) % 3
    length = np.sqrt(e[after] * e[after] + e[last] * e[last])
    basis[least, 0], basis[after, 0], basis[last, 0] = 0.0, -e[last] / length, e[after] / length
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        basis[a, 1] = e[b] * basis[c, 0] - e[c] * basis[b, 0]


@compiled
def _add_up(points: Floats, n: int, e: Floats, basis: Floats, normal: Floats, score: Floats, chi2: Floats) -> float:
    """Fill normal matrix (2, 2), score (2,) and ``chi2 (M,)`` of the first n points; returns the vote.

    The best rate of a point is ``s = e' info w / e' info e``. Its residual r = w - s e follows e by
    ``-s (I - e e' info / e' info e)``: with info e r = 0, the score along a tangent b is s b' info r, and the
    information on two tangents b, c is s^2 (b' info c - (b' info e)(c' info e) / e' info e). Without a branch: several
    points are worked at side by side.
    """
    ex, ey, ez = e[0], e[1], e[2]
    ux, uy, uz, vx, vy, vz = basis[0, 0], basis[1, 0], basis[2, 0], basis[0, 1], basis[1, 1], basis[2, 1]
    n00 = n10 = n11 = s0 = s1 = votes = 0.0
    for c in range(n):
        wx, wy, wz, xx, xy, xz = points[0, c], points[1, c], points[2, c], points[3, c], points[4, c], points[5, c]
        yy, yz, zz = points[6, c], points[7, c], points[8, c]
        along_x, along_y, along_z = (
            xx * ex + xy * ey + xz * ez,
            xy * ex + yy * ey + yz * ez,
            xz * ex + yz * ey + zz * ez,
        )
        square = along_x * ex + along_y * ey + along_z * ez
        # Where a point says nothing of its rate, it says nothing.
        inverse = 1.0 / square if square > 0.0 else 0.0
        rate = (along_x * wx + along_y * wy + along_z * wz) * inverse
        votes += min(max(rate * np.sqrt(max(square, 0.0)), -_MAX_VOTE_SIGMAS), _MAX_VOTE_SIGMAS)
        x, y, z = wx - rate * ex, wy - rate * ey, wz - rate * ez
        off_x, off_y, off_z = xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z
        chi2[c] = x * off_x + y * off_y + z * off_z if square > 0.0 else 0.0
        weighted = rate / (1.0 + chi2[c] * (1.0 / (_CAUCHY_SIGMAS * _CAUCHY_SIGMAS)))
        mean_u = (along_x * ux + along_y * uy + along_z * uz) * inverse
        mean_v = (along_x * vx + along_y * vy + along_z * vz) * inverse
        from_u = (xx * ux + xy * uy + xz * uz) * ux + (xy * ux + yy * uy + yz * uz) * uy
        from_u += (xz * ux + yz * uy + zz * uz) * uz
        px, py, pz = xx * vx + xy * vy + xz * vz, xy * vx + yy * vy + yz * vz, xz * vx + yz * vy + zz * vz
        s0 += weighted * (off_x * ux + off_y * uy + off_z * uz)
        s1 += weighted * (off_x * vx + off_y * vy + off_z * vz)
        both = weighted * rate
        n00 += both * (from_u - mean_u * mean_u * square)
        n10 += both * (px * ux + py * uy + pz * uz - mean_u * mean_v * square)
        n11 += both * (px * vx + py * vy + pz * vz - mean_v * mean_v * square)
    normal[0, 0], normal[1, 0], normal[0, 1], normal[1, 1], score[0], score[1] = n00, n10, n10, n11, s0, s1
    return votes


@compiled
def _add_up_shared(
    points: Floats,
    n: int,
    usable: Ints,
    shared: Floats,
    e: Floats,
    basis: Floats,
    chi2: Floats,
    mixed: Floats,
) -> None:
    """Fill ``mixed (2, E)``: what the errors ``shared (N, 3, E)`` do to the score of the first n points (`_add_up`)."""
    mixed[:] = 0.0
    along, pull = np.empty(3), np.empty(3)
    for c in range(n if shared.shape[2] else 0):
        i = usable[c]
        _times(points, c, e[0], e[1], e[2], along)
        square = along[0] * e[0] + along[1] * e[1] + along[2] * e[2]
        if not square > 0.0:
            continue
        rate = (along[0] * points[0, c] + along[1] * points[1, c] + along[2] * points[2, c]) / square
        weighted = rate / (1.0 + chi2[c] / (_CAUCHY_SIGMAS * _CAUCHY_SIGMAS))
        for j in range(2):
            _times(points, c, basis[0, j], basis[1, j], basis[2, j], pull)
            mean = (along[0] * basis[0, j] + along[1] * basis[1, j] + along[2] * basis[2, j]) / square
            for a in range(3):
                for k in range(shared.shape[2]):
                    mixed[j, k] += weighted * (pull[a] - mean * along[a]) * shared[i, a, k]


@compiled
def _times(points: Floats, c: int, x: float, y: float, z: float, product: Floats) -> None:
    """Fill ``product (3,)``: the information of point c times a vector."""
    product[0] = points[3, c] * x + points[4, c] * y + points[5, c] * z
    product[1] = points[4, c] * x + points[6, c] * y + points[7, c] * z
    product[2] = points[5, c] * x + points[7, c] * y + points[8, c] * z
