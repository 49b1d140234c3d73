"""A comparison in words, as JSON and as JUnit test cases."""

from __future__ import annotations

import math
from typing import Any

from ttcvid.studies.compare.columns import ColumnVerdict, WorstRow
from ttcvid.studies.compare.results import Comparison, PartSummary

MAX_COMPLAINTS = 10
"""Of one part, in words; JSON has all of them."""


def describe_comparison(comparison: Comparison) -> list[str]:
    """What was made differently, a summary of each part, what is different with its worst rows, and the verdict."""
    parts = [describe_part(part, comparison) for part in comparison.parts]
    return [*describe_changes(comparison), *parts, *describe_differences(comparison), verdict(comparison)]


def describe_changes(comparison: Comparison) -> list[str]:
    """What the two were made with differently, a line each."""
    lines = [f"changed: {change.name}: {change.baseline} -> {change.run}" for change in comparison.changes]
    return [*lines, *(f"note: {note}" for note in comparison.notes)]


def describe_differences(comparison: Comparison) -> list[str]:
    """What is missing or additional, and each column that is different with its worst rows."""
    lines = []
    for part in comparison.parts:
        lines += [f"DIFFERENT {part.part}: {text}" for text in part.complaints[:MAX_COMPLAINTS]]
        if len(part.complaints) > MAX_COMPLAINTS:
            lines.append(f"DIFFERENT {part.part}: ... and {len(part.complaints) - MAX_COMPLAINTS} more")
    for column in comparison.columns:
        if not column.is_same:
            lines.append(f"DIFFERENT {describe_column(column)}")
            lines += [f"    {describe_row(row, column.unit)}" for row in column.worst]
    return lines


def verdict(comparison: Comparison) -> str:
    """One line: same, or how much is different."""
    if comparison.is_same:
        return f"same: {comparison.run} and {comparison.baseline}"
    return f"different: {comparison.run} and {comparison.baseline}: {reasons(comparison)}"


def reasons(comparison: Comparison) -> str:
    """In which columns two results are different, and what is missing or additional, in short."""
    columns = [column.name for column in comparison.columns if not column.is_same]
    others = [text for part in comparison.parts for text in part.complaints]
    parts = [f"{len(columns)} of {len(comparison.columns)} columns ({_some(columns)})"] if columns else []
    return "; ".join([*others[:2], *([f"{len(others) - 2} more"] if len(others) > 2 else []), *parts])


def describe_part(part: PartSummary, comparison: Comparison) -> str:
    """One line: how many rows were joined, and in how many columns they are the same."""
    columns = [column for column in comparison.columns if column.part == part.part]
    n_same = sum(column.is_same for column in columns)
    is_same = n_same == len(columns) and not part.complaints
    rows = f"{part.n_joined} joined of {part.n_baseline} and {part.n_run}"
    if part.n_counted is not None:
        before, now = part.n_counted
        counted = str(before) if before == now else f"{before} and {now}"
        rows = f"{part.n_baseline} and {part.n_run} objects, {counted} counted, {part.n_joined} found again"
    return (
        f"{part.part:<16}  {'same' if is_same else 'DIFFERENT':<9}  {rows}, {n_same} of {len(columns)} columns the same"
    )


def describe_column(column: ColumnVerdict) -> str:
    """One line: how many rows are outside, how large the typical difference is, and what explains it."""
    share = f"{column.n_outside} of {column.n_rows} rows outside the tolerance"
    hint = f": {column.hint}" if column.hint else ""
    return f"{column.name}{hint} ({share}, typical difference {_times(column.typical)})"


def describe_row(row: WorstRow, unit: str) -> str:
    """One line: where, and both values."""
    who = f" {row.who}" if row.who else ""
    values = f"{row.baseline} -> {row.run} {unit}".rstrip()
    return f"frame {row.frame} ({row.t_s:.3f} s){who}: {values}, {_times(row.ratio)}"


def comparison_as_json(comparison: Comparison) -> dict[str, Any]:
    """Everything, ready for JSON: infinite ratios are null."""
    return {
        "baseline": comparison.baseline,
        "run": comparison.run,
        "is_same": comparison.is_same,
        "changes": [vars(change) for change in comparison.changes],
        "notes": list(comparison.notes),
        "parts": [{**vars(part), "complaints": list(part.complaints)} for part in comparison.parts],
        "columns": [_column_as_json(column) for column in comparison.columns],
    }


def comparison_cases(comparison: Comparison) -> list[tuple[str, list[str]]]:
    """Names and failures of what was judged, a case for each part and each column."""
    cases = [(part.part, list(part.complaints)) for part in comparison.parts]
    for column in comparison.columns:
        rows = [describe_row(row, column.unit) for row in column.worst]
        cases.append((column.name, [] if column.is_same else [describe_column(column), *rows]))
    return cases


def _column_as_json(column: ColumnVerdict) -> dict[str, Any]:
    worst = [{**vars(row), "ratio": _finite(row.ratio)} for row in column.worst]
    return {**vars(column), "name": column.name, "typical": _finite(column.typical), "worst": worst}


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _times(ratio: float) -> str:
    return f"{ratio:.3g} x the tolerance" if math.isfinite(ratio) else "not to be measured"


def _some(names: list[str], n_shown: int = 5) -> str:
    return ", ".join(names[:n_shown]) + (", ..." if len(names) > n_shown else "")
