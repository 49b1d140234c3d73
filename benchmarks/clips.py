"""Every real clip analysed: are all outputs there and sound, and what stands in them?

python benchmarks/clips.py [--only NAME] [--keep FOLDER] [--check]

For the KT3DMoSeg track tables also the clustering error: a track's label is its most frequent cluster, matched one to
one to the groups given by hand; tracks of no cluster and of unmatched ones are errors.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
from clustering_error import clustering_error, label_of_tracks
from folder_checks import problems_of
from report import Bar, Report
from runs import TimedRun, analyze_command, analyzed, data_folder, shown

from ttcvid import Run

CLUSTERING_BAR_PERCENT = 12.0
"""For orientation: the bar of a later estimator, not checked here."""


@dataclass(frozen=True)
class Clip:
    """An input with the options that belong to it, both relative to the data folder."""

    name: str
    path: str
    options: tuple[str, ...]


CLIPS = (
    Clip(
        "kitti_sfnd_ttc",
        "kitti_sfnd_ttc/image_02",
        ("--camera", "kitti_sfnd_ttc/calib.txt", "--fps", "9.6525", "--platform", "vehicle"),
    ),
    Clip("solidWhiteRight", "driving_clips/solidWhiteRight.mp4", ("--platform", "vehicle")),
    Clip("street_multidir", "static_traffic/street_multidir_905f.mp4", ("--platform", "static")),
    Clip("V_AIRPLANE_041", "airborne/V_AIRPLANE_041.mp4", ("--platform", "free")),
    Clip("davis_car_shadow", "davis_car_shadow/JPEGImages/480p/car-shadow", ("--fps", "24")),
)
TABLE_OPTIONS = ("--camera", "kt3dmoseg/calib.txt", "--image-size", "1242x375", "--platform", "vehicle")


def clips(only: str | None) -> Iterator[Clip]:
    """The clips, then the track tables; those whose name contains ``only``."""
    tables = sorted((data_folder() / "kt3dmoseg").glob("*.tracks.parquet"))
    named = [
        Clip(path.name.removesuffix(".tracks.parquet"), f"kt3dmoseg/{path.name}", TABLE_OPTIONS) for path in tables
    ]
    return (clip for clip in (*CLIPS, *named) if only is None or only in clip.name)


def arguments_of(clip: Clip) -> list[str]:
    """The options with full paths."""
    data = data_folder()
    return [str(data / word) if word.endswith(".txt") else word for word in clip.options]


def row_of(name: str, done: TimedRun) -> list[str]:
    """What stands in an output folder, in one row of text."""
    run, frames = done.run, done.run.frames
    counts = run.manifest["counts"]
    nearest = run.manifest["nearest"]
    return [
        name,
        str(counts["frames"]),
        _counted(frames.status),
        f"{frames.n_tracks.median():.0f}",
        f"{counts['objects']}",
        f"{(frames.n_clusters - 1).clip(lower=0).mean():.1f}",
        f"{counts['events']}",
        "" if nearest is None else f"{nearest['ttc_z_s']:.2f}",
        f"{100 * run.collision_times.tcpa_s.notna().mean():.0f}",
        f"{done.wall_s:.1f}",
    ]


HEADER = [
    "clip",
    "frames",
    "status of frames",
    "tracks (median)",
    "objects",
    "objects a frame",
    "events",
    "least ttc_z, s",
    "tracks with times, %",
    "s",
]


def _counted(names: pd.Series) -> str:
    counts = names.value_counts()
    return ", ".join(f"{name} {count}" for name, count in counts.items() if count)


def error_of_groups(clip: Clip, run: Run) -> float | None:
    """Clustering error of a track table that has labels; None for other clips."""
    path = data_folder() / clip.path.replace(".tracks.", ".labels.")
    if ".labels." not in path.name:
        return None
    truth = pd.read_parquet(path).set_index("track_id").label
    found = label_of_tracks(run.collision_times).reindex(truth.index, fill_value=-1)
    return clustering_error(truth.to_numpy(), found.to_numpy())


def measure(report: Report, only: str | None = None, keep: Path | None = None) -> None:
    """Analyse all clips; a clip with an unsound output misses its bar."""
    rows, errors, problems = [], {}, {}
    report.heading("Real clips: every output written, decoded, and as the schema says")
    with tempfile.TemporaryDirectory() as temporary:
        folder = (keep or Path(temporary)).resolve()
        folder.mkdir(parents=True, exist_ok=True)
        for clip in clips(only):
            options = arguments_of(clip)
            report.command(shown(analyze_command(data_folder() / clip.path, Path(clip.name), options)))
            done = analyzed(data_folder() / clip.path, folder / clip.name, [*options, "--overwrite"])
            rows.append(row_of(clip.name, done))
            problems[clip.name] = problems_of(done.run)
            error = error_of_groups(clip, done.run)
            if error is not None:
                errors[clip.name] = error
    report.table(HEADER, rows)
    for name, found in problems.items():
        for problem in found:
            report.say(f"- {name}: {problem}")
    report.figure("clips with something wrong in their outputs", sum(map(bool, problems.values())), "", Bar(0.0))
    if errors:
        _report_errors(report, errors)


def _report_errors(report: Report, errors: dict[str, float]) -> None:
    report.heading("KT3DMoSeg: clustering error (for orientation)")
    report.table(["clip", "error, %"], [[name, f"{100 * error:.1f}"] for name, error in errors.items()])
    mean_percent = 100 * sum(errors.values()) / len(errors)
    report.figure(f"mean over {len(errors)} clips, to be brought to {CLUSTERING_BAR_PERCENT:g} %", mean_percent, "%")


def main() -> int:
    """Measure and print; with ``--check`` 1 when a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", metavar="NAME", help="clips whose name contains this")
    parser.add_argument("--keep", metavar="FOLDER", type=Path, help="leave the outputs here")
    parser.add_argument("--check", action="store_true", help="exit code 1 when a bar is missed")
    arguments = parser.parse_args()
    report = Report()
    measure(report, arguments.only, arguments.keep)
    return report.exit_code(arguments.check)


if __name__ == "__main__":
    sys.exit(main())
