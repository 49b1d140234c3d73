"""Two frames, three frames, whole tracks, and whole tracks from both sides: the same clips, side by side.

python benchmarks/estimators_side_by_side.py [--keep FOLDER] [--write-docs] [--check]

The car ahead of ``kitti_sfnd_ttc`` against lidar, and rendered scenes against their exact truth. What each column means
stands in docs/evaluation.md.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

import pandas as pd
from accuracy import PLATFORMS, SCENES, cell
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from report import REPOSITORY, Report
from runs import TTCVID, analyze_command, data_folder, shown, timed
from truths import Judged, RealClip, judge_lead_car, judge_smoothed_lead_car, real_clips

from ttcvid import Run, evaluate
from ttcvid.studies.collision_map.picture import write_figure
from ttcvid.studies.evaluation.metrics import Value

WAYS: dict[str, tuple[str, ...]] = {
    "two-frame": ("--estimator", "two-frame"),
    "three-frame": ("--estimator", "three-frame"),
    "multi-frame": (),
    "multi-frame --smooth": ("--smooth",),
}
"""What is compared, with its options."""
SHOWN_SCENES = ("crossing_collision", "demo", "lead_car_brakes", "resting_six_movers", "turning_jitter")
COLUMNS: dict[str, tuple[str, ...]] = {
    "in frames": ("objects.share",),
    "value": ("ttc_z.share",),
    "ttc_z median": ("ttc_z.median",),
    "p90": ("ttc_z.p90",),
    "bias": ("ttc_z.bias",),
    "90 % hold": ("ttc_z.coverage",),
    "half-width": ("ttc_z.half_width",),
    "tcpa median": ("tcpa.median",),
    "miss median": ("miss.median",),
    "object dir": ("epipole_objects.median",),
    "warned": ("events.true", "events.expected"),
    "false warnings": ("events.false",),
}
PICTURE = "estimators.png"
# Okabe and Ito's colours: told apart with any colour vision.
_COLOURS = ("#d55e00", "#e69f00", "#0072b2", "#009e73")
_LONGEST_S = 25.0


def rows_of(metrics: Mapping[str, Mapping[str, Value]]) -> list[list[str]]:
    """A row for each way; ``-`` where the truth says nothing, or there is no value."""
    return [[way, *(cell(found, names) for names in COLUMNS.values())] for way, found in metrics.items()]


def lead_car_picture(joined: Mapping[str, pd.DataFrame]) -> Figure:
    """A panel for each way: the estimate with its 90 % interval, and what lidar says.

    Parameters
    ----------
    joined : of each way the true and the found times of the frames (``Evaluation.joined``).
    """
    figure = Figure(figsize=(10.0, 6.4), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(2, 2, sharex=True, sharey=True).flat
    for axes, colour, (way, rows) in zip(panels, _COLOURS, joined.items(), strict=True):
        _panel(axes, rows.sort_values("t_s"), colour)
        axes.set_title(way, loc="left", fontsize=10)
    figure.supxlabel("time in the clip, s", fontsize=10)
    figure.supylabel("time until depth zero (ttc_z), s", fontsize=10)
    return figure


def _panel(axes: Axes, rows: pd.DataFrame, colour: str) -> None:
    t_s, low_s = rows.t_s.to_numpy(float), rows.ttc_z_lo_s_found.to_numpy(float)
    high_s = rows.ttc_z_hi_s_found.to_numpy(float)
    # An interval that runs through infinity (lo > hi) has no upper end; after a negative value only its lower one.
    upper_s = pd.Series(high_s).where(high_s >= low_s, 10.0 * _LONGEST_S).to_numpy()
    axes.fill_between(t_s, low_s, upper_s, color=colour, alpha=0.2, lw=0, label="90 % interval")
    axes.plot(t_s, rows.ttc_z_s_found.to_numpy(float), "o-", color=colour, ms=3, lw=1.2, label="estimate")
    axes.plot(t_s, rows.ttc_z_s.to_numpy(float), color="black", lw=1.4, label="lidar")
    axes.set_ylim(0.0, _LONGEST_S)
    axes.grid(True, color="#dddddd")
    axes.legend(frameon=False, fontsize=8.5, loc="upper right")


def measure_lead_car(report: Report, folder: Path) -> dict[str, Judged]:
    """The car ahead, in all ways."""
    clip = next(clip for clip in real_clips() if clip.judge is judge_lead_car)
    judged = {way: _judged_clip(clip, way, folder) for way in WAYS}
    report.heading("The car ahead, against lidar")
    report.say(
        "`kitti_sfnd_ttc`, frames 8 to 48: a car that creeps up to a red light, braking and letting go again. Lidar's "
        "own times are good to 5 to 10 %."
    )
    report.say(f"![The time of the car ahead over time, by each estimator and by lidar]({PICTURE})")
    names = [figure.name for figure in judged["multi-frame"].figures[:6]]
    rows = [[way, *(f"{f.value:.3g} {f.unit}" for f in found.figures[: len(names)])] for way, found in judged.items()]
    report.table(["estimator", *names], rows)
    for way in ("multi-frame", "multi-frame --smooth"):
        for figure in judged[way].figures[:2]:
            report.figure(f"{way}: {figure.name}", figure.value, figure.unit, figure.bar)
    report.command(shown(analyze_command(data_folder() / clip.path, Path("run"), clip.arguments())))
    return judged


def _judged_clip(clip: RealClip, way: str, folder: Path) -> Judged:
    run = _analyzed(data_folder() / clip.path, clip.arguments(), way, folder)
    return judge_smoothed_lead_car(run) if "--smooth" in WAYS[way] else clip.judge(run)


def measure_scene(report: Report, name: str, folder: Path) -> None:
    """A rendered scene, in all ways."""
    scene = folder / name
    timed([str(TTCVID), "simulate", str(SCENES / f"{name}.yaml"), "-q", "--overwrite", "-o", str(scene)], folder)
    options = ["--camera", str(scene / "camera.yaml"), "--platform", PLATFORMS.get(name, "vehicle")]
    runs = {way: _analyzed(scene / "clip.mp4", options, way, folder) for way in WAYS}
    metrics = {way: evaluate(run.folder, scene).evaluation.metrics for way, run in runs.items()}
    report.heading(f"Scene {name}")
    report.table(["estimator", *COLUMNS], rows_of(metrics))


def _analyzed(input_: Path, options: list[str], way: str, folder: Path) -> Run:
    out = folder / f"{input_.parent.name}_{way.replace(' --', '_')}_run"
    timed([*analyze_command(input_, out, [*options, *WAYS[way]]), "--no-overlay", "--overwrite"], folder)
    return Run.open(out)


def main() -> int:
    """Measure and print; with ``--check`` 1 when a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--keep", metavar="FOLDER", type=Path, help="leave scenes and runs here")
    parser.add_argument("--write-docs", action="store_true", help="write docs/estimators.md and its picture")
    parser.add_argument("--check", action="store_true", help="exit code 1 when a bar is missed")
    arguments = parser.parse_args()
    report = Report()
    report.say(
        "The same tracks, the same own rotation, the same objects: what differs is how many of a track's views make "
        "its time. `two-frame` and `three-frame` are the paper's, over a gap that grows until the flow is 8 px long; "
        "`multi-frame` takes all views of the last 20 frames that one motion explains; with `--smooth` these lie on "
        "both sides of the frame, and objects begin up to 10 frames before they are found (so there are more, and "
        "earlier, values to be judged). Warnings are made of the past alone, with `--smooth` too."
    )
    report.say(
        "What to expect: two views know little, and nothing old. Given the direction of an object (that of the "
        "velocity which its tracks share over 0.6 s) they follow what brakes near by, and fail where the flow is "
        "small beside its errors: the car ahead. They fail before what turns, too, or while we turn: that direction "
        "takes all ways for straight ones, and neither time nor interval knows (turning_jitter). Three views, each "
        "point with a direction of its own, are left to noise. Twenty views find the turn with the time; they are "
        "best where the flow is small, and lag where a velocity changes in a way that they cannot tell from noise; on "
        "both sides of the frame they do not lag."
    )
    with tempfile.TemporaryDirectory() as temporary:
        folder = (arguments.keep or Path(temporary)).resolve()
        folder.mkdir(parents=True, exist_ok=True)
        judged = measure_lead_car(report, folder)
        for name in SHOWN_SCENES:
            measure_scene(report, name, folder)
    report.heading("How the runs were made")
    report.say("A scene NAME as in [accuracy](accuracy.md#how-the-runs-were-made), each clip once with each of these:")
    report.table(["estimator", "options"], [[way, f"`{' '.join(words)}`"] for way, words in WAYS.items() if words])
    if arguments.write_docs:
        joined = {way: found.evaluation.joined for way, found in judged.items()}
        write_figure(lead_car_picture(joined), REPOSITORY / "docs" / PICTURE)
        report.write_docs("estimators.md", "The estimators side by side")
    return report.exit_code(arguments.check)


if __name__ == "__main__":
    sys.exit(main())
