"""Warnings: objects that will come close soon, with persistence before and hysteresis after."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from scipy.special import ndtr, ndtri

from ttcvid.config import EventsConfig
from ttcvid.geometry.camera import rays_from_pixels
from ttcvid.geometry.closing import Closing
from ttcvid.geometry.compiled import compiled
from ttcvid.geometry.rotation import tangent_basis
from ttcvid.model import APPROACHING, Camera, ClusterRow, Event, Floats, MotionState

ClosingOf = Callable[[int], Closing | None]
"""From the number of a cluster to how its depth changes; None where that is not known."""

# A warning that stands goes on up to these multiples of the thresholds.
_KEEP_TTC, _KEEP_MISS = 1.25, 1.5
# What is seen of a thing counts by its part across the way that it goes, and half as much again for our own width; and
# by this part in any case, since nothing is a line.
_WITH_OURS, _LEAST_ACROSS = 1.5, 0.1
# A warning of what is hidden or has no value stands so many times as long as one that is over: it is still there.
_HIDDEN = 3.0
# What appears where something under watch was lost, with this part of the smaller box in common, is the same thing.
_SAME_PLACE = 0.3
# A step so many times as long as usual is a gap.
_STALLED = 1.5
# Times of pictures are rounded to the clock of their container, and differences of them once more: what has lasted as
# long as the persistence within this, s, has lasted as long.
_ROUNDING_S = 1e-3
# What closes in ever faster is told at 99 % (one side); who brakes goes on with it for about so long, s.
_SIGMAS_99, _LASTING_S = 2.326, 1.0
# Half of our own width and some room beside it, in heights of the camera above the road: cars, vans and lorries alike.
_ROOM_HEIGHTS = 1.0
# A miss distance, in units of depth, without a side.
_TINY = 1e-9


@dataclass(frozen=True)
class WatchedObject:
    """An object under watch: since when its condition holds, when and in which box it held last, and its warning.

    ``near_since_s`` is since when it would be warned of, None where it would not; ``tcpa_s`` what its ``tcpa`` was at
    the times of the last ``persistence_s``: pairs (t_s, tcpa_s).
    """

    since_s: float
    last_s: float
    box_px: tuple[float, float, float, float]
    near_since_s: float | None = None
    tcpa_s: tuple[tuple[float, float], ...] = ()
    event: Event | None = None


@dataclass(frozen=True)
class EventMemory:
    """Objects under watch by ``cluster_id``, and the number of the next warning."""

    watched: dict[int, WatchedObject] = field(default_factory=dict)
    next_event_id: int = 1


def unknown_closing(_: int) -> None:
    """Nothing is known of how the depth of any cluster changes."""


def update_events(
    memory: EventMemory,
    frame: int,
    t_s: float,
    clusters: tuple[ClusterRow, ...],
    camera: Camera,
    config: EventsConfig,
    *,
    step_s: float = 0.0,
    on_ground: bool = False,
    closing_of: ClosingOf = unknown_closing,
) -> tuple[tuple[Event, ...], EventMemory]:
    """Warnings active in this frame, and what to remember.

    A warning starts when an object has met the condition for ``persistence_s`` without a gap; or, after having come at
    us for as long but a little later, when it meets it and what its time was by then has run down below the limit
    (`_has_run_down`). It ends when the object has not met the looser condition for as long, or has been hidden for
    `_HIDDEN` times as long. An object that gets another number behind what hid it is warned of at once.

    Parameters
    ----------
    step_s : usual time between frames; what is looked at so seldom that this is longer than the persistence has no gap.
    on_ground, closing_of : as of `is_collision_course`.
    """
    gone_s = _gone_s(config)
    longest_step_s = max(gone_s, _STALLED * step_s)
    rows = {row.cluster_id: row for row in clusters}
    watched: dict[int, WatchedObject] = {}
    next_event_id = memory.next_event_id
    for cluster_id in sorted(set(rows) | set(memory.watched)):
        before = memory.watched.get(cluster_id)
        warned = before is not None and before.event is not None
        row = rows.get(cluster_id)
        if row is None or row.state_abc_hz is None:
            hidden_s = _HIDDEN * gone_s if warned else longest_step_s
            if before is not None and t_s - before.last_s <= hidden_s:
                watched[cluster_id] = before
            continue
        is_course = partial(is_collision_course, row, camera, config, on_ground=on_ground, closing_of=closing_of)
        if not is_course(is_warned=warned, is_watched=True):
            if before is not None and warned and t_s - before.last_s <= gone_s:
                watched[cluster_id] = before
            continue
        if before is not None and not warned and t_s - before.last_s > longest_step_s:
            # Not looked at in between (dark or doubled pictures): that is no persistence.
            before = None
        if before is None:
            lost_id = _lost_at(row.box_px, watched, rows)
            before = None if lost_id is None else _under_new_number(watched.pop(lost_id), t_s, config)
        now = _watched(before, row, t_s, config)
        if now.event is not None:
            now = replace(now, event=_continued(now.event, row, frame, t_s))
        elif is_course(is_warned=False):
            near_since_s = t_s if now.near_since_s is None else now.near_since_s
            now = replace(now, near_since_s=near_since_s)
            if _lasts(near_since_s, t_s, config) or _has_run_down(now, t_s, config):
                now = replace(now, event=_started(next_event_id, row, frame, t_s))
                next_event_id += 1
        else:
            now = replace(now, near_since_s=None)
        watched[cluster_id] = now
    active = tuple(w.event for w in watched.values() if w.event is not None)
    return active, EventMemory(watched, next_event_id)


def _watched(before: WatchedObject | None, row: ClusterRow, t_s: float, config: EventsConfig) -> WatchedObject:
    """An object whose condition holds now, its warning as before."""
    if before is None:
        return WatchedObject(t_s, t_s, row.box_px, tcpa_s=((t_s, row.times.tcpa_s[0]),))
    recent = tuple(pair for pair in before.tcpa_s if t_s - pair[0] <= _gone_s(config))
    return replace(before, last_s=t_s, box_px=row.box_px, tcpa_s=(*recent, (t_s, row.times.tcpa_s[0])))


def _under_new_number(lost: WatchedObject, t_s: float, config: EventsConfig) -> WatchedObject:
    """What was under watch and has another number now: if it was warned of, it is to be warned of at once."""
    if lost.event is None:
        return lost
    warned_s = t_s - config.persistence_s
    return replace(lost, since_s=min(lost.since_s, warned_s), near_since_s=warned_s, event=None)


def _lasts(since_s: float, t_s: float, config: EventsConfig) -> bool:
    """Whether what holds since then has held for the persistence."""
    return t_s - since_s >= config.persistence_s - _ROUNDING_S


def _has_run_down(one: WatchedObject, t_s: float, config: EventsConfig) -> bool:
    """Whether a thing is near in time by most of what its time was lately, and has come at us for as long.

    That a time runs down needs no proof, but a single one of them may err.
    """
    left_s = [tcpa_s - (t_s - then_s) for then_s, tcpa_s in one.tcpa_s]
    return _lasts(one.since_s, t_s, config) and float(np.median(left_s)) <= config.max_ttc_s


def _lost_at(
    box_px: tuple[float, float, float, float], watched: dict[int, WatchedObject], rows: dict[int, ClusterRow]
) -> int | None:
    """Number of an object under watch that is not there any more and was last where this box is; None: none."""
    for cluster_id, one in watched.items():
        if cluster_id not in rows and _common_part(box_px, one.box_px) > _SAME_PLACE:
            return cluster_id
    return None


def _common_part(one: tuple[float, float, float, float], other: tuple[float, float, float, float]) -> float:
    """Area that two boxes have in common over that of the smaller one."""
    width = min(one[2], other[2]) - max(one[0], other[0])
    height = min(one[3], other[3]) - max(one[1], other[1])
    smaller = min((box[2] - box[0]) * (box[3] - box[1]) for box in (one, other))
    return max(width, 0.0) * max(height, 0.0) / smaller if smaller > 0.0 else 0.0


def _gone_s(config: EventsConfig) -> float:
    """What is gone for longer has gone."""
    return config.persistence_s + _ROUNDING_S


def standing_events(memory: EventMemory, t_s: float, config: EventsConfig) -> tuple[Event, ...]:
    """Warnings that stand in a frame in which nothing is looked at: as they were, until that has lasted too long."""
    recent = [watched for watched in memory.watched.values() if t_s - watched.last_s <= _HIDDEN * _gone_s(config)]
    return tuple(watched.event for watched in recent if watched.event is not None)


def restarted_events(memory: EventMemory) -> EventMemory:
    """Nothing under watch any more, but no number given out twice."""
    return EventMemory(next_event_id=memory.next_event_id)


def is_collision_course(
    row: ClusterRow,
    camera: Camera,
    config: EventsConfig,
    *,
    is_warned: bool,
    is_watched: bool = False,
    on_ground: bool = False,
    closing_of: ClosingOf = unknown_closing,
) -> bool:
    """Whether an object comes close, soon and surely: at the configured confidence, one side each.

    The miss distance is judged in widths of the object from the same state: a fixed ``miss_s`` would mean 6 m at 20 m/s
    and 0.6 m at 2 m/s. A car that brakes hard has no sure time, but comes nearer surely, and straight at us.

    Parameters
    ----------
    is_warned, is_watched : warned of, it may come a little later and miss by a little more; to be watched, only later.
    on_ground : we drive on a road. What is on it is met by a vehicle of usual width that reaches from the camera down
        to the road: what passes below the camera hits it, and a long lorry need not pass as far off as it is long.
    closing_of : tells how the depth of a cluster changes; asked where all depends on that, since it takes its time.
    """
    if row.motion_state not in APPROACHING:
        return False
    if not row.times.tcpa_s[0] > 0.0 or row.state_abc_hz is None:
        return False
    cov = row.present_cov
    if cov is None or not _surety(row.state_abc_hz, cov) > config.confidence:
        return False
    max_ttc_s = config.max_ttc_s * (_KEEP_TTC if is_warned else 1.0)
    max_tcpa_s = config.max_ttc_s * (_KEEP_TTC if is_warned or is_watched else 1.0)
    max_miss_widths = config.max_miss_widths * (_KEEP_MISS if is_warned else 1.0)
    sigmas = float(ndtri(config.confidence))
    return bool(
        _miss_widths(row, row.state_abc_hz, cov, camera, sigmas, on_ground) <= max_miss_widths
        and (row.times.tcpa_s[0] <= max_tcpa_s or _contact_s(closing_of(row.cluster_id)) <= max_ttc_s)
    )


def _contact_s(closing: Closing | None) -> float:
    """Time until contact with what surely closes in ever faster, s; infinite for anything else.

    At constant velocity a car that has just begun to brake seems far away for long.
    """
    if closing is None or not closing.acceleration_hz2 < -_SIGMAS_99 * closing.acceleration_sigma_hz2:
        return math.inf
    return closing.contact_s(_LASTING_S)


def _surety(abc_hz: Floats | None, cov: Floats | None) -> float:
    """Probability that an object comes nearer in depth, by its state now; 0 without one."""
    if abc_hz is None or cov is None:
        return 0.0
    sigma_hz = max(math.sqrt(cov[2, 2]), _TINY)
    return float(ndtr(-float(abc_hz[2]) / sigma_hz))


def _miss_widths(
    row: ClusterRow, abc_hz: Floats, cov: Floats, camera: Camera, sigmas: float, on_ground: bool = False
) -> float:
    """Distance at closest approach over the object's width, so many standard deviations above the best estimate.

    Both in units of depth: how fast the object comes has no part in it, only where to. Where its sides are is seen at
    the height of the reference point, which itself may be at either side: of a lorry that crosses, the end that is
    nearer.
    """
    assert row.ref_px is not None
    (x0_px, top_px, x1_px, bottom_px), y_px = row.box_px, row.ref_px[1]
    x_px = 0.5 * (x0_px + x1_px)
    outline_px = ((x_px, y_px), (x0_px, y_px), (x1_px, y_px), (x_px, top_px), (x_px, bottom_px))
    rays = rays_from_pixels(camera, np.array(outline_px))
    direction = abc_hz / np.linalg.norm(abc_hz)
    basis = tangent_basis(direction)
    return _miss_over_width(rays, abc_hz, cov, basis, sigmas, on_ground, 1.0 / camera.fx_px)


@compiled
def _miss_over_width(
    outline: Floats, abc_hz: Floats, cov: Floats, basis: Floats, sigmas: float, on_ground: bool, least_width: float
) -> float:
    """`_miss_widths` of the rays ``outline (5, 3)`` of a box: its middle, left, right, top and bottom.

    A thing is as high as it is seen: of somebody who walks before a car the feet pass below the camera by three times
    the width. A side at 90 deg or more off the axis (of a fisheye) is nowhere in the plane z = 1: infinitely far.
    ``basis (3, 2)`` are two directions across that of ``abc_hz (3,)``.
    """
    speed = np.sqrt(abc_hz[0] ** 2 + abc_hz[1] ** 2 + abc_hz[2] ** 2)
    dx, dy, dz = abc_hz[0] / speed, abc_hz[1] / speed, abc_hz[2] / speed
    x, y, z = outline[0, 0], outline[0, 1], outline[0, 2]
    # Down across the way that it goes, (0, 1, 0) - dy d, of the squared length 1 - dy^2.
    down2 = (dy * dx) ** 2 + (1.0 - dy * dy) ** 2 + (dy * dz) ** 2
    top, bottom = outline[3, 1], outline[4, 1]
    if down2 >= _TINY and np.isfinite(top) and np.isfinite(bottom):
        # Where the thing passes nearest, up or down within the box.
        nearest = y - (y - dy * (x * dx + y * dy + z * dz)) / down2
        y = min(max(nearest, min(top, y)), max(bottom, y))
    ahead = x * dx + y * dy + z * dz
    off_x, off_y, off_z = x - ahead * dx, y - ahead * dy, z - ahead * dz
    if on_ground and off_y > 0.0:
        # Our own car is below the camera.
        part = (off_y - dy * (off_x * dx + off_y * dy + off_z * dz)) / down2
        off_x, off_y, off_z = off_x + part * dy * dx, off_y - part * (1.0 - dy * dy), off_z + part * dy * dz
    miss = np.sqrt(off_x * off_x + off_y * off_y + off_z * off_z)
    variance = 0.0
    for side in range(2):
        u, v, w = basis[0, side], basis[1, side], basis[2, side]
        if miss > _TINY:
            u, v, w = off_x / miss, off_y / miss, off_z / miss
        total = u * u * cov[0, 0] + v * v * cov[1, 1] + w * w * cov[2, 2]
        total += 2.0 * (u * v * cov[0, 1] + u * w * cov[0, 2] + v * w * cov[1, 2])
        # What is not known stays so.
        variance = variance if total <= variance else total
    # Across its way, with some of our own: a bus that crosses shows its length.
    level = np.sqrt(dx * dx + dz * dz)
    across = min(_WITH_OURS * abs(dz) / level + _LEAST_ACROSS, 1.0) if level > 0.0 else 1.0
    left = outline[1, 0] if np.isfinite(outline[1, 0]) else -np.inf
    right = outline[2, 0] if np.isfinite(outline[2, 0]) else np.inf
    width = across * max(right - left, least_width)
    if on_ground and abs(dz) >= _TINY:
        # The height of the camera above the foot of what moves level to us, in units of its depth.
        height = bottom - dy / dz
        if np.isfinite(height):
            width = min(width, 0.5 * width + _ROOM_HEIGHTS * max(height, 0.0))
    found: float = (miss + sigmas * abs(ahead) / speed * np.sqrt(variance)) / width
    return found


def _started(event_id: int, row: ClusterRow, frame: int, t_s: float) -> Event:
    kind = "constant_bearing" if row.motion_state == MotionState.constant_bearing else "collision_course"
    event = Event(
        event_id,
        kind,
        row.cluster_id,
        frame,
        frame,
        t_s,
        t_s,
        None,
        None,
        None,
        _surety(row.state_abc_hz, row.present_cov),
    )
    return _continued(event, row, frame, t_s)


def _continued(event: Event, row: ClusterRow, frame: int, t_s: float) -> Event:
    tcpa_s, ttc_z_s = float(row.times.tcpa_s[0]), float(row.times.ttc_z_s[0])
    is_nearer = event.min_tcpa_s is None or tcpa_s < event.min_tcpa_s
    ahead = [t for t in (event.min_ttc_z_s, ttc_z_s) if t is not None and t > 0.0]
    return replace(
        event,
        end_frame=frame,
        end_s=t_s,
        min_ttc_z_s=min(ahead) if ahead else None,
        min_tcpa_s=tcpa_s if is_nearer else event.min_tcpa_s,
        miss_s=float(row.times.miss_s[0]) if is_nearer else event.miss_s,
        confidence=_surety(row.state_abc_hz, row.present_cov) if is_nearer else event.confidence,
    )
