"""How long it takes to compare two runs of 1000 frames, start of the interpreter included.

python benchmarks/compare_speed.py [--frames 1000] [--write-docs] [--check]

A simulated clip is repeated without encoding it again, as often as it takes, and analysed; the run is compared with
itself, with that of another seed, and with one from a camera file that is off by 2 %, in which every column is judged
and printed. Each figure is the best of three.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from memory import repeat_clip
from report import REPOSITORY, Bar, Report
from runs import TTCVID, analyze_command, timed

from ttcvid import Run

SCENE = REPOSITORY / "sample_configs" / "scenes" / "demo.yaml"
BAR_S = Bar(3.0)
N_FRAMES, N_REPEATS = 1000, 3
FOCAL_FACTOR = 1.02


def measure(report: Report, n_frames: int = N_FRAMES) -> None:
    """Render, analyse three times, and time the comparisons."""
    report.heading(f"Comparing two runs of {n_frames} frames")
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        runs = analyzed(folder, n_frames)
        n_rows = Run.open(runs["first"]).manifest["counts"]["track_rows"]
        report.say(f"{n_rows} track rows in the first run, {n_rows / n_frames:.0f} a frame.")
        for name in ("first", "seed", "focal"):
            words = [str(TTCVID), "compare", str(runs["first"]), str(runs[name])]
            report.command([word.replace(str(folder), "runs").replace(str(TTCVID), "ttcvid") for word in words])
            wall_s, verdict = best_time(words)
            report.figure(f"{NAMES[name]} ({verdict})", wall_s, "s", BAR_S)


NAMES = {"first": "with itself", "seed": "with another seed", "focal": "with a focal length off by 2 %"}


def analyzed(folder: Path, n_frames: int) -> dict[str, Path]:
    """The runs to compare, by name."""
    scene, clip = folder / "scene", folder / "long.mp4"
    timed([str(TTCVID), "simulate", str(SCENE), "-q", "-o", str(scene)], folder)
    repeat_clip(scene / "clip.mp4", clip, n_frames)
    lines = (scene / "camera.yaml").read_text().splitlines()
    (scene / "off.yaml").write_text("\n".join(map(focal_off, lines)) + "\n")
    options = ["--platform", "vehicle", "--end", str(n_frames), "--no-overlay"]
    own = {"first": ["camera.yaml", "0"], "seed": ["camera.yaml", "1"], "focal": ["off.yaml", "0"]}
    for name, (camera, seed) in own.items():
        words = analyze_command(clip, folder / name, [*options, "--camera", str(scene / camera), "--seed", seed])
        timed(words, folder)
    return {name: folder / name for name in own}


def focal_off(line: str) -> str:
    """A line of the camera file, its focal length off."""
    name, colon, value = line.partition(":")
    return f"{name}: {float(value) * FOCAL_FACTOR}" if name in ("fx_px", "fy_px") else name + colon + value


def best_time(words: list[str]) -> tuple[float, str]:
    """Wall-clock seconds of the fastest of some calls, and the verdict; anything but same or different ends here."""
    times_s = []
    for _ in range(N_REPEATS):
        start_s = time.perf_counter()
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        times_s.append(time.perf_counter() - start_s)
        if done.returncode not in (0, 1):
            raise SystemExit(f"{' '.join(words)}: exit code {done.returncode}: {done.stderr.strip()}")
    return min(times_s), done.stdout.strip().splitlines()[-1].partition(":")[0]


def main() -> int:
    """Measure and print; with ``--check`` 1 when a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=N_FRAMES)
    parser.add_argument("--write-docs", action="store_true", help="write docs/compare_speed.md")
    parser.add_argument("--check", action="store_true", help="exit code 1 when a bar is missed")
    arguments = parser.parse_args()
    report = Report()
    measure(report, arguments.frames)
    if arguments.write_docs:
        report.write_docs("compare_speed.md", "How fast comparisons are")
    return report.exit_code(arguments.check)


if __name__ == "__main__":
    sys.exit(main())
