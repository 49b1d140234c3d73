"""Pictures out of packets; what is damaged, and what rests on it, is left out."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator

import av
from av.container import InputContainer
from av.packet import Packet
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

from ttcvid.sources.packets import PacketIndex

_NAL_START = re.compile(b"\x00\x00\x01(.)", re.DOTALL)
_H264_SLICES = (1, 5)
_HEVC_SLICES = 16
"""Types of H.264 units that hold a picture not split further; HEVC's have numbers below this (an even one: no other
picture of its layer refers to it)."""


def decode(
    container: InputContainer, stream: VideoStream, index: PacketIndex, first: int
) -> Iterator[VideoFrame | None]:
    """Decoded frames in the order of presentation, from packet ``first`` on; None for each that cannot be decoded.

    A decoder makes up what is missing of a damaged picture, and of those that refer to it. Where their times tell
    which they are, such pictures are left out: up to the next keyframe, or alone where no other refers to them.
    """
    packets = container.demux(stream)
    doubt = _Doubt()
    number = -1
    while True:
        try:
            packet = next(packets, None)
        except av.error.FFmpegError:
            break  # the container itself is damaged: nothing can be found behind this place
        if packet is None:
            break
        if packet.size == 0:
            continue  # an empty packet would end the decoding
        number += 1
        if number < first:
            continue
        pictures = _decode_packet(packet.decode)
        if not index.is_counted:
            is_damaged = number in index.damaged or None in pictures
            doubt.look_at(packet, stream.codec_context.name, is_damaged=is_damaged)
        yield from doubt.without_doubtful(pictures)
    yield from doubt.without_doubtful(_decode_packet(lambda: stream.codec_context.decode(None)))


def _decode_packet(decode_once: Callable[[], list[VideoFrame]]) -> list[VideoFrame | None]:
    try:
        return [*decode_once()]
    except av.error.FFmpegError:
        return [None]


class _Doubt:
    """Which pictures, by their presentation times, may show what was never filmed."""

    def __init__(self) -> None:
        self._pts: set[int | None] = set()
        self._lasts = False

    def look_at(self, packet: Packet[VideoStream], codec: str, *, is_damaged: bool) -> None:
        """Take note of the next packet in file order."""
        if packet.is_keyframe:
            self._lasts = False
        if is_damaged or self._lasts:
            self._pts.add(packet.pts)
        else:
            self._pts.discard(packet.pts)  # a clock that started again gives the same times again
        self._lasts |= is_damaged and _is_referred_to(packet, codec)

    def without_doubtful(self, pictures: list[VideoFrame | None]) -> Iterator[VideoFrame | None]:
        for picture in pictures:
            if picture is None or picture.pts is None or picture.pts not in self._pts:
                yield picture


def _is_referred_to(packet: Packet[VideoStream], codec: str) -> bool:
    """Whether other pictures may be made from this one; False only where the packet itself says that none is."""
    if packet.is_disposable:
        return False
    for unit in _NAL_START.finditer(bytes(packet)) if codec in ("h264", "hevc") else ():
        header = unit[1][0]
        if codec == "h264" and header & 31 in _H264_SLICES:
            return bool(header >> 5 & 3)
        if codec == "hevc" and header >> 1 & 63 < _HEVC_SLICES:
            return bool(header >> 1 & 1)
    return True
