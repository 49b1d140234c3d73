"""What one analysis can be told, beside the parameters of its stages: the names that all three interfaces share."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, PlainSerializer, PlainValidator

from ttcvid.calibration.fields import MAX_IMAGE_SIDE_PX
from ttcvid.config import (
    CollisionMapConfig,
    OverlayConfig,
    PipelineConfig,
    PositiveFloat,
    SensitivityConfig,
    StageConfig,
)
from ttcvid.model import ImageSize
from ttcvid.picture_header import MAX_IMAGE_MPX

_SIZE = re.compile(r"([1-9]\d{0,5})x([1-9]\d{0,5})")


def image_size_from(value: Any) -> ImageSize:
    """``ImageSize`` of ``"1242x375"`` (or of an ImageSize itself); ValueError for anything else."""
    if isinstance(value, ImageSize):
        return value
    match = _SIZE.fullmatch(value) if isinstance(value, str) else None
    if match is None:
        raise ValueError("expected WIDTHxHEIGHT in px, such as 1242x375")
    size = ImageSize(int(match[1]), int(match[2]))
    if max(size.width_px, size.height_px) > MAX_IMAGE_SIDE_PX:
        raise ValueError(f"expected sides of at most {MAX_IMAGE_SIDE_PX} px")
    return size


def _place_text(value: Any) -> Any:
    """Frame numbers may come as numbers; ``Selection`` reads text."""
    if not isinstance(value, (int, str)) or isinstance(value, bool):
        raise ValueError('expected a frame number, or text such as "120", "4.5s" or "00:01:02.5"')
    return str(value)


ImageSizeText = Annotated[ImageSize, PlainValidator(image_size_from), PlainSerializer(str)]
PlaceText = Annotated[str, BeforeValidator(_place_text)]


class AnalyzeOptions(StageConfig):
    """The section ``[analyze]``: input, calibration and output of one analysis.

    Relative paths have been resolved: against the folder of the file that named them, else the working folder.
    """

    camera: Path | None = None
    focal_px: PositiveFloat | None = None
    hfov: float | None = Field(default=None, gt=0, lt=180, description="horizontal field of view in degrees")
    image_size: ImageSizeText | None = None
    horizon: Path | None = None
    mask: Path | None = None
    fps: float | None = Field(default=None, ge=1e-3, le=1e5)
    timestamps: Path | None = None
    start: PlaceText | None = None
    end: PlaceText | None = None
    stride: int = Field(default=1, ge=1, description="every n-th frame")
    max_image_mpx: PositiveFloat = Field(
        default=MAX_IMAGE_MPX, description="pictures that claim more, in 10^6 pixels, are left out"
    )
    overlay: bool = True
    report: bool = True
    overwrite: bool = False
    seed: int = Field(default=0, ge=0, description="recorded in the manifest; nothing in an analysis is random")

    @property
    def wants_auto_horizon(self) -> bool:
        """Whether the horizon is to be found in the clip itself."""
        return str(self.horizon) == AUTO_HORIZON[1]


def _stage_sections() -> dict[str, type[StageConfig]]:
    stages = {name: field.annotation for name, field in PipelineConfig.model_fields.items()}
    return {name: stage for name, stage in stages.items() if isinstance(stage, type) and issubclass(stage, StageConfig)}


ANALYSIS_SECTIONS: dict[str, type[StageConfig]] = {
    "analyze": AnalyzeOptions,
    **_stage_sections(),
    "overlay": OverlayConfig,
}
"""Sections of a configuration file that an analysis follows, with the class that checks each."""

STUDY_SECTIONS: dict[str, type[StageConfig]] = {"collision_map": CollisionMapConfig, "sensitivity": SensitivityConfig}
"""Sections of the other commands."""

SECTIONS = {**ANALYSIS_SECTIONS, **STUDY_SECTIONS}
"""Every section of a configuration file."""

SHORTCUTS = {
    "tracker": ("tracking", "tracker"),
    "platform": ("egomotion", "platform"),
    "estimator": ("collision_times", "estimator"),
    "smooth": ("collision_times", "smooth"),
    "moving": ("horizon_calibration", "moving"),
    "roll_zero": ("horizon_calibration", "roll_zero"),
}
"""Stage parameters that may be given like an option; they are kept in their stage's section alone."""

ALTERNATIVES = (("camera", "focal_px", "hfov"), ("fps", "timestamps"))
"""Options of which one place may give only one; given in a stronger place, it replaces the others of weaker places."""

AUTO_HORIZON = ("horizon", "auto")
"""The path option that can be a word instead: the clip itself is to tell the horizon. A file of that name: ./auto."""
PATH_OPTIONS = ("camera", "horizon", "mask", "timestamps")
