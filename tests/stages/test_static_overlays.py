"""Burned-in text and the own bonnet are left out while the scene moves; a lead car that begins to brake is not."""

import numpy as np

from ttcvid.model import PointSet
from ttcvid.stages.tracking.static_overlays import FrozenMemory, find_frozen

N_SCENE = 40
TEXT_PX = np.column_stack([np.linspace(20, 60, 6), np.full(6, 12.0)])
LEAD_PX = np.array([[300.0, 150.0], [340.0, 150.0], [300.0, 170.0], [340.0, 170.0], [320.0, 160.0]])


def scene_px(frame, speed_px=2.0):
    start = np.random.default_rng(1).uniform([0, 40], [600, 300], (N_SCENE, 2))
    return start + np.array([speed_px * frame, 0.0])


def watch(n_frames, other_px, moves=True, speed_px=2.0, jitter_px=0.05, step_s=0.1):
    """Is-frozen of the other points (T, M) and of the scene's (T, N), over a clip; and the last memory."""
    rng = np.random.default_rng(2)
    memory, others, scene = FrozenMemory(), [], []
    for frame in range(n_frames):
        xy_px = np.concatenate([scene_px(frame, speed_px), other_px(frame)])
        xy_px = xy_px + jitter_px * rng.normal(size=xy_px.shape)
        points = PointSet(np.arange(len(xy_px)), xy_px)
        is_frozen, memory = find_frozen(memory, points, scene_moves=moves, step_s=step_s)
        scene.append(is_frozen[:N_SCENE])
        others.append(is_frozen[N_SCENE:])
    return np.array(others), np.array(scene), memory


def test_burned_in_text_is_found_while_the_scene_moves():
    text, scene, _ = watch(30, lambda _: TEXT_PX)
    assert not text[:10].any()
    assert text[20:].all()
    assert not scene.any()


def test_what_moves_slowly_is_not_frozen_in_a_fast_clip():
    """Half a pixel in half a second: at 120 frames/s that is 0.3 px in 36 frames."""

    def creeping_px(fps):
        return lambda frame: LEAD_PX + np.array([frame / fps, 0.0])

    for fps in (30.0, 120.0):
        creeping, _, _ = watch(int(fps), creeping_px(fps), step_s=1.0 / fps, jitter_px=0.02, speed_px=60.0 / fps)
        assert not creeping.any()
        text, scene, _ = watch(int(fps), lambda _: TEXT_PX, step_s=1.0 / fps, jitter_px=0.02, speed_px=60.0 / fps)
        assert not text[: int(0.4 * fps)].any()
        assert text[int(0.6 * fps) :].all()
        assert not scene.any()


def test_a_resting_camera_marks_nothing():
    text, scene, _ = watch(60, lambda _: TEXT_PX, moves=False, speed_px=0.0)
    assert not text.any()
    assert not scene.any()


def test_frames_before_the_scene_moved_do_not_count():
    memory = watch(40, lambda _: TEXT_PX, moves=False)[2]
    points = PointSet(np.arange(N_SCENE + 6), np.concatenate([scene_px(40), TEXT_PX]))
    is_frozen, _ = find_frozen(memory, points, scene_moves=True)
    assert not is_frozen.any()


def lead_car_px(frame, brakes_at=30):
    """At constant distance first; then its picture grows by 1, 2, 3 ... % a frame."""
    growth = 1.0 + 0.01 * np.sum(np.arange(max(0, frame - brakes_at) + 1))
    return LEAD_PX.mean(axis=0) + growth * (LEAD_PX - LEAD_PX.mean(axis=0))


def test_a_lead_car_that_begins_to_brake_is_released_at_once():
    """Its outer points are looked at again within two frames of the first centimetre."""
    lead, _, _ = watch(36, lead_car_px)
    assert lead[28].all()
    assert not lead[32, :4].any()
    assert not lead[33:, :4].any()


def test_what_sways_by_a_pixel_is_not_frozen():
    shakes, _, _ = watch(40, lambda frame: TEXT_PX + np.array([0.6 * np.sin(frame / 2), 0.0]))
    assert not shakes.any()


def test_what_creeps_is_not_frozen():
    """A twentieth of a pixel a frame: in no single step more than the noise, and yet it moves."""
    creeps, _, _ = watch(60, lambda frame: TEXT_PX + np.array([0.05 * frame, 0.0]), jitter_px=0.0)
    assert not creeps.any()


def test_a_new_corner_of_a_burned_in_letter_is_frozen_from_the_start():
    _, _, memory = watch(30, lambda _: TEXT_PX)
    new_px = np.array([[40.0, 15.0], [400.0, 200.0]])
    points = PointSet(np.arange(N_SCENE + 8), np.concatenate([scene_px(30), TEXT_PX, new_px]))
    is_frozen, memory = find_frozen(memory, points, scene_moves=True)
    assert is_frozen[-2:].tolist() == [True, False]
    moved = PointSet(points.track_id, np.concatenate([scene_px(31), TEXT_PX, new_px + 1.0]))
    is_frozen, _ = find_frozen(memory, moved, scene_moves=True)
    assert is_frozen[-2:].tolist() == [False, False]
    assert is_frozen[N_SCENE:-2].all()


def test_numbers_that_come_and_go_keep_their_own_memory():
    _, _, memory = watch(30, lambda _: TEXT_PX)
    half = np.arange(N_SCENE, N_SCENE + 6)[::2]
    is_frozen, memory = find_frozen(memory, PointSet(half, TEXT_PX[::2]), scene_moves=True)
    assert is_frozen.all()
    is_frozen, _ = find_frozen(memory, PointSet(np.empty(0, np.int64), np.empty((0, 2))), scene_moves=True)
    assert is_frozen.shape == (0,)
