"""What a video file says of its frames before any of them is decoded."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from av.container import InputContainer
from av.packet import Packet
from av.stream import Disposition
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

from ttcvid.errors import InputError
from ttcvid.model import Floats, Ints

NO_TIMESTAMPS_FLAG = 0x0080
"""AVFMT_NOTIMESTAMPS of libavformat: a bare stream, whose times would be invented from an assumed rate."""

TS_PACKET_BYTES = (188, 192, 204)
"""Packet lengths of MPEG transport streams: plain, with arrival times, with error correction."""

TS_SYNC_BYTE = 0x47
TS_SYNCS = 5
"""Sync bytes in a row, one packet apart, that tell the length of the packets."""

FORMATS = (
    "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpegts,mpeg,mpegvideo,flv,asf,ogg,mxf,gxf,nut,dv,wtv,rm,dhav,cine,gif,apng,"
    "ivf,obu,h261,h263,h264,hevc,vvc,m4v,mjpeg,mjpeg_2000,mpjpeg,cavsvideo,vc1,dirac,yuv4mpegpipe"
)
"""Containers and bare streams that hold their pictures themselves, by FFmpeg's names. What is not among them may be a
list of other files (hls, dash, concat, imf, sdp...), whose hash would say nothing of what was analysed."""

LARGEST_OVERHEAD_BYTES = 200
"""Between two blocks of a Matroska file; the heads of block and cluster take some 40."""

LEAST_PART_OF_LONGEST = 0.5
"""A stream with fewer packets than this part of the longest one's is no second camera but a cover or a thumbnail."""

MICROSECONDS = 1_000_000
DURATION_SLACK_S = 0.1
"""How much shorter than the header says a file may end: headers are rounded and count the last frame's length."""


@dataclass(frozen=True)
class PacketIndex:
    """The frames that a file holds, in presentation order, from its packets alone.

    ``pts (N,)`` is in units of ``time_base``; None where the file knows no times. ``entry_packet (N,)`` is the
    number, in file order, of the packet from which decoding has to start for that frame. Where
    ``decoder_orders`` the file does not know the order of presentation, and only decoding tells it: the k-th
    frame that comes out is frame k. ``is_cut`` says that the file ends earlier than it should; ``damaged``
    are the numbers, in file order, of packets of which something is missing. ``stream`` is the number of the stream
    in its file, one of ``n_streams`` of moving pictures. About ``n_missing`` frames are gone, packets and all, where
    bytes of the file cannot be read.
    """

    pts: Ints | None
    time_base: Fraction
    entry_packet: Ints
    decoder_orders: bool
    is_cut: bool
    damaged: frozenset[int] = frozenset()
    stream: int = 0
    n_streams: int = 1
    n_missing: int = 0

    @property
    def n_frames(self) -> int:
        """Number of frames that come out if all of them can be decoded."""
        return len(self.entry_packet)

    @property
    def is_counted(self) -> bool:
        """Whether frames are numbered in the order in which they come out, because their times do not tell."""
        return self.pts is None or self.decoder_orders

    def times_s(self) -> Floats | None:
        """Presentation times ``(N,)`` in s, pts x time_base, the first one moved to 0 only where it is negative."""
        if self.pts is None:
            return None
        # a product of whole numbers below 2^53 is exact: only the division rounds
        times_s = self.pts * float(self.time_base.numerator) / self.time_base.denominator
        return np.asarray(times_s - min(0.0, times_s.min()))

    def number(self, pictures: Iterable[VideoFrame | None]) -> Iterator[tuple[int, VideoFrame]]:
        """Decoded frames with their index in the source, ascending; what the file does not announce is left out.

        A gap is seen from the times; where there are none, each damaged packet (None) stands for one lost frame.
        """
        due = 0
        for picture in pictures:
            if picture is None:
                due += self.is_counted
                continue
            index = due if self.is_counted else self._find(picture.pts, due)
            if index is not None:
                due = index + 1
                yield index, picture

    def _find(self, pts: int | None, due: int) -> int | None:
        assert self.pts is not None
        if pts is None or (due < self.n_frames and self.pts[due] == pts):
            return due
        later = np.flatnonzero(self.pts[due:] == pts)
        return due + int(later[0]) if len(later) else None


def open_video(path: Path, number: int) -> tuple[InputContainer, VideoStream]:
    """Open a video file and its stream of this number, to decode it; InputError where that cannot be done."""
    container = _open_container(path)
    stream = container.streams[number]
    assert isinstance(stream, VideoStream)
    # frame threads swallow what precedes a damaged packet, and slice threads do not tell of a damaged slice
    stream.thread_type = "NONE"
    return container, stream


def _open_container(path: Path) -> InputContainer:
    """Open a file that holds its pictures itself; InputError for anything else."""
    try:
        # "file:" keeps names with a colon from being taken for URLs, the whitelists keep lists from opening other files
        return av.open(f"file:{path}", options={"protocol_whitelist": "file", "format_whitelist": FORMATS})
    except av.error.ArgumentError:
        raise InputError(
            f"{path}: is a list of other files (a playlist), or no kind of video that is read here: give the clip "
            f"itself, one file, or convert it to one (ffmpeg -i {path.name} clip.mp4)"
        ) from None
    except (av.error.FFmpegError, OSError) as error:
        raise InputError(
            f"{path}: cannot be opened as video ({error.strerror}): expected a complete clip such as mp4, mkv, avi or "
            f"ts; an mp4 cut before its index was written has to be recorded or copied again"
        ) from None


def index_packets(path: Path) -> PacketIndex:
    """Read all packets once, without decoding, and list the frames that they hold.

    Raises InputError where the file is no video, holds no pictures, or none whose format is known.
    """
    contents = _read_contents(path)
    rows = contents.rows
    n_missing = _n_missing(rows) if "matroska" in contents.format else 0
    of_stream = (contents.stream, contents.n_streams, n_missing)
    damaged = _damaged(rows, "mpegts" in contents.format)
    shown = [i for i, row in enumerate(rows) if not row.is_discard]
    entry = _entry_packets(rows)
    known = [] if contents.is_bare else [i for i in shown if rows[i].pts is not None]
    if not known:
        entry_packet = np.zeros(len(shown), dtype=np.int64)
        return PacketIndex(None, contents.time_base, entry_packet, True, contents.is_cut, damaged, *of_stream)
    order = _presentation_order(rows, known)
    ordered_pts = np.array([rows[i].pts for i in order], dtype=np.int64)
    # an AVI file numbers its packets in the order of decoding, whatever the order of presentation
    decoder_orders = contents.is_reordered and order == known and contents.format == "avi"
    # a frame without time is numbered by counting, which has to begin at the first packet
    must_count = decoder_orders or len(known) < len(shown)
    first = np.zeros(len(order), dtype=np.int64) if must_count else np.array([entry[i] for i in order])
    return PacketIndex(ordered_pts, contents.time_base, first, decoder_orders, contents.is_cut, damaged, *of_stream)


@dataclass(frozen=True, slots=True)
class _Contents:
    """What is known of a file once it is closed: plain values.

    A closed container has freed its streams: what PyAV still answers about them is whatever else stands in that memory.
    ``rows`` are the packets of the stream in file order, ``stream`` and ``n_streams`` are of `PacketIndex`; ``format``
    is FFmpeg's name of the container; ``is_bare`` says that it knows no times, ``is_reordered`` that frames are not
    shown in the order of decoding.
    """

    rows: list[_Packet]
    stream: int
    n_streams: int
    format: str
    time_base: Fraction
    is_bare: bool
    is_reordered: bool
    is_cut: bool


def _read_contents(path: Path) -> _Contents:
    with _open_container(path) as container:
        streams = _moving_pictures(path, container)
        scanned, end_s, is_broken = _scan(container, streams)
        stream = _choose(streams, scanned)
        rows, n_empty = scanned[stream.index].rows, scanned[stream.index].n_empty
        is_broken |= bool(rows) and rows[-1].is_corrupt
        return _Contents(
            rows=rows,
            stream=stream.index,
            n_streams=len(streams),
            format=container.format.name,
            time_base=stream.time_base or Fraction(1),
            is_bare=bool(container.format.flags & NO_TIMESTAMPS_FLAG),
            is_reordered=stream.codec_context.has_b_frames > 0,
            is_cut=is_broken or _ends_early(path, container, stream, len(rows) + n_empty, end_s),
        )


def _moving_pictures(path: Path, container: InputContainer) -> list[VideoStream]:
    """The streams that may be analysed, at least one; InputError where there is none."""
    streams = [s for s in container.streams.video if not s.disposition & Disposition.attached_pic]
    if not streams:
        kinds = ", ".join(sorted({s.type for s in container.streams})) or "nothing"
        raise InputError(f"{path}: holds no video, only {kinds}: expected a clip with a video stream")
    # decoding a stream without codec parameters would crash the interpreter
    known = [s for s in streams if s.codec_context is not None]
    if not known:
        raise InputError(f"{path}: its video stream cannot be decoded (unknown or damaged format): convert it to H.264")
    return known


def _choose(streams: list[VideoStream], scanned: dict[int, _Scanned]) -> VideoStream:
    """Of the streams about as long as the longest, the one that is marked as default, or else the first.

    A cover may come first, and be marked as default by the program that put it in.
    """
    n_packets = {s.index: len(scanned[s.index].rows) for s in streams}
    long = [s for s in streams if n_packets[s.index] >= LEAST_PART_OF_LONGEST * max(n_packets.values())]
    return next((s for s in long if s.disposition & Disposition.default), long[0])


@dataclass(frozen=True, slots=True)
class _Packet:
    pts: int | None
    dts: int | None
    is_keyframe: bool
    is_discard: bool
    is_corrupt: bool
    follows_on: bool = True
    """Whether it begins where the packet before it in the file, of any stream, ends."""


@dataclass(slots=True)
class _Scanned:
    """The packets of a stream in file order, and how many more hold nothing.

    AVI files keep the place of frames dropped while recording with empty packets, and count them in the header.
    """

    rows: list[_Packet]
    n_empty: int = 0


class _Place:
    """How far a file has been read: what lies between two packets, beside their heads, is no packet."""

    def __init__(self) -> None:
        self._begin = self._end = -1

    def go_on(self, packet: Packet[Any]) -> bool:
        """Go on to the next packet; whether it begins where the one before ended."""
        before, begin = self._end, packet.pos or 0
        is_in_same_block = begin == self._begin  # several packets of sound may share one
        self._end = (before if is_in_same_block else begin) + packet.size
        self._begin = begin
        return before < 0 or is_in_same_block or 0 <= begin - before <= LARGEST_OVERHEAD_BYTES


def _scan(container: InputContainer, streams: list[VideoStream]) -> tuple[dict[int, _Scanned], float, bool]:
    """What the streams hold, by their numbers, where the last packet of any stream ends, in s, and if it broke off."""
    scanned = {stream.index: _Scanned([]) for stream in streams}
    end_s = 0.0
    place = _Place()
    try:
        for packet in container.demux():
            wanted = scanned.get(packet.stream_index)
            if packet.size == 0:
                if wanted is not None and packet.dts is not None:
                    wanted.n_empty += 1
                continue
            if packet.pts is not None:
                end_s = max(end_s, float((packet.pts + (packet.duration or 0)) * packet.time_base))
            follows_on = place.go_on(packet)
            if wanted is not None:
                flags = packet.is_keyframe, packet.is_discard, packet.is_corrupt, follows_on
                wanted.rows.append(_Packet(packet.pts, packet.dts, *flags))
    except av.error.FFmpegError:
        return scanned, end_s, True
    return scanned, end_s, False


def _ends_early(path: Path, container: InputContainer, stream: VideoStream, n_packets: int, end_s: float) -> bool:
    """Whether the file is shorter than its own header says."""
    kinds = set(container.format.name.split(","))
    if "mp4" in kinds:
        return len(stream.index_entries) > n_packets
    if "avi" in kinds:
        return stream.frames > n_packets
    if kinds & {"matroska", "flv"}:
        frame_s = float(1 / stream.average_rate) if stream.average_rate else 0.0
        return (container.duration or 0) / MICROSECONDS > end_s + frame_s + DURATION_SLACK_S
    if "mpegts" in kinds:
        return path.stat().st_size % _ts_packet_bytes(path) != 0
    return False


def _ts_packet_bytes(path: Path) -> int:
    """Length of the packets of a transport stream; 1 where no length shows."""
    with path.open("rb") as stream:
        head = stream.read(TS_SYNCS * max(TS_PACKET_BYTES))
    for length in TS_PACKET_BYTES:
        columns = (head[offset::length][:TS_SYNCS] for offset in (0, length - min(TS_PACKET_BYTES)))
        if any(column and set(column) == {TS_SYNC_BYTE} for column in columns):
            return length
    return 1


def _entry_packets(rows: list[_Packet]) -> list[int]:
    """For each packet the last keyframe, in file order, that is shown no later than it."""
    entry: list[int] = []
    keys: list[int] = []
    for i, row in enumerate(rows):
        if row.is_keyframe:
            keys = [*keys[-1:], i]
        # pictures that lead an open group of pictures follow its keyframe in the file, but need the group before
        shown = [k for k in keys if row.pts is not None and (rows[k].pts or 0) <= row.pts]
        entry.append(shown[-1] if shown else (keys[0] if keys else 0))
    return entry


def _damaged(rows: list[_Packet], is_transport_stream: bool) -> frozenset[int]:
    """Numbers of the packets of which something is missing."""
    marked = [i for i, row in enumerate(rows) if row.is_corrupt]
    if not is_transport_stream:
        return frozenset(marked)
    # its parser gives a packet out while it reads the next one, and with the mark of that
    damaged = {min(i + 1, len(rows) - 1) for i in marked}
    # where two streams were put together nothing is missing, only the count of packets starts again
    return frozenset(i for i in damaged if not _clock_starts_anew(rows, i + 1))


def _n_missing(rows: list[_Packet]) -> int:
    """Number of frames that lay where one block of a Matroska or WebM file does not begin behind the one before it.

    Such a file has no list of its frames: a reader that meets damaged bytes goes on at the next cluster, in silence.
    Only where the times jump as well is anything taken to be missing.
    """
    pts = np.array([row.pts for row in rows if row.pts is not None], dtype=np.int64)
    if len(pts) != len(rows) or len(rows) < 3:
        return 0
    step = float(np.median(np.diff(np.sort(pts))))
    holes = [i for i, row in enumerate(rows) if i > 0 and not row.follows_on]
    return sum(max(0, round((pts[i:].min() - pts[:i].max()) / step) - 1) for i in holes) if step > 0 else 0


def _clock_starts_anew(rows: list[_Packet], number: int) -> bool:
    """Whether the times of decoding fall at a packet."""
    if number >= len(rows):
        return False
    before, here = rows[number - 1].dts, rows[number].dts
    return before is not None and here is not None and here < before


def _presentation_order(rows: list[_Packet], known: list[int]) -> list[int]:
    """Packet numbers in the order of presentation; a clock that jumps back (dts falls) starts again behind."""
    order: list[int] = []
    piece: list[int] = []
    last_dts: int | None = None
    for i in known:
        dts = rows[i].dts
        if dts is not None and last_dts is not None and dts < last_dts:
            order += sorted(piece, key=lambda k: rows[k].pts or 0)
            piece = []
        last_dts = dts if dts is not None else last_dts
        piece.append(i)
    return order + sorted(piece, key=lambda k: rows[k].pts or 0)
