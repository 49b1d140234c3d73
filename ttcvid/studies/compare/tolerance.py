"""How far two results may lie apart before they count as different: per column, per part of the tables, per object.

Defaults are made for one clip analysed twice. What another seed, another number of threads or another machine changes
is a few tracks at the edge of a group, and with them a few rows; what another camera, another clip or a fault of the
program changes is most rows of a column. So a row is judged by its column's tolerance, and a column by how many rows
lie outside, and by how large the typical difference is.
"""

from __future__ import annotations

import difflib
import fnmatch
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field, ValidationError

from ttcvid.config import Fraction, PositiveFloat, StageConfig
from ttcvid.errors import UsageError, quoted
from ttcvid.schema import TABLES

Share = Annotated[float, Field(ge=0, le=1)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class ColumnTolerance(StageConfig):
    """A row counts as different where the difference exceeds each of the three.

    ``abs`` is in the column's unit (ttc_z_s and its ends: 1/s, for they are judged as 1/time), ``rel`` a share of the
    larger of both values, ``sigmas`` a multiple of the standard deviation that the baseline reports beside the value.
    ``max_share`` and ``typical`` stand for those of the column's part where they are given. With ``may_be_null``, a
    value on one side only is no difference.
    """

    abs: NotNegative = 0.0
    rel: NotNegative = 0.0
    sigmas: NotNegative = 0.0
    max_share: Share | None = None
    typical: NotNegative | None = None
    may_be_null: bool = False


class PartTolerance(StageConfig):
    """When a column counts as different.

    Where more rows than ``max_share`` do, or where the median of difference over tolerance exceeds ``typical``.
    """

    max_share: Share = 0.02
    typical: NotNegative = 0.25


class ObjectTolerance(StageConfig):
    """Which objects have to be there again, and what being there means.

    An object counts if it carries a warning, if it certainly approaches and is nearer in time than ``warn_s``,
    or if it is large enough. Of all others only their number is judged.
    """

    min_frames: int = Field(default=8, ge=1, description="an object counts by itself from so many frames on")
    min_tracks: int = Field(default=10, ge=1, description="and so many tracks (median over its frames)")
    warn_s: NotNegative = Field(default=4.0, description="it counts whatever its size, where it certainly comes sooner")
    min_found: Share = Field(default=0.5, description="share of an object's frames in which it has to be there again")
    min_one_number: Share = Field(default=0.8, description="share of those frames in which it has one number")
    rate_sigmas: NotNegative = Field(
        default=3.0, description="frames of all other objects that are gone or new, in standard deviations of the count"
    )


class EventTolerance(StageConfig):
    """Which warnings have to be there again."""

    min_duration_s: NotNegative = Field(default=0.25, description="warnings shorter than this may come and go")


class FrameTolerance(StageConfig):
    """Which frames of two runs are the same, and which tracks in them."""

    max_dt: Fraction = Field(default=0.25, description="frames are the same within this share of the frame interval")
    max_distance_px: PositiveFloat = Field(default=1.0, description="tracks are the same within this distance")
    min_joined: Share = Field(default=0.9, description="share of tracks that have to be there again")


def _same(tolerance: ColumnTolerance, table: str, *names: str) -> dict[str, ColumnTolerance]:
    return {f"{table}.{name}": tolerance for name in names}


def _times(table: str) -> dict[str, ColumnTolerance]:
    """Times and their intervals, alike for tracks and clusters: a tenth of a per cent of what can be known."""
    ends = ("", "_lo", "_hi")
    return {
        **_same(ColumnTolerance(abs=0.002, rel=0.02, sigmas=1), table, *(f"ttc_z{end}_s" for end in ends)),
        **_same(ColumnTolerance(abs=0.02, rel=0.02, sigmas=1), table, *(f"tcpa{end}_s" for end in ends)),
        **_same(ColumnTolerance(abs=0.02, rel=0.02, sigmas=1), table, *(f"miss{end}_s" for end in ends)),
    }


_COVARIANCE = ColumnTolerance(sigmas=0.5)
"""Of what the two standard deviations beside it allow."""
_PLACE = ColumnTolerance(abs=0.5)
_COUNT = ColumnTolerance(abs=2, rel=0.1)
_EXACT = ColumnTolerance()

DEFAULT_COLUMNS: dict[str, ColumnTolerance] = {
    **_same(ColumnTolerance(abs=0.001), "frames", "t_s", "dt_s"),
    **_same(_COUNT, "frames", "n_tracks"),
    **_same(ColumnTolerance(abs=1, max_share=0.3), "frames", "n_clusters"),
    **_same(ColumnTolerance(abs=2e-5, sigmas=1), "frames", "rot_x_rad", "rot_y_rad", "rot_z_rad"),
    **_same(ColumnTolerance(rel=0.25), "frames", "rot_sigma_rad"),
    # Of the nearest object, however few tracks it has; objects that count are judged themselves.
    **_same(ColumnTolerance(abs=0.002, rel=0.05, max_share=0.5, typical=1, may_be_null=True), "frames", "min_ttc_z_s"),
    **_same(ColumnTolerance(abs=1e-3, sigmas=1), "epipoles", "dir_x", "dir_y", "dir_z"),
    **_same(_COVARIANCE, "epipoles", *(f"cov_{ij}" for ij in ("xx", "xy", "xz", "yy", "yz", "zz"))),
    **_same(ColumnTolerance(abs=0.5, sigmas=1), "epipoles", "x_px", "y_px", "horizon_offset_px"),
    **_same(_COUNT, "epipoles", "n_tracks"),
    **_same(_COUNT, "clusters", "n_tracks"),
    **_same(ColumnTolerance(abs=5), "clusters", "x0_px", "y0_px", "x1_px", "y1_px", "ref_x_px", "ref_y_px"),
    **_same(ColumnTolerance(abs=1e-3, rel=0.01, sigmas=1), "clusters", "a_hz", "b_hz", "c_hz"),
    # From the change of distances between single points: no sigma is stated, and it hangs on which points there are.
    **_same(ColumnTolerance(abs=0.02, rel=0.1, max_share=0.5), "clusters", "expansion_hz"),
    **_same(_COVARIANCE, "clusters", *(f"cov_{ij}" for ij in ("aa", "ab", "ac", "bb", "bc", "cc"))),
    **_times("clusters"),
    **_same(ColumnTolerance(abs=1), "clusters", "urgency_rank"),
    **_same(_PLACE, "collision_times", "x_px", "y_px"),
    **_same(ColumnTolerance(max_share=0.05), "collision_times", "cluster_id"),
    **_same(ColumnTolerance(abs=1), "collision_times", "n_frames"),
    **_same(ColumnTolerance(abs=2e-3), "collision_times", "alpha_rad"),
    **_same(ColumnTolerance(abs=0.5, rel=0.02, sigmas=1), "collision_times", "k_frames"),
    **_times("collision_times"),
    **_same(ColumnTolerance(abs=0.25), "events", "start_s", "end_s"),
    **_same(ColumnTolerance(rel=0.1), "events", "min_ttc_z_s", "min_tcpa_s"),
    **_same(ColumnTolerance(abs=0.1, rel=0.1), "events", "miss_s"),
    **_same(ColumnTolerance(abs=0.02), "events", "confidence"),
}
"""By ``table.column``; names that are not here (status, state, kind ...) have to be the same."""

DEFAULT_PARTS: dict[str, PartTolerance] = {
    "frames": PartTolerance(max_share=0.05),
    "epipoles.scene": PartTolerance(max_share=0.05),
    "epipoles.objects": PartTolerance(max_share=0.4, typical=0.5),
    "clusters.scene": PartTolerance(max_share=0.05),
    "clusters.objects": PartTolerance(max_share=0.4, typical=0.5),
    "collision_times": PartTolerance(max_share=0.1),
    "events": PartTolerance(max_share=0.0, typical=1.0),
}

"""The tables; those with a row per cluster in two parts: objects are found less certainly than the scene."""

NOT_JUDGED = ("frame", "t_s", "track_id", "cluster_id", "motion_id", "event_id", "role", "start_frame", "end_frame")
"""What rows are joined by, and numbers that may be assigned again; the clusters of tracks are judged even so."""


class Tolerance(StageConfig):
    """All tolerances of a comparison; made by `tolerance_from`."""

    columns: dict[str, ColumnTolerance] = DEFAULT_COLUMNS
    parts: dict[str, PartTolerance] = DEFAULT_PARTS
    objects: ObjectTolerance = ObjectTolerance()
    events: EventTolerance = EventTolerance()
    frames: FrameTolerance = FrameTolerance()

    def of_column(self, part: str, column: str) -> ColumnTolerance:
        """The tolerance of a column of a part; names and what is not listed have to be the same."""
        return self.columns.get(f"{part.partition('.')[0]}.{column}", _EXACT)


def tolerance_from(content: Any, place: str) -> Tolerance:
    """The tolerances of a file's ``content``, laid over the defaults; UsageError that names ``place`` and the field.

    Names of columns (``frames.rot_x_rad``) and parts (``epipoles.objects``) may be patterns (``clusters.*``, ``*``). An
    entry replaces all values of a column, but only those given of a part.

    >>> tolerance_from({"columns": {"frames.rot_*": {"abs": 0.1}}}, "file").of_column("frames", "rot_x_rad").sigmas
    0.0
    """
    content = {} if content is None else content
    if not isinstance(content, Mapping):
        raise UsageError(f"{place}: expected sections such as 'columns:', found {quoted(content)}")
    sections = dict(content)
    try:
        columns = {name: ColumnTolerance.model_validate(v) for name, v in _section(sections, "columns", place)}
        given = dict(_section(sections, "parts", place))
        for value in given.values():
            PartTolerance.model_validate(value)
        rest = Tolerance.model_validate({k: v for k, v in sections.items() if k not in ("columns", "parts")})
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(map(str, first["loc"]))
        found = quoted(first["input"])
        raise UsageError(f"{place}: field {where!r} = {found}: {first['msg']}: mend the file") from None
    known = {f"{table}.{column.name}" for table, of_table in TABLES.items() for column in of_table}
    merged = dict(DEFAULT_COLUMNS)
    for pattern, tolerance in columns.items():
        merged |= dict.fromkeys(_matching(pattern, known, place), tolerance)
    parts = dict(DEFAULT_PARTS)
    for pattern, values in given.items():
        for name in _matching(pattern, set(DEFAULT_PARTS), place):
            parts[name] = PartTolerance(**{**parts[name].model_dump(), **values})
    return rest.model_copy(update={"columns": merged, "parts": parts})


def _section(sections: Mapping[str, Any], name: str, place: str) -> list[tuple[str, Any]]:
    section = sections.get(name) or {}
    if not isinstance(section, Mapping):
        raise UsageError(f"{place}: field {name!r}: expected names with their tolerances, found {quoted(section)}")
    return [(str(key), value if value is not None else {}) for key, value in section.items()]


def _matching(pattern: str, known: set[str], place: str) -> list[str]:
    names = fnmatch.filter(known, pattern)
    if not names:
        nearest = difflib.get_close_matches(pattern, known, n=1)
        remedy = f"did you mean {nearest[0]!r}?" if nearest else f"expected one of {', '.join(sorted(known))}"
        raise UsageError(f"{place}: {pattern!r} is no column or part of a table: {remedy}")
    return names


def markdown_of_tolerances() -> str:
    """The default tolerances of all numbers as a Markdown table, for the manual."""
    lines = ["| column | unit | `abs` | `rel` | `sigmas` | |", "|---|---|---|---|---|---|"]
    units = {f"{table}.{column.name}": column.unit for table, columns in TABLES.items() for column in columns}
    for name, tolerance in DEFAULT_COLUMNS.items():
        unit = "1/s" if "ttc_z" in name else units[name]
        numbers = [f"{value:g}" if value else "" for value in (tolerance.abs, tolerance.rel, tolerance.sigmas)]
        own = {"max_share": tolerance.max_share, "typical": tolerance.typical}
        notes = [f"`{key}` {value:g}" for key, value in own.items() if value is not None]
        notes += ["`may_be_null`"] if tolerance.may_be_null else []
        lines.append(f"| `{name}` | {unit} | {' | '.join(numbers)} | {', '.join(notes)} |")
    return "\n".join(lines) + "\n"
