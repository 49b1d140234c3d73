"""What carries the camera, told from looks at exact points: rest, a drive over its ground, and all else."""

from dataclasses import replace

import numpy as np
import pytest

from ttcvid.geometry.rotation import rotation_from_vector
from ttcvid.model import Camera, ImageSize, Platform, PointSet
from ttcvid.stages.egomotion.platform import Glance, Verdict, glance_at, told_platform

SIZE = ImageSize(640, 360)
CAMERA = Camera(500.0, 500.0, 319.5, 179.5, SIZE)
TIMES_S = np.arange(7) / 30.0
HEIGHT_M = 1.5
NOTHING = Glance(0.0, 0.0, 0.0, None, 0.0, 0.0, None)
RESTS = replace(NOTHING, still_share=0.9)
DRIVES = replace(NOTHING, travel=np.array([0.0, 0.0, 1.0]), explained_share=0.9, best_share=0.9, ground_hz=8.0)
MOVES = replace(DRIVES, travel=np.array([1.0, 0.0, 0.0]))
TURNS = replace(NOTHING, still_share=0.9, turned_rad=0.1)


def street(rng: np.random.Generator) -> np.ndarray:
    """Points (N, 3) of a road and of what stands beside it, in m: x right, y down, z ahead."""
    road = np.column_stack([rng.uniform(-6, 6, 300), np.full(300, HEIGHT_M), rng.uniform(5, 40, 300)])
    beside = np.column_stack([rng.choice([-1, 1], 300) * rng.uniform(5, 15, 300), rng.uniform(-5, 1.5, 300)])
    return np.vstack([road, np.column_stack([beside, rng.uniform(8, 60, 300)])])


def seen(
    points: np.ndarray, places_m: np.ndarray, turned_rad: np.ndarray, rng: np.random.Generator, sigma_px: float = 0.1
) -> list[PointSet]:
    """The points as seen from places (K, 3) with rotations (K, 3), with noise."""
    found = []
    for place, turn in zip(places_m, turned_rad, strict=True):
        rays = (points - place) @ rotation_from_vector(turn).T
        xy = rays[:, :2] / rays[:, 2:] * 500.0 + (319.5, 179.5) + sigma_px * rng.standard_normal((len(points), 2))
        is_seen = (rays[:, 2] > 1) & (xy > 0).all(axis=1) & (xy < (639, 359)).all(axis=1)
        found.append(PointSet(np.flatnonzero(is_seen), xy[is_seen]))
    return found


def glance(velocity_m_s: tuple[float, float, float], turn_rad_s: tuple[float, float, float] = (0, 0, 0)) -> Glance:
    rng = np.random.default_rng(1)
    places, turns = TIMES_S[:, None] * np.array(velocity_m_s), TIMES_S[:, None] * np.array(turn_rad_s)
    found = glance_at(seen(street(rng), places, turns, rng), list(TIMES_S), CAMERA)
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("velocity_m_s", "turn_rad_s", "verdict"),
    [
        ((0, 0, 0), (0, 0, 0), Verdict.rests),
        ((0, 0, 12), (0, 0, 0), Verdict.drives),
        ((0.5, 0, 12), (0, 0.3, 0), Verdict.drives),
        ((0, 0, -6), (0, 0, 0), Verdict.drives),
        ((6, 0, 0), (0, 0, 0), Verdict.moves),
        ((4, -2, 3), (0, 0, 0), Verdict.moves),
        ((0, 0, 0), (0, 0.3, 0), Verdict.turns),
    ],
)
def test_a_look_tells_rest_a_drive_along_the_axis_and_other_motion(velocity_m_s, turn_rad_s, verdict):
    assert glance(velocity_m_s, turn_rad_s).verdict == verdict


def test_the_ground_goes_by_with_speed_over_height():
    assert glance((0, 0, 12)).ground_hz == pytest.approx(12 / HEIGHT_M, rel=0.1)
    assert glance((0, 0, 3)).ground_hz == pytest.approx(3 / HEIGHT_M, rel=0.1)


def test_a_bonnet_that_fills_half_of_the_picture_does_not_rest():
    rng = np.random.default_rng(2)
    drive = seen(street(rng), TIMES_S[:, None] * np.array([0, 0, 12.0]), np.zeros((7, 3)), rng)
    stuck = PointSet(np.arange(1000, 1400), rng.uniform((0, 180), (640, 360), (400, 2)))
    both = [PointSet(np.append(p.track_id, stuck.track_id), np.vstack([p.xy_px, stuck.xy_px])) for p in drive]
    found = glance_at(both, list(TIMES_S), CAMERA)
    assert found is not None
    assert found.verdict == Verdict.drives


def test_few_points_tell_nothing():
    rng = np.random.default_rng(3)
    assert glance_at(seen(street(rng)[::30], np.zeros((7, 3)), np.zeros((7, 3)), rng), list(TIMES_S), CAMERA) is None


@pytest.mark.parametrize(
    ("glances", "between", "platform"),
    [
        ([RESTS] * 9, [0.9] * 8, Platform.static),
        ([RESTS] * 8 + [MOVES], [0.9] * 8, Platform.static),
        ([RESTS] * 9, [0.9] * 7 + [0.1], Platform.free),  # it is panned between two looks
        ([RESTS] * 9, [], Platform.free),  # nothing tells that it looks at the same place
        ([RESTS] * 6 + [DRIVES] * 3, [0.9] * 5, Platform.vehicle),  # a drive that begins at a red light
        ([DRIVES] * 9, [], Platform.vehicle),
        ([DRIVES] * 6 + [MOVES] * 3, [], Platform.vehicle),
        ([DRIVES] * 4 + [MOVES] * 5, [], Platform.free),
        ([replace(DRIVES, ground_hz=None)] * 4, [], Platform.vehicle),
        ([replace(DRIVES, ground_hz=None)] * 2, [], Platform.vehicle),  # no ground is seen
        ([DRIVES] * 4 + [TURNS] * 5, [], Platform.vehicle),  # what shows no travel contradicts nothing
        ([TURNS] * 9, [], Platform.free),
        ([MOVES] * 4 + [RESTS] * 5, [0.9] * 8, Platform.static),  # traffic hides that it rests, in some looks
        ([replace(DRIVES, ground_hz=0.3)] * 9, [], Platform.free),  # an aircraft
        ([replace(DRIVES, ground_hz=1.0)] * 9, [], Platform.vehicle),  # a car that creeps
        ([MOVES] * 9, [], Platform.free),
        ([MOVES] * 9, [0.9] * 8, Platform.free),  # a picture alone that stays is no rest
        ([DRIVES] * 4 + [RESTS] * 5, [0.9] * 8, Platform.vehicle),
        ([DRIVES] * 4 + [MOVES] * 4, [], Platform.free),  # a tie
        ([DRIVES], [], Platform.free),
        ([], [], Platform.free),
    ],
)
def test_the_looks_together_tell_the_platform_and_nothing_against_the_evidence(glances, between, platform):
    told = told_platform(glances, between)
    assert told.platform == platform
    assert told.reason
    assert told.glances == tuple(glances)


def test_who_walks_ahead_wavers():
    ways = [np.array([0.15 * s, 0.1 * c, 1.0]) for s, c in zip((1, -1, 0, 1, -1), (0, 1, -1, 1, -1), strict=True)]
    walk = [replace(DRIVES, travel=way / np.linalg.norm(way), ground_hz=1.0) for way in ways]
    assert told_platform(walk, []).platform == Platform.free
    assert told_platform([replace(one, ground_hz=8.0) for one in walk], []).platform == Platform.vehicle


def test_noise_of_the_points_is_neither_rest_nor_travel():
    rng = np.random.default_rng(4)
    rests = glance_at(seen(street(rng), np.zeros((7, 3)), np.zeros((7, 3)), rng, sigma_px=1.0), list(TIMES_S), CAMERA)
    assert rests is not None
    assert rests.sigma_px == pytest.approx(1.0, rel=0.15)
    assert rests.verdict == Verdict.rests


def test_tracks_that_are_shorter_than_a_look_tell_what_they_show():
    rng = np.random.default_rng(5)
    drive = seen(street(rng), TIMES_S[:, None] * np.array([0, 0, 12.0]), np.zeros((7, 3)), rng)
    short = [PointSet(p.track_id + 10_000 * (i // 4), p.xy_px) for i, p in enumerate(drive)]
    found = glance_at(short, list(TIMES_S), CAMERA)
    assert found is not None
    assert found.verdict == Verdict.drives
    assert found.t_s == TIMES_S[3]


def test_tracks_that_are_seen_in_every_second_frame_tell_nothing():
    rng = np.random.default_rng(6)
    drive = seen(street(rng), TIMES_S[:, None] * np.array([0, 0, 12.0]), np.zeros((7, 3)), rng)
    alternating = [PointSet(p.track_id + 10_000 * (i % 2), p.xy_px) for i, p in enumerate(drive)]
    assert glance_at(alternating, list(TIMES_S), CAMERA) is None
