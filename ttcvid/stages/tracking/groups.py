"""Sets of tracks, such as the members of each cluster, looked at all at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ttcvid.geometry.medians import medians
from ttcvid.model import Bools, Floats, Ints, PointSet


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

    def members(self, number: int) -> Ints:
        """The tracks of one set."""
        return self.index[self.first[number] : self.first[number] + self.lengths[number]]

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
        own = xy[self.index]
        return np.hstack([np.minimum.reduceat(own, self.first), np.maximum.reduceat(own, self.first)])

    def radii(self, xy: Floats) -> Floats:
        """Root mean square distance (K,) of the tracks of each set from their centre.

        Places ``xy (N, 2)`` that are NaN have no part in it; without any other, it is 0.
        """
        known, left = self.where(np.isfinite(xy[self.index, 0]))
        own, radii = xy[known.index], np.zeros(len(self))
        off = own - (known.sums(own) / known.lengths[:, None])[known.set_of]
        radii[left] = np.sqrt(known.sums((off * off).sum(axis=1)) / known.lengths)
        return radii


def places_among(known: Ints, track_id: Ints) -> Ints:
    """Where each of ``track_id (N,)`` stands among those ``known (M,)``, which ascend: (N,), -1 for nowhere."""
    if not len(known):
        return np.full(len(track_id), -1)
    place = np.searchsorted(known, track_id)
    return np.where(known.take(place, mode="clip") == track_id, place, -1)


def in_common(one: PointSet, other: PointSet) -> tuple[Floats, Floats]:
    """Pixels ``(M, 2)`` of the same points in two pictures."""
    place = places_among(one.track_id, other.track_id)
    return one.xy_px[place[place >= 0]], other.xy_px[place >= 0]
