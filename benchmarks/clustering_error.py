"""How well tracks are put into scene and movers, against labels given by hand (KT3DMoSeg)."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.optimize import linear_sum_assignment

NOWHERE = -1
"""Label of a track that never was in a cluster."""


def label_of_tracks(collision_times: pd.DataFrame) -> pd.Series:
    """The cluster that each track was in most often (the smaller number at a tie), ``NOWHERE`` if in none."""
    seen = collision_times.dropna(subset="cluster_id")
    counts = seen.groupby(["track_id", "cluster_id"]).size().reset_index(name="n")
    best = counts.sort_values(["n", "cluster_id"], ascending=[False, True]).drop_duplicates("track_id")
    labels = best.set_index("track_id").cluster_id.astype(int)
    return labels.reindex(collision_times.track_id.unique(), fill_value=NOWHERE)


def clustering_error(truth: np.ndarray, found: np.ndarray) -> float:
    """Part of the tracks (N,) not in the cluster that stands for their group, clusters matched one to one to groups.

    ``NOWHERE`` among ``found`` matches no group.
    """
    groups, group = np.unique(truth, return_inverse=True)
    is_somewhere = found != NOWHERE
    clusters, cluster = np.unique(found[is_somewhere], return_inverse=True)
    shared = np.zeros((len(groups), len(clusters)), dtype=int)
    np.add.at(shared, (group[is_somewhere], cluster), 1)
    matched = shared[linear_sum_assignment(shared, maximize=True)].sum()
    return 1.0 - float(matched) / len(truth)
