"""Whether tracks are in the group of the object that they lie on."""

from __future__ import annotations

import numpy as np

from ttcvid.model import NO_CLUSTER, SCENE_CLUSTER, Bools, Ints
from ttcvid.studies.evaluation.matching import best_one_to_one
from ttcvid.studies.evaluation.times import Numbers
from ttcvid.studies.evaluation.truth import UNKNOWN_OBJECT


def judge_grouping(track_object: Ints, cluster_id: Ints) -> Numbers:
    """Shares of track rows ``(N,)`` in the right group.

    Cluster 0 is the static scene; the others are assigned to true objects one-to-one, over the whole clip, as most
    rows agree. A row of no cluster, or of one that got no object, is wrong. Rows of unknown object do not count.
    """
    is_known = track_object != UNKNOWN_OBJECT
    track_object, cluster_id = track_object[is_known], cluster_id[is_known]
    on_object, in_object = track_object != SCENE_CLUSTER, cluster_id > SCENE_CLUSTER
    both = on_object & in_object
    object_of = best_one_to_one(cluster_id[both], track_object[both]) | {SCENE_CLUSTER: SCENE_CLUSTER}
    clusters, place = np.unique(cluster_id, return_inverse=True)
    meant = np.array([object_of.get(int(c), UNKNOWN_OBJECT) for c in clusters], dtype=np.int64)[place]
    is_right = meant == track_object
    return {
        "n": float(len(is_right)),
        "right": _share(is_right),
        "objects_right": _share(is_right[on_object]),
        "objects_pure": _share(is_right[in_object]),
        "unassigned": _share(cluster_id == NO_CLUSTER),
    }


def share_in_bodies(cluster_id: Ints, is_outlier: Bools) -> float:
    """Share of the displaced observations ``(N,)`` that are taken into a body, the scene or an object."""
    return _share(cluster_id[is_outlier] != NO_CLUSTER)


def _share(values: np.ndarray) -> float:
    return float(np.mean(values)) if len(values) else float("nan")
