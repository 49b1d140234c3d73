"""The page of a verdict: what the suite says of the present state, group by group and nuisance by nuisance."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from report import Bar, Report

from scenario_suite.families import FAMILIES
from scenario_suite.figures import FORESEEN_S, LEVEL, SPREAD, Estimate, Figures
from scenario_suite.nuisances import NUISANCES
from scenario_suite.pictures import write_errors, write_worst
from scenario_suite.scoring import LEAST_SIZE_PX, MOTION_SIGMAS, REACHES_US_S, SceneScore
from ttcvid.model import Bools

NONE = "–"
ERRORS_NAME, WORST_NAME = "scenarios_errors.png", "scenarios_worst.jpg"
_ANGLE_BINS_DEG = (50.0, 65.0, 80.0, 95.0)
_N_WORST = 10

Column = tuple[str, Callable[[dict[str, Estimate]], str]]


def percent(name: str) -> Callable[[dict[str, Estimate]], str]:
    """A column of per cent."""
    return lambda figures: shown(figures[name], 100.0)


def plain(name: str) -> Callable[[dict[str, Estimate]], str]:
    """A column of numbers as they are."""
    return lambda figures: shown(figures[name], 1.0)


FOUND: tuple[Column, ...] = (
    ("object-frames", lambda figures: str(figures["found"].n)),
    ("found, %", percent("found")),
    ("tracks wrongly labelled, %", percent("labels_wrong")),
    ("outliers taken in, %", percent("outliers_in")),
    ("false objects a frame", plain("false_per_frame")),
    ("direction, median, deg", plain("direction_median")),
    ("p90", plain("direction_p90")),
)
TIMES: tuple[Column, ...] = tuple(
    column
    for name in ("ttc_z", "tcpa", "miss")
    for column in (
        (f"{name}: n", lambda figures, name=name: str(figures[f"{name}_median"].n)),
        ("median, %", percent(f"{name}_median")),
        ("p90, %", percent(f"{name}_p90")),
        ("in interval, %", percent(f"{name}_coverage")),
    )
)
WARNINGS: tuple[Column, ...] = (
    ("collisions", lambda figures: str(figures["warned"].n)),
    ("warned, %", percent("warned")),
    (">= 2.0 s ahead, %", percent("warned_2s")),
    ("by the trade's limit, %", percent("warned_by_limit")),
    ("lead p10, s", plain("lead_p10")),
    ("median, s", plain("lead_median")),
    ("false warnings", lambda figures: str(figures["false_warnings"].n)),
    ("false in 10 min (95 % bound)", lambda figures: rate(figures["false_warnings"])),
    ("false ids in 1 h", lambda figures: rate(figures["false_ids"])),
)
OWN_MOTION: tuple[Column, ...] = (
    ("rotation, median, deg a frame", plain("rotation_median")),
    ("rotation, p90", plain("rotation_p90")),
    ("direction, median, deg", plain("own_direction_median")),
    ("direction, p90", plain("own_direction_p90")),
    ("ttc_z of the scene's tracks, median %", percent("scene_ttc_z_median")),
    ("p90 of frames, %", percent("scene_ttc_z_p90")),
    ("within 90 %, %", percent("scene_ttc_z_coverage")),
)


def shown(estimate: Estimate, scale: float) -> str:
    """A figure, its spread over scenes in round brackets, a binomial interval in square ones."""
    if not math.isfinite(estimate.value):
        return NONE
    text = number(scale * estimate.value)
    if math.isfinite(estimate.lo):
        text += f" ({number(scale * estimate.lo)}–{number(scale * estimate.hi)})"
    if estimate.bounds is not None:
        text += f" [{number(scale * estimate.bounds[0])}–{number(scale * estimate.bounds[1])}]"
    return text


def rate(estimate: Estimate) -> str:
    """A rate with its Poisson bound."""
    if estimate.bounds is None:
        return NONE
    return f"{number(estimate.value)} (<= {number(estimate.bounds[1])})"


def number(value: float) -> str:
    """Two digits that mean something, never an exponent.

    >>> number(0.01234), number(3.456), number(87.6), number(1234.0)
    ('0.012', '3.5', '88', '1234')
    """
    if value == 0:
        return "0"
    digits = max(0, 1 - math.floor(math.log10(abs(value))))
    return f"{value:.{min(digits, 4)}f}"


def write_page(
    report: Report,
    scores: Sequence[SceneScore],
    smoothed: Sequence[SceneScore],
    sweep: Sequence[SceneScore],
    *,
    docs: Path,
) -> None:
    """All that is said of the suite's scenes.

    ``smoothed`` are the same scenes with ``--smooth``; ``sweep`` those in which one nuisance alone was changed.
    """
    figures = Figures(scores)
    _explain(report, figures)
    _failures(report, figures, sweep)
    _bars(report, figures, Figures(smoothed))
    for kind, name in (("video", "pictures"), ("tracks", "tables of tracks")):
        chosen = (figures.facts.kind == kind).to_numpy()
        if chosen.any():
            _tables(report, f"By group: {name}", "group", _groups(figures, chosen), figures)
    _tables(report, "By family, both kinds together", "family", _families(figures), figures)
    for kind, name in (("video", "pictures"), ("tracks", "tables of tracks")):
        rows = list(_nuisances(figures, kind))
        if rows:
            _tables(report, f"By nuisance: {name}", "nuisance", rows, figures)
    _undetermined(report, scores)
    report.heading("Errors over distance and size")
    write_errors(scores, docs / ERRORS_NAME)
    report.say(f"![Errors and share found over distance and size]({ERRORS_NAME})")
    _worst(report, scores, docs / WORST_NAME)


def _explain(report: Report, figures: Figures) -> None:
    n_failed = int((figures.facts.exit_code != 0).sum())
    kinds = figures.facts.kind.value_counts().to_dict()
    report.heading("How to read it")
    report.say(
        f"{kinds.get('video', 0)} rendered scenes and {kinds.get('tracks', 0)} tables of point tracks; of {n_failed} "
        "the analysis made no result, and these are in no figure below. An object-frame counts where the object is "
        f"larger than {LEAST_SIZE_PX:g} px (geometric mean of its visible box's sides) and its own motion has shifted "
        f"it by more than {MOTION_SIGMAS:g} sigma of the tracks' noise within half a second, or where it is hit within "
        f"{REACHES_US_S:g} s. Times are compared in 1/time, over the object-frames that are found; `evaluate` gives "
        "every definition ([evaluation](evaluation.md)). Outliers are single displaced observations of tracks: taken "
        "in is one that has a body all the same. A false id is an object over nothing true in most of its frames. An "
        "object is on a collision course where it would touch us, however late, if both of us kept the velocities of "
        "that moment. Who walks into our way and stops short of it was on one."
    )
    report.say(
        f"Behind each figure stands, in round brackets, its spread over scenes: {SPREAD[0]:g} to {SPREAD[1]:g} % of "
        f"200 draws of whole scenes with replacement; in square ones the {100 * LEVEL:g} % binomial interval. Frames "
        "of one scene hang together: where the round brackets are the wider ones, it is scenes that are too few. "
        f"False warnings stand with the {100 * LEVEL:g} % Poisson bound. {NONE}: nothing to judge."
    )


def _failures(report: Report, figures: Figures, sweep: Sequence[SceneScore]) -> None:
    """What fails most plainly, first."""
    report.heading("What fails")
    facts = figures.facts
    by_family = {name: figures.over(chosen)["found"] for name, chosen in _families(figures)}
    poor = sorted((one.value, name) for name, one in by_family.items() if one.n >= 20)[:8]
    listed = ", ".join(f"{name} {number(100 * value)} %" for value, name in poor)
    report.say(f"- Families with the smallest share found (20 object-frames or more): {listed}.")
    free = figures.over((facts.group == "free").to_numpy())
    report.say(
        "- A camera that moves freely among movers (hand-held, hovering) takes the wrong ones for the scene: "
        f"{shown(free['found'], 100)} % of object-frames are found, {shown(free['labels_wrong'], 100)} % of tracks "
        f"have the wrong label, own direction errs by {shown(free['own_direction_median'], 1)} deg (median) and "
        f"{shown(free['own_direction_p90'], 1)} deg (p90)."
    )
    if not sweep:
        return
    swept = Figures(sweep)
    report.say(
        "- A camera at rest on a mast, the same scenes at each level of sensor noise (all else at its baseline): "
        "before a background without noise what moves looks noisy, and is not found:"
    )
    noise = swept.facts.nuisances.map(lambda values: values["sensor_noise_grey"])
    rows = [(f"{value:g} grey levels", swept.over((noise == value).to_numpy())) for value in sorted(noise.unique())]
    report.table(
        ["sensor noise", "scenes", *(name for name, _ in FOUND)],
        [
            [name, str(int((noise == float(name.split()[0])).sum())), *(write(one) for _, write in FOUND)]
            for name, one in rows
        ],
    )


def rated(name: str) -> Callable[[dict[str, Estimate]], str]:
    """A column of rates."""
    return lambda figures: rate(figures[name])


@dataclass(frozen=True)
class _Line:
    """A line of the bars: each of the figures ``names``, written as ``column`` does, has to keep the ``bar``."""

    title: str
    names: tuple[str, ...]
    bar: Bar
    column: Callable[[str], Callable[[dict[str, Estimate]], str]] = percent

    @property
    def wanted(self) -> str:
        """The bar in words."""
        return f"{self.bar} %" if self.column is percent else str(self.bar)

    def cells(self, figures: dict[str, Estimate]) -> list[str]:
        """What was measured, and whether that is enough."""
        scale = 100.0 if self.column is percent else 1.0
        is_kept = all(self.bar.is_kept_by(scale * figures[name].value) for name in self.names)
        measured = "; ".join(self.column(name)(figures) for name in self.names)
        return [measured, "kept" if is_kept else "MISSED"]


_LINES = (
    _Line("found", ("found",), Bar(85.0, at_least=True)),
    _Line("ttc_z, median error", ("ttc_z_median",), Bar(5.0)),
    _Line("tcpa, median error", ("tcpa_median",), Bar(5.0)),
    _Line(
        "90 % intervals hold the truth (ttc_z; tcpa; miss)",
        ("ttc_z_coverage", "tcpa_coverage", "miss_coverage"),
        Bar(83.0, at_least=True, most=95.0),
    ),
    _Line("false objects a frame", ("false_per_frame",), Bar(0.05), plain),
    _Line("collisions warned of >= 1.7 s ahead", ("warned_1.7s",), Bar(90.0, at_least=True)),
    _Line(
        f"... of objects larger than {LEAST_SIZE_PX:g} px for {FORESEEN_S:g} s before",
        ("foreseen_warned_1.7s",),
        Bar(90.0, at_least=True),
    ),
    _Line(
        "... and on a collision course for as long, by the velocities of each moment",
        ("on_course_warned_1.7s",),
        Bar(90.0, at_least=True),
    ),
    _Line("false warnings in 10 minutes", ("false_warnings",), Bar(1.0), rated),
    _Line("... of what was on no collision course when they began", ("unfounded_warnings",), Bar(1.0), rated),
)


def _bars(report: Report, figures: Figures, smoothed: Figures) -> None:
    report.heading("Beside the bars")
    report.say(
        "Each frame by itself and what came before it, as `analyze` does without options, and again with the frames "
        "after it (`--smooth`). Warnings are the same with both: they never know what comes. With other objects "
        "around, one may be judged otherwise."
    )
    causal, both_sides = (one.over(np.ones(len(one.scores), bool)) for one in (figures, smoothed))
    report.table(
        ["over all scenes", "has to be", "is", "", "with `--smooth`", ""],
        [[line.title, line.wanted, *line.cells(causal), *line.cells(both_sides)] for line in _LINES],
    )


Part = tuple[str, Bools]


def _tables(report: Report, title: str, what: str, parts: Iterable[Part], figures: Figures) -> None:
    """Four tables, of the same parts each."""
    rows = [(name, int(chosen.sum()), figures.over(chosen)) for name, chosen in parts]
    report.heading(title)
    for columns in (FOUND, TIMES, WARNINGS, OWN_MOTION):
        cells = [[name, str(n), *(write(one) for _, write in columns)] for name, n, one in rows]
        is_said = [row for row in cells if any(cell not in (NONE, "0") for cell in row[2:])]
        if is_said:
            report.table([what, "scenes", *(name for name, _ in columns)], is_said)


def _groups(figures: Figures, of_kind: Bools) -> list[Part]:
    groups = dict.fromkeys(family.group for family in FAMILIES.values())
    parts = [(group, of_kind & (figures.facts.group == group).to_numpy()) for group in groups]
    return [("all", of_kind), *((name, chosen) for name, chosen in parts if chosen.any())]


def _families(figures: Figures) -> list[Part]:
    parts = [(name, (figures.facts.family == name).to_numpy()) for name in FAMILIES]
    return [(name, chosen) for name, chosen in parts if chosen.any()]


def _nuisances(figures: Figures, kind: str) -> Iterable[Part]:
    of_kind = (figures.facts.kind == kind).to_numpy()
    for name in NUISANCES[kind]:  # type: ignore[index]
        values = [label_of(name, one.facts["nuisances"].get(name)) for one in figures.scores]
        for value in sorted({v for v, is_of in zip(values, of_kind, strict=True) if is_of}, key=_order):
            yield f"{name} {value}", of_kind & np.array([v == value for v in values])


def label_of(name: str, value: float | str | None) -> str:
    """The value of a nuisance as the tables have it: angles in bins, errors of the focal length without sign.

    >>> label_of("hfov_deg", 71.3), label_of("focal", -0.05), label_of("hfov_deg", None)
    ('65-80', '0.05', 'own')
    """
    if value is None:
        return "own"
    if isinstance(value, str):
        return value
    if name == "hfov_deg":
        k = int(np.searchsorted(_ANGLE_BINS_DEG, value, side="right"))
        edges = ("", *(f"{edge:g}" for edge in _ANGLE_BINS_DEG), "")
        return f"{edges[k]}-{edges[k + 1]}".strip("-") if 0 < k < len(_ANGLE_BINS_DEG) else _outer(k)
    return f"{abs(value) if name == 'focal' else value:g}"


def _outer(k: int) -> str:
    return f"under {_ANGLE_BINS_DEG[0]:g}" if k == 0 else f"over {_ANGLE_BINS_DEG[-1]:g}"


def _order(label: str) -> tuple[int, float, str]:
    first = label.split("-")[0] if not label.startswith("-") else label
    try:
        return 1, float(first), label
    except ValueError:
        return (2 if label.startswith("over") else 0), 0.0, label


def _undetermined(report: Report, scores: Sequence[SceneScore]) -> None:
    """What is said where nothing can be told."""
    rows = []
    for one in scores:
        expected = one.facts["expected_status"]
        if expected is None or not len(one.frames):
            continue
        status = one.frames.status[1:]
        said = ", ".join(f"{name} {100 * share:.0f} %" for name, share in status.value_counts(normalize=True).items())
        right = f"{100 * (status == expected).mean():.0f} %"
        n_objects, n_warnings = one.facts["n_objects_told"], one.facts["false_warnings"]
        rows.append([one.name, str(one.facts["kind"]), expected, right, said, str(n_objects), f"{n_warnings:.0f}"])
    if rows:
        report.heading("Where nothing can be told")
        header = ["scene", "kind", "status to be told", "told in", "all frames but the first", "objects", "warnings"]
        report.table(header, rows)


def badness(one: SceneScore) -> float:
    """How bad a scene is: each of missed objects, false ones, errors of time, labels, warnings counts up to 1."""
    rows, facts = one.object_frames, one.facts
    due = rows[rows.is_due] if len(rows) else rows
    missed = float(1.0 - due.is_found.mean()) if len(due) else 0.0
    errors = due[due.is_found].ttc_z_error.abs().dropna() if len(due) else due
    wrong_time = min(1.0, float(errors.median())) if len(errors) else 0.0
    false_objects = min(1.0, float(one.frames.n_false.mean())) if len(one.frames) else 0.0
    labels = facts["n_labels_wrong"] / max(facts["n_labels"], 1.0)
    late = float(any(warning["verdict"] in ("missed", "late") for warning in facts["warnings"]))
    return missed + wrong_time + false_objects + labels + late + min(1.0, facts["false_warnings"])


def _worst(report: Report, scores: Sequence[SceneScore], path: Path) -> None:
    rendered = [one for one in scores if one.facts["kind"] == "video" and one.facts["exit_code"] == 0]
    worst = sorted(rendered, key=badness, reverse=True)[:_N_WORST]
    if not worst:
        return
    report.heading(f"The worst {len(worst)} rendered scenes")
    write_worst(worst, path)
    report.say(
        "Added up: share missed, median error of ttc_z, false objects a frame, share of wrong labels, a warning that "
        "is late or missing, false warnings, each up to 1. White: where the object truly is; orange: what was found. "
        "`benchmarks/scenarios.py --show NAME` draws one alone."
    )
    report.say(f"![A frame of each]({path.name})")
    rows = []
    for place, one in enumerate(worst, 1):
        due = one.object_frames[one.object_frames.is_due] if len(one.object_frames) else one.object_frames
        found = f"{100 * due.is_found.mean():.0f} %" if len(due) else NONE
        warned = ", ".join(
            warning["verdict"] + ("" if warning["lead_s"] is None else f" ({warning['lead_s']:.1f} s)")
            for warning in one.facts["warnings"]
        )
        rows.append(
            [
                str(place),
                f"`{one.name}`",
                FAMILIES[one.facts["family"]].title,
                found,
                warned or "no collision",
                f"{one.facts['false_warnings']:.0f}",
                _unusual(one),
            ]
        )
    report.table(
        ["", "scene", "what it is", "found", "warning", "false warnings", "nuisances off their baseline"], rows
    )


def _unusual(one: SceneScore) -> str:
    kind = one.facts["kind"]
    values = one.facts["nuisances"]
    return ", ".join(
        f"{name} {label_of(name, values[name]) if name == 'hfov_deg' else values[name]}"
        for name, nuisance in NUISANCES[kind].items()
        if values[name] != nuisance.baseline
    )
