"""What the annotated picture says about a cluster, in as few signs as can be read at a glance."""

from __future__ import annotations

from enum import IntEnum

from ttcvid.draw.palette import BLACK, CLOSE, DARK, MUTED_INK, WARNING, WHITE, Colour
from ttcvid.model import APPROACHING, ClusterRow, Event, FrameResult, MotionState

CLOSE_TTC_S = 4.0  # from here on an approach is marked, warned of or not
LONGEST_TTC_S = 99.0  # longer ones are written as this
TIGHT_INTERVAL = 0.15  # relative half-width up to which the value can stand alone

NOT_IN_VIEW = "not in view"
_STATE_WORDS = {
    MotionState.receding: "away",
    MotionState.no_relative_motion: "same speed",
    MotionState.unknown: "?",
}


class Urgency(IntEnum):
    """How loud a cluster is drawn; ``untold`` is one of which it is open whether it approaches."""

    untold = 0
    calm = 1
    close = 2
    warned = 3


BACKINGS: dict[Urgency, Colour] = {
    Urgency.untold: DARK,
    Urgency.calm: DARK,
    Urgency.close: CLOSE,
    Urgency.warned: WARNING,
}
INKS: dict[Urgency, Colour] = {
    Urgency.untold: MUTED_INK,
    Urgency.calm: WHITE,
    Urgency.close: BLACK,
    Urgency.warned: WHITE,
}


def urgency_of(cluster: ClusterRow, events: tuple[Event, ...]) -> Urgency:
    """Warned where an event is active, close where the approach is certain and `CLOSE_TTC_S` or less away."""
    if any(event.cluster_id == cluster.cluster_id for event in events):
        return Urgency.warned
    if cluster.motion_state is MotionState.unknown:
        return Urgency.untold
    ttc_s, lo_s, hi_s = _ttc_z(cluster)
    is_approach = cluster.motion_state in APPROACHING
    is_certain = not lo_s > hi_s
    return Urgency.close if is_approach and is_certain and 0 < ttc_s <= CLOSE_TTC_S else Urgency.calm


def by_urgency(result: FrameResult) -> list[ClusterRow]:
    """The objects of a frame, the most urgent first; those without a rank last, by number."""
    objects = [cluster for cluster in result.clusters if cluster.role == "object"]
    return sorted(objects, key=lambda row: (row.urgency_rank is None, row.urgency_rank or 0, row.cluster_id))


def time_text(cluster: ClusterRow) -> str:
    """``2.4 s`` where the 90 % interval is tight, ``2.1-3.9 s`` where not, ``>2.1 s`` where it runs through infinity.

    A cluster that does not approach gets a word instead of a time.
    """
    if cluster.motion_state in _STATE_WORDS:
        return _STATE_WORDS[cluster.motion_state]
    ttc_s, lo_s, hi_s = _ttc_z(cluster)
    if lo_s > hi_s:
        return f">{seconds(lo_s)} s"
    if not ttc_s > 0:
        return "-"
    if hi_s - lo_s > 2 * TIGHT_INTERVAL * ttc_s:
        return f"{seconds(max(lo_s, 0.0))}-{seconds(hi_s)} s"
    return f"{seconds(ttc_s)} s"


def interval_text(cluster: ClusterRow) -> str:
    """``2.1-2.8`` beside a time that stands alone; empty where there is no interval or `time_text` shows it."""
    _, lo_s, hi_s = _ttc_z(cluster)
    is_shown = "-" in time_text(cluster) or ">" in time_text(cluster)
    if is_shown or cluster.motion_state in _STATE_WORDS or not lo_s <= hi_s:
        return ""
    return f"{seconds(max(lo_s, 0.0))}-{seconds(hi_s)}"


def seconds(value_s: float) -> str:
    """A time in two or three signs: ``2.4``, ``14``, ``99+``."""
    if not value_s <= LONGEST_TTC_S:
        return f"{LONGEST_TTC_S:.0f}+"
    return f"{value_s:.1f}" if value_s < 9.95 else f"{value_s:.0f}"


def unseen_text(unseen_s: float) -> str:
    """Of an object that is hidden while its warning goes on: how long ago it was seen."""
    return f"seen {seconds(unseen_s)} s ago"


def banner_text(event: Event, said_of_it: str) -> str:
    """The line across the picture while a warning is active: its kind, its object and what is said of that."""
    return f"{event.kind.replace('_', ' ').upper()} #{event.cluster_id}  {said_of_it}"


def _ttc_z(cluster: ClusterRow) -> tuple[float, float, float]:
    """ttc_z with the ends of its interval, NaN where there is none."""
    times = cluster.times
    return float(times.ttc_z_s[0]), float(times.ttc_z_lo_s[0]), float(times.ttc_z_hi_s[0])
