"""How accurate the analysis is: every scene with its exact truth, and every real clip that has a truth, in one table.

python benchmarks/accuracy.py [--only NAME] [--keep FOLDER] [--write-docs] [--check]

Each scene of ``sample_configs/scenes`` is rendered, analysed with its own camera, and evaluated; each real clip is
analysed and held against its truth (benchmarks/truths.py). What each column means stands in docs/evaluation.md.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from report import REPOSITORY, Bar, Report
from runs import TTCVID, analyze_command, data_folder, shown, timed
from truths import Figure, Judged, RealClip, judge_bodies, real_clips

from ttcvid import Run, evaluate
from ttcvid.studies.evaluation.metrics import Value
from ttcvid.studies.evaluation.wording import describe_value

SCENES = REPOSITORY / "sample_configs" / "scenes"
PLATFORMS = {
    "aircraft_head_on": "aircraft",
    "aircraft_passing": "aircraft",
    "drone_among_posts": "free",
    "resting_six_movers": "static",
}
"""What carries the camera; all other scenes are drives."""
CLUSTERING_BAR = Bar(8.0)
COLUMNS: dict[str, tuple[str, ...]] = {
    "objects found": ("objects.found", "objects.total"),
    "in frames": ("objects.share",),
    "one id": ("objects.one_id",),
    "false": ("objects.false",),
    "ttc_z median": ("ttc_z.median",),
    "p90": ("ttc_z.p90",),
    "bias": ("ttc_z.bias",),
    "value": ("ttc_z.share",),
    "90 % hold": ("ttc_z.coverage",),
    "tcpa median": ("tcpa.median",),
    "miss median": ("miss.median",),
    "scene dir": ("epipole_scene.median",),
    "object dir": ("epipole_objects.median",),
    "rotation": ("rotation.median",),
    "tracks right": ("tracks.right",),
    "on objects": ("tracks.objects_right",),
    "warned": ("events.true", "events.expected"),
    "ahead": ("events.lead_s",),
    "late": ("events.late",),
    "false warnings": ("events.false",),
}
"""Header and metrics (two: the first of the second)."""


def row_of(name: str, metrics: Mapping[str, Value], own_measure: str = "-") -> list[str]:
    """One row of the table; ``-`` where the truth says nothing."""
    return [name, *(cell(metrics, names) for names in COLUMNS.values()), own_measure]


def _shown(figure: Figure) -> str:
    return f"{figure.name} {figure.value:.3g} {figure.unit}".rstrip()


def cell(metrics: Mapping[str, Value], names: tuple[str, ...]) -> str:
    """One metric, or two as ``first of second``; ``-`` where there is no value."""
    values = [describe_value(name, metrics[name]).removesuffix(" deg") for name in names]
    return "-" if "-" in values else " of ".join(values)


def judged_scene(path: Path, folder: Path) -> list[str]:
    """Render, analyse and evaluate a scene; its row."""
    scene, run = folder / path.stem, folder / f"{path.stem}_run"
    options = ["--camera", str(scene / "camera.yaml"), "--platform", PLATFORMS.get(path.stem, "vehicle")]
    timed([str(TTCVID), "simulate", str(path), "-q", "--overwrite", "-o", str(scene)], folder)
    _analyze(scene / "clip.mp4", run, options, folder)
    return row_of(path.stem, evaluate(run, scene).evaluation.metrics)


def judged_clip(clip: RealClip, folder: Path) -> Judged:
    """Analyse a real clip and hold it against its truth."""
    run = folder / f"{clip.name}_run"
    _analyze(data_folder() / clip.path, run, clip.arguments(), folder)
    return clip.judge(Run.open(run))


def _analyze(input_: Path, out: Path, options: list[str], folder: Path) -> None:
    timed([*analyze_command(input_, out, options), "--no-overlay", "--overwrite"], folder)


def measure(report: Report, only: str | None = None, keep: Path | None = None) -> None:
    """Everything whose name contains ``only``."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = (keep or Path(temporary)).resolve()
        folder.mkdir(parents=True, exist_ok=True)
        scenes = [path for path in sorted(SCENES.glob("*.yaml")) if _is_meant(path.stem, only)]
        clips = [clip for clip in real_clips() if _is_meant(clip.name, only)]
        rows = [judged_scene(path, folder) for path in scenes]
        judged = {clip.name: judged_clip(clip, folder) for clip in clips}
    rows += [row_of(name, found.evaluation.metrics, _shown(found.figures[0])) for name, found in judged.items()]
    report.heading("All scenes and clips")
    report.say("Directions and rotations in degrees; `-`: the truth says nothing of it, or there is no value.")
    report.table(["clip", *COLUMNS, "own measure"], rows)
    report.heading("Real clips, in the measures of their truths")
    for name, found in judged.items():
        for figure in found.figures:
            report.figure(f"{name}: {figure.name}", figure.value, figure.unit, figure.bar)
    errors = [judged[clip.name].figures[0].value for clip in clips if clip.judge is judge_bodies]
    if errors:
        report.figure(f"kt3dmoseg: mean over {len(errors)} clips", float(np.mean(errors)), "%", CLUSTERING_BAR)
    report.heading("How the runs were made")
    report.say("A scene NAME; its platform is vehicle unless said here:")
    report.command([f"ttcvid simulate {SCENES.relative_to(REPOSITORY)}/NAME.yaml -o NAME"])
    report.command(["ttcvid analyze NAME/clip.mp4 --camera NAME/camera.yaml --platform vehicle -o NAME_run"])
    report.command(["ttcvid evaluate NAME_run NAME"])
    report.say(", ".join(f"{name}: {platform}" for name, platform in PLATFORMS.items()))
    report.say("The real clips (their truths: benchmarks/truths.py):")
    for clip in clips:
        words = analyze_command(data_folder() / clip.path, Path(f"{clip.name}_run"), clip.arguments())
        report.command(shown(words))


def _is_meant(name: str, only: str | None) -> bool:
    return only is None or only in name


def main() -> int:
    """Measure and print; with ``--check`` 1 when a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", metavar="NAME", help="scenes and clips whose name contains this")
    parser.add_argument("--keep", metavar="FOLDER", type=Path, help="leave scenes and runs here")
    parser.add_argument("--write-docs", action="store_true", help="write docs/accuracy.md")
    parser.add_argument("--check", action="store_true", help="exit code 1 when a bar is missed")
    arguments = parser.parse_args()
    report = Report()
    measure(report, arguments.only, arguments.keep)
    if arguments.write_docs:
        report.write_docs("accuracy.md", "How accurate it is")
    return report.exit_code(arguments.check)


if __name__ == "__main__":
    sys.exit(main())
