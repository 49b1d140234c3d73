"""Video files that are damaged, cut short, or no video at all."""

from fractions import Fraction

import av
import numpy as np
import pytest
from source_clips import FPS, HEIGHT, WIDTH, N, cut, damage, one_line_error, read, write_video

from ttcvid.errors import InputError
from ttcvid.sources import Selection


@pytest.mark.parametrize("bad", [1, 5])
def test_an_isolated_bad_packet_leaves_a_gap(tmp_path, bad):
    path = write_video(tmp_path / "a.mkv", codec="mjpeg", pixel_format="yuvj420p")
    damage(path, bad)
    frames, source = read(path)
    good = [i for i in range(N) if i != bad]
    assert [frame.index for frame in frames] == good
    assert [frame.t_s for frame in frames] == [i / FPS for i in good]
    assert source.info.n_frames == N
    assert (source.report.n_packets_skipped, source.report.is_truncated) == (1, False)
    assert "1 frames cannot be decoded" in source.report.warnings[0]


def test_a_bad_packet_leaves_a_gap_where_the_file_knows_no_order(tmp_path):
    path = write_video(tmp_path / "a.avi", reordered=True)
    damage(path, 2)  # I P B B: a frame that no other needs
    frames, source = read(path)
    assert len(frames) == N - 1
    assert frames[-1].index == N - 1
    assert (source.report.n_packets_skipped, source.report.is_truncated) == (1, False)


def test_a_bad_packet_at_the_end_of_the_selection_is_no_truncation(tmp_path):
    path = write_video(tmp_path / "a.mkv", codec="mjpeg", pixel_format="yuvj420p")
    damage(path, 5)
    frames, source = read(path, "2", "6")
    assert [frame.index for frame in frames] == [2, 3, 4]
    assert (source.report.n_packets_skipped, source.report.is_truncated) == (1, False)
    assert read(path, "6")[1].report.n_packets_skipped == 0
    assert "none of the 1 selected frames can be decoded" in one_line_error(
        InputError, path, selection=Selection("5", "6")
    )


def test_a_bad_last_packet_is_a_truncation(tmp_path):
    path = write_video(tmp_path / "a.mkv", codec="mjpeg", pixel_format="yuvj420p")
    damage(path, N - 1)
    frames, source = read(path)
    assert len(frames) == N - 1
    assert (source.report.n_packets_skipped, source.report.is_truncated) == (0, True)


def test_a_damaged_first_packet_is_skipped(tmp_path):
    path = write_video(tmp_path / "a.mkv", codec="mjpeg", pixel_format="yuvj420p")
    damage(path, 0)
    frames, source = read(path)
    assert [frame.index for frame in frames] == list(range(1, N))
    assert source.report.n_packets_skipped == 1


def lose_transport_packet(path, number):
    """Take a piece out of one frame of a transport stream, as bad reception does."""
    with av.open(str(path)) as container:
        places = [packet.pos for packet in container.demux(video=0) if packet.size]
    data = bytearray(path.read_bytes())
    pid = data[places[number] + 1] & 31, data[places[number] + 2]
    own = [at for at in range(0, len(data), 188) if (data[at + 1] & 31, data[at + 2]) == pid]
    mine = [at for at in own if places[number] < at < places[number + 1]]
    at = mine[len(mine) // 2]
    del data[at : at + 188]
    path.write_bytes(data)


@pytest.mark.parametrize(("packet", "n_lost"), [(9, 1), (8, 2), (12, 8)])
def test_what_a_decoder_makes_up_for_lost_pieces_is_left_out(tmp_path, packet, n_lost):
    """Packets 10 and 20 are keyframes. Nothing refers to the B frame of packet 9, but it does to that of packet 8."""
    whole, _ = read(write_video(tmp_path / "whole.ts", n=25, key_every=10, reordered=True))
    path = write_video(tmp_path / "a.ts", n=25, key_every=10, reordered=True)
    lose_transport_packet(path, packet)
    frames, source = read(path)
    assert len(frames) == 25 - n_lost
    for frame in frames:
        assert frame.t_s == whole[frame.index].t_s
        np.testing.assert_array_equal(frame.grey, whole[frame.index].grey)
    assert (source.report.n_packets_skipped, source.report.is_truncated) == (n_lost, False)
    assert "1 packets are damaged" in source.report.warnings[0]


def test_what_follows_a_packet_that_cannot_be_decoded_is_left_out_up_to_the_next_keyframe(tmp_path):
    path = write_video(tmp_path / "a.mkv", n=25, key_every=10, codec="mpeg4")
    whole, _ = read(path)
    damage(path, 13)
    frames, source = read(path)
    assert [frame.index for frame in frames] == [*range(13), *range(20, 25)]
    for frame in frames:
        np.testing.assert_array_equal(frame.grey, whole[frame.index].grey)
    assert source.report.n_packets_skipped == 7


CUT = {
    "a.mp4": {"container_options": {"movflags": "faststart"}, "reordered": True},
    "a.mkv": {"reordered": True},
    "a.ts": {"reordered": True},
    "a.avi": {"codec": "mjpeg", "pixel_format": "yuvj420p"},
    "a.flv": {"reordered": True},
}


@pytest.mark.parametrize("name", CUT)
def test_of_a_cut_file_what_is_there_is_delivered(tmp_path, name):
    whole, source = read(write_video(tmp_path / f"whole_{name}", n=60, **CUT[name]))
    assert (len(whole), source.report.is_truncated) == (60, False)
    path = cut(write_video(tmp_path / name, n=60, **CUT[name]), 0.613)
    frames, source = read(path)
    assert source.report.is_truncated
    assert 25 <= len(frames) <= 45
    assert source.report.n_packets_skipped == 0
    assert "ends early, after frame" in source.report.warnings[-1]
    sure = len(frames) - 4  # behind that the reference frames of B frames are missing
    assert [frame.index for frame in frames[:sure]] == list(range(sure))
    for frame, true in zip(frames[:sure], whole, strict=False):
        assert frame.t_s == true.t_s
        np.testing.assert_array_equal(frame.grey, true.grey)
    # an end before the cut was wanted: nothing is missing
    assert not read(path, None, "20")[1].report.is_truncated


def test_a_cut_file_reads_the_same_every_time(tmp_path):
    path = cut(write_video(tmp_path / "a.mkv", n=60, reordered=True), 0.7)
    readings = [[(f.index, f.grey.tobytes()) for f in read(path)[0]] for _ in range(3)]
    assert readings[0] == readings[1] == readings[2]


def test_an_mp4_without_its_index_is_unreadable(tmp_path):
    assert "cut before its index was written" in one_line_error(
        InputError, cut(write_video(tmp_path / "a.mp4", n=60), 0.6)
    )


@pytest.mark.parametrize("share", [0.02, 0.05, 0.1, 0.15, 0.2, 0.3])
def test_no_cut_crashes(tmp_path, share):
    path = cut(write_video(tmp_path / "a.mp4", container_options={"movflags": "faststart"}), share)
    try:
        frames, source = read(path)
    except InputError:
        return  # nothing of it can be decoded
    assert source.report.is_truncated
    assert frames


def test_a_change_of_size_is_an_error_that_names_both(tmp_path):
    path = tmp_path / "a.mkv"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mjpeg", rate=FPS)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuvj420p"
        others = [av.CodecContext.create("mjpeg", "w") for _ in range(2)]
        for encoder, width in zip(others, (WIDTH, 32), strict=True):
            encoder.width, encoder.height, encoder.pix_fmt = width, HEIGHT, "yuvj420p"
            encoder.time_base = Fraction(1, FPS)
        for index in range(4):
            width = WIDTH if index < 2 else 32
            for packet in others[index // 2].encode(av.VideoFrame(width, HEIGHT, "yuvj420p")):
                packet.stream, packet.time_base = stream, Fraction(1, FPS)
                packet.pts = packet.dts = index
                container.mux(packet)
    message = one_line_error(InputError, path)
    assert "frame 2 is 32x48, the frames before it 70x48" in message
    assert "--end 2" in message


def test_missing_empty_and_foreign_files_are_one_line_each(tmp_path):
    assert "no such file" in one_line_error(InputError, tmp_path / "none.mp4")
    empty = tmp_path / "empty.mp4"
    empty.touch()
    assert "is empty (0 bytes)" in one_line_error(InputError, empty)
    text = tmp_path / "text.mp4"
    text.write_text("this is no video\n" * 100)
    assert "cannot be opened as video" in one_line_error(InputError, text)
    noise = tmp_path / "noise.mp4"
    noise.write_bytes(np.random.default_rng(0).bytes(5000))
    one_line_error(InputError, noise)


def test_a_playlist_cannot_reach_for_other_files(tmp_path):
    write_video(tmp_path / "a.ts")
    playlist = tmp_path / "list.mp4"
    playlist.write_text("#EXTM3U\n#EXTINF:1,\nhttp://127.0.0.1:9/a.ts\n#EXT-X-ENDLIST\n")
    one_line_error(InputError, playlist)


def test_audio_only_is_an_error_that_says_so(tmp_path):
    path = tmp_path / "a.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("aac", rate=8000, layout="mono")
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), "fltp", "mono")
        frame.sample_rate = 8000
        container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    assert "holds no video, only audio" in one_line_error(InputError, path)


def test_a_video_without_frames_is_an_error(tmp_path):
    path = write_video(tmp_path / "a.mkv", codec="mjpeg", pixel_format="yuvj420p", n=3)
    for number in range(3):
        damage(path, number)
    assert "no picture in it can be decoded" in one_line_error(InputError, path)
    one_line_error(InputError, write_video(tmp_path / "b.mp4", n=0))
