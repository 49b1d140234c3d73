"""Points that another tracker has followed: the same statuses as for our own."""

from __future__ import annotations

import numpy as np

from ttcvid.model import FrameStatus, PointSet


def compare_table_points(last: PointSet | None, points: PointSet) -> FrameStatus:
    """Status of a frame of a track table: ``first``, ``cut`` (no track goes on), ``duplicate`` or ``ok``.

    A frame is a duplicate when it has the same tracks in exactly the same places.
    """
    if last is None:
        return FrameStatus.first
    if (
        len(points.track_id)
        and np.array_equal(last.track_id, points.track_id)
        and np.array_equal(last.xy_px, points.xy_px)
    ):
        return FrameStatus.duplicate
    if len(last.track_id) and len(points.track_id) and not np.isin(points.track_id, last.track_id).any():
        return FrameStatus.cut
    return FrameStatus.ok
