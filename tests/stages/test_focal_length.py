"""The focal length found from exact and noisy views of scenes whose camera is known; where it cannot be told, none."""

from dataclasses import replace

import numpy as np
import pytest
from turning_camera import CURVE, PAN, PAN_AND_STEP, REST, SIZE, STRAIGHT, seen_points

from ttcvid.model import PointSet
from ttcvid.stages.egomotion.focal_length import find_focal_length

TURNING = pytest.mark.parametrize(
    ("drive", "n_frames"), [(PAN, 18), (PAN_AND_STEP, 18), (CURVE, 24)], ids=["pan", "pan and step", "curve"]
)


@TURNING
@pytest.mark.parametrize("focal_px", [450.0, 1100.0])
def test_exact_tracks_of_a_turning_camera_tell_its_focal_length(drive, n_frames, focal_px):
    found = find_focal_length(seen_points(drive, focal_px, n_frames=n_frames), SIZE)
    assert found is not None
    assert found.focal_px == pytest.approx(focal_px, rel=1e-3)


@pytest.mark.slow
@TURNING
def test_noisy_tracks_tell_it_within_its_sigma(drive, n_frames):
    """Three scenes each: root mean square of the error in sigmas under 1.5, and none beyond three."""
    errors = []
    for seed, focal_px in enumerate((450.0, 700.0, 1100.0)):
        found = find_focal_length(seen_points(drive, focal_px, sigma_px=0.2, n_frames=n_frames, seed=seed), SIZE)
        assert found is not None
        assert found.sigma < 0.05
        errors.append(np.log(found.focal_px / focal_px) / found.sigma)
    assert np.sqrt(np.mean(np.square(errors))) < 1.5
    assert np.max(np.abs(errors)) < 3.0


@pytest.mark.parametrize("drive", [STRAIGHT, REST], ids=["straight", "rest"])
@pytest.mark.parametrize("movers", [0.0, 0.3])
def test_a_camera_that_does_not_turn_tells_nothing(drive, movers):
    assert find_focal_length(seen_points(drive, 600.0, sigma_px=0.2, movers=movers), SIZE) is None


def test_a_few_points_are_not_enough():
    few = [
        replace(seen, points=PointSet(seen.points.track_id[::20], seen.points.xy_px[::20]))
        for seen in seen_points(PAN, 600.0, n_frames=40, n_points=6000)
    ]
    assert find_focal_length(few, SIZE) is None


def test_no_frames_tell_nothing():
    assert find_focal_length([], SIZE) is None


def test_cuts_part_the_clip():
    """Two shots of two places, one after the other: each is understood by itself."""
    first, second = (seen_points(PAN_AND_STEP, 600.0, n_frames=16, n_points=2000, seed=seed) for seed in (1, 2))
    second[0] = replace(second[0], is_new=True)
    found = find_focal_length([*first, *second], SIZE)
    assert found is not None
    assert found.focal_px == pytest.approx(600.0, rel=2e-3)


def test_burned_in_points_are_left_out():
    """A tenth of the points stays on its pixels all the time."""
    seen = seen_points(PAN_AND_STEP, 600.0)
    rng = np.random.default_rng(0)
    xy_px = rng.uniform((0.0, 0.0), (799.0, 449.0), (60, 2))
    with_text = [
        replace(
            one,
            points=PointSet(
                np.append(one.points.track_id, 10**6 + np.arange(60)), np.vstack([one.points.xy_px, xy_px])
            ),
        )
        for one in seen
    ]
    found = find_focal_length(with_text, SIZE)
    assert found is not None
    assert found.focal_px == pytest.approx(600.0, rel=1e-3)


def test_pictures_without_any_track_tell_nothing():
    nothing = PointSet(np.empty(0, np.int64), np.empty((0, 2)))
    seen = [replace(one, points=nothing) for one in seen_points(PAN, 600.0, n_frames=12)]
    assert find_focal_length(seen, SIZE) is None
