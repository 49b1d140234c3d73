"""Slanted surfaces: how their depth changes over the picture, and which part of them is nearest."""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled, compiled_for
from ttcvid.geometry.kernels.medians import at_rank, median
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.tracking.groups import TrackSets

# A slope has two components.
_N_SLOPES = 2
# Tracks within so many of their standard deviations of a plane lie on it.
_PLANE_SIGMAS = 2.0
# A plane through two sides of an object lies on neither. Refit this often, with the inliers' own scatter as
# tolerance, it settles on the side that more tracks show. The scatter is never less than this part of the assumed
# unevenness of surfaces: 0.5 % of the distance.
_LOOKS, _LEAST_FLATNESS = 4, 0.2
# Standard deviation of a Gaussian over its median deviation.
_BY_MEDIAN = 1.4826
# The nearest is this part of what is seen of a thing, with what lies behind that by no more than this part of the
# distance.
_NEAREST_PART, _DEPTH_PART = 0.1, 0.01
# A plane is looked at in so many places along each side of the box around its tracks.
_PLACES = 10
# Tracks whose spread across a line is this part of that along it tell no slope across.
_LEAST_SPREAD_PART = 1e-3
# The side that a thing shows us while it turns stands at some angle, of up to 45 deg: the slope of the rate over the
# rate is its tangent (standard deviation, per component).
_SLOPE_OF_TURNING = 0.5
# Least that a surface is not flat by, 1/s.
_TINY = 1e-12
# Numbers that tell a plane: its middle (x, y) and the rate there, its slope (x, y), and of the covariance of these the
# variance of the rate and xx, xy, yy of the slope.
_N_PLANE = 9


def nearest_parts(
    sets: TrackSets,
    rate_hz: Floats,
    own_hz: Floats,
    sigma_hz: Floats,
    by_shared: Floats,
    shared_cov: Floats,
    xy: Floats,
    needed: Ints,
    is_in: Bools,
    turns: Bools,
) -> tuple[Bools, Floats, Floats, Floats]:
    """The nearest parts of those surfaces that slope away from us; other surfaces as they are.

    Inverse depths on a plane are linear in the picture. A plane through the tracks of a surface finds the others that
    lie on it, and with them the part of it that is hit first, a tenth of what is seen; to ask the tracks themselves for
    that would take those with the largest errors, or where they crowd.

    Parameters
    ----------
    sets : tracks of K objects.
    rate_hz, xy : (M,), (M, 2) rates, speed over depth, and places.
    own_hz, sigma_hz : (M,) standard deviations of the rates by noise, and by noise and what surfaces are not flat by.
    by_shared, shared_cov : (M, n) and (K, n, n), what errors that tracks share do to their rates: a wrong turn looks
        like a slope.
    needed : (K,) tracks that bear a plane.
    is_in : (M,) those on the nearest surface.
    turns : (K,) objects that turn.

    Returns
    -------
    which tracks bear the nearest part (M,), by how much the plane's mean rate there is above that of each (M,), 1/s,
    the variance (K,) of that, 1/s^2, both zero where nothing slopes, and its centre (K, 2), NaN there.
    """
    is_near, above_hz, variance = is_in.copy(), np.zeros(len(rate_hz)), np.zeros(len(sets))
    centre = np.full((len(sets), 2), np.nan)
    _find_each(
        rate_hz,
        own_hz,
        sigma_hz,
        by_shared,
        shared_cov,
        np.ascontiguousarray(xy),
        sets.first,
        sets.lengths,
        needed,
        turns,
        is_near,
        above_hz,
        variance,
        centre,
    )
    return is_near, above_hz, variance, centre


@compiled_for(
    "(i8[::1], b1[::1], i8[::1], f8[::1], UniTuple(f8[:, ::1], 2), f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1])"
)
def move_to_centres(
    lengths: Ints,
    is_near: Bools,
    counts: Ints,
    weight: Floats,
    places: tuple[Floats, Floats],
    centre: Floats,
    turn_rad_s: Floats,
    abc_hz: Floats,
    ref_px: Floats,
) -> None:
    """Moves states ``abc_hz (K, 3)`` and pixels ``ref_px (K, 2)`` from the tracks to the centres of nearest parts.

    Tracks crowd, or are missing, anywhere in it, and each place of what turns has a velocity of its own. The rates are
    those of the centres already.

    Parameters
    ----------
    lengths : (K,) how many of the tracks each set has, of which those that are ``is_near (M,)`` bear its nearest part.
    counts, weight : how many tracks each state is the mean of, (K,), and with what weights, state by state.
    places : of all tracks, (M, 2) in the plane z = 1 and (M, 2) in the picture.
    centre, turn_rad_s : (K, 2) as of `nearest_parts`, and (K, 3).
    """
    low, first = 0, 0
    for k in range(len(lengths)):
        high, q = low + lengths[k], first
        if np.isfinite(centre[k, 0]):
            step = centre[k].copy()
            for i in range(low, high):
                if is_near[i]:
                    for j in range(2):
                        step[j] -= weight[q] * places[0][i, j]
                    q += 1
            for j in range(2):
                spread = _extent(places[0], j, low, high)
                if spread > 0.0:
                    ref_px[k, j] += step[j] * _extent(places[1], j, low, high) / spread
            abc_hz[k, 0] -= turn_rad_s[k, 2] * step[1]
            abc_hz[k, 1] += turn_rad_s[k, 2] * step[0]
            abc_hz[k, 2] += turn_rad_s[k, 0] * step[1] - turn_rad_s[k, 1] * step[0]
        low, first = high, first + counts[k]


@compiled
def _extent(places: Floats, j: int, low: int, high: int) -> float:
    """From the least to the greatest coordinate j of the places from one to another."""
    least, most = np.inf, -np.inf
    for i in range(low, high):
        least, most = min(least, places[i, j]), max(most, places[i, j])
    return most - least


@compiled_for(
    "(f8[::1], f8[::1], f8[::1], f8[:, ::1], f8[:, :, ::1], f8[:, ::1], i8[::1], i8[::1], i8[::1], b1[::1], "
    "b1[::1], f8[::1], f8[::1], f8[:, ::1])"
)
def _find_each(
    rate: Floats,
    own: Floats,
    sigma: Floats,
    by_shared: Floats,
    shared_cov: Floats,
    xy: Floats,
    first: Ints,
    lengths: Ints,
    needed: Ints,
    turns: Bools,
    is_near: Bools,
    above: Floats,
    variance: Floats,
    centre: Floats,
) -> None:
    """Fills the results of `nearest_parts`, set by set; ``is_near (M,)`` tells the surfaces when it comes."""
    plane, again, on_plane = np.empty(_N_PLANE), np.empty(len(rate), dtype=np.bool_), np.empty(len(rate))
    for k in range(len(first)):
        low, high = first[k], first[k] + lengths[k]
        of_set = (rate[low:high], own[low:high], sigma[low:high], by_shared[low:high], xy[low:high])
        cov = shared_cov[k]
        if not _fit(*of_set, cov, is_near[low:high], turns[k], plane):
            continue
        flatness, is_plane = 1.0, False
        for _ in range(_LOOKS):
            count = _mark(*of_set, flatness, plane, again[low:high])
            if count < needed[k] or not _fit(*of_set, cov, again[low:high], turns[k], plane):
                break
            is_plane = True
            flatness = min(flatness, max(_flatness(*of_set, plane, again[low:high]), _LEAST_FLATNESS))
        if not is_plane:
            continue
        count = _mark(*of_set, flatness, plane, again[low:high])
        if count < needed[k]:
            count = _mark(*of_set, 1.0, plane, again[low:high])
        if count < needed[k]:
            continue
        most = -np.inf
        for i in range(low, high):
            on_plane[i] = _rate_at(plane, xy[i]) if again[i] else -np.inf
            most = max(most, on_plane[i])
        part = min(_NEAREST_PART * (high - low) / count, 1.0)
        nearest = _rate_of_nearest(plane, xy[low:high], again[low:high], part, centre[k])
        last = min(nearest, most)
        there = _rate_at(plane, centre[k])
        for i in range(low, high):
            is_near[i] = on_plane[i] >= last - _DEPTH_PART * abs(last)
            if is_near[i]:
                above[i] = there - rate[i]
        dx, dy = centre[k, 0] - plane[0], centre[k, 1] - plane[1]
        variance[k] = plane[5] + dx * dx * plane[6] + 2.0 * dx * dy * plane[7] + dy * dy * plane[8]


@compiled
def _rate_of_nearest(plane: Floats, xy: Floats, is_on: Bools, part: float, centre: Floats) -> float:
    """The rate above which this part of a plane lies, of the box around its tracks in the picture.

    Fills the ``centre (2,)`` of it, with what lies behind it by no more than `_DEPTH_PART`.

    Its area counts and not its tracks: these crowd where there is texture, and are rare where a thing leaves the
    picture.
    """
    left, top, right, low = np.inf, np.inf, -np.inf, -np.inf
    for i in range(len(xy)):
        if is_on[i]:
            left, right = min(left, xy[i, 0]), max(right, xy[i, 0])
            top, low = min(top, xy[i, 1]), max(low, xy[i, 1])
    rates, place = np.empty(_PLACES * _PLACES), np.empty(2)
    for i in range(_PLACES):
        for j in range(_PLACES):
            place[0] = left + (i + 0.5) / _PLACES * (right - left)
            place[1] = top + (j + 0.5) / _PLACES * (low - top)
            rates[i * _PLACES + j] = _rate_at(plane, place)
    found = at_rank(rates.copy(), min(int((1.0 - part) * len(rates)), len(rates) - 1))
    x, y, count = 0.0, 0.0, 0
    for i in range(_PLACES):
        for j in range(_PLACES):
            if rates[i * _PLACES + j] >= found - _DEPTH_PART * abs(found):
                x, y, count = x + (i + 0.5) / _PLACES, y + (j + 0.5) / _PLACES, count + 1
    centre[0], centre[1] = left + x / count * (right - left), top + y / count * (low - top)
    return found


@compiled
def _mark(
    rate: Floats, own: Floats, sigma: Floats, by_shared: Floats, xy: Floats, flatness: float, plane: Floats, lies: Bools
) -> int:
    """Fills ``lies (N,)``: the tracks on the plane, where that is as flat as said (1: as surfaces are); their count."""
    count = 0
    for i in range(len(rate)):
        relief = flatness * _relief(own[i], sigma[i])
        lies[i] = abs(rate[i] - _rate_at(plane, xy[i])) < _PLANE_SIGMAS * np.hypot(own[i], relief)
        count += lies[i]
    return count


@compiled
def _flatness(
    rate: Floats, own: Floats, sigma: Floats, by_shared: Floats, xy: Floats, plane: Floats, is_in: Bools
) -> float:
    """What the median track leaves the plane by, as a standard deviation, over what surfaces are not flat by."""
    count, parts = 0, np.empty(len(rate))
    for i in range(len(rate)):
        if is_in[i]:
            relief = max(_relief(own[i], sigma[i]), _TINY)
            parts[count] = _BY_MEDIAN * abs(rate[i] - _rate_at(plane, xy[i])) / relief
            count += 1
    return median(parts[:count])


@compiled
def _relief(own: float, sigma: float) -> float:
    """What surfaces are not flat by, 1/s: what the standard deviation has beside noise."""
    found: float = np.sqrt(max(sigma * sigma - own * own, 0.0))
    return found


@compiled
def _rate_at(plane: Floats, xy: Floats) -> float:
    rate: float = plane[2] + plane[3] * (xy[0] - plane[0]) + plane[4] * (xy[1] - plane[1])
    return rate


@compiled
def _fit(
    rate: Floats,
    own: Floats,
    sigma: Floats,
    by_shared: Floats,
    xy: Floats,
    shared_cov: Floats,
    is_in: Bools,
    turns: bool,
    plane: Floats,
) -> bool:
    """Fills the ``plane (9,)`` through the tracks that are in; returns whether it slopes at all.

    Weighted least squares. Errors alone make a chi-square of about 2 of the slope: by that part it is drawn towards
    none (Stein's shrinkage), wholly where it has no more. To wait until a slope is sure would say of most that they are
    none, and put the nearest part too far away. What ``turns`` has a slope: there a usual one is what is believed
    before. How flat the surface is, its tracks say: what they scatter by about the plane, no less than noise makes of
    it.
    """
    weights, x, y, mean, noise, count = 0.0, 0.0, 0.0, 0.0, 0.0, 0
    for i in range(len(rate)):
        if is_in[i]:
            w = 1.0 / (sigma[i] * sigma[i])
            weights, x, y, mean, count = weights + w, x + w * xy[i, 0], y + w * xy[i, 1], mean + w * rate[i], count + 1
            noise += w * own[i] * own[i]
    dof = count - 1 - _N_SLOPES
    if dof <= 2:
        return False
    x, y, mean = x / weights, y / weights, mean / weights
    n = by_shared.shape[1]
    xx, xy_, yy, rr = 0.0, 0.0, 0.0, 0.0
    # Along x and along y: first the rates themselves, then what the shared errors do to them.
    along = np.zeros((2, 1 + n))
    for i in range(len(rate)):
        if is_in[i]:
            w, dx, dy, dr = 1.0 / (sigma[i] * sigma[i]), xy[i, 0] - x, xy[i, 1] - y, rate[i] - mean
            xx, xy_, yy, rr = xx + w * dx * dx, xy_ + w * dx * dy, yy + w * dy * dy, rr + w * dr * dr
            along[0, 0] += w * dx * dr
            along[1, 0] += w * dy * dr
            for j in range(n):
                along[0, 1 + j] += w * dx * by_shared[i, j]
                along[1, 1 + j] += w * dy * by_shared[i, j]
    determinant = xx * yy - xy_ * xy_
    if not determinant > (_LEAST_SPREAD_PART * (xx + yy)) ** 2:
        return False
    slope = np.empty_like(along)
    for j in range(1 + n):
        slope[0, j] = (yy * along[0, j] - xy_ * along[1, j]) / determinant
        slope[1, j] = (xx * along[1, j] - xy_ * along[0, j]) / determinant
    gx, gy = slope[0, 0], slope[1, 0]
    left = rr - gx * along[0, 0] - gy * along[1, 0]
    misfit = max(left / dof, noise / count)
    vxx, vxy, vyy = misfit * yy / determinant, -misfit * xy_ / determinant, misfit * xx / determinant
    for j in range(n):
        for m in range(n):
            vxx += slope[0, 1 + j] * shared_cov[j, m] * slope[0, 1 + m]
            vxy += slope[0, 1 + j] * shared_cov[j, m] * slope[1, 1 + m]
            vyy += slope[1, 1 + j] * shared_cov[j, m] * slope[1, 1 + m]
    if turns:
        believed = (_SLOPE_OF_TURNING * mean) ** 2
        bxx, byy = believed + vxx, believed + vyy
        part = believed / (bxx * byy - vxy * vxy)
        plane[0], plane[1], plane[2] = x, y, mean
        plane[3], plane[4] = part * (byy * gx - vxy * gy), part * (bxx * gy - vxy * gx)
        plane[5], plane[7] = misfit / weights, believed * part * vxy
        plane[6], plane[8] = believed * (1.0 - part * byy), believed * (1.0 - part * bxx)
        return True
    chi2 = (vyy * gx * gx - 2.0 * vxy * gx * gy + vxx * gy * gy) / (vxx * vyy - vxy * vxy)
    # The mean of Fisher's F, times the slopes: the scatter is measured.
    by_errors = _N_SLOPES * dof / (dof - 2.0)
    if not chi2 > by_errors:
        return False
    part = 1.0 - by_errors / chi2
    plane[0], plane[1], plane[2], plane[3], plane[4] = x, y, mean, part * gx, part * gy
    plane[5], plane[6], plane[7], plane[8] = misfit / weights, vxx, vxy, vyy
    return True
