"""The places that settings come from, each read into one layer: arguments, environment, configuration files."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ttcvid.errors import UsageError, quoted
from ttcvid.jobs.settings.options import AUTO_HORIZON, PATH_OPTIONS, SECTIONS, SHORTCUTS
from ttcvid.plain_files import read_plain

MAX_CONFIGURATION_BYTES = 1_000_000
ENVIRONMENT_PREFIX = "TTCVID_"
NOT_OPTIONS = frozenset({"TTCVID_DATA", "TTCVID_DEBUG"})
"""Variables with our prefix that steer tests and error display, not an analysis."""


@dataclass(frozen=True)
class Entry:
    """A value and its place as an error message names it: ``--focal-px`` or ``car.toml: [tracking] tracker``."""

    value: Any
    place: str


@dataclass
class Layer:
    """Settings of one origin: ``entries[section][key]``. With ``is_text``, the values are strings yet to be read."""

    origin: str
    is_text: bool
    entries: dict[str, dict[str, Entry]] = field(default_factory=dict)

    def add(self, section: str, key: str, value: Any, place: str) -> None:
        """Put a setting where it is kept; UsageError for an unknown name or a second, different value."""
        section, key = SHORTCUTS.get(key, (section, key)) if section == "analyze" else (section, key)
        require_known(section, SECTIONS, f"{place}: unknown section [{section}]")
        known = _known_keys(section)
        elsewhere = [f"[{name}]" for name in SECTIONS if key in SECTIONS[name].model_fields]
        if key not in known and elsewhere:
            raise UsageError(f"{place}: unknown key {key!r}: it belongs under {' or '.join(elsewhere)}")
        require_known(key, known, f"{place}: unknown key {key!r}")
        entries = self.entries.setdefault(section, {})
        before = entries.get(key)
        if before is not None and before.value != value:
            raise UsageError(
                f"{place} = {quoted(value)} contradicts {before.place} = {quoted(before.value)}: "
                f"both set [{section}] {key}, keep one"
            )
        entries[key] = Entry(value, place)


def _known_keys(section: str) -> list[str]:
    return [*SECTIONS[section].model_fields, *(SHORTCUTS if section == "analyze" else ())]


def require_known(name: str, known: Iterable[str], problem: str) -> None:
    """UsageError that names the nearest known name, or all of them where none is near."""
    known = list(known)
    if name in known:
        return
    nearest = difflib.get_close_matches(name, known, n=1)
    remedy = f"did you mean {nearest[0]!r}?" if nearest else f"expected one of {', '.join(known)}"
    raise UsageError(f"{problem}: {remedy}")


def layer_from_command_line(options: Mapping[str, str | None], settings: Iterable[str]) -> Layer:
    """Options by name (None: not given) and ``section.key=value`` settings, all as text."""
    layer = Layer("command line", is_text=True)
    for name, value in options.items():
        if value is not None:
            layer.add("analyze", name, value, f"--{name.replace('_', '-')}")
    for setting in settings:
        path, equals, value = setting.partition("=")
        section, dot, key = path.strip().partition(".")
        if not (equals and dot):
            raise UsageError(f"--set {setting}: expected section.key=value, such as tracking.max_tracks=800")
        layer.add(section, key, value.strip(), f"--set {path.strip()}")
    return layer


def layer_from_arguments(options: Mapping[str, Any]) -> Layer:
    """Keyword arguments of the Python interface: options by name, stages as mappings (``tracking={...}``)."""
    layer = Layer("argument", is_text=False)
    for name, value in options.items():
        if isinstance(value, Mapping):
            for key, inner in value.items():
                place = f"{name}[{key!r}]"
                layer.add(name, key, _plain(inner, place), place)
        elif name in SECTIONS and name not in SECTIONS["analyze"].model_fields:
            raise UsageError(
                f"{name} = {quoted(value)}: expected the parameters of this stage as a mapping, such as {name}={{...}}"
            )
        elif value is not None:
            layer.add("analyze", name, _plain(value, name), name)
    return layer


def _plain(value: Any, place: str) -> Any:
    """Numpy scalars as Python numbers; UsageError for what holds several values."""
    n_dimensions = getattr(value, "ndim", None)
    if n_dimensions:
        remedy = "the path of a file" if place in PATH_OPTIONS else "one value"
        raise UsageError(f"{place}: got an array of shape {value.shape}: expected {remedy}")
    return value.item() if n_dimensions == 0 else value


def layer_from_environment(environment: Mapping[str, str]) -> Layer:
    """``TTCVID_PLATFORM=vehicle``, ``TTCVID_TRACKING__MAX_TRACKS=800``; an empty value counts as not given."""
    layer = Layer("environment", is_text=True)
    for name in sorted(environment):
        if not name.startswith(ENVIRONMENT_PREFIX) or name in NOT_OPTIONS or not environment[name]:
            continue
        first, underscores, second = name.removeprefix(ENVIRONMENT_PREFIX).lower().partition("__")
        section, key = (first, second) if underscores else ("analyze", first)
        layer.add(section, key, environment[name], f"environment variable {name}")
    return layer


def layer_from_file(path: Path) -> Layer:
    """A TOML file of sections. Its relative paths are relative to its own folder."""
    layer = Layer(f"file {path}", is_text=False)
    for section, content in _read_toml(path).items():
        if not isinstance(content, dict):
            raise UsageError(
                f"{path}: {section!r} stands outside a section: expected it under a line such as [analyze]"
            )
        require_known(section, SECTIONS, f"{path}: unknown section [{section}]")
        for key, value in content.items():
            if section == "analyze" and key in PATH_OPTIONS and isinstance(value, str) and (key, value) != AUTO_HORIZON:
                value = str(path.absolute().parent / value)
            layer.add(section, key, value, f"{path}: [{section}] {key}")
    return layer


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(read_plain(path, MAX_CONFIGURATION_BYTES).decode("utf-8-sig"))
    except OSError as error:
        raise UsageError(f"{path}: cannot be read as configuration ({error.strerror}): check --config") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"{path}: is no valid TOML: {error}: mend the file") from None
    except RecursionError:
        raise UsageError(
            f"{path}: is nested too deeply for a configuration: expected sections of plain values"
        ) from None
