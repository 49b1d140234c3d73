"""Corners: well spread, apart from each other and from the points already there, and only where allowed."""

import cv2
import numpy as np
import pytest
from scipy.spatial.distance import pdist
from wave_pictures import HEIGHT, WIDTH, wave_picture

from ttcvid.config import TrackingConfig
from ttcvid.stages.tracking import corners
from ttcvid.stages.tracking.corners import find_corners, find_corners_where, occupied_cells

NO_POINTS = np.empty((0, 2))
# Part of the corners that may stand close, and of the distance what is kept between those.
CLOSE_SHARE = 0.1
CLOSEST = 0.57
# Part of the corners that goes where the picture moves least.
FAR_SHARE = 0.4


def corners_of(
    picture, allowed, taken_px, n_wanted, min_distance_px, quality, close_share, far_share=FAR_SHARE, **options
):
    shares = {"close_share": close_share, "far_share": far_share}
    config = TrackingConfig(min_distance_px=min_distance_px, corner_quality=quality, **shares)
    return find_corners(picture, allowed, taken_px, n_wanted, config, **options)


def checkerboard(square_px=20, contrast=200):
    """Corners between the pixels k * square_px - 1 and k * square_px."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH] // square_px
    return (contrast * ((x + y) % 2)).astype(np.uint8)


def test_corners_of_a_checkerboard_are_found_between_its_pixels():
    found = corners_of(checkerboard(), None, NO_POINTS, 500, 7.0, 0.01, CLOSE_SHARE)
    x, y = np.meshgrid(np.arange(20, WIDTH, 20) - 0.5, np.arange(20, HEIGHT, 20) - 0.5)
    true = np.column_stack([x.ravel(), y.ravel()])
    distance = np.linalg.norm(true[:, None] - found[None], axis=2)
    assert distance.min(axis=1).max() < 0.6
    assert distance.min(axis=0).max() < 0.6


@pytest.mark.parametrize("sigma_grey", [0.0, 0.5, 1.0, 2.0, 4.0, 8.0])
def test_plain_picture_has_no_corners_and_sensor_noise_makes_next_to_none(sigma_grey):
    noisy = np.rint(120 + np.random.default_rng(3).normal(0, sigma_grey, (HEIGHT, WIDTH))).astype(np.uint8)
    n_at_most = 0 if sigma_grey < 1.0 else 1
    assert len(corners_of(noisy, None, NO_POINTS, 100, 7.0, 0.005, CLOSE_SHARE)) <= n_at_most
    assert len(find_corners_where(noisy, np.ones_like(noisy), NO_POINTS, 100, 7.0)) <= n_at_most


@pytest.mark.parametrize("sigma_grey", [2.0, 4.0])
def test_in_a_noisy_picture_corners_stand_on_what_has_texture(sigma_grey):
    """Ground below a sky, whose noise would hold half of the tracks and tell that nothing moves."""
    clean = np.full((HEIGHT, WIDTH), 128.0)
    clean[HEIGHT // 2 :] = wave_picture()[HEIGHT // 2 :]
    noisy = clean + np.random.default_rng(3).normal(0, sigma_grey, clean.shape)
    found = corners_of(np.clip(np.rint(noisy), 0, 255).astype(np.uint8), None, NO_POINTS, 200, 7.0, 0.005, 0.1)
    assert len(found) > 100
    assert (found[:, 1] > HEIGHT // 2 - 3).mean() > 0.99


@pytest.mark.parametrize("anywhere", [False, True])
def test_no_corner_stands_on_a_line_between_its_ends(anywhere):
    """The kerb of a bend: its windows would slip, and say that nothing turns."""
    picture = np.full((HEIGHT, WIDTH), 90, np.uint8)
    first, last = np.array([30, HEIGHT - 40]), np.array([WIDTH - 40, 30])
    cv2.line(picture, first.tolist(), last.tolist(), 200, 5, cv2.LINE_AA)
    picture = np.rint(picture + np.random.default_rng(5).normal(0, 2.0, picture.shape)).astype(np.uint8)
    if anywhere:
        found = find_corners_where(picture, np.ones_like(picture), NO_POINTS, 100, 7.0)
    else:
        found = corners_of(picture, None, NO_POINTS, 100, 7.0, 0.005, CLOSE_SHARE)
    length_px = np.linalg.norm(last - first)
    along = (last - first) / length_px
    is_on_line = np.abs((found - first) @ [-along[1], along[0]]) < 5.0
    place_px = (found[is_on_line] - first) @ along
    assert (np.abs(place_px) < 12.0).any()
    assert (np.abs(place_px - length_px) < 12.0).any()
    assert not ((place_px > 12.0) & (place_px < length_px - 12.0)).any()


def test_a_tree_does_not_take_all_corners():
    """A quarter of the picture has three times the contrast; the rest keeps its share all the same."""
    picture = wave_picture().astype(float) - 128
    picture[:, WIDTH // 4 :] *= 0.33
    found = corners_of(np.rint(picture + 128).astype(np.uint8), None, NO_POINTS, 1000, 7.0, 0.005, CLOSE_SHARE)
    in_faint_part = found[:, 0] > WIDTH / 4 + 3
    density_faint = np.count_nonzero(in_faint_part) / (0.75 * WIDTH)
    density_strong = np.count_nonzero(~in_faint_part) / (0.25 * WIDTH)
    assert density_faint > 0.5 * density_strong


def test_strongest_corners_come_first():
    picture = checkerboard(contrast=40)
    picture[:, : WIDTH // 2] = checkerboard(contrast=250)[:, : WIDTH // 2]
    found = corners_of(picture, None, NO_POINTS, 20, 7.0, 0.001, CLOSE_SHARE)
    assert len(found) == 20
    of_the_grid = found[:18]
    assert (of_the_grid[:, 0] < WIDTH / 2 + 1).all()


@pytest.mark.parametrize("min_distance_px", [5.0, 7.0, 15.0])
def test_new_corners_keep_their_distance_from_points_already_there(min_distance_px):
    taken = np.random.default_rng(1).uniform([0, 0], [WIDTH - 1, HEIGHT - 1], (60, 2))
    found = corners_of(wave_picture(), None, taken, 1000, min_distance_px, 0.005, CLOSE_SHARE)
    distance = np.linalg.norm(found[:, None] - taken[None], axis=2)
    assert len(found) > 10
    # A corner may move by half a pixel when it is refined.
    assert distance.min() > CLOSEST * min_distance_px - 0.75


def test_a_cell_gives_one_corner_before_more_are_wanted():
    found = corners_of(wave_picture(), None, NO_POINTS, 60, 10.0, 0.001, CLOSE_SHARE)[:54]
    cells = np.unique(np.floor(np.rint(found) / 10.0), axis=0)
    # Refined by up to half a pixel, a corner may look as if it stood in the next cell.
    assert len(cells) > 0.9 * len(found)


def test_a_small_thing_before_a_plain_wall_has_more_corners_than_the_grid_has_cells_there():
    picture = np.full((HEIGHT, WIDTH), 120, np.uint8)
    picture[100:120, 100:120] = checkerboard(square_px=5)[100:120, 100:120]
    on_it = corners_of(picture, None, NO_POINTS, 1000, 10.0, 0.005, CLOSE_SHARE)
    assert ((on_it > 97) & (on_it < 122)).all()
    assert len(on_it) >= 8


def test_what_stands_out_of_its_surroundings_gets_the_corners_that_may_stand_close():
    """A faint thing before plain sky, and the rest of the picture full of stronger corners."""
    picture = wave_picture().astype(float)
    sky = np.s_[: HEIGHT // 2]
    picture[sky] = 120
    thing = np.s_[40:52, 100:124]
    picture[thing] = 120 + 0.15 * (checkerboard(square_px=6).astype(float)[thing] - 100)
    found = corners_of(np.rint(picture).astype(np.uint8), None, NO_POINTS, 120, 10.0, 0.005, CLOSE_SHARE)
    on_thing = (found[:, 1] < 56) & (np.abs(found[:, 0] - 112) < 16)
    assert len(found) <= 120
    assert np.count_nonzero(on_thing) >= 6


@pytest.mark.parametrize("picture", [checkerboard(), wave_picture()], ids=["checkerboard", "texture"])
def test_new_corners_keep_their_distance_from_each_other(picture):
    found = corners_of(picture, None, NO_POINTS, 1000, 7.0, 0.005, CLOSE_SHARE)
    assert pdist(found).min() > CLOSEST * 7.0 - 1.5


def test_without_a_share_of_close_corners_all_keep_the_whole_distance():
    wanted = 1000
    apart = corners_of(wave_picture(), None, NO_POINTS, wanted, 10.0, 0.005, 0.0)
    assert pdist(apart).min() > 10.0 - 1.5
    assert len(apart) < len(corners_of(wave_picture(), None, NO_POINTS, wanted, 10.0, 0.005, CLOSE_SHARE))


def test_a_part_of_the_corners_goes_where_the_picture_moves_least():
    """The camera turns: what is far away moves by that alone, and of what is near some stands still in the picture."""
    taken = np.random.default_rng(2).uniform([8, 8], [WIDTH - 8, HEIGHT - 8], (60, 2))
    is_far = taken[:, 0] > WIDTH / 2
    step_px = np.where(is_far[:, None], [8.0, 0.0], [0.0, 0.0])
    step_px[::9] = np.nan
    taken, step_px = (values[is_far | (np.arange(60) % 3 > 0)] for values in (taken, step_px))
    assert np.nanmedian(step_px[:, 0]) == 8.0

    def part_far_away(step_px):
        found = corners_of(wave_picture(), None, taken, 120, 7.0, 0.005, CLOSE_SHARE, step_px=step_px)
        assert np.linalg.norm(found[:, None] - taken[None], axis=2).min() > CLOSEST * 7.0 - 0.75
        return np.mean(found[:, 0] > WIDTH / 2)

    assert part_far_away(step_px) > part_far_away(None) + 0.15
    assert part_far_away(-step_px) == part_far_away(step_px)
    assert part_far_away(np.full_like(step_px, np.nan)) == part_far_away(None)


@pytest.mark.parametrize(("close_share", "far_share"), [(0.9, 0.2), (1.0, 1.0), (0.6, 0.6)])
def test_shares_beyond_the_whole_give_no_more_than_is_wanted(close_share, far_share):
    taken = np.random.default_rng(1).uniform([0, 0], [WIDTH - 1, HEIGHT - 1], (60, 2))
    step_px = np.ones_like(taken)
    found = corners_of(wave_picture(), None, taken, 20, 7.0, 0.005, close_share, far_share, step_px=step_px)
    assert len(found) == 20


def test_corners_far_away_keep_their_distance_from_tracks_that_stand_close_but_for_a_few():
    nearest = []
    for seed in range(20):
        taken = np.random.default_rng(seed).uniform([8, 8], [WIDTH - 8, HEIGHT - 8], (250, 2))
        apart = np.linalg.norm(taken[:, None] - taken[None], axis=2) + 100.0 * np.eye(len(taken))
        taken = taken[apart.min(axis=1) > CLOSEST * 7.0]
        found = corners_of(wave_picture(), None, taken, 200, 7.0, 0.005, 0.0, 0.3, step_px=np.ones_like(taken))
        nearest.append(np.linalg.norm(found[:, None] - taken[None], axis=2).min(axis=1))
    assert np.mean(np.concatenate(nearest) < 7.0 - 0.75) < 0.02


def test_asked_for_none_gives_none_and_never_more_than_asked():
    assert len(corners_of(wave_picture(), None, NO_POINTS, 0, 7.0, 0.005, CLOSE_SHARE)) == 0
    assert len(corners_of(wave_picture(), None, NO_POINTS, -5, 7.0, 0.005, CLOSE_SHARE)) == 0
    assert len(corners_of(wave_picture(), None, NO_POINTS, 17, 7.0, 0.005, CLOSE_SHARE)) == 17


def test_corners_stand_only_where_the_mask_allows_them():
    allowed = np.zeros((HEIGHT, WIDTH), np.uint8)
    allowed[40:90, 60:200] = 255
    found = corners_of(wave_picture(), allowed, NO_POINTS, 1000, 7.0, 0.005, CLOSE_SHARE)
    column, row = np.rint(found).astype(int).T
    assert len(found) > 20
    assert (allowed[row, column] > 0).all()


def test_corners_keep_clear_of_the_rim_of_the_picture():
    found = corners_of(wave_picture(), None, NO_POINTS, 1000, 7.0, 0.001, CLOSE_SHARE)
    assert (found > 3).all()
    assert (found < [WIDTH - 4, HEIGHT - 4]).all()


def test_occupied_cells_are_those_of_the_points_and_their_neighbours():
    cells = occupied_cells(np.array([[25.0, 15.0]]), (50, 60), 10.0)
    expected = np.zeros((6, 7), dtype=bool)
    expected[0:3, 1:4] = True
    np.testing.assert_array_equal(cells, expected)
    assert not occupied_cells(NO_POINTS, (50, 60), 10.0).any()


def test_places_without_tracks_alone_give_corners_where_only_new_ones_are_asked_for():
    """Something faint has come into a picture whose other corners are followed, but for every seventh."""
    picture = wave_picture().astype(float) - 128
    picture[:, WIDTH // 2 :] *= 0.4
    picture = np.rint(picture + 128).astype(np.uint8)
    corners = corners_of(picture, None, NO_POINTS, 1000, 7.0, 0.005, 0.0)
    known = corners[corners[:, 0] < WIDTH / 2]
    known = known[np.arange(len(known)) % 7 > 0]
    found = corners_of(picture, None, known, 20, 7.0, 0.005, 0.0, only_new_places=True)
    assert len(found) == 20
    assert (found[:, 0] > WIDTH / 2 - 10).all()
    assert len(corners_of(picture, None, corners, 20, 7.0, 0.005, 0.1, only_new_places=True)) == 0


def test_faint_corners_are_found_where_they_are_asked_for_and_nowhere_else():
    """Beside far stronger ones; where room is left for more, closer ones follow."""
    picture = 4.0 * (wave_picture().astype(float) - 128)
    picture[:, WIDTH // 2 :] *= 0.03
    picture = np.clip(np.rint(picture + 128), 0, 255).astype(np.uint8)
    where = np.zeros_like(picture)
    where[20:80, WIDTH // 2 + 10 : WIDTH - 20] = 255
    assert not (corners_of(picture, where, NO_POINTS, 1000, 7.0, 0.005, CLOSE_SHARE)).size
    found = find_corners_where(picture, where, NO_POINTS, 1000, 7.0)
    assert len(found) > 15
    assert (where[tuple(np.rint(found).astype(int).T[::-1])] > 0).all()
    few = find_corners_where(picture, where, NO_POINTS, 10, 7.0)
    np.testing.assert_array_equal(few, found[:10])
    assert pdist(few).min() > 7.0 - 1.0
    assert 0.57 * 7.0 - 1.0 < pdist(found).min() < 6.0
    assert len(find_corners_where(picture, where, found, 1000, 7.0)) == 0
    assert len(find_corners_where(picture, where, NO_POINTS, 0, 7.0)) == 0


def test_corners_of_a_large_picture_are_those_found_without_bands(monkeypatch: pytest.MonkeyPatch) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (60, 107), dtype=np.uint8)
    grey = np.asarray(cv2.resize(noise, (642, 360), interpolation=cv2.INTER_CUBIC), dtype=np.uint8)
    taken = np.array([[30.0, 40.0], [500.0, 300.0]])
    whole = corners_of(grey, None, taken, 400, 20.0, 0.01, 0.3)
    monkeypatch.setattr(corners, "_WHOLE_PIXELS", 1000)
    monkeypatch.setattr(corners, "_BAND_PIXELS", 642 * 50)
    assert len(whole) > 100
    np.testing.assert_array_equal(corners_of(grey, None, taken, 400, 20.0, 0.01, 0.3), whole)


@pytest.mark.parametrize("shape", [(10, 200), (200, 10)])
def test_a_picture_smaller_than_what_its_noise_is_told_by_has_corners(shape):
    picture = np.full(shape, 90, np.uint8)
    picture[5:, 5:] = 200
    assert len(find_corners_where(picture, np.ones_like(picture), NO_POINTS, 10, 7.0)) == 1
