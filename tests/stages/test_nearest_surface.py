"""What is hit first: the nearest surface with enough tracks, and not the most extreme of its noisy rates."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ttcvid.stages.objects.nearest_surface import in_nearest_surface, tracks_needed
from ttcvid.stages.tracking.groups import TrackSets

LINK_PX = 30.0


def nearest_surface(rate_hz, sigma_hz, xy_px, link_px, n_tracks=None):
    """Tracks of the nearest surface of one object, of `n_tracks` with those that have no rate."""
    tracks = TrackSets.of([np.arange(len(rate_hz))])
    n_tracks = np.array([len(rate_hz) if n_tracks is None else n_tracks])
    return np.flatnonzero(in_nearest_surface(rate_hz, sigma_hz, xy_px, tracks, tracks_needed(n_tracks), link_px))


def places(rng, n, corner=(0.0, 0.0), size_px=40.0):
    return np.asarray(corner) + rng.uniform(0, size_px, (n, 2))


def rate(eta_hz, sigma_hz, surface):
    return np.average(eta_hz[surface], weights=1.0 / sigma_hz[surface] ** 2)


@pytest.mark.parametrize("n", [10, 20, 50, 100, 200])
def test_the_rate_of_a_fronto_parallel_plane_is_not_biased_towards_its_extreme(n):
    rng = np.random.default_rng([51, n])
    sigma_hz, errors = np.full(n, 0.05), []
    for _ in range(150):
        eta_hz = 0.5 + sigma_hz * rng.normal(size=n)
        surface = nearest_surface(eta_hz, sigma_hz, places(rng, n), LINK_PX)
        assert len(surface) >= 5
        errors.append(rate(eta_hz, sigma_hz, surface) - 0.5)
    spread = np.std(errors) / np.sqrt(len(errors))
    assert abs(np.mean(errors)) < 0.2 * 0.05 + 2.0 * spread


@pytest.mark.parametrize("n", [10, 50, 200])
def test_nor_where_tracks_are_of_different_quality(n):
    rng = np.random.default_rng([52, n])
    errors, sigmas = [], []
    for _ in range(150):
        sigma_hz = 0.02 * np.exp(rng.uniform(-1.0, 1.0, n))
        eta_hz = 0.5 + sigma_hz * rng.normal(size=n)
        surface = nearest_surface(eta_hz, sigma_hz, places(rng, n), LINK_PX)
        assert len(surface) >= 5
        errors.append(rate(eta_hz, sigma_hz, surface) - 0.5)
        sigmas.append(np.median(sigma_hz))
    assert abs(np.mean(errors)) < 0.2 * np.mean(sigmas) + 2.0 * np.std(errors) / np.sqrt(len(errors))


def car(rng, n_face=25, n_roof=40, sigma_hz=0.004):
    """Rates of a car whose rear face is hit in 2 s and whose roof and windows are 15 % deeper; true part of each."""
    is_face = np.repeat([True, False], [n_face, n_roof])
    sigma = np.full(len(is_face), sigma_hz)
    eta_hz = np.where(is_face, 0.5, 0.5 / 1.15) + sigma * rng.normal(size=len(is_face))
    xy_px = np.concatenate([places(rng, n_face), places(rng, n_roof, corner=(0.0, -50.0))])
    return eta_hz, sigma, xy_px, is_face


def test_a_cars_rear_face_gives_its_time_and_not_the_deeper_roof():
    rng = np.random.default_rng(53)
    for _ in range(50):
        eta_hz, sigma_hz, xy_px, is_face = car(rng)
        surface = nearest_surface(eta_hz, sigma_hz, xy_px, LINK_PX)
        assert is_face[surface].mean() > 0.95
        assert rate(eta_hz, sigma_hz, surface) == pytest.approx(0.5, rel=0.01)


def test_a_few_wild_tracks_in_front_are_no_surface():
    rng = np.random.default_rng(54)
    eta_hz, sigma_hz, xy_px, _ = car(rng)
    eta_hz[[3, 30, 50]] = [2.0, 1.4, 1.39]
    surface = nearest_surface(eta_hz, sigma_hz, xy_px, LINK_PX)
    assert rate(eta_hz, sigma_hz, surface) == pytest.approx(0.5, rel=0.01)


def test_tracks_of_one_rate_scattered_over_the_picture_are_no_surface():
    rng = np.random.default_rng(55)
    eta_hz, sigma_hz, xy_px, is_face = car(rng, n_face=8, n_roof=40)
    xy_px[is_face] = 200.0 * np.arange(8)[:, None] + [0.0, 300.0]
    surface = nearest_surface(eta_hz, sigma_hz, xy_px, LINK_PX)
    assert not is_face[surface].any()


@pytest.mark.parametrize(
    ("n_near", "n_far", "is_found"), [(5, 30, True), (4, 30, False), (9, 91, False), (10, 90, True)]
)
def test_a_surface_is_borne_by_five_tracks_and_a_tenth_of_them(n_near, n_far, is_found):
    eta_hz = np.repeat([0.6, 0.4], [n_near, n_far])
    xy_px = places(np.random.default_rng(56), n_near + n_far, size_px=20.0)
    surface = nearest_surface(eta_hz, np.full(len(eta_hz), 0.01), xy_px, LINK_PX)
    assert eta_hz[surface].max() == (0.6 if is_found else 0.4)


@pytest.mark.parametrize(
    ("n_usable", "n_tracks", "is_found"),
    [
        (1, 40, False),
        (4, 40, False),
        (5, 40, True),
        (5, 60, False),
        (6, 60, True),
        (4, 5, False),
        (4, 4, True),
        (3, 4, False),
    ],
)
def test_what_bears_a_surface_is_counted_among_all_tracks_of_the_object(n_usable, n_tracks, is_found):
    """Most tracks of a thing may have no state (too short, no parallax): the rest is not all of it."""
    xy_px = places(np.random.default_rng(60), n_usable, size_px=20.0)
    surface = nearest_surface(np.full(n_usable, 0.5), np.full(n_usable, 0.01), xy_px, LINK_PX, n_tracks)
    assert len(surface) == (n_usable if is_found else 0)


@pytest.mark.parametrize("n_tracks", [1, 2, 3])
def test_few_tracks_are_no_surface_though_they_agree(n_tracks):
    """What is left of a mover behind a post: the rates of three of its tracks agree by chance."""
    surface = nearest_surface(np.full(n_tracks, 0.5), np.full(n_tracks, 0.01), np.zeros((n_tracks, 2)), LINK_PX)
    assert not len(surface)


@pytest.mark.parametrize(("last_hz", "is_found"), [(0.505, True), (0.6, False)])
def test_of_four_tracks_all_have_to_agree(last_hz, is_found):
    """An aircraft far off has no more."""
    rate_hz, xy_px = np.array([0.5, 0.495, 0.5, last_hz]), np.zeros((4, 2))
    assert len(nearest_surface(rate_hz, np.full(4, 0.01), xy_px, LINK_PX)) == (4 if is_found else 0)


@given(seed=st.integers(0, 2**32 - 1))
def test_order_of_tracks_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    eta_hz, sigma_hz, xy_px, _ = car(rng, n_face=int(rng.integers(3, 20)), n_roof=int(rng.integers(0, 20)))
    order = rng.permutation(len(eta_hz))
    expected = set(nearest_surface(eta_hz, sigma_hz, xy_px, LINK_PX).tolist())
    shuffled = nearest_surface(eta_hz[order], sigma_hz[order], xy_px[order], LINK_PX)
    assert set(order[shuffled].tolist()) == expected


def test_a_receding_object_has_a_surface_too():
    rng = np.random.default_rng(57)
    eta_hz = -0.3 + 0.01 * rng.normal(size=30)
    surface = nearest_surface(eta_hz, np.full(30, 0.01), places(rng, 30), LINK_PX)
    assert eta_hz[surface].mean() == pytest.approx(-0.3, abs=0.01)


def test_without_tracks_or_with_rates_that_all_differ_there_is_none():
    nothing = np.empty(0)
    assert not len(nearest_surface(nothing, nothing, np.empty((0, 2)), LINK_PX))
    rng = np.random.default_rng(58)
    assert not len(nearest_surface(np.linspace(0, 1, 12), np.full(12, 1e-3), places(rng, 12), LINK_PX))


def test_five_tracks_bear_a_surface_when_there_are_no_more():
    eta_hz = np.array([0.50, 0.51, 0.49, 0.50, 0.50])
    xy_px = np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 10.0], [10.0, 10.0], [5.0, 5.0]])
    assert sorted(nearest_surface(eta_hz, np.full(5, 0.01), xy_px, LINK_PX)) == [0, 1, 2, 3, 4]


def test_of_a_surface_in_two_places_the_larger_part_counts():
    chains = np.arange(6), np.arange(9)
    xy_px = np.concatenate([np.column_stack([29.0 * chain, 100.0 * len(chain) + 0.0 * chain]) for chain in chains])
    surface = nearest_surface(np.full(15, 0.5), np.full(15, 0.01), xy_px, LINK_PX)
    np.testing.assert_array_equal(surface, np.arange(6, 15))


def test_each_of_several_objects_has_the_surface_that_it_has_alone():
    rng = np.random.default_rng(59)
    cars = [car(rng, n_face=int(n)) for n in (5, 8, 25)]
    rate_hz, sigma_hz, xy_px, _ = (np.concatenate(values) for values in zip(*cars, strict=True))
    lengths = [len(one[0]) for one in cars]
    sets = TrackSets.of(np.split(np.arange(sum(lengths)), np.cumsum(lengths)[:-1]))
    together = np.split(
        in_nearest_surface(rate_hz, sigma_hz, xy_px, sets, tracks_needed(sets.lengths), LINK_PX),
        np.cumsum(lengths)[:-1],
    )
    for is_in, one in zip(together, cars, strict=True):
        np.testing.assert_array_equal(np.flatnonzero(is_in), nearest_surface(*one[:3], LINK_PX))
