"""What a report says in words: what was found, what it rests on, and how the run was made."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

import numpy as np
import pyarrow.compute as pc

from ttcvid.errors import counted
from ttcvid.report.contents import RunContents
from ttcvid.report.objects import SeenObject, Warned

MAX_WARNINGS_IN_WORDS = 5
Fact = tuple[str, str]
"""A name and its value, as text."""

_STATES = {
    "complete": "The clip was analysed completely",
    "truncated": "The input breaks off: what could be decoded was analysed",
    "interrupted": "The analysis was interrupted: what was done until then is here",
}
_TOLD = ("ok", "first", "rotation_only", "static")
"""Statuses of frames of which own motion is known, as far as there is any."""
_PLATFORMS = {
    "vehicle": "The camera is carried by a vehicle: it moves about forward, on a road.",
    "aircraft": "The camera is carried by an aircraft.",
    "free": "Nothing is expected of what carries the camera.",
    "static": "The camera rests: it only shakes.",
}
_TIME_ORIGINS = {
    "presentation": "Frame times are those that the video itself has.",
    "timestamps": "Frame times are those of the file given by --timestamps.",
    "fps": "Frame times follow from the frame rate given by --fps.",
    "table": "Frame times are those of the table of tracks.",
}


@dataclass(frozen=True)
class Assumption:
    """A sentence on what the numbers rest on; ``is_weak`` where nobody has given or measured it."""

    text: str
    is_weak: bool = False


def title_of(contents: RunContents) -> str:
    """What the run is of: the name of its input."""
    path = str(contents.manifest["input"].get("path", contents.name))
    return PurePath(path).name or path


def summary_sentences(contents: RunContents, objects: list[SeenObject], warnings: tuple[Warned, ...]) -> list[str]:
    """The result in a few sentences."""
    counts, size = contents.manifest["counts"], contents.manifest["image_size"]
    t_s = contents.numbers("frames", "t_s")
    duration_s = float(t_s.max() - t_s.min())
    sentences = [
        f"{_STATES[contents.manifest['state']]}: {counted(counts['frames'], 'frame')} of {size['width_px']} × "
        f"{size['height_px']} px, over {duration_s:.1f} s.",
        _found_sentence(len(objects), len(warnings)),
    ]
    sentences += [_warned_sentence(warned) for warned in warnings[:MAX_WARNINGS_IN_WORDS]]
    if len(warnings) > MAX_WARNINGS_IN_WORDS:
        sentences.append(f"{counted(len(warnings) - MAX_WARNINGS_IN_WORDS, 'more warning')}: see the timeline.")
    nearest, settings = contents.manifest["nearest"], contents.manifest["configuration"]
    if nearest is not None:
        sentences.append(
            f"The smallest time to collision is {nearest['ttc_z_s']:.2f} s (90 % interval {nearest['ttc_z_lo_s']:.2f} "
            f"to {nearest['ttc_z_hi_s']:.2f} s), of object {nearest['cluster_id']} at frame {nearest['frame']}: of "
            f"objects that have certainly approached for {_value(settings, 'events', 'persistence_s')} s."
        )
    sentences += _own_motion_sentences(contents)
    return sentences


def _found_sentence(n_objects: int, n_warnings: int) -> str:
    if n_objects == 0:
        return "No object was found that moves on its own or stands in the way."
    found = f"{counted(n_objects, 'object')} {'was' if n_objects == 1 else 'were'} found"
    if n_warnings == 0:
        return f"{found}; nothing was warned of."
    return f"{found}; {counted(n_warnings, 'warning')} {'was' if n_warnings == 1 else 'were'} given."


def _warned_sentence(warned: Warned) -> str:
    kind = {"collision course": "on collision course", "constant bearing": "at constant bearing"}.get(
        warned.kind, warned.kind
    )
    smallest = "" if np.isnan(warned.min_ttc_z_s) else f", down to {warned.min_ttc_z_s:.2f} s to collision"
    return f"Object {warned.cluster_id} was {kind} from {warned.start_s:.2f} to {warned.end_s:.2f} s{smallest}."


def _own_motion_sentences(contents: RunContents) -> list[str]:
    statuses = Counter(contents.words("frames", "status"))
    n = sum(statuses.values())
    bad = {status: count for status, count in statuses.items() if status not in _TOLD}
    if not bad:
        return []
    listed = ", ".join(f"{count} {status}" for status, count in sorted(bad.items()))
    return [f"{sum(bad.values())} of {counted(n, 'frame')} do not determine own motion ({listed})."]


def assumptions(contents: RunContents) -> list[Assumption]:
    """What the numbers rest on, the weakest first."""
    manifest = contents.manifest
    settings = manifest["configuration"]
    found = [*_camera_assumptions(contents), _level(manifest)]
    found.append(_platform(manifest))
    found.append(Assumption(_TIME_ORIGINS.get(str(manifest["input"].get("time_origin")), "")))
    if _value(settings, "collision_times", "smooth") == "True":
        found.append(Assumption("Directions and times use frames on both sides; warnings are causal."))
    else:
        found.append(Assumption("Every value is causal: it uses the frames up to its own."))
    found.append(
        Assumption("Times hold if everything keeps its velocity: what brakes or turns later arrives at another time.")
    )
    found.append(
        Assumption(
            "Intervals hold the true value in 90 of 100 cases, as far as the camera is as described. One that is open "
            "upwards means that it is not certain that the object approaches."
        )
    )
    found.append(
        Assumption(
            "One camera tells no metres: miss distances are in seconds of relative motion (metres = miss × relative "
            "speed)."
        )
    )
    return sorted((one for one in found if one.text), key=lambda one: not one.is_weak)


def _platform(manifest: Mapping[str, Any]) -> Assumption:
    """What carries the camera, and whether the clip told it."""
    platform = manifest["platform"]
    told = f" That is told by the clip: {platform['reason']}." if platform["is_told_by_clip"] else ""
    return Assumption(f"{_PLATFORMS.get(platform['value'], '')}{told}".strip())


def _camera_assumptions(contents: RunContents) -> list[Assumption]:
    camera = contents.camera
    hfov_deg = 2 * np.degrees(np.arctan(camera.image_size.width_px / (2 * camera.fx_px)))
    focal = f"{camera.fx_px:.0f} px"
    if camera.is_assumed:
        text = (
            f"The focal length is assumed ({focal}, a horizontal field of view of {hfov_deg:.0f}°): directions and "
            "miss distances are only as good as that. Give --camera, --focal-px or --hfov."
        )
        found = [Assumption(text, is_weak=True)]
    elif camera.focal_sigma_px is not None:
        text = f"The focal length was found in the clip: {focal} ± {camera.focal_sigma_px:.0f} px."
        found = [Assumption(text, is_weak=True)]
    else:
        origin = {"focal_px": "--focal-px", "hfov_deg": "--hfov"}.get(camera.origin, PurePath(camera.origin).name)
        found = [Assumption(f"The focal length is {focal} ({hfov_deg:.0f}° horizontally), given by {origin}.")]
    if camera.distortion_model == "none":
        found.append(Assumption("The lens is taken as free of distortion."))
    else:
        found.append(Assumption(f"The lens is described by the model {camera.distortion_model}."))
    return found


def _level(manifest: Mapping[str, Any]) -> Assumption:
    if manifest["horizon"] is None:
        return Assumption("Things may move in any direction: no horizon was given.")
    return Assumption("Everything moves in the plane of the horizon that was given.")


def counts_and_statuses(contents: RunContents) -> dict[str, list[Fact]]:
    """Counts, the frames by status, the rows of objects by status and by state, and the rows of tracks by status."""
    counts = contents.manifest["counts"]
    tables = {
        "Frames": Counter(contents.words("frames", "status")),
        "Objects and scene, by frame": Counter(contents.words("clusters", "status")),
        "Motion of objects, by frame": Counter(contents.words("clusters", "state")),
        "Tracks, by frame": _track_statuses(contents),
    }
    facts = {"Counts": [(name.replace("_", " "), _text(value)) for name, value in counts.items() if value is not None]}
    for name, counter in tables.items():
        total = max(sum(counter.values()), 1)
        facts[name] = [(word, f"{n} ({100 * n / total:.1f} %)") for word, n in counter.most_common()]
    return facts


def _track_statuses(contents: RunContents) -> Counter[str]:
    values: Any = pc.value_counts(contents.tables["collision_times"]["status"].combine_chunks())
    return Counter({str(entry["values"]): int(entry["counts"]) for entry in values.to_pylist()})


def manifest_facts(contents: RunContents) -> dict[str, list[Fact]]:
    """What a reviewer asks for: input and its hash, settings that are not the defaults, camera, versions, time."""
    manifest = contents.manifest
    facts = {
        "Input": list(_flat(manifest["input"])),
        "Command": [("arguments", " ".join(map(str, manifest.get("arguments", []))))],
        "Settings that are not the defaults": list(_settings(manifest, is_all=False)),
        "Camera": list(_flat(manifest["camera"])),
        "Horizon": list(_flat(manifest["horizon"] or {})),
        "Versions": list(_flat(manifest["versions"])),
        "Time taken": list(_flat(manifest["timings"])),
        "All settings": list(_settings(manifest, is_all=True)),
    }
    return {name: rows for name, rows in facts.items() if rows}


def compared_facts(contents: RunContents) -> dict[str, str]:
    """What several runs differ in, in the words of `summary_sentences`; the same names for every run."""
    manifest = contents.manifest
    settings, counts, nearest = manifest["configuration"], manifest["counts"], manifest["nearest"]
    camera = contents.camera
    told = sum(status in _TOLD for status in contents.words("frames", "status"))
    smallest = "none"
    if nearest is not None:
        smallest = (
            f"{nearest['ttc_z_s']:.2f} s ({nearest['ttc_z_lo_s']:.2f} to {nearest['ttc_z_hi_s']:.2f} s), object "
            f"{nearest['cluster_id']}, frame {nearest['frame']}"
        )
    origin = "assumed" if camera.is_assumed else "found" if camera.is_found else PurePath(camera.origin).name
    return {
        "state": str(manifest["state"]),
        "input": title_of(contents),
        "hash of the input": str(manifest["input"]["sha256"])[:12],
        "frames": str(counts["frames"]),
        "frames that tell own motion": str(told),
        "objects": str(counts["objects"]),
        "warnings": str(counts["events"]),
        "smallest time to collision": smallest,
        "tracks in a frame, mean": f"{np.nanmean(contents.numbers('frames', 'n_tracks')):.0f}",
        "focal length": f"{camera.fx_px:.1f} px ({origin})",
        "horizon": "none" if manifest["horizon"] is None else "given",
        "platform": _value(settings, "egomotion", "platform"),
        "tracker": _value(settings, "tracking", "tracker"),
        "estimator": _value(settings, "collision_times", "estimator"),
        "smooth": _value(settings, "collision_times", "smooth").lower(),
        "ttcvid": str(manifest["versions"].get("ttcvid")),
        "frames/s": f"{manifest['timings']['frames_per_s']:.1f}",
    }


def _settings(manifest: Mapping[str, Any], is_all: bool) -> list[Fact]:
    """``section.key`` and value of each setting, with where it comes from; all of them, or those that somebody set."""
    rows = []
    for section, keys in manifest["configuration"].items():
        for key, entry in keys.items():
            origin = str(entry.get("origin", "default"))
            if is_all or origin != "default":
                rows.append((f"{section}.{key}", f"{_text(entry.get('value'))} ({origin})"))
    return rows


def _flat(values: Mapping[str, Any], above: str = "") -> list[Fact]:
    rows: list[Fact] = []
    for key, value in values.items():
        name = f"{above}{key}"
        if isinstance(value, Mapping):
            rows += _flat(value, f"{name}.")
        elif value is not None and value != []:
            rows.append((name, _text(value)))
    return rows


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}"
    return "none" if value is None else str(value)


def _value(settings: Mapping[str, Any], section: str, key: str) -> str:
    return str(settings.get(section, {}).get(key, {}).get("value"))
