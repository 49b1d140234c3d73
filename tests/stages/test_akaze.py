"""The paper's AKAZE tracks: numbers chained over the pictures, doubtful and one-sided matches left out."""

import numpy as np
import pytest
from wave_pictures import HEIGHT, WIDTH, Warp, wave_picture

from ttcvid.config import TrackingConfig
from ttcvid.stages.tracking.akaze import Features, detect_features, follow_akaze, start_akaze

CONFIG = TrackingConfig(tracker="akaze", max_tracks=300, akaze_threshold=1e-4)


def descriptors(*bits_set):
    """Descriptors (N, 61): the first so many bits of each are set, starting at a bit of its own."""
    bits = np.zeros((len(bits_set), 61 * 8), dtype=np.uint8)
    for row, (start, count) in enumerate(bits_set):
        bits[row, start : start + count] = 1
    return np.packbits(bits, axis=1)


def features(*bits_set):
    return Features(np.arange(2.0 * len(bits_set)).reshape(-1, 2), descriptors(*bits_set))


def test_a_clear_match_goes_on_under_its_number():
    former = features((0, 40), (100, 40), (200, 40))
    now = features((201, 40), (1, 40), (300, 40))
    memory, survival = follow_akaze(start_akaze(former, next_track_id=7), now, CONFIG)
    # Track 9 is now first, track 7 second; the third is new, and 8 is gone.
    assert memory.track_id.tolist() == [9, 7, 10]
    assert memory.next_track_id == 11
    assert survival == pytest.approx(2 / 3)


def test_a_match_with_a_rival_as_good_begins_a_new_track():
    """Distance 10 to the nearest, 12 to the next: above the ratio of 0.8."""
    former = features((0, 40), (200, 40))
    now = features((5, 40), (6, 40), (200, 40))
    memory, _ = follow_akaze(start_akaze(former), now, CONFIG)
    assert memory.track_id.tolist() == [2, 3, 1]
    lenient, _ = follow_akaze(start_akaze(former), now, CONFIG.model_copy(update={"akaze_ratio": 0.9}))
    assert lenient.track_id.tolist() == [0, 2, 1]


def test_only_mutual_neighbours_match():
    """Both former features are nearest to the same one of now; it goes to the nearer, never to both."""
    former = features((0, 40), (3, 40))
    now = features((2, 40), (300, 40))
    memory, survival = follow_akaze(start_akaze(former), now, CONFIG)
    assert memory.track_id.tolist() == [1, 2]
    assert survival == 0.5


def test_tracks_are_chained_over_many_pictures_of_a_moving_texture():
    warps = [Warp(shift_px=(1.7 * step, 0.6 * step), scale=1 + 0.004 * step) for step in range(6)]
    memory, paths = None, {}
    for index, warp in enumerate(warps):
        found = detect_features(wave_picture(warp), None, CONFIG)
        memory = start_akaze(found) if memory is None else follow_akaze(memory, found, CONFIG)[0]
        points = memory.seen
        assert (np.diff(points.track_id) > 0).all()
        for track_id, xy_px in zip(points.track_id.tolist(), points.xy_px, strict=True):
            paths.setdefault(track_id, []).append((index, xy_px))
    whole = [path for path in paths.values() if len(path) == len(warps)]
    assert len(whole) > 30
    assert all(np.diff([index for index, _ in path]).tolist() == [1] * (len(path) - 1) for path in paths.values())
    start, end = np.array([path[0][1] for path in whole]), np.array([path[-1][1] for path in whole])
    error = np.linalg.norm(end - warps[-1].to_picture(start), axis=1)
    assert np.median(error) < 0.4
    assert np.percentile(error, 95) < 1.5


def test_a_pattern_that_repeats_gives_hardly_a_match_that_would_be_a_guess():
    patch = wave_picture()[:80, :80]
    tiled = np.tile(patch, (2, 3))
    memory = start_akaze(detect_features(tiled, None, CONFIG))
    again, _ = follow_akaze(memory, detect_features(np.roll(tiled, 3, axis=1), None, CONFIG), CONFIG)
    former = dict(zip(memory.track_id.tolist(), memory.features.xy_px, strict=True))
    step = [
        xy - former[number]
        for number, xy in zip(again.track_id.tolist(), again.features.xy_px, strict=True)
        if number in former
    ]
    wrong = [s for s in step if np.linalg.norm(s - [3.0, 0.0]) > 3.0]
    assert len(step) < 0.5 * len(former)
    assert len(wrong) < 0.02 * len(former)


def test_features_stand_only_where_the_mask_allows_them_and_never_exceed_their_number():
    allowed = np.zeros((HEIGHT, WIDTH), np.uint8)
    allowed[:, 120:] = 255
    found = detect_features(wave_picture(), allowed, CONFIG)
    assert len(found.xy_px) > 10
    assert (found.xy_px[:, 0] > 119).all()
    few = detect_features(wave_picture(), None, CONFIG.model_copy(update={"max_tracks": 20}))
    # A tenth more than tracks.
    assert few.xy_px.shape == (22, 2)
    assert few.descriptors.shape == (22, 61)


def test_a_plain_picture_ends_all_tracks_and_is_survived():
    plain = np.full((HEIGHT, WIDTH), 90, np.uint8)
    nothing = detect_features(plain, None, CONFIG)
    assert nothing.xy_px.shape == (0, 2)
    started = start_akaze(detect_features(wave_picture(), None, CONFIG))
    empty, survival = follow_akaze(started, nothing, CONFIG)
    assert survival == 0.0
    again, survival = follow_akaze(empty, started.features, CONFIG)
    assert survival == 1.0
    assert again.track_id.min() == started.next_track_id
