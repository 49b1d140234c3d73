"""Memory of an analysis over 3000 frames: how much, and whether it grows.

python benchmarks/memory.py [--clip CLIP] [--frames 3000] [--check]

The clip is repeated without encoding it again, as often as it takes, and analysed from this process with tables
and overlay; after each frame the resident memory of all its processes is read.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import av
import numpy as np
from report import Bar, Report
from runs import data_folder

from ttcvid.jobs.analyze.run_analysis import run_analysis
from ttcvid.jobs.processes.memory import PeakMemory, resident_mb
from ttcvid.jobs.settings.configuration import configure_from_arguments

PEAK_BAR, GROWTH_BAR = Bar(500.0), Bar(20.0)
"""MB (10^6 bytes)."""
N_FRAMES, EARLY_FRAME = 3000, 500
SMOOTHING_FRAMES = 50
"""The figure at a frame is the median over the frames up to it: one reading depends on what waits in the queues."""


def repeat_clip(clip: Path, out: Path, n_frames: int) -> None:
    """Write a clip that shows ``clip`` again and again, at least ``n_frames`` frames of it, by copying its packets."""
    with av.open(str(clip)) as source:
        packets = [packet for packet in source.demux(source.streams.video[0]) if packet.pts is not None]
        times = np.sort([packet.pts for packet in packets])
        period = int(times[-1] - times[0] + np.median(np.diff(times)))
        with av.open(str(out), "w") as target:
            stream = target.add_stream_from_template(source.streams.video[0])
            for number in range(-(-n_frames // len(packets))):
                for packet in packets:
                    target.mux(_later(packet, number * period, stream))


def _later(packet: av.Packet, delay: int, stream: av.VideoStream) -> av.Packet:
    """A copy of a packet, ``delay`` ticks of its time base later: muxing changes the packet that it is given."""
    copy = av.Packet(bytes(packet))
    copy.pts, copy.dts, copy.time_base = packet.pts + delay, packet.dts + delay, packet.time_base
    copy.duration, copy.is_keyframe, copy.stream = packet.duration, packet.is_keyframe, stream
    return copy


def measure(report: Report, clip: Path, camera: Path | None, n_frames: int = N_FRAMES) -> None:
    """Analyse the repeated clip and say what memory it took."""
    report.heading(f"Memory over {n_frames} frames")
    report.command(["python", "benchmarks/memory.py", "--frames", str(n_frames)])
    options = {"platform": "vehicle", **({"camera": camera} if camera else {})}
    readings_mb: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        long_clip = Path(folder) / "long.mp4"
        repeat_clip(clip, long_clip, n_frames)
        with PeakMemory() as memory:
            run_analysis(
                str(long_clip),
                Path(folder) / "run",
                configure_from_arguments({**options, "end": n_frames}),
                on_frame=lambda done, total: readings_mb.append(resident_mb()),
            )
            peak_mb = memory.peak_mb
    early_mb, late_mb = (resident_at(readings_mb, frame) for frame in (EARLY_FRAME, len(readings_mb)))
    report.figure(f"resident memory at frame {EARLY_FRAME}", early_mb, "MB")
    report.figure(f"resident memory at frame {len(readings_mb)}", late_mb, "MB")
    report.figure("growth", late_mb - early_mb, "MB", GROWTH_BAR)
    report.figure("peak of its processes together", peak_mb, "MB", PEAK_BAR)


def resident_at(readings_mb: list[float], frame: int) -> float:
    """Median reading of the frames up to this one."""
    return float(np.median(readings_mb[max(0, frame - SMOOTHING_FRAMES) : frame]))


def main() -> int:
    """Measure and print; with ``--check`` 1 when a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clip", type=Path, help="default: driving_clips/kitti_speed_300.mp4 with its camera")
    parser.add_argument("--frames", type=int, default=N_FRAMES)
    parser.add_argument("--check", action="store_true", help="exit code 1 when a bar is missed")
    arguments = parser.parse_args()
    report = Report()
    camera = None if arguments.clip else data_folder() / "kitti_sfnd_ttc" / "calib.txt"
    clip = arguments.clip or data_folder() / "driving_clips" / "kitti_speed_300.mp4"
    measure(report, clip, camera, arguments.frames)
    return report.exit_code(arguments.check)


if __name__ == "__main__":
    sys.exit(main())
