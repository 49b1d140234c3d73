"""Maps from truth against every changed velocity driven, and drives that follow the advice."""

from pathlib import Path

import numpy as np
import pytest
from advised_drive import drive
from brute_force import contact_times_s, is_inner
from collision_map import brute_force_map

from ttcvid.jobs.collision_map.true_hazards import own_body_of, true_situation
from ttcvid.simulate import build_world, encounters, load_scene
from ttcvid.studies.collision_map.evasion import EvasionLimits, EvasionStatus, evade
from ttcvid.studies.collision_map.velocity_map import LIKELY, map_of_changes

SCENES = Path(__file__).parent.parent.parent / "sample_configs" / "scenes"


def test_present_velocity_driven_on_touches_when_the_scene_says_so():
    scene = load_scene(SCENES / "aircraft_head_on.yaml")
    (expected,) = encounters(scene)
    velocity = build_world(scene).path.velocity_m_s[:1]
    contact = contact_times_s(scene, 0.0, np.concatenate([velocity, 0.2 * velocity]), 0.0, 6.0)
    assert contact[0] == pytest.approx(expected.t_contact_s, abs=0.03)
    assert np.isinf(contact[1])


@pytest.mark.parametrize("name", ["aircraft_head_on", "resting_six_movers"])
def test_map_from_truth_agrees_with_every_changed_velocity_driven(name: str):
    scene = load_scene(SCENES / f"{name}.yaml")
    world = build_world(scene)
    frame = world.n_frames // 2
    situation = true_situation(world, frame, own_body_of(world))
    changes = np.linspace(-10.0, 10.0, 31)
    made = map_of_changes(situation, changes, changes, 5.0)
    contact = brute_force_map(scene, world, frame, situation, changes, changes)
    is_hit = np.isfinite(contact)
    inner = is_inner(is_hit)
    assert is_hit.any()
    assert ((made.probability >= LIKELY) == is_hit)[inner].mean() >= 0.99
    assert np.median(np.abs(made.time_s - contact)[is_hit & inner]) < 0.03


@pytest.mark.slow
@pytest.mark.parametrize("name", ["aircraft_head_on", "crossing_collision", "lead_car_brakes"])
def test_following_the_advice_avoids_the_collision(name: str):
    scene = load_scene(SCENES / f"{name}.yaml")
    contact_s = min(one.t_contact_s for one in encounters(scene) if one.is_collision)
    done = drive(scene, contact_s + 2.0, 0.2)
    assert np.isinf(done.contact_s), (done.touched, done.contact_s)
    assert done.n_advices > 0
    assert done.first_advice_s < contact_s - 1.0


@pytest.mark.parametrize("name", ["crossing_clear", "oncoming", "parked_street", "aircraft_passing"])
def test_a_scene_without_danger_gives_no_advice(name: str):
    scene = load_scene(SCENES / f"{name}.yaml")
    world = build_world(scene)
    for frame in range(0, world.n_frames, 4):
        advice = evade(true_situation(world, frame, own_body_of(world)), EvasionLimits())
        assert advice.status is EvasionStatus.no_danger, frame
