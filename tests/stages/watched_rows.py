"""Rows of bodies on straight ways, and the warnings that stand while they are watched."""

import numpy as np
from relative_motion import CAMERA, FOCAL_PX

from ttcvid.config import EventsConfig
from ttcvid.model import ClusterRow, Status
from ttcvid.stages.objects.clusters import with_times
from ttcvid.stages.warnings.course import Viewpoint
from ttcvid.stages.warnings.events import EventMemory, update_events

CONFIG = EventsConfig(max_ttc_s=4.0, max_miss_widths=1.0, persistence_s=0.3)
FRAME_S = 0.05
WIDTH_M = 1.8


def row_of(position_m, velocity_m_s, cluster_id=1, relative_sigma=0.02, width_m=WIDTH_M):
    """Cluster row of a body of a given width, with its rates known to a part of their size."""
    position_m, velocity_m_s = np.asarray(position_m, float), np.asarray(velocity_m_s, float)
    abc_hz = velocity_m_s / position_m[2]
    ref_px = FOCAL_PX * position_m[:2] / position_m[2] + (CAMERA.cx_px, CAMERA.cy_px)
    half_px = 0.5 * FOCAL_PX * width_m / position_m[2]
    row = ClusterRow(
        cluster_id=cluster_id,
        motion_id=1,
        n_tracks=20,
        box_px=(ref_px[0] - half_px, ref_px[1] - half_px, ref_px[0] + half_px, ref_px[1] + half_px),
        status=Status.ok,
        epipole_status=Status.ok,
        method="consensus",
        ref_px=(float(ref_px[0]), float(ref_px[1])),
        state_abc_hz=abc_hz,
        state_cov=(relative_sigma * np.linalg.norm(abc_hz)) ** 2 * np.eye(3),
    )
    return with_times([row], CAMERA)[0]


def drive(position_m, velocity_m_s, seconds, **options):
    """Rows of a body, frame after frame, from `position_m` on; until it is at 1 m depth."""
    rows = []
    for t_s in np.arange(0.0, seconds, FRAME_S):
        now = np.asarray(position_m, float) + np.asarray(velocity_m_s, float) * t_s
        if now[2] < 1.0:
            break
        rows.append(row_of(now, velocity_m_s, **options))
    return rows


def watched(frames, config=CONFIG, memory=None, first_frame=0, **options):
    """Events active in each frame; a frame is a tuple of rows, or one row, or None. ``options`` to the `Viewpoint`."""
    memory, active = memory or EventMemory(), []
    for number, rows in enumerate(frames, first_frame):
        rows = () if rows is None else rows if isinstance(rows, tuple) else (rows,)
        view = Viewpoint(CAMERA, **options)
        events, memory = update_events(memory, number, number * FRAME_S, rows, view, config)
        active.append(events)
    return active, memory


def first_warned(active):
    """Frame in which the first warning stands."""
    return next((number for number, events in enumerate(active) if events), None)


HIT = ((0.0, 0.0, 30.0), (0.0, 0.0, -10.0))
HARMLESS = row_of((0.0, 0.0, 30.0), (0.0, 0.0, 8.0))
WITHOUT_STATE = ClusterRow(1, 1, 5, (0.0, 0.0, 9.0, 9.0), Status.no_parallax, Status.ok, "consensus")
