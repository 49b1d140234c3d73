"""Shutter, lens and sensor: what each does to a picture, and that the truth does not change by it."""

from functools import cache

import numpy as np
import pytest

from ttcvid.simulate import Scene, build_world, grounds, render_frames

LENS = {"image_size": [320, 180], "fx_px": 250, "height_m": 1.2, "fps": 10, "n_frames": 3}
# A post before an empty sky: 10 m away, it moves to the right by 500 px/s.
POST = {
    "name": "post", "kind": "post", "at_m": [10.1, 1, 0], "size_m": [0.2, 0.8, 6], "velocity_m_s": [0, -20, 0],
    "heading_deg": 0, "colour_rgb": [20, 20, 20],
}  # fmt: skip
QUIET = {"noise_grey": 0}


@pytest.fixture(autouse=True)
def small_tile(monkeypatch):
    """A coarse pavement: to paint a fine one takes longer than to draw all pictures."""
    monkeypatch.setattr(grounds, "TILE_TEXELS", 512)


NOTHING = {"kind": "none"}


def pictures_of(bodies=(), ground=NOTHING, own_motion=None, n_frames=3, **picture) -> list:
    camera = LENS | {"n_frames": n_frames}
    content = {"name": "test", "camera": camera, "ground": ground, "bodies": list(bodies)}
    content |= {"own_motion": own_motion or {}, "picture": QUIET | picture}
    return list(render_frames(Scene.model_validate(content)))


@cache
def square(**picture) -> np.ndarray:
    """A picture of a paved square."""
    return pictures_of(ground={"kind": "square"}, n_frames=1, **picture)[0].bgr


def edges_px(rendered, row: int) -> np.ndarray:
    """Where the dark post begins and ends in a row."""
    sky = pictures_of()[0].bgr[row].astype(float).mean(axis=1)
    dark = sky - rendered.bgr[row].astype(float).mean(axis=1) > 8
    return np.flatnonzero(dark)[[0, -1]]


def test_what_rests_is_not_blurred_by_the_exposure():
    np.testing.assert_array_equal(square(), square(exposure_s=0.04))


def test_what_moves_is_drawn_out_by_its_path_within_the_exposure_and_its_truth_stays():
    (sharp, exposed) = (pictures_of([POST], exposure_s=seconds)[1] for seconds in (0.0, 0.04))
    low, high = edges_px(sharp, 60)
    blurred_low, blurred_high = edges_px(exposed, 60)
    # 500 px/s for 40 ms, but for the first and last fifth that five pictures do not reach.
    assert blurred_high - blurred_low == pytest.approx(high - low + 16, abs=2)
    assert blurred_high + blurred_low == pytest.approx(high + low, abs=2)
    assert sharp.objects[0].box_px == exposed.objects[0].box_px


def test_rows_are_read_one_after_the_other_about_the_time_of_the_frame():
    sharp, rolling = (pictures_of([POST], readout_s=seconds)[1] for seconds in (0.0, 0.04))
    shift = {row: np.mean(edges_px(rolling, row) - edges_px(sharp, row)) for row in (12, 60, 108)}
    expected = {row: ((row + 0.5) / 180 - 0.5) * 0.04 * 500 for row in shift}
    assert shift == pytest.approx(expected, abs=1.0)
    assert sharp.objects[0].box_px == rolling.objects[0].box_px


def test_rolling_shutter_leaves_a_resting_scene_as_it_is():
    assert (square() != square(readout_s=0.03)).mean() < 1e-3


def test_repeated_frame_shows_the_picture_before_it_at_its_own_time_with_the_truth_of_that_time():
    plain = pictures_of([POST], noise_grey=1.0)
    repeated = pictures_of([POST], noise_grey=1.0, repeated_frames=[1])
    np.testing.assert_array_equal(repeated[1].bgr, plain[0].bgr)
    np.testing.assert_array_equal(repeated[2].bgr, plain[2].bgr)
    assert repeated[1].t_s == plain[1].t_s
    assert repeated[1].objects[0].box_px == plain[1].objects[0].box_px


def test_corners_lose_the_light_that_vignetting_says_and_the_middle_none():
    plain, dark = (pictures_of(vignetting=share)[0].bgr.astype(float) for share in (0.0, 0.4))
    assert dark[0, 0] / plain[0, 0] == pytest.approx(np.full(3, 0.6), abs=0.02)
    assert dark[90, 160] == pytest.approx(plain[90, 160], abs=1)


def test_gain_steps_hold_from_their_times_on():
    plain, stepped = pictures_of(), pictures_of(gain_steps=[[0.1, 0.8], [0.2, 0.5]])
    ratio = [b.bgr.mean() / a.bgr.mean() for a, b in zip(plain, stepped, strict=True)]
    assert ratio == pytest.approx([1.0, 0.8, 0.5], abs=0.01)


def test_contrast_and_texture_scale_the_differences_of_grey():
    ground = (slice(120, 180), slice(None), 1)
    spread = square()[ground].std()
    assert square(contrast=0.5)[ground].std() / spread == pytest.approx(0.5, abs=0.03)
    assert square(texture=0.0)[ground].std() < 0.3 * spread


def test_spots_rest_in_the_picture_while_the_scene_moves():
    scene = {"ground": {"kind": "square"}, "own_motion": {"speed_m_s": 10}}
    clean, spotted = pictures_of(**scene), pictures_of(n_spots=20, **scene)
    covered = [(a.bgr != b.bgr).any(axis=2) for a, b in zip(clean, spotted, strict=True)]
    assert 0.005 < covered[0].mean() < 0.2
    # Where a spot lies over its own colour it does not show.
    assert (covered[0] & covered[2]).sum() > 0.9 * max(covered[0].sum(), covered[2].sum())


def test_sway_and_swing_have_the_standard_deviations_of_the_scene():
    own = {"sway_m": [0.2, 0.1, 0.05], "sway_period_s": 2.0, "swing_deg": [3, 2, 1], "shake_deg": 0.0}
    camera = LENS | {"n_frames": 4000}
    scene = Scene.model_validate({"name": "test", "camera": camera, "own_motion": own})
    path = build_world(scene).path
    np.testing.assert_allclose(path.position_m.std(axis=0), own["sway_m"], rtol=0.02)
    step = 1e-5
    near = build_world(scene, np.array([3.0 - step, 3.0, 3.0 + step])).path
    np.testing.assert_allclose(near.velocity_m_s[1], (near.position_m[2] - near.position_m[0]) / (2 * step), atol=1e-6)
    pan = np.degrees(np.arctan2(-path.cam_R_road[:, 0, 0], -path.cam_R_road[:, 0, 1]))
    assert (np.unwrap(pan, period=180)).std() == pytest.approx(3.0, rel=0.05)


def test_points_of_a_spinning_body_move_as_its_turn_says():
    body = {"name": "drone", "kind": "drone", "at_m": [9, 1, 2], "velocity_m_s": [1, 2, -0.5]}
    body["spin_deg_s"] = [40, -70, 90]
    content = {"name": "test", "camera": LENS, "bodies": [body]}
    step = 1e-5
    world = build_world(Scene.model_validate(content), np.array([0.7 - step, 0.7, 0.7 + step]))
    path = world.actors[0].path
    arm = np.array([0.2, -0.1, 0.05])
    before, now, after = path.position_m + path.road_R_body @ arm
    expected = path.velocity_m_s[1] + np.cross(path.turn_rad_s[1], now - path.position_m[1])
    np.testing.assert_allclose((after - before) / (2 * step), expected, atol=1e-6)
