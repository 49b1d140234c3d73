"""Point tracks with truth: noise, outliers, births and deaths as asked for."""

import numpy as np
import pytest

from ttcvid.simulate import Scene, TrackOptions, simulate_tracks

CAR = {"name": "car", "kind": "car", "at_m": [25, 4, 0], "heading_deg": 180, "speed_m_s": 8}
WALL = {"name": "wall", "kind": "wall", "at_m": [14, 0, 0], "size_m": [0.3, 3, 2]}


@pytest.fixture(scope="module")
def scene():
    camera = {"image_size": [640, 360], "hfov_deg": 60, "fps": 20, "n_frames": 30}
    return Scene.model_validate({"name": "t", "camera": camera, "own_motion": {"speed_m_s": 5}, "bodies": [CAR, WALL]})


def test_noise_has_the_asked_standard_deviation_and_outliers_the_asked_fraction(scene):
    tracks = simulate_tracks(scene, TrackOptions(sigma_px=0.3, outlier_fraction=0.1))
    error = (tracks.xy_px - tracks.true_xy_px)[~tracks.is_outlier]
    assert error.std() == pytest.approx(0.3, rel=0.03)
    assert tracks.is_outlier.mean() == pytest.approx(0.1, abs=0.01)


def test_rows_are_sorted_and_a_track_number_is_used_once_per_frame(scene):
    tracks = simulate_tracks(scene)
    key = tracks.frame * 10**6 + tracks.track_id
    assert (np.diff(key) > 0).all()
    for track in np.unique(tracks.track_id)[:50]:
        assert (np.diff(tracks.frame[tracks.track_id == track]) == 1).all()


def test_object_gets_its_share_of_tracks_and_hidden_points_none(scene):
    tracks = simulate_tracks(scene, TrackOptions(min_per_object=20))
    on_car = np.bincount(tracks.frame[tracks.object_id == 1], minlength=30)
    assert on_car[:25].min() >= 15
    # Nothing of the road behind the wall: inside the wall's outline all depths are those of the wall or nearer.
    x, y = (tracks.position_m[:, k] / tracks.position_m[:, 2] for k in (0, 1))
    distance = 13.85 - 5 * tracks.t_s
    behind = (np.abs(x) < 1.45 / distance) & (y < 1.35 / distance) & (y > -0.55 / distance)
    assert (tracks.position_m[behind, 2] <= distance[behind] + 1e-6).all()


def test_without_births_tracks_only_end(scene):
    tracks = simulate_tracks(scene, TrackOptions(births=False, death_rate=0.05))
    alive = np.bincount(tracks.frame, minlength=30)
    assert (np.diff(alive) <= 0).all()
    assert tracks.track_id.max() < alive[0]


def test_seed_decides_the_noise(scene):
    first, again, other = (simulate_tracks(scene, seed=seed).xy_px for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert first.shape != other.shape or (first != other).all()


def test_distorted_tracks_lie_where_the_lens_puts_them(scene):
    lens = {"distortion_model": "plumb_bob", "distortion": (-0.2, 0.0, 0.0, 0.0, 0.0)}
    bent = scene.model_copy(update={"camera": scene.camera.model_copy(update=lens)})
    tracks = simulate_tracks(bent, TrackOptions(sigma_px=0))
    ray = tracks.position_m[:, :2] / tracks.position_m[:, 2:]
    focal = 320 / np.tan(np.radians(30))
    expected = ray * (1 - 0.2 * (ray**2).sum(axis=1, keepdims=True)) * focal + (319.5, 179.5)
    np.testing.assert_allclose(tracks.xy_px, expected, atol=1e-6)
