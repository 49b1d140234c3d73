"""The options that tell an analysis about camera, time and method: those of ``analyze`` and ``batch``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click

from ttcvid.cli.clip_options import Command, clip_options, in_order, method_option, tracker_option
from ttcvid.cli.grouped import option_under

ESTIMATORS = ("multi-frame", "three-frame", "two-frame")
PLATFORMS = ("auto", "vehicle", "aircraft", "free", "static")

_camera_option = option_under("Camera (default: focal length estimated where the camera turns, else 55 deg assumed)")


def analysis_options() -> Callable[[Command], Command]:
    """Camera, horizon, times and method of an analysis."""
    return in_order(
        _camera_option(
            "--camera",
            metavar="FILE",
            help="Intrinsics and distortion, recognised by content: ttcvid YAML, ROS camera_info, Kalibr camchain, "
            "OpenCV FileStorage, KITTI calib.",
        ),
        _camera_option(
            "--horizon", metavar="FILE|auto", help="Horizon of the camera, or auto: switches planar motion on."
        ),
        clip_options(_camera_option),
        method_option(
            "--platform",
            type=click.Choice(PLATFORMS),
            help="What carries the camera: the prior of its motion; auto: decided from the clip.  [default: auto]",
        ),
        tracker_option(),
        method_option(
            "--estimator", type=click.Choice(ESTIMATORS), help="How times are estimated.  [default: multi-frame]"
        ),
        method_option(
            "--smooth/--no-smooth",
            default=None,
            help="Directions, times and objects from frames on both sides; warnings stay causal.  "
            "[default: --no-smooth]",
        ),
        method_option(
            "--seed", metavar="N", help="Recorded in the manifest; nothing in analyze is random.  [default: 0]"
        ),
    )


def as_text(value: Any) -> str | None:
    """An option's value as text, to be checked where settings of all places are."""
    return str(value).lower() if isinstance(value, bool) else value
