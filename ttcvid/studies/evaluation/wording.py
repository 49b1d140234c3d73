"""An evaluation in words and numbers that people read."""

from __future__ import annotations

from collections.abc import Mapping

from ttcvid.config import BodiesConfig
from ttcvid.studies.evaluation.evaluate import ObjectJudged, Sight
from ttcvid.studies.evaluation.metrics import METRICS, Value

_OF_TIMES = ("median", "p90", "bias", "coverage", "half_width", "wrong_sign")
_OF_TRACKS = ("right", "objects_right", "objects_pure", "unassigned")
_PERCENT = ("share", "one_id", *_OF_TIMES, *_OF_TRACKS)
_ANGLES = ("epipole_scene", "epipole_objects", "rotation")
MAX_SHOWN = 10.0
"""Relative errors beyond this are shown as such: how far wrong says nothing any more."""
LEAST_TRACKS = BodiesConfig().min_tracks
"""So many tracks make an object, unless it comes straight at us."""
WARNING_WORDS = {
    "in_time": "warned in time",
    "late": "warned late",
    "missed": "NOT WARNED",
    "not_expected": "collides, warning not due yet",
    "no_collision": "does not collide",
}


def describe_value(metric: str, value: Value) -> str:
    """A value with its unit; shares and relative errors in per cent.

    >>> describe_value("ttc_z.median", 0.0345), describe_value("rotation.median", 0.0021)
    ('3.5 %', '0.0021 deg')
    """
    if value is None:
        return "-"
    group, _, name = metric.partition(".")
    unit = METRICS[metric][0]
    if name in _PERCENT and (name == "share" or group not in _ANGLES):
        return f"{100 * value:.1f} %" if abs(value) <= MAX_SHOWN else f"over {100 * MAX_SHOWN:.0f} %"
    if unit == "deg":
        return f"{value:.2g} deg" if value < 1 else f"{value:.1f} deg"
    text = f"{value:.0f}" if value == int(value) else f"{value:.2f}"
    return text if unit == "1" else f"{text} {unit.removeprefix('1/')}" if unit == "s" else text


def describe_groups(metrics: Mapping[str, Value]) -> list[str]:
    """A line for each group of metrics that has any value."""
    groups: dict[str, list[str]] = {}
    for metric, value in metrics.items():
        group, _, name = metric.partition(".")
        if value is not None:
            groups.setdefault(group, []).append(f"{name} {describe_value(metric, value)}")
    width = max((len(group) for group in groups), default=0)
    return [f"{group:<{width}}  {', '.join(values)}" for group, values in groups.items()]


def describe_object(judged: ObjectJudged) -> str:
    """One line: how often an object was found, its median error of ttc_z, and what became of its warning.

    Of one that was never found: what there was to see of it, and where its tracks went.
    """
    warning = WARNING_WORDS.get(judged.warning, "")
    if judged.found_share == 0:
        result = f"stayed unseen in all of {judged.n_frames} frames{_why_unseen(judged.sight)}"
    else:
        found = f"found in {100 * judged.found_share:.0f} % of {judged.n_frames} frames"
        error = judged.ttc_z_median
        times = "without ttc_z" if error is None else f"ttc_z off by {100 * error:.1f} % (median)"
        result = f"{found}, {times}"
    return f"object {judged.object_id} ({judged.name}): {result}{warning and ', ' + warning}"


def _why_unseen(sight: Sight) -> str:
    """What is known of why an object was not found, with the colon before it; empty where nothing is."""
    reasons = [] if sight.longest_side_px is None else [f"at most {sight.longest_side_px:.0f} px long"]
    if sight.most_tracks is not None:
        few = f" ({LEAST_TRACKS} make an object)" if sight.most_tracks < LEAST_TRACKS else ""
        reasons.append(f"at most {sight.most_tracks} tracks on it{few}")
    if sight.scene_share:
        reasons.append(f"{100 * sight.scene_share:.0f} % of their rows taken for the static scene")
    return f": {', '.join(reasons)}" if reasons else ""
