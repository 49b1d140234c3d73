"""The report of one run, or of several side by side, as one HTML page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ttcvid.draw.wording import CLOSE_TTC_S
from ttcvid.report.contents import RunContents
from ttcvid.report.facts import (
    assumptions,
    compared_facts,
    counts_and_statuses,
    manifest_facts,
    summary_sentences,
    title_of,
)
from ttcvid.report.objects import SeenObjects
from ttcvid.report.pages import render, script
from ttcvid.report.series import MAX_OBJECTS, run_series, thinning


def run_page(runs: Sequence[RunContents]) -> str:
    """The page of one or more runs; it refers to nothing outside itself but their videos.

    At most `MAX_OBJECTS` objects of a run are shown, those warned of first, then those that come soonest.
    """
    described, series = [], []
    for run in runs:
        words, numbers = _run(run, is_one_of_many=len(runs) > 1)
        described.append(words)
        series.append(numbers)
    facts = [compared_facts(run) for run in runs]
    title = " and ".join(dict.fromkeys(title_of(run) for run in runs))
    return render(
        "report.html.j2",
        {"runs": series},
        title=f"{title}: report of {'the analysis' if len(runs) == 1 else 'the analyses'}",
        runs=described,
        compared=[(name, [of_run[name] for of_run in facts]) for name in facts[0]],
        scripts=[script("plots.js"), script("run.js")],
    )


def _run(contents: RunContents, is_one_of_many: bool) -> tuple[dict[str, Any], dict[str, Any]]:
    """What the template says of a run, and the numbers for its plots."""
    objects = SeenObjects(contents)
    shown = objects.ranked[:MAX_OBJECTS]
    found = assumptions(contents)
    words = {
        "title": title_of(contents),
        "name": contents.name,
        "own_page": contents.own_page,
        "is_one_of_many": is_one_of_many,
        "state": contents.manifest["state"],
        "summary": summary_sentences(contents, objects.ranked, objects.warnings),
        "warnings_of_run": [str(warning) for warning in contents.manifest["warnings"]],
        "assumptions": found,
        "is_assumption_weak": any(assumption.is_weak for assumption in found),
        "video": contents.video,
        "objects": shown,
        "warnings": objects.warnings,
        "left_out": _left_out(len(objects.ranked)),
        "close_s": f"{CLOSE_TTC_S:g}",
        "thinning": thinning(contents, shown),
        "counts": counts_and_statuses(contents),
        "facts": manifest_facts(contents),
    }
    return words, run_series(contents, shown)


def _left_out(n_objects: int) -> str:
    if n_objects <= MAX_OBJECTS:
        return ""
    return (
        f"{MAX_OBJECTS} of {n_objects} objects are shown: those warned of, then those that come soonest. The tables "
        "hold all."
    )
