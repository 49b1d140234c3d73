"""Parameters of the stages: one frozen class each, with bounds and units.

Names, bounds and defaults stand here once. ``ttcvid.toml`` has a section of the same name for each class.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

from ttcvid.model import Platform

Fraction = Annotated[float, Field(gt=0, lt=1)]
LEAST_TRACK_FRAMES = 3
SENSITIVITY_SPANS = {
    "distance": (5.0, 200.0),
    "angle": (5.0, 85.0),
    "focal": (2.0, 50.0),
    "noise": (0.02, 2.0),
    "rate": (2.0, 100.0),
    "height": (0.1, 10.0),
}
"""What `ttcvid sensitivity` can vary and between which values by default: m, deg, mm, px, 1/s, m."""

PositiveFloat = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class StageConfig(BaseModel):
    """Base of all parameter classes: immutable, no unknown keys, no NaN or infinity."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    def contradiction(self) -> str | None:
        """What is wrong with the values together, each of which is possible; None: nothing."""
        return None


class TrackingConfig(StageConfig):
    """How points are detected and tracked."""

    tracker: Literal["klt", "akaze"] = "klt"
    max_tracks: int = Field(
        default=1300,
        ge=20,
        le=20000,
        description="live tracks (klt); of AKAZE features 1.1 times as many: some match none",
    )
    min_distance_px: float = Field(
        default=7.0, ge=1.0, description="minimum distance between a new corner and any track"
    )
    close_share: float = Field(
        default=0.1,
        ge=0.0,
        le=1.0,
        description="share of new corners allowed at 0.57 of that distance, on small objects",
    )
    far_share: float = Field(
        default=0.2,
        ge=0.0,
        le=1.0,
        description="share of new corners that go where the picture moves least: far away, where things are small",
    )
    corner_quality: Fraction = Field(
        default=0.005, description="corner response relative to the best one of the picture"
    )
    window_px: int = Field(default=9, ge=5, le=51, description="side of the Lucas-Kanade window")
    pyramid_levels: int = Field(default=3, ge=0, le=6, description="levels above the full picture")
    max_forward_backward_px: PositiveFloat = Field(
        default=0.2, description="forward-backward distance that ends a track"
    )
    akaze_threshold: PositiveFloat = Field(default=0.0004, description="AKAZE detector response")
    akaze_layers: int = Field(default=1, ge=1, le=8, description="AKAZE scales per octave")
    akaze_ratio: Fraction = Field(default=0.8, description="nearest over second nearest descriptor distance")
    sigma_floor_px: PositiveFloat = Field(default=0.05, description="least standard deviation of a track's position")
    sigma_start_px: PositiveFloat = Field(
        default=0.2, description="standard deviation assumed until it has been estimated"
    )


class EgomotionConfig(StageConfig):
    """Priors of own rotation and translation."""

    platform: Platform = Field(
        default=Platform.auto,
        description="what carries the camera; auto: static, vehicle or free, decided from the clip",
    )
    min_tracks: int = Field(default=12, ge=5, description="fewer tracks than this give the status few_tracks")


class BodiesConfig(StageConfig):
    """How tracks are segmented into the static scene and movers."""

    min_tracks: int = Field(
        default=6,
        ge=3,
        description="minimum number of tracks of a new mover; 5 for an expanding object at constant bearing",
    )
    scene_gate: PositiveFloat = Field(
        default=5.0,
        description="reduced chi-square on the scene's motion, over the median of its own tracks, above which a track "
        "contradicts the scene",
    )
    gain: PositiveFloat = Field(
        default=4.0,
        description="ratio by which a new mover's own motion has to reduce the chi-square of as many tracks as it "
        "needs; all its tracks together have to save as much",
    )
    confirm_frames: int = Field(
        default=2,
        ge=1,
        description="frames in which a new mover or obstacle of min_tracks tracks has to be found before it gets its "
        "cluster_id: fewer with more tracks (what stands in our way or expands: two at the least), more with fewer",
    )
    forget_frames: int = Field(
        default=2, ge=0, description="frames for which a mover with fewer than three tracks keeps them"
    )


class CollisionTimesConfig(StageConfig):
    """Which estimator gives the times, and from which frames."""

    estimator: Literal["multi-frame", "three-frame", "two-frame"] = "multi-frame"
    smooth: bool = Field(
        default=False, description="multi-frame: directions, times and objects from frames on both sides"
    )
    max_frames: int = Field(
        default=20,
        ge=3,
        le=100,
        description="multi-frame: maximum number of views of a track; above 30 frames/s they are thinned to span the "
        "same time as at 30",
    )
    object_window_s: PositiveFloat = Field(
        default=0.75, description="multi-frame: length of the window of a mover; cars brake within a second"
    )
    window_probability: Fraction = Field(
        default=0.999, description="multi-frame: chi-square probability within which one motion explains the views"
    )
    max_gap_frames: int = Field(
        default=10,
        ge=1,
        le=60,
        description="largest gap of the flexible baseline, in views (frames; above 30 frames/s thinned)",
    )
    target_flow_px: PositiveFloat = Field(default=8.0, description="the gap grows until the flow is this long")

    def contradiction(self) -> str | None:
        """Two and three views are those of the past."""
        if self.smooth and self.estimator != "multi-frame":
            return f"smooth needs estimator = multi-frame, got {self.estimator}: leave one of them out"
        return None


class EventsConfig(StageConfig):
    """When an approach becomes a warning."""

    max_ttc_s: PositiveFloat = Field(default=4.0, description="a warning starts below this time to closest approach")
    max_miss_widths: PositiveFloat = Field(
        default=1.0,
        description="miss distance of a collision course, in object widths; on the road and of a camera at rest, in "
        "what makes it touch us",
    )
    confidence: Fraction = Field(default=0.95, description="probability of a collision course that a warning needs")
    persistence_s: PositiveFloat = Field(
        default=0.25,
        description="time over which the log odds of a collision course add up: a warning takes a tenth longer where "
        "all frames are sure of it, longer where they are not",
    )


class OverlayConfig(StageConfig):
    """The annotated video."""

    preset: Literal["ultrafast", "superfast", "veryfast", "faster", "fast", "medium"] = "ultrafast"
    crf: int = Field(default=24, ge=0, le=51, description="H.264 constant rate factor")
    trail_frames: int = Field(default=8, ge=1, le=60, description="length of the drawn track trails")


class HorizonCalibrationConfig(StageConfig):
    """How the horizon is estimated from objects that move in straight lines."""

    moving: bool = Field(default=False, description="the camera drives: its own motion determines the horizon")
    roll_zero: bool = Field(default=False, description="the camera has no roll: one direction is enough")
    min_track_s: PositiveFloat = Field(default=0.3, description="shortest track that is used, s")
    min_path_px: PositiveFloat = Field(default=8.0, description="minimum distance between a track's ends, px")
    min_tracks: int = Field(default=6, ge=2, description="minimum number of tracks of a mover")
    min_motion_s: PositiveFloat = Field(default=0.8, description="shortest motion, s: most of a stride")
    max_motion_s: PositiveFloat = Field(default=4.0, description="longer motions are cut into pieces of this length, s")
    link_part: Fraction = Field(default=0.06, description="neighbours are nearer than this part of the picture's width")
    speed_change_hz: PositiveFloat = Field(
        default=0.15, description="standard deviation of the change of speed, parts of the speed per s"
    )
    turn_sigma_deg_s: PositiveFloat = Field(
        default=0.7, description="standard deviation of the turn rate of motion that counts as straight, deg/s"
    )
    max_turn_deg: PositiveFloat = Field(default=4.0, description="a path that turns by more is curved, deg")
    error_memory_s: PositiveFloat = Field(
        default=0.6, description="correlation time of the errors of a mover's tracks, s: half a stride"
    )
    max_sigma_deg: PositiveFloat = Field(
        default=15.0, description="an epipole with a larger standard deviation is not used, deg"
    )
    floor_deg: PositiveFloat = Field(default=0.02, description="minimum scatter of epipoles, deg")
    picture_sigma_factor: float = Field(
        default=2.0, ge=1, description="factor on the standard deviation of epipoles found from pictures"
    )
    rigid_noise_px: PositiveFloat = Field(
        default=0.3,
        description="scatter about a body, px, above which its epipole's sigma grows in proportion",
    )
    outline_sigma_factor: float = Field(
        default=1.5, ge=1, description="factor on the standard deviation of epipoles found from outlines"
    )
    picture_floor_deg: PositiveFloat = Field(
        default=0.2,
        description="minimum standard deviation of an epipole found from pictures, deg: errors that its tracks have in "
        "common",
    )
    min_drive_s: PositiveFloat = Field(default=2.0, description="shortest own motion of a driving camera, s")
    driving_floor_deg: PositiveFloat = Field(
        default=0.2,
        description="standard deviation of a car's roll relative to the road, deg: cannot be measured, and widens the "
        "band",
    )
    min_motions: int = Field(default=3, ge=2, description="minimum number of straight motions")
    one_direction_probability: Fraction = Field(
        default=0.9999, description="probability at which two directions count as different"
    )
    min_spread_deg: PositiveFloat = Field(
        default=10.0, description="minimum certain angle between two of the directions, deg"
    )
    max_band_part: Fraction = Field(
        default=0.15, description="widest 95 % band (half its width) at the centre, part of the picture's height"
    )


class SensitivityConfig(StageConfig):
    """How well a camera can tell direction and time: the case, and what is varied."""

    speed_km_h: PositiveFloat = Field(default=50.0, description="speed of the point relative to the camera")
    angle_deg: float = Field(default=45.0, ge=0, lt=90, description="angle of its motion with the optical axis")
    distance_m: PositiveFloat = Field(default=50.0, description="distance, where that is not what is varied")
    height_m: PositiveFloat = Field(default=1.0, description="height of the point off the horizon's plane")
    focal_mm: PositiveFloat = Field(default=8.0, description="focal length")
    pixel_pitch_um: PositiveFloat = Field(
        default=4.65, description="size of a pixel; the paper does not say: that of a common 1/3 inch sensor"
    )
    sigma_px: PositiveFloat = Field(default=0.2, description="standard deviation of a coordinate in the picture")
    frame_rate_hz: PositiveFloat = Field(default=12.0, description="pictures a second")
    baseline_m: PositiveFloat = Field(default=0.15, description="distance between the cameras of the stereo pair")
    frames: str = Field(default="5,10,20", description="lengths of the whole tracks, in pictures")
    over: Literal["distance", "angle", "focal", "noise", "rate", "height"] = Field(
        default="distance", description="what is varied"
    )
    first: PositiveFloat | None = Field(default=None, description="its first value; default by what is varied")
    last: PositiveFloat | None = Field(default=None, description="its last value; default by what is varied")
    steps: int = Field(default=25, ge=2, le=500, description="number of its values")
    trials: int = Field(default=10000, ge=100, le=200000, description="noisy pictures tried of each value and method")
    within: Fraction = Field(default=0.1, description="relative error up to which a method counts as useful")
    seed: int = Field(default=0, ge=0, description="seed of the noise")

    @property
    def span(self) -> tuple[float, float]:
        """First and last value of what is varied."""
        first, last = SENSITIVITY_SPANS[self.over]
        return first if self.first is None else self.first, last if self.last is None else self.last

    @field_validator("frames")
    @classmethod
    def _are_lengths(cls, frames: str) -> str:
        parts = [part.strip() for part in frames.split(",")]
        if not all(part.isdecimal() and int(part) >= LEAST_TRACK_FRAMES for part in parts):
            raise ValueError("expected whole numbers of at least 3 pictures with commas between, such as 5,10,20")
        return ",".join(sorted(set(parts), key=int))

    def contradiction(self) -> str | None:
        """The first value lies below the last one."""
        first, last = self.span
        if first >= last:
            return f"first = {first:g} is not below last = {last:g}: raise last"
        if self.over == "angle" and last >= 90:
            return f"last = {last:g} deg: expected less than 90, for an approaching point"
        return None


class CollisionMapConfig(StageConfig):
    """What a change of own velocity leads to: scale, own size, limits, and the map itself."""

    ego_speed: str | None = Field(
        default=None, description="own speed: 13.9 (m/s), 50km/h, or FILE:COLUMN of a table with frame or t_s"
    )
    camera_height_m: PositiveFloat | None = Field(default=None, description="height of the camera over the ground")
    object_width_m: str | None = Field(
        default=None, description="width of objects: 1.8 for all, 3=2.5 for object 3, or both with a comma between"
    )
    width_m: PositiveFloat | None = Field(default=None, description="own width; a scene knows its own, else 1.8")
    length_m: PositiveFloat | None = Field(default=None, description="own length; a scene knows its own, else 4.5")
    height_m: PositiveFloat | None = Field(default=None, description="own height; a scene knows its own, else 1.5")
    look_ahead_s: float = Field(default=5.0, gt=0, le=60, description="collisions later than this do not count")
    warn_s: float = Field(default=3.5, gt=0, le=60, description="advice is given for contacts earlier than this")
    max_probability: Fraction = Field(
        default=0.1, description="probability of a collision above which advice is given, and to which it leads"
    )
    braking_m_s2: PositiveFloat = Field(default=6.0, description="hardest braking")
    sideways_m_s2: PositiveFloat = Field(default=3.0, description="largest acceleration sideways")
    forward_m_s2: float = Field(default=0.0, ge=0, description="largest acceleration forward that may be advised")
    turning_radius_m: float = Field(
        default=5.5, ge=0, le=100, description="radius of the narrowest turn; 0: we turn on the spot"
    )
    range_m_s: PositiveFloat | None = Field(
        default=None,
        description="largest change forward on the map, half of it sideways; default: own speed, but 3 to 15",
    )
    n_cells: int = Field(default=61, ge=3, le=401, description="cells of the map each way; odd, so that one is zero")
    units: Literal["km/h", "own-speed"] = Field(default="km/h", description="units of the picture's axes")

    @field_validator("n_cells")
    @classmethod
    def _has_a_middle(cls, n_cells: int) -> int:
        if n_cells % 2 == 0:
            raise ValueError("expected an odd number, so that the middle cell is the present velocity")
        return n_cells

    def contradiction(self) -> str | None:
        """An evasion has to be good for at least the time in which it is asked for."""
        if self.warn_s > self.look_ahead_s:
            return f"warn_s = {self.warn_s:g} is longer than look_ahead_s = {self.look_ahead_s:g}: shorten it"
        return None


class PipelineConfig(StageConfig):
    """All stages of one analysis."""

    tracking: TrackingConfig = TrackingConfig()
    egomotion: EgomotionConfig = EgomotionConfig()
    bodies: BodiesConfig = BodiesConfig()
    collision_times: CollisionTimesConfig = CollisionTimesConfig()
    events: EventsConfig = EventsConfig()
    horizon_calibration: HorizonCalibrationConfig = HorizonCalibrationConfig()
