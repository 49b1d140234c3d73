"""What the plots of a report show, as plain numbers for JSON, thinned where a clip is long."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from ttcvid.geometry.estimation.intervals import NORMAL_90_SIGMAS
from ttcvid.model import SCENE_CLUSTER, Floats, Ints
from ttcvid.report.colours import colours_of_objects
from ttcvid.report.contents import RunContents
from ttcvid.report.objects import SeenObject
from ttcvid.report.sphere import azimuth_elevation_deg, azimuth_elevation_errors, bearings_deg, outline_deg

MAX_ROWS, MAX_FRAMES = 30_000, 4_000
"""Rows of objects, and frames of own motion, that a page shows at most: some 3 MB, whatever the length of the clip."""
MAX_OBJECTS = 60
DIGITS = 4
TICKS_PER_S = 10_000
"""Presentation times stand in the page in steps of 0.1 ms."""
TIMES = ("ttc_z", "tcpa", "miss")
_COVARIANCE = ("xx", "xy", "xz", "xy", "yy", "yz", "xz", "yz", "zz")


def run_series(contents: RunContents, shown: list[SeenObject]) -> dict[str, Any]:
    """The clock of a run, its own motion, and the objects ``shown``."""
    return {
        "clock": _clock(contents),
        "frames": _frames(contents),
        "objects": _objects(contents, shown),
        "outline": [plain(side) for side in outline_deg(contents.camera).T],
        "dt_s": float(contents.manifest["input"]["nominal_dt_s"]),
    }


def as_json(content: Any) -> str:
    """JSON that may stand inside of a ``<script>``: nothing in it ends that element, whatever a file is called."""
    text = json.dumps(content, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def plain(values: Floats) -> list[float | None]:
    """Numbers with `DIGITS` significant digits, whole from 10^4 on; None for NaN and infinity.

    >>> plain(np.array([1 / 3, 123456.7, np.nan, 0.0]))
    [0.3333, 123457.0, None, 0.0]
    """
    values = np.asarray(values, dtype=float)
    size = np.abs(np.where(np.isfinite(values) & (values != 0), values, 1.0))
    scale = 10.0 ** np.clip(DIGITS - 1 - np.floor(np.log10(size)), 0, 12)
    with np.errstate(invalid="ignore"):
        rounded = np.round(values * scale) / scale
    return [value if math.isfinite(value) else None for value in rounded.tolist()]


def kept_rows(ttc_s: Floats, every: int) -> Ints:
    """Of each ``every`` rows the one with the smallest positive time, and the first and the last row of all.

    >>> kept_rows(np.array([5.0, 4.0, 3.0, np.nan, 2.0, 2.5, 9.0]), 3)
    array([0, 2, 4, 6])
    """
    n = len(ttc_s)
    if every <= 1:
        return np.arange(n)
    bucket = np.arange(n) // every
    order = np.lexsort((np.where(ttc_s > 0, ttc_s, np.inf), bucket))
    is_first = np.r_[True, np.diff(bucket[order]) > 0]
    return np.unique(np.r_[0, order[is_first], n - 1])


def _clock(contents: RunContents) -> dict[str, list[int]]:
    """Number and time of every frame, as steps from the one before: two to four signs each."""
    frame = contents.numbers("frames", "frame").astype(int)
    ticks = np.round(contents.numbers("frames", "t_s") * TICKS_PER_S).astype(int)
    return {"frame": np.diff(frame, prepend=0).tolist(), "ticks": np.diff(ticks, prepend=0).tolist()}


def _frames(contents: RunContents) -> dict[str, Any]:
    n = contents.tables["frames"].num_rows
    every = -(-n // MAX_FRAMES)
    at = np.arange(0, n, every)
    dt_s = contents.numbers("frames", "dt_s")[at]
    per_s = np.degrees(1.0 / np.where(dt_s > 0, dt_s, np.nan))
    rates = {axis: plain(contents.numbers("frames", f"rot_{axis}_rad")[at] * per_s) for axis in "xyz"}
    half = contents.numbers("frames", "rot_sigma_rad")[at] * per_s * NORMAL_90_SIGMAS
    heading, error = _headings(contents, at)
    return {
        "every": every,
        "at": at.tolist(),
        "rates": rates,
        "rate_half": plain(half),
        "heading": [plain(values) for values in heading.T],
        "heading_half": [plain(values * NORMAL_90_SIGMAS) for values in error[:, :2].T],
        "n_tracks": plain(contents.numbers("frames", "n_tracks")[at]),
    }


def _headings(contents: RunContents, at: Ints) -> tuple[Floats, Floats]:
    """Own direction of motion ``(N, 2)`` in deg at frames ``at``, with its errors ``(N, 3)``; NaN where unknown."""
    frames = contents.numbers("frames", "frame")[at]
    heading, error = np.full((len(at), 2), np.nan), np.full((len(at), 3), np.nan)
    is_scene = contents.numbers("epipoles", "cluster_id") == SCENE_CLUSTER
    rows = np.flatnonzero(is_scene & np.isin(contents.numbers("epipoles", "frame"), frames))
    places = np.searchsorted(frames, contents.numbers("epipoles", "frame")[rows])
    heading[places], error[places] = _epipoles(contents, rows)
    return heading, error


def _epipoles(contents: RunContents, rows: Ints) -> tuple[Floats, Floats]:
    """Where the rows' clusters come from, ``-dir``, in deg ``(N, 2)``, with errors ``(N, 3)``."""
    direction = -np.column_stack([contents.numbers("epipoles", f"dir_{axis}")[rows] for axis in "xyz"])
    cov = np.column_stack([contents.numbers("epipoles", f"cov_{ij}")[rows] for ij in _COVARIANCE])
    return azimuth_elevation_deg(direction), azimuth_elevation_errors(direction, cov.reshape(-1, 3, 3))


def _objects(contents: RunContents, shown: list[SeenObject]) -> list[dict[str, Any]]:
    every = -(-sum(len(seen.row) for seen in shown) // MAX_ROWS)
    columns = [f"{time}{end}_s" for time in TIMES for end in ("", "_lo", "_hi")]
    table = {name: contents.numbers("clusters", name) for name in (*columns, "ref_x_px", "ref_y_px")}
    bearing = bearings_deg(contents.camera, np.column_stack([table["ref_x_px"], table["ref_y_px"]]))
    # Both tables have a row a frame and cluster, in one order.
    where, error = _epipoles(contents, np.arange(contents.tables["epipoles"].num_rows))
    colours = colours_of_objects(_in_view(contents))
    objects = []
    for seen in shown:
        kept = kept_rows(table["ttc_z_s"][seen.row], every)
        row = seen.row[kept]
        objects.append(
            {
                "id": seen.cluster_id,
                "colour": colours[seen.cluster_id],
                "at": seen.at[kept].tolist(),
                "every": every,
                **{name.removesuffix("_s"): plain(table[name][row]) for name in columns},
                "epipole": _columns(where[row]),
                "epipole_error": _columns(error[row]),
                "bearing": _columns(bearing[row]),
            }
        )
    return objects


def _in_view(contents: RunContents) -> list[list[int]]:
    """The numbers of the objects that are seen, frame by frame."""
    number = contents.numbers("clusters", "cluster_id").astype(int)
    is_object = number != SCENE_CLUSTER
    frame = contents.numbers("clusters", "frame")[is_object]
    starts = np.flatnonzero(np.diff(frame, prepend=-1))
    return [part.tolist() for part in np.split(number[is_object], starts[1:])]


def _columns(values: Floats) -> list[list[float | None]]:
    return [plain(column) for column in values.T]


def thinning(contents: RunContents, shown: Iterable[SeenObject]) -> list[str]:
    """What the plots leave out, as sentences."""
    n, n_rows = contents.tables["frames"].num_rows, sum(len(seen.row) for seen in shown)
    notes = []
    if n > MAX_FRAMES:
        notes.append(f"Plots of own motion show one frame in {-(-n // MAX_FRAMES)}.")
    if n_rows > MAX_ROWS:
        notes.append(
            f"Plots of objects show one frame in {-(-n_rows // MAX_ROWS)}: of each so many the one with the smallest "
            "time to collision."
        )
    return notes
