"""Tracks and objects that are missing in some frames: histories, numbers and warnings go on behind the gap."""

from dataclasses import replace

import numpy as np
import pytest
from tables_of_points import Body, box, driving, ids_of, moving, results_of, street, table

from ttcvid.model import PointSet


@pytest.mark.parametrize("n_missing", [1, 5])
def test_a_track_that_is_missing_in_some_frames_keeps_its_history(n_missing):
    missing = range(15, 15 + n_missing)
    results = results_of(
        table(
            [street()],
            driving(10.0),
            hidden=lambda i, body: np.full(len(body), i in missing) & (np.arange(len(body)) % 3 == 0),
        )
    )
    for result in results[20:]:
        n_frames = dict(zip(result.tracks.track_id.tolist(), result.tracks.n_frames.tolist(), strict=True))
        behind = {track: n for track, n in n_frames.items() if n >= 12}
        assert {n for track, n in behind.items() if track % 3 == 0} == {result.frame + 1 - n_missing}


STREET = street(free_way=True, seed=6)
CROSSING = Body(box((-12.0, 0.6, 42.0), (4.0, 1.4, 1.8), seed=2), moving(3.0, 0.0, 0.0))


def warned(results):
    return {event.event_id: event for result in results for event in result.events}


@pytest.mark.parametrize("n_missing", [1, 4])
def test_frames_with_too_few_tracks_end_no_object_and_no_warning(n_missing):
    """All but eight tracks are missing in some frames at 20/s: behind the gap everything goes on as before it."""
    gap = range(30, 30 + n_missing)
    frames = table(
        [STREET, CROSSING],
        driving(10.0),
        45,
        20.0,
        seed=1,
        hidden=lambda i, body: (np.arange(len(body)) >= 8) & (i in gap),
    )
    results = results_of(frames)
    assert [str(result.status) for result in results[30 : 31 + n_missing]] == ["few_tracks"] * n_missing + ["ok"]
    assert [ids_of(result) for result in results[28:] if result.frame not in gap] == [[1]] * (17 - n_missing)
    behind = results[30 + n_missing]
    assert behind.dt_s == pytest.approx((1 + n_missing) / 20.0)
    assert len(warned(results[:30])) == 1
    assert len(warned(results)) == 1
    tracks = dict(zip(behind.tracks.track_id.tolist(), behind.tracks.n_frames.tolist(), strict=True))
    assert max(tracks.values()) == 31


@pytest.mark.parametrize("n_hidden", [1, 5])
@pytest.mark.parametrize("same_tracks", [True, False])
def test_a_car_that_is_hidden_for_some_frames_keeps_its_number(n_hidden, same_tracks):
    """Seen at 10/s; new tracks take three views until they show whose they are."""
    n_static, hides_at = len(STREET.points_m), 15
    gap = range(hides_at, hides_at + n_hidden)
    frames = table([STREET, CROSSING], driving(10.0), 28, seed=1, hidden=lambda i, body: (body == 1) & (i in gap))
    if not same_tracks:
        frames = [with_new_tracks(frame, n_static) if frame.index >= hides_at else frame for frame in frames]
    numbers = [ids_of(result) for result in results_of(frames)]
    assert numbers[hides_at - 1] == [1]
    assert numbers[hides_at : gap.stop] == [[]] * n_hidden
    seen_from = gap.stop + (0 if same_tracks else 2)
    assert numbers[seen_from:] == [[1]] * (28 - seen_from)


def with_new_tracks(frame, first):
    """The frame with other numbers for the tracks from a number on."""
    track_id = frame.points.track_id
    points = PointSet(np.where(track_id >= first, track_id + 10_000, track_id), frame.points.xy_px)
    return replace(frame, points=points)


@pytest.mark.parametrize("seed", range(3))
def test_dirt_on_the_lens_is_no_car_ahead(seed):
    """Four spots at the height of the road ahead, of twenty tracks each, which follow them with an error."""
    rng = np.random.default_rng(seed)
    spots = np.concatenate([rng.normal(at, 15.0, (20, 2)) for at in ((800, 445), (420, 430), (650, 417), (570, 470))])
    with_dirt = []
    for frame in table([street(seed=seed)], driving(10.0), 40, seed=seed):
        track_id = np.append(frame.points.track_id, 10000 + np.arange(len(spots)))
        xy_px = np.concatenate([frame.points.xy_px, spots + rng.normal(0.0, 0.2, spots.shape)])
        with_dirt.append(replace(frame, points=PointSet(track_id, xy_px)))
    results = results_of(with_dirt)
    assert sum(len(ids_of(result)) for result in results) <= 4
    assert warned(results) == {}
