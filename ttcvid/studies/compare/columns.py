"""Joined rows of two results, judged column by column."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from ttcvid.geometry.estimation.intervals import NORMAL_90_SIGMAS, REGION_90_SIGMAS
from ttcvid.model import Bools, Floats, Ints
from ttcvid.schema import TABLES, Column
from ttcvid.studies.compare.tolerance import NOT_JUDGED, ColumnTolerance, Tolerance

N_WORST = 5
EXPLAINED_SHARE = 0.8
"""A change of sign, factor or offset is named where it explains this share of the rows that are large enough."""
UNEXPLAINED_SHARE = 0.5
"""A factor or offset is named only if it leaves less than this share of the typical difference."""
_ALIKE = 1e-6
MIN_EXPLAINED_ROWS = 4
_MOST_ROWS = 0.5
_OBJECT_TIMES = ("ttc_z_s", "tcpa_s", "miss_s")


@dataclass(frozen=True)
class JoinedRows:
    """Rows of one part of the tables that correspond to each other in both results.

    ``baseline`` and ``run`` have the same length and order, null is NaN. ``who`` names the object of each row beyond
    its frame ("object 2"; empty where the frame says all), after ``prefix``; ``frame`` and ``t_s`` are the baseline's.
    """

    part: str
    frame: Ints
    t_s: Floats
    who: np.ndarray
    baseline: pd.DataFrame
    run: pd.DataFrame
    prefix: str = ""


@dataclass(frozen=True)
class WorstRow:
    """One row of a column: ``ratio`` is difference over tolerance, infinite where a value is on one side only."""

    frame: int
    t_s: float
    who: str
    baseline: str
    run: str
    ratio: float


@dataclass(frozen=True)
class ColumnVerdict:
    """What became of one column of a part.

    ``n_outside`` of the ``n_rows`` rows with a value on either side differ by more than the tolerance; ``typical`` is
    the median of difference over tolerance. ``hint`` names what explains the difference, where something simple does.
    ``worst`` has the worst rows.
    """

    part: str
    column: str
    unit: str
    n_rows: int
    n_outside: int
    typical: float
    is_same: bool
    hint: str
    worst: tuple[WorstRow, ...]

    @property
    def name(self) -> str:
        """``table.column``, with the part of the table where it has parts."""
        return f"{self.part}.{self.column}"


def judge_columns(rows: JoinedRows, tolerance: Tolerance, focal_px: tuple[float, float] | None) -> list[ColumnVerdict]:
    """Judge every column that both sides hold, those aside that only name rows.

    ``focal_px`` (fx, fy) gives epipole pixels their sigma; None: unknown.
    """
    return [
        judge_column(rows, column, tolerance, focal_px)
        for column in TABLES[rows.part.partition(".")[0]]
        if column.name in rows.baseline and column.name in rows.run and is_judged(rows.part, column.name)
    ]


def judge_column(
    rows: JoinedRows, column: Column, tolerance: Tolerance, focal_px: tuple[float, float] | None
) -> ColumnVerdict:
    """Judge one column: how many rows are outside of the tolerance, and how large the typical difference is."""
    baseline, run = rows.baseline[column.name], rows.run[column.name]
    if column.unit == "":
        ratio = np.where(_is_same_name(baseline, run), 0.0, np.inf)
        return _verdict(rows, column, tolerance, ratio)
    before, now = _told(rows.baseline, column.name), _told(rows.run, column.name)
    limits = tolerance.of_column(rows.part, column.name)
    allowed = allowed_difference(before, now, limits, reported_sigma(rows.baseline, column.name, focal_px))
    ratio = difference_ratio(before, now, allowed)
    if limits.may_be_null:
        ratio[np.isnan(before) | np.isnan(now)] = 0.0
    verdict = _verdict(rows, column, tolerance, ratio)
    return verdict if verdict.is_same else replace(verdict, hint=explanation(before, now, allowed, judged_unit(column)))


def complaints_about_times(
    rows: JoinedRows, numbers: Collection[int], columns: Collection[str], tolerance: Tolerance
) -> list[str]:
    """What to say of single objects, of those with ``numbers``, most of whose times are outside of the tolerance.

    One among many that are as before does not make a column different; ``columns`` are those that are the same.
    """
    complaints = []
    for name in (name for name in _OBJECT_TIMES if name in columns):
        before, now = (_told(side, name) for side in (rows.baseline, rows.run))
        limits = tolerance.of_column(rows.part, name)
        allowed = allowed_difference(before, now, limits, reported_sigma(rows.baseline, name, None))
        is_outside = difference_ratio(before, now, allowed) > 1
        has_value = ~(np.isnan(before) & np.isnan(now))
        for number in numbers:
            own = has_value & (rows.who == number)
            if own.sum() >= MIN_EXPLAINED_ROWS and np.mean(is_outside[own]) > _MOST_ROWS:
                hint = explanation(before[own], now[own], allowed[own], "1/s" if name == "ttc_z_s" else "s")
                what = f"object {number}: {name} is different in {is_outside[own].sum()} of {own.sum()} rows"
                complaints.append(what + (f": {hint}" if hint else ""))
    return complaints


def _told(table: pd.DataFrame, name: str) -> Floats:
    """`judged_values` of a column; of ttc_z the middle of its interval where only that is told.

    An object's value comes and goes where its interval comes to reach infinity: no difference by itself.
    """
    values = judged_values(name, table[name])
    if name == "ttc_z_s" and {"ttc_z_lo_s", "ttc_z_hi_s"} <= set(table):
        ends = (judged_values("ttc_z", table[f"ttc_z_{end}_s"]) for end in ("lo", "hi"))
        values = np.where(np.isnan(values), sum(ends) / 2.0, values)
    return values


def judged_values(name: str, values: pd.Series) -> Floats:
    """The values ``(N,)`` in which a column is judged: ttc_z and its ends as 1/time, all others as they are."""
    numbers = values.to_numpy(float)
    if not name.startswith(("ttc_z", "min_ttc_z")):
        return numbers
    with np.errstate(divide="ignore"):
        return np.asarray(1 / numbers)


def judged_unit(column: Column) -> str:
    """The unit of `judged_values`."""
    return "1/s" if column.name.startswith(("ttc_z", "min_ttc_z")) else "" if column.unit == "1" else column.unit


def reported_sigma(table: pd.DataFrame, name: str, focal_px: tuple[float, float] | None) -> Floats:
    """Standard deviation ``(N,)`` that a result itself states of a column, in the units of `judged_values`.

    From the covariance or the 90 % interval beside the value; of an element of a covariance, what its two variances
    allow it to be. NaN where nothing is stated, or the interval has no end.
    """
    nothing = np.full(len(table), np.nan)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        if name.startswith("rot_") and name != "rot_sigma_rad" and "rot_sigma_rad" in table:
            return table.rot_sigma_rad.to_numpy(float)
        if _variance_of(name) in table:
            return np.asarray(np.sqrt(table[_variance_of(name)].to_numpy(float)))
        if name.startswith("cov_"):
            first, second = (f"cov_{axis}{axis}" for axis in name[-2:])
            is_there = first in table and second in table
            return np.sqrt(table[first].to_numpy(float) * table[second].to_numpy(float)) if is_there else nothing
        if name in ("x_px", "y_px", "horizon_offset_px") and {"dir_z", "cov_zz"} <= set(table):
            axis = "x" if name == "x_px" else "y"
            return nothing if focal_px is None else _epipole_sigma_px(table, axis, focal_px)
        return _interval_sigma(table, name)


def _variance_of(name: str) -> str:
    if name.startswith("dir_"):
        return f"cov_{name[-1] * 2}"
    return f"cov_{name[0] * 2}" if name in ("a_hz", "b_hz", "c_hz") else ""


def _epipole_sigma_px(table: pd.DataFrame, axis: str, focal_px: tuple[float, float]) -> Floats:
    """Of f dir_x / dir_z, to first order, from the covariance of dir.

    What x and z have in common follows from the three variances, which is all that a baseline keeps: the covariance
    lies in the plane normal to dir, so that cov_xx dir_x^2 + cov_zz dir_z^2 + 2 cov_xz dir_x dir_z = cov_yy dir_y^2.
    """
    other = "xy"[axis == "x"]
    along, across, depth = (table[f"dir_{name}"].to_numpy(float) for name in (axis, other, "z"))
    own, of_other, of_depth = (table[f"cov_{name * 2}"].to_numpy(float) for name in (axis, other, "z"))
    twice_both = (of_other * across**2 - own * along**2 - of_depth * depth**2) / depth**2
    variance = own - twice_both + of_depth * (along / depth) ** 2
    return np.asarray(focal_px["xy".index(axis)] * np.sqrt(variance) / np.abs(depth))


def _interval_sigma(table: pd.DataFrame, name: str) -> Floats:
    stem = "tcpa" if name == "k_frames" else name.removesuffix("_s").removesuffix("_lo").removesuffix("_hi")
    if not {f"{stem}_lo_s", f"{stem}_hi_s"} <= set(table):
        return np.full(len(table), np.nan)
    low, high = (judged_values(stem, table[f"{stem}_{end}_s"]) for end in ("lo", "hi"))
    sigma = np.abs(high - low) / (2 * (NORMAL_90_SIGMAS if stem == "ttc_z" else REGION_90_SIGMAS))
    if name == "k_frames":
        with np.errstate(invalid="ignore", divide="ignore"):
            sigma = sigma * np.abs(table.k_frames.to_numpy(float) / table.tcpa_s.to_numpy(float))
    return np.asarray(sigma)


def allowed_difference(before: Floats, now: Floats, limits: ColumnTolerance, sigma: Floats) -> Floats:
    """The tolerance ``(N,)`` of each row: the largest of the three kinds."""
    of_size = np.fmax(limits.abs, limits.rel * np.fmax(np.abs(before), np.abs(now)))
    return np.asarray(np.fmax(of_size, limits.sigmas * sigma))


def difference_ratio(before: Floats, now: Floats, allowed: Floats) -> Floats:
    """Difference over tolerance ``(N,)``; 0 for equal values or nulls, infinite for a value on one side only."""
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.abs(now - before) / allowed
    is_equal = (before == now) | (np.isnan(before) & np.isnan(now))
    return np.where(is_equal, 0.0, np.where(np.isnan(ratio), np.inf, ratio))


def explanation(before: Floats, now: Floats, allowed: Floats, unit: str) -> str:
    """What simple change turns ``before (N,)`` into ``now (N,)`` within the tolerances; empty where none does.

    >>> x = np.linspace(1.0, 2.0, 9)
    >>> explanation(x, -x, np.full(9, 0.01), "rad"), explanation(x, x + 5, np.full(9, 0.01), "px")
    ('the sign is swapped', 'offset +5 px')
    """
    is_there = np.isfinite(before) & np.isfinite(now) & np.isfinite(allowed)
    before, now, allowed = before[is_there], now[is_there], allowed[is_there]
    is_large = np.abs(before) > allowed
    if is_large.sum() >= MIN_EXPLAINED_ROWS and _explains(-before[is_large], now[is_large], allowed[is_large]):
        return "the sign is swapped"
    if len(before) < MIN_EXPLAINED_ROWS:
        return ""
    offset = float(np.median(now - before))
    factor = float(np.median(now[is_large] / before[is_large])) if is_large.any() else 1.0
    left, of_offset, of_factor = (_typical(now - model) for model in (before, before + offset, before * factor))
    if min(of_offset, of_factor) >= UNEXPLAINED_SHARE * left:
        return ""
    # Of values that are all alike, an offset and a factor say the same: then the offset.
    if of_offset <= of_factor + _ALIKE * left:
        return f"offset {offset:+.3g} {unit}".rstrip() if _explains(before + offset, now, allowed) else ""
    return f"factor {factor:.6g}" if _explains(before * factor, now, allowed) else ""


def _typical(differences: Floats) -> float:
    return float(np.median(np.abs(differences)))


def _explains(model: Floats, now: Floats, allowed: Floats) -> bool:
    return bool(np.mean(np.abs(now - model) <= allowed) >= EXPLAINED_SHARE)


def is_judged(part: str, column: str) -> bool:
    """Whether a column is judged, or only names rows."""
    return column not in NOT_JUDGED or (part, column) in (("frames", "t_s"), ("collision_times", "cluster_id"))


def _is_same_name(baseline: pd.Series, run: pd.Series) -> Bools:
    if isinstance(baseline.dtype, pd.CategoricalDtype) and baseline.dtype == run.dtype:
        return np.asarray(baseline.cat.codes.to_numpy() == run.cat.codes.to_numpy())
    return np.asarray(baseline.astype(str).to_numpy() == run.astype(str).to_numpy())


def _verdict(rows: JoinedRows, column: Column, tolerance: Tolerance, ratio: Floats) -> ColumnVerdict:
    limits, own = tolerance.parts[rows.part], tolerance.of_column(rows.part, column.name)
    max_share = limits.max_share if own.max_share is None else own.max_share
    max_typical = limits.typical if own.typical is None else own.typical
    n_rows = int(np.sum(has_value := rows.baseline[column.name].notna() | rows.run[column.name].notna()))
    n_outside = int((ratio > 1).sum())
    typical = float(np.median(ratio[has_value])) if n_rows else 0.0
    is_same = n_outside <= max_share * n_rows and typical <= max_typical
    return ColumnVerdict(
        part=rows.part,
        column=column.name,
        unit="" if column.unit == "1" else column.unit,
        n_rows=n_rows,
        n_outside=n_outside,
        typical=typical,
        is_same=is_same,
        hint="",
        worst=tuple(_worst_row(rows, column.name, int(row), float(ratio[row])) for row in _worst(ratio)),
    )


def _worst(ratio: Floats) -> Ints:
    """Rows with the largest ratios, those without a difference left out; sorting all of them would take longest."""
    rows = np.flatnonzero(ratio > 0)
    if len(rows) > N_WORST:
        least = np.partition(ratio[rows], -N_WORST)[-N_WORST]
        rows = rows[ratio[rows] >= least]
    return np.asarray(rows[np.argsort(-ratio[rows], kind="stable")][:N_WORST])


def _worst_row(rows: JoinedRows, name: str, row: int, ratio: float) -> WorstRow:
    before, now = (shown(side[name].iloc[row]) for side in (rows.baseline, rows.run))
    return WorstRow(int(rows.frame[row]), float(rows.t_s[row]), f"{rows.prefix}{rows.who[row]}", before, now, ratio)


def shown(value: object) -> str:
    """A value of a table as text; null for a missing one.

    >>> shown(0.123456789), shown(float("nan")), shown("ok")
    ('0.123457', 'null', 'ok')
    """
    if isinstance(value, float | np.floating):
        return "null" if np.isnan(value) else f"{value:.6g}"
    return str(value)
