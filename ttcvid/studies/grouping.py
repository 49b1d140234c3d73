"""Whether tracks are in the group of the thing that they lie on."""

from __future__ import annotations

import numpy as np

from ttcvid.model import NO_CLUSTER, SCENE_CLUSTER, Ints
from ttcvid.studies.matching import best_one_to_one
from ttcvid.studies.times import Numbers
from ttcvid.studies.truth import UNKNOWN_OBJECT


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
    meant = np.array([object_of.get(int(c), UNKNOWN_OBJECT) for c in cluster_id], dtype=np.int64)
    is_right = meant == track_object
    return {
        "n": float(len(is_right)),
        "right": _share(is_right),
        "objects_right": _share(is_right[on_object]),
        "objects_pure": _share(is_right[in_object]),
        "unassigned": _share(cluster_id == NO_CLUSTER),
    }


def clustering_error(track_id: Ints, cluster_id: Ints, label_of_track: dict[int, int]) -> float:
    """The share of labelled tracks in the wrong motion group.

    A track's group is the cluster that it is in most often (the lower number in a tie). Groups are assigned to labels
    one-to-one so that most tracks agree; a track of no group, or of an unassigned one, is an error.

    >>> clustering_error(np.array([1, 1, 2, 3]), np.array([0, 0, 0, 5]), {1: 1, 2: 1, 3: 2, 4: 2})
    0.25
    """
    group_of = most_frequent_cluster(track_id, cluster_id)
    tracks = [track for track in label_of_track if track in group_of]
    groups = np.array([group_of[track] for track in tracks], dtype=np.int64)
    labels = np.array([label_of_track[track] for track in tracks], dtype=np.int64)
    label_of_group = best_one_to_one(groups, labels)
    n_right = sum(label_of_group.get(int(g)) == int(label) for g, label in zip(groups, labels, strict=True))
    return 1.0 - n_right / len(label_of_track)


def most_frequent_cluster(track_id: Ints, cluster_id: Ints) -> dict[int, int]:
    """The cluster that each track is in most often; a track that is in none is left out."""
    in_any = cluster_id != NO_CLUSTER
    pairs, counts = np.unique(np.stack([track_id[in_any], cluster_id[in_any]]), axis=1, return_counts=True)
    # Ascending in cluster_id within a track, and a stable sort: of a tie the lower number comes first.
    order = np.lexsort((pairs[1], -counts))[::-1]
    return {int(pairs[0, k]): int(pairs[1, k]) for k in order}


def _share(values: np.ndarray) -> float:
    return float(np.mean(values)) if len(values) else float("nan")
