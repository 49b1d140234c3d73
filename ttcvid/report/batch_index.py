"""The index page of a batch: what became of each clip, with a link to its report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from urllib.parse import quote

from ttcvid.report.pages import render_still

GENERATOR = "ttcvid batch"
"""Stands in the page's head, and tells it from the pages of others."""

_STATES = ("complete", "truncated", "failed", "pending")


@dataclass(frozen=True)
class IndexRow:
    """One clip of the page.

    ``target`` is the file or folder that its name leads to, relative to the page; None: to nothing. ``time_s`` is the
    smallest time to collision with its 90 % interval, in s.
    """

    clip: str
    state: str
    target: str | None
    reason: str = ""
    n_frames: int | None = None
    n_objects: int | None = None
    n_events: int | None = None
    time_s: tuple[float, float, float] | None = None
    warnings: tuple[str, ...] = ()

    @property
    def link(self) -> str | None:
        """The target as a relative address: a name may hold what means something in one."""
        return None if self.target is None else quote(self.target)


def batch_page(title: str, rows: Sequence[IndexRow]) -> str:
    """The page as HTML: one file that needs nothing else. What ``rows`` say is text, whatever it looks like."""
    counts = {state: sum(row.state == state for row in rows) for state in _STATES}
    return render_still(
        "batch_index.html.j2",
        title=title,
        generator=GENERATOR,
        rows=rows,
        states={state: n for state, n in counts.items() if n},
        n_frames=sum(row.n_frames or 0 for row in rows),
        n_events=sum(row.n_events or 0 for row in rows),
    )
