"""Figures over many scenes, each with its spread over scenes: what would another draw of as many scenes have said?

The frames of a scene hang together, so the spread comes from drawing whole scenes with replacement (bootstrap). The
binomial interval of a share of frames, which takes each for a draw of its own, is told beside it for coverage: where
it is the wider one, there are too few frames, else too few scenes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.special import chdtri

from scenario_suite.scoring import SceneScore
from ttcvid.model import Bools, Floats, Ints

N_DRAWS, SPREAD = 200, (5.0, 95.0)
"""Draws of the bootstrap, and the percentiles between which the spread lies."""
FORESEEN_S = 2.0
"""An object that was large enough so long before it hits us could be warned of 1.7 s ahead."""
LEVEL = 0.95
"""Of binomial intervals and of Poisson bounds."""
TEN_MINUTES_S, HOUR_S = 600.0, 3600.0


@dataclass(frozen=True)
class Estimate:
    """A figure: ``value`` (NaN: nothing to judge) over ``n`` judged, its spread over scenes ``lo, hi`` (NaN: of one
    scene there is none), and the binomial interval or Poisson bound where it has one.
    """

    value: float
    n: int
    lo: float = np.nan
    hi: float = np.nan
    bounds: tuple[float, float] | None = None


class Figure(ABC):
    """A figure over scenes; ``scenes (S,)`` are their numbers, ``draws (R, S)`` how often each is drawn."""

    @abstractmethod
    def value(self, scenes: Ints) -> tuple[float, int]:
        """The figure over these scenes, NaN where there is nothing to judge, and over how many."""

    @abstractmethod
    def drawn(self, scenes: Ints, draws: Ints) -> Floats:
        """The figure of each draw ``(R,)``, NaN where there is nothing to judge."""

    def bounds(self, scenes: Ints) -> tuple[float, float] | None:
        """Binomial interval or Poisson bound."""
        return None

    def estimate(self, scenes: Ints, draws: Ints) -> Estimate:
        """The figure with its spread."""
        value, n = self.value(scenes)
        if not np.isfinite(value):
            return Estimate(np.nan, 0)
        lo, hi = _spread(self.drawn(scenes, draws), len(scenes))
        return Estimate(value, n, lo, hi, self.bounds(scenes))


@dataclass(frozen=True)
class Share(Figure):
    """Sums of a numerator over those of a denominator ``(S,)``, scene by scene."""

    part: Floats
    whole: Floats
    is_coverage: bool = False

    def value(self, scenes: Ints) -> tuple[float, int]:
        """See `Figure`."""
        whole = self.whole[scenes].sum()
        return (float(self.part[scenes].sum() / whole) if whole else np.nan), round(whole)

    def drawn(self, scenes: Ints, draws: Ints) -> Floats:
        """See `Figure`."""
        return _ratio(draws @ self.part[scenes], draws @ self.whole[scenes])

    def bounds(self, scenes: Ints) -> tuple[float, float] | None:
        """Wilson's interval of a coverage."""
        if not self.is_coverage:
            return None
        # Here only: scipy.stats takes two seconds to import, and most of what imports this module asks for no interval.
        from scipy.stats import binomtest

        counts = round(self.part[scenes].sum()), round(self.whole[scenes].sum())
        interval = binomtest(*counts).proportion_ci(LEVEL, method="wilson")
        return float(interval.low), float(interval.high)


@dataclass(frozen=True)
class Percentile(Figure):
    """A percentile of values ``(N,)``, each of the scene ``scene (N,)``."""

    values: Floats
    scene: Ints
    share: float

    def value(self, scenes: Ints) -> tuple[float, int]:
        """See `Figure`."""
        values, _ = self._sorted(scenes)
        return _weighted(values, np.ones(len(values)), self.share), len(values)

    def drawn(self, scenes: Ints, draws: Ints) -> Floats:
        """See `Figure`."""
        values, place = self._sorted(scenes)
        return np.array([_weighted(values, weights, self.share) for weights in draws[:, place]])

    def _sorted(self, scenes: Ints) -> tuple[Floats, Ints]:
        """The values of these scenes, ascending, and the place of the scene of each among them."""
        column = np.full(int(max(self.scene.max(initial=-1), scenes.max(initial=-1))) + 1, -1)
        column[scenes] = np.arange(len(scenes))
        place = column[self.scene]
        values, place = self.values[place >= 0], place[place >= 0]
        order = np.argsort(values, kind="stable")
        return values[order], place[order]


@dataclass(frozen=True)
class Rate(Figure):
    """Events per ``unit_s`` of clip, with the one-sided Poisson bound above; over how many: the events."""

    events: Floats
    duration_s: Floats
    unit_s: float

    def value(self, scenes: Ints) -> tuple[float, int]:
        """See `Figure`."""
        units = self.duration_s[scenes].sum() / self.unit_s
        events = float(self.events[scenes].sum())
        return (events / units if units else np.nan), round(events)

    def drawn(self, scenes: Ints, draws: Ints) -> Floats:
        """See `Figure`."""
        return _ratio(draws @ self.events[scenes], draws @ self.duration_s[scenes] / self.unit_s)

    def bounds(self, scenes: Ints) -> tuple[float, float] | None:
        """From 0 to the bound of Poisson."""
        units = self.duration_s[scenes].sum() / self.unit_s
        return 0.0, at_most(self.events[scenes].sum()) / units


def at_most(n_events: float) -> float:
    """The mean number of events that is excluded with 95 % if ``n_events`` came (Poisson).

    >>> round(at_most(0), 2)
    3.0
    """
    return float(chdtri(2 * (n_events + 1), 1.0 - LEVEL) / 2)


def draws_of(n_scenes: int) -> Ints:
    """How often each of some scenes is drawn, with replacement: (R, S), the same every time."""
    shares = np.full(n_scenes, 1.0 / max(n_scenes, 1))
    none = np.zeros((N_DRAWS, 0), dtype=np.int64)
    return np.random.default_rng(n_scenes).multinomial(n_scenes, shares, N_DRAWS) if n_scenes else none


class Figures:
    """All figures of a set of scenes, and of any part of it."""

    def __init__(self, scores: Sequence[SceneScore]) -> None:
        self.scores = tuple(scores)
        self.facts = pd.DataFrame([dict(one.facts) for one in self.scores])
        self._of = _figures(self.scores)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the figures."""
        return tuple(self._of)

    def over(self, chosen: Bools) -> dict[str, Estimate]:
        """Every figure over the chosen scenes ``(S,)``, by name; the same scenes always give the same."""
        scenes = np.flatnonzero(chosen)
        draws = draws_of(len(scenes))
        return {name: figure.estimate(scenes, draws) for name, figure in self._of.items()}

    def drawn(self, name: str, chosen: Bools) -> Floats:
        """One figure over each draw ``(R,)`` of the chosen scenes; as many scenes always give the same draws."""
        scenes = np.flatnonzero(chosen)
        return self._of[name].drawn(scenes, draws_of(len(scenes)))


def _figures(scores: Sequence[SceneScore]) -> dict[str, Figure]:
    rows = _stacked([one.object_frames for one in scores])
    frames = _stacked([one.frames for one in scores])
    n = len(scores)
    found = rows[rows.is_due & rows.is_found] if len(rows) else rows
    figures: dict[str, Figure] = {
        "found": Share(_sums(rows, "is_found", rows.is_due, n), _sums(rows, "is_due", rows.is_due, n)),
        "labels_wrong": Share(_facts(scores, "n_labels_wrong"), _facts(scores, "n_labels")),
        "outliers_in": Share(_facts(scores, "n_outliers_in"), _facts(scores, "n_outliers")),
        "false_per_frame": Share(_sums(frames, "n_false", None, n), _sums(frames, "one", None, n)),
        "direction_median": _percentile(found, "direction_deg", 0.5),
        "direction_p90": _percentile(found, "direction_deg", 0.9),
    }
    for name in ("ttc_z", "tcpa", "miss"):
        judged = found[found[f"{name}_error"].notna()]
        figures[f"{name}_median"] = _percentile(judged, f"{name}_error", 0.5)
        figures[f"{name}_p90"] = _percentile(judged, f"{name}_error", 0.9)
        within, all_ = _sums(judged, f"{name}_within", None, n), _sums(judged, "one", None, n)
        figures[f"{name}_coverage"] = Share(within, all_, is_coverage=True)
    figures |= figures_of_warnings(scores)
    figures["rotation_median"] = _percentile(frames, "rotation_deg", 0.5)
    figures["rotation_p90"] = _percentile(frames, "rotation_deg", 0.9)
    figures["own_direction_median"] = _percentile(frames, "epipole_deg", 0.5)
    figures["own_direction_p90"] = _percentile(frames, "epipole_deg", 0.9)
    of_scene = frames[frames.scene_ttc_z_error.notna()]
    figures["scene_ttc_z_median"] = _percentile(of_scene, "scene_ttc_z_error", 0.5)
    figures["scene_ttc_z_p90"] = _percentile(of_scene, "scene_ttc_z_error", 0.9)
    counts = (_sums(of_scene, name, None, n) for name in ("n_scene_ttc_z_within", "n_scene_ttc_z"))
    figures["scene_ttc_z_coverage"] = Share(*counts)
    return figures


def figures_of_warnings(scores: Sequence[SceneScore]) -> dict[str, Figure]:
    """Of collisions that have to be warned of: the share that is, and how long before."""
    expected = [
        (k, warning["lead_s"], warning["large_for_s"], warning["on_course_for_s"])
        for k, one in enumerate(scores)
        for warning in one.facts.get("warnings", ())
        if warning["verdict"] in ("in_time", "late", "missed")
    ]
    scene = np.array([k for k, *_ in expected], dtype=np.int64)
    lead_s = np.array([np.nan if lead is None else lead for _, lead, *_ in expected], dtype=float)
    is_large = np.array([large_for_s for *_, large_for_s, _ in expected], dtype=float) >= FORESEEN_S
    is_on_course = np.array([on_course_for_s for *_, on_course_for_s in expected], dtype=float) >= FORESEEN_S
    limit_s = np.array([scores[k].facts["warn_by_s"] for k in scene], dtype=float)
    n = len(scores)

    def share(is_so: Bools, of: Bools) -> Share:
        counts = (np.bincount(scene, which.astype(float), n) for which in (is_so & of, of))
        return Share(*counts, is_coverage=True)

    everything = np.ones(len(scene), dtype=bool)
    with np.errstate(invalid="ignore"):
        figures: dict[str, Figure] = {
            "warned": share(np.isfinite(lead_s), everything),
            "warned_1.7s": share(lead_s >= 1.7, everything),
            "warned_2s": share(lead_s >= 2.0, everything),
            "warned_by_limit": share(lead_s >= limit_s, everything),
            "foreseen_warned_1.7s": share(lead_s >= 1.7, is_large),
            "on_course_warned_1.7s": share(lead_s >= 1.7, is_large & is_on_course),
        }
    is_warned = np.isfinite(lead_s)
    figures["lead_p10"] = Percentile(lead_s[is_warned], scene[is_warned], 0.1)
    figures["lead_median"] = Percentile(lead_s[is_warned], scene[is_warned], 0.5)
    duration_s = _facts(scores, "analysed_s")
    figures["false_warnings"] = Rate(_facts(scores, "false_warnings"), duration_s, TEN_MINUTES_S)
    n_unfounded = _facts(scores, "false_warnings") - _facts(scores, "averted_warnings")
    figures["unfounded_warnings"] = Rate(n_unfounded, duration_s, TEN_MINUTES_S)
    figures["false_ids"] = Rate(_facts(scores, "false_ids"), duration_s, HOUR_S)
    return figures


def _stacked(tables: Sequence[pd.DataFrame]) -> pd.DataFrame:
    parts = [table.assign(scene=k, one=1.0) for k, table in enumerate(tables) if len(table)]
    stacked = pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=["scene", "one"])
    return stacked.reindex(columns=stacked.columns.union(_COLUMNS, sort=False))


_COLUMNS = (
    *("is_due", "is_found", "direction_deg", "n_false", "rotation_deg", "epipole_deg", "size_px", "distance_m"),
    *("scene_ttc_z_error", "n_scene_ttc_z", "n_scene_ttc_z_within"),
    *(f"{name}_{what}" for name in ("ttc_z", "tcpa", "miss") for what in ("error", "within")),
)


def _sums(rows: pd.DataFrame, column: str, chosen: pd.Series | None, n_scenes: int) -> Floats:
    rows = rows if chosen is None else rows[chosen.astype(bool)]
    scene, values = rows.scene.to_numpy(np.int64), rows[column].to_numpy(float)
    return np.bincount(scene, values, n_scenes).astype(float)


def _facts(scores: Sequence[SceneScore], name: str) -> Floats:
    return np.array([float(one.facts.get(name, 0.0)) for one in scores])


def _percentile(rows: pd.DataFrame, column: str, share: float) -> Percentile:
    rows = rows[rows[column].notna()]
    return Percentile(np.abs(rows[column].to_numpy(float)), rows.scene.to_numpy(np.int64), share)


def _ratio(part: Floats, whole: Floats) -> Floats:
    """NaN where the whole is zero."""
    return np.divide(part, whole, out=np.full(len(whole), np.nan), where=whole > 0)


def _weighted(values: Floats, weights: Floats, share: float) -> float:
    """The first of the ascending values that ``share`` of the weights do not exceed; NaN without weight."""
    total = np.cumsum(weights)
    if not len(total) or total[-1] == 0:
        return np.nan
    return float(values[np.searchsorted(total, share * total[-1] - 1e-9)])


def _spread(drawn: Floats, n_scenes: int) -> tuple[float, float]:
    drawn = drawn[np.isfinite(drawn)]
    if n_scenes < 2 or len(drawn) == 0:
        return np.nan, np.nan
    lo, hi = np.percentile(drawn, SPREAD)
    return float(lo), float(hi)
