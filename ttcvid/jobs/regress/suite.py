"""The file of a regression suite: which clips are analysed how, and what is expected of the results."""

from __future__ import annotations

import difflib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import Field, ValidationError, field_validator, model_validator

from ttcvid.config import StageConfig
from ttcvid.errors import UsageError, quoted
from ttcvid.jobs.settings.options import PATH_OPTIONS
from ttcvid.jobs.settings.yaml_file import read_yaml
from ttcvid.studies.compare.tolerance import Tolerance, tolerance_from
from ttcvid.studies.regression.expectations import Expectation, expectation_from_text

NAME_PATTERN = r"[A-Za-z0-9][A-Za-z0-9_.-]*"


class SuiteClip(StageConfig):
    """One clip: a recorded ``clip`` or a ``scene`` to be rendered, options of analyze, and what is expected."""

    name: str = Field(pattern=rf"^{NAME_PATTERN}$")
    clip: str | None = None
    scene: str | None = None
    frames: int | None = Field(default=None, ge=1, description="only the first frames of a scene")
    options: dict[str, Any] = Field(default={})
    truth: str | None = None
    baseline: bool = True
    optional: bool = False
    tolerance: Any = None
    expectations: tuple[str, ...] = ()

    @field_validator("expectations", mode="before")
    @classmethod
    def _as_texts(cls, value: Any) -> Any:
        """Expectations come as lines, as ``name: value``, or as one mapping of those."""
        entries = [{key: inner} for key, inner in value.items()] if isinstance(value, dict) else value
        if not isinstance(entries, list | tuple):
            raise ValueError("expected a list of expectations")
        return tuple(text for entry in entries for text in _texts(entry))

    @model_validator(mode="after")
    def _one_input(self) -> SuiteClip:
        if (self.clip is None) == (self.scene is None):
            raise ValueError("expected either 'clip' or 'scene'")
        if self.frames is not None and self.scene is None:
            raise ValueError("'frames' is for scenes; of a clip take a part by options: {end: N}")
        return self


class _SuiteFile(StageConfig):
    root: str = "."
    baselines: str = "baselines"
    tolerance: Any = None
    options: dict[str, Any] = Field(default={})
    clips: tuple[SuiteClip, ...] = Field(min_length=1)


class Suite:
    """A suite that has been read and checked.

    ``root`` is the folder of the clips and of the files that options name, ``baselines`` that of the baselines.
    """

    def __init__(self, path: Path, content: _SuiteFile) -> None:
        self.path = path
        self.clips = content.clips
        self.root = path.parent / os.path.expandvars(content.root)
        self.baselines = path.parent / os.path.expandvars(content.baselines)
        self._options = content.options
        self._content = content
        self.expectations = {clip.name: _expectations(path, clip) for clip in self.clips}
        for clip in self.clips:
            self.tolerance(clip)

    def options(self, clip: SuiteClip) -> dict[str, Any]:
        """Options of a clip's analysis: its own over the suite's."""
        return {**self._options, **clip.options}

    def tolerance(self, clip: SuiteClip) -> Tolerance:
        """Tolerances of a clip: its own where it has some, else the suite's."""
        given = self._content.tolerance if clip.tolerance is None else clip.tolerance
        place = f"{self.path}: tolerance of clip {clip.name!r}"
        if isinstance(given, str):
            given = read_yaml(self.path.parent / given)
        return tolerance_from(given, place)

    def baseline(self, clip: SuiteClip) -> Path:
        """Where the baseline of a clip is kept."""
        return self.baselines / f"{clip.name}.yaml"

    def chosen(self, only: Sequence[str]) -> tuple[SuiteClip, ...]:
        """The clips of these names, or all; UsageError for an unknown name."""
        names = [clip.name for clip in self.clips]
        for name in only:
            if name not in names:
                nearest = difflib.get_close_matches(name, names, n=1)
                remedy = f"did you mean {nearest[0]!r}?" if nearest else f"expected one of {', '.join(names)}"
                raise UsageError(f"--only {name}: {self.path} has no such clip: {remedy}")
        return tuple(clip for clip in self.clips if not only or clip.name in only)


def read_suite(path: Path) -> Suite:
    """Read and check a suite; UsageError that names file, clip and field where it cannot be used."""
    content = read_yaml(path)
    if not isinstance(content, dict):
        raise UsageError(f"{path}: expected a list 'clips:' with name and clip or scene, found {quoted(content)}")
    try:
        suite = Suite(path, _SuiteFile.model_validate(content))
    except ValidationError as error:
        raise _usage_error(path, content, error) from None
    names = [clip.name for clip in suite.clips]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise UsageError(f"{path}: two clips are called {twice[0]!r}: give each a name of its own")
    return suite


def resolved(options: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Options of which paths are relative to ``folder``."""
    return {key: folder / value if key in PATH_OPTIONS else value for key, value in options.items()}


def _texts(entry: Any) -> list[str]:
    if isinstance(entry, str):
        return [entry]
    if isinstance(entry, dict):
        return [f"{key}: {value}" for key, value in entry.items()]
    raise ValueError(f"{quoted(entry)} is no expectation: expected text, such as 'events: none'")


def _expectations(path: Path, clip: SuiteClip) -> tuple[Expectation, ...]:
    place = f"{path}: clip {clip.name!r}: expectation"
    return tuple(expectation_from_text(text, place) for text in clip.expectations)


def _usage_error(path: Path, content: dict[Any, Any], error: ValidationError) -> UsageError:
    first = error.errors(include_url=False)[0]
    where, place = list(first["loc"]), str(path)
    if where[0:1] == ["clips"] and len(where) > 1:
        number, clips = int(where[1]), content.get("clips")
        clip = clips[number] if isinstance(clips, list) else {}
        name = clip.get("name") if isinstance(clip, dict) else None
        place += f": clip {name!r}" if name else f": clip number {number + 1}"
        where = where[2:]
    field = f" field {'.'.join(map(str, where))!r}:" if where else ""
    message = first["msg"].removeprefix("Value error, ").replace("Input should", "expected to")
    return UsageError(f"{place}:{field} {message}: mend the file")
