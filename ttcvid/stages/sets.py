"""Sets of tracks, such as the members of each cluster, looked at all at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

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

    def means(self, values: Floats) -> Floats:
        """Means over each set of ``values (M,)`` or ``(M, n)``."""
        sums = self.sums(values)
        return np.asarray(sums / self.lengths.reshape(-1, *[1] * (sums.ndim - 1)))

    def medians(self, values: Floats) -> Floats:
        """Medians over each set of ``values (M,)``: (K,)."""
        ascending = values[np.lexsort((values, self.set_of))]
        return np.asarray(
            0.5 * (ascending[self.first + (self.lengths - 1) // 2] + ascending[self.first + self.lengths // 2])
        )

    def boxes(self, xy: Floats) -> Floats:
        """Least x and y, greatest x and y of each set: (K, 4), of the places ``xy (N, 2)`` of all tracks."""
        places = xy[self.index]
        low = np.minimum.reduceat(places, self.first, axis=0)
        return np.concatenate([low, np.maximum.reduceat(places, self.first, axis=0)], axis=1)
