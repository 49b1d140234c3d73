"""Which tracks hang together in the picture."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from ttcvid.model import Bools, Ints


def largest_connected(is_in: Bools, pairs: Ints) -> Ints:
    """Indices of the largest part of ``is_in (N,)`` that hangs together by ``pairs (M, 2)``."""
    label = connected_parts(is_in, pairs)
    counts = np.bincount(label[is_in]) if is_in.any() else np.zeros(1, dtype=np.int64)
    largest: Ints = np.flatnonzero(is_in & (label == np.argmax(counts)))
    return largest


def connected_parts(is_in: Bools, pairs: Ints) -> Ints:
    """Number of the part that each of the tracks ``is_in (N,)`` belongs to, joined by ``pairs (M, 2)`` of tracks: (N,).

    The others have numbers of their own.
    """
    one, other = pairs[:, 0], pairs[:, 1]
    keep = is_in[one] & is_in[other]
    n = len(is_in)
    order = np.argsort(one[keep], kind="stable")
    row_starts = np.concatenate([[0], np.cumsum(np.bincount(one[keep], minlength=n))])
    graph = csr_array((np.ones(len(order)), other[keep][order], row_starts), shape=(n, n))
    label: Ints = connected_components(graph, directed=False)[1].astype(np.int64)
    return label
