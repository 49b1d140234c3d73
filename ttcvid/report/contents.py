"""What a page is made of: one finished analysis, as it stands in its folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from ttcvid.model import Camera, Floats

TABLE_COLUMNS: dict[str, tuple[str, ...]] = {
    "frames": (
        *("frame", "t_s", "dt_s", "n_tracks", "n_clusters"),
        *("rot_x_rad", "rot_y_rad", "rot_z_rad", "rot_sigma_rad", "min_ttc_z_s", "status"),
    ),
    "clusters": (
        *("frame", "cluster_id", "n_tracks", "x0_px", "y0_px", "x1_px", "y1_px", "ref_x_px", "ref_y_px", "state"),
        *("tcpa_s", "tcpa_lo_s", "tcpa_hi_s", "miss_s", "miss_lo_s", "miss_hi_s"),
        *("ttc_z_s", "ttc_z_lo_s", "ttc_z_hi_s", "status"),
    ),
    "epipoles": (
        *("frame", "cluster_id", "dir_x", "dir_y", "dir_z"),
        *("cov_xx", "cov_xy", "cov_xz", "cov_yy", "cov_yz", "cov_zz"),
    ),
    "events": (
        *("kind", "cluster_id", "start_frame", "end_frame", "start_s", "end_s"),
        *("min_ttc_z_s", "min_tcpa_s", "miss_s", "confidence"),
    ),
    "collision_times": ("status",),
}
"""Tables that a report reads, and what of them."""


@dataclass(frozen=True)
class RunContents:
    """One run.

    ``tables`` holds at least `TABLE_COLUMNS`; ``video`` and ``own_page`` are the addresses of its annotated video and
    of its own report as seen from the page, None where there are none.
    """

    name: str
    manifest: Mapping[str, Any]
    camera: Camera
    tables: Mapping[str, pa.Table]
    video: str | None
    own_page: str | None = None

    def numbers(self, table: str, column: str) -> Floats:
        """A column of numbers ``(N,)``, null as NaN.

        From its memory: pyarrow's ``to_numpy`` and ``fill_null`` import pandas first, which takes longer than the page.
        """
        values = self.tables[table][column].cast(pa.float64()).combine_chunks()
        is_valid, memory = values.buffers()
        rows = slice(values.offset, values.offset + len(values))
        numbers: Floats = np.frombuffer(memoryview(memory or b""), dtype=np.float64)[rows].copy()
        if is_valid is not None:
            bits = np.unpackbits(np.frombuffer(memoryview(is_valid), dtype=np.uint8), bitorder="little")
            numbers[bits[rows] == 0] = np.nan
        return numbers

    def words(self, table: str, column: str) -> list[str]:
        """A column of words."""
        return [str(word) for word in self.tables[table][column].to_pylist()]
