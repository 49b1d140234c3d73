import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from ttcvid.errors import OutputError
from ttcvid.model import ImageSize
from ttcvid.sinks import video
from ttcvid.sinks.video import TICKS_PER_S, OverlayVideo, check_video


def picture(size: ImageSize, i: int):
    """A smooth picture whose grey value tells its number."""
    ramp = np.linspace(0, 60, size.width_px)[None, :, None] + np.linspace(0, 40, size.height_px)[:, None, None]
    return np.broadcast_to(ramp + 5 * i, (size.height_px, size.width_px, 3)).astype(np.uint8)


def write_video(path: Path, size: ImageSize, times_s, nominal_dt_s=0.1):
    with OverlayVideo(path, size, nominal_dt_s, preset="ultrafast", crf=20) as overlay:
        for i, t_s in enumerate(times_s):
            overlay.write(picture(size, i), t_s)


def decoded(path: Path):
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        return stream, list(container.decode(stream))


@pytest.mark.parametrize("size", [(64, 48), (65, 48), (64, 49), (65, 49), (1242, 375), (16, 17), (2, 2), (1, 1)])
def test_every_frame_comes_back_padded_to_even_sides_and_never_scaled(tmp_path, size):
    size = ImageSize(*size)
    write_video(tmp_path / "overlay.mp4", size, [0.0, 0.1, 0.2])
    assert check_video(tmp_path / "overlay.mp4") == 3
    _, frames = decoded(tmp_path / "overlay.mp4")
    for i, frame in enumerate(frames):
        bgr = frame.to_ndarray(format="bgr24")
        assert bgr.shape == (size.height_px + size.height_px % 2, size.width_px + size.width_px % 2, 3)
        back = bgr[: size.height_px, : size.width_px].astype(int)
        assert np.abs(back - picture(size, i)).mean() < 4


def test_presentation_times_are_exact_to_a_tick_from_the_first_picture_on(tmp_path):
    times_s = [7.0, 7.033367, 7.066733, 7.5, 9.25, 9.250111]
    write_video(tmp_path / "overlay.mp4", ImageSize(32, 32), times_s)
    stream, frames = decoded(tmp_path / "overlay.mp4")
    assert stream.time_base == Fraction(1, TICKS_PER_S)
    shown_s = [float(frame.pts * frame.time_base) for frame in frames]
    assert shown_s == pytest.approx(np.array(times_s) - times_s[0], abs=0.5 / TICKS_PER_S)


def test_times_that_stand_still_or_run_back_move_on_by_one_tick(tmp_path):
    write_video(tmp_path / "overlay.mp4", ImageSize(32, 32), [0.0, 0.1, 0.1, 0.05, 0.2])
    _, frames = decoded(tmp_path / "overlay.mp4")
    assert [frame.pts for frame in frames] == [0, 9000, 9001, 9002, 18000]


def test_last_picture_is_shown_for_the_usual_interval(tmp_path):
    write_video(tmp_path / "overlay.mp4", ImageSize(32, 32), [0.0, 0.1, 0.2])
    stream, _ = decoded(tmp_path / "overlay.mp4")
    assert float(stream.duration * stream.time_base) == pytest.approx(0.3)


def test_format_is_what_browsers_play(tmp_path):
    write_video(tmp_path / "overlay.mp4", ImageSize(64, 48), np.arange(50) * 0.1)
    stream, frames = decoded(tmp_path / "overlay.mp4")
    assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
    keys = [i for i, frame in enumerate(frames) if frame.key_frame]
    assert keys[0] == 0
    assert max(np.diff([*keys, len(frames)])) <= 20  # a key frame every 2 s
    content = (tmp_path / "overlay.mp4").read_bytes()
    assert content.index(b"moov") < content.index(b"mdat")  # the index first: plays while it loads


def test_equal_pictures_give_equal_bytes(tmp_path):
    for name in ("a.mp4", "b.mp4"):
        write_video(tmp_path / name, ImageSize(64, 48), np.arange(10) * 0.1)
    assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()


def test_picture_of_another_size_is_refused(tmp_path):
    with (
        pytest.raises(ValueError, match="expected a picture of 64x48"),
        OverlayVideo(tmp_path / "overlay.mp4", ImageSize(64, 48), 0.1, "ultrafast", 23) as overlay,
    ):
        overlay.write(np.zeros((48, 63, 3), np.uint8), 0.0)


@pytest.mark.parametrize("nominal_dt_s", [1 / 240, 1001 / 30000, 0.1, 10.0, 3600.0])
def test_any_usual_interval_can_be_written(tmp_path, nominal_dt_s):
    write_video(tmp_path / "overlay.mp4", ImageSize(32, 32), np.arange(4) * nominal_dt_s, nominal_dt_s)
    assert check_video(tmp_path / "overlay.mp4") == 4


def test_interrupted_video_is_closed_and_playable(tmp_path):
    def interrupted():
        with OverlayVideo(tmp_path / "overlay.mp4", ImageSize(32, 32), 0.1, "ultrafast", 23) as overlay:
            overlay.write(picture(ImageSize(32, 32), 0), 0.0)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert check_video(tmp_path / "overlay.mp4") == 1


@pytest.mark.parametrize("content", [b"", b"no video at all", None])
def test_file_that_is_no_video_fails_the_check(tmp_path, content):
    path = tmp_path / "overlay.mp4"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(OutputError, match=r"overlay\.mp4: the video just written cannot be decoded") as caught:
        check_video(path)
    assert "\n" not in str(caught.value)


def test_damaged_video_fails_the_check(tmp_path):
    path = tmp_path / "overlay.mp4"
    write_video(path, ImageSize(64, 48), np.arange(30) * 0.1)
    path.write_bytes(path.read_bytes()[:-400])
    with pytest.raises(OutputError, match=r"holds \d+ of 30 pictures"):
        check_video(path)


def test_video_without_a_picture_fails_the_check(tmp_path):
    write_video(tmp_path / "overlay.mp4", ImageSize(64, 48), [])
    with pytest.raises(OutputError, match="the video just written"):
        check_video(tmp_path / "overlay.mp4")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("n_frames", [1, 300])
def test_full_disk_is_one_line_with_remedy(tmp_path, n_frames):
    (tmp_path / "overlay.mp4").symlink_to("/dev/full")
    with pytest.raises(OutputError, match=r"overlay\.mp4: cannot be written, the disk is full"):
        write_video(tmp_path / "overlay.mp4", ImageSize(64, 48), np.arange(n_frames) * 0.1)


@pytest.mark.parametrize("limit", [1, 3000, 60_000])
def test_disk_that_fills_up_while_writing_is_an_output_error_and_no_crash(tmp_path, limit):
    """A limit on the size of files stands in for the disk; it needs a process of its own."""
    script = f"""
import resource, signal
from pathlib import Path
import numpy as np
from ttcvid.errors import OutputError
from ttcvid.model import ImageSize
from ttcvid.sinks.video import OverlayVideo

signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))
noise = np.random.default_rng(0).integers(0, 255, (48, 64, 3), dtype=np.uint8)
overlay = OverlayVideo(Path({str(tmp_path / "overlay.mp4")!r}), ImageSize(64, 48), 0.1, "ultrafast", 20)
try:
    for i in range(40):
        overlay.write(np.roll(noise, i, axis=1), i / 10)
    overlay.close()
except OutputError as error:
    print(error)
overlay.close()
overlay.close()
"""
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert "overlay.mp4: cannot be written, the file is larger than allowed here" in run.stdout
    assert run.stdout.count("\n") == 1


def test_missing_encoder_is_one_line_with_remedy(tmp_path, monkeypatch):
    def unknown(name, mode):
        raise av.codec.codec.UnknownCodecError(name)

    monkeypatch.setattr(video.av.codec, "Codec", unknown)
    with pytest.raises(OutputError, match=r"libx264: this PyAV has no H\.264 encoder: install"):
        OverlayVideo(tmp_path / "overlay.mp4", ImageSize(64, 48), 0.1, "ultrafast", 23)
    assert not any(tmp_path.iterdir())


def test_missing_folder_is_an_output_error(tmp_path):
    with pytest.raises(OutputError, match="does not exist"):
        OverlayVideo(tmp_path / "absent" / "overlay.mp4", ImageSize(64, 48), 0.1, "ultrafast", 23)
