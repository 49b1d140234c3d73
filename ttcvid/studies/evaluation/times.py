"""Errors of times: relative, in eta = 1 / time, because times themselves have heavy tails."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ttcvid.model import Bools, Floats

TIMES = ("ttc_z", "tcpa", "miss")
TIME_RANGE_S = (0.1, 20.0)
"""True times, either sign, that are judged: nearer ones are over, of farther ones 1/time is next to nothing."""

Numbers = dict[str, float]


def judge_times(name: str, truth_s: Floats, found: Mapping[str, Any], is_counted: Bools) -> Numbers:
    """How good one of the times is.

    Parameters
    ----------
    name : One of ``TIMES``.
    truth_s : ``(N,)`` true times, NaN where there is none.
    found : Columns ``{name}_s, {name}_lo_s, {name}_hi_s (N,)``, NaN where there is no estimate.
    is_counted : ``(N,)`` rows to judge, among them those in which nothing was found.
    """
    in_range = is_counted & (np.abs(truth_s) >= TIME_RANGE_S[0]) & (np.abs(truth_s) <= TIME_RANGE_S[1])
    found_s = np.column_stack([np.asarray(found[f"{name}{end}_s"], float) for end in ("", "_lo", "_hi")])
    has_value = np.isfinite(found_s[in_range, 0])
    true_s, (value_s, lo_s, hi_s) = truth_s[in_range][has_value], found_s[in_range][has_value].T
    error = relative_error_of_eta(true_s, value_s)
    # An object's interval that reaches infinity stands without a value.
    has_interval = has_value | np.isfinite(found_s[in_range, 1:]).all(axis=1)
    judged = truth_s[in_range][has_interval], *found_s[in_range][has_interval, 1:].T
    numbers = {
        "n": float(len(true_s)),
        "share": _mean(has_value),
        "median": quantile(np.abs(error), 0.5),
        "p90": quantile(np.abs(error), 0.9),
        "bias": quantile(error, 0.5),
        "coverage": _mean(is_within(name, *judged)),
        "half_width": quantile(relative_half_width(name, value_s, lo_s, hi_s), 0.5),
    }
    if name == "miss":
        numbers["abs_median_s"] = _absolute_error_s(truth_s[is_counted], found_s[is_counted, 0])
    else:
        numbers["wrong_sign"] = _mean(value_s * true_s < 0)
    return numbers


def relative_error_of_eta(true_s: Floats, value_s: Floats) -> Floats:
    """``true / estimate - 1``, the error of 1/time relative to the true one; positive: said to come too soon.

    >>> relative_error_of_eta(np.array([4.0, 4.0]), np.array([5.0, -4.0])).round(6).tolist()
    [-0.2, -2.0]
    """
    with np.errstate(divide="ignore"):
        return true_s / value_s - 1.0


def is_within(name: str, true_s: Floats, lo_s: Floats, hi_s: Floats) -> Bools:
    """Whether intervals hold the truth; an end that is NaN is unbounded.

    Those of ttc_z are read in 1/time, where they are connected: lo > hi runs through infinity.
    """
    if name == "ttc_z":
        eta, eta_lo, eta_hi = _reciprocal(true_s, 0.0), _reciprocal(hi_s, -np.inf), _reciprocal(lo_s, np.inf)
        return (eta_lo <= eta) & (eta <= eta_hi)
    return (np.nan_to_num(lo_s, nan=-np.inf) <= true_s) & (true_s <= np.nan_to_num(hi_s, nan=np.inf))


def relative_half_width(name: str, value_s: Floats, lo_s: Floats, hi_s: Floats) -> Floats:
    """Half the length of an interval over its value, that of ttc_z in 1/time; infinite where it is unbounded."""
    if name == "ttc_z":
        lo_s, hi_s, value_s = _reciprocal(hi_s, -np.inf), _reciprocal(lo_s, np.inf), 1.0 / value_s
    lo_s, hi_s = np.nan_to_num(lo_s, nan=-np.inf, neginf=-np.inf), np.nan_to_num(hi_s, nan=np.inf, posinf=np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray((hi_s - lo_s) / 2.0 / np.abs(value_s))


def quantile(values: Floats, share: float) -> float:
    """The value that ``share`` of ``values (N,)`` do not exceed, the mean of the middle two for the median of an even
    number; NaN of nothing.
    """
    if len(values) == 0:
        return float("nan")
    return float(np.median(values)) if share == 0.5 else float(np.quantile(values, share, method="inverted_cdf"))


def _absolute_error_s(truth_s: Floats, found_s: Floats) -> float:
    error_s = np.abs(found_s - truth_s)
    return quantile(error_s[np.isfinite(error_s)], 0.5)


def _reciprocal(value: Floats, missing: float) -> Floats:
    with np.errstate(divide="ignore"):
        return np.where(np.isnan(value), missing, 1.0 / value)


def _mean(values: Bools) -> float:
    return float(np.mean(values)) if len(values) else float("nan")
