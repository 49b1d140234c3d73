"""Hostile and damaged inputs: nothing false is told of them, nothing else is opened, nothing hangs."""

import json
import os
import subprocess
import sys
import threading
import tracemalloc
from collections.abc import Callable, Sequence
from fractions import Fraction
from multiprocessing.context import ForkProcess
from pathlib import Path

import av
import cv2
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from av.stream import Disposition
from copies_of_process import CommandInCopy
from moving_clips import FPS, approach, write_approaching_tracks, write_clip, write_frames

from ttcvid.calibration import read_mask
from ttcvid.cli.main import main
from ttcvid.errors import CalibrationError, InputError, UsageError
from ttcvid.jobs.analyze.run_analysis import analyze
from ttcvid.jobs.runs import provenance
from ttcvid.jobs.runs.provenance import digest_in_background
from ttcvid.jobs.runs.run import Run
from ttcvid.model import ImageSize
from ttcvid.plain_files import read_plain
from ttcvid.sources import open_source

SCENE = Path(__file__).resolve().parents[2] / "sample_configs" / "scenes" / "resting_six_movers.yaml"
NOT_UTF8 = os.fsdecode(b"caf\xe9")

TIMES_OF = """
import sys
from ttcvid.sources import open_source
for path in sys.argv[1:]:
    with open_source(path) as source:
        print([frame.t_s for frame in source], source.info.nominal_dt_s)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="MALLOC_PERTURB_ is glibc's")
def test_times_do_not_come_from_memory_that_is_free(tmp_path: Path) -> None:
    clips = [write_clip(tmp_path / name, approach(4)) for name in ("a.mp4", "a.mkv")]
    command = [sys.executable, "-c", TIMES_OF, *map(str, clips)]
    # glibc overwrites what is freed: of a stream that is read after its container was closed only nonsense is left
    environment = {**os.environ, "MALLOC_PERTURB_": "255"}
    printed = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=60).stdout
    assert printed == f"{[i / FPS for i in range(4)]} {1 / FPS}\n" * 2


def video(folder: Path) -> tuple[Path, dict[str, object]]:
    return write_clip(folder / "clip.mp4", approach(4)), {"focal_px": 300.0}


def pictures(folder: Path) -> tuple[Path, dict[str, object]]:
    return write_frames(folder / "frames", approach(4)), {"focal_px": 300.0, "fps": 10.0}


def tracks(folder: Path) -> tuple[Path, dict[str, object]]:
    return write_approaching_tracks(folder / "tracks.csv"), {"focal_px": 300.0, "image_size": "192x128"}


@pytest.mark.skipif(sys.platform != "linux", reason="names are bytes on Linux")
@pytest.mark.parametrize("make", [video, pictures, tracks], ids=lambda make: make.__name__)
def test_a_name_that_is_not_utf8_is_a_name_like_any_other(
    tmp_path: Path, make: Callable[[Path], tuple[Path, dict[str, object]]]
) -> None:
    made, options = make(tmp_path)
    input_ = made.rename(tmp_path / f"{NOT_UTF8}{made.suffix}")
    out = tmp_path / f"{NOT_UTF8}_ttc"
    run = analyze(input_, out, **options)
    assert run.state == "complete"
    again = Run.open(out)
    assert again.manifest["input"]["path"] == str(input_)
    assert len(again.frames) == again.manifest["counts"]["frames"]


@pytest.mark.skipif(sys.platform != "linux", reason="names are bytes on Linux")
def test_the_summary_prints_a_name_as_it_is(tmp_path: Path) -> None:
    table, _ = tracks(tmp_path)
    arguments = [str(table), "--image-size", "192x128", "--no-overlay", "-q", "-o", f"{NOT_UTF8}_ttc"]
    exit_code, printed, _ = CommandInCopy(tmp_path, "analyze", *arguments).ended(60.0)
    assert exit_code == 0
    assert os.fsencode(printed).startswith(b"caf\xe9_ttc: complete, 12 frames")


@pytest.mark.parametrize("error", [UnicodeEncodeError("utf-8", "x", 0, 1, "no"), MemoryError(), InputError("gone")])
def test_whatever_the_hash_thread_fails_of_is_raised_where_its_result_is_awaited(
    monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def fail(files: tuple[Path, ...]) -> None:
        raise error

    monkeypatch.setattr(provenance, "digest_of", fail)
    with pytest.raises(type(error)):
        digest_in_background(()).result(timeout=10)


@pytest.mark.parametrize("name", ["2026-11-24T13:05", "concat:a|b"])
def test_an_output_folder_may_have_any_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """FFmpeg takes what precedes a colon for a protocol."""
    monkeypatch.chdir(tmp_path)
    table, options = tracks(tmp_path)
    run = analyze(table.name, name, end=2, **options)
    assert run.overlay is not None
    assert run.overlay.stat().st_size == json.loads((Path(name) / "manifest.json").read_text())["files"]["overlay.mp4"]


PLAYLISTS = {
    "clip.m3u8": "#EXTM3U\n#EXT-X-TARGETDURATION:2\n#EXTINF:1,\nother.ts\n#EXT-X-ENDLIST\n",
    "clip.mp4": "ffconcat version 1.0\nfile other.ts\n",
    "clip.sdp": "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nt=0 0\nm=video 9 RTP/AVP 96\n",
    "clip.avi": '<?xml version="1.0"?>\n<MPD xmlns="urn:mpeg:dash:schema:mpd:2011"><Period><AdaptationSet>'
    "<Representation><BaseURL>other.ts</BaseURL></Representation></AdaptationSet></Period></MPD>\n",
}


@pytest.mark.parametrize("name", PLAYLISTS)
def test_a_list_of_other_files_is_no_clip(tmp_path: Path, name: str) -> None:
    """The manifest would hold the hash of the list, whatever the files in it are."""
    write_clip(tmp_path / "other.ts", approach(4))
    (tmp_path / name).write_text(PLAYLISTS[name])
    with pytest.raises(InputError, match=r"give the clip itself|expected a complete clip") as caught:
        open_source(str(tmp_path / name))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("input_", ["https://example.org/clip.mp4", "https:/example.org/clip.mp4", "rtsp://camera/1"])
def test_a_url_is_said_to_be_one(input_: str) -> None:
    with pytest.raises(InputError, match=f"^{input_}: URLs are not read: download"):
        open_source(input_)


@pytest.mark.parametrize("input_", ["x" * 5000, "x" * 5000 + "/*.png", "d/" * 3000 + "%06d.png"])
def test_a_name_too_long_is_one_short_line(input_: str) -> None:
    with pytest.raises(InputError, match="File name too long") as caught:
        open_source(input_)
    assert len(str(caught.value)) < 300


def write_streams(
    path: Path,
    streams: list[list[np.ndarray]],
    default: int | None = None,
    codec: str = "mjpeg",
    options: dict[str, str] | None = None,
    times: Sequence[int] | None = None,
) -> Path:
    """Video streams in one file, one of which may be marked as default; ``times`` of the pictures in steps of 1/FPS."""
    pixel_format = "yuvj420p" if codec == "mjpeg" else "yuv420p"
    with av.open(str(path), "w", options=options or {}) as container:
        made = []
        for pictures in streams:
            stream = container.add_stream(codec, rate=FPS)
            stream.height, stream.width = pictures[0].shape
            stream.pix_fmt = pixel_format
            stream.gop_size = 5
            stream.codec_context.time_base = Fraction(1, FPS)
            made.append(stream)
            if default is not None:
                stream.disposition = Disposition.default if len(made) - 1 == default else Disposition(0)
        for stream, pictures in zip(made, streams, strict=True):
            for index, grey in enumerate(pictures):
                frame = av.VideoFrame.from_ndarray(grey, format="gray").reformat(format=pixel_format)
                frame.pts, frame.time_base = times[index] if times else index, Fraction(1, FPS)
                container.mux(stream.encode(frame))
            container.mux(stream.encode(None))
    return path


COVER = [np.full((64, 64), 90, np.uint8)]


@pytest.mark.parametrize(
    ("streams", "default", "chosen"),
    [
        ([COVER, approach(4)], None, 1),
        ([COVER, approach(4)], 0, 1),
        ([approach(4), COVER], None, 0),
        ([COVER * 4, approach(4)], 1, 1),
        ([approach(4), COVER * 3], 0, 0),
    ],
)
def test_of_several_video_streams_a_long_one_is_analysed_and_that_is_said(
    tmp_path: Path, streams: list[list[np.ndarray]], default: int | None, chosen: int
) -> None:
    path = write_streams(tmp_path / "a.mkv", streams, default)
    with open_source(str(path)) as source:
        assert [frame.grey.shape for frame in source] == [streams[chosen][0].shape] * len(streams[chosen])
        assert f"holds 2 video streams: number {chosen} is analysed" in source.report.warnings[0]


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a folder in use cannot be removed")
@pytest.mark.parametrize("command", [["analyze", "{clip}"], ["simulate", "{scene}", "--frames", "1"]])
def test_a_working_folder_that_was_removed_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], command: list[str]
) -> None:
    places = {"{clip}": str(write_clip(tmp_path / "clip.mp4", approach(4))), "{scene}": str(SCENE)}
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    assert main([places.get(word, word) for word in command]) == 2
    assert "the working folder does not exist any more" in capsys.readouterr().err


def with_claim(jpeg: Path, width: int, height: int) -> None:
    """Let the header of a JPEG claim a size."""
    data = bytearray(jpeg.read_bytes())
    at = data.index(b"\xff\xc0")
    data[at + 5 : at + 9] = height.to_bytes(2, "big") + width.to_bytes(2, "big")
    jpeg.write_bytes(data)


def write_jpegs(folder: Path, n: int) -> list[Path]:
    folder.mkdir()
    pictures = [folder / f"{index}.jpg" for index in range(n)]
    for path, grey in zip(pictures, approach(n), strict=True):
        assert cv2.imwrite(str(path), grey)
    return pictures


@pytest.mark.parametrize("claimed", [(65500, 65500), (30000, 30000), (20000, 6000)])
def test_a_picture_that_claims_gigabytes_is_left_out_like_one_that_cannot_be_read(
    tmp_path: Path, claimed: tuple[int, int]
) -> None:
    with_claim(write_jpegs(tmp_path / "frames", 4)[1], *claimed)
    with open_source(str(tmp_path / "frames"), fps=FPS) as source:
        assert [frame.index for frame in source] == [0, 2, 3]
    assert (source.report.n_packets_skipped, source.report.is_truncated) == (1, False)
    assert "1 images cannot be read and are left out, 1.jpg is the first" in source.report.warnings[0]
    assert f"claims {claimed[0]}x{claimed[1]} px: raise --max-image-mpx" in source.report.warnings[0]


def test_the_limit_of_pictures_is_an_option(tmp_path: Path) -> None:
    write_jpegs(tmp_path / "frames", 2)
    with pytest.raises(InputError, match="192x128 px: raise --max-image-mpx"):
        analyze(tmp_path / "frames", tmp_path / "out", fps=FPS, focal_px=300.0, max_image_mpx=0.02)
    run = analyze(tmp_path / "frames", tmp_path / "out", fps=FPS, focal_px=300.0, max_image_mpx=0.025)
    assert run.manifest["counts"]["frames"] == 2


def test_a_mask_that_claims_another_size_is_not_decoded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mask = write_jpegs(tmp_path / "masks", 1)[0]
    with_claim(mask, 65500, 65500)
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("it was decoded"))
    with pytest.raises(CalibrationError, match="the mask is 65500x65500; expected 192x128"):
        read_mask(mask, ImageSize(192, 128))


def test_a_pipe_among_pictures_is_none(tmp_path: Path) -> None:
    write_frames(tmp_path / "frames", approach(3))
    os.mkfifo(tmp_path / "frames" / "000001b.png")
    with open_source(str(tmp_path / "frames"), fps=FPS) as source:
        assert len(source.files) == len(list(source)) == 3


@pytest.mark.parametrize("name", ["clip.webm", "clip.mkv"])
@pytest.mark.parametrize("hole", ["zeros", "noise", "cut out"])
def test_frames_that_are_gone_without_a_trace_are_counted(tmp_path: Path, name: str, hole: str) -> None:
    """A hole in a Matroska file is jumped over to its next cluster: nothing is left of it but a step in the times."""
    codec = "libvpx" if name == "clip.webm" else "mjpeg"
    path = write_streams(tmp_path / name, [approach(30)], codec=codec, options={"cluster_time_limit": "500"})
    data = path.read_bytes()
    begin, end = int(0.4 * len(data)), int(0.55 * len(data))
    filling = {"zeros": bytes(end - begin), "noise": np.random.default_rng(1).bytes(end - begin), "cut out": b""}[hole]
    path.write_bytes(data[:begin] + filling + data[end:])
    with open_source(str(path)) as source:
        n_read = len(list(source))
    assert n_read < 28
    assert source.report.n_frames_missing + source.report.n_packets_skipped + n_read == 30
    assert f"about {source.report.n_frames_missing} frames are missing" in source.report.warnings[0]


def test_an_uneven_clip_misses_nothing(tmp_path: Path) -> None:
    times = [0, 1, 2, 3, 40, 41, 42, 80, 81]
    path = write_streams(tmp_path / "clip.mkv", [approach(len(times))], times=times)
    with open_source(str(path)) as source:
        assert len(list(source)) == len(times)
    assert (source.report.n_frames_missing, source.report.warnings) == (0, ())


def test_frames_that_a_decoder_patches_up_are_counted_in_the_manifest(tmp_path: Path) -> None:
    path = write_clip(tmp_path / "clip.mp4", approach(12))
    with av.open(str(path)) as container:
        packet = list(container.demux(video=0))[5]  # a keyframe, of several slices
        begin, end = packet.pos + packet.size // 2, packet.pos + packet.size
    data = bytearray(path.read_bytes())
    data[begin:end] = b"\x55" * (end - begin)
    path.write_bytes(data)
    run = analyze(path, tmp_path / "out", focal_px=300.0, overlay=False)
    assert run.manifest["counts"]["corrupt_frames"] == 1
    assert run.manifest["counts"]["missing_frames"] == 0
    assert any(
        "1 frames are damaged, and analysed as the decoder patched them up" in w for w in run.manifest["warnings"]
    )


@pytest.mark.parametrize("stored", ["dictionary", "string"])
def test_a_long_text_that_occurs_often_is_read_once(tmp_path: Path, stored: str) -> None:
    """A file of some kilobytes: made text by text, its columns would have 20 GB."""
    n = 1000
    texts = pa.DictionaryArray.from_arrays(pa.array([0] * n, pa.int32()), pa.array(["9" * 20_000_000]))
    columns = {"frame": range(n), "t_s": np.arange(n) / 10, "x_px": np.full(n, 9.0), "y_px": np.full(n, 9.0)}
    table = pa.table({**{name: pa.array(values) for name, values in columns.items()}, "track_id": texts, "note": texts})
    path = tmp_path / "tracks.parquet"
    pq.write_table(table, path, compression="zstd", store_schema=stored == "dictionary")
    with pytest.raises(InputError, match=r"row 1: track_id is '9+\.\.\.9+'.*\(1000 such rows\)"):
        open_source(str(path), image_size=ImageSize(192, 128))


def test_numbers_written_as_texts_are_numbers(tmp_path: Path) -> None:
    table = pd.read_csv(write_approaching_tracks(tmp_path / "tracks.csv"))
    table.astype({"track_id": str, "x_px": str}).astype({"track_id": "category"}).to_parquet(tmp_path / "texts.parquet")
    with (
        open_source(str(tmp_path / "tracks.csv"), image_size=ImageSize(192, 128)) as plain,
        open_source(str(tmp_path / "texts.parquet"), image_size=ImageSize(192, 128)) as texts,
    ):
        for one, other in zip(plain, texts, strict=True):
            np.testing.assert_array_equal(one.points.xy_px, other.points.xy_px)
            np.testing.assert_array_equal(one.points.track_id, other.points.track_id)


@pytest.mark.parametrize("time_s", [1e300, -1e300, 1e12])
def test_a_time_that_is_none_is_refused(tmp_path: Path, time_s: float) -> None:
    table = pd.read_csv(write_approaching_tracks(tmp_path / "tracks.csv"))
    table.loc[table.frame == table.frame.max(), "t_s"] = time_s
    table.to_csv(tmp_path / "tracks.csv", index=False)
    with pytest.raises(InputError, match=r"t_s is -?1e\+(300|12) s: expected at most 1e\+11"):
        open_source(str(tmp_path / "tracks.csv"), image_size=ImageSize(192, 128))
    write_frames(tmp_path / "frames", approach(3))
    (tmp_path / "times.txt").write_text(f"0\n0.1\n{time_s}\n")
    with pytest.raises(InputError, match=r"times\.txt: the time is"):
        open_source(str(tmp_path / "frames"), timestamps=tmp_path / "times.txt")


def pipe(path: Path) -> Path:
    os.mkfifo(path)
    return path


def endless(path: Path) -> Path:
    path.symlink_to("/dev/zero")
    return path


def huge(path: Path) -> Path:
    """8 GB that take no place on the disk."""
    with path.open("wb") as file:
        file.truncate(8_000_000_000)
    return path


@pytest.mark.skipif(sys.platform != "linux", reason="pipes, devices and files without content of Linux")
@pytest.mark.parametrize("make", [pipe, endless, huge], ids=lambda make: make.__name__)
@pytest.mark.parametrize(
    ("option", "error"),
    [
        ("config", UsageError),
        ("timestamps", InputError),
        ("camera", CalibrationError),
        ("horizon", CalibrationError),
        ("mask", CalibrationError),
    ],
)
def test_a_file_that_never_ends_is_not_read(
    tmp_path: Path, make: Callable[[Path], Path], option: str, error: type[Exception]
) -> None:
    clip = write_frames(tmp_path / "frames", approach(2))
    given = {"fps": 10.0, "focal_px": 300.0, option: make(tmp_path / "file")}
    if option in ("timestamps", "camera"):
        del given["fps" if option == "timestamps" else "focal_px"]
    with pytest.raises(error) as caught:
        analyze(clip, tmp_path / "out", **given)
    assert str(tmp_path / "file") in str(caught.value)
    assert not (tmp_path / "out").exists()


def no_thread(self: object) -> None:
    raise RuntimeError("can't start new thread")


def no_process(self: object) -> None:
    raise BlockingIOError(11, "Resource temporarily unavailable")


@pytest.mark.parametrize(
    "refused", [(threading.Thread, no_thread), (ForkProcess, no_process)], ids=["thread", "process"]
)
@pytest.mark.usefixtures("geometry_in_a_process")
def test_too_few_threads_or_processes_are_not_the_fault_of_the_clip(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    refused: tuple[type, Callable[[object], None]],
) -> None:
    clip = write_clip(tmp_path / "clip.mp4", approach(4))
    monkeypatch.setattr(refused[0], "start", refused[1])
    assert main(["analyze", str(clip), "--focal-px", "300", "-o", str(tmp_path / "out")]) == 2
    message = capsys.readouterr().err.splitlines()[-1]
    assert "no further thread or process can be started" in message
    assert "ulimit -u" in message
    assert not (tmp_path / "out").exists()


def test_a_short_file_takes_little_memory_whatever_it_may_have(tmp_path: Path) -> None:
    (tmp_path / "short").write_bytes(b"x" * 100_000)
    tracemalloc.start()
    try:
        assert len(read_plain(tmp_path / "short", 2_000_000_000)) == 100_000
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()
    with pytest.raises(OSError, match=r"more than 0\.09 MB"):
        read_plain(tmp_path / "short", 90_000)
