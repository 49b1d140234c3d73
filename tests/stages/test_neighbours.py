"""Neighbours and parts in the picture, held against brute force and against scipy."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from ttcvid.stages.tracking.neighbours import connected_parts, linked_pairs, nearest_neighbours, without_gaps


@st.composite
def places(draw):
    """Points on a coarse grid, with many equal distances and doubles, or anywhere; negative coordinates too."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n = draw(st.integers(0, 60))
    if draw(st.booleans()):
        return rng.integers(-6, 7, (n, 2)).astype(float)
    return rng.uniform(-500.0, 900.0, (n, 2)) / draw(st.sampled_from([1.0, 20.0, 200.0]))


RADII = st.sampled_from([0.5, 1.0, 1.5, 2.0, 7.3, 40.0, 3000.0])


def squares_of(xy):
    return np.sum((xy[:, None] - xy[None]) ** 2, axis=2)


def neighbours_of_all(xy, count, radius):
    return nearest_neighbours(xy, count, radius, np.ones(len(xy), dtype=bool), np.zeros(len(xy), dtype=np.int64))


@given(xy=places(), radius=RADII, count=st.integers(1, 9))
@settings(max_examples=150)
def test_neighbours_are_the_nearest_others_within_the_radius(xy, radius, count):
    found = neighbours_of_all(xy, count, radius)
    assert found.shape == (len(xy), count)
    square = squares_of(xy)
    for i, row in enumerate(found):
        others = row[row != i]
        near = np.sort(np.delete(square[i], i))
        near = near[near < radius**2][:count]
        # Of equally near ones any.
        assert sorted(square[i, others].tolist()) == near.tolist()
        assert len(np.unique(others)) == len(near)
        assert (row[len(near) :] == i).all()


@given(seed=st.integers(0, 2**32 - 1), n=st.integers(2, 400))
@settings(max_examples=30)
def test_neighbours_are_those_of_a_tree(seed, n):
    xy = np.random.default_rng(seed).uniform(0.0, 640.0, (n, 2))
    distance, index = KDTree(xy).query(xy, k=range(2, 8), distance_upper_bound=60.0)
    expected = np.where(np.isfinite(distance), index, np.arange(n)[:, None])
    np.testing.assert_array_equal(np.sort(neighbours_of_all(xy, 6, 60.0)), np.sort(expected))


@given(xy=places(), radius=RADII, part=st.sampled_from([0.0, 0.1, 0.6]))
@settings(max_examples=150)
def test_neighbours_of_those_asked_are_as_if_all_were(xy, radius, part):
    is_asked = np.random.default_rng(len(xy)).random(len(xy)) < part
    alike = np.zeros(len(xy), dtype=np.int64)
    found, of_all = nearest_neighbours(xy, 6, radius, is_asked, alike), neighbours_of_all(xy, 6, radius)
    np.testing.assert_array_equal(found, np.where(is_asked[:, None], of_all, np.arange(len(xy))[:, None]))


@given(xy=places(), radius=RADII)
@settings(max_examples=150)
def test_pairs_are_all_that_are_closer_than_the_radius_each_once(xy, radius):
    pairs = linked_pairs(xy, radius)
    one, other = np.nonzero(np.triu(squares_of(xy) < radius**2, k=1)) if len(xy) else ([], [])
    assert sorted(map(tuple, pairs.tolist())) == sorted(zip(one, other, strict=True))
    assert (pairs[:, 0] < pairs[:, 1]).all()


def test_points_far_outside_the_picture_cost_no_memory_and_change_nothing():
    """A table may hold a point at a million pixels: the grid is of the cells that something lies in."""
    rng = np.random.default_rng(3)
    near = rng.uniform(0.0, 640.0, (300, 2))
    far = np.concatenate([rng.uniform(-1e6, 1e6, (40, 2)), [[1e6, 0.0], [1e6 + 20.0, 0.0], [0.0, -1e6]]])
    xy = np.concatenate([near, far])
    distance, index = KDTree(xy).query(xy, k=range(2, 8), distance_upper_bound=60.0)
    expected = np.where(np.isfinite(distance), index, np.arange(len(xy))[:, None])
    np.testing.assert_array_equal(np.sort(neighbours_of_all(xy, 6, 60.0)), np.sort(expected))
    pairs = linked_pairs(xy, 30.0)
    assert set(map(tuple, pairs.tolist())) == KDTree(xy).query_pairs(30.0)


def test_neighbours_are_of_the_same_cluster_and_a_point_without_enough_has_itself():
    xy_px = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [1.5, 0.0], [50.0, 0.0], [52.0, 0.0]])
    cluster = np.array([1, 1, 1, 2, 1, 2])
    found = nearest_neighbours(xy_px, 2, 10.0, np.isin(np.arange(len(xy_px)), [0, 3, 5]), cluster)
    assert [set(found[place].tolist()) for place in (0, 3, 5)] == [{1, 2}, {3}, {5}]


def test_points_exactly_a_radius_apart_are_no_neighbours():
    xy = np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 3.9]])
    assert linked_pairs(xy, 5.0).tolist() == [[0, 2], [1, 2]]
    assert neighbours_of_all(xy, 1, 5.0).tolist() == [[2], [2], [1]]


@st.composite
def graphs(draw):
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n = draw(st.integers(0, 40))
    pairs = rng.integers(0, n, (draw(st.integers(0, 60)), 2)) if n else np.empty((0, 2), dtype=np.int64)
    return rng.random(n) < 0.8, pairs


@given(graph=graphs())
@settings(max_examples=150)
def test_parts_are_those_of_scipy(graph):
    is_in, pairs = graph
    n = len(is_in)
    label = connected_parts(is_in, pairs)
    kept = pairs[is_in[pairs].all(axis=1)]
    edges = coo_array((np.ones(len(kept)), (kept[:, 0], kept[:, 1])), shape=(n, n))
    number, expected = connected_components(edges, directed=False) if n else (0, np.empty(0))
    assert len(np.unique(label)) == number
    np.testing.assert_array_equal(label[:, None] == label, expected[:, None] == expected)
    # Numbered by their first track, without gaps.
    first = [np.flatnonzero(label == k)[0] for k in range(number)]
    assert first == sorted(first)


@given(graph=graphs(), seed=st.integers(0, 1000))
def test_parts_do_not_depend_on_the_order_of_the_pairs(graph, seed):
    is_in, pairs = graph
    shuffled = np.random.default_rng(seed).permuted(np.random.default_rng(seed).permutation(pairs), axis=1)
    np.testing.assert_array_equal(connected_parts(is_in, pairs), connected_parts(is_in, shuffled))


def test_two_cars_have_a_gap_between_them_and_one_that_is_sparse_has_none():
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(5.0), np.arange(4.0)))
    car = np.column_stack([x, y])
    for spacing_px, apart_px, n_parts in ((5.0, 18.0, 2), (12.0, 18.0, 1)):
        one = spacing_px * car
        xy_px = np.concatenate([one, one + np.array([4.0 * spacing_px + apart_px, 0.0])])
        pairs = linked_pairs(xy_px, 32.0)
        every = np.ones(len(xy_px), dtype=bool)
        assert len({*connected_parts(every, pairs).tolist()}) == 1
        assert len({*connected_parts(every, without_gaps(pairs, xy_px, 32.0)).tolist()}) == n_parts


def test_gaps_are_measured_by_the_third_nearest_of_those_a_point_is_paired_with():
    xy_px = np.random.default_rng(3).uniform(0.0, 100.0, (60, 2))
    pairs, apart = linked_pairs(xy_px, 40.0), np.linalg.norm(xy_px[:, None] - xy_px, axis=2)
    third = np.minimum(np.sort(apart, axis=1)[:, 3], 40.0)
    expected = [pair for pair in pairs.tolist() if apart[tuple(pair)] <= 2.0 * third[pair].max()]
    assert without_gaps(pairs, xy_px, 40.0).tolist() == expected
    assert 0 < len(expected) < len(pairs)
    assert without_gaps(np.empty((0, 2), dtype=np.int64), xy_px, 40.0).shape == (0, 2)
