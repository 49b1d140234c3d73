"""The moments of a run: each frame's rows of its tables, given metres."""

from __future__ import annotations

import difflib
import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ttcvid.config import CollisionMapConfig
from ttcvid.errors import UsageError
from ttcvid.geometry.camera.pinhole import rays_from_pixels
from ttcvid.geometry.estimation.intervals import NORMAL_90_SIGMAS, REGION_90_SIGMAS, focal_interval_px
from ttcvid.geometry.horizon.plane import normal_from_horizon
from ttcvid.jobs.collision_map.ego_speed import ego_speed_m_s
from ttcvid.jobs.collision_map.moments import Clip, Moment, own_body
from ttcvid.jobs.evaluate import read_run_tables
from ttcvid.jobs.runs.manifest import camera_of
from ttcvid.jobs.runs.run import Run
from ttcvid.model import SCENE_CLUSTER, Floats, Horizon, ImageSize, Ints, Status
from ttcvid.studies.collision_map.evasion import EvasionStatus
from ttcvid.studies.collision_map.hazards import OwnBody
from ttcvid.studies.collision_map.run_hazards import Scale, SeenFrame, SeenObjects, situation_of
from ttcvid.studies.evaluation.truth import DIRECTION, ROTATION

_TURN_WINDOW_S, _LEAST_TURN_RAD_S = 0.5, math.radians(1.0)
"""Own turning is the median over this time; slower than this it is none."""
_ON_ROAD_PLATFORM = "vehicle"
_FARTHEST_SCALES, _LEAST_COMPARED = 1.5, 10
"""The speed given and that by the camera's height agree to some 1 % in simulated drives, to 7 % in a real one (median
over the clip). Where they differ by this factor in the median of so many frames, one of them is wrong: miles an hour
and km/h differ by 1.6."""


def run_clip(run: Run, config: CollisionMapConfig) -> Clip:
    """The frames of a run, with the scale that the configuration gives.

    Raises
    ------
    UsageError
        Nothing gives a scale, own speed and the camera's height contradict each other, or a width is that of an object
        that the run does not have.
    InputError
        A table cannot be read.
    """
    if config.ego_speed is None and config.camera_height_m is None:
        raise UsageError(
            f"{run.folder}: a run has no metres: give --ego-speed or --camera-height-m, or both for the best map"
        )
    tables = read_run_tables(run)
    frames, clusters, points, epipoles = tables.frames, tables.clusters, tables.collision_times, tables.epipoles
    t_s = frames.t_s.to_numpy(float)
    speeds = None
    if config.ego_speed is not None:
        speeds = ego_speed_m_s(config.ego_speed, frames.frame.to_numpy(), t_s)
    reader = _FrameReader(run, frames, clusters, points, epipoles)
    widths, width = _widths(config.object_width_m, sorted(set(clusters.cluster_id) - {SCENE_CLUSTER}))
    scales = [
        Scale(None if speeds is None else float(speeds[n]), config.camera_height_m, widths, width, reader.is_on_road)
        for n in range(len(frames))
    ]
    moments, speeds_m_s = _moments(reader, scales, own_body(config), reader.notes())
    _require_one_scale(run.folder, speeds_m_s)
    return Clip(run.folder.name, frames.frame.to_numpy(), t_s, moments.__getitem__, (run.folder,))


def _moments(
    reader: _FrameReader, scales: list[Scale], own: OwnBody, notes: tuple[str, ...]
) -> tuple[list[Moment], list[tuple[float, float]]]:
    """All moments in order, because each remembers what the ones before have seen.

    And own speed in m/s where it is known twice: as given, and by the camera's height.
    """
    moments, memory, speeds_m_s = [], None, list[tuple[float, float]]()
    for n, scale in enumerate(scales):
        seen = reader.read(n)
        # Who moves and does not know whereto has no map; who rests needs no direction.
        if not np.isfinite(seen.own_direction).all() and scale.own_speed_m_s != 0.0:
            moments.append(Moment(None, EvasionStatus.no_result))
            continue
        found = situation_of(seen, scale, own, memory)
        memory = found.memory if found.memory is not None else memory
        if scale.own_speed_m_s and found.speed_by_height_m_s:
            speeds_m_s.append((scale.own_speed_m_s, found.speed_by_height_m_s))
        status = EvasionStatus.no_danger if found.situation is not None else EvasionStatus.no_scale
        said = (*found.notes, *notes)
        if found.situation is not None and not found.is_scene_known:
            said = (*said, "What stands still is not known yet, or no road was found under it: it is left out.")
        moments.append(Moment(found.situation, status, found.unlinked, said, found.is_scene_known, found.course_rad))
    return moments, speeds_m_s


def _require_one_scale(folder: Path, speeds_m_s: list[tuple[float, float]]) -> None:
    """Refuse an own speed that the camera's height over the road contradicts: metres would be of two kinds."""
    if len(speeds_m_s) < _LEAST_COMPARED:
        return
    given, by_height = np.transpose(speeds_m_s)
    factor = float(np.median(given / by_height))
    if max(factor, 1.0 / factor) > _FARTHEST_SCALES:
        raise UsageError(
            f"{folder}: --ego-speed is {3.6 * np.median(given):.0f} km/h, but under a camera at --camera-height-m the "
            f"road goes by at {3.6 * np.median(by_height):.0f} km/h: expected two that agree, mend one or leave it out"
        )


class _FrameReader:
    """Picks the rows of one frame and turns pixels into rays."""

    def __init__(
        self, run: Run, frames: pd.DataFrame, clusters: pd.DataFrame, points: pd.DataFrame, epipoles: pd.DataFrame
    ) -> None:
        self._frames = frames
        self._camera = camera_of(run.manifest["camera"])
        self._horizon = _horizon_of(run.manifest["horizon"])
        self._platform = str(run.manifest["configuration"]["egomotion"]["platform"]["value"])
        objects = clusters[(clusters.role == "object") & clusters[["a_hz", "cov_aa"]].notna().all(axis=1)]
        is_static = (points.cluster_id == SCENE_CLUSTER) & (points.status == Status.ok.name)
        self._objects = dict(list(objects.groupby("frame")))
        self._points = dict(list(points[is_static].groupby("frame")))
        size = self._camera.image_size
        # Along the middles of the sides; the corners of a distorted picture reach farther.
        middles_px = np.array(
            [
                [0.0, 0.5 * size.height_px],
                [0.5 * size.width_px, 0.0],
                [size.width_px - 1.0, 0.5 * size.height_px],
                [0.5 * size.width_px, size.height_px - 1.0],
            ]
        )
        left, top, right, bottom = rays_from_pixels(self._camera, middles_px)
        self._view = np.array([[left[0], top[1]], [right[0], bottom[1]]])
        self._scene = epipoles[epipoles.cluster_id == SCENE_CLUSTER].set_index("frame")[DIRECTION]

    @property
    def is_on_road(self) -> bool:
        """Whether what moves stands on the road that we are on: the horizon is known, or we are a vehicle."""
        return self._horizon is not None or self._platform == _ON_ROAD_PLATFORM

    def notes(self) -> tuple[str, ...]:
        """What the level rests on, and what is assumed of the camera."""
        notes = ["Level by the horizon file."] if self._horizon is not None else []
        if self._horizon is None and self.is_on_road:
            notes = ["Level by own motion: no horizon was given to the run."]
        if not self.is_on_road:
            notes = ["No horizon and no vehicle: nothing is taken to stand on a road; level as the camera."]
        if self._camera.is_assumed:
            notes.append("The focal length is ASSUMED: directions and distances are as wrong as it is.")
        if self._camera.focal_sigma_px is not None:
            part = self._camera.focal_sigma_px / self._camera.fx_px
            notes.append(f"The focal length was FOUND in the clip, to {100 * part:.0f} %.")
        return tuple(notes)

    def read(self, n: int) -> SeenFrame:
        """What the tables say of the n-th frame."""
        frame = int(self._frames.frame.iloc[n])
        down = np.array([0.0, 1.0, 0.0])
        if self._horizon is not None:
            down = -normal_from_horizon(self._camera, self._horizon)
        points = self._points.get(frame)
        track_id: Ints = np.empty(0, np.int64)
        rays: Floats = np.empty((0, 3))
        range_s: Floats = np.empty(0)
        sigma: Floats = np.empty(0)
        if points is not None:
            rays = self._rays(points, "x_px", "y_px")
            range_s = np.hypot(points.tcpa_s.to_numpy(float), points.miss_s.to_numpy(float))
            sigma = self._relative_noise(points, range_s)
            is_known = np.isfinite(rays).all(axis=1) & np.isfinite(sigma)
            track_id = points.track_id.to_numpy(np.int64)[is_known]
            rays, range_s, sigma = rays[is_known], range_s[is_known], sigma[is_known]
        direction: Floats = np.full(3, np.nan)
        if frame in self._scene.index:
            direction = -self._scene.loc[frame].to_numpy(float)
        t_s = float(self._frames.t_s.iloc[n])
        objects = self._objects_of(frame)
        turn_rad_s = self._turn(n, down)
        return SeenFrame(t_s, direction, down, turn_rad_s, track_id, rays, range_s, sigma, objects, self._view)

    def _relative_noise(self, points: pd.DataFrame, range_s: Floats) -> Floats:
        """Standard deviation (N,) of the distances of points as a part of them, ``range_s (N,)``: each its own."""
        of_tcpa: Floats = (points.tcpa_hi_s - points.tcpa_lo_s).to_numpy(float) / (2 * REGION_90_SIGMAS) / range_s
        if focal_interval_px(self._camera) is None:
            return of_tcpa
        # The intervals of tcpa hold what the focal length may be, which all points share; those of ttc_z do not.
        low, high = (1.0 / points[f"ttc_z_{end}_s"].to_numpy(float) for end in ("lo", "hi"))
        of_ttc_z = np.abs(points.ttc_z_s.to_numpy(float) * (low - high)) / (2 * NORMAL_90_SIGMAS)
        return np.fmin(of_tcpa, of_ttc_z)

    def _objects_of(self, frame: int) -> SeenObjects:
        rows = self._objects.get(frame)
        if rows is None:
            none = np.empty((0, 3))
            counts = np.empty(0, np.int64)
            return SeenObjects(counts, counts, none, none, np.empty((0, 3, 3)), none, none, none, none)
        middle = rows.assign(x_px=0.5 * (rows.x0_px + rows.x1_px), y_px=0.5 * (rows.y0_px + rows.y1_px))
        names = [[f"cov_{''.join(sorted(i + j))}" for j in "abc"] for i in "abc"]
        return SeenObjects(
            rows.cluster_id.to_numpy(np.int64),
            rows.motion_id.to_numpy(np.int64),
            self._rays(rows, "ref_x_px", "ref_y_px"),
            rows[["a_hz", "b_hz", "c_hz"]].to_numpy(float),
            np.stack([rows[list(row)].to_numpy(float) for row in names], axis=1),
            self._rays(middle, "x0_px", "y_px"),
            self._rays(middle, "x1_px", "y_px"),
            self._rays(middle, "x_px", "y0_px"),
            self._rays(middle, "x_px", "y1_px"),
        )

    def _rays(self, rows: pd.DataFrame, x: str, y: str) -> Floats:
        return rays_from_pixels(self._camera, rows[[x, y]].to_numpy(float))

    def _turn(self, n: int, down: Floats) -> float:
        """Rate of turning to the right: the scene turns to the left then, about down by a negative angle."""
        now_s = float(self._frames.t_s.iloc[n])
        window = self._frames[(self._frames.t_s <= now_s) & (self._frames.t_s > now_s - _TURN_WINDOW_S)]
        rates = -(window[ROTATION].to_numpy(float) @ down) / window.dt_s.to_numpy(float)
        rates = rates[np.isfinite(rates)]
        turn = float(np.median(rates)) if len(rates) else 0.0
        return turn if abs(turn) >= _LEAST_TURN_RAD_S else 0.0


def _horizon_of(manifest: dict[str, Any] | None) -> Horizon | None:
    if manifest is None:
        return None
    names = ("y_left_px", "y_right_px", "sigma_rad", "origin")
    return Horizon(**{name: manifest[name] for name in names}, image_size=ImageSize(**manifest["image_size"]))


def _widths(text: str | None, known: list[int]) -> tuple[dict[int, float], float | None]:
    """Widths in m by object, and that of all others, of ``1.8``, ``3=2.5`` or ``1.8,3=2.5``."""
    of_object: dict[int, float] = {}
    of_all: float | None = None
    for part in text.split(",") if text is not None else []:
        number, equals, width = part.rpartition("=")
        try:
            value, cluster_id = float(width), int(number) if equals else None
        except ValueError:
            value, cluster_id = math.nan, None
        if not (math.isfinite(value) and value > 0):
            raise UsageError(
                f"--object-width-m = {text!r}: expected widths > 0 in m, such as 1.8 or 3=2.5 or 1.8,3=2.5"
            )
        if cluster_id is None:
            of_all = value
        elif cluster_id in known:
            of_object[cluster_id] = value
        else:
            near = difflib.get_close_matches(str(cluster_id), map(str, known), n=1)
            hint = f"did you mean {near[0]}?" if near else f"it has {', '.join(map(str, known)) or 'none'}"
            raise UsageError(f"--object-width-m = {text!r}: the run has no object {cluster_id}: {hint}")
    return of_object, of_all
