"""The objects of a run as its report shows them: when they were there, how near they came, what was warned of."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from typing import Any

import numpy as np

from ttcvid.draw.wording import CLOSE_TTC_S
from ttcvid.model import APPROACHING, SCENE_CLUSTER, Bools, Floats, Ints
from ttcvid.report.contents import RunContents

TIMELINE_CELLS = 400
"""Pieces that a timeline is told in: a screen has not many more pixels for it."""
CALM, CLOSE = "calm", "close"


@dataclass(frozen=True)
class Warned:
    """A warning: the object it was of, and where in the clip it stands, in parts of 100 of the clip's time."""

    kind: str
    cluster_id: int
    start_frame: int
    end_frame: int
    start_s: float
    end_s: float
    min_ttc_z_s: float
    confidence: float
    left: float
    width: float


@dataclass(frozen=True)
class Bar:
    """A piece of a timeline, in parts of 100 of the clip's time; ``level`` is `CALM` or `CLOSE`."""

    left: float
    width: float
    level: str


@dataclass(frozen=True)
class Smallest:
    """The smallest time to collision of an object that certainly approaches, with its 90 % interval, and the frame."""

    ttc_z_s: float
    lo_s: float
    hi_s: float
    frame: int


@dataclass(frozen=True)
class SeenObject:
    """One object: ``row (N,)`` are its rows in the table of clusters, ``at (N,)`` their places in that of frames."""

    cluster_id: int
    row: Ints
    at: Ints
    first_frame: int
    last_frame: int
    smallest: Smallest | None
    miss_s: float | None
    bars: tuple[Bar, ...]
    warnings: tuple[Warned, ...]

    @property
    def is_of_interest(self) -> bool:
        """Whether it was warned of, or certainly approached at any time."""
        return bool(self.warnings) or self.smallest is not None


class SeenObjects:
    """All objects of a run, ``ranked``: those warned of as they were warned of, then those that came soonest."""

    def __init__(self, contents: RunContents) -> None:
        self._contents = contents
        self._frame = contents.numbers("frames", "frame").astype(int)
        self._t_s = contents.numbers("frames", "t_s")
        self._cluster_id = contents.numbers("clusters", "cluster_id").astype(int)
        self._times = {name: contents.numbers("clusters", name) for name in ("ttc_z_s", "ttc_z_lo_s", "ttc_z_hi_s")}
        self._miss_s = contents.numbers("clusters", "miss_s")

    @cached_property
    def ranked(self) -> list[SeenObject]:
        """The objects, the one to look at first in front."""
        numbers = np.unique(self._cluster_id[self._cluster_id != SCENE_CLUSTER])
        return sorted((self._object(int(number)) for number in numbers), key=_urgency)

    @cached_property
    def warnings(self) -> tuple[Warned, ...]:
        """The warnings, as they began."""
        columns = ("cluster_id", "start_frame", "end_frame", "start_s", "end_s", "min_ttc_z_s", "confidence")
        values = {name: self._contents.numbers("events", name) for name in columns}
        kinds = [kind.replace("_", " ") for kind in self._contents.words("events", "kind")]
        found = []
        for i in np.argsort(values["start_s"], kind="stable"):
            left, right = self._part_of_clip(np.array([values["start_s"][i], values["end_s"][i]]))
            row: dict[str, Any] = {name: int(values[name][i]) for name in columns[:3]}
            row |= {name: float(values[name][i]) for name in columns[3:]}
            found.append(Warned(kind=kinds[i], left=left, width=right - left, **row))
        return tuple(found)

    def _object(self, cluster_id: int) -> SeenObject:
        row = np.flatnonzero(self._cluster_id == cluster_id)
        at = self._places[row]
        is_sure = self._is_sure_approach[row]
        smallest = miss_s = None
        if is_sure.any():
            ttc_s = np.where(is_sure, self._times["ttc_z_s"][row], np.inf)
            best = int(row[np.argmin(ttc_s)])
            ttc_z_s, lo_s, hi_s = (float(values[best]) for values in self._times.values())
            smallest = Smallest(ttc_z_s, lo_s, hi_s, int(self._frame[self._places[best]]))
            miss_s = None if np.isnan(self._miss_s[best]) else float(self._miss_s[best])
        return SeenObject(
            cluster_id,
            row,
            at,
            int(self._frame[at[0]]),
            int(self._frame[at[-1]]),
            smallest,
            miss_s,
            self._bars(at, is_sure & (self._times["ttc_z_s"][row] <= CLOSE_TTC_S)),
            tuple(warned for warned in self.warnings if warned.cluster_id == cluster_id),
        )

    @cached_property
    def _places(self) -> Ints:
        """The place in the table of frames of every row of clusters."""
        frame = self._contents.numbers("clusters", "frame").astype(int)
        return np.minimum(np.searchsorted(self._frame, frame), len(self._frame) - 1)

    @cached_property
    def _is_sure_approach(self) -> Bools:
        approaching = {str(state) for state in APPROACHING}
        is_approach = np.array(
            [state in approaching for state in self._contents.words("clusters", "state")], dtype=bool
        )
        ttc_s, lo_s, hi_s = self._times.values()
        return np.asarray(is_approach & (ttc_s > 0) & (lo_s <= hi_s))

    def _part_of_clip(self, t_s: Floats) -> list[float]:
        """Times as parts of 100 of the clip's, from the first frame to the end of the last."""
        start_s, end_s = self._t_s.min(), self._t_s.max()
        parts = np.clip((t_s - start_s) / max(end_s - start_s, 1e-9), 0.0, 1.0)
        return [round(100 * float(part), 3) for part in parts]

    def _bars(self, at: Ints, is_close: Bools) -> tuple[Bar, ...]:
        """Where an object is there, on cells of the timeline; close where it is so in any frame of a cell."""
        cell = (np.array(self._part_of_clip(self._t_s[at])) * (TIMELINE_CELLS - 1) / 100).astype(int)
        level = np.zeros(TIMELINE_CELLS, dtype=int)
        np.maximum.at(level, cell, 1 + is_close.astype(int))
        # Frames farther apart than cells leave gaps where the object was there all along.
        for i in np.flatnonzero((np.diff(at) == 1) & (np.diff(cell) > 1)):
            level[cell[i] + 1 : cell[i + 1]] = 1 + int(is_close[i])
        bars, start = [], 0
        for value, run in groupby(level.tolist()):
            length = len(list(run))
            if value:
                part = 100 / TIMELINE_CELLS
                bars.append(Bar(round(start * part, 2), round(length * part, 2), CLOSE if value > 1 else CALM))
            start += length
        return tuple(bars)


def _urgency(seen: SeenObject) -> tuple[bool, float, int]:
    if seen.warnings:
        return False, seen.warnings[0].start_s, seen.cluster_id
    return True, seen.smallest.ttc_z_s if seen.smallest else np.inf, seen.cluster_id
