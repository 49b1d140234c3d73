"""Before a camera that is known to rest, what moves is none of the scene, and nothing but movers moves."""

from dataclasses import dataclass

import numpy as np
import pytest
from rigid_worlds import Thing, bodies_of, car, static_points

from ttcvid.model import SCENE_CLUSTER, Platform

AT_REST = (0.0, 0.0, 0.0)
WAY_M_S = np.array([2.0, 0.0, -1.0])


@dataclass(frozen=True)
class Swinging(Thing):
    """Swings along its way by so many m, once a second: somebody's leg."""

    swing_m: float = 0.0

    def at(self, t_s):
        return super().at(t_s) + self.swing_m * np.sin(2 * np.pi * t_s) * np.array([1.0, 0.0, 0.0])


@dataclass(frozen=True)
class Stopping(Thing):
    """Goes on until a time and stands from then on."""

    until_s: float = np.inf

    def at(self, t_s):
        return super().at(min(t_s, self.until_s))


def seen(n_frames, *movers, seed=0):
    """The frames of a camera on a mast over a street with these movers; things are numbered from 1."""
    rng = np.random.default_rng(seed)
    street = static_points(rng, AT_REST, n_frames, movers)
    return bodies_of([street, *movers], n_frames, AT_REST, platform=Platform.static, seed=seed)


def few(rng, n, centre_m):
    return np.asarray(centre_m) + rng.uniform(-0.4, 0.4, (n, 3))


@pytest.mark.parametrize("seed", range(3))
def test_three_tracks_that_move_alike_are_a_mover(seed):
    rng = np.random.default_rng(seed)
    frames = seen(14, Thing(few(rng, 3, (-2.0, 0.5, 15.0)), tuple(WAY_M_S)), seed=seed)
    key, share = frames[-1].keys_of(1)
    assert key != SCENE_CLUSTER
    assert share == 1.0
    assert frames[-1].mover_keys == {key}


def test_before_a_mast_that_rests_nothing_counts_as_fixed_to_the_camera():
    frames = seen(10, Thing(few(np.random.default_rng(0), 6, (-2.0, 0.5, 15.0)), tuple(WAY_M_S)))
    assert all(np.isneginf(frame.found.seen.ride_odds).all() for frame in frames)


@pytest.mark.parametrize("seed", [1, 2])
def test_dirt_on_the_lens_of_a_mast_that_shakes_is_no_mover(seed):
    rng = np.random.default_rng(seed)
    places = [(0.25, 0.12), (-0.3, 0.1), (0.02, 0.08), (-0.1, -0.15)]
    dirt = [Thing(2.0 * np.column_stack([rng.normal(xy, 0.02, (12, 2)), np.ones(12)]), rides=True) for xy in places]
    walker = Thing(few(rng, 12, (-2.0, 0.5, 15.0)), tuple(WAY_M_S))
    things = [static_points(rng, AT_REST, 30, [walker]), walker, *dirt]
    frames = bodies_of(things, 30, AT_REST, platform=Platform.static, seed=seed, shake_rad=0.002)
    # By three views nobody can tell.
    assert all(not (set(frame.key[frame.truth > 1].tolist()) - {SCENE_CLUSTER}) for frame in frames[2:])
    assert frames[-1].keys_of(1)[0] != SCENE_CLUSTER


def test_three_tracks_beside_a_mover_are_none_for_themselves():
    """Where its roof crosses lines of what stands behind it, corners run along, at a pace of their own."""
    rng = np.random.default_rng(0)
    whole = car(rng, (-2.0, 0.5, 15.0), tuple(WAY_M_S))
    corners = Thing(few(rng, 3, (-2.0, -0.9, 15.0)), (0.9, -0.3, 0.0))
    for frame in seen(16, whole, corners)[6:]:
        assert len(frame.mover_keys) == 1
        assert frame.keys_of(1)[0] in frame.mover_keys


def test_what_swings_about_the_way_of_a_mover_is_a_part_of_it():
    rng = np.random.default_rng(1)
    body = Thing(few(rng, 14, (-2.0, 0.0, 15.0)), (1.5, 0.0, 0.0))
    leg = Swinging(few(rng, 4, (-2.0, 0.9, 15.0)), (1.5, 0.0, 0.0), swing_m=0.3)
    late = seen(24, body, leg)[8:]
    with_body = [np.mean(frame.key[frame.truth == 2] == frame.keys_of(1)[0]) for frame in late]
    assert np.mean(with_body) > 0.8
    assert not any((frame.key[frame.truth == 1] == SCENE_CLUSTER).any() for frame in late)


def test_what_has_stopped_is_a_part_of_the_scene_at_once():
    """Long before its old motion has left the views."""
    rng = np.random.default_rng(2)
    stopping = Stopping(few(rng, 12, (-2.0, 0.5, 15.0)), tuple(WAY_M_S), until_s=1.0)
    frames = seen(20, stopping)
    assert frames[8].keys_of(1)[0] != SCENE_CLUSTER
    for frame in frames[15:]:
        key, share = frame.keys_of(1)
        assert key == SCENE_CLUSTER
        assert share > 0.9
