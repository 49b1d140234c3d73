"""Rules on trial: switched off inside the block and nowhere else, and what a rule earns over the same scenes."""

from importlib import import_module
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from ablation import EVERY, NONE_OF_THEM, Difference, earned, earned_badness, families_changed, shown, trials_of
from scenario_suite.figures import Figures
from scenario_suite.rules import GROUPS, RULES, switched_off
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


def test_every_rule_is_in_one_group_and_in_every_kind_of_trial():
    assert sorted(name for names in GROUPS.values() for name in names) == sorted(RULES)
    trials = trials_of(("one-out", "group-out", "add-one"))
    assert [trial.name for trial in trials[:2]] == [EVERY, NONE_OF_THEM]
    assert {trial.without for trial in trials if trial.kind == "one-out"} == {(name,) for name in RULES}
    for trial in trials:
        if trial.kind == "add-one":
            assert set(RULES) - set(trial.without) == {trial.name}
            assert trial.beside == NONE_OF_THEM
    assert all(rule.n_lines > 0 for rule in RULES.values() if rule.files)


def test_a_rule_earns_what_is_found_with_it_and_not_without():
    with_it = [scene("a", 8), scene("b", 9), scene("b", 6)]
    without = [scene("a", 8), scene("b", 5), scene("b", 5)]
    found = earned(Figures(with_it), Figures(without), "found", 1.0)
    assert found.value == pytest.approx(5 / 30)
    assert 0.0 <= found.lo < found.value < found.hi <= 0.4 + 1e-9
    badness = earned_badness(with_it, without)
    assert badness.value == pytest.approx(0.5 / 3)
    assert families_changed(with_it, without) == (1, 0)
    assert families_changed(without, with_it) == (0, 1)
    alike = earned(Figures(with_it), Figures(with_it), "found", 1.0)
    assert alike == Difference(0.0, 0.0, 0.0)
    assert (shown(alike), shown(Difference(0.1, 0.05, 0.2), 100.0)) == ("0", "**+10 (+5.0 to +20)**")
