"""What a picture file says of its size, before it is decoded.

A few bytes can claim pictures of gigabytes, so that size is judged by the header: formats that have none that is known
here are not decoded.
"""

from __future__ import annotations

import io
import struct

import imagesize

MAX_IMAGE_MPX = 100.0
"""In 10^6 pixels. The largest cameras that film have some 60; decoded in colour 100 take 300 MB."""


def size_in_header(content: bytes) -> tuple[int, int] | None:
    """Width and height in px that a picture file claims, as stored; None where it is no picture of a known kind."""
    try:
        width_px, height_px = imagesize.get(io.BytesIO(content))
    except (ValueError, TypeError, OverflowError, IndexError, KeyError, EOFError, OSError, struct.error):
        return None  # of a damaged header its parser makes anything
    return (int(width_px), int(height_px)) if width_px > 0 and height_px > 0 else None
