"""Nearest binary descriptors: what comparing every bit of every pair finds."""

import cv2
import numpy as np
import pytest

from ttcvid.stages.tracking.hamming import nearest_descriptors


def random_descriptors(n, seed, n_bytes=61):
    return np.random.default_rng(seed).integers(0, 256, (n, n_bytes), dtype=np.uint8)


@pytest.mark.parametrize(("n_one", "n_other", "n_bytes"), [(2, 2, 61), (37, 90, 61), (90, 37, 61), (50, 50, 64)])
def test_neighbours_are_those_of_the_table_of_all_distances(n_one, n_other, n_bytes):
    one, other = random_descriptors(n_one, 1, n_bytes), random_descriptors(n_other, 2, n_bytes)
    differs = np.unpackbits(one, axis=1)[:, None] != np.unpackbits(other, axis=1)[None]
    distance = differs.sum(axis=2)
    nearest, distance_bits, second_bits, nearest_back = nearest_descriptors(one, other)
    np.testing.assert_array_equal(nearest, distance.argmin(axis=1))
    np.testing.assert_array_equal(distance_bits, np.sort(distance, axis=1)[:, 0])
    np.testing.assert_array_equal(second_bits, np.sort(distance, axis=1)[:, 1])
    np.testing.assert_array_equal(nearest_back, distance.argmin(axis=0))


def test_neighbours_are_those_of_opencv():
    one, other = random_descriptors(300, 3), random_descriptors(200, 4)
    nearest, _, second_bits, _ = nearest_descriptors(one, other)
    pairs = cv2.BFMatcher(cv2.NORM_HAMMING).knnMatch(one, other, k=2)
    assert nearest.tolist() == [first.trainIdx for first, _ in pairs]
    assert second_bits.tolist() == [second.distance for _, second in pairs]


def test_of_equal_descriptors_the_first_counts_and_is_its_own_rival():
    one = random_descriptors(3, 5)
    other = np.concatenate([one, one])
    nearest, _, second_bits, _ = nearest_descriptors(one, other)
    assert nearest.tolist() == [0, 1, 2]
    assert second_bits.tolist() == [0, 0, 0]
    assert nearest_descriptors(other, one)[3].tolist() == [0, 1, 2]
