"""What the scenario suite says of scenes: which objects have to be found, figures with their spread, the page."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scenarios
from report import REPOSITORY, Report
from scenario_suite.figures import Figures, Percentile, Rate, Share, at_most, figures_of_warnings
from scenario_suite.page import label_of, number, shown, write_page
from scenario_suite.scoring import (
    SceneScore,
    is_on_course,
    judged_rows,
    n_averted,
    on_course_since_s,
    own_velocity_m_s,
    scene_tracks,
    score,
    size_px,
    wanted,
)

from ttcvid.studies.evaluation.evaluate import Evaluation
from ttcvid.studies.evaluation.truth import BOX, DIRECTION, POSITION, UNKNOWN_OBJECT, VELOCITY, Truth

FOCAL_PX, SIGMA_PX = 500.0, 0.2
NO_DRAW = np.ones((1, 1), np.int64)


def seen(place_m, velocity_m_s, *, n=10, object_id=1, box=(0.0, 0.0, 40.0, 40.0)) -> pd.DataFrame:
    """Rows of ``Evaluation.joined`` of an object that is where it is in every frame, 0.1 s apart, and is found."""
    rows = pd.DataFrame({"frame": range(n), "t_s": 0.1 * np.arange(n), "object_id": object_id, "is_counted": True})
    for columns, values in ((BOX, box), (POSITION, place_m), (VELOCITY, velocity_m_s)):
        rows[columns] = np.tile(np.array(values, float), (n, 1))
    return rows


def truth_of(own_m_s=(0.0, 0.0, 0.0), contact_s=np.nan, n=10) -> Truth:
    """Own velocity, null in the first frame, and when object 1 is hit."""
    frames = pd.DataFrame({"frame": range(n)})
    frames[VELOCITY] = np.vstack([np.full(3, np.nan), np.tile(np.array(own_m_s, float), (n - 1, 1))])
    hit = {"object_id": [1], "is_collision": [np.isfinite(contact_s)], "t_contact_s": [contact_s]}
    return Truth(frames=frames, encounters=pd.DataFrame(hit))


def test_tracks_of_the_scene_are_judged_without_outliers_movers_and_far_ones():
    points = pd.DataFrame(
        {
            "frame": [3, 3, 3, 3, 3, 4],
            "track_id": [1, 2, 3, 4, 5, 1],
            "object_id": [0, 0, 0, 0, 7, 0],
            "is_outlier": [False, False, False, True, False, False],
            "ttc_z_s": [4.0, 4.0, 1000.0, 4.0, 4.0, 3.9],
        }
    )
    tracks = points[["frame", "track_id"]].assign(ttc_z_s=[5.0, 4.4, 4.0, 9.0, 9.0, np.nan])
    tracks["ttc_z_lo_s"], tracks["ttc_z_hi_s"] = 0.95 * tracks.ttc_z_s, 1.2 * tracks.ttc_z_s
    tracks.loc[1, "ttc_z_lo_s"] = 3.0
    (only,) = scene_tracks(tracks, points).to_dict("records")
    # The first errs by a fifth and says not, the second by a tenth and says so; the last frame tells nothing.
    assert (only["frame"], only["n_scene_ttc_z"], only["n_scene_ttc_z_within"]) == (3, 2, 1)
    assert only["scene_ttc_z_error"] == pytest.approx(0.5 * (1 / 5 + 1 / 11))


def test_a_parked_car_that_we_pass_does_not_have_to_be_found():
    rows = seen((3.0, 0.0, 20.0), (0.0, 0.0, -10.0))
    assert not wanted(rows, truth_of(own_m_s=(0.0, 0.0, 10.0)), FOCAL_PX, SIGMA_PX).any()


def test_the_car_in_our_way_has_to_be_found_three_seconds_before_it_is_hit():
    rows = seen((0.0, 0.0, 40.0), (0.0, 0.0, -10.0))
    is_wanted = wanted(rows, truth_of(own_m_s=(0.0, 0.0, 10.0), contact_s=3.45), FOCAL_PX, SIGMA_PX)
    assert is_wanted.tolist() == [False] * 5 + [True] * 5


def test_what_crosses_has_to_be_found_once_it_has_moved_by_three_sigma():
    # 1 m/s at 100 m: 5 px/s, so that 0.6 px have passed after 0.12 s.
    rows = seen((0.0, 0.0, 100.0), (1.0, 0.0, 0.0))
    assert wanted(rows, truth_of(), FOCAL_PX, SIGMA_PX).tolist() == [False, False] + [True] * 8
    assert not wanted(rows, truth_of(), FOCAL_PX, 1.0).any()


def test_what_goes_ahead_of_us_at_our_speed_moves_by_what_its_outline_would_have_grown():
    rows = seen((0.0, 0.0, 20.0), (0.0, 0.0, 0.0))
    assert wanted(rows, truth_of(own_m_s=(0.0, 0.0, 10.0)), FOCAL_PX, SIGMA_PX)[3:].all()


def test_what_is_hardly_seen_does_not_count_and_what_is_small_is_wanted_but_not_due():
    small = seen((0.0, 0.0, 20.0), (5.0, 0.0, 0.0), box=(0.0, 0.0, 20.0, 20.0))
    assert size_px(small).tolist() == [20.0] * 10
    is_wanted = wanted(small, truth_of(), FOCAL_PX, SIGMA_PX)
    assert is_wanted[1:].all()
    assert not wanted(small.assign(is_counted=False), truth_of(), FOCAL_PX, SIGMA_PX).any()
    found = {f"{axis}_found": 0.0 for axis in DIRECTION} | dict.fromkeys(DIRECTION, 0.0)
    times = {
        f"{t}{end}_s{f}": 1.0 for t in ("ttc_z", "tcpa", "miss") for end in ("", "_lo", "_hi") for f in ("", "_found")
    }
    rows = judged_rows(small.assign(is_found=True, **found, **times), is_wanted)
    assert not rows.is_due.any()
    assert rows.ttc_z_within.all()


def test_own_velocity_is_the_middle_of_the_steps_before_and_after():
    frames = truth_of(n=3).frames
    frames.loc[1, "vz_m_s"], frames.loc[2, "vz_m_s"] = 4.0, 6.0
    assert own_velocity_m_s(frames).vz_m_s.tolist() == [4.0, 5.0, 6.0]


def test_a_share_is_that_of_sums_and_its_spread_that_of_scenes():
    share = Share(np.array([9.0, 0.0]), np.array([10.0, 30.0]), is_coverage=True)
    draws = np.array([[2, 0], [1, 1], [0, 2]])
    both = share.estimate(np.array([0, 1]), draws)
    assert (both.value, both.n) == (9 / 40, 40)
    assert both.lo == pytest.approx(0.0, abs=0.03)
    assert both.hi == pytest.approx(0.9, abs=0.08)
    # Wilson, Journal of the American Statistical Association 22 (1927), 95 %: 9 of 40.
    assert both.bounds == pytest.approx((0.123, 0.375), abs=5e-4)
    alone = share.estimate(np.array([0]), NO_DRAW)
    assert alone.value == 0.9
    assert np.isnan(alone.lo)


def test_a_percentile_over_part_of_the_scenes_is_that_of_their_values():
    values, scene = np.array([5.0, 1.0, 3.0, 100.0]), np.array([2, 0, 2, 1])
    draws = np.array([[1, 1], [2, 0], [0, 2]])
    one = Percentile(values, scene, 0.5).estimate(np.array([0, 2]), draws)
    assert (one.value, one.n) == (3.0, 3)
    assert 1.0 <= one.lo < one.hi <= 3.0
    assert np.isnan(Percentile(values, scene, 0.5).estimate(np.array([3]), NO_DRAW).value)


def test_no_false_warning_in_an_hour_excludes_half_a_one_in_ten_minutes():
    none = Rate(np.zeros(1), np.array([3600.0]), 600.0).estimate(np.array([0]), NO_DRAW)
    assert (none.value, none.bounds) == (0.0, pytest.approx((0.0, 0.4993), abs=1e-3))
    assert at_most(0) == pytest.approx(-np.log(0.05))


def test_a_scene_without_a_result_is_in_no_figure():
    facts = {"name": "a:0", "kind": "tracks", "exit_code": 70, "warn_by_s": 2.0}
    figures = Figures([SceneScore(facts, pd.DataFrame(), pd.DataFrame(), Path())])
    assert {one.n for one in figures.over(np.ones(1, bool)).values()} == {0}
    assert shown(figures.over(np.ones(1, bool))["found"], 100.0) == "–"


def test_values_of_nuisances_are_told_in_few_words():
    assert [label_of("hfov_deg", value) for value in (None, 40.0, 65.0, 100.0)] == [
        "own",
        "under 50",
        "65-80",
        "over 95",
    ]
    assert [label_of("focal", value) for value in (-0.05, 0.05, "unknown")] == ["0.05", "0.05", "unknown"]
    assert [number(value) for value in (0.0, 0.00012, 0.5, 12.34)] == ["0", "0.0001", "0.50", "12"]


def test_the_page_of_the_same_scenes_is_the_same_and_a_score_is_made_once(done_scenes, tmp_path):
    scores = []
    for folder in done_scenes:
        made_at = (folder / "score" / "facts.json").stat().st_mtime_ns
        scores.append(score(folder))
        assert (folder / "score" / "facts.json").stat().st_mtime_ns == made_at
    pages = []
    for name in ("one", "two"):
        docs, report = tmp_path / name, Report()
        docs.mkdir()
        write_page(report, scores, scores[:1], [], docs=docs)
        pages.append(("\n".join(report._markdown), (docs / "scenarios_errors.png").read_bytes()))
    assert pages[0] == pages[1]
    assert "2 tables of point tracks" in pages[0][0]
    assert "| mast-crossing | 1 |" in pages[0][0]
    bars = next(line for line in pages[0][0].splitlines() if line.startswith("| found |"))
    found = [shown(Figures(some).over(np.ones(len(some), bool))["found"], 100.0) for some in (scores, scores[:1])]
    assert found[0] != found[1]
    assert [cell.strip() for cell in bars.split("|")[3:6:2]] == found


@pytest.mark.slow
def test_a_run_that_is_stopped_goes_on_where_it_was(tmp_path, monkeypatch, capsys):
    words = ["benchmarks/scenarios.py", "--families", "CCFtap,CMFtap", "--kind", "tracks", "--seeds", "0-9"]
    words += ["--jobs", "1", "--out", str(tmp_path / "out")]
    # A shell lets what it starts in the background ignore the signal.
    options = {"start_new_session": True, "preexec_fn": lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)}
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen([sys.executable, *words], cwd=REPOSITORY, **options, **streams)
    assert process.stdout is not None
    first = process.stdout.readline()
    assert first.startswith("   1/20 CCFtap:0  drawn")
    os.killpg(process.pid, signal.SIGINT)
    _, complaint = process.communicate(timeout=60)
    assert (process.returncode, complaint) == (130, "")
    for _ in range(100):
        if _is_gone(process.pid):
            break
        time.sleep(0.1)
    assert _is_gone(process.pid)
    monkeypatch.setattr(sys, "argv", [*words, "--n", "1"])
    monkeypatch.setattr(scenarios, "run_all", lambda tasks, n_jobs, work: map(work, tasks))
    scenarios.main()
    assert "1 done before, 0 without a result" in capsys.readouterr().out


def _is_gone(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return True
    return False


def test_collisions_with_what_was_large_and_on_course_for_two_seconds_are_counted_by_themselves():
    def hit(lead_s, large_for_s, on_course_for_s):
        return {"verdict": "late", "lead_s": lead_s, "large_for_s": large_for_s, "on_course_for_s": on_course_for_s}

    facts = {"warn_by_s": 1.0, "analysed_s": 300.0, "false_warnings": 2.0, "averted_warnings": 1.0, "false_ids": 0.0}
    scenes = [[hit(1.8, 2.5, 2.5), hit(1.9, 1.5, 1.5)], [hit(1.0, 2.1, 0.5), hit(None, 0.0, 0.0)]]
    scores = [SceneScore(facts | {"warnings": hits}, pd.DataFrame(), pd.DataFrame(), Path()) for hits in scenes]
    told, draws = figures_of_warnings(scores), np.ones((1, 2), np.int64)
    assert told["warned_1.7s"].estimate(np.arange(2), draws).value == 2 / 4
    assert told["foreseen_warned_1.7s"].estimate(np.arange(2), draws).value == 1 / 2
    assert told["on_course_warned_1.7s"].estimate(np.arange(2), draws).value == 1
    assert told["false_warnings"].estimate(np.arange(2), draws).value == 4.0
    assert told["unfounded_warnings"].estimate(np.arange(2), draws).value == 2.0


def test_who_would_touch_us_at_constant_velocities_is_on_course():
    assert is_on_course(seen((0.5, 0.0, 20.0), (0.0, 0.0, -10.0)), FOCAL_PX).all()
    # A box of 40 px at 20 m is 1.6 m wide.
    assert is_on_course(seen((1.7, 0.0, 20.0), (0.0, 0.0, -10.0)), FOCAL_PX).all()
    assert not is_on_course(seen((2.0, 0.0, 20.0), (0.0, 0.0, -10.0)), FOCAL_PX).any()
    assert is_on_course(seen((10.0, 0.0, 20.0), (-5.0, 0.0, -10.0)), FOCAL_PX).all()
    assert not is_on_course(seen((0.0, 0.0, 20.0), (0.0, 0.0, 10.0)), FOCAL_PX).any()
    assert not is_on_course(seen((0.0, 0.0, 20.0), (0.0, 0.0, 0.0)), FOCAL_PX).any()


def test_a_collision_is_foreseen_from_where_it_stays_on_course():
    """Who stands until frame 6 and then runs before us is on course in frame 2 by chance, and for good from 6 on."""
    rows = seen((8.0, 0.0, 20.0), (0.0, 0.0, -10.0))
    rows.loc[[2, 6, 7, 8, 9], VELOCITY[0]] = -4.0
    assert on_course_since_s(rows, FOCAL_PX).to_dict() == {1: pytest.approx(0.6)}
    # It is beside us at last: its closest approach lies behind.
    rows.loc[9, [POSITION[2], VELOCITY[0]]] = 0.5, 4.0
    assert on_course_since_s(rows, FOCAL_PX).to_dict() == {1: pytest.approx(0.6)}
    assert on_course_since_s(rows.iloc[:6], FOCAL_PX).empty


def test_a_warning_of_who_stops_short_of_our_way_is_no_unfounded_one():
    events = pd.DataFrame({"start_frame": [2, 8, 2, 2]})
    rows = seen((8.0, 0.0, 20.0), (-4.0, 0.0, -10.0))
    rows.loc[5:, VELOCITY[0]] = 0.0
    rows = pd.concat([rows, seen((0.0, 0.0, 20.0), (0.0, 0.0, -10.0), object_id=2)], ignore_index=True)
    of_walker, of_nobody, of_hit = 1, UNKNOWN_OBJECT, 2
    judged = Evaluation({}, (), rows, pd.DataFrame(), np.array([of_walker, of_walker, of_nobody, of_hit]))
    assert n_averted(judged, events, [2], FOCAL_PX) == 1
