"""Options that every command which reads a clip has, declared once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from typing import Any, TypeVar

import click

from ttcvid.cli.grouped import option_under

Command = TypeVar("Command", bound=Callable[..., Any])
Option = Callable[..., Callable[[Command], Command]]

TRACKERS = ("klt", "akaze")

_IMAGE_SIZE = "Picture size in px of a track table without a camera file."
_MAX_IMAGE_MPX = "Skip pictures whose header claims more, in 10^6 pixels.  [default: 100]"
_MASK = "Picture, black where nothing is to be analysed (own bonnet, text)."
_FPS = "Frame rate of an image folder; of a video, instead of its own times."
_TIMESTAMPS = "Times of all frames in seconds, one a line, or in KITTI's format."

_time_option = option_under("Time (frames as 120, seconds as 4.5s or 00:01:02.5)")
method_option = option_under("Method")
output_option = option_under("Output")


def clip_options(camera_option: Option[Any]) -> Callable[[Command], Command]:
    """Focal length, picture size, mask and times; ``camera_option`` declares under the command's own heading."""
    return in_order(
        camera_option("--focal-px", metavar="PX", help="Focal length in px, principal point at the centre."),
        camera_option("--hfov", metavar="DEG", help="Horizontal field of view in degrees."),
        camera_option("--image-size", metavar="WxH", help=_IMAGE_SIZE),
        camera_option("--max-image-mpx", metavar="MPX", help=_MAX_IMAGE_MPX),
        camera_option("--mask", metavar="FILE", help=_MASK),
        _time_option("--fps", metavar="HZ", help=_FPS),
        _time_option("--timestamps", metavar="FILE", help=_TIMESTAMPS),
        _time_option("--start", metavar="PLACE", help="First frame or time.  [default: the beginning]"),
        _time_option("--end", metavar="PLACE", help="End (excluded).  [default: the end]"),
        _time_option("--stride", metavar="N", help="Take every N-th frame.  [default: 1]"),
    )


@dataclass(frozen=True)
class Messages:
    """What a command says: its summary as JSON, no progress and no warnings, or more than those."""

    as_json: bool
    quiet: bool
    verbose: bool


def message_options() -> Callable[[Callable[..., None]], Callable[..., None]]:
    """What is said, and where: the command gets ``messages``."""

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        @wraps(command)
        def with_messages(*arguments: Any, as_json: bool, quiet: bool, verbose: bool, **options: Any) -> None:
            command(*arguments, messages=Messages(as_json, quiet, verbose), **options)

        return in_order(
            output_option("--json", "as_json", is_flag=True, help="Print the summary as one JSON object."),
            output_option("-q", "--quiet", is_flag=True, help="No progress and no warnings on stderr."),
            output_option("-v", "--verbose", is_flag=True, help="Say on stderr what is being done."),
        )(with_messages)

    return decorate


def tracker_option() -> Callable[[Command], Command]:
    """How points are tracked."""
    return method_option("--tracker", type=click.Choice(TRACKERS), help="How points are tracked.  [default: klt]")


def configuration_options(example: str) -> Callable[[Command], Command]:
    """A file of settings, and single ones; ``example`` is a setting that means something to the command."""
    return in_order(
        method_option(
            "--config", metavar="FILE", help="TOML configuration; ./ttcvid.toml is read as well, with lower precedence."
        ),
        method_option(
            "--set",
            "settings",
            metavar="SECTION.KEY=VALUE",
            multiple=True,
            help=f"A parameter of a stage, such as {example}. Repeatable.",
        ),
    )


def in_order(*options: Callable[[Command], Command]) -> Callable[[Command], Command]:
    """The options as one decorator, in the order in which help lists them."""

    def decorate(command: Command) -> Command:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate
