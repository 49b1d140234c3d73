"""The types that flow between the stages, and the conventions that all of them follow.

Pixels
    x right, y down; the centre of the top-left pixel is (0, 0), after the stream's own rotation has been
    applied. Every stored pixel is a pixel of the source picture, distorted as it is.
Camera frame
    x right, y down, z forward. The ray of a pixel is the undistorted ``K^-1 (x, y, 1)``.
Time
    ``frame`` is the index in the source, from 0; ``t_s`` its presentation time. A row of frame i describes
    the motion up to i, expressed in the camera of frame i. ``cam_R_prev`` turns a ray of the previous
    camera into the present one: ``ray_cam = cam_R_prev @ ray_prev``.
Relative velocity
    ``V = v_point - v_camera`` with the camera's rotation removed; a point approaches when P . V < 0.
    ``dir = V / |V|``: over time the picture of a point moves from ``-dir`` (where it comes from) to ``+dir``.
    ``alpha`` is the angle between the point's ray and ``-dir``, in [0, pi].
Missing values
    Arrays hold NaN (floats) or ``NO_CLUSTER`` (cluster numbers) where there is no result, always beside a
    ``Status`` that says why. Tables hold null there: never 0, NaN or infinity.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from enum import IntEnum, StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Picture = NDArray[np.uint8]

NO_CLUSTER = -1
SCENE_CLUSTER = 0
SCENE_MOTION = 0
"""``motion_id`` of what moves as the static scene does."""


class Status(IntEnum):
    """Why a track or cluster has a result, or has none; stored by name in the tables."""

    ok = 0
    short_track = 1
    no_parallax = 2
    parallel_to_horizon = 3
    at_epipole = 4
    no_epipole = 5
    epipole_at_infinity = 6
    not_rigid = 7
    no_approach = 8


class FrameStatus(StrEnum):
    """What became of a frame; ``static`` is ``ok`` before a camera that rests."""

    ok = "ok"
    first = "first"
    cut = "cut"
    bad_dt = "bad_dt"
    duplicate = "duplicate"
    dark = "dark"
    few_tracks = "few_tracks"
    rotation_only = "rotation_only"
    static = "static"


class MotionState(StrEnum):
    """How a cluster moves relative to the camera."""

    approaching = "approaching"
    receding = "receding"
    constant_bearing = "constant_bearing"
    no_relative_motion = "no_relative_motion"
    unknown = "unknown"


APPROACHING = frozenset({MotionState.approaching, MotionState.constant_bearing})
"""The states of approaching objects."""


class Platform(StrEnum):
    """What carries the camera; chooses the priors on own motion.

    ``auto`` is to be told from the clip (``ttcvid.stages.egomotion.platform``) before anything is analysed.
    """

    auto = "auto"
    vehicle = "vehicle"
    aircraft = "aircraft"
    free = "free"
    static = "static"


@dataclass(frozen=True)
class ImageSize:
    """Width and height of a picture, in px."""

    width_px: int
    height_px: int

    @property
    def longer_side_px(self) -> int:
        """What lengths in a picture are measured by: the same, however a camera is held."""
        return max(self.width_px, self.height_px)

    def __str__(self) -> str:
        return f"{self.width_px}x{self.height_px}"


@dataclass(frozen=True)
class Camera:
    """A pinhole camera with lens distortion.

    ``distortion_model`` is ``none``, ``plumb_bob`` (k1 k2 p1 p2 k3), ``rational`` (k1 k2 p1 p2 k3 k4 k5 k6) or
    ``fisheye`` (k1 k2 k3 k4 of the equidistant model), with OpenCV's meaning of the coefficients.
    ``origin`` says where the numbers come from: a file name, ``focal_px``, ``hfov_deg``, ``found`` (in the clip itself)
    or ``assumed``; ``focal_sigma_px`` is the standard deviation of a focal length that was found, None for others.
    """

    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    image_size: ImageSize
    distortion_model: str = "none"
    distortion: tuple[float, ...] = ()
    origin: str = "assumed"
    focal_sigma_px: float | None = None

    @property
    def is_assumed(self) -> bool:
        """True where nobody gave the focal length and the clip does not tell it: every output has to say so."""
        return self.origin == "assumed"

    @property
    def is_found(self) -> bool:
        """True where nobody gave the focal length, but the clip told it: every output has to say so."""
        return self.focal_sigma_px is not None


@dataclass(frozen=True)
class Horizon:
    """The horizon of a camera as a line in undistorted pixels, at x = 0 and at x = width - 1.

    ``sigma_rad`` is the standard deviation of its normal's direction; where it is known, ``covariance_rad2`` is that of
    (pitch, roll), ((pitch pitch, pitch roll), (pitch roll, roll roll)).
    """

    y_left_px: float
    y_right_px: float
    image_size: ImageSize
    sigma_rad: float
    origin: str
    covariance_rad2: tuple[tuple[float, float], tuple[float, float]] | None = None


@dataclass(frozen=True)
class PointSet:
    """Observed points of one picture.

    ``track_id (N,)`` ascending and unique; ``xy_px (N, 2)`` distorted source pixels. ``window_px (N, 2)`` where the
    windows stand by which a tracker follows them, None where they stand about the points. ``common_error_px`` is what
    the points of a thing err by together (standard deviation at its outline): 0 where each errs by itself.
    ``unseen_id (M,)`` are tracks not observed in this picture that may come back, ascending; None: any track may.
    """

    track_id: Ints
    xy_px: Floats
    window_px: Floats | None = None
    common_error_px: float = 0.0
    unseen_id: Ints | None = None

    def __post_init__(self) -> None:
        n = len(self.track_id)
        if self.track_id.shape != (n,) or self.xy_px.shape != (n, 2):
            raise ValueError(
                f"PointSet: expected track_id (N,) and xy_px (N, 2), got {self.track_id.shape} and {self.xy_px.shape}"
            )

    @property
    def windows_px(self) -> Floats:
        """Where the windows stand by which the points are followed: (N, 2)."""
        return self.xy_px if self.window_px is None else self.window_px

    def take(self, points: Bools) -> PointSet:
        """The points of a mask ``(N,)``."""
        window_px = None if self.window_px is None else self.window_px[points]
        return replace(self, track_id=self.track_id[points], xy_px=self.xy_px[points], window_px=window_px)


NO_POINTS = PointSet(np.empty(0, dtype=np.int64), np.empty((0, 2)))


@dataclass(frozen=True)
class Frame:
    """One picture (or one set of tracked points) of a source, with its time.

    ``grey`` (H, W) uint8, or None where the source delivers ``points`` instead. ``colour`` gives the picture
    as (H, W, 3) BGR uint8, a fresh array at each call; None where there is no picture to draw on.
    """

    index: int
    t_s: float
    grey: Picture | None = None
    points: PointSet | None = None
    colour: Callable[[], Picture] | None = None


@dataclass(frozen=True)
class SourceInfo:
    """What is known of a source before its first frame is read.

    ``nominal_dt_s`` is the median time difference of the whole source (before ``stride``), ``n_frames`` the
    number of frames that the source will deliver if all of them can be decoded (None: unknown).
    ``time_origin`` says where the times come from: ``presentation`` (container), ``timestamps``, ``fps`` or ``table``.
    """

    path: str
    kind: str
    image_size: ImageSize
    nominal_dt_s: float
    n_frames: int | None
    time_origin: str


@dataclass(frozen=True)
class SourceReport:
    """What happened while a source was read; valid once the iteration has ended.

    ``n_frames_corrupt`` frames were passed on although their decoder calls them damaged; about ``n_frames_missing`` of
    the whole source are gone without a trace but in the times.
    """

    n_packets_skipped: int = 0
    is_truncated: bool = False
    warnings: tuple[str, ...] = ()
    n_frames_corrupt: int = 0
    n_frames_missing: int = 0


@dataclass(frozen=True)
class CollisionTimes:
    """The three times of N points with their 90 % intervals, each ``(N,)`` in s; NaN where there is none.

    ``tcpa_s`` (the paper's k): until closest approach; ``miss_s`` (the paper's H): distance then, in seconds of
    relative motion; ``ttc_z_s``: until depth zero, what lidar and KITTI call TTC. Positive is ahead.
    The ttc_z interval is made on 1/time: lo > hi means that it runs through infinity.
    """

    tcpa_s: Floats
    tcpa_lo_s: Floats
    tcpa_hi_s: Floats
    miss_s: Floats
    miss_lo_s: Floats
    miss_hi_s: Floats
    ttc_z_s: Floats
    ttc_z_lo_s: Floats
    ttc_z_hi_s: Floats

    @staticmethod
    def missing(n: int) -> CollisionTimes:
        """N rows without a result."""
        return CollisionTimes(*(np.full(n, np.nan) for _ in fields(CollisionTimes)))

    def take(self, index: Any) -> CollisionTimes:
        """The rows that a mask or an index array picks."""
        return CollisionTimes(*(getattr(self, f.name)[index] for f in fields(self)))

    def where_bounded(self) -> CollisionTimes:
        """The same with NaN for values whose 90 % interval has an end that is infinite; the bounds stay.

        There 1 / time may be zero: of ttc_z and miss the lower bound says what is known, of tcpa nothing is left. Meant
        for objects. The times of single tracks are what estimates are made of, which a selection by noise would bias.
        """
        told = {"tcpa_s": self.tcpa_lo_s <= self.tcpa_hi_s, "miss_s": self.miss_lo_s <= self.miss_hi_s}
        told["ttc_z_s"] = self.ttc_z_lo_s <= self.ttc_z_hi_s
        return replace(self, **{name: np.where(is_told, getattr(self, name), np.nan) for name, is_told in told.items()})


_NO_TIMES = CollisionTimes.missing(1)


@dataclass(frozen=True)
class TrackRows:
    """Results of the N live tracks of one frame, ascending in ``track_id``.

    ``n_frames`` counts the observations of the track so far, ``alpha_rad`` is the angle from the epipole,
    ``status`` holds ``Status`` values.
    """

    track_id: Ints
    cluster_id: Ints
    xy_px: Floats
    n_frames: Ints
    alpha_rad: Floats
    times: CollisionTimes
    status: Ints


@dataclass(frozen=True)
class HorizonOffset:
    """How far off the horizon an epipole was found, before it was moved there.

    ``below_rad`` is the angle below the horizon of the direction, turned ahead, with its own standard deviation
    ``sigma_rad``; ``ahead`` is the cosine of its angle to the optical axis: only what moves there and back tells pitch.
    """

    below_rad: float
    sigma_rad: float
    ahead: float


@dataclass(frozen=True)
class ClusterRow:
    """One cluster (the scene or an object) in one frame.

    ``direction`` (3,) is ``dir``, None where there is no epipole, with ``direction_cov`` (3, 3) in rad^2 in its
    tangent plane. ``epipole_px`` (2,) is None within 1 deg of the picture plane. ``state_abc_hz`` (3,) is
    (a, b, c) = V / Z of the reference point with covariance ``state_cov`` (3, 3) in 1/s^2; as the centroid of a surface
    it has the standard error ``ref_sigma`` (x, y in the plane z = 1). ``times`` has one row. ``method`` names how the
    epipole was found. ``front_px`` is the box of what of it is as near as the reference point, None where that is not
    known. ``horizon_offset`` is None without a horizon.
    """

    cluster_id: int
    motion_id: int
    n_tracks: int
    box_px: tuple[float, float, float, float]
    status: Status
    epipole_status: Status
    method: str
    motion_state: MotionState = MotionState.unknown
    direction: Floats | None = None
    direction_cov: Floats | None = None
    epipole_px: Floats | None = None
    horizon_offset_px: float | None = None
    horizon_offset: HorizonOffset | None = None
    ref_px: tuple[float, float] | None = None
    ref_sigma: tuple[float, float] = (0.0, 0.0)
    front_px: tuple[float, float, float, float] | None = None
    state_abc_hz: Floats | None = None
    state_cov: Floats | None = None
    expansion_hz: float | None = None
    urgency_rank: int | None = None
    times: CollisionTimes = field(default_factory=lambda: _NO_TIMES)

    def changed(self, **values: Any) -> ClusterRow:
        """The same row with other ``values``, as `dataclasses.replace`, which takes six times as long."""
        row = object.__new__(ClusterRow)
        row.__dict__.update(self.__dict__, **values)
        if len(row.__dict__) > len(self.__dict__):
            raise TypeError(f"a row of a cluster has none of these: {', '.join(values.keys() - self.__dict__.keys())}")
        return row

    @property
    def role(self) -> str:
        """``scene`` or ``object``."""
        return "scene" if self.cluster_id == SCENE_CLUSTER else "object"


@dataclass(frozen=True)
class Event:
    """A warning: an object on collision course, or one at constant bearing that expands."""

    event_id: int
    kind: str
    cluster_id: int
    start_frame: int
    end_frame: int
    start_s: float
    end_s: float
    min_ttc_z_s: float | None
    min_tcpa_s: float | None
    miss_s: float | None
    confidence: float


@dataclass(frozen=True)
class FrameResult:
    """Everything that is known of one frame.

    ``rotation_rad`` (3,) is the rotation vector of ``cam_R_prev``, None where there is no estimate, with
    ``rotation_sigma_rad`` its standard deviation per axis. ``nearest`` is the row of the object that is reached first,
    of those whose approach deserves to be told (``ttcvid.stages.objects.reached_first``); None where there is none.
    ``horizon_px`` is the horizon line (y at x = 0, y at x = width - 1, undistorted pixels) of this frame, None where
    none is in use.
    ``events`` are the warnings active in this frame, as they stand: the last version of each ``event_id`` is final.
    """

    frame: int
    t_s: float
    dt_s: float | None
    status: FrameStatus
    tracks: TrackRows
    clusters: tuple[ClusterRow, ...]
    rotation_rad: Floats | None = None
    rotation_sigma_rad: float | None = None
    nearest: ClusterRow | None = None
    horizon_px: tuple[float, float] | None = None
    events: tuple[Event, ...] = ()

    @property
    def min_ttc_z_s(self) -> float | None:
        """Time until the depth of ``nearest`` is zero."""
        return None if self.nearest is None else float(self.nearest.times.ttc_z_s[0])
