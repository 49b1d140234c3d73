"""What contradicts the scene, by compiled loops, held against the plain formulas."""

from types import SimpleNamespace

import numpy as np
import pytest

from ttcvid.config import BodiesConfig
from ttcvid.stages.segmentation import births, ground_plane, merge_and_split

N, K = 80, 5


@pytest.mark.parametrize("seed", range(5))
def test_candidates_are_those_whose_neighbourhood_has_a_large_median_misfit(seed):
    rng, config = np.random.default_rng(seed), BodiesConfig()
    neighbours = rng.integers(0, N, (N, K))
    neighbours[rng.random((N, K)) < 0.3] = -1
    neighbours = np.where(neighbours < 0, np.arange(N)[:, None], neighbours)
    is_asked, misfit = rng.random(N) < 0.8, config.scene_gate * np.exp(rng.normal(0.3, 1.5, N))
    misfit[rng.random(N) < 0.1] = 0.0
    expected = []
    for i in np.flatnonzero(is_asked & (misfit > config.scene_gate)):
        around = [misfit[i], *(misfit[j] for j in neighbours[i] if j != i and is_asked[j])]
        together = np.median(np.log(np.maximum(around, 0.1)))
        if len(around) >= 3 and together > 0.6 * np.log(config.scene_gate):
            expected.append(i)
    found = births._candidates(neighbours, is_asked, misfit, config)
    np.testing.assert_array_equal(found, expected)


def test_a_track_on_a_road_is_given_the_slip_of_its_window_and_one_not_seen_before_is_not():
    rng = np.random.default_rng(0)
    rays, sigma, misfit = rng.normal(size=(3, N, 3)), rng.uniform(0.001, 0.1, N), rng.uniform(0.0, 50.0, N)
    rays[-2, :20], on_road = np.nan, rng.random(N) < 0.5
    slip2 = 0.02**2 * np.nan_to_num(np.sum((rays[-1] - rays[-2]) ** 2, axis=1))
    expected = np.where(on_road, sigma**2 / (sigma**2 + slip2), 1.0) * misfit
    found = births._without_slip(SimpleNamespace(rays=rays, sigma_norm=sigma), on_road, misfit)
    np.testing.assert_allclose(found, expected, rtol=1e-14)


def test_movers_touch_where_a_track_of_one_is_beside_a_track_of_the_other():
    rng = np.random.default_rng(1)
    number, neighbours = rng.integers(0, 6, N), rng.integers(0, N, (N, 1))
    neighbours[rng.random(N) < 0.9, 0] = 0
    number[number == 5] = np.where(np.arange(np.count_nonzero(number == 5)) < 2, 5, 0)
    counts, expected = np.bincount(number, minlength=6), {}
    for one in range(1, 6):
        for other in range(one + 1, 6):
            if min(counts[one], counts[other]) >= 3:
                large, small = (one, other) if counts[one] >= counts[other] else (other, one)
                expected[large - 1, small - 1] = bool(np.any(number[neighbours[number == one]] == other))
    pairs, touch = np.empty((10, 2), dtype=np.int64), np.empty(10, dtype=bool)
    count = merge_and_split._list_pairs(number, neighbours, 5, pairs, touch)
    found = [(int(large), int(small)) for large, small in pairs[:count]]
    assert dict(zip(found, touch[:count].tolist(), strict=True)) == expected
    assert 0 < sum(expected.values()) < count == len(expected)


def test_the_plane_of_a_road_is_that_of_weighted_least_squares():
    rng, road_hz = np.random.default_rng(2), np.array([0.02, 0.01, 1.0])
    place = rng.uniform((-0.6, 0.1), (0.6, 0.4), (N, 2))
    columns = np.column_stack([np.ones(N), place])
    rate = columns @ road_hz * np.exp(rng.normal(0.0, 0.03, N))
    expected = found = np.array([0.0, 0.0, 1.05])
    found = found.copy()
    for _ in range(2):
        predicted = columns @ expected
        used = np.abs(rate - predicted) < 1.5 * 0.08 * predicted
        weighted = columns[used] / predicted[used, None]
        normal = weighted.T @ weighted
        normal[1, 1] += normal[2, 2] * 0.1**2
        expected = np.linalg.solve(normal, weighted.T @ (rate[used] / predicted[used]))
    assert ground_plane._fit_plane(place, rate, np.ones(len(rate)), found)
    np.testing.assert_allclose(found, expected, rtol=1e-11)
    assert not ground_plane._fit_plane(place[:8], rate[:8], np.ones(8), found.copy())
