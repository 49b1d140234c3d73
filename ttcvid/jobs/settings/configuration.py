"""The resolved configuration of an analysis: where each value comes from, the strongest place first.

Command line (or Python arguments) > ``TTCVID_*`` environment > ``--config FILE`` > ``./ttcvid.toml`` > defaults.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from ttcvid.config import OverlayConfig, PipelineConfig, StageConfig
from ttcvid.errors import UsageError, quoted
from ttcvid.jobs.settings.layers import (
    Entry,
    Layer,
    layer_from_arguments,
    layer_from_command_line,
    layer_from_environment,
    layer_from_file,
)
from ttcvid.jobs.settings.options import (
    ALTERNATIVES,
    ANALYSIS_SECTIONS,
    AUTO_HORIZON,
    PATH_OPTIONS,
    SECTIONS,
    AnalyzeOptions,
)

PROJECT_FILE = "ttcvid.toml"
TOLD_BY_CLIP = "told by the clip"
"""Origin of a value that nobody gave and that the clip itself tells."""


@dataclass(frozen=True)
class Configuration:
    """Every parameter of an analysis.

    ``origins["tracking.max_tracks"]`` says where a value comes from; defaults are not listed.
    """

    options: AnalyzeOptions
    pipeline: PipelineConfig
    overlay: OverlayConfig
    origins: dict[str, str]

    def as_manifest(self) -> dict[str, dict[str, dict[str, Any]]]:
        """``{section: {key: {"value": ..., "origin": ...}}}``, ready for JSON."""
        sections: dict[str, StageConfig] = {
            name: getattr(self.pipeline, name, self.options) for name in ANALYSIS_SECTIONS
        }
        sections["overlay"] = self.overlay
        return {
            section: {
                key: {"value": value, "origin": self.origins.get(f"{section}.{key}", "default")}
                for key, value in values.model_dump(mode="json").items()
            }
            for section, values in sections.items()
        }


def configure_from_command_line(
    options: Mapping[str, str | None], settings: Iterable[str] = (), config: Path | None = None
) -> Configuration:
    """Resolve what the command line says together with the environment, files and defaults."""
    return _resolve(layer_from_command_line(options, settings), config)


def configure_from_arguments(options: Mapping[str, Any], config: Path | None = None) -> Configuration:
    """Resolve Python arguments together with the environment, files and defaults, as the command line would."""
    return _resolve(layer_from_arguments(options), config)


def configure_each(for_all: Layer, own: Iterable[Layer], config: Path | None = None) -> list[Configuration]:
    """One configuration for each of ``own``: its settings over ``for_all``, the environment, files and defaults.

    Paths in it are absolute: it may be followed in another working folder.
    """
    merged, origins = _merge(for_all, config)
    configurations = []
    for layer in own:
        values, places = {section: dict(keys) for section, keys in merged.items()}, dict(origins)
        _lay_over(values, places, layer)
        for name in PATH_OPTIONS:
            path = values["analyze"].get(name)
            if path is not None and (name, str(path)) != AUTO_HORIZON:
                values["analyze"][name] = path.absolute()
        configurations.append(_configuration(values, places))
    return configurations


Study = TypeVar("Study", bound=StageConfig)


def configure_study(
    section: str, parameters: type[Study], options: Mapping[str, Any], config: Path | None = None, is_text: bool = False
) -> Study:
    """Resolve the section of a study: ``options`` (None: not given) over the environment, files and defaults.

    With ``is_text`` the options come from the command line, else from Python.
    """
    explicit = Layer("command line" if is_text else "argument", is_text)
    for name, value in options.items():
        if value is not None:
            explicit.add(section, name, value, f"--{name.replace('_', '-')}" if is_text else name)
    merged, _ = _merge(explicit, config)
    study = parameters(**merged[section])
    _refuse_contradiction(section, study)
    return study


def _refuse_contradiction(section: str, values: StageConfig) -> None:
    """Known only when the values of all places are together."""
    contradiction = values.contradiction()
    if contradiction is not None:
        raise UsageError(f"[{section}] {contradiction}")


def _resolve(explicit: Layer, config: Path | None) -> Configuration:
    return _configuration(*_merge(explicit, config))


def _configuration(merged: dict[str, dict[str, Any]], origins: dict[str, str]) -> Configuration:
    stages = {name: values for name, values in merged.items() if name in PipelineConfig.model_fields}
    options = AnalyzeOptions(**merged["analyze"])
    pipeline = PipelineConfig(**stages)
    for section in stages:
        _refuse_contradiction(section, getattr(pipeline, section))
    return Configuration(options, pipeline, OverlayConfig(**merged["overlay"]), origins)


def _merge(explicit: Layer, config: Path | None) -> tuple[dict[str, dict[str, Any]], dict[str, str]]:
    """Values by section and key, and the origin of each ``section.key``, of all places together."""
    files = [path for path in (config, Path(PROJECT_FILE)) if path is not None]
    if not Path(PROJECT_FILE).exists():
        files.pop()
    strongest_first = [explicit, layer_from_environment(os.environ), *map(layer_from_file, files)]
    merged: dict[str, dict[str, Any]] = {section: {} for section in SECTIONS}
    origins: dict[str, str] = {}
    for layer in reversed(strongest_first):
        _lay_over(merged, origins, layer)
    return merged, origins


def _lay_over(merged: dict[str, dict[str, Any]], origins: dict[str, str], layer: Layer) -> None:
    """Check a layer and let its values replace those of the weaker ones in ``merged``."""
    _drop_weaker_alternatives(merged, origins, layer)
    for section, entries in layer.entries.items():
        for key, value in _checked(section, entries, layer.is_text).items():
            merged[section][key] = value
            is_variable = layer.origin == "environment"
            origins[f"{section}.{key}"] = entries[key].place if is_variable else layer.origin


def _drop_weaker_alternatives(merged: dict[str, dict[str, Any]], origins: dict[str, str], layer: Layer) -> None:
    given = layer.entries.get("analyze", {})
    for alternatives in ALTERNATIVES:
        chosen = [given[key].place for key in alternatives if key in given]
        if len(chosen) > 1:
            raise UsageError(f"{' and '.join(chosen)} exclude each other: give only one of them")
        if chosen:
            for key in alternatives:
                merged["analyze"].pop(key, None)
                origins.pop(f"analyze.{key}", None)


def _checked(section: str, entries: Mapping[str, Entry], is_text: bool) -> dict[str, Any]:
    """Values of one section with their types, bounds and finiteness checked.

    Typed values go through JSON because pydantic's strict mode then still takes text for a path or a named
    choice, but neither text nor true/false for a number.
    """
    values = {key: entry.value for key, entry in entries.items()}
    parameters = SECTIONS[section]
    try:
        if is_text:
            checked = parameters.model_validate_strings(values)
        else:
            checked = parameters.model_validate_json(json.dumps(values, default=str), strict=True)
    except ValidationError as error:
        raise _usage_error(error, entries) from None
    return {key: getattr(checked, key) for key in values}


def _usage_error(error: ValidationError, entries: Mapping[str, Entry]) -> UsageError:
    first = error.errors(include_url=False)[0]
    entry = entries[str(first["loc"][0])]
    expectation = first["msg"].removeprefix("Value error, ").replace("Input should be", "expected")
    if first["type"] == "string_type":
        expectation = "expected text"
    return UsageError(f"{entry.place} = {quoted(entry.value)}: {expectation}")
