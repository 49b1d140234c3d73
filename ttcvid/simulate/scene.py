"""What a scene file may say: camera, own motion, ground, picture and bodies, with units in the names.

Road frame: x ahead of the camera at time 0, y to the left, z up, origin on the ground under the camera. Headings and
yaw rates are positive to the left, pitch is positive where the camera looks down, roll where its right side is low.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from ttcvid.geometry.camera.pinhole import rays_from_pixels
from ttcvid.model import Camera, Floats, ImageSize

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Vector = tuple[float, float, float]
Kind = Literal[
    "car",
    "lorry",
    "bus",
    "motorcycle",
    "cyclist",
    "walker",
    "wall",
    "house",
    "box",
    "post",
    "tree",
    "aircraft",
    "drone",
    "island",
    "slab",
]
TIME_TICK_S = 1 / 90000
"""Frame times are multiples of this, the time base of the clip, so that clip and truth agree exactly."""


class SceneModel(BaseModel):
    """Base of all parts of a scene: immutable, no unknown keys, no NaN or infinity."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class CameraSpec(SceneModel):
    """The camera: intrinsics (``hfov_deg`` or ``fx_px`` ...), mounting, and the times of its pictures."""

    image_size: tuple[Annotated[int, Field(ge=32, le=8192)], Annotated[int, Field(ge=32, le=8192)]] = (640, 360)
    hfov_deg: Annotated[float, Field(gt=1, lt=150)] | None = None
    fx_px: Positive | None = None
    fy_px: Positive | None = None
    cx_px: float | None = None
    cy_px: float | None = None
    distortion_model: Literal["none", "plumb_bob", "rational", "fisheye"] = "none"
    distortion: tuple[float, ...] = ()
    height_m: Positive = 1.4
    pitch_deg: Annotated[float, Field(gt=-80, lt=80)] = 0.0
    roll_deg: Annotated[float, Field(gt=-90, lt=90)] = 0.0
    fps: Annotated[float, Field(gt=0, le=1000)] | None = None
    n_frames: Annotated[int, Field(ge=1, le=100000)] | None = None
    times_s: tuple[NotNegative, ...] | None = None

    @model_validator(mode="after")
    def _complete(self) -> CameraSpec:
        if (self.hfov_deg is None) == (self.fx_px is None):
            raise ValueError("expected either hfov_deg or fx_px")
        if (self.times_s is None) == (self.fps is None or self.n_frames is None):
            raise ValueError("expected either fps and n_frames, or times_s")
        if any(side % 2 for side in self.image_size):
            raise ValueError("image_size: expected even sides, which H.264 needs")
        if self.times_s is not None and self.times_s[:1] != (0.0,):
            raise ValueError("times_s: expected the first picture at 0")
        if self.times_s is not None and (len(self.times_s) == 0 or np.any(np.diff(self.times_s) < TIME_TICK_S)):
            raise ValueError("times_s: expected at least one time, each later than the one before")
        n_wanted = {"none": 0, "plumb_bob": 5, "rational": 8, "fisheye": 4}[self.distortion_model]
        if len(self.distortion) != n_wanted:
            raise ValueError(f"distortion: {self.distortion_model} has {n_wanted} coefficients")
        return self

    def frame_times_s(self) -> Floats:
        """Times of the pictures ``(N,)``, on the clip's time base."""
        if self.times_s is not None:
            times = np.asarray(self.times_s)
        else:
            times = np.arange(self.n_frames or 0) / (self.fps or 1.0)
        return np.round(times / TIME_TICK_S) * TIME_TICK_S


class OwnMotion(SceneModel):
    """How the camera moves; speed 0 is a resting one. ``radius_m`` is the size of what carries it.

    Standard deviations of what comes on top: ``sway_m`` along x, y and z, ``swing_deg`` in pan, tilt and roll, each
    with a period; ``shake_deg`` in all three at 4-9 Hz.
    """

    heading_deg: float = 0.0
    speed_m_s: NotNegative = 0.0
    acceleration_m_s2: float = 0.0
    acceleration_from_s: NotNegative = 0.0
    acceleration_until_s: NotNegative | None = None
    yaw_rate_deg_s: Annotated[float, Field(ge=-120, le=120)] = 0.0
    yaw_from_s: NotNegative = 0.0
    yaw_until_s: NotNegative | None = None
    climb_m_s: float = 0.0
    sideslip_amplitude_deg: Annotated[float, Field(ge=0, lt=90)] = 0.0
    sideslip_period_s: Annotated[float, Field(ge=0.5)] = 2.0
    pitch_jitter_deg: Annotated[float, Field(ge=0, le=10)] = 0.0
    sway_m: tuple[NotNegative, NotNegative, NotNegative] = (0.0, 0.0, 0.0)
    sway_period_s: Annotated[float, Field(ge=0.5)] = 4.0
    swing_deg: tuple[NotNegative, NotNegative, NotNegative] = (0.0, 0.0, 0.0)
    swing_period_s: Annotated[float, Field(ge=0.5)] = 4.0
    shake_deg: Annotated[float, Field(ge=0, le=10)] = 0.0
    radius_m: Positive = 1.0


class Ground(SceneModel):
    """The ground at z = 0. ``street`` runs along x, or round ``centre_m`` at ``bend_radius_m``."""

    kind: Literal["street", "square", "fields", "none"] = "street"
    road_width_m: Positive = 7.0
    road_offset_m: float = 0.0
    pavement_width_m: NotNegative = 3.0
    bend_radius_m: Annotated[float, Field(ge=5)] | None = None
    centre_m: tuple[float, float] | None = None

    @model_validator(mode="after")
    def _bend_has_centre(self) -> Ground:
        if (self.bend_radius_m is None) != (self.centre_m is None):
            raise ValueError("expected bend_radius_m and centre_m together")
        return self


class PictureSpec(SceneModel):
    """How the pictures are made: sky, samples per pixel and axis, and what makes them worse.

    ``texture`` and ``contrast`` scale the contrast of the surfaces and of the whole picture; ``vignetting`` is the
    share of the light that the corners lose; ``gain_steps`` (time, factor) are steps of the exposure; ``exposure_s``
    blurs what moves; ``readout_s`` is the time from the first row to the last; ``n_spots`` drops or specks rest in the
    picture; ``repeated_frames`` show the picture before them once more, at their own time; ``codec_crf`` is that of
    the clip (0: nothing is lost).
    """

    noise_grey: Annotated[float, Field(ge=0, le=50)] = 1.0
    texture: Annotated[float, Field(ge=0, le=1)] = 1.0
    contrast: Annotated[float, Field(ge=0, le=1)] = 1.0
    vignetting: Annotated[float, Field(ge=0, lt=1)] = 0.0
    gain_steps: tuple[tuple[NotNegative, Positive], ...] = ()
    exposure_s: Annotated[float, Field(ge=0, le=0.2)] = 0.0
    readout_s: Annotated[float, Field(ge=0, le=0.2)] = 0.0
    n_spots: Annotated[int, Field(ge=0, le=1000)] = 0
    repeated_frames: tuple[Annotated[int, Field(ge=1)], ...] = ()
    codec_crf: Annotated[int, Field(ge=0, le=51)] = 12
    supersampling: Annotated[int, Field(ge=1, le=4)] = 2
    sky: Literal["clear", "clouds"] = "clear"


class Repeat(SceneModel):
    """Further copies of a body, each ``step_m`` from the one before."""

    count: Annotated[int, Field(ge=1, le=200)]
    step_m: Vector


class Body(SceneModel):
    """One body of the scene: what it is, where it stands at time 0 (centre of its base), how it moves.

    Either ``speed_m_s`` along ``heading_deg`` or ``velocity_m_s`` (then ``heading_deg`` is where it faces, along its
    motion when not given). ``lane_change_m`` to the left comes on top of a straight path; ``spin_deg_s`` turns a body
    about the axes x, y and z through the centre of its base. ``size_m`` is (length, width, height). ``is_object``
    decides whether it is an object of the truth or part of the static scene; what moves always is one.
    """

    name: str = Field(min_length=1, max_length=60)
    kind: Kind
    at_m: Vector
    size_m: tuple[Positive, Positive, Positive] | None = None
    colour_rgb: tuple[Annotated[int, Field(ge=0, le=255)], ...] | None = Field(default=None, min_length=3, max_length=3)
    heading_deg: float | None = None
    pitch_deg: Annotated[float, Field(gt=-90, lt=90)] = 0.0
    bank_deg: Annotated[float, Field(gt=-180, lt=180)] = 0.0
    speed_m_s: NotNegative = 0.0
    velocity_m_s: Vector | None = None
    acceleration_m_s2: float = 0.0
    acceleration_from_s: NotNegative = 0.0
    acceleration_until_s: NotNegative | None = None
    yaw_rate_deg_s: Annotated[float, Field(ge=-120, le=120)] = 0.0
    yaw_from_s: NotNegative = 0.0
    yaw_until_s: NotNegative | None = None
    lane_change_m: float = 0.0
    lane_change_from_s: NotNegative = 0.0
    lane_change_duration_s: Positive = 3.0
    spin_deg_s: Vector = (0.0, 0.0, 0.0)
    is_object: bool | None = None
    repeat: Repeat | None = None

    @model_validator(mode="after")
    def _one_motion(self) -> Body:
        if self.velocity_m_s is not None and self.speed_m_s > 0:
            raise ValueError("expected either speed_m_s or velocity_m_s")
        if self.is_object is False and (
            self.speed_m_s > 0 or self.acceleration_m_s2 > 0 or any(self.velocity_m_s or ())
        ):
            raise ValueError("is_object: a body that moves is an object, leave is_object out")
        if self.yaw_rate_deg_s and (self.lane_change_m or any(self.spin_deg_s)):
            raise ValueError("yaw_rate_deg_s: expected none beside lane_change_m or spin_deg_s")
        if self.lane_change_m and any(self.spin_deg_s):
            raise ValueError("spin_deg_s: expected none beside lane_change_m")
        return self


class Scene(SceneModel):
    """A whole scene. ``description`` is for the reader."""

    name: str = Field(min_length=1, max_length=60)
    description: str = ""
    seed: Annotated[int, Field(ge=0)] = 0
    camera: CameraSpec
    own_motion: OwnMotion = OwnMotion()
    ground: Ground = Ground()
    picture: PictureSpec = PictureSpec()
    bodies: tuple[Body, ...] = ()

    @model_validator(mode="after")
    def _lens_reaches_the_corners(self) -> Scene:
        camera = camera_of(self)
        width, height = self.camera.image_size
        across, down = np.arange(-0.5, width), np.arange(-0.5, height)
        rim = [np.stack(np.broadcast_arrays(across, y), axis=-1) for y in (-0.5, height - 0.5)]
        rim += [np.stack(np.broadcast_arrays(x, down), axis=-1) for x in (-0.5, width - 0.5)]
        if not np.isfinite(rays_from_pixels(camera, np.concatenate(rim))).all():
            raise ValueError("camera.distortion: the lens model cannot reach the corners of the picture")
        return self

    @model_validator(mode="after")
    def _unique_names(self) -> Scene:
        names = [body.name for body in self.bodies]
        doubled = sorted({name for name in names if names.count(name) > 1})
        if doubled:
            raise ValueError(f"bodies: name {doubled[0]!r} stands twice, expected a name of its own for each")
        return self


def camera_of(scene: Scene) -> Camera:
    """The camera of a scene: missing ``fy_px`` equals ``fx_px``, a missing principal point is the centre."""
    spec = scene.camera
    width, height = spec.image_size
    half_width = (width - 1) / 2
    fx = spec.fx_px if spec.fx_px is not None else width / 2 / np.tan(np.radians(spec.hfov_deg or 0.0) / 2)
    return Camera(
        fx_px=float(fx),
        fy_px=float(fx if spec.fy_px is None else spec.fy_px),
        cx_px=half_width if spec.cx_px is None else spec.cx_px,
        cy_px=(height - 1) / 2 if spec.cy_px is None else spec.cy_px,
        image_size=ImageSize(width, height),
        distortion_model=spec.distortion_model,
        distortion=spec.distortion,
        origin=f"scene {scene.name}",
    )
