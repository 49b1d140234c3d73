"""Warnings beside true encounters: given in time, late, missed or false."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from ttcvid.model import Ints
from ttcvid.studies.evaluation.times import Numbers, quantile
from ttcvid.studies.evaluation.truth import UNKNOWN_OBJECT

IN_TIME_S = 1.0
"""A warning that starts this long before the contact, or earlier, is in time."""
AHEAD_S = 2.0
"""The time before the contact by which the trade's tests mostly want the warning."""
EXPECTED_WITHIN_S = 2.0
"""A collision has to be warned of if the clip goes on until this long before the contact, and if the object has been
in view for as long before the contact."""


@dataclass(frozen=True)
class WarningsJudged:
    """What became of each object, and the numbers of the list of metrics.

    ``verdict`` by ``object_id``: ``in_time``, ``late``, ``missed``, ``not_expected`` (a collision that does not have to
    be warned of yet) or ``no_collision``. ``lead_s`` is the time from the first warning to the contact, of every object
    that collides and is warned of, whether it has to be or not. ``event_object (N,)`` is the true object that each
    warning is of, ``UNKNOWN_OBJECT`` for none.
    """

    verdict: dict[int, str]
    lead_s: dict[int, float]
    numbers: Numbers
    event_object: Ints


def judge_warnings(
    events: pd.DataFrame, event_object: Ints, encounters: pd.DataFrame, first_seen_s: dict[int, float], end_s: float
) -> WarningsJudged:
    """Hold warnings against encounters.

    Parameters
    ----------
    events : The table of that name: ``start_s``.
    event_object : ``(N,)`` true object that each warning is of, ``UNKNOWN_OBJECT`` for none.
    encounters : ``truth_encounters``: ``object_id, is_collision, t_contact_s``.
    first_seen_s : When each object is first in view.
    end_s : Time of the last picture.

    A warning is false unless its object does collide with us (in the clip or after it).
    """
    hits = encounters[encounters.is_collision.astype(bool)]
    contact_s = dict(zip(hits.object_id.astype(int), hits.t_contact_s.astype(float), strict=True))
    verdict: dict[int, str] = {}
    lead_s: dict[int, float] = {}
    for object_id in encounters.object_id.astype(int):
        if object_id not in contact_s:
            verdict[object_id] = "no_collision"
            continue
        starts_s = events.start_s.to_numpy(float)[event_object == object_id]
        if len(starts_s):
            lead_s[object_id] = float(contact_s[object_id] - starts_s.min())
        seen_for_s = contact_s[object_id] - first_seen_s.get(object_id, np.inf)
        is_expected = contact_s[object_id] <= end_s + EXPECTED_WITHIN_S and seen_for_s >= EXPECTED_WITHIN_S
        verdict[object_id] = _verdict(is_expected, lead_s.get(object_id))
    expected_leads_s = np.array([lead_s[o] for o in verdict if verdict[o] in ("in_time", "late")])
    n_of = {name: float(sum(v == name for v in verdict.values())) for name in ("in_time", "late", "missed")}
    is_false = ~np.isin(event_object, list(contact_s))
    numbers = {
        "expected": sum(n_of.values()),
        "true": n_of["in_time"],
        "late": n_of["late"],
        "missed": n_of["missed"],
        "false": float(is_false.sum()),
        "ahead": float((expected_leads_s >= AHEAD_S).sum()),
        "lead_s": quantile(expected_leads_s, 0.5),
        "lead_p10_s": quantile(expected_leads_s, 0.1),
    }
    return WarningsJudged(verdict, lead_s, numbers, event_object)


def object_of_events(events: pd.DataFrame, found: pd.DataFrame, owner: Ints) -> Ints:
    """The true object ``(N,)`` that each warning's cluster lay over most often while the warning was on.

    ``found`` holds the rows of the objects, ``owner`` the true object of each of these rows.
    """
    result = np.full(len(events), UNKNOWN_OBJECT)
    frame, cluster_id = found.frame.to_numpy(), found.cluster_id.to_numpy()
    for k, event in enumerate(events.itertuples()):
        during = (cluster_id == event.cluster_id) & (frame >= event.start_frame) & (frame <= event.end_frame)
        if during.any():
            names, counts = np.unique(owner[during], return_counts=True)
            result[k] = names[counts.argmax()]
    return result


def _verdict(is_expected: bool, lead_s: float | None) -> str:
    if not is_expected:
        return "not_expected"
    if lead_s is None:
        return "missed"
    return "in_time" if lead_s >= IN_TIME_S else "late"
