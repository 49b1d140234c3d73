"""The scenario suite: scenes in the terms of the trade, drawn by family and seed, and analysed.

python benchmarks/scenarios.py [--families CCRs,CPNA-25 | --group static] [--kind tracks] [--n 60] [--seeds 0-9]
python benchmarks/scenarios.py --verdict HEAD --n 200       # seeds from the hash of a commit
python benchmarks/scenarios.py --sweep sensor_noise_grey    # one nuisance over its values, all others off
python benchmarks/scenarios.py --show CPNA-25:17            # draw one alone
python benchmarks/scenarios.py --verdict HEAD --write-docs  # docs/scenarios.md, from rendered scenes and track tables
python benchmarks/scenarios.py --list                       # the families

Folders are written below --out; what is complete there is not done again.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from dataclasses import replace
from pathlib import Path

# One thread of linear algebra in each process: set before numpy is loaded.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from real import analyzed_clips
from real_clips.judging import report_clips
from report import REPOSITORY, Report
from runs import data_place, until_stopped
from scenario_suite.drawing import drawn, input_of
from scenario_suite.families import FAMILIES, in_turn, scenario
from scenario_suite.nuisances import NUISANCES
from scenario_suite.page import write_page
from scenario_suite.running import Task, Took, do, options_of, run_all
from scenario_suite.scoring import score
from scenario_suite.seeds import BUILDING_SEEDS, commit_hash, verdict_seeds

MASTS = ["mast-crossing", "mast-along", "mast-junction", "mast-walkers"]
SWEPT = "sensor_noise_grey"
"""Of cameras at rest, how they do without any noise is told on the page: it has failed before."""
GROUPS = tuple(dict.fromkeys(family.group for family in FAMILIES.values()))


def main() -> None:
    """Draw and run what is asked for; a line a scene."""
    arguments = _arguments()
    if arguments.show:
        _show(arguments.show, arguments.kind, _pictures(arguments))
        return
    if arguments.list:
        for family in FAMILIES.values():
            print(f"{family.name:18} {family.group:14} {'/'.join(family.kinds):13} {family.title}")
        return
    tasks = _tasks(arguments)
    took = _done(tasks, arguments)
    if arguments.write_docs:
        _write_docs(tasks, took, arguments)


def _done(tasks: list[Task], arguments: argparse.Namespace) -> Took:
    """Have tasks done, and say a line of each."""
    start_s, n_old, n_failed, n_drawn = time.perf_counter(), 0, 0, 0
    for number, done in enumerate(run_all(tasks, arguments.jobs, do), 1):
        n_old, n_failed = n_old + done.is_old, n_failed + bool(done.run["exit_code"])
        n_drawn += done.drawing_s == 0.0
        said = "done before" if done.is_old else f"drawn {done.drawing_s:.1f} s, analysed {done.run['seconds']:.1f} s"
        error = f"  exit code {done.run['exit_code']}: {done.run['error']}" if done.run["exit_code"] else ""
        print(f"{number:4}/{len(tasks)} {done.task.family}:{done.task.seed}  {said}{error}", flush=True)
    took_s = time.perf_counter() - start_s
    counts = f"{n_old} done before, {n_failed} without a result"
    print(f"{len(tasks)} scenarios in {took_s:.0f} s, {counts}: {arguments.out}")
    return Took(len(tasks), n_old, took_s, n_drawn)


def _write_docs(tasks: list[Task], took: Took, arguments: argparse.Namespace) -> None:
    """The page, from the scenes asked for, as many tables of tracks as ``--tables``, and a sweep of cameras at rest.

    Scenes and tables are analysed once more with ``--smooth``.
    """
    as_tables = _beside(arguments, "tables", kind="tracks", n=arguments.tables)
    as_sweep = _beside(arguments, "sweep", families=MASTS, n=len(MASTS), sweep=SWEPT)
    tables, sweep = _tasks(as_tables), _tasks(as_sweep)
    tables_took = _done(tables, as_tables)
    smoothed = [_smoothed(task) for task in (*tasks, *tables)]
    _done(smoothed, arguments)
    _done(sweep, as_sweep)
    kinds_of_runs = ([*tasks, *tables], smoothed, sweep)
    scores, scores_smoothed, swept = ([score(task.folder) for task in some] for some in kinds_of_runs)
    report = Report()
    if arguments.verdict:
        seeds = f"from the hash of commit {commit_hash(arguments.verdict)[:12]}"
    else:
        seeds = "those for building, which rules may have been fitted to"
    report.say(f"Seeds: {seeds}. Analysed by the code of commit {commit_hash('HEAD')[:12]}.")
    report.say(
        f"Drawn, analysed and judged by {arguments.jobs} processes: {took.said('scenes', 60, 15)}; "
        f"{tables_took.said('tables of tracks', 1000, 10)}."
    )
    if data_place().is_dir():
        real_out = arguments.out.with_name(f"{arguments.out.name}_real")
        report_clips(report, analyzed_clips(real_out, arguments.jobs))
    else:
        report.say("Real clips: left out, because their folder ($TTCVID_DATA) is absent.")
    write_page(report, scores, scores_smoothed, swept, docs=REPOSITORY / "docs")
    report.write_docs("scenarios.md", "What the scenario suite says")


def _smoothed(task: Task) -> Task:
    """The same scene, analysed with the frames on both sides of each."""
    return replace(task, out=task.out.with_name(f"{task.out.name}_smooth"), options={"smooth": True})


def _beside(arguments: argparse.Namespace, name: str, **changes: object) -> argparse.Namespace:
    """The same arguments with some changed, and folders of their own."""
    folders = {"out": arguments.out, "pictures": _pictures(arguments)}
    own = {key: folder.with_name(f"{folder.name}_{name}") for key, folder in folders.items()}
    return argparse.Namespace(**vars(arguments) | own | changes)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--families", type=lambda text: text.split(","), help="names, with commas between them")
    parser.add_argument("--group", choices=GROUPS, help="all families of a group")
    parser.add_argument("--kind", choices=("video", "tracks"), help="instead of each family's own kind of input")
    parser.add_argument("--n", type=int, help="at most so many scenes, one of each family in turn")
    parser.add_argument("--seeds", type=_seed_range, help="A-B, both included (default 0-199, or as many as --n takes)")
    parser.add_argument("--verdict", nargs="?", const="HEAD", metavar="COMMIT", help="seeds from a commit's hash")
    parser.add_argument("--sweep", metavar="NUISANCE", help="one nuisance over its values, all others off")
    parser.add_argument("--show", metavar="FAMILY:SEED", help="draw one scene and say where it is")
    parser.add_argument("--list", action="store_true", help="the families, and what each is")
    parser.add_argument("--write-docs", action="store_true", help="write docs/scenarios.md from all that was asked for")
    parser.add_argument("--tables", type=int, default=1000, help="with --write-docs: scenes as tables of tracks")
    parser.add_argument("--jobs", type=int, default=2, help="processes side by side")
    parser.add_argument(
        "--out",
        type=Path,
        help="where the folders belong (default: out/scenarios, with --kind tracks out/scenarios_tracks)",
    )
    parser.add_argument("--pictures", type=Path, help="where truth is kept (default: pictures beside --out)")
    arguments = parser.parse_args()
    if arguments.out is None:
        arguments.out = REPOSITORY / "out" / ("scenarios_tracks" if arguments.kind == "tracks" else "scenarios")
    unknown = [name for name in arguments.families or [] if name not in FAMILIES]
    if unknown:
        parser.error(f"--families {unknown[0]}: no such family; expected some of {', '.join(FAMILIES)}")
    if arguments.verdict and arguments.seeds:
        parser.error("--verdict and --seeds exclude each other: a verdict has seeds of its own")
    if arguments.sweep and arguments.sweep not in NUISANCES[arguments.kind or "video"]:
        names = ", ".join(NUISANCES[arguments.kind or "video"])
        parser.error(f"--sweep {arguments.sweep}: no such nuisance; expected one of {names}")
    return arguments


def _seed_range(text: str) -> range:
    first, _, last = text.partition("-")
    return range(int(first), int(last or first) + 1)


def _pictures(arguments: argparse.Namespace) -> Path:
    return Path(arguments.pictures or arguments.out.with_name(f"{arguments.out.name}_pictures"))


def _tasks(arguments: argparse.Namespace) -> list[Task]:
    """Every scene that is asked for, seed by seed."""
    names = arguments.families or _all_families(arguments.group)
    kind = arguments.kind or ("video" if arguments.sweep else None)
    names = in_turn([name for name in names if kind is None or kind in FAMILIES[name].kinds])
    if not names:
        sys.exit(f"none of the families asked for is left (--kind {kind}): ask for others, or leave --kind out")
    if arguments.verdict:
        n_each = -(-(arguments.n or 200) // len(names))
        seeds = verdict_seeds(commit_hash(arguments.verdict), n_each)
    else:
        seeds = arguments.seeds or BUILDING_SEEDS
    chosen = [(name, seed) for seed in seeds for name in names][: arguments.n]
    pictures = _pictures(arguments)
    if not arguments.sweep:
        return [Task(name, seed, arguments.kind, arguments.out, pictures) for name, seed in chosen]
    values = NUISANCES[arguments.kind or "video"][arguments.sweep].sweep
    return [
        Task(
            name,
            seed,
            arguments.kind,
            arguments.out / f"{arguments.sweep}={value}",
            pictures / f"{arguments.sweep}={value}",
            {arguments.sweep: value},
        )
        for name, seed in chosen
        for value in values
    ]


def _all_families(group: str | None) -> list[str]:
    """Those of a group, or all; without the recorded ones, which is said, where there are no recordings."""
    names = [name for name, family in FAMILIES.items() if group in (None, family.group)]
    recorded = [name for name in names if FAMILIES[name].group == "recorded"]
    if recorded and not data_place().is_dir():
        print(f"left out without $TTCVID_DATA ({data_place()}): {', '.join(recorded)}", file=sys.stderr)
        return [name for name in names if name not in recorded]
    return names


def _show(name: str, kind: str | None, pictures: Path) -> None:
    family, _, seed = name.partition(":")
    if family not in FAMILIES or not seed.isdigit():
        sys.exit(f"--show {name}: expected FAMILY:SEED with one of the families {', '.join(FAMILIES)}")
    chosen = scenario(family, int(seed), kind)
    truth = drawn(chosen, pictures / family / seed)
    print(f"{chosen.name}: {FAMILIES[family].title}; {'collision' if chosen.is_collision else 'no collision'}")
    for key, value in chosen.nuisances.items():
        print(f"  {key} = {value}")
    options = " ".join(
        f"--{key.replace('_', '-')} {value}"
        for key, value in options_of(chosen, truth).items()
        if key not in ("overlay", "report")
    )
    print(f"open  {input_of(truth)}\nscene {truth / 'scene.yaml'}\nttcvid analyze {input_of(truth)} {options}")


if __name__ == "__main__":
    until_stopped(main)
