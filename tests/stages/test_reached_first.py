"""The smallest time to collision is told of objects that deserve it only."""

import pytest
from frame_results import object_cluster, times_of

from ttcvid.config import PipelineConfig
from ttcvid.model import MotionState
from ttcvid.stages.objects.reached_first import nearest_object

DT_S = 0.05
CONFIG = PipelineConfig()


def approaching(cluster_id, ttc_z_s, lo_s=None, hi_s=None, **changes):
    lo_s, hi_s = 0.8 * ttc_z_s if lo_s is None else lo_s, 1.3 * ttc_z_s if hi_s is None else hi_s
    times = times_of(ttc_z_s=[ttc_z_s], ttc_z_lo_s=[lo_s], ttc_z_hi_s=[hi_s])
    return object_cluster(cluster_id, times=times, **changes)


def told(*frames):
    """The ``cluster_id`` that is told in each of the frames, 0.05 s apart."""
    since, found = {}, []
    for k, rows in enumerate(frames):
        nearest, since = nearest_object(since, k * DT_S, rows, CONFIG)
        found.append(None if nearest is None else nearest.cluster_id)
    return found


def test_what_has_approached_for_the_persistence_is_told():
    assert told(*[(approaching(4, 2.0),)] * 7) == [None] * 5 + [4, 4]


def test_the_one_with_the_smallest_time_is_told():
    assert told(*[(approaching(4, 2.0), approaching(5, 1.0))] * 6)[-1] == 5


def test_what_appeared_just_now_does_not_displace_what_has_come_for_long():
    before, now = (approaching(4, 2.0),), (approaching(4, 2.0), approaching(9, 0.2))
    assert told(*[before] * 6, *[now] * 3) == [None] * 5 + [4] * 4


@pytest.mark.parametrize(
    "row",
    [
        approaching(4, 0.6, n_tracks=4),
        approaching(4, 0.6, lo_s=0.5, hi_s=-3.0),
        approaching(4, 0.6, lo_s=-0.1),
        approaching(4, 0.6, hi_s=float("inf")),
        approaching(4, 0.6, motion_state=MotionState.unknown),
        approaching(4, float("nan")),
    ],
    ids=["a handful of points", "may recede", "may be past", "without end", "of unknown state", "without a time"],
)
def test_what_is_small_or_not_sure_to_come_is_not_told(row):
    assert told(*[(row,)] * 12) == [None] * 12


def test_a_doubt_in_between_starts_the_persistence_anew():
    sure, doubtful = (approaching(4, 2.0),), (approaching(4, 2.0, lo_s=-1.0),)
    assert told(*[sure] * 5, doubtful, *[sure] * 5) == [None] * 11
