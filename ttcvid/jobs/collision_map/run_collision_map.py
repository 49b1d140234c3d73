"""``ttcvid collision-map``: the map of a moment and the advice of every frame, from a scene's truth or from a run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from ttcvid.config import CollisionMapConfig
from ttcvid.errors import InputError, UsageError
from ttcvid.jobs.collision_map.moments import Clip, Moment
from ttcvid.jobs.collision_map.run_moments import run_clip
from ttcvid.jobs.collision_map.true_hazards import scene_clip
from ttcvid.jobs.runs.provenance import versions
from ttcvid.jobs.runs.run import Run
from ttcvid.jobs.settings.configuration import configure_study
from ttcvid.jobs.simulate import MARKER_NAME
from ttcvid.plain_files import printable
from ttcvid.sinks.failures import output_errors
from ttcvid.sinks.folder import OutputFolder
from ttcvid.sinks.manifest import MANIFEST_NAME
from ttcvid.sinks.tables import write_table
from ttcvid.studies.collision_map.evasion import Evasion, EvasionLimits, EvasionStatus, evade
from ttcvid.studies.collision_map.evasion_wording import caption_of, describe_advice
from ttcvid.studies.collision_map.picture import collision_map_figure, write_figure
from ttcvid.studies.collision_map.velocity_map import NO_OBJECT, CollisionMap, family_maps, map_of_changes

MAP_NAMES = ("collision_map.parquet", "collision_map.png", "collision_map.svg", "evasion.parquet")
_RANGE_M_S = (3.0, 15.0)
"""The map reaches as far as own speed, but at least and at most this."""
_NOTHING = Evasion(EvasionStatus.no_result, *(float("nan"),) * 5, NO_OBJECT)


@dataclass(frozen=True)
class MapResult:
    """What was written: the folder, the frame of the map, the map, and the advice of every frame."""

    folder: Path
    name: str
    frame: int
    t_s: float
    map: CollisionMap
    advice: Evasion
    n_frames: int
    n_advised: int

    def summary(self) -> str:
        """One line: what was found at the frame of the map, and in how many frames something is advised."""
        advised = f"an advice in {self.n_advised} of {self.n_frames} frames"
        return f"{self.folder}: frame {self.frame}: {describe_advice(self.advice, self.map.names)}; {advised}"

    def as_json(self) -> dict[str, Any]:
        """The summary as plain values; null where there is none."""
        advice = self.advice
        who = advice.object_index
        numbers = {
            "time_s": advice.time_s,
            "probability_now": advice.probability_now,
            "forward_m_s": advice.forward_m_s,
            "right_m_s": advice.right_m_s,
            "probability_after": advice.probability_after,
        }
        return {
            "folder": str(self.folder),
            "frame": self.frame,
            "t_s": self.t_s,
            "status": advice.status.value,
            "name": None if who == NO_OBJECT else self.map.names[who],
            **{name: value if np.isfinite(value) else None for name, value in numbers.items()},
            "frames": self.n_frames,
            "frames_with_advice": self.n_advised,
        }


def collision_map(
    run: str | Path,
    out: str | Path | None = None,
    *,
    frame: int | None = None,
    time_s: float | None = None,
    config: str | Path | None = None,
    overwrite: bool = False,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> MapResult:
    """Which change of own velocity would lead to a collision, and the smallest one that avoids it.

    Parameters
    ----------
    run : The output folder of an analysis, the folder of a simulation or a scene file (then its truth is used).
    out : Output folder; default ``NAME_map`` in the working folder.
    frame, time_s : The moment of the map; default: the first in which something is to be done, else the most dangerous
        one.
    config : A TOML file with the section ``[collision_map]``; ``TTCVID_*`` variables and ``./ttcvid.toml`` count as
        well.
    overwrite : Replace the result in a folder that exists.
    progress : Called with (frames done, frames in all).
    **options : The parameters of ``CollisionMapConfig``, as ``ego_speed="50km/h"``.

    Returns
    -------
    `MapResult`: the output folder, the map of the chosen moment and its advice.

    Raises
    ------
    TtcvidError
        Input, parameters or output place cannot be used.
    """
    path = Path(config) if config is not None else None
    parameters = configure_study("collision_map", CollisionMapConfig, options, path)
    return run_collision_map(Path(run), Path(out) if out else None, parameters, frame, time_s, overwrite, progress)


def run_collision_map(
    run: Path,
    out: Path | None,
    config: CollisionMapConfig,
    frame: int | None = None,
    time_s: float | None = None,
    overwrite: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> MapResult:
    """Make the map and the table of advices as configured; the parameters are those of `collision_map`."""
    clip = open_clip_of(run, config)
    chosen = _index_of(clip, frame, time_s)
    target = out if out is not None else Path(f"{run.stem}_map")
    with OutputFolder.create(target, overwrite, MAP_NAMES) as folder:
        moments = [clip.moment(n) for n in range(len(clip.frame))]
        advices = []
        for n, moment in enumerate(moments):
            advices.append(advice_at(moment, config))
            if progress is not None:
                progress(n + 1, len(moments))
        n = most_telling(advices) if chosen is None else chosen
        made = _make_map(clip, n, moments[n], advices[n], config, folder.partial)
        metadata = {"source": clip.name, "frame": str(clip.frame[n])}
        write_table(folder.partial / "collision_map.parquet", "collision_map", _map_rows(made), metadata)
        write_table(folder.partial / "evasion.parquet", "evasion", _evasion_rows(clip, moments, advices), metadata)
        result = MapResult(
            target,
            clip.name,
            int(clip.frame[n]),
            float(clip.t_s[n]),
            made,
            advices[n],
            len(moments),
            sum(advice.status in (EvasionStatus.advice, EvasionStatus.no_escape) for advice in advices),
        )
        folder.publish(
            {
                "state": "complete",
                "command": "collision-map",
                "versions": versions(),
                "configuration": config.model_dump(mode="json"),
                "input": [str(source) for source in clip.sources],
                "result": result.as_json(),
                "notes": list(moments[n].notes),
            }
        )
    return result


def open_clip_of(path: Path, config: CollisionMapConfig) -> Clip:
    """The frames of a run, of the folder of a simulation (its truth), or of a scene file (its truth).

    Raises
    ------
    InputError
        ``path`` is none of these, or cannot be read.
    UsageError
        The scale is missing, or is given where it is known; the scene file is not valid.
    """
    if path.is_dir() and (path / MARKER_NAME).is_file():
        return scene_clip(path / MARKER_NAME, config)
    if path.is_file() and path.suffix in (".yaml", ".yml"):
        return scene_clip(path, config)
    if path.is_dir() and (path / MANIFEST_NAME).is_file():
        return run_clip(Run.open(path), config)
    what = "holds neither" if path.is_dir() else "is neither a scene file nor a folder with"
    raise InputError(
        f"{path}: {what} manifest.json (a run) nor {MARKER_NAME} (a simulation): give the folder of 'ttcvid analyze' "
        "or 'ttcvid simulate', or a scene file"
    )


def _index_of(clip: Clip, frame: int | None, time_s: float | None) -> int | None:
    """The place of the wanted frame among the clip's; None: none was named."""
    if frame is not None and time_s is not None:
        raise UsageError("--frame and --time exclude each other: give only one of them")
    if frame is not None:
        places = np.flatnonzero(clip.frame == frame)
        if len(places) == 0:
            raise UsageError(f"--frame {frame}: {clip.name} has frames {clip.frame[0]} to {clip.frame[-1]}")
        return int(places[0])
    if time_s is not None:
        step_s = float(np.median(np.diff(clip.t_s))) if len(clip.t_s) > 1 else 0.0
        if not clip.t_s[0] - step_s <= time_s <= clip.t_s[-1] + step_s:
            raise UsageError(f"--time {time_s:g}: {clip.name} runs from {clip.t_s[0]:.3f} to {clip.t_s[-1]:.3f} s")
        return int(np.abs(clip.t_s - time_s).argmin())
    return None


def advice_at(moment: Moment, config: CollisionMapConfig) -> Evasion:
    """What is to be done at a moment, or why that cannot be told."""
    if moment.situation is None:
        return _NOTHING if moment.status is EvasionStatus.no_result else _no_scale()
    names = [field.name for field in fields(EvasionLimits) if field.name != "course_rad"]
    values = {name: getattr(config, name) for name in names}
    limits = EvasionLimits(**values, course_rad=moment.course_rad)
    # Who goes where the camera does not look, such as backwards, sees nothing of what could be hit.
    left, right = moment.course_rad
    if not left <= 0.0 <= right:
        return Evasion(EvasionStatus.unknown, *(float("nan"),) * 5, NO_OBJECT)
    # What may be at any distance may be anywhere: it is a reason to say that we do not know, and none to brake.
    hazards = moment.situation.hazards.without(moment.unlinked)
    advice = evade(replace(moment.situation, hazards=hazards), limits)
    if advice.status is not EvasionStatus.no_danger:
        return advice
    may_be_hit = evade(moment.situation, limits).status is not EvasionStatus.no_danger
    if may_be_hit or not moment.is_scene_known:
        return replace(advice, status=EvasionStatus.unknown)
    return advice


def _no_scale() -> Evasion:
    return Evasion(EvasionStatus.no_scale, *(float("nan"),) * 5, NO_OBJECT)


def most_telling(advices: list[Evasion]) -> int:
    """The first frame in which something is to be done, else that of the likeliest or earliest contact."""
    for n, advice in enumerate(advices):
        if advice.status in (EvasionStatus.advice, EvasionStatus.no_escape):
            return n
    with_map = (EvasionStatus.no_danger, EvasionStatus.unknown)
    known = [n for n, advice in enumerate(advices) if advice.status in with_map]
    if not known:
        raise UsageError("no frame has anything with a known distance, so there is no map to draw")
    return max(known, key=lambda n: (advices[n].probability_now, -np.nan_to_num(advices[n].time_s, nan=np.inf), n))


def _make_map(
    clip: Clip, n: int, moment: Moment, advice: Evasion, config: CollisionMapConfig, folder: Path
) -> CollisionMap:
    """The map of the n-th frame, and its pictures."""
    if moment.situation is None:
        raise UsageError(f"frame {clip.frame[n]} has no map ({moment.status}): name another with --frame or --time")
    speed_m_s = moment.situation.own_speed_m_s
    if config.units == "own-speed" and speed_m_s == 0.0:
        raise UsageError("--units own-speed: we rest, so there is no own speed to count in: use km/h")
    reach = config.range_m_s or float(np.clip(speed_m_s, *_RANGE_M_S))
    changes = np.linspace(-reach, reach, config.n_cells)
    made = map_of_changes(moment.situation, changes, 0.5 * changes, config.look_ahead_s)
    made = made.known_within(speed_m_s, moment.course_rad)
    caption = caption_of(
        printable(clip.name), int(clip.frame[n]), float(clip.t_s[n]), speed_m_s, advice, made.names, moment.notes
    )
    families = [
        (name, family_maps(moment.situation, name, changes, 0.5 * changes, config.look_ahead_s))
        for name in moment.unlinked
    ]
    figure = collision_map_figure(made, advice, speed_m_s, config.units, caption, families)
    with output_errors(folder.parent):
        for name in ("collision_map.png", "collision_map.svg"):
            write_figure(figure, folder / name)
    return made


def _map_rows(made: CollisionMap) -> list[tuple[Any, ...]]:
    """The rows of ``collision_map``."""
    forward, right = np.meshgrid(made.forward_m_s, made.right_m_s, indexing="ij")
    who = [(None, -1) if k == NO_OBJECT else (made.names[k], made.cluster_ids[k]) for k in made.object_index.ravel()]
    values = zip(forward.ravel(), right.ravel(), made.time_s.ravel(), made.probability.ravel(), who, strict=True)
    return [(*numbers, *name_and_number) for *numbers, name_and_number in values]


def _evasion_rows(clip: Clip, moments: list[Moment], advices: list[Evasion]) -> list[tuple[Any, ...]]:
    """The rows of ``evasion``."""
    return [
        (
            frame,
            t_s,
            _own_speed_m_s(moment),
            advice.time_s,
            advice.probability_now,
            *_name_and_number(moment, advice),
            advice.forward_m_s,
            advice.right_m_s,
            advice.probability_after,
            advice.status.value,
        )
        for frame, t_s, moment, advice in zip(clip.frame, clip.t_s, moments, advices, strict=True)
    ]


def _name_and_number(moment: Moment, advice: Evasion) -> tuple[str | None, int]:
    """What is hit without the advice; -1 stands for null."""
    if moment.situation is None or advice.object_index == NO_OBJECT:
        return None, -1
    hazards = moment.situation.hazards
    return hazards.names[advice.object_index], hazards.cluster_ids[advice.object_index]


def _own_speed_m_s(moment: Moment) -> float:
    if moment.situation is None:
        return float("nan")
    return moment.situation.own_speed_m_s
