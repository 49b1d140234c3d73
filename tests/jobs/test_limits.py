"""Limits of the method are told of the clips that run into them, and of no others."""

from dataclasses import replace

import numpy as np
from frame_results import frame_result, no_tracks, object_cluster, scene_cluster, some_tracks

from ttcvid.jobs.analyze.limits import LimitWatch
from ttcvid.model import FrameResult, FrameStatus, Platform

MANY = some_tracks(200, np.random.default_rng(1))
AHEAD, ACROSS = np.array([0.0, 0.1, -0.995]), np.array([1.0, 0.0, 0.0])


def names(*results: FrameResult, platform: Platform = Platform.vehicle) -> list[str]:
    watch = LimitWatch()
    for result in results:
        watch.add(result)
    return [limit["name"] for limit in watch.limits(platform)]


def frames(
    status: FrameStatus = FrameStatus.ok, direction=ACROSS, n_tracks: int = 12, tracks=MANY
) -> list[FrameResult]:
    clusters = (scene_cluster(direction=direction), object_cluster(1, n_tracks=n_tracks))
    return [replace(frame_result(i, tracks, clusters), status=status) for i in range(1, 11)]


def test_a_clip_without_any_has_none():
    assert names(*frames()) == []
    assert names() == []


def test_little_texture_is_told():
    assert names(*frames(tracks=no_tracks())) == ["little texture"]


def test_movers_of_few_points_are_told_and_not_those_of_a_moment():
    assert names(*frames(n_tracks=5)) == ["few points"]
    assert names(*frames(n_tracks=5)[:4]) == []


def test_own_travel_that_is_not_seen_is_told_but_not_of_a_camera_at_rest():
    unseen = frames(FrameStatus.rotation_only, direction=None)
    assert names(*unseen, platform=Platform.free) == ["own travel unseen"]
    assert names(*frames(FrameStatus.static, direction=None), platform=Platform.static) == []


def test_a_drive_along_the_view_says_what_goes_our_way():
    assert names(*frames(direction=AHEAD)) == ["own direction"]
    watch = LimitWatch()
    for result in frames(direction=AHEAD):
        watch.add(result)
    (limit,) = watch.limits(Platform.free)
    assert "the road is not used with --platform free" in limit["text"]
