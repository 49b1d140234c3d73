"""Scene files: what is wrong in them is told in one line that says where."""

import copy
from pathlib import Path

import numpy as np
import pytest
import yaml

from ttcvid.errors import InputError, UsageError
from ttcvid.simulate import Scene, build_world, encounters, load_scene
from ttcvid.simulate.encounters import LOOK_AHEAD_S, STEP_S, encounters_in

SCENES = Path(__file__).resolve().parents[2] / "sample_configs" / "scenes"
CAR = {"name": "car", "kind": "car", "at_m": [15, 0, 0]}


def content(**changes):
    scene = {"name": "test", "camera": {"hfov_deg": 60, "fps": 20, "n_frames": 10}, "bodies": [dict(CAR)]}
    for path, value in changes.items():
        *parts, last = path.split("__")
        target = scene
        for part in parts:
            target = target[int(part)] if part.isdigit() else target[part]
        target[last] = value
    return scene


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"bodies__0__sped_m_s": 3}, ["bodies[0].sped_m_s", "unknown key", "did you mean 'speed_m_s'"]),
        ({"camera__hight_m": 3}, ["camera.hight_m", "did you mean 'height_m'"]),
        ({"bodies__0__size_m": [4, -1.8, 1.5]}, ["bodies[0].size_m[1]", "-1.8", "greater than 0"]),
        ({"bodies__0__at_m": [4, float("nan"), 0]}, ["bodies[0].at_m[1]", "nan", "finite"]),
        ({"bodies__0__kind": "tank"}, ["bodies[0].kind", "'tank'", "'car'"]),
        ({"camera__fps": "fast"}, ["camera.fps", "'fast'", "number"]),
        ({"camera__fx_px": 500}, ["camera", "either hfov_deg or fx_px"]),
        ({"camera__image_size": [641, 360]}, ["image_size", "even"]),
        ({"bodies__0__velocity_m_s": [1, 0, 0], "bodies__0__speed_m_s": 3}, ["bodies[0]", "either speed_m_s"]),
        ({"camera__distortion_model": "plumb_bob"}, ["distortion", "5 coefficients"]),
        (
            {"camera__distortion_model": "plumb_bob", "camera__distortion": [-0.9, 0, 0, 0, 0]},
            ["camera.distortion", "cannot reach"],
        ),
        ({"bodies": [copy.deepcopy(CAR), copy.deepcopy(CAR)]}, ["'car'", "twice"]),
        ({"bodies__0__at_m": [1.0, 0.2, 0]}, ["camera is inside 'car'", "frame 0"]),
    ],
)
def test_mistake_becomes_one_line_that_names_file_field_and_expectation(tmp_path, changes, words):
    path = tmp_path / "wrong.yaml"
    path.write_text(yaml.safe_dump(content(**changes)))
    with pytest.raises(UsageError) as caught:
        load_scene(path)
    message = str(caught.value)
    assert "\n" not in message
    assert all(word in message for word in [str(path), *words]), message


def test_camera_that_drives_into_a_body_is_an_error_that_names_the_frame(tmp_path):
    path = tmp_path / "crash.yaml"
    path.write_text(yaml.safe_dump(content(own_motion={"speed_m_s": 40})))
    with pytest.raises(UsageError, match=r"inside 'car' in frame [78]"):
        load_scene(path)


@pytest.mark.parametrize("text", ["[1, 2", "- a list", "", "!!python/object/apply:os.getcwd []"])
def test_file_that_is_no_scene_is_an_error(tmp_path, text):
    path = tmp_path / "wrong.yaml"
    path.write_text(text)
    with pytest.raises(UsageError, match=r"wrong\.yaml"):
        load_scene(path)


def test_missing_file_is_an_error(tmp_path):
    with pytest.raises(InputError, match="No such file"):
        load_scene(tmp_path / "nowhere.yaml")


@pytest.mark.parametrize(
    ("name", "collides"),
    [
        ("demo", {"crossing car"}),
        ("roundabout", set()),
        ("lead_car_brakes", {"lead car"}),
        ("crossing_collision", {"crossing car"}),
        ("crossing_clear", set()),
        ("oncoming", set()),
        ("parked_street", set()),
        ("aircraft_head_on", {"other aircraft"}),
        ("aircraft_passing", set()),
        ("resting_six_movers", set()),
        ("turning_jitter", {"lead car"}),
        ("drone_among_posts", {"crossing drone"}),
        ("swinging_drive", set()),
        ("stopped_car_ahead", {"stopped car"}),
        ("stop_at_crossing", set()),
    ],
)
def test_shipped_scenes_are_valid_and_collide_as_described(name, collides):
    scene = load_scene(SCENES / f"{name}.yaml")
    assert scene.name == name
    assert {encounter.name for encounter in encounters(scene) if encounter.is_collision} == collides
    assert all(not e.t_contact_s <= scene.camera.frame_times_s()[-1] for e in encounters(scene))


def test_every_shipped_scene_is_tested_above():
    marks = test_shipped_scenes_are_valid_and_collide_as_described.pytestmark
    tested = {name for name, _ in marks[0].args[1]}
    assert {path.stem for path in SCENES.glob("*.yaml")} == tested


@pytest.mark.parametrize("turning", [{"yaw_rate_deg_s": 120.0, "speed_m_s": 0.5}, {"spin_deg_s": [0.0, 0.0, 300.0]}])
def test_who_touches_whom_is_found_as_on_the_whole_fine_grid(turning):
    """Also of a lorry that turns so fast that its corners sweep over the camera between two times of the coarse one."""
    bodies = [{"name": "lorry", "kind": "lorry", "at_m": [4.0, 4.5, 0.0], **turning}]
    bodies.append({"name": "car", "kind": "car", "at_m": [30.0, 1.0, 0.0], "speed_m_s": 9.0, "heading_deg": 180.0})
    scene = Scene.model_validate(content(bodies=bodies))
    times_s = scene.camera.frame_times_s()
    fine_s = np.arange(times_s[0], times_s[-1] + LOOK_AHEAD_S, STEP_S)
    for found, expected in zip(encounters(scene), encounters_in(build_world(scene, fine_s)), strict=True):
        assert (found.name, found.is_collision) == (expected.name, expected.is_collision)
        np.testing.assert_allclose(
            [found.t_min_s, found.min_distance_m, found.t_contact_s],
            [expected.t_min_s, expected.min_distance_m, expected.t_contact_s],
            atol=1e-9,
        )
    assert encounters(Scene.model_validate(content(bodies=[]))) == []
