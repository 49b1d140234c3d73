"""Speed of a whole analysis against a bare loop of OpenCV and PyAV in the same run.

python benchmarks/speed.py [--clip CLIP] [--repeats 3] [--profile] [--check] [--write-docs]

The bare loop (bare_loop.py) and ``ttcvid analyze`` take turns, so that a machine that is slow for a while is slow for
both; the best of the repeats counts for each. Three times are told apart:
analysis: from opening the clip to the last row and picture, the manifest's ``analysis_s``;
job:      the same with the check that reads the finished overlay once more, the manifest's ``total_s``;
command:  wall-clock of the whole command, with the start of the interpreter and all imports.
The bar is on the job against the loop, neither with the start of its interpreter.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import memory
from report import Bar, Report
from runs import analyze_command, analyzed, data_folder, shown, timed
from stage_times import GEOMETRY, milliseconds_per_stage

from ttcvid import Run

TRACKERS = ("klt", "akaze")
RATIO_BARS = {"klt": Bar(1.5, at_least=True), "akaze": Bar(1.8, at_least=True)}
TRACKS_BAR = Bar(1000, at_least=True)
GEOMETRY_BAR, GEOMETRY_TRACKS = Bar(15.0), 1150
"""ms a frame at about 1000 tracks: KLT holds between 80 and 100 % of its ``max_tracks``."""
BARE_LOOP = Path(__file__).with_name("bare_loop.py")


@dataclass(frozen=True)
class Turn:
    """Frames/s of one turn of both programs, and the median number of points that each followed."""

    loop: float
    loop_command: float
    analysis: float
    job: float
    command: float
    loop_points: float
    tracks: float


def one_turn(clip: Path, options: list[str], tracker: str, folder: Path) -> Turn:
    """Run the bare loop, then the analysis."""
    text, loop_wall_s = timed(bare_command(clip, folder / "bare.mp4", tracker), folder)
    bare = json.loads(text)
    done = analyzed(clip, folder / "run", [*options, "--overwrite"])
    timings, n_frames = done.run.manifest["timings"], done.run.manifest["counts"]["frames"]
    return Turn(
        bare["frames"] / bare["loop_s"],
        bare["frames"] / loop_wall_s,
        n_frames / timings["analysis_s"],
        n_frames / timings["total_s"],
        n_frames / done.wall_s,
        bare["median_points"],
        tracks_with_flow(done.run),
    )


def tracks_with_flow(run: Run) -> float:
    """Median number of tracks a frame that were seen before: a corner of this frame has not been followed yet."""
    rows = run.collision_times
    counts = rows[rows.n_frames >= 2].groupby("frame").size()
    return float(counts.reindex(run.frames.frame, fill_value=0).iloc[1:].median())


def bare_command(clip: Path, out: Path, tracker: str) -> list[str]:
    """The command line of the bare loop."""
    return [sys.executable, str(BARE_LOOP), str(clip), str(out), "--tracker", tracker]


def measure(report: Report, clip: Path, camera: list[str], repeats: int) -> None:
    """Both trackers, each against its bare loop."""
    for tracker in TRACKERS:
        options = [*camera, "--platform", "vehicle", "--tracker", tracker]
        report.heading(f"Speed with {tracker}: best of {repeats}, taking turns")
        report.command(shown(bare_command(clip, Path("bare.mp4"), tracker)))
        report.command(shown(analyze_command(clip, Path("run"), options)))
        with tempfile.TemporaryDirectory() as folder:
            turns = [one_turn(clip, options, tracker, Path(folder)) for _ in range(repeats)]
        loop, job = max(t.loop for t in turns), max(t.job for t in turns)
        command, loop_command = max(t.command for t in turns), max(t.loop_command for t in turns)
        header = ["turn", "bare loop", "its command", "analysis", "job", "command (all in frames/s)"]
        fields = ("loop", "loop_command", "analysis", "job", "command")
        report.table(
            header,
            [[str(n + 1), *(f"{getattr(t, field):.1f}" for field in fields)] for n, t in enumerate(turns)],
        )
        report.figure(f"{tracker}: bare loop, {turns[0].loop_points:.0f} points (median)", loop, "frames/s")
        report.figure(f"{tracker}: job", job, "frames/s")
        report.figure(f"{tracker}: job over bare loop", job / loop, "x", RATIO_BARS[tracker])
        report.figure(f"{tracker}: command over command, interpreter start and imports in both", command / loop_command)
        report.figure(f"{tracker}: tracks a frame that were seen before (median)", turns[0].tracks, "", TRACKS_BAR)


def profile(report: Report, clip: Path, camera: Path) -> None:
    """Milliseconds of each stage in one thread, at the defaults and at about 1000 tracks."""
    report.heading("Where the time goes: processor milliseconds a frame, all in one thread")
    settings = {
        "klt": {"tracker": "klt"},
        f"klt, max_tracks {GEOMETRY_TRACKS}": {"tracker": "klt", "tracking": {"max_tracks": GEOMETRY_TRACKS}},
        "akaze": {"tracker": "akaze"},
    }
    rows, geometry_ms = [], {}
    for name, options in settings.items():
        stages_ms, n_tracks = milliseconds_per_stage(clip, camera=camera, platform="vehicle", **options)
        geometry_ms[name] = sum(stages_ms[stage] for stage in GEOMETRY)
        total_ms = sum(stages_ms.values())
        rows.append([name, f"{n_tracks:.0f}", *(f"{ms:.1f}" for ms in (*stages_ms.values(), total_ms))])
    report.table(["", "tracks", *stages_ms, "sum"], rows)
    report.figure(
        f"geometry ({', '.join(GEOMETRY)}) at about 1000 tracks",
        geometry_ms[f"klt, max_tracks {GEOMETRY_TRACKS}"],
        "ms a frame",
        GEOMETRY_BAR,
    )


def main() -> int:
    """Measure and print; with ``--check`` 1 when a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clip", type=Path, help="default: driving_clips/kitti_speed_300.mp4 with its camera")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--profile", action="store_true", help="milliseconds of each stage instead of the comparison")
    parser.add_argument("--check", action="store_true", help="exit code 1 when a bar is missed")
    parser.add_argument("--write-docs", action="store_true", help="memory, comparison and profile into docs/speed.md")
    arguments = parser.parse_args()
    report = Report()
    camera = None if arguments.clip else data_folder() / "kitti_sfnd_ttc" / "calib.txt"
    clip = arguments.clip.resolve() if arguments.clip else data_folder() / "driving_clips" / "kitti_speed_300.mp4"
    if arguments.write_docs:
        # First, while the process holds nothing else.
        memory.measure(report, clip, camera)
    if arguments.write_docs or not arguments.profile:
        measure(report, clip, ["--camera", str(camera)] if camera else [], arguments.repeats)
    if arguments.write_docs or arguments.profile:
        profile(report, clip, camera)
    if arguments.write_docs:
        report.write_docs("speed.md", "Speed and memory")
    return report.exit_code(arguments.check)


if __name__ == "__main__":
    sys.exit(main())
