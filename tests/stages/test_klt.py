"""Lucas-Kanade tracks: exact to a fraction of a pixel, checked forth and back, topped up, one a point."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from wave_pictures import HEIGHT, WIDTH, Warp, wave_picture

from ttcvid.config import TrackingConfig
from ttcvid.model import PointSet
from ttcvid.stages.tracking.klt import KltMemory, follow_klt, start_klt

CONFIG = TrackingConfig(max_tracks=200)


def followed(first, second, allowed=None, config=CONFIG):
    """Places of the same tracks in two pictures, (N, 2) each, the share that survived, and all points of the second."""
    before = start_klt(first, allowed, config)
    after, survival = follow_klt(before, second, allowed, config)
    _, one, other = np.intersect1d(before.points.track_id, after.points.track_id, return_indices=True)
    return before.points.xy_px[one], after.points.xy_px[other], survival, after.points


@pytest.mark.parametrize(
    ("warp", "median_px"),
    [
        (Warp(shift_px=(0.37, -0.61)), 0.025),
        (Warp(shift_px=(5.3, 2.9)), 0.025),
        (Warp(scale=1.01), 0.025),
        (Warp(scale=0.993, turn_deg=0.2, shift_px=(-2.2, 1.4)), 0.025),
        # The content keeps its distance from the window, and its bearing: that turns.
        (Warp(turn_deg=0.5), 0.04),
    ],
    ids=["sub-pixel", "shift", "approach", "mixed", "roll"],
)
def test_points_are_followed_within_a_twentieth_of_a_pixel(warp, median_px):
    first, second, survival, _ = followed(wave_picture(), wave_picture(warp))
    error = np.linalg.norm(second - warp.to_picture(first), axis=1)
    assert survival > 0.9
    assert len(first) > 150
    assert np.median(error) < median_px
    assert np.percentile(error, 95) < 0.07


def test_a_patch_that_changes_by_a_fiftieth_costs_a_few_hundredths_of_a_pixel():
    """Magnified by 2 % in one step, as at k = 50 frames: the window no longer fits, and says nothing of it."""
    warp = Warp(scale=1.02)
    first, second, survival, _ = followed(wave_picture(), wave_picture(warp))
    error = second - warp.to_picture(first)
    assert survival > 0.9
    assert np.percentile(np.linalg.norm(error, axis=1), 95) < 0.1
    # Without a common part: it would look like a motion of everything.
    assert np.linalg.norm(error.mean(axis=0)) < 0.02


def test_points_that_a_large_bright_thing_sweeps_past_are_not_taken_along():
    def with_bar(left_px):
        picture = (wave_picture() * 0.3).astype(np.uint8)
        picture[:, left_px : left_px + 14] = 250
        return picture

    config = replace_config(max_tracks=300)
    memory = start_klt(with_bar(60), None, config)
    known, n_kept = np.empty(0, dtype=np.int64), []
    for left_px in (78, 96, 114):
        x, track_id = memory.points.xy_px[:, 0], memory.points.track_id
        is_near = (np.abs(x - left_px) < 42) & ((x < left_px - 32) | (x > left_px + 28))
        asked = track_id[is_near & np.isin(track_id, known)]
        known = track_id
        memory, _ = follow_klt(memory, with_bar(left_px), None, config)
        n_kept.append(np.isin(asked, memory.points.track_id).mean() if len(asked) else np.nan)
    # Without a second look at them 0.3 of them are.
    assert min(n_kept[1:]) > 0.8


def test_a_still_picture_moves_no_point():
    first, second, survival, _ = followed(wave_picture(), wave_picture())
    assert survival > 0.98
    np.testing.assert_allclose(second, first, atol=0.01)


def test_a_constant_step_is_expected_to_go_on():
    """A move that the pyramid cannot reach from rest is followed when it has built up."""
    config = replace_config(pyramid_levels=0)
    memory = start_klt(wave_picture(), None, config)
    start = memory.points
    for shift in (2.0, 6.0, 12.0, 20.0):
        memory, _ = follow_klt(memory, wave_picture(Warp(shift_px=(shift, 0.0))), None, config)
    _, one, other = np.intersect1d(start.track_id, memory.points.track_id, return_indices=True)
    step = memory.points.xy_px[other] - start.xy_px[one]
    assert len(one) > 60
    assert np.mean(np.linalg.norm(step - [20.0, 0.0], axis=1) < 0.1) > 0.95


def test_points_that_get_covered_are_given_up():
    cover = (slice(40, 110), slice(60, 150))
    second = wave_picture(Warp(shift_px=(1.5, 0.5)))
    second[cover] = wave_picture(seed=9)[cover]
    before = start_klt(wave_picture(), None, CONFIG)
    after, _ = follow_klt(before, second, None, CONFIG)
    x, y = before.points.xy_px.T
    # Well inside: the whole window of such a point shows something else.
    hidden = before.points.track_id[(x > 68) & (x < 142) & (y > 48) & (y < 102)]
    visible = before.points.track_id[(x < 50) | (x > 160) | (y < 30) | (y > 120)]
    assert len(hidden) > 15
    assert np.isin(hidden, after.points.track_id).mean() < 0.1
    assert np.isin(visible, after.points.track_id).mean() > 0.9


def test_points_that_leave_the_picture_end():
    warp = Warp(shift_px=(12.0, 0.0))
    before = start_klt(wave_picture(), None, CONFIG)
    after, _ = follow_klt(before, wave_picture(warp), None, CONFIG)
    gone = before.points.track_id[warp.to_picture(before.points.xy_px)[:, 0] > WIDTH - 1]
    assert len(gone) > 3
    assert not np.isin(gone, after.points.track_id).any()
    assert (after.points.xy_px >= 0).all()
    assert (after.points.xy_px <= [WIDTH - 1, HEIGHT - 1]).all()


def test_tracks_keep_their_numbers_and_new_ones_get_fresh_numbers():
    memory = start_klt(wave_picture(), None, CONFIG, next_track_id=1000)
    seen = set(memory.points.track_id.tolist())
    assert min(seen) == 1000
    for step in range(1, 6):
        before = memory
        memory, _ = follow_klt(memory, wave_picture(Warp(shift_px=(9.0 * step, 0.0))), None, CONFIG)
        ids = memory.points.track_id
        assert (np.diff(ids) > 0).all()
        fresh = set(ids.tolist()) - set(before.points.track_id.tolist())
        assert not fresh & seen
        seen |= fresh
    assert memory.next_track_id == max(seen) + 1


def test_tracks_that_die_are_replaced_apart_from_those_that_live():
    config = replace_config(max_tracks=150)
    memory = start_klt(wave_picture(), None, config)
    n_first = len(memory.points.track_id)
    for step in range(1, 7):
        memory, _ = follow_klt(memory, wave_picture(Warp(shift_px=(15.0 * step, 0.0))), None, config)
    is_new = memory.points.track_id >= n_first
    assert is_new.sum() > 20
    assert 0.8 * n_first <= len(is_new) <= config.max_tracks
    old, new = memory.points.xy_px[~is_new], memory.points.xy_px[is_new]
    # New corners keep clear of old tracks in the picture they were found in; later they may draw together a little.
    distance = np.linalg.norm(new[:, None] - old[None], axis=2).min(axis=1)
    assert np.mean(distance > config.min_distance_px - 1.5) > 0.7
    # On small things they may stand at this part of the distance.
    assert distance.min() > 0.57 * config.min_distance_px - 1.5


def test_of_two_tracks_on_one_point_the_older_one_lives():
    start = start_klt(wave_picture(), None, CONFIG)
    n = len(start.points.track_id)
    doubled = PointSet(
        np.concatenate([start.points.track_id, 500 + start.points.track_id]),
        np.concatenate([start.points.xy_px, start.points.xy_px]),
    )
    memory = KltMemory(start.grey, doubled, np.zeros((2 * n, 2)), 2000, start.grey, np.zeros(2 * n, dtype=np.int64))
    after, _ = follow_klt(memory, wave_picture(Warp(shift_px=(0.8, 0.3))), None, replace_config(max_tracks=20))
    assert (after.points.track_id < 500).all()
    assert len(after.points.track_id) > 0.85 * n


def test_points_that_wander_under_the_mask_end():
    allowed = np.full((HEIGHT, WIDTH), 255, np.uint8)
    allowed[:, :80] = 0
    memory = start_klt(wave_picture(), allowed, CONFIG)
    for step in range(1, 4):
        memory, _ = follow_klt(memory, wave_picture(Warp(shift_px=(-6.0 * step, 0.0))), allowed, CONFIG)
        assert (memory.points.xy_px[:, 0] > 79).all()
    assert len(memory.points.track_id) > 50


def test_a_picture_without_points_is_followed_into_one_with_points():
    plain = np.full((HEIGHT, WIDTH), 90, np.uint8)
    empty = start_klt(plain, None, CONFIG)
    assert len(empty.points.track_id) == 0
    memory, survival = follow_klt(empty, wave_picture(), None, CONFIG)
    assert survival == 1.0
    assert len(memory.points.track_id) > 100


def replace_config(**changes):
    return CONFIG.model_copy(update=changes)


def test_following_is_a_function_of_its_arguments():
    memory = start_klt(wave_picture(), None, CONFIG)
    second = wave_picture(Warp(scale=1.01))
    one, _ = follow_klt(memory, second, None, CONFIG)
    other, _ = follow_klt(replace(memory), second, None, CONFIG)
    np.testing.assert_array_equal(one.points.xy_px, other.points.xy_px)


def with_things(left_px, tops_px, size_px):
    """A street at rest and before it things of other textures, whose left edges stand at ``left_px``."""
    picture = wave_picture()
    first, last = max(left_px, 0), min(left_px + size_px[0], WIDTH)
    for k, top_px in enumerate(tops_px if first < last else []):
        thing = wave_picture(seed=7 + k)[: size_px[1], first - left_px : last - left_px]
        picture[top_px : top_px + size_px[1], first:last] = thing
    return picture


def on_things(memory, left_px, tops_px, size_px):
    """Which tracks stand on one of them, clear of its edges: (N,)."""
    off_px = memory.points.xy_px[:, None] - [[left_px, top_px] for top_px in tops_px]
    return ((off_px > 2) & (off_px < np.array(size_px) - 3)).all(axis=2).any(axis=1)


def test_what_comes_into_the_picture_of_a_camera_at_rest_is_followed_within_some_pictures():
    """No track of the street dies but those that it covers, one in fifty a picture."""
    config = replace_config(max_tracks=300, min_distance_px=6.0)
    thing = {"tops_px": [50], "size_px": (70, 44)}
    memory = start_klt(with_things(-70, **thing), None, config)
    for left_px in range(-66, 8, 4):
        memory, survival = follow_klt(memory, with_things(left_px, **thing), None, config)
        assert survival > 0.95
    known = memory.points.track_id
    memory, _ = follow_klt(memory, with_things(10, **thing), None, config)
    kept = on_things(memory, 10, **thing) & np.isin(memory.points.track_id, known)
    assert kept.sum() >= 15


def test_faint_movers_before_a_camera_at_rest_have_tracks_though_the_street_could_have_them_all():
    """The street has more corners than are wanted, each of them better than those of the mover."""
    config = replace_config(max_tracks=150, min_distance_px=5.0)
    texture = np.rint(128 + 0.3 * (wave_picture(seed=9)[:40, :60].astype(float) - 128)).astype(np.uint8)

    def picture(left_px):
        street = wave_picture()
        street[50:90, left_px : left_px + 60] = texture
        return street

    memory = start_klt(picture(10), None, config)
    assert len(memory.points.track_id) == 150
    for left_px in range(12, 44, 2):
        memory, _ = follow_klt(memory, picture(left_px), None, config, camera_rests=True)
    is_on_it = on_things(memory, 42, [50], (60, 40))
    assert is_on_it.sum() >= 20
    # The street keeps half of what there may be, its oldest tracks.
    assert 60 < np.count_nonzero(memory.points.track_id[~is_on_it] < 150) <= 75
    assert len(memory.points.track_id) <= 150


def test_new_points_on_small_fast_things_go_where_their_others_have_gone():
    """Pyramids mix the things with the street: they alone lead half of the new points astray."""
    config = replace_config(max_tracks=600, min_distance_px=5.0)
    things = {"tops_px": [10, 42, 74, 106], "size_px": (40, 24)}
    before = start_klt(with_things(60, **things), None, config)
    after, _ = follow_klt(before, with_things(88, **things), None, config)
    asked = before.points.track_id[on_things(before, 60, **things)]
    _, one, other = np.intersect1d(before.points.track_id, after.points.track_id, return_indices=True)
    step_px = (after.points.xy_px[other] - before.points.xy_px[one])[np.isin(before.points.track_id[one], asked)]
    went_along = np.linalg.norm(step_px - [28.0, 0.0], axis=1) < 0.5
    assert went_along.sum() > 0.8 * len(asked) > 15


COPIED = np.s_[40:120, 30:150]
"""Where a codec has copied the last picture."""


def copied_between(n_copied, step_px):
    """Memory after two pictures of a steady motion, after those with a part copied, and after one without."""
    pictures = [wave_picture(Warp(shift_px=(step_px * count, 0.0))) for count in range(3 + n_copied)]
    memory = start_klt(pictures[0], None, CONFIG)
    memory, _ = follow_klt(memory, pictures[1], None, CONFIG)
    before = memory
    for picture in pictures[2:-1]:
        sent = picture.copy()
        sent[COPIED] = memory.grey[COPIED]
        memory, _ = follow_klt(memory, sent, None, CONFIG)
    after, _ = follow_klt(memory, pictures[-1], None, CONFIG)
    return before, memory, after


def inside_copied(points, margin_px=8.0):
    rows, columns = COPIED
    x, y = points.xy_px.T
    is_inside = (x > columns.start + margin_px) & (x < columns.stop - margin_px)
    return set(points.track_id[is_inside & (y > rows.start + margin_px) & (y < rows.stop - margin_px)].tolist())


@pytest.mark.parametrize("n_copied", [1, 4])
def test_a_copy_of_the_last_picture_is_no_observation(n_copied):
    before, copied, after = copied_between(n_copied, step_px=3.0)
    inside, seen = inside_copied(before.seen), copied.seen
    assert len(inside) > 10
    assert not inside & {*seen.track_id.tolist()}
    # They are followed on, and found again where they have gone meanwhile.
    assert len(inside & {*seen.unseen_id.tolist()}) > 0.9 * len(inside)
    _, one, other = np.intersect1d(before.points.track_id, after.seen.track_id, return_indices=True)
    assert len(inside & {*after.seen.track_id.tolist()}) > 0.8 * len(inside)
    gone_px = after.seen.xy_px[other] - before.points.xy_px[one]
    np.testing.assert_allclose(np.median(gone_px, axis=0), [3.0 * (n_copied + 1), 0.0], atol=0.1)


def test_corners_that_are_found_in_a_copy_are_seen_once_it_is_sent_anew():
    _, copied, after = copied_between(6, step_px=8.0)
    is_new = np.isnan(copied.step_px[:, 0]) & (copied.n_copied > 0)
    new_id = set(copied.points.track_id[is_new].tolist())
    assert new_id
    assert not new_id & {*copied.seen.track_id.tolist()}
    assert new_id & {*after.points.track_id.tolist()} <= {*after.seen.track_id.tolist()}


def test_what_stood_before_is_seen_in_its_copy_and_so_is_a_picture_that_stands():
    before, copied, _ = copied_between(3, step_px=0.2)
    assert inside_copied(before.seen) <= {*copied.seen.track_id.tolist()}
    memory = copied_between(1, step_px=3.0)[0]
    standing, _ = follow_klt(memory, memory.grey, None, CONFIG)
    assert len(standing.seen.track_id) == len(standing.points.track_id)


def street_front(shift_px):
    """House fronts with rows of windows that are all alike, above a street."""
    wall = np.full((HEIGHT, WIDTH + 80), 150.0)
    for top in range(10, HEIGHT, 26):
        for left in range(10, WIDTH + 60, 20):
            wall[top : top + 14, left : left + 9] = 60.0
            wall[top + 6 : top + 8, left : left + 9] = 200.0
    move = np.array([[1.0, 0.0, shift_px[0] - 40.0], [0.0, 1.0, shift_px[1]]])
    wall = cv2.warpAffine(cv2.GaussianBlur(wall, (0, 0), 0.8), move, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC)
    street = wave_picture(Warp(shift_px=shift_px))
    wall[HEIGHT // 2 :] = street[HEIGHT // 2 :]
    return np.clip(wall, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("jump_px", [(12.0, 0.0), (-11.0, 0.0)])
def test_a_shaken_camera_takes_no_window_of_a_house_for_its_neighbour(jump_px):
    memory = start_klt(street_front((0.0, 0.0)), None, CONFIG)
    memory, _ = follow_klt(memory, street_front((1.0, 0.0)), None, CONFIG)
    before = memory.points
    memory, part = follow_klt(memory, street_front((2.0 + jump_px[0], jump_px[1])), None, CONFIG)
    _, one, other = np.intersect1d(before.track_id, memory.points.track_id, return_indices=True)
    step_px = memory.points.xy_px[other] - before.xy_px[one]
    is_right = np.linalg.norm(step_px - (1.0 + jump_px[0], jump_px[1]), axis=1) < 0.5
    assert is_right.mean() > 0.95
    assert part > 0.6


def shaken_front(shift_px, roll_deg):
    """House fronts whose windows differ a little, as those of a real house do, seen by a camera that rolls too."""
    rng = np.random.default_rng(3)
    wall = np.full((HEIGHT + 80, WIDTH + 80), 150.0)
    for top in range(0, HEIGHT + 60, 20):
        for left in range(0, WIDTH + 60, 14):
            wall[top : top + 12, left : left + 8] = rng.uniform(50.0, 70.0)
            wall[top + 5 : top + 7, left : left + 8] = rng.uniform(190.0, 210.0)
    turn = shaken_by(shift_px, roll_deg)
    turn[:, 2] += turn[:, :2] @ (-40.0, -40.0)
    wall = cv2.warpAffine(cv2.GaussianBlur(wall, (0, 0), 0.8), turn, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC)
    return np.clip(wall, 0, 255).astype(np.uint8)


def shaken_by(shift_px, roll_deg):
    """The shake as a matrix (2, 3)."""
    turn = cv2.getRotationMatrix2D((0.5 * WIDTH, 0.5 * HEIGHT), roll_deg, 1.0)
    turn[:, 2] += shift_px
    return turn


@pytest.mark.parametrize(("shift_px", "roll_deg"), [((-6.0, -2.0), -1.2), ((-5.0, 0.0), 0.8), ((0.0, 0.0), 4.0)])
def test_windows_that_a_shake_with_a_roll_leads_to_their_neighbours_are_put_right(shift_px, roll_deg):
    memory = start_klt(shaken_front((-1.0, 0.0), 0.0), None, CONFIG)
    memory, _ = follow_klt(memory, shaken_front((0.0, 0.0), 0.0), None, CONFIG)
    # Those whose step is known: what is new may take its neighbour's window.
    before = memory.points.take(np.linalg.norm(memory.step_px - (1.0, 0.0), axis=1) < 0.5)
    memory, part = follow_klt(memory, shaken_front(shift_px, roll_deg), None, CONFIG)
    _, one, other = np.intersect1d(before.track_id, memory.points.track_id, return_indices=True)
    turn = shaken_by(shift_px, roll_deg)
    true_px = before.xy_px[one] @ turn[:, :2].T + turn[:, 2]
    is_right = np.linalg.norm(memory.points.xy_px[other] - true_px, axis=1) < 0.5
    assert is_right.mean() > 0.95
    assert part > 0.6


def before_a_lorry(depth_m, seed):
    """House fronts whose windows are all alike, and a lorry before most of them."""
    rng = np.random.default_rng(3)
    front = np.full((540, 960), 150.0)
    for top in range(4, 524, 20):
        for left in range(4, 948, 14):
            front[top : top + 12, left : left + 8] = 60.0
            front[top + 5 : top + 7, left : left + 8] = 200.0
    side = cv2.GaussianBlur(rng.normal(size=(800, 800)), (0, 0), 2.2)
    side = 128.0 + 45.0 * side / side.std()
    scale = 3.6 / depth_m
    place = np.array([[scale, 0.0, 620.0 - 2560.0 / depth_m], [0.0, scale, 270.0 - 1440.0 / depth_m]])
    lorry = cv2.warpAffine(side, place, (960, 540), borderValue=-1e6)
    picture = np.where(lorry > -1e3, lorry, cv2.GaussianBlur(front, (0, 0), 0.8))
    picture += np.random.default_rng(seed).normal(scale=1.5, size=picture.shape)
    return np.clip(picture, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("depth_m", [(6.4, 5.6, 4.8), (6.6, 5.6, 4.6)])
def test_a_lorry_that_fills_most_of_the_picture_before_a_mast_leaves_the_street_where_it_is(depth_m):
    """Most points go as it grows, and it grows faster from picture to picture."""
    first, second, third = (before_a_lorry(depth, seed) for seed, depth in enumerate(depth_m))
    config = TrackingConfig(max_tracks=600)
    memory, _ = follow_klt(start_klt(first, None, config), second, None, config)
    left_px, right_px = (620.0 + side / depth_m[-1] for side in (-2560.0, 320.0))
    x_px = memory.points.windows_px[:, 0]
    in_street = (x_px < left_px - 10.0) | (x_px > right_px + 10.0)
    before = memory.points.take(in_street & (np.linalg.norm(memory.step_px, axis=1) < 0.5))
    memory, _ = follow_klt(memory, third, None, config)
    _, one, other = np.intersect1d(before.track_id, memory.points.track_id, return_indices=True)
    assert len(one) > 20
    np.testing.assert_allclose(memory.points.windows_px[other], before.windows_px[one], atol=0.8)


def test_what_moves_by_itself_in_a_shaken_picture_is_followed():
    street, thing = wave_picture(), wave_picture(Warp(turn_deg=90.0))[60:100, 60:100]

    def seen(shift_px, left_px):
        move = np.array([[1.0, 0.0, shift_px], [0.0, 1.0, 0.0]])
        picture = cv2.warpAffine(street, move, (WIDTH, HEIGHT), borderMode=cv2.BORDER_REFLECT)
        picture[60:100, left_px : left_px + 40] = thing
        return picture

    memory = start_klt(seen(0.0, 100), None, CONFIG)
    memory, _ = follow_klt(memory, seen(1.0, 102), None, CONFIG)
    inside = np.all(np.abs(memory.points.windows_px - (121.5, 79.5)) < 14.0, axis=1)
    before = memory.points.take(inside & np.isfinite(memory.step_px[:, 0]))
    memory, _ = follow_klt(memory, seen(-9.0, 104), None, CONFIG)
    _, one, other = np.intersect1d(before.track_id, memory.points.track_id, return_indices=True)
    assert len(one) >= 0.8 * len(before.track_id)
    assert len(one) > 4
    step_px = memory.points.xy_px[other] - before.xy_px[one]
    assert np.mean(np.linalg.norm(step_px - (2.0, 0.0), axis=1) < 0.3) > 0.9
