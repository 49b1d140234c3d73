"""Sets of tracks, such as the members of each cluster, looked at all at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ttcvid.geometry.compiled import compiled_for
from ttcvid.geometry.medians import medians
from ttcvid.model import Bools, Floats, Ints


@dataclass(frozen=True)
class TrackSets:
    """K sets of tracks, none of them empty, one after the other: ``index (M,)`` the tracks, ``lengths (K,)``."""

    index: Ints
    lengths: Ints

    @staticmethod
    def of(members: Sequence[Ints]) -> TrackSets:
        """The sets with these ``members``, each an index array."""
        index = np.concatenate([np.empty(0, dtype=np.int64), *members])
        return TrackSets(index, np.array([len(one) for one in members], dtype=np.int64))

    def where(self, holds: Bools) -> tuple[TrackSets, Ints]:
        """The same without the places at which ``holds (M,)`` is False, and which of the sets are left: (K',)."""
        lengths = np.bincount(self.set_of[holds], minlength=len(self))
        left = np.flatnonzero(lengths)
        return TrackSets(self.index[holds], lengths[left]), left

    def __len__(self) -> int:
        return len(self.lengths)

    @cached_property
    def set_of(self) -> Ints:
        """The set of each place: (M,), ascending."""
        return np.repeat(np.arange(len(self)), self.lengths)

    @cached_property
    def first(self) -> Ints:
        """Where each set begins: (K,)."""
        return np.cumsum(self.lengths) - self.lengths

    def sums(self, values: Floats) -> Floats:
        """Sums over each set of ``values (M, ...)``: (K, ...)."""
        return np.asarray(np.add.reduceat(values, self.first, axis=0))

    def medians(self, values: Floats) -> Floats:
        """Medians over each set of ``values (M,)``: (K,)."""
        return medians(values, self.set_of, len(self))

    def boxes(self, xy: Floats) -> Floats:
        """Least x and y, greatest x and y of each set: (K, 4), of the places ``xy (N, 2)`` of all tracks."""
        boxes = np.empty((len(self), 4))
        _fill_boxes(self.index, self.lengths, np.ascontiguousarray(xy), boxes)
        return boxes

    def radii(self, xy: Floats, is_asked: Bools) -> Floats:
        """Root mean square distance (K,) of the tracks of each set from their centre; 0 if not asked.

        ``is_asked (K,)``. Places ``xy (N, 2)`` that are NaN have no part in it; without any other, it is 0.
        """
        radii = np.zeros(len(self))
        _fill_radii(self.index, self.lengths, np.ascontiguousarray(xy), is_asked, radii)
        return radii


@compiled_for("(i8[::1], i8[::1], f8[:, ::1], f8[:, ::1])")
def _fill_boxes(index: Ints, lengths: Ints, xy: Floats, boxes: Floats) -> None:
    """Fills ``boxes (K, 4)``."""
    place = 0
    for k in range(len(lengths)):
        box = boxes[k]
        box[0] = box[2] = xy[index[place], 0]
        box[1] = box[3] = xy[index[place], 1]
        for _ in range(lengths[k]):
            x, y = xy[index[place], 0], xy[index[place], 1]
            box[0], box[1], box[2], box[3] = min(box[0], x), min(box[1], y), max(box[2], x), max(box[3], y)
            place += 1


@compiled_for("(i8[::1], i8[::1], f8[:, ::1], b1[::1], f8[::1])")
def _fill_radii(index: Ints, lengths: Ints, xy: Floats, is_asked: Bools, radii: Floats) -> None:
    """Fills ``radii (K,)``, which come as zeros."""
    low = 0
    for k in range(len(lengths)):
        high = low + lengths[k]
        x, y, count, square = 0.0, 0.0, 0, 0.0
        for place in range(low, high if is_asked[k] else low):
            if np.isfinite(xy[index[place], 0]):
                x, y, count = x + xy[index[place], 0], y + xy[index[place], 1], count + 1
        if count:
            x, y = x / count, y / count
            for place in range(low, high):
                if np.isfinite(xy[index[place], 0]):
                    square += (xy[index[place], 0] - x) ** 2 + (xy[index[place], 1] - y) ** 2
            radii[k] = np.sqrt(square / count)
        low = high


def places_among(known: Ints, track_id: Ints) -> Ints:
    """Where each of ``track_id (N,)`` stands among those ``known (M,)``, both ascending: (N,), -1 for nowhere."""
    place = np.empty(len(track_id), dtype=np.int64)
    _find_places(known, track_id, place)
    return place


@compiled_for("(i8[::1], i8[::1], i8[::1])")
def _find_places(known: Ints, track_id: Ints, place: Ints) -> None:
    """Fills ``place (N,)`` of `places_among`."""
    m = 0
    for i in range(len(track_id)):
        while m < len(known) and known[m] < track_id[i]:
            m += 1
        place[i] = m if m < len(known) and known[m] == track_id[i] else -1
