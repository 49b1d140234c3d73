"""What contradicts the scene, held against the plain formulas."""

from dataclasses import replace

import numpy as np
import pytest

from ttcvid.config import BodiesConfig
from ttcvid.stages.segmentation import births, merges, road
from ttcvid.stages.segmentation.data_association import Movers

N, K = 80, 5


@pytest.mark.parametrize("seed", range(5))
def test_candidates_are_those_whose_neighbourhood_has_a_large_median_misfit(seed):
    rng, config = np.random.default_rng(seed), BodiesConfig()
    neighbours = rng.integers(0, N, (N, K))
    neighbours[rng.random((N, K)) < 0.3] = -1
    neighbours = np.where(neighbours < 0, np.arange(N)[:, None], neighbours)
    is_asked, redchi = rng.random(N) < 0.8, config.scene_gate * np.exp(rng.normal(0.3, 1.5, N))
    redchi[rng.random(N) < 0.1] = 0.0
    expected = []
    for i in np.flatnonzero(is_asked & (redchi > config.scene_gate)):
        around = [redchi[i], *(redchi[j] for j in neighbours[i] if j != i and is_asked[j])]
        together = np.median(np.log(np.maximum(around, 0.1)))
        if len(around) >= 3 and together > 0.6 * np.log(config.scene_gate):
            expected.append(i)
    found = births._candidates(neighbours, is_asked, redchi, config)
    np.testing.assert_array_equal(found, expected)


def test_movers_touch_where_a_track_of_one_is_beside_a_track_of_the_other():
    rng = np.random.default_rng(1)
    number, neighbours = rng.integers(0, 6, N), rng.integers(0, N, (N, 1))
    neighbours[rng.random(N) < 0.9, 0] = 0
    number[number == 5] = np.where(np.arange(np.count_nonzero(number == 5)) < 2, 5, 0)
    counts, expected = np.bincount(number, minlength=6), set()
    for one in range(1, 6):
        for other in range(one + 1, 6):
            if min(counts[one], counts[other]) >= 3:
                large, small = (one, other) if counts[one] >= counts[other] else (other, one)
                one_sees_other = (number[neighbours[number == one]] == other).any()
                if one_sees_other or (number[neighbours[number == other]] == one).any():
                    expected.add((large - 1, small - 1))
    due = Movers(np.arange(5), np.zeros(5), np.zeros(5, dtype=np.int64), *[None] * 4)
    found = merges._asked_neighbours(neighbours, number, due)
    assert set(zip(*(places.tolist() for places in found), strict=True)) == expected
    assert 0 < len(expected) < 6


def test_the_plane_of_a_road_is_that_of_most_points_below_the_horizon():
    rng, plane = np.random.default_rng(2), np.array([0.005, 0.0, 1.0])
    place = rng.uniform((-0.6, 0.1), (0.6, 0.4), (N, 2))
    rate_hz = plane[0] + place @ plane[1:]
    rate_hz[: N // 3] *= 1.3
    start = road.Road(np.array([0.0, 0.0, 1.05]))
    seen = road.RoadPoints(place, rate_hz, np.ones(N), np.arange(N), np.zeros(N))
    # But for the priors.
    np.testing.assert_allclose(road._fitted_road(seen, start).plane, plane, atol=2e-3)
    few = road.RoadPoints(place[-8:], rate_hz[-8:], np.ones(8), np.arange(8), np.zeros(8))
    assert road._fitted_road(few, start) is None
    others_weigh_more = replace(seen, weight=np.where(np.arange(N) < N // 3, 9.0, 1.0))
    assert road._fitted_road(others_weigh_more, start) is None
