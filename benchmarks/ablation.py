"""Every special rule of the analysis on trial: what it earns over the scenario suite, and what it costs in lines.

python benchmarks/ablation.py [--seeds 0-1] [--n 104] [--rendered 12] [--trials one-out,group-out,add-one] [--real]
python benchmarks/ablation.py --write-docs                  # docs/ablation.md

Each scene is analysed with all rules, and again without one of them, without a group of them, without any, and with
one alone. The rules are switched off in this program's own processes (`scenario_suite.rules`). What is complete below
--out is not done again; Ctrl-C, and it goes on where it was.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

# One thread of linear algebra in each process: set before numpy is loaded.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from real_clips.clips import CLIPS, DASHCAM, ClipTask, do_clip
from report import REPOSITORY, Report
from runs import data_folder, until_stopped
from scenario_suite.families import FAMILIES, in_turn
from scenario_suite.figures import SPREAD, Figures, draws_of
from scenario_suite.page import badness, number
from scenario_suite.rules import GROUPS, RULES
from scenario_suite.running import Task, do, run_all
from scenario_suite.scoring import SceneScore, score

from ttcvid.model import Floats

TRIALS = ("one-out", "group-out", "add-one")
EVERY, NONE_OF_THEM = "all rules", "no rule"
FIGURES = (
    ("found", "found, points", 100.0, 1.0),
    ("labels_wrong", "labels, points", 100.0, -1.0),
    ("ttc_z_median", "ttc_z, points", 100.0, -1.0),
    ("false_per_frame", "false objects in 100 frames", 100.0, -1.0),
    ("warned_2s", "warned >= 2 s, points", 100.0, 1.0),
    ("false_warnings", "false warnings in 10 min", 1.0, -1.0),
)
"""Figures of the suite, their names on the page, scale, and whether more is better (1) or less (-1)."""
SAME_BADNESS = 0.02
"""A family is helped or harmed where the mean badness of its scenes differs by more than this."""


@dataclass(frozen=True)
class Trial:
    """The analysis without some rules, named on the page, beside that of another trial."""

    name: str
    kind: str
    without: tuple[str, ...]
    beside: str

    @property
    def folder(self) -> str:
        """Where its runs are kept, below ``--out``."""
        return f"{self.kind}_{self.name}".replace(" ", "_")


def trials_of(kinds: Sequence[str]) -> list[Trial]:
    """The trials of some kinds, and those that they are held against."""
    trials = [Trial(EVERY, "reference", (), EVERY), Trial(NONE_OF_THEM, "reference", tuple(RULES), EVERY)]
    if "one-out" in kinds:
        trials += [Trial(name, "one-out", (name,), EVERY) for name in RULES]
    if "group-out" in kinds:
        trials += [Trial(group, "group-out", names, EVERY) for group, names in GROUPS.items()]
    if "add-one" in kinds:
        others = {name: tuple(other for other in RULES if other != name) for name in RULES}
        trials += [Trial(name, "add-one", without, NONE_OF_THEM) for name, without in others.items()]
    return trials


@dataclass(frozen=True)
class Difference:
    """What a rule earns in one figure, better being positive, and its spread over scenes (paired bootstrap)."""

    value: float
    lo: float
    hi: float

    @property
    def is_sure(self) -> bool:
        """Whether nearly all draws of scenes agree on its sign."""
        return self.lo > 0.0 or self.hi < 0.0


def earned(with_it: Figures, without: Figures, name: str, sign: float) -> Difference:
    """The figure with a rule less that without it, over the same scenes and the same draws of them."""
    chosen = np.ones(len(with_it.scores), dtype=bool)
    value = sign * (with_it.over(chosen)[name].value - without.over(chosen)[name].value)
    return _difference(value, sign * (with_it.drawn(name, chosen) - without.drawn(name, chosen)))


def earned_badness(with_it: Sequence[SceneScore], without: Sequence[SceneScore]) -> Difference:
    """By how much a rule makes scenes less bad, in the mean."""
    gain = _gains(with_it, without)
    return _difference(float(gain.mean()), draws_of(len(gain)) @ gain / len(gain))


def families_changed(with_it: Sequence[SceneScore], without: Sequence[SceneScore]) -> tuple[int, int]:
    """How many families a rule helps, and how many it harms."""
    gain = _gains(with_it, without)
    family = np.array([one.facts["family"] for one in with_it])
    means = np.array([gain[family == name].mean() for name in dict.fromkeys(family)])
    return int((means > SAME_BADNESS).sum()), int((means < -SAME_BADNESS).sum())


def _gains(with_it: Sequence[SceneScore], without: Sequence[SceneScore]) -> Floats:
    return np.array([badness(b) - badness(a) for a, b in zip(with_it, without, strict=True)])


def _difference(value: float, drawn: Floats) -> Difference:
    drawn = drawn[np.isfinite(drawn)]
    lo, hi = np.percentile(drawn, SPREAD) if len(drawn) else (np.nan, np.nan)
    return Difference(value, float(lo), float(hi))


def shown(difference: Difference, scale: float = 1.0) -> str:
    """With its sign; bold where it is sure. A dash where there is nothing to judge, 0 where nothing changes."""
    if not np.isfinite(difference.value):
        return "–"
    if difference.value == difference.lo == difference.hi == 0.0:
        return "0"

    def signed(value: float) -> str:
        return f"{'+' if value > 0 else '−' if value < 0 else ''}{number(abs(scale * value))}"

    text = f"{signed(difference.value)} ({signed(difference.lo)} to {signed(difference.hi)})"
    return f"**{text}**" if difference.is_sure else text


def tasks_of(arguments: argparse.Namespace, trial: Trial) -> list[Task]:
    """The scenes of a trial: tables of tracks of all families, seed by seed, and rendered ones of some."""
    out, pictures = arguments.out / trial.folder, arguments.pictures
    told = [name for name, family in FAMILIES.items() if family.expected_status is None]
    names = in_turn(arguments.families or told)
    drawn = [(name, seed) for seed in arguments.seeds for name in names]
    return [
        Task(name, seed, kind, out / kind, pictures / kind, without=trial.without)
        for kind, n in (("tracks", arguments.n), ("video", arguments.rendered))
        for name, seed in [(name, seed) for name, seed in drawn if kind in FAMILIES[name].kinds][:n]
    ]


def measured(arguments: argparse.Namespace, trials: Sequence[Trial]) -> Iterator[tuple[Trial, list[SceneScore]]]:
    """The scores of each trial, all trials of a scene side by side in time."""
    tasks = {trial: tasks_of(arguments, trial) for trial in trials}
    # Scene by scene: what is stopped early has all trials of some scenes.
    in_turn = [task for of_scene in zip(*tasks.values(), strict=True) for task in of_scene]
    for count, done in enumerate(run_all(in_turn, arguments.jobs, do), 1):
        if not done.is_old:
            said = f"{done.task.out.parent.name} {done.task.family}:{done.task.seed}  {done.run['seconds']:.1f} s"
            print(f"{count:5}/{len(in_turn)}  {said}", flush=True)
    for trial, of_trial in tasks.items():
        yield trial, [score(task.folder) for task in of_trial]


def report_trials(report: Report, scores: dict[Trial, list[SceneScore]]) -> None:
    """A table for each kind of trial; only scenes with a result in all of the two trials that are compared count."""
    of_name = {trial.name: kept for trial, kept in scores.items() if trial.kind == "reference"}
    titles = {
        "reference": "All of them together",
        "one-out": "Without one rule",
        "group-out": "Without a group of rules",
        "add-one": "One rule alone",
    }
    header = ["rule", "lines", "badness", *(name for _, name, _, _ in FIGURES), "families helped", "harmed"]
    for kind, title in titles.items():
        rows = []
        for trial, own in scores.items():
            if trial.kind != kind or (kind == "reference" and trial.name == EVERY):
                continue
            other = of_name[trial.beside]
            first, second = (own, other) if kind == "add-one" else (other, own)
            both = [
                (a, b) for a, b in zip(first, second, strict=True) if not (a.facts["exit_code"] or b.facts["exit_code"])
            ]
            rows.append([trial.name, str(lines_of(trial)), *_cells([a for a, _ in both], [b for _, b in both])])
        if rows:
            report.heading(title)
            report.table(header, rows)
    failed = [f"{trial.folder} {one.name}" for trial, own in scores.items() for one in own if one.facts["exit_code"]]
    if failed:
        report.say(f"Without a result, and left out of the two that are compared: {', '.join(failed)}.")


def lines_of(trial: Trial) -> int:
    """Lines that the rules of a trial cost; a file that several rules stand in counts once."""
    names = (trial.name,) if trial.kind == "add-one" else trial.without
    files = {file: replace(RULES[name], files=(file,)).n_lines for name in names for file in RULES[name].files}
    return sum(files.values())


def _cells(with_it: list[SceneScore], without: list[SceneScore]) -> list[str]:
    if not with_it:
        return ["–"] * (len(FIGURES) + 3)
    one, other = Figures(with_it), Figures(without)
    helped, harmed = families_changed(with_it, without)
    figures = [shown(earned(one, other, name, sign), scale) for name, _, scale, sign in FIGURES]
    return [shown(earned_badness(with_it, without)), *figures, str(helped), str(harmed)]


def report_drives(report: Report, arguments: argparse.Namespace, trials: Sequence[Trial]) -> None:
    """Warnings in the real drives without a collision, trial by trial: all of them are false.

    Not with one rule alone: nobody would use such an analysis.
    """
    trials = [trial for trial in trials if trial.kind != "add-one"]
    drives = [clip for clip in CLIPS if clip.name in DASHCAM and clip.setting == "vehicle"]
    tasks = [
        ClipTask(clip, data_folder(), arguments.out / trial.folder / "real", trial.without)
        for trial in trials
        for clip in drives
    ]
    n_warnings = dict.fromkeys(tasks, 0)
    for done in run_all(tasks, arguments.jobs, do_clip):
        n_warnings[done.task] = -1 if done.error else len(done.run().events)
    report.heading("Warnings in the real drives, all of them false")
    rows = []
    for k, trial in enumerate(trials):
        own = [n_warnings[task] for task in tasks[k * len(drives) : (k + 1) * len(drives)]]
        rows.append([trial.kind, trial.name, *("no result" if n < 0 else str(n) for n in own)])
    report.table(["trial", "rule", *(clip.name for clip in drives)], rows)


def main() -> None:
    """Run the trials and print what each rule earns."""
    arguments = _arguments()
    trials = trials_of(arguments.trials)
    scores = dict(measured(arguments, trials))
    report = Report()
    _explain(report, scores)
    report_trials(report, scores)
    report.heading("What the rules are")
    rows = [[name, rule.group, rule.title, " ".join(rule.files)] for name, rule in RULES.items()]
    report.table(["rule", "group", "what it is for", "files"], rows)
    if arguments.real:
        report_drives(report, arguments, trials)
    if arguments.write_docs:
        report.write_docs("ablation.md", "What each rule earns")


def _explain(report: Report, scores: dict[Trial, list[SceneScore]]) -> None:
    first = next(iter(scores.values()))
    n_tables = sum(one.facts["kind"] == "tracks" for one in first)
    n_families = len({one.facts["family"] for one in first})
    report.say(
        f"Run on {n_tables} tables of point tracks and {len(first) - n_tables} rendered scenes of {n_families} "
        f"families, {len(scores)} trials each. A figure is what the rule earns, better being positive: with it less "
        f"without it, over the same scenes; in brackets {SPREAD[0]:g} to {SPREAD[1]:g} % of 200 draws of whole scenes "
        "(paired bootstrap), bold where they agree on the sign. Badness adds up share missed, median error of ttc_z, "
        "false objects a frame, wrong labels, a late or missing warning and false warnings, each up to 1 "
        f"([scenarios](scenarios.md)). A family is helped or harmed by more than {SAME_BADNESS:g} of it. "
        "So few scenes say what a rule is for; they do not say that one without effect here has none anywhere."
    )


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=lambda text: text.split(","), default=list(TRIALS), help="kinds of trials")
    parser.add_argument("--families", type=lambda text: text.split(","), help="names, with commas between them")
    parser.add_argument("--seeds", type=_seeds, default=range(2), help="A-B, both included")
    parser.add_argument("--n", type=int, default=104, help="tables of tracks, of each family in turn")
    parser.add_argument("--rendered", type=int, default=12, help="rendered scenes, of each family in turn")
    parser.add_argument("--real", action="store_true", help="the real drives, too")
    parser.add_argument("--jobs", type=int, default=2, help="processes side by side")
    parser.add_argument("--out", type=Path, default=REPOSITORY / "out" / "ablation", help="where the folders belong")
    parser.add_argument("--pictures", type=Path, help="where truth is kept (default: pictures beside --out)")
    parser.add_argument("--write-docs", action="store_true", help="write docs/ablation.md")
    arguments = parser.parse_args()
    unknown = [kind for kind in arguments.trials if kind not in TRIALS]
    if unknown:
        parser.error(f"--trials {unknown[0]}: expected some of {', '.join(TRIALS)}")
    unknown = [name for name in arguments.families or [] if name not in FAMILIES]
    if unknown:
        parser.error(f"--families {unknown[0]}: no such family; expected some of {', '.join(FAMILIES)}")
    if arguments.pictures is None:
        arguments.pictures = arguments.out.with_name(f"{arguments.out.name}_pictures")
    return arguments


def _seeds(text: str) -> range:
    first, _, last = text.partition("-")
    return range(int(first), int(last or first) + 1)


if __name__ == "__main__":
    until_stopped(main)
