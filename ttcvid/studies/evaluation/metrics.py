"""The numbers of an evaluation: what each is called, its unit and its exact meaning, in one place."""

from __future__ import annotations

import difflib
import operator
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from ttcvid.errors import UsageError
from ttcvid.studies.evaluation.times import TIME_RANGE_S

Value = float | None

_OF_TIME = {
    "n": ("1", "object-frames in which {0} is judged: the object counts, was found, has a value, and abs(true) is "
          f"{TIME_RANGE_S[0]:g} to {TIME_RANGE_S[1]:g} s"),
    "share": ("1", "such object-frames over all that have a true value in that range, found or not"),
    "median": ("1", "median of abs(true / estimate - 1), the error of 1/time"),
    "p90": ("1", "90th percentile of abs(true / estimate - 1)"),
    "bias": ("1", "median of true / estimate - 1; positive: said to come sooner (miss: pass closer) than in truth"),
    "coverage": ("1", "share of 90 % intervals that hold the truth; a null end is unbounded; ttc_z in 1/time"),
    "half_width": ("1", "median of half the 90 % interval over the value, that of ttc_z in 1/time"),
}  # fmt: skip
_WRONG_SIGN = ("1", "share of values with the sign of the opposite: approach said of a recession, or the reverse")
_OF_ANGLE = {
    "n": ("1", "{0} judged"),
    "share": ("1", "share of {0} that have a value"),
    "median": ("deg", "median angle between true and estimated {1}"),
    "p90": ("deg", "90th percentile of that angle"),
}

METRICS: dict[str, tuple[str, str]] = {
    "clip.frames": ("1", "frames that run and truth have in common"),
    "clip.duration_s": ("s", "time that they span, the last picture's own included"),
    "objects.total": ("1", "true objects that count in at least one frame: 100 px^2 and a quarter of them seen"),
    "objects.found": ("1", "those matched in at least half of the frames in which they count"),
    "objects.missed": ("1", "the rest of them"),
    "objects.share": ("1", "matched object-frames over all that count"),
    "objects.one_id": ("1", "matched object-frames with the object's own cluster_id over all matched; one number an "
                       "object, one-to-one over the clip"),
    "objects.false": ("1", "cluster_ids that lie over nothing true, and are said to move, in most of their frames"),
    "objects.false_per_frame": ("1", "rows over nothing true, and said to move, per frame"),
    "objects.doubles_per_frame": ("1", "rows that are a further piece of a true object, per frame"),
    **{f"ttc_z.{key}": (unit, text.format("ttc_z_s")) for key, (unit, text) in _OF_TIME.items()},
    "ttc_z.wrong_sign": _WRONG_SIGN,
    **{f"tcpa.{key}": (unit, text.format("tcpa_s")) for key, (unit, text) in _OF_TIME.items()},
    "tcpa.wrong_sign": _WRONG_SIGN,
    **{f"miss.{key}": (unit, text.format("miss_s")) for key, (unit, text) in _OF_TIME.items()},
    "miss.abs_median_s": ("s", "median of abs(estimate - true) over all matched object-frames, those of a hit too"),
    **{
        f"track_{name}.{key}": (unit, f"as {name}.{key}, over the rows of tracks instead of objects (truth_tracks)")
        for name in ("ttc_z", "tcpa", "miss")
        for key, (unit, _) in (_OF_TIME | {"wrong_sign": _WRONG_SIGN}).items()
        if (name, key) != ("miss", "wrong_sign")
    },
    "track_miss.abs_median_s": ("s", "as miss.abs_median_s, over the rows of tracks"),
    **{f"epipole_scene.{key}": (unit, text.format("frames but the first in which we move", "dir of the static scene"))
       for key, (unit, text) in _OF_ANGLE.items()},
    **{f"epipole_objects.{key}": (unit, text.format("matched object-frames with relative motion", "dir of the object"))
       for key, (unit, text) in _OF_ANGLE.items()},
    **{f"rotation.{key}": (unit, text.format("frames but the first", "rotation since the frame before, as the angle of "
                                             "their difference"))
       for key, (unit, text) in _OF_ANGLE.items()},
    "tracks.n": ("1", "rows of tracks whose true object is known and counts; on outlines, and of displaced "
                 "observations, it is not known"),
    "tracks.right": ("1", "share of them in the right cluster, the static scene among the clusters"),
    "tracks.objects_right": ("1", "share of those on true objects that are in the object's cluster"),
    "tracks.objects_pure": ("1", "share of those in clusters other than the scene that lie on the cluster's object"),
    "tracks.unassigned": ("1", "share of them in no cluster: an error"),
    "tracks.outliers_in": ("1", "share of displaced observations (is_outlier of truth_tracks) in a cluster, the scene "
                           "among them"),
    "events.expected": ("1", "collisions that have to be warned of: contact at most 2 s after the clip, and the object "
                        "in view 2 s before it"),
    "events.true": ("1", "of these, warned of at least 1 s before contact"),
    "events.ahead": ("1", "of the expected, warned of at least 2 s before contact"),
    "events.late": ("1", "of these, warned of later"),
    "events.missed": ("1", "of these, never warned of"),
    "events.false": ("1", "warnings of what does not collide with us, each counted"),
    "events.true_per_10min": ("1/10 min", "events.true per 10 minutes of clip"),
    "events.missed_per_10min": ("1/10 min", "events.missed per 10 minutes of clip"),
    "events.false_per_10min": ("1/10 min", "events.false per 10 minutes of clip"),
    "events.lead_s": ("s", "median time from the first warning to the contact, of the expected that are warned of"),
    "events.lead_p10_s": ("s", "10th percentile of that time"),
}  # fmt: skip
"""Unit and meaning of every metric. One that a truth says nothing of is null."""

_OPERATORS: dict[str, Callable[[float, float], bool]] = {
    ">=": operator.ge,
    "<=": operator.le,
    "==": operator.eq,
    "!=": operator.ne,
    ">": operator.gt,
    "<": operator.lt,
}


@dataclass(frozen=True)
class Check:
    """A condition under which an evaluation fails, as in ``ttc_z.median>0.05``."""

    metric: str
    sign: str
    bound: float

    def holds(self, value: float) -> bool:
        """Whether a value meets the condition."""
        return _OPERATORS[self.sign](value, self.bound)

    def complaint(self, metrics: Mapping[str, Value]) -> str | None:
        """What is wrong, in words; None where nothing is. A metric without a value cannot pass."""
        value = metrics[self.metric]
        if value is None:
            return f"{self.metric} has no value (fails on {self.sign} {self.bound:g})"
        if not self.holds(value):
            return None
        return f"{self.metric} = {value:.4g} (fails on {self.sign} {self.bound:g})"


def check_from_text(text: str, place: str = "--fail-on") -> Check:
    """Read ``NAME SIGN NUMBER``; UsageError, which names ``place``, where it is not that.

    >>> check_from_text("ttc_z.median > 0.05")
    Check(metric='ttc_z.median', sign='>', bound=0.05)
    """
    parts = re.fullmatch(r"\s*([\w.]+)\s*(>=|<=|==|!=|>|<)\s*(\S+)\s*", text)
    if parts is None:
        raise UsageError(
            f"{place} {text!r}: expected a metric, a sign (> >= < <= == !=) and a number, as in 'ttc_z.median>0.05'"
        )
    metric, sign, number = parts.groups()
    if metric not in METRICS:
        nearest = difflib.get_close_matches(metric, METRICS, n=1)
        remedy = f"did you mean {nearest[0]!r}?" if nearest else "'ttcvid evaluate' lists the names"
        raise UsageError(f"{place} {text!r}: unknown metric {metric!r}: {remedy}")
    try:
        bound = float(number)
    except ValueError:
        bound = float("nan")
    if bound != bound or bound in (float("inf"), -float("inf")):
        raise UsageError(f"{place} {text!r}: {number!r} is no finite number: expected one, as in 'ttc_z.median>0.05'")
    return Check(metric, sign, bound)


def markdown_of_metrics() -> str:
    """All metrics as a Markdown table, for the manual."""
    lines = ["| metric | unit | meaning |", "|---|---|---|"]
    lines += [f"| `{name}` | {unit} | {meaning} |" for name, (unit, meaning) in METRICS.items()]
    return "\n".join(lines) + "\n"
