"""Sets of tracks, such as the members of each cluster, looked at all at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ttcvid.model import Bools, Floats, Ints


@dataclass(frozen=True)
class TrackSets:
    """K sets of tracks, none of them empty, one after the other: ``index (M,)`` the tracks, ``set_of (M,)`` ascending.

    ``first (K,)`` is where each set begins.
    """

    index: Ints
    set_of: Ints
    first: Ints

    @staticmethod
    def of(members: Sequence[Ints]) -> TrackSets:
        """The sets with these ``members``, each an index array."""
        lengths = np.array([len(index) for index in members], dtype=np.int64)
        index = np.concatenate([np.empty(0, dtype=np.int64), *members])
        return TrackSets(index, np.repeat(np.arange(len(members)), lengths), np.cumsum(lengths) - lengths)

    def where(self, holds: Bools) -> tuple[TrackSets, Ints]:
        """The same without the places at which ``holds (M,)`` is False, and which of the sets are left: (K',)."""
        left, set_of = np.unique(self.set_of[holds], return_inverse=True)
        first = np.searchsorted(set_of, np.arange(len(left)))
        return TrackSets(self.index[holds], np.asarray(set_of, dtype=np.int64), first), left

    def __len__(self) -> int:
        return len(self.first)

    @property
    def lengths(self) -> Ints:
        """Number of tracks of each set: (K,)."""
        return np.diff(self.first, append=len(self.index))

    def sums(self, values: Floats) -> Floats:
        """Sums over each set of ``values (M, ...)``: (K, ...)."""
        return np.asarray(np.add.reduceat(values, self.first, axis=0))

    def means(self, values: Floats) -> Floats:
        """Means over each set of ``values (M,)`` or ``(M, n)``."""
        sums = self.sums(values)
        return np.asarray(sums / self.lengths.reshape(-1, *[1] * (sums.ndim - 1)))

    def medians(self, values: Floats) -> Floats:
        """Medians over each set of ``values (M,)``: (K,)."""
        ascending = values[np.lexsort((values, self.set_of))]
        last, lengths = self.first + self.lengths - 1, self.lengths
        return np.asarray(0.5 * (ascending[self.first + (lengths - 1) // 2] + ascending[last - (lengths - 1) // 2]))

    def boxes(self, xy: Floats) -> Floats:
        """Least x and y, greatest x and y of each set: (K, 4), of the places ``xy (N, 2)`` of all tracks."""
        places = xy[self.index]
        low = np.minimum.reduceat(places, self.first, axis=0)
        return np.concatenate([low, np.maximum.reduceat(places, self.first, axis=0)], axis=1)
