"""What is missing for some frames: numbers, histories and warnings go on behind the gap."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from tables_of_points import (
    CAMERA,
    FOCAL_PX,
    STILL,
    VEHICLE,
    Body,
    box,
    driving,
    ids_of,
    moving,
    results_of,
    street,
    table,
)

import ttcvid.stages.objects.surface_motions as surface_motions
from ttcvid.model import FrameStatus, Horizon, PointSet
from ttcvid.pipeline import analyze_frames

LEVEL = Horizon(CAMERA.cy_px, CAMERA.cy_px, CAMERA.image_size, 0.002, "test")
STOPPED = Body(box((0.0, 0.5, 30.0), (1.8, 1.4, 0.3)))
CROSSING = Body(box((12.0, 0.5, 30.0), (1.8, 1.4, 0.3)), moving(-4.0, 0.0, 0.0))


def test_what_stands_in_our_way_keeps_its_number_over_a_frame_whose_way_is_not_known(monkeypatch):
    known, calls = surface_motions.own_path, []

    def unknown_once(*args):
        calls.append(args)
        # Twice a frame: for what stands in our way, and for our speed over the road.
        return None if len(calls) in (39, 40) else known(*args)

    monkeypatch.setattr(surface_motions, "own_path", unknown_once)
    stopped = Body(box((0.0, 0.5, 30.0), (1.8, 1.4, 0.3)), STILL)
    results = results_of(table([street(free_way=True), stopped], driving(10.0), n_frames=30))
    assert len(calls) == 58
    assert [ids_of(result) for result in results[16:20]] == [[1]] * 4
    assert [ids_of(result) for result in results[22:]] == [[1]] * 8


def doubled(frames, after=0, times=1):
    """Each frame from ``after`` on is followed by so many of itself, evenly up to the next."""
    out = []
    for frame, later in zip(frames, [*frames[1:], None], strict=True):
        out.append(frame)
        if frame.index >= after and later is not None:
            steps_s = (later.t_s - frame.t_s) * np.arange(1, times + 1) / (times + 1)
            out += [replace(frame, t_s=frame.t_s + step_s) for step_s in steps_s]
    return out


def nodding(frames):
    """The frames as a camera sees them that nods by 1.5 deg up and down in 2 s."""
    out = []
    for frame in frames:
        shift = FOCAL_PX * np.radians(1.5) * np.sin(np.pi * frame.t_s)
        # Far off the axis this is no rotation, but near enough to one for a few degrees.
        out.append(replace(frame, points=PointSet(frame.points.track_id, frame.points.xy_px + np.array([0.0, shift]))))
    return out


def with_horizon(frames):
    return [result for _, result in analyze_frames(frames, CAMERA, VEHICLE, LEVEL)]


@pytest.mark.parametrize("times", [1, 2])
def test_time_and_rotation_of_a_row_are_since_the_same_frame(times):
    """Doubled frames (30 pictures a second sent as 60) are no part of the next one's time."""
    frames = table([street()], driving(8.0), n_frames=8)
    for result in results_of(doubled(frames, times=times))[1:]:
        if result.status == FrameStatus.duplicate:
            assert result.dt_s < 0.1 - 1e-9
        else:
            assert result.dt_s == pytest.approx(0.1)


def test_a_horizon_is_followed_alike_with_doubled_frames_between():
    frames = nodding(table([street()], driving(8.0), n_frames=12))
    plain, with_more = with_horizon(frames), with_horizon(doubled(frames))
    away_px = [abs(result.horizon_px[0] - LEVEL.y_left_px) for result in plain]
    assert max(away_px) > 10.0
    used = [result for result in with_more if result.status != FrameStatus.duplicate]
    for one, other in zip(plain, used, strict=True):
        assert other.horizon_px == pytest.approx(one.horizon_px, abs=1e-6)


def test_a_frame_without_numbers_shows_the_horizon_where_it_was_last():
    frames = nodding(table([street()], driving(8.0), n_frames=8))
    results = with_horizon(doubled(frames))
    for before, here in pairwise(results):
        if here.status == FrameStatus.duplicate:
            assert here.horizon_px == before.horizon_px


def test_a_warning_stands_in_frames_without_numbers_and_ends_when_there_are_only_such():
    frames = table([street(free_way=True), CROSSING], driving(10.0), n_frames=24)
    results = results_of(doubled(frames, after=20))
    warned = [index for index, result in enumerate(results) if result.events]
    assert warned[0] < 20
    assert warned[-1] == len(results) - 1
    assert warned == list(range(warned[0], len(results)))
    for before, here in pairwise(results[20:]):
        if here.status == FrameStatus.duplicate:
            assert here.events == before.events
    standing = [replace(frames[-1], t_s=frames[-1].t_s + 0.1 * step) for step in range(1, 12)]
    ended = results_of([*frames, *standing])[len(frames) :]
    assert [result.status for result in ended] == [FrameStatus.duplicate] * 11
    assert ended[0].events
    assert ended[-1].events == ()
