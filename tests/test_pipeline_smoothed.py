"""Estimates from frames on both sides: what they change, and what they leave as it is."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from pipeline_runs import VEHICLE, assert_same, has_no_numbers, results_of, table

from ttcvid.config import CollisionTimesConfig
from ttcvid.model import FrameStatus
from ttcvid.pipeline import analyze_frames

SMOOTH = VEHICLE.model_copy(update={"collision_times": CollisionTimesConfig(smooth=True, max_frames=10)})
CAUSAL = VEHICLE.model_copy(update={"collision_times": CollisionTimesConfig(max_frames=10)})


@cache
def long_runs(name):
    """The causal results, and those from both sides."""
    frames, camera = table(name, 24)
    return results_of(frames, camera, CAUSAL), results_of(frames, camera, SMOOTH)


@pytest.mark.parametrize("name", ["crossing_collision", "lead_car_brakes", "resting_six_movers"])
def test_smoothing_takes_nothing_back_that_was_found_out_on_the_way(name):
    causal, smooth = long_runs(name)
    for one, other in zip(causal, smooth, strict=True):
        assert (one.frame, one.t_s, one.status, one.events) == (other.frame, other.t_s, other.status, other.events)
        np.testing.assert_array_equal(one.rotation_rad, other.rotation_rad)
        np.testing.assert_array_equal(one.tracks.track_id, other.tracks.track_id)
        np.testing.assert_array_equal(one.tracks.xy_px, other.tracks.xy_px)
        in_object = one.tracks.cluster_id > 0
        np.testing.assert_array_equal(one.tracks.cluster_id[in_object], other.tracks.cluster_id[in_object])
        assert {row.cluster_id for row in one.clusters} <= {row.cluster_id for row in other.clusters}
    assert_same(causal[-1:], smooth[-1:])
    middle = slice(8, 16)
    changed = [
        not np.array_equal(one.tracks.times.ttc_z_s, other.tracks.times.ttc_z_s, equal_nan=True)
        for one, other in zip(causal[middle], smooth[middle], strict=True)
    ]
    assert all(changed)


def test_objects_are_known_half_a_window_before_they_are_found():
    causal, smooth = long_runs("crossing_collision")

    def first_frames(results):
        seen = [(row.cluster_id, result.frame) for result in results[::-1] for row in result.clusters]
        return {cluster_id: frame for cluster_id, frame in seen if cluster_id}

    found, known = first_frames(causal), first_frames(smooth)
    assert found.keys() == known.keys()
    earlier = [found[cluster_id] - known[cluster_id] for cluster_id in found]
    assert 0 < max(earlier) <= SMOOTH.collision_times.max_frames // 2
    assert min(earlier) >= 0


def test_smoothed_warnings_are_those_of_the_causal_analysis():
    frames, camera = table("crossing_collision", 48, n_tracks=150, min_per_object=30)
    causal, smooth = results_of(frames, camera, CAUSAL), results_of(frames, camera, SMOOTH)
    assert any(result.events for result in causal)
    assert [result.events for result in causal] == [result.events for result in smooth]


def test_smoothed_results_wait_for_half_a_window_and_no_longer():
    frames, camera = table("crossing_collision", 30)
    read = []

    def source():
        for frame in frames:
            read.append(frame.index)
            yield frame

    stream = analyze_frames(source(), camera, SMOOTH)
    for n in range(1, 20):
        next(stream)
        assert len(read) == n + SMOOTH.collision_times.max_frames // 2


def test_smoothed_results_do_not_look_over_a_cut():
    frames, camera = table("crossing_collision")
    n_ids = 1 + max(frame.points.track_id.max() for frame in frames)
    again = [
        replace(f, index=f.index + 12, t_s=f.t_s + 1.0, points=replace(f.points, track_id=f.points.track_id + n_ids))
        for f in frames
    ]
    alone, both = results_of(frames, camera, SMOOTH), results_of([*frames, *again], camera, SMOOTH)
    assert both[12].status == FrameStatus.cut
    assert_same(alone, both[:12])


def test_frames_without_numbers_keep_their_place_among_smoothed_ones():
    frames, camera = table("crossing_collision", 24)
    bad = replace(frames[5], index=99, t_s=frames[5].t_s)
    results = results_of([*frames[:6], bad, *frames[6:]], camera, SMOOTH)
    assert [result.frame for result in results[:8]] == [0, 1, 2, 3, 4, 5, 99, 6]
    assert has_no_numbers(results[6])
    # The frames before it wait for as many frames as ever, one of which gives them no view.
    assert_same(results[7:], long_runs("crossing_collision")[1][6:])


@pytest.mark.parametrize("n_frames", [1, 2, 3])
def test_a_clip_shorter_than_the_wait_is_smoothed_all_the_same(n_frames):
    frames, camera = table("crossing_collision", 12)
    results = results_of(frames[:n_frames], camera, SMOOTH)
    assert [result.frame for result in results] == list(range(n_frames))
