"""What a scenario is: a family and a seed, the scene that they draw, and how it is to be analysed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from numpy.random import Generator

from ttcvid.simulate import Scene, camera_of

Values = dict[str, Any]
Kind = Literal["video", "tracks"]
Group = Literal["vehicle_ahead", "vehicle_other", "static", "free", "aircraft", "recorded"]
NuisanceValue = float | str | None


@dataclass(frozen=True)
class Family:
    """A test of the trade as a function of a random generator and of whether it is to end in a collision.

    ``draw`` returns the values of a scene file without name and seed, in the steady conditions of every nuisance's
    baseline. ``hfov_deg`` are the fields of view in which the test is in the picture. ``collides`` is None where both
    are drawn, equally often. ``kinds`` are the kinds of input that it makes sense for, its own first. ``warn_by_s``
    is the time before the contact by which the trade wants the warning.
    """

    name: str
    group: Group
    title: str
    draw: Callable[[Generator, bool], Values]
    platform: str = "vehicle"
    kinds: tuple[Kind, ...] = ("video", "tracks")
    hfov_deg: tuple[float, float] = (35.0, 110.0)
    collides: bool | None = None
    expected_status: str | None = None
    warn_by_s: float = 2.0


@dataclass(frozen=True)
class Recording:
    """Which part of recorded trajectories a scene takes: sequence and first time."""

    sequence: str
    start_s: float


@dataclass(frozen=True)
class Scenario:
    """One scene of the suite; family and seed determine it.

    ``is_collision`` says whether an object touches us if nobody acts. ``focal_error`` is the relative error of the
    focal length that the analysis is given, where ``camera_known``. ``nuisances`` holds the drawn value of each, by
    name. ``recording`` is where the objects come from, if not from the scene. ``expected_status`` is what has to be
    told where nothing can be estimated.
    """

    family: str
    seed: int
    group: Group
    scene: Scene
    kind: Kind
    platform: str
    camera_known: bool
    focal_error: float
    is_collision: bool
    expected_status: str | None
    warn_by_s: float
    nuisances: dict[str, NuisanceValue] = field(default_factory=dict)
    recording: Recording | None = None

    @property
    def name(self) -> str:
        """Family and seed, as ``--show`` takes it."""
        return f"{self.family}:{self.seed}"

    def described(self) -> dict[str, Any]:
        """All but the scene, as ``scenario.json`` has it."""
        values = {name: getattr(self, name) for name in self.__dataclass_fields__ if name not in ("scene", "recording")}
        values["recording"] = None if self.recording is None else asdict(self.recording)
        camera, times_s = camera_of(self.scene), self.scene.camera.frame_times_s()
        return {
            "name": self.name,
            **values,
            "image_size": [camera.image_size.width_px, camera.image_size.height_px],
            "true_focal_px": camera.fx_px,
            "n_frames": len(times_s),
            "duration_s": float(times_s[-1]),
            "repeated_frames": list(self.scene.picture.repeated_frames),
        }
