"""Every special rule of the analysis on trial: what it earns over the scenario suite, and what it costs in lines.

python benchmarks/ablation.py [--families CCRs,CPNA-25] [--seeds 0-1] [--n 104] [--rendered 12] [--real]
                              [--trials one-out,group-out,add-one]
python benchmarks/ablation.py --write-docs                  # docs/ablation.md

Each scene is analysed with all rules, and again without one of them, without a group of them, without any, and with
one alone. The rules are switched off in this program's own processes (`scenario_suite.rules`). Where a rule never gives
anything else than what stands in its place, the analysis would be the same, and is not made again. What is complete
below --out is not done again; Ctrl-C, and it goes on where it was.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

# One thread of linear algebra in each process: set before numpy is loaded.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from real_clips.clips import ClipDone, ClipTask, do_clip
from real_clips.trials import CUTS, cut_clips, shares_of, table_clips, units_of
from real_clips.trials import FIGURES as REAL_FIGURES
from report import REPOSITORY, Report
from runs import data_folder, until_stopped
from scenario_suite.families import FAMILIES, in_turn
from scenario_suite.figures import SPREAD, Figures, Share, draws_of
from scenario_suite.page import badness, number
from scenario_suite.rules import GROUPS, RULES
from scenario_suite.running import Done, Task, do, run_all
from scenario_suite.scoring import SceneScore, score
from scenario_suite.seeds import commit_hash

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


def families_changed(with_it: Sequence[SceneScore], without: Sequence[SceneScore]) -> dict[str, float]:
    """By family, how much less bad a rule makes its scenes in the mean, largest gain first.

    Families that change by at most `SAME_BADNESS` are left out.
    """
    gain = _gains(with_it, without)
    family = np.array([one.facts["family"] for one in with_it])
    means = {str(name): float(gain[family == name].mean()) for name in np.unique(family)}
    changed = [name for name, value in means.items() if abs(value) > SAME_BADNESS]
    return {name: means[name] for name in sorted(changed, key=lambda name: -means[name])}


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
    watched = trial.kind == "reference"
    return [
        Task(name, seed, kind, out / kind, pictures / kind, without=trial.without, is_watched=watched)
        for kind, n in (("tracks", arguments.n), ("video", arguments.rendered))
        for name, seed in [(name, seed) for name, seed in drawn if kind in FAMILIES[name].kinds][:n]
    ]


def clip_tasks_of(arguments: argparse.Namespace, trial: Trial) -> list[ClipTask]:
    """The real tables and cuts of a trial. Of one rule alone the tables: nobody would use such an analysis."""
    if not arguments.real:
        return []
    data, out = data_folder(), arguments.out / trial.folder / "real"
    clips = table_clips(data) + ([] if trial.kind == "add-one" else cut_clips())
    return [ClipTask(clip, data, out, trial.without, trial.kind == "reference") for clip in clips]


T = TypeVar("T")
D = TypeVar("D")


def each_done(
    trials: Sequence[Trial],
    tasks_of: Callable[[Trial], list[T]],
    run: Callable[[list[T]], Iterator[D]],
    acting_of: Callable[[D], Collection[str]],
    place_of: Callable[[T | D], tuple[Any, ...]],
) -> dict[Trial, list[D]]:
    """What each task of each trial has become; that of the trial beside it where no rule that differs acts there."""
    by_place: dict[Trial, dict[tuple[Any, ...], D]] = {}
    references = [trial for trial in trials if trial.kind == "reference"]
    first = [(trial, task) for trial in references for task in tasks_of(trial)]
    for trial, done in _run_all(first, run, place_of):
        by_place.setdefault(trial, {})[place_of(done)] = done
    beside = {trial.name: trial for trial in references}
    wanted = []
    for trial in trials:
        if trial.kind == "reference":
            continue
        other = beside[trial.beside]
        differing = set(trial.without) ^ set(other.without)
        for task in tasks_of(trial):
            known = by_place[other][place_of(task)]
            if differing & set(acting_of(known)):
                wanted.append((trial, task))
            else:
                by_place.setdefault(trial, {})[place_of(task)] = known
    for trial, done in _run_all(wanted, run, place_of):
        by_place.setdefault(trial, {})[place_of(done)] = done
    return {trial: [by_place[trial][place_of(task)] for task in tasks_of(trial)] for trial in trials}


def _run_all(
    wanted: list[tuple[Trial, T]],
    run: Callable[[list[T]], Iterator[D]],
    place_of: Callable[[T | D], tuple[Any, ...]],
) -> Iterator[tuple[Trial, D]]:
    """Have tasks done; each with its trial."""
    trial_of = {(task.out, place_of(task)): trial for trial, task in wanted}
    for count, done in enumerate(run([task for _, task in wanted]), 1):
        trial = trial_of[done.task.out, place_of(done)]
        if not done.is_old:
            print(f"{count:5}/{len(wanted)}  {trial.folder}  {' '.join(map(str, place_of(done)))}", flush=True)
        yield trial, done


def scene_place(one: Task | Done) -> tuple[str, int, str | None]:
    """Which scene it is."""
    task = one.task if isinstance(one, Done) else one
    return task.family, task.seed, task.kind


def clip_place(one: ClipTask | ClipDone) -> tuple[str]:
    """Which clip it is."""
    return ((one.task if isinstance(one, ClipDone) else one).clip.name,)


def report_trials(
    report: Report, scores: dict[Trial, list[SceneScore]], clips: dict[Trial, list[ClipDone]], acts: dict[Trial, str]
) -> None:
    """A table for each kind of trial; only scenes with a result in all of the two trials that are compared count."""
    of_name = {trial.name: trial for trial in scores if trial.kind == "reference"}
    titles = {
        "reference": "All of them together",
        "one-out": "Without one rule",
        "group-out": "Without a group of rules",
        "add-one": "One rule alone",
    }
    header = ["rule", "lines", "acts in", "badness", *(name for _, name, _, _ in FIGURES), "families helped", "harmed"]
    for kind, title in titles.items():
        rows, family_rows, real_rows = list[list[str]](), list[list[str]](), list[list[str]]()
        for trial in scores:
            if trial.kind != kind or (kind == "reference" and trial.name == EVERY):
                continue
            # Which has the rules that the other one lacks.
            with_it, without = (trial, of_name[trial.beside]) if kind == "add-one" else (of_name[trial.beside], trial)
            both = [
                (a, b)
                for a, b in zip(scores[with_it], scores[without], strict=True)
                if not (a.facts["exit_code"] or b.facts["exit_code"])
            ]
            name, changed = [trial.name, str(lines_of(trial)), acts[trial]], dict[str, float]()
            if both:
                changed = families_changed([a for a, _ in both], [b for _, b in both])
            rows.append([*name, *_cells([a for a, _ in both], [b for _, b in both], changed)])
            family_rows.append([trial.name, *_named(changed)])
            if clips:
                real_rows.append([*name[:2], *_real_cells(clips[with_it], clips[without])])
        if rows:
            report.heading(title)
            report.table(header, rows)
        if kind == "one-out" and family_rows:
            own = scores[of_name[EVERY]]
            n_each = len(own) / len({one.facts["family"] for one in own})
            report.say(
                f"Which families, and how much less bad the rule makes them. There are {n_each:.1f} scenes a family: a "
                f"warning that one of them gains or loses counts {1.0 / n_each:.2f}."
            )
            report.table(["rule", "helped", "harmed"], family_rows)
        if real_rows:
            report.say("The same on real clips:")
            report.table(["rule", "lines", *(name for _, name, _, _ in REAL_FIGURES)], real_rows)
    failed = [f"{trial.folder} {one.name}" for trial, own in scores.items() for one in own if one.facts["exit_code"]]
    failed += [
        f"{trial.folder} {one.task.clip.name}" for trial, own in clips.items() for one in own if one.error is not None
    ]
    if failed:
        report.say(f"Without a result, and left out of the two that are compared: {', '.join(dict.fromkeys(failed))}.")


def lines_of(trial: Trial) -> int:
    """Lines that the rules of a trial cost; a file that several rules stand in counts once."""
    names = (trial.name,) if trial.kind == "add-one" else trial.without
    files = {file: replace(RULES[name], files=(file,)).n_lines for name in names for file in RULES[name].files}
    return sum(files.values()) + sum(RULES[name].n_lines for name in names if not RULES[name].files)


def _cells(with_it: list[SceneScore], without: list[SceneScore], changed: dict[str, float]) -> list[str]:
    if not with_it:
        return ["–"] * (len(FIGURES) + 3)
    one, other = Figures(with_it), Figures(without)
    n_helped = sum(gain > 0.0 for gain in changed.values())
    figures = [shown(earned(one, other, name, sign), scale) for name, _, scale, sign in FIGURES]
    return [shown(earned_badness(with_it, without)), *figures, str(n_helped), str(len(changed) - n_helped)]


def _named(changed: dict[str, float]) -> tuple[str, str]:
    """The families that a rule helps, with by how much, and those that it harms, most first."""
    helped = [f"{name} +{gain:.2f}" for name, gain in changed.items() if gain > 0.0]
    harmed = [f"{name} −{-gain:.2f}" for name, gain in reversed(changed.items()) if gain < 0.0]
    return ", ".join(helped) or "–", ", ".join(harmed) or "–"


def _real_cells(with_it: Sequence[ClipDone], without: Sequence[ClipDone]) -> list[str]:
    """As `_cells`, of real clips: the bootstrap draws tables, frames with boxes and windows of a second."""
    # Of one rule alone there are the tables only.
    other = {clip_place(one): one for one in without}
    first = {clip_place(one): one for one in with_it}
    both = [
        (first[place], other[place])
        for place in first
        if place in other and first[place].error is None and other[place].error is None
    ]
    one, two = (shares_of([unit for pair in both for unit in units_of(pair[k])]) for k in (0, 1))
    return [
        shown(earned_share(one[name], two[name], sign), scale) if name in one and name in two else "–"
        for name, _, scale, sign in REAL_FIGURES
    ]


def earned_share(with_it: Share, without: Share, sign: float) -> Difference:
    """A share with a rule less that without it, over the same units and the same draws of them."""
    units = np.arange(len(with_it.whole))
    draws = draws_of(len(units))
    value = sign * (with_it.value(units)[0] - without.value(units)[0])
    return _difference(value, sign * (with_it.drawn(units, draws) - without.drawn(units, draws)))


def main() -> None:
    """Run the trials and print what each rule earns."""
    arguments = _arguments()
    trials = trials_of(arguments.trials)
    start_s = time.perf_counter()
    done = each_done(
        trials,
        partial(tasks_of, arguments),
        lambda tasks: run_all(tasks, arguments.jobs, do),
        lambda one: one.run["acting"],
        scene_place,
    )
    scores = {trial: [score(one.folder) for one in own] for trial, own in done.items()}
    clips: dict[Trial, list[ClipDone]] = {}
    if arguments.real:
        clips = each_done(
            trials,
            partial(clip_tasks_of, arguments),
            lambda tasks: run_all(tasks, arguments.jobs, do_clip),
            lambda one: one.acting,
            clip_place,
        )
    print(f"{time.perf_counter() - start_s:.0f} s")
    report = Report()
    report.say(f"Analysed by the code of commit {commit_hash('HEAD')[:12]}.")
    _explain(report, scores, clips)
    report_trials(report, scores, clips, {trial: _acts(trial, done) for trial in trials})
    report.heading("What the rules are")
    rows = [[name, rule.group, rule.title, " ".join(rule.files)] for name, rule in RULES.items()]
    report.table(["rule", "group", "what it is for", "files"], rows)
    if arguments.write_docs:
        report.write_docs("ablation.md", "What each rule earns")


def _acts(trial: Trial, done: dict[Trial, list[Done]]) -> str:
    """In how many scenes one of the rules of a trial acts, of all."""
    (beside,) = (other for other in done if other.kind == "reference" and other.name == trial.beside)
    differing = set(trial.without) ^ set(beside.without)
    acting = [bool(differing & set(one.run["acting"])) for one in done[beside]]
    return f"{sum(acting)} of {len(acting)}"


def _explain(report: Report, scores: dict[Trial, list[SceneScore]], clips: dict[Trial, list[ClipDone]]) -> None:
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
        "A rule acts in a scene if it gives there, once at least, something else than nothing; in the others the "
        "analysis is the same without it. "
        "So few scenes say what a rule is for; they do not say that one without effect here has none anywhere."
    )
    if clips:
        real = next(iter(clips.values()))
        cuts = [one for one in real if one.task.clip.setting != "tracks"]
        names = ", ".join(f"{one.task.clip.name} {'-'.join(map(str, CUTS[one.task.clip.name]))}" for one in cuts)
        report.say(
            f"Real clips: {len(real) - len(cuts)} tables of KT3DMoSeg, with groups given by hand, and {len(cuts)} cuts "
            f"(frames: {names}), of which boxes drawn by eye are counted and, since nothing collides, every warning is "
            "a false one. Brackets: draws of tables, of frames with boxes, of windows of a second. Cuts are left out "
            "where one rule is alone."
        )


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=lambda text: text.split(","), default=list(TRIALS), help="kinds of trials")
    parser.add_argument("--families", type=lambda text: text.split(","), help="names, with commas between them")
    parser.add_argument("--seeds", type=_seeds, default=range(2), help="A-B, both included")
    parser.add_argument("--n", type=int, default=104, help="tables of tracks, of each family in turn")
    parser.add_argument("--rendered", type=int, default=12, help="rendered scenes, of each family in turn")
    parser.add_argument("--real", action="store_true", help="real tables of tracks and cuts of clips, too")
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
