"""What a regression suite can expect of a result, in words: read, and held against a result."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from ttcvid.errors import UsageError, counted
from ttcvid.studies.evaluation.metrics import Value, check_from_text
from ttcvid.studies.evaluation.truth import BOX

NEAR_PX = 20.0
"""A place may lie this far outside of an object's box: boxes end at the outermost tracks."""
_NUMBER = r"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?"
_TIMES = ("ttc_z", "tcpa", "miss")
GRAMMAR = (
    "events: none | N | at least N | at most N",
    "ttc_z | tcpa | miss of object at (X, Y) in frame N: V s +- T % | s",
    "horizon y centre: Y +- T",
    "max_rss_mb: N",
    "min_fps_ratio: N",
    "METRIC SIGN NUMBER, as in ttc_z.median <= 0.1",
)
"""Every form of an expectation."""


@dataclass(frozen=True)
class Observed:
    """What expectations are held against.

    ``tables`` of the result; ``horizon_y_px`` at the middle of the picture, undistorted, None where there is none, with
    the ``horizon_reason``; ``max_rss_mb`` the peak of resident memory of the analysis in 10^6 bytes; ``fps_ratio`` the
    frames analysed per second over those recorded per second; ``metrics`` of ``ttcvid evaluate``, None without truth.
    """

    tables: Mapping[str, pd.DataFrame]
    horizon_y_px: float | None
    horizon_reason: str
    max_rss_mb: float
    fps_ratio: float
    metrics: Mapping[str, Value] | None


@dataclass(frozen=True)
class Expectation:
    """One expectation; ``complaint`` gives what is wrong, in words, or nothing."""

    text: str
    complaint: Callable[[Observed], str]
    needs_horizon: bool = False
    needs_metrics: bool = False


def expectation_from_text(text: str, place: str) -> Expectation:
    """Read one expectation; UsageError that names ``place`` where it is none of `GRAMMAR`."""
    text = " ".join(text.split())
    for pattern, make in _FORMS:
        match = re.fullmatch(pattern, text)
        if match is not None:
            return make(text, match)
    if re.match(r"[a-z_]+\.[a-z_0-9]+\s*[<>=!]", text):
        return _metric(text, place)
    raise UsageError(f"{place} {text!r}: expected one of: {'; '.join(GRAMMAR)}")


def _events(text: str, match: re.Match[str]) -> Expectation:
    word, number = match["word"], match["number"]
    least = 0 if word == "at most" or number is None else int(number)
    most = np.inf if word == "at least" else 0 if number is None else int(number)

    def complaint(observed: Observed) -> str:
        events = observed.tables["events"]
        if least <= len(events) <= most:
            return ""
        names = [f"{e.kind} of object {e.cluster_id} at {e.start_s:.2f}-{e.end_s:.2f} s" for e in events.itertuples()]
        return f"{counted(len(events), 'warning')}, expected {text.partition(':')[2].strip()}" + (
            f": {'; '.join(names)}" if names else ""
        )

    return Expectation(text, complaint)


def _time(text: str, match: re.Match[str]) -> Expectation:
    name, frame = match["name"], int(match["frame"])
    place = float(match["x"]), float(match["y"])
    value, allowed = float(match["value"]), float(match["allowed"])
    if match["unit"] == "%":
        allowed *= abs(value) / 100

    def complaint(observed: Observed) -> str:
        row = object_at_place(observed.tables["clusters"], frame, place)
        if isinstance(row, str):
            return row
        found = float(row[f"{name}_s"])
        if abs(found - value) <= allowed:
            return ""
        shown = "null" if np.isnan(found) else f"{found:.3g} s"
        expected = f"{value:g} s +- {match['allowed']} {match['unit']}"
        return f"{name}_s of object {row.cluster_id} in frame {frame} is {shown}, expected {expected}"

    return Expectation(text, complaint)


def object_at_place(clusters: pd.DataFrame, frame: int, place: tuple[float, float]) -> pd.Series | str:
    """The row of the object at a place: the smallest box around it, else the nearest; in words why there is none."""
    rows = clusters[(clusters.frame == frame) & (clusters.role == "object")]
    if not (clusters.frame == frame).any():
        return f"frame {frame} has no result"
    box = rows[BOX].to_numpy(float)
    outside = np.maximum(np.maximum(box[:, :2] - place, place - box[:, 2:]), 0.0)
    distance_px = np.linalg.norm(outside, axis=1)
    area = np.prod(box[:, 2:] - box[:, :2], axis=1)
    order = np.lexsort((area, distance_px))
    if len(rows) == 0 or distance_px[order[0]] > NEAR_PX:
        there = ", ".join(f"{r.cluster_id} at ({r.ref_x_px:.0f}, {r.ref_y_px:.0f})" for r in rows.itertuples())
        return f"no object at ({place[0]:g}, {place[1]:g}) in frame {frame}; there are: {there or 'none'}"
    row: pd.Series = rows.iloc[order[0]]
    return row


def _horizon(text: str, match: re.Match[str]) -> Expectation:
    value, allowed = float(match["value"]), float(match["allowed"])

    def complaint(observed: Observed) -> str:
        if observed.horizon_y_px is None:
            return f"no horizon: {observed.horizon_reason}"
        if abs(observed.horizon_y_px - value) <= allowed:
            return ""
        return f"horizon y centre is {observed.horizon_y_px:.1f} px, expected {value:g} +- {allowed:g}"

    return Expectation(text, complaint, needs_horizon=True)


def _memory(text: str, match: re.Match[str]) -> Expectation:
    most = float(match["value"])
    return Expectation(
        text,
        lambda o: "" if o.max_rss_mb <= most else f"{o.max_rss_mb:.0f} MB of memory, expected at most {most:g}",
    )


def _speed(text: str, match: re.Match[str]) -> Expectation:
    least = float(match["value"])
    return Expectation(
        text,
        lambda o: (
            ""
            if o.fps_ratio >= least
            else f"{o.fps_ratio:.2g} times as fast as the clip was recorded, expected at least {least:g}"
        ),
    )


def _metric(text: str, place: str) -> Expectation:
    check = check_from_text(text, place)

    def complaint(observed: Observed) -> str:
        value = None if observed.metrics is None else observed.metrics[check.metric]
        if value is not None and check.holds(value):
            return ""
        found = "without a value" if value is None else f"{value:.4g}"
        return f"{check.metric} is {found}, expected {check.sign} {check.bound:g}"

    return Expectation(text, complaint, needs_metrics=True)


_FORMS: tuple[tuple[str, Callable[[str, re.Match[str]], Expectation]], ...] = (
    (r"events:? (?:none|(?:(?P<word>at least|at most) )?(?P<number>\d+))", _events),
    (
        rf"(?P<name>{'|'.join(_TIMES)})(?:_s)? of object at \((?P<x>{_NUMBER}), ?(?P<y>{_NUMBER})\) "
        rf"in frame (?P<frame>\d+):? (?P<value>{_NUMBER}) ?s \+- ?(?P<allowed>{_NUMBER}) ?(?P<unit>%|s)",
        _time,
    ),
    (rf"horizon y centre:? (?P<value>{_NUMBER})(?: px)? (?:\+-|±) ?(?P<allowed>{_NUMBER})(?: px)?", _horizon),
    (rf"max_rss_mb:? (?P<value>{_NUMBER})", _memory),
    (rf"min_fps_ratio:? (?P<value>{_NUMBER})", _speed),
)
