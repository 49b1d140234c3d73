"""``ttcvid collision-map`` from a scene's truth: what it writes, and what it refuses."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import ttcvid
from ttcvid.cli.main import main
from ttcvid.config import CollisionMapConfig
from ttcvid.jobs.collision_map.moments import Moment
from ttcvid.jobs.collision_map.run_collision_map import advice_at, most_telling
from ttcvid.schema import STUDY_TABLES
from ttcvid.studies.collision_map.evasion import EvasionStatus
from ttcvid.studies.collision_map.hazards import OwnBody, Situation, one_object

SCENES = Path(__file__).parent.parent.parent / "sample_configs" / "scenes"


@pytest.fixture(scope="module")
def head_on(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("maps") / "head_on"
    result = ttcvid.collision_map(SCENES / "aircraft_head_on.yaml", out, time_s=2.0)
    assert result.frame == 50
    return out


def test_tables_are_those_of_the_schema(head_on: Path):
    for name in ("collision_map", "evasion"):
        table = pd.read_parquet(head_on / f"{name}.parquet")
        assert list(table) == [column.name for column in STUDY_TABLES[name]]
    assert len(pd.read_parquet(head_on / "collision_map.parquet")) == 61 * 61


def test_middle_of_the_map_is_the_present_velocity(head_on: Path):
    table = pd.read_parquet(head_on / "collision_map.parquet")
    now = table[(table.forward_m_s == 0) & (table.right_m_s == 0)].iloc[0]
    # 420 m apart at first, 80 m/s: after 2 s it is 260 m, less 6 m of our radius and 6 m of its half length.
    assert now["name"] == "other aircraft"
    assert now.time_s == pytest.approx((420 - 160 - 6 - 6) / 80, abs=0.02)
    assert now.cluster_id == 1


def test_every_frame_has_an_advice_or_a_reason(head_on: Path):
    table = pd.read_parquet(head_on / "evasion.parquet")
    assert len(table) == 120
    assert set(table.status) <= {"no_danger", "advice", "no_escape"}
    advised = table[table.status == "advice"]
    assert (advised.time_s <= 3.5).all()
    assert (advised.probability_after <= 0.1).all()
    assert (np.hypot(advised.forward_m_s, advised.right_m_s) > 0).all()


def configured_map(out: Path) -> Path:
    """A small map, as a file of settings has it."""
    sample = SCENES.parent / "collision_map.toml"
    words = ["collision-map", str(SCENES / "aircraft_passing.yaml"), "--config", str(sample), "-o", str(out), "-q"]
    assert main([*words, "--units", "own-speed"]) == 0
    return out


def test_configuration_file_counts_and_pictures_are_the_same_every_time(tmp_path: Path):
    out, again = configured_map(tmp_path / "map"), configured_map(tmp_path / "again")
    for name in ("collision_map.png", "collision_map.parquet", "evasion.parquet"):
        assert (again / name).read_bytes() == (out / name).read_bytes(), name
    configuration = json.loads((out / "manifest.json").read_text())["configuration"]
    assert configuration["braking_m_s2"] == 3
    assert configuration["units"] == "own-speed"
    assert len(pd.read_parquet(out / "collision_map.parquet")) == 41 * 41


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--width-m", "0"], "--width-m = '0': expected greater than 0"),
        (["--n-cells", "60"], "expected an odd number"),
        (["--frame", "900"], "--frame 900: aircraft_head_on has frames 0 to 119"),
        (["--time", "-3"], "--time -3: aircraft_head_on runs from"),
        (["--frame", "3", "--time", "1"], "exclude each other"),
        (["--warn-s", "9"], "warn_s = 9 is longer than look_ahead_s = 5"),
        (["--ego-speed", "5"], "is a scene, which knows it by itself"),
        (["--max-probability", "1.5"], "--max-probability = '1.5'"),
        (["--braking-m-s2", "nan"], "--braking-m-s2 = 'nan'"),
    ],
)
def test_impossible_parameters_are_refused_in_one_line(
    options: list[str], complaint: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    out = tmp_path / "map"
    assert main(["collision-map", str(SCENES / "aircraft_head_on.yaml"), "-o", str(out), *options]) == 2
    said = capsys.readouterr().err
    assert said.startswith("ttcvid: error: ")
    assert said.count("\n") == 1
    assert complaint in said
    assert not out.exists()


def moment_with(name: str, place: tuple[float, float, float], **changes: object) -> Moment:
    """We drive at 10 m/s towards one thing at rest."""
    box = np.array([place]), np.array([[0.0, 0.0, -10.0]]), np.full((1, 3), 0.8)
    return Moment(Situation(one_object(name, 1, *box), OwnBody(1.8, 4.5, 1.5), np.array([0.0, 0.0, 10.0])), **changes)


IN_THE_WAY, ASIDE = (0.0, 0.0, 25.0), (9.0, 0.0, 25.0)


@pytest.mark.parametrize(
    ("moment", "status"),
    [
        (moment_with("car", IN_THE_WAY), EvasionStatus.advice),
        (moment_with("car", ASIDE), EvasionStatus.no_danger),
        (moment_with("car", IN_THE_WAY, unlinked=("car",)), EvasionStatus.unknown),
        (moment_with("car", ASIDE, unlinked=("car",)), EvasionStatus.no_danger),
        (moment_with("car", ASIDE, is_scene_known=False), EvasionStatus.unknown),
        (moment_with("car", IN_THE_WAY, is_scene_known=False), EvasionStatus.advice),
        (moment_with("car", IN_THE_WAY, course_rad=(0.4, 1.2)), EvasionStatus.unknown),
        (Moment(None, EvasionStatus.no_result), EvasionStatus.no_result),
        (Moment(None, EvasionStatus.no_scale), EvasionStatus.no_scale),
    ],
)
def test_where_the_map_cannot_tell_it_says_unknown(moment: Moment, status: EvasionStatus):
    assert advice_at(moment, CollisionMapConfig()).status is status


def test_the_map_is_of_the_first_frame_in_which_something_is_to_be_done_as_help_says(
    capsys: pytest.CaptureFixture[str],
):
    moments = [
        moment_with("car", ASIDE),
        moment_with("car", ASIDE, is_scene_known=False),
        moment_with("wall", (0.0, 0.0, 4.0)),
        moment_with("car", IN_THE_WAY),
    ]
    advices = [advice_at(moment, CollisionMapConfig()) for moment in moments]
    assert [advice.status for advice in advices[2:]] == [EvasionStatus.no_escape, EvasionStatus.advice]
    assert most_telling(advices) == 2
    assert most_telling(advices[:2]) in (0, 1)
    assert main(["collision-map", "--help"]) == 0
    words = " ".join(capsys.readouterr().out.split())
    assert "default: the first in which something is to be done, else the most dangerous" in words


def test_a_folder_of_something_else_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["collision-map", str(tmp_path), "-o", str(tmp_path / "map")]) == 3
    assert "manifest.json (a run) nor scene.yaml (a simulation)" in capsys.readouterr().err
