"""The truth as tables: columns with units, and the rows of a picture."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from ttcvid.model import Floats
from ttcvid.schema import Column
from ttcvid.simulate.encounters import Encounter
from ttcvid.simulate.object_truth import ObjectTruth
from ttcvid.simulate.poses import horizon_lines_px, mean_velocities_m_s, rotation_vectors_rad
from ttcvid.simulate.render import Rendered
from ttcvid.simulate.scene import Scene
from ttcvid.simulate.tracks import SimulatedTracks
from ttcvid.simulate.world import World


def _real(name: str, unit: str, description: str, nullable: bool = False) -> Column:
    return Column(name, pa.float64(), unit, description, nullable)


def _vector(stem: str, tail: str, unit: str, what: str, nullable: bool = False) -> tuple[Column, ...]:
    ways = {"x": "to the right", "y": "downwards", "z": "away from the camera"}
    return tuple(_real(f"{stem}{axis}{tail}", unit, f"{what}, {way}", nullable) for axis, way in ways.items())


_FRAME = Column("frame", pa.int32(), "1", "index of the picture, from 0")
_T_S = _real("t_s", "s", "presentation time of the picture")
_TRACK_ID = Column("track_id", pa.int64(), "1", "number of the point track, never used twice")
_OBJECT_ID = Column("object_id", pa.int32(), "1", "object, as in truth_labels; 0 is the static scene")
_NAME = Column("name", pa.string(), "", "name of the body in the scene file")
_TIMES = (
    _real("tcpa_s", "s", "time until closest approach, -P.V/|V|^2; null where V is 0", True),
    _real("miss_s", "s", "distance of the closest approach, |P x V|/|V|^2; null where V is 0", True),
    _real("ttc_z_s", "s", "time until depth zero, -Z/Vz; null where Vz is 0", True),
)

TRUTH_TABLES: dict[str, tuple[Column, ...]] = {
    "truth_objects": (
        _FRAME,
        _T_S,
        _OBJECT_ID,
        _NAME,
        Column("is_moving", pa.bool_(), "", "whether it moves over the ground at some time of the clip"),
        _real("x0_px", "px", "left edge of its visible part (distorted source pixels)"),
        _real("y0_px", "px", "upper edge of its visible part"),
        _real("x1_px", "px", "right edge of its visible part"),
        _real("y1_px", "px", "lower edge of its visible part"),
        _real("visible_px", "px^2", "visible area"),
        _real("visible_fraction", "1", "visible area over the area inside the picture if nothing stood before it"),
        *_vector("dir_", "", "1", "relative direction of motion V/|V|; null where V is 0", True),
        *_TIMES,
        *_vector("", "_m", "m", "centre P of its nearest visible surface, in the camera of the frame"),
        *_vector("v", "_m_s", "m/s", "relative velocity V of that point at t_s, rotation of the camera removed"),
    ),
    "truth_frames": (
        _FRAME,
        _T_S,
        *_vector("rot_", "_rad", "rad", "rotation vector of cam_R_prev; null for the first frame", True),
        *_vector("v", "_m_s", "m/s", "own mean velocity since the previous frame, in the present camera", True),
        *_vector("dir_", "", "1", "direction -v/|v| in which the static scene moves; null at rest", True),
        _real("horizon_left_px", "px", "y of the horizon at x = 0, undistorted pixels"),
        _real("horizon_right_px", "px", "y of the horizon at x = width - 1, undistorted pixels"),
    ),
    "truth_encounters": (
        _OBJECT_ID,
        _NAME,
        _real("t_min_s", "s", "time at which the body comes closest to the camera, within the clip or soon after it"),
        _real("min_distance_m", "m", "distance of the body's surface from the camera then"),
        Column("is_collision", pa.bool_(), "", "whether that is less than radius_m of own_motion"),
        _real("t_contact_s", "s", "time at which the distance falls below radius_m; null without collision", True),
    ),
    "tracks": (
        _FRAME,
        _T_S,
        _TRACK_ID,
        _real("x_px", "px", "observed position"),
        _real("y_px", "px", "observed position"),
    ),
    "truth_tracks": (
        _FRAME,
        _TRACK_ID,
        _OBJECT_ID,
        Column("is_outlier", pa.bool_(), "", "whether the observation was displaced at random"),
        _real("x_true_px", "px", "true position"),
        _real("y_true_px", "px", "true position"),
        *_vector("", "_m", "m", "the point P in the camera of the frame"),
        *_vector("v", "_m_s", "m/s", "relative velocity V of the point at t_s, rotation of the camera removed"),
        *_TIMES,
    ),
}


def truth_table(name: str, columns: dict[str, Any], scene: Scene) -> pa.Table:
    """A truth table from its columns; NaN becomes null."""
    fields = [column.field() for column in TRUTH_TABLES[name]]
    metadata: dict[bytes | str, bytes | str] = {"ttcvid_table": name, "ttcvid_scene": scene.name}
    metadata["ttcvid_seed"] = str(scene.seed)
    arrays = [pa.array(columns[field.name], type=field.type, from_pandas=True) for field in fields]
    return pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata=metadata))


def frame_columns(world: World) -> dict[str, Any]:
    """The columns of ``truth_frames``."""
    rotation, velocity = rotation_vectors_rad(world.path), mean_velocities_m_s(world.path)
    speed = np.linalg.norm(velocity, axis=1, keepdims=True)
    direction = -velocity / np.where(speed > 0, speed, np.nan)
    horizon = horizon_lines_px(world.camera, world.path.cam_R_road)
    return {
        "frame": np.arange(world.n_frames),
        "t_s": world.path.t_s,
        **_split("rot_", "_rad", rotation),
        **_split("v", "_m_s", velocity),
        **_split("dir_", "", direction),
        "horizon_left_px": horizon[:, 0],
        "horizon_right_px": horizon[:, 1],
    }


def object_rows(rendered: Rendered) -> list[tuple[Any, ...]]:
    """The rows of ``truth_objects`` of one picture, in the order of its columns."""
    return [(rendered.frame, rendered.t_s, *_object_row(truth)) for truth in rendered.objects]


def encounter_columns(encounters: Sequence[Encounter]) -> dict[str, Any]:
    """The columns of ``truth_encounters``."""
    names = [column.name for column in TRUTH_TABLES["truth_encounters"]]
    return {name: [getattr(encounter, name) for encounter in encounters] for name in names}


def track_columns(tracks: SimulatedTracks) -> dict[str, Any]:
    """The columns of ``tracks`` and ``truth_tracks`` together."""
    return {
        "frame": tracks.frame,
        "t_s": tracks.t_s,
        "track_id": tracks.track_id,
        "object_id": tracks.object_id,
        "is_outlier": tracks.is_outlier,
        "x_px": tracks.xy_px[:, 0],
        "y_px": tracks.xy_px[:, 1],
        "x_true_px": tracks.true_xy_px[:, 0],
        "y_true_px": tracks.true_xy_px[:, 1],
        **_split("", "_m", tracks.position_m),
        **_split("v", "_m_s", tracks.velocity_m_s),
        "tcpa_s": tracks.times.tcpa_s,
        "miss_s": tracks.times.miss_s,
        "ttc_z_s": tracks.times.ttc_z_s,
    }


def _object_row(truth: ObjectTruth) -> tuple[Any, ...]:
    times = truth.times
    return (
        truth.object_id,
        truth.name,
        truth.is_moving,
        *truth.box_px,
        truth.visible_px,
        truth.visible_fraction,
        *times.direction[0].tolist(),
        float(times.tcpa_s[0]),
        float(times.miss_s[0]),
        float(times.ttc_z_s[0]),
        *truth.position_m.tolist(),
        *truth.velocity_m_s.tolist(),
    )


def _split(stem: str, tail: str, vectors: Floats) -> dict[str, Floats]:
    return {f"{stem}{axis}{tail}": vectors[:, k] for k, axis in enumerate("xyz")}
