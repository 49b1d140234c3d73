"""The tables of a result: columns, types, units, descriptions and version, in one place.

Everything else follows from here: the Parquet files take their schema from `table_schema`, the manual takes its
tables from `markdown_of`. A change of a column's name, type, unit or meaning raises `SCHEMA_VERSION`.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import pyarrow as pa

from ttcvid.model import FrameStatus, MotionState, Status

SCHEMA_VERSION = "1"
VERSION_KEY = "ttcvid_schema_version"
TABLE_KEY = "ttcvid_table"

# Names that come from a fixed list are stored as dictionaries: small on disk, categories in pandas.
_NAME = pa.dictionary(pa.int8(), pa.string())
# The types of pandas in which a null stays NA, instead of turning whole numbers into floats and NaN.
_PANDAS_TYPES = {
    pa.int32(): "Int32",
    pa.int64(): "Int64",
    pa.float64(): "Float64",
    pa.bool_(): "boolean",
    pa.string(): "string",
}
STATUS_NAMES = tuple(status.name for status in Status)
FRAME_STATUS_NAMES = tuple(status.value for status in FrameStatus)
MOTION_STATE_NAMES = tuple(state.value for state in MotionState)
ROLE_NAMES = ("scene", "object")
EVENT_KINDS = ("collision_course", "constant_bearing")


@dataclass(frozen=True)
class Column:
    """One column: ``unit`` is empty for names and ``1`` for pure numbers; ``values`` lists what a name can be."""

    name: str
    type: pa.DataType
    unit: str
    description: str
    nullable: bool = False
    values: tuple[str, ...] = ()

    def field(self) -> pa.Field[Any]:
        """The column as an Arrow field, with unit and description as its metadata."""
        metadata: dict[str | bytes, str | bytes] = {"unit": self.unit, "description": self.description}
        return pa.field(self.name, self.type, nullable=self.nullable, metadata=metadata)


def _count(name: str, description: str, nullable: bool = False) -> Column:
    return Column(name, pa.int32(), "1", description, nullable)


def _name(name: str, description: str, values: tuple[str, ...]) -> Column:
    return Column(name, _NAME, "", description, values=values)


def _real(name: str, unit: str, description: str, nullable: bool = True) -> Column:
    return Column(name, pa.float64(), unit, description, nullable)


_AXES = (("x", "to the right"), ("y", "downwards"), ("z", "away from the camera"))
_FRAME = _count("frame", "index of the picture in the source, from 0")
_T_S = _real("t_s", "s", "presentation time of the picture", nullable=False)
_STATUS = _name(
    "status",
    "why there is a result, or why there is none (no_approach is reserved: receding objects have negative times)",
    STATUS_NAMES,
)
_STATE = (
    "significant motion relative to the camera: depth decreases while the bearing changes (approaching) or is constant "
    "(constant_bearing), depth increases (receding), neither (no_relative_motion); scene: unknown if the camera moves"
)
_CLUSTER_ID = _count("cluster_id", "0: static scene, objects from 1; an object keeps its number for life")

TIMES = (
    _real("tcpa_s", "s", "time until closest approach (the paper's k); positive: in the future, negative: in the past"),
    _real(
        "tcpa_lo_s",
        "s",
        "lower bound of tcpa_s over the joint 90 % region of tcpa and miss, and over an unknown focal length",
    ),
    _real(
        "tcpa_hi_s",
        "s",
        "upper bound of tcpa_s over the joint 90 % region of tcpa and miss, and over an unknown focal length",
    ),
    _real(
        "miss_s",
        "s",
        "miss distance, at the closest approach (the paper's H), in seconds of relative motion; metres = miss_s |V|",
    ),
    _real(
        "miss_lo_s",
        "s",
        "lower bound of miss_s over the joint 90 % region of tcpa and miss, and over an unknown focal length",
    ),
    _real(
        "miss_hi_s",
        "s",
        "upper bound of miss_s over the joint 90 % region of tcpa and miss, and over an unknown focal length",
    ),
    _real("ttc_z_s", "s", "time to collision of lidar and KITTI: time until depth zero, -Z/Vz; positive: approaching"),
    _real(
        "ttc_z_lo_s", "s", "lower end of the 90 % interval of ttc_z_s, computed on 1/time; lo > hi: includes infinity"
    ),
    _real(
        "ttc_z_hi_s", "s", "upper end of the 90 % interval of ttc_z_s, computed on 1/time; lo > hi: includes infinity"
    ),
)

TABLES: dict[str, tuple[Column, ...]] = {
    "collision_times": (
        _FRAME,
        _T_S,
        Column("track_id", pa.int64(), "1", "number of the point track, unique within the run"),
        _count("cluster_id", "cluster of the track: 0: static scene, objects from 1; null: no cluster", nullable=True),
        _real("x_px", "px", "position in the source picture, to the right; 0: centre of the leftmost pixel", False),
        _real("y_px", "px", "position in the source picture, downwards; 0: centre of the topmost pixel", False),
        _count("n_frames", "observations of the track so far"),
        _real("alpha_rad", "rad", "angle between the point's ray and -dir, in [0, pi]; 0: straight at the camera"),
        _real("k_frames", "frames", "tcpa_s in units of the source's median frame interval"),
        *TIMES,
        _STATUS,
    ),
    "epipoles": (
        _FRAME,
        _T_S,
        _CLUSTER_ID,
        Column("method", pa.string(), "", "how the epipole was found"),
        _real("dir_x", "1", "relative direction of motion V/|V| of the cluster, to the right"),
        _real("dir_y", "1", "relative direction of motion V/|V| of the cluster, downwards"),
        _real("dir_z", "1", "relative direction of motion V/|V| of the cluster, away from the camera"),
        *(
            _real(f"cov_{ij}", "rad^2", f"covariance of dir, element {ij}; it lies in the tangent plane of dir")
            for ij in ("xx", "xy", "xz", "yy", "yz", "zz")
        ),
        _real(
            "x_px",
            "px",
            "epipole (line along dir meets the image plane), to the right; null within 1 deg of that plane",
        ),
        _real(
            "y_px", "px", "epipole (line along dir meets the image plane), downwards; null within 1 deg of that plane"
        ),
        _real(
            "horizon_offset_px",
            "px",
            "distance of the epipole from the horizon, positive below it; null without a horizon or at infinity",
        ),
        _count("n_tracks", "tracks of the cluster, inliers of the epipole or not"),
        _STATUS,
    ),
    "clusters": (
        _FRAME,
        _T_S,
        _CLUSTER_ID,
        _name("role", "the static scene or one object", ROLE_NAMES),
        _count(
            "motion_id",
            "0: the scene and standing obstacles; movers with the same epipole share a number, from 1",
        ),
        _count("n_tracks", "tracks of the cluster"),
        _real("x0_px", "px", "left side of the bounding box of its tracks"),
        _real("y0_px", "px", "upper side of the bounding box of its tracks"),
        _real("x1_px", "px", "right side of the bounding box of its tracks"),
        _real("y1_px", "px", "lower side of the bounding box of its tracks"),
        _real("ref_x_px", "px", "reference point of the state and the times, to the right"),
        _real("ref_y_px", "px", "reference point of the state and the times, downwards"),
        _real("a_hz", "1/s", "Vx/Z at the reference point"),
        _real("b_hz", "1/s", "Vy/Z at the reference point"),
        _real("c_hz", "1/s", "Vz/Z at the reference point; negative: approaching"),
        *(
            _real(f"cov_{ij}", "1/s^2", f"covariance of (a, b, c), element {ij}")
            for ij in ("aa", "ab", "ac", "bb", "bc", "cc")
        ),
        _name("state", _STATE, MOTION_STATE_NAMES),
        _real("expansion_hz", "1/s", "expansion: relative growth rate of the cluster's image; positive: approaching"),
        *TIMES,
        _count("urgency_rank", "1: most urgent object of the frame; null: not ranked", nullable=True),
        _STATUS,
    ),
    "frames": (
        _FRAME,
        _T_S,
        _real(
            "dt_s",
            "s",
            "time since the frame from which the rotation is measured; null for the first",
        ),
        _count("n_tracks", "live tracks"),
        _count("n_clusters", "clusters, the scene included"),
        _real("rot_x_rad", "rad", "rotation vector of cam_R_prev (ray_cam = cam_R_prev ray_prev), about x"),
        _real("rot_y_rad", "rad", "rotation vector of cam_R_prev (ray_cam = cam_R_prev ray_prev), about y"),
        _real("rot_z_rad", "rad", "rotation vector of cam_R_prev (ray_cam = cam_R_prev ray_prev), about z"),
        _real("rot_sigma_rad", "rad", "standard deviation of the rotation, per axis"),
        _real(
            "min_ttc_z_s",
            "s",
            "smallest ttc_z_s of the objects whose whole 90 % interval approaches, in each frame of the last "
            "events.persistence_s, and that have bodies.min_tracks tracks; null: there is none",
        ),
        _name("status", "result of the frame; static: ok, the camera is at rest", FRAME_STATUS_NAMES),
    ),
    "events": (
        _count("event_id", "number of the warning"),
        _name("kind", "kind of the warning", EVENT_KINDS),
        _count("cluster_id", "object of the warning"),
        _count("start_frame", "first frame of the warning"),
        _count(
            "end_frame",
            "last frame in which the condition held; the overlay shows the warning of a hidden object for longer",
        ),
        _real("start_s", "s", "presentation time of start_frame", nullable=False),
        _real("end_s", "s", "presentation time of end_frame", nullable=False),
        _real("min_ttc_z_s", "s", "smallest ttc_z_s during the warning"),
        _real("min_tcpa_s", "s", "smallest tcpa_s during the warning"),
        _real("miss_s", "s", "miss distance at the smallest tcpa_s, in seconds of relative motion"),
        _real("confidence", "1", "probability that its depth decreases, at its smallest tcpa_s", nullable=False),
    ),
}
TABLE_NAMES = tuple(TABLES)
MOTION_STATUS_NAMES = ("used", "off_horizon", "curved", "not_rigid", "uncertain")

CALIBRATION_TABLES: dict[str, tuple[Column, ...]] = {
    "motions": (
        _count("clip", "number of the clip among those given, from 0"),
        _count("mover_id", "number of the mover in its clip; a mover on a bend can have several straight motions"),
        _name("status", "whether the motion is used for the horizon, or why not", MOTION_STATUS_NAMES),
        _count("first_frame", "first frame of its observations"),
        _count("last_frame", "last frame of its observations"),
        _real("duration_s", "s", "time from the first to the last of its observations", nullable=False),
        _count("n_tracks", "number of its tracks; for own motion (--moving) of its frames"),
        *(_real(f"dir_{axis}", "1", f"direction of motion V/|V|, {way}") for axis, way in _AXES),
        *(
            _real(f"cov_{ij}", "rad^2", f"covariance of dir, element {ij}; it lies in the tangent plane of dir")
            for ij in ("xx", "xy", "xz", "yy", "yz", "zz")
        ),
        _real("x_px", "px", "its epipole in undistorted pixels, to the right; null within 1 deg of the image plane"),
        _real("y_px", "px", "its epipole in undistorted pixels, downwards; null within 1 deg of the image plane"),
        _real("residual_deg", "deg", "angle of the epipole from the horizon, positive above it"),
        _real("sigma_deg", "deg", "standard deviation of that angle"),
        _real("turned_deg", "deg", "angle by which its path bends, as far as it can be estimated"),
        _real("noise_px", "px", "standard deviation of one coordinate of its observations"),
        _real("correlation", "1", "variance over that of independent errors; above 1: errors are correlated"),
    ),
}

EVASION_STATUS_NAMES = ("no_danger", "advice", "no_escape", "unknown", "no_scale", "no_result")
_FORWARD = _real("forward_m_s", "m/s", "change of own velocity in the direction of travel; negative brakes")
_RIGHT = _real("right_m_s", "m/s", "change of own velocity to the right")
_WHO = (
    Column("name", pa.string(), "", "first object hit; null: none", nullable=True),
    _count("cluster_id", "its cluster, 0 for the static scene; null: none", nullable=True),
)

SENSITIVITY_METHODS = ("planar_two_frame", "three_frame", "whole_track", "stereo")
_VARIED = ("distance", "angle", "focal", "noise", "rate", "height")


def _error(name: str, unit: str, what: str) -> tuple[Column, ...]:
    """The errors of one quantity by the three ways."""
    ways = {"formula": "by closed form", "bound": "Cramer-Rao bound", "trials": "by Monte-Carlo of the real functions"}
    columns = [
        _real(f"{name}_{way}", unit, f"one standard deviation of {what}, {words}") for way, words in ways.items()
    ]
    valid = Column(f"{name}_is_small", pa.bool_(), "", f"whether {what} is small enough for the closed form to hold")
    return (*columns, valid)


STUDY_TABLES: dict[str, tuple[Column, ...]] = {
    "sensitivity": (
        _name("over", "quantity that is varied", _VARIED),
        _real("value", "1", "its value: m, deg, mm, px, 1/s or m", nullable=False),
        _name("method", "how direction and time are estimated", SENSITIVITY_METHODS),
        _count("n_frames", "number of pictures used; of stereo, number of pairs"),
        _real("distance_m", "m", "distance of the point", nullable=False),
        *_error("direction", "rad", "the direction of motion, both axes together"),
        *_error("ttc_z", "1", "the time until depth zero, relative to it"),
        *_error("tcpa", "1", "the time until closest approach, relative to it"),
    ),
    "collision_map": (
        _FORWARD,
        _RIGHT,
        _real("time_s", "s", "time until the earliest possible contact; null: none within the look-ahead"),
        _real("probability", "1", "probability of a collision within the look-ahead; null: outside the field of view"),
        *_WHO,
    ),
    "evasion": (
        _FRAME,
        _T_S,
        _real("own_speed_m_s", "m/s", "own speed, which gives the frame its scale in metres"),
        _real("time_s", "s", "time until the earliest possible contact at the present velocity; null: none"),
        _real("probability_now", "1", "probability of a collision within the time of warning at the present velocity"),
        *_WHO,
        _real("forward_m_s", "m/s", "advised change of own velocity in the direction of travel; negative brakes"),
        _real("right_m_s", "m/s", "advised change of own velocity to the right; negative is to the left"),
        _real("probability_after", "1", "probability of a collision within the look-ahead with the advised change"),
        _name("status", "whether there is a danger and an evasion, or why that is unknown", EVASION_STATUS_NAMES),
    ),
}
"""Tables of the studies: of the other commands than ``analyze``."""


def table_schema(name: str, metadata: dict[str, str] | None = None) -> pa.Schema:
    """The Arrow schema of a table, with the schema's version (and ``metadata``) as file metadata.

    The file metadata tell pandas, too, in which types to read the table (null is NA), and what to put into ``attrs``.

    Raises
    ------
    KeyError
        Where there is no table ``name``; the names are in `TABLE_NAMES`, `CALIBRATION_TABLES`, `STUDY_TABLES`.

    Examples
    --------
    >>> table_schema("frames").field("dt_s").metadata[b"unit"]
    b's'
    """
    about: dict[str | bytes, str | bytes] = {TABLE_KEY: name, VERSION_KEY: SCHEMA_VERSION}
    about.update(metadata.items() if metadata else ())
    about.update(_pandas_metadata(columns_of(name)))
    return pa.schema([column.field() for column in columns_of(name)], metadata=about)


def _pandas_metadata(columns: tuple[Column, ...]) -> dict[str, str]:
    """What `pandas.read_parquet` goes by: its own description of the columns, and the ``attrs`` of the frame.

    Sources: "Developer: Storing pandas DataFrame objects in Apache Parquet format" of the pandas manual, and
    `pandas.io.parquet` for the key of the ``attrs``.
    """
    described = [
        {
            "name": column.name,
            "field_name": column.name,
            "pandas_type": "categorical" if column.values else str(column.type),
            "numpy_type": "int8" if column.values else _PANDAS_TYPES[column.type],
            "metadata": {"num_categories": len(column.values), "ordered": False} if column.values else None,
        }
        for column in columns
    ]
    attrs = {
        "units": {column.name: column.unit for column in columns if column.unit},
        "descriptions": {column.name: column.description for column in columns},
    }
    pandas = {"index_columns": [], "column_indexes": [], "columns": described}
    return {"pandas": json.dumps(pandas), "PANDAS_ATTRS": json.dumps(attrs)}


def columns_of(name: str) -> tuple[Column, ...]:
    """The columns of a table of an analysis, a calibration or a study; KeyError where there is none of that name."""
    return (TABLES | CALIBRATION_TABLES | STUDY_TABLES)[name]


def markdown_of(name: str) -> str:
    """The columns of a table as a Markdown table: column, type, unit, whether it can be null, meaning."""
    lines = ["| column | type | unit | null | meaning |", "|---|---|---|---|---|"]
    for column in columns_of(name):
        kind = "name" if column.type == _NAME else str(column.type).replace("double", "float64")
        meaning = column.description + (f": {', '.join(column.values)}" if column.values else "")
        cells = (f"`{column.name}`", kind, column.unit, "yes" if column.nullable else "", meaning)
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(lines) + "\n"
