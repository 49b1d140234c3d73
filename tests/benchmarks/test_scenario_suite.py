"""The scenario suite: its truth against closed forms, its seeds, its nuisances, and that nothing is done twice."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
import pytest
from scenario_suite.drawing import drawing_key, drawn, read_json
from scenario_suite.families import FAMILIES, scenario
from scenario_suite.families.streets import OWN_RADIUS_M, mirrored
from scenario_suite.figures import Figures
from scenario_suite.nuisances import CLEAN_SHARE, NUISANCES, baselines, conditioned, drawn_nuisances
from scenario_suite.running import Task, Took, do
from scenario_suite.scoring import score
from scenario_suite.seeds import BUILDING_SEEDS, generator, verdict_seeds

from ttcvid.simulate import build_world, encounters

CLEAN = {}
"""No nuisance: each at its baseline."""


def first_collision(family: str):
    return next(one for seed in range(9) if (one := scenario(family, seed, "tracks", CLEAN)).is_collision)


def body_of(one, name: str):
    return next(body for body in one.scene.bodies if body.name == name)


def test_family_and_seed_determine_the_scene():
    assert scenario("CPNA-25", 17) == scenario("CPNA-25", 17)
    assert scenario("CPNA-25", 17).scene != scenario("CPNA-25", 18).scene
    assert scenario("CPNA-25", 17).name == "CPNA-25:17"


def test_every_test_of_the_trade_is_a_family():
    expected = """CCRs CCRm CCRb CCRb-2023 CMRs CMRb NHTSA-stopped NHTSA-braking NHTSA-slower cut-in CCFhos
        CCFhol CCFtap CMFtap CCCscp CCCscp-hidden CMCscp CMCscp-hidden CPNA-25 CPFA-50 CPNCO-50 CPLA-25
        CBNA-50 CBNAO-50 CBFA-50 CBLA-50 CPTA-50 CBTA-50 overtaken own-lanes lead-at-distance waiting
        roundabout bend empty-road mast-junction hand-held hovering hand-held-tracks air-head-on air-crossing
        air-converging air-overtaking KITTI-labels"""
    assert set(expected.split()) <= set(FAMILIES)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name, family in FAMILIES.items() if family.group != "recorded"])
def test_what_is_said_to_collide_does_and_the_rest_is_clear(name):
    """Of a family with both, a scene of each."""
    said, has_both = [], FAMILIES[name].collides is None
    for seed in (0, 1) if has_both else (0,):
        one = scenario(name, seed)
        met = encounters(one.scene)
        assert one.is_collision == any(encounter.is_collision for encounter in met)
        if not one.is_collision:
            assert all(encounter.min_distance_m > 1.2 * one.scene.own_motion.radius_m for encounter in met)
        said.append(one.is_collision)
    assert sorted(said) == ([False, True] if has_both else [False])


def test_contact_with_a_standing_car_is_its_distance_over_our_speed():
    one = first_collision("CCRs")
    target = body_of(one, "target")
    own = one.scene.own_motion.speed_m_s
    (met,) = encounters(one.scene)
    rear_m = target.at_m[0] - target.size_m[0] / 2
    # The nearest edge of its lower body lies aside and below: the camera's radius reaches it a little later.
    aside_m = max(0.0, abs(target.at_m[1]) - target.size_m[1] / 2)
    below_m = one.scene.camera.height_m - 0.58 * target.size_m[2]
    reach_m = math.sqrt(OWN_RADIUS_M**2 - aside_m**2 - below_m**2)
    assert met.t_contact_s == pytest.approx((rear_m - reach_m) / own, abs=0.006)
    assert one.scene.camera.frame_times_s()[-1] == pytest.approx(met.t_contact_s - 0.3, abs=0.12)


def test_contact_with_one_that_brakes_is_where_the_gap_is_used_up():
    one = first_collision("NHTSA-braking")
    target = body_of(one, "target")
    assert (target.speed_m_s, target.acceleration_m_s2) == pytest.approx((45 * 0.44704, -0.3 * 9.81), abs=1e-3)
    gap_m = target.at_m[0] - target.size_m[0] / 2
    assert gap_m == pytest.approx(30.0, abs=1e-3)
    (met,) = encounters(one.scene)
    expected_s = target.acceleration_from_s + math.sqrt(2 * (gap_m - OWN_RADIUS_M) / (0.3 * 9.81))
    assert met.t_contact_s == pytest.approx(expected_s, abs=0.02)


def test_walker_of_the_trade_walks_at_five_km_h_onto_a_quarter_of_our_width():
    one = first_collision("CPNA-25")
    walker = body_of(one, "crossing")
    own = one.scene.own_motion.speed_m_s
    pace = math.hypot(*walker.velocity_m_s)
    assert pace == pytest.approx(5 / 3.6, abs=1e-3)
    reaches_s = (walker.at_m[0] - OWN_RADIUS_M) / own
    # From the side that he comes from, a quarter of a car's 1.8 m: 0.45 m before our middle, give or take 0.12 of it.
    before_middle_m = -(walker.at_m[1] + walker.velocity_m_s[1] * reaches_s) * math.copysign(1, walker.velocity_m_s[1])
    assert before_middle_m == pytest.approx(0.25 * 1.8, abs=0.12 * 1.8 + 1e-3)


def test_times_of_a_head_on_contact_are_those_of_both_speeds(tmp_path):
    one = first_collision("CCFhos")
    truth = drawn(one, tmp_path)
    points = pd.read_parquet(truth / "truth_tracks.parquet").query("object_id == 1")
    closing = one.scene.own_motion.speed_m_s + body_of(one, "oncoming 1").speed_m_s
    pitch = math.cos(math.radians(one.scene.camera.pitch_deg))
    # Depth is measured along the camera's axis: both shrink by the cosine of its small tilt.
    np.testing.assert_allclose(points.vz_m_s, -closing * pitch, rtol=2e-3)
    np.testing.assert_allclose(points.ttc_z_s, -points.z_m / points.vz_m_s, rtol=1e-12)


def test_sweep_changes_the_camera_and_nothing_else():
    plain = scenario("CCCscp", 3, nuisances=CLEAN)
    for name, value in (("sensor_noise_grey", 4.0), ("frame_rate_hz", 10.0), ("texture", 0.3), ("hfov_deg", 95.0)):
        worse = scenario("CCCscp", 3, nuisances={name: value})
        assert worse.scene.bodies == plain.scene.bodies
        assert worse.scene.own_motion == plain.scene.own_motion
        assert worse.scene != plain.scene
        assert worse.nuisances == baselines("video") | {name: value}
        assert drawing_key(worse) != drawing_key(plain)


@pytest.mark.parametrize("kind", ["video", "tracks"])
def test_every_nuisance_is_drawn_and_every_value_of_its_sweep_makes_a_scene(kind):
    family, clean = FAMILIES["CCCscp"], scenario("CCCscp", 3, kind, CLEAN).scene
    values = [drawn_nuisances(generator("CCCscp", seed, "nuisances"), family, kind) for seed in range(300)]
    share = np.mean([value == baselines(kind) for value in values])
    assert CLEAN_SHARE - 0.05 < share < CLEAN_SHARE + 0.08
    for name, nuisance in NUISANCES[kind].items():
        assert any(value[name] != nuisance.baseline for value in values)
        assert nuisance.baseline is None or nuisance.baseline in nuisance.sweep
        for value in nuisance.sweep:
            assert conditioned(clean, baselines(kind) | {name: value}, generator("CCCscp", 3, "conditions"))


def test_times_of_the_pictures_follow_what_the_recorder_does():
    steady = scenario("CCRm", 4, nuisances=CLEAN).scene
    lost = scenario("CCRm", 4, nuisances={"frame_times": "dropped"}).scene
    uneven = scenario("CCRm", 4, nuisances={"frame_times": "variable"}).scene
    doubled = scenario("CCRm", 4, nuisances={"frame_times": "doubled"}).scene
    all_s, fewer_s = steady.camera.frame_times_s(), lost.camera.frame_times_s()
    assert set(fewer_s) < set(all_s)
    assert np.diff(fewer_s).max() > 0.14
    assert np.ptp(np.diff(uneven.camera.frame_times_s())) > 0.02
    np.testing.assert_array_equal(doubled.camera.frame_times_s(), all_s)
    assert len(doubled.picture.repeated_frames) > 0


def test_seeds_of_a_verdict_follow_from_the_commit_and_are_never_those_of_building():
    seeds = verdict_seeds("0123456789abcdef" * 2 + "01234567", 50)
    assert seeds == verdict_seeds("0123456789abcdef" * 2 + "01234567", 50)
    assert len({*seeds, *verdict_seeds("f" * 40, 50)}) == 100
    assert not set(seeds) & set(BUILDING_SEEDS)


def test_mirrored_twice_is_the_scene_itself():
    body = {"at_m": [1.0, 2.0, 3.0], "heading_deg": 30.0, "velocity_m_s": [4.0, 5.0, 6.0], "lane_change_m": 3.6}
    values = {"bodies": [body], "ground": {"centre_m": [1.0, 9.0], "road_offset_m": 2.0}}
    assert mirrored(values) != values
    assert mirrored(mirrored(values)) == values


def test_what_is_complete_is_not_done_again_and_another_estimator_gets_the_same_pictures(tmp_path):
    task = Task("CCFtap", 0, "tracks", tmp_path / "out", tmp_path / "pictures", CLEAN)
    first = do(task)
    assert not first.is_old
    assert (first.run["exit_code"], first.run["error"]) == (0, None)
    folder = tmp_path / "out" / "CCFtap" / "0"
    assert {path.name for path in folder.iterdir()} == {"scenario.json", "truth", "run", "run.json", "score"}
    assert (folder / "run" / "clusters.parquet").exists()
    said = read_json(folder / "scenario.json")
    assert (said["name"], said["kind"], said["nuisances"]) == ("CCFtap:0", "tracks", baselines("tracks"))
    drawn_at = (folder / "truth" / "tracks.parquet").stat().st_mtime_ns
    assert do(task).is_old
    other = do(replace(task, out=tmp_path / "smooth", options={"smooth": True}))
    assert not other.is_old
    assert (folder / "truth" / "tracks.parquet").stat().st_mtime_ns == drawn_at
    (folder / "run.json").unlink()
    assert not do(task).is_old


def test_analysis_is_told_the_focal_length_with_its_error(tmp_path):
    one = scenario("CCRs", 0, "tracks", {"focal": 0.05})
    given = (drawn(one, tmp_path) / "camera_given.yaml").read_text()
    true = (tmp_path / "truth" / "camera.yaml").read_text()
    focal = [float(next(line for line in text.splitlines() if "fx" in line).split()[-1]) for text in (given, true)]
    assert focal[0] / focal[1] == pytest.approx(1.05, rel=1e-6)
    unknown = scenario("CCRs", 0, "tracks", {"focal": "unknown"})
    assert not (drawn(unknown, tmp_path / "unknown") / "camera_given.yaml").exists()


@pytest.mark.data
@pytest.mark.usefixtures("data_dir")
def test_recorded_objects_move_as_their_labels_say():
    from scenario_suite.families.recorded import label_folder, recorded_world, trajectories_of

    one = scenario("KITTI-labels", 0, nuisances=CLEAN)
    step = 1e-4
    world = recorded_world(one.scene, one.recording, np.array([1.0 - step, 1.0, 1.0 + step]))
    moving = [actor for actor in world.actors if actor.object_id and abs(actor.path.position_m[1, 0]) < 500]
    assert moving
    for actor in moving:
        path = actor.path
        moved = (path.position_m[2] - path.position_m[0]) / (2 * step)
        np.testing.assert_allclose(path.velocity_m_s[1], moved, atol=1e-4)
    rows = [line.split() for line in (label_folder() / "0000.txt").read_text().splitlines()]
    for trajectory in trajectories_of("0000"):
        track = trajectory.name.split()[1].split(".")[0]
        labels = np.array([[float(row[k]) for k in (0, 13, 15)] for row in rows if row[1] == track])
        labels = labels[
            (labels[:, 0] >= 10 * trajectory.first_s - 0.5) & (labels[:, 0] <= 10 * trajectory.last_s + 0.5)
        ]
        off_m = np.hypot(*(trajectory.place(labels[:, 0] / 10)[:, :2] - labels[:, [2, 1]] * [1, -1]).T)
        # Smoothed within what a box drawn by hand is good to.
        assert np.median(off_m) < 0.3


def test_same_seeds_give_the_same_truth_and_the_same_figures(done_scenes, tmp_path):
    tasks = [
        Task(folder.parent.name, int(folder.name), "tracks", tmp_path / "out", tmp_path / "pictures")
        for folder in done_scenes
    ]
    again = [do(task).folder for task in tasks]
    figures = [
        Figures([score(folder) for folder in folders]).over(np.ones(2, bool)) for folders in (done_scenes, again)
    ]
    for one_folder, other_folder in zip(done_scenes, again, strict=True):
        for table in ("truth/tracks", "truth/truth_tracks", "truth/truth_encounters", "run/clusters", "run/events"):
            one, other = (pd.read_parquet(folder / f"{table}.parquet") for folder in (one_folder, other_folder))
            pd.testing.assert_frame_equal(one, other)
    assert figures[0]["found"].n > 0
    assert {name: repr(one) for name, one in figures[0].items()} == {
        name: repr(one) for name, one in figures[1].items()
    }


def test_how_long_a_run_took_is_said_beside_its_limit():
    assert Took(250, 0, 180.0).said("tables", 1000, 10) == (
        "250 tables in 3 min 0 s (1000 at this rate: 12.0 min, limit 10)"
    )
    assert "at this rate" not in Took(250, 1, 180.0).said("tables", 1000, 10)


def test_speeds_and_limits_of_the_trade_are_those_of_its_tests():
    """Euro NCAP's and NHTSA's values, over many seeds: the drawn ones lie within them and reach out for their ends."""

    @cache
    def contents(family):
        draw = FAMILIES[family].draw
        return [draw(generator(family, seed, "scene"), seed % 2 == 0) for seed in range(20)]

    def drawn_km_h(family, body=None):
        values = []
        for content in contents(family):
            own = content["own_motion"]["speed_m_s"]
            bodies = {one["name"]: one for one in content["bodies"]}
            values.append(3.6 * (own if body is None else bodies[body].get("speed_m_s", 0.0)))
        return min(values), max(values)

    def spans(found, least, most):
        return least - 1e-6 <= found[0] <= least + 0.2 * (most - least) and (
            most - 0.2 * (most - least) <= found[1] <= most + 1e-6
        )

    assert spans(drawn_km_h("CCRs"), 10, 80)
    assert spans(drawn_km_h("CMRs"), 10, 80)
    assert spans(drawn_km_h("CCRm"), 30, 130)
    assert spans(drawn_km_h("CCRm", "target"), 20, 70)
    assert spans(drawn_km_h("CCRb"), 30, 130)
    assert spans(drawn_km_h("CMRb"), 30, 130)
    assert drawn_km_h("CCRb-2023") == pytest.approx((50, 50))
    assert spans(drawn_km_h("CCFhos"), 30, 100)
    assert spans(drawn_km_h("CCFhos", "oncoming 1"), 50, 100)
    assert spans(drawn_km_h("CCFtap"), 10, 25)
    assert spans(drawn_km_h("CCFtap", "oncoming"), 30, 80)
    assert spans(drawn_km_h("CMFtap", "oncoming"), 30, 80)
    for name in ("NHTSA-stopped", "NHTSA-braking", "NHTSA-slower"):
        assert drawn_km_h(name) == pytest.approx((45 * 1.609344,) * 2, rel=1e-4)
    assert drawn_km_h("NHTSA-slower", "target") == pytest.approx((20 * 1.609344,) * 2, rel=1e-4)
    limits_s = {name: FAMILIES[name].warn_by_s for name in FAMILIES if name.startswith("NHTSA")}
    assert limits_s == {"NHTSA-stopped": 2.1, "NHTSA-braking": 2.4, "NHTSA-slower": 2.0}


def test_motorcycle_and_car_ahead_brake_as_the_trade_has_it():
    for name in ("CCRb", "CMRb"):
        one = first_collision(name)
        target = body_of(one, "target")
        gap_m = target.at_m[0] - target.size_m[0] / 2
        assert gap_m / one.scene.own_motion.speed_m_s == pytest.approx(1.0, abs=1e-3)
        assert target.acceleration_m_s2 == -4.0
    drawn_gaps, drawn_brakes = set(), set()
    for seed in range(24):
        content = FAMILIES["CCRb-2023"].draw(generator("CCRb-2023", seed, "scene"), True)
        (target,) = (body for body in content["bodies"] if body["name"] == "target")
        drawn_gaps.add(round(target["at_m"][0] - target["size_m"][0] / 2, 3))
        drawn_brakes.add(target["acceleration_m_s2"])
    assert drawn_gaps == {12.0, 40.0}
    assert drawn_brakes == {-2.0, -6.0}


def test_lane_change_of_head_on_traffic_ends_one_and_a_half_seconds_before_the_contact():
    one = first_collision("CCFhol")
    other = body_of(one, "oncoming 1")
    (met,) = [met for met in encounters(one.scene) if met.is_collision]
    ends_s = other.lane_change_from_s + other.lane_change_duration_s
    # Reached by its corner a little before or after its front is where we are.
    assert met.t_contact_s - ends_s == pytest.approx(1.5, abs=0.1)


@pytest.mark.slow
def test_intruders_are_eight_to_eighty_pixels_wide(tmp_path):
    widths = []
    for family in ("air-head-on", "air-crossing", "air-converging", "air-overtaking"):
        for seed in range(6):
            one = scenario(family, seed, "tracks", CLEAN)
            world = build_world(one.scene)
            (intruder,) = (actor for actor in world.actors if actor.object_id)
            away_m = np.linalg.norm(world.path.position_m - intruder.path.position_m, axis=1)
            widths += (world.camera.fx_px * intruder.body.size_m[1] / away_m).tolist()
    inside = [8.0 <= width <= 80.0 for width in widths]
    assert np.mean(inside) > 0.75
    assert min(widths) > 4.0
