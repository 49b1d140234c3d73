"""Pictures against projection by hand: places, occlusion, labels, determinism."""

import numpy as np
import pytest

from ttcvid.simulate import SKY_LABEL, Renderer, Scene, build_world, render_frames
from ttcvid.simulate.object_truth import nearest_surface_m
from ttcvid.simulate.ripmap import Ripmap

BOX = {"name": "box", "kind": "box", "at_m": [11, 0, 0], "size_m": [2, 2, 2.4], "velocity_m_s": [-3, 0, 0]}


def scene_of(bodies, **parts) -> Scene:
    camera = {"image_size": [320, 180], "fx_px": 250, "height_m": 1.2, "fps": 10, "n_frames": 3}
    camera.update(parts.pop("camera", {}))
    return Scene.model_validate(
        {"name": "test", "camera": camera, "ground": {"kind": "none"}, "bodies": bodies, **parts}
    )


def test_front_of_a_box_is_seen_where_projection_says():
    rendered = next(iter(render_frames(scene_of([BOX]))))
    (truth,) = rendered.objects
    # Its face is 10 m away, 2 m wide, from 1.2 m above to 1.2 m below the camera.
    expected = (159.5 - 25, 89.5 - 30, 159.5 + 25, 89.5 + 30)
    np.testing.assert_allclose(truth.box_px, expected, atol=0.26)
    assert truth.visible_px == pytest.approx(50 * 60, rel=0.02)
    assert truth.visible_fraction == 1
    np.testing.assert_allclose(truth.position_m, [0, 0, 10], atol=0.02)
    np.testing.assert_allclose(truth.velocity_m_s, [0, 0, -3], atol=1e-12)
    assert truth.times.ttc_z_s[0] == pytest.approx(10 / 3, rel=1e-3)


def test_labels_agree_with_the_box_the_sky_and_the_ground():
    rendered = next(iter(render_frames(scene_of([BOX], ground={"kind": "square"}))))
    assert rendered.labels.shape == (180, 320)
    assert set(np.unique(rendered.labels)) == {0, 1, SKY_LABEL}
    assert (rendered.labels[60:119, 136:184] == 1).all()
    assert (rendered.labels[:89, :130] == SKY_LABEL).all()
    assert (rendered.labels[91:, :130] == 0).all()


def test_nearer_body_hides_the_farther_one_whatever_their_order():
    post = {"name": "post", "kind": "wall", "at_m": [6, 1, 0], "size_m": [0.2, 2, 3]}
    for bodies in ([BOX, post], [post, BOX]):
        (truth,) = next(iter(render_frames(scene_of(bodies)))).objects
        assert truth.visible_fraction == pytest.approx(0.5, abs=0.02)
        assert truth.box_px[0] == pytest.approx(159.5, abs=0.26)


def test_part_behind_the_camera_is_cut_off_without_holes():
    wall = {"name": "wall", "kind": "wall", "at_m": [5, 2, 0], "size_m": [40, 0.3, 30], "is_object": True}
    rendered = next(iter(render_frames(scene_of([wall]))))
    assert (rendered.labels[:90, :100] == 1).all()


def test_object_outside_the_picture_has_no_row():
    behind = {**BOX, "at_m": [-10, 0, 0]}
    assert next(iter(render_frames(scene_of([behind])))).objects == ()


def test_static_body_is_an_object_only_where_the_scene_says_so():
    still = {"name": "still", "kind": "box", "at_m": [11, 0, 0]}
    assert next(iter(render_frames(scene_of([still])))).objects == ()
    (truth,) = next(iter(render_frames(scene_of([{**still, "is_object": True}])))).objects
    assert (truth.object_id, truth.is_moving) == (1, False)


def test_same_seed_gives_the_same_pictures_and_another_seed_the_same_truth():
    first, again, other = (list(render_frames(scene_of([BOX], seed=seed))) for seed in (3, 3, 4))
    for a, b, c in zip(first, again, other, strict=True):
        np.testing.assert_array_equal(a.bgr, b.bgr)
        assert (a.bgr != c.bgr).any(axis=2)[a.labels == 1].mean() > 0.9
        np.testing.assert_array_equal(a.labels, c.labels)
        np.testing.assert_array_equal(a.objects[0].position_m, c.objects[0].position_m)


def test_picture_does_not_depend_on_what_was_rendered_before():
    scene = scene_of([BOX])
    in_order = list(render_frames(scene))[2]
    alone = Renderer(build_world(scene)).render(2)
    np.testing.assert_array_equal(in_order.bgr, alone.bgr)


def test_noise_has_the_standard_deviation_that_the_scene_gives():
    quiet, noisy = (
        next(iter(render_frames(scene_of([BOX], picture={"noise_grey": sigma})))).bgr.astype(float)
        for sigma in (0.0, 4.0)
    )
    difference = (noisy - quiet)[:, :, 1]
    assert difference.std() == pytest.approx(4.0, rel=0.03)
    assert abs(difference.mean()) < 0.1


def test_distorted_camera_shows_the_box_where_the_distorted_projection_lies():
    distortion = {"distortion_model": "plumb_bob", "distortion": [-0.2, 0.0, 0.0, 0.0, 0.0]}
    body = {**BOX, "at_m": [11, -4, 0]}
    (truth,) = next(iter(render_frames(scene_of([body], camera=distortion)))).objects
    corners = np.array([[0.3, -0.12], [0.5, -0.12], [0.3, 0.12], [0.5, 0.12], [0.3, 0.0], [0.5, 0.0]])
    distorted = corners * (1 - 0.2 * (corners**2).sum(axis=1, keepdims=True))
    assert truth.box_px[2] == pytest.approx(159.5 + 250 * distorted[5, 0], abs=0.3)
    assert truth.box_px[1] == pytest.approx(89.5 + 250 * distorted[0, 1], abs=0.3)


def test_far_ground_does_not_shimmer():
    scene = scene_of([], ground={"kind": "square"}, own_motion={"speed_m_s": 10}, picture={"noise_grey": 0})
    pictures = [rendered.bgr.astype(float) for rendered in render_frames(scene)]
    # 2 px below the horizon the ground is 150 m away: 1 m of motion is less than a pixel there.
    change = np.abs(pictures[1][92:95] - pictures[0][92:95]).mean()
    assert change < 3.0


def test_nearest_surface_of_a_parallel_plane_is_its_centre_not_its_extreme():
    x, y = (grid.ravel() for grid in np.meshgrid(np.linspace(-0.1, 0.3, 21), np.linspace(0, 0.2, 11)))
    np.testing.assert_allclose(nearest_surface_m(x, y, np.full(x.shape, 0.1)), [1.0, 1.0, 10.0], atol=1e-9)


def test_nearest_surface_is_the_bumper_and_not_the_roof_behind_it():
    x = np.zeros(1000)
    depth = np.where(np.arange(1000) < 300, 8.0, 10.0)
    assert nearest_surface_m(x, x, 1 / depth)[2] == pytest.approx(8.0)


def test_ripmap_keeps_the_mean_of_its_picture_at_every_footprint():
    rng = np.random.default_rng(1)
    picture = rng.integers(0, 256, (64, 96, 3)).astype(np.uint8)
    ripmap = Ripmap(picture, (96.0, 64.0), wraps=True)
    for step_u, step_v in ((1, 1), (8, 1), (1, 8), (32, 16), (500, 300)):
        v, u = np.meshgrid(np.arange(64) * step_v, np.arange(96) * step_u, indexing="ij")
        bgr, _ = ripmap.sample(u.astype(np.float32), v.astype(np.float32))
        assert bgr.mean() == pytest.approx(picture.mean(), abs=6)


def test_ripmap_returns_its_texels_where_they_are():
    picture = np.random.default_rng(2).integers(0, 256, (8, 12, 3)).astype(np.uint8)
    ripmap = Ripmap(picture, (6.0, 4.0), wraps=False)
    v, u = np.meshgrid((np.arange(8) + 0.5) / 2, (np.arange(12) + 0.5) / 2, indexing="ij")
    # One texel per sample lies on the edge between two reductions: look a little closer.
    bgr, _ = ripmap.sample(u[:, :1].astype(np.float32) + np.zeros((8, 2), np.float32), v[:, :2].astype(np.float32))
    np.testing.assert_allclose(bgr[:, 0].astype(int), picture[:, 0].astype(int), atol=1)
