"""Rules on trial: switched off inside the block and nowhere else, and what a rule earns over the same scenes."""

import inspect
import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from ablation import (
    EVERY,
    NONE_OF_THEM,
    Difference,
    each_done,
    earned,
    earned_badness,
    earned_share,
    families_changed,
    scene_place,
    shown,
    trials_of,
)
from real_clips.trials import Unit, shares_of
from scenario_suite.figures import Figures
from scenario_suite.rules import GROUPS, RULES, switched_off
from scenario_suite.running import Done, Task, do
from scenario_suite.scoring import SceneScore

from ttcvid.stages import update
from ttcvid.stages.tracking import static_overlays


def scene(family: str, n_found: int, n_due: int = 10) -> SceneScore:
    """A scene in which some of ten object-frames are found, each with times that are exact."""
    rows = pd.DataFrame({"is_wanted": True, "is_due": True, "is_found": np.arange(n_due) < n_found, "size_px": 50.0})
    rows = rows.assign(direction_deg=0.0, distance_m=10.0)
    for name in ("ttc_z", "tcpa", "miss"):
        rows[f"{name}_error"], rows[f"{name}_within"] = 0.0, True
    frames = pd.DataFrame({"frame": range(5), "n_false": 0, "rotation_deg": 0.0, "epipole_deg": 0.0})
    facts = {"name": f"{family}:0", "family": family, "kind": "tracks", "exit_code": 0, "warn_by_s": 2.0}
    facts |= {"n_labels": 10.0, "n_labels_wrong": 0.0, "false_warnings": 0.0, "analysed_s": 5.0, "warnings": []}
    return SceneScore(facts, rows, frames, Path())


def places(names=tuple(RULES)):
    return [place.rpartition(".") for name in names for place in RULES[name].instead]


def test_a_rule_is_off_inside_the_block_and_as_it_was_after_it():
    before = {place: getattr(import_module(f"ttcvid.{place[0]}"), place[2]) for place in places()}
    with switched_off(["frozen"]):
        assert (
            update.find_frozen
            is static_overlays.find_frozen
            is not before["stages.tracking.static_overlays", ".", "find_frozen"]
        )
        points = type("Points", (), {"track_id": np.arange(2), "xy_px": np.zeros((2, 2))})
        assert not update.find_frozen(None, points)[0].any()
    off = switched_off(tuple(RULES))
    off.__enter__()
    assert all(getattr(import_module(f"ttcvid.{a}"), b) is not former for (a, _, b), former in before.items())
    assert off.__exit__(KeyError, KeyError(), None) is not True
    assert all(getattr(import_module(f"ttcvid.{a}"), b) is former for (a, _, b), former in before.items())
    assert update.find_frozen is static_overlays.find_frozen


@pytest.mark.parametrize("name", ["growing", "obstacles"])
def test_without_surfaces_the_next_number_is_the_one_that_was_given(name):
    ((home, _, short),) = places([name])
    function = getattr(import_module(f"ttcvid.{home}"), short)
    given = {one: 7 if one == "next_cluster_id" else None for one in inspect.signature(function).parameters}
    with switched_off([name]):
        assert getattr(import_module(f"ttcvid.{home}"), short)(*given.values()) == ({}, (), 7)


@pytest.mark.parametrize("name", RULES)
def test_a_rule_that_is_off_is_nowhere_in_the_package(name):
    formers = [getattr(import_module(f"ttcvid.{home}"), short) for home, _, short in places([name])]
    with switched_off([name]):
        left = [
            f"{key}.{attribute}"
            for former in formers
            if callable(former)
            for key, module in list(sys.modules.items())
            if key.startswith("ttcvid.")
            for attribute, value in list(vars(module).items())
            if value is former
        ]
        assert left == []
        assert all(
            getattr(import_module(f"ttcvid.{home}"), short) != former
            for (home, _, short), former in zip(places([name]), formers, strict=True)
        )


def test_where_no_rule_acts_the_analysis_is_the_same_with_it_and_without_it(tmp_path):
    def tables(name, without, is_watched=False):
        task = Task("CCRb", 0, "tracks", tmp_path / name, tmp_path / "pictures", {}, without=without)
        done = do(replace(task, is_watched=is_watched))
        assert done.run["error"] is None
        run = [pd.read_parquet(done.folder / "run" / f"{table}.parquet") for table in ("clusters", "collision_times")]
        return run, set(done.run.get("acting", ()))

    everything, acting = tables("all", (), True)
    assert {"road", "nearer"} <= acting
    idle = tuple(name for name in RULES if name not in acting)
    assert idle
    for one, other in zip(everything, tables("without_idle", idle)[0], strict=True):
        pd.testing.assert_frame_equal(one, other)
    nothing, would_act = tables("none", tuple(RULES), True)
    assert not nothing[0].equals(everything[0])
    for one, other in zip(nothing, tables("with_idle", tuple(would_act))[0], strict=True):
        pd.testing.assert_frame_equal(one, other)


def test_a_trial_in_which_no_rule_acts_that_differs_is_not_run():
    trials = trials_of(("one-out", "add-one"))
    asked = []

    def run(tasks):
        for task in tasks:
            asked.append(task.without)
            acting = ["road"] if task.without == () else ["fronts"]
            yield Done(task, Path(), False, 0.0, {"acting": acting, "without": task.without})

    def tasks_of(trial):
        return [Task("CCRs", 0, "tracks", Path(trial.folder), Path(), without=trial.without)]

    done = each_done(trials, tasks_of, run, lambda one: one.run["acting"], scene_place)
    others = {name: tuple(other for other in RULES if other != name) for name in RULES}
    assert asked == [(), tuple(RULES), ("road",), others["fronts"]]
    for trial, (one,) in done.items():
        if trial.kind == "one-out":
            assert one.run["without"] == (("road",) if trial.name == "road" else ())
        if trial.kind == "add-one":
            assert one.run["without"] == (others["fronts"] if trial.name == "fronts" else tuple(RULES))


def test_real_units_are_judged_with_the_same_draws():
    with_it = shares_of([Unit("found", 2, 3), Unit("found", 1, 1), Unit("warnings", 0, 0.1)])
    without = shares_of([Unit("found", 1, 3), Unit("found", 1, 1), Unit("warnings", 1, 0.1)])
    assert earned_share(with_it["found"], without["found"], 1.0).value == pytest.approx(0.25)
    assert earned_share(with_it["found"], without["found"], 1.0).lo == 0.0
    assert earned_share(with_it["warnings"], without["warnings"], -1.0).value == pytest.approx(10.0)
    assert earned_share(with_it["found"], with_it["found"], 1.0) == Difference(0.0, 0.0, 0.0)


def test_every_rule_is_in_one_group_and_in_every_kind_of_trial():
    assert sorted(name for names in GROUPS.values() for name in names) == sorted(RULES)
    trials = trials_of(("one-out", "group-out", "add-one"))
    assert [trial.name for trial in trials[:2]] == [EVERY, NONE_OF_THEM]
    assert {trial.without for trial in trials if trial.kind == "one-out"} == {(name,) for name in RULES}
    for trial in trials:
        if trial.kind == "add-one":
            assert set(RULES) - set(trial.without) == {trial.name}
            assert trial.beside == NONE_OF_THEM
    assert all(rule.n_lines > 0 for rule in RULES.values())


def test_a_rule_earns_what_is_found_with_it_and_not_without():
    with_it = [scene("a", 8), scene("b", 9), scene("b", 6)]
    without = [scene("a", 8), scene("b", 5), scene("b", 5)]
    found = earned(Figures(with_it), Figures(without), "found", 1.0)
    assert found.value == pytest.approx(5 / 30)
    assert 0.0 <= found.lo < found.value < found.hi <= 0.4 + 1e-9
    badness = earned_badness(with_it, without)
    assert badness.value == pytest.approx(0.5 / 3)
    assert families_changed(with_it, without) == {"b": pytest.approx(0.25)}
    assert families_changed(without, with_it) == {"b": pytest.approx(-0.25)}
    alike = earned(Figures(with_it), Figures(with_it), "found", 1.0)
    assert alike == Difference(0.0, 0.0, 0.0)
    assert (shown(alike), shown(Difference(0.1, 0.05, 0.2), 100.0)) == ("0", "**+10 (+5.0 to +20)**")
