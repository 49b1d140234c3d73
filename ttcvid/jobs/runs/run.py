"""A finished run: its manifest, and its tables as data frames."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from ttcvid.errors import InputError, counted, on_one_line
from ttcvid.jobs.runs.manifest import EXIT_CODES, read_run_manifest
from ttcvid.model import APPROACHING
from ttcvid.plain_files import open_plain
from ttcvid.schema import TABLES
from ttcvid.sinks.folder import OVERLAY_NAME, REPORT_NAME

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Run:
    """The output folder of one analysis; ``manifest`` is the content of its ``manifest.json``.

    The tables are read when they are first asked for, in the types in which `pandas.read_parquet` gives them: null is
    NA, names are categories. ``attrs["units"]`` and ``attrs["descriptions"]`` of each say what its columns are.
    """

    folder: Path
    manifest: dict[str, Any]

    @classmethod
    def open(cls, folder: str | Path) -> Run:
        """The run in ``folder``; InputError where there is none, or none that was finished."""
        folder = Path(folder)
        if not folder.is_dir():
            raise InputError(f"{folder}: no such folder: expected the output folder of 'ttcvid analyze'")
        return cls(folder, read_run_manifest(folder))

    @property
    def state(self) -> str:
        """``complete``, ``truncated`` (the input ends early) or ``interrupted``."""
        return str(self.manifest["state"])

    @property
    def exit_code(self) -> int:
        """What the command line ends with."""
        return EXIT_CODES[self.state]

    @cached_property
    def collision_times(self) -> pd.DataFrame:
        """A row per frame and live track."""
        return self._table("collision_times")

    @cached_property
    def epipoles(self) -> pd.DataFrame:
        """A row per frame and cluster: its direction of relative motion."""
        return self._table("epipoles")

    @cached_property
    def clusters(self) -> pd.DataFrame:
        """A row per frame and cluster: place, state and times."""
        return self._table("clusters")

    @cached_property
    def frames(self) -> pd.DataFrame:
        """A row for every frame."""
        return self._table("frames")

    @cached_property
    def events(self) -> pd.DataFrame:
        """A row per warning."""
        return self._table("events")

    @property
    def overlay(self) -> Path | None:
        """The annotated video; None where none was asked for."""
        return self._file(OVERLAY_NAME)

    @property
    def report(self) -> Path | None:
        """The page that shows the result; None where none was asked for."""
        return self._file(REPORT_NAME)

    def _file(self, name: str) -> Path | None:
        return self.folder / name if name in self.manifest.get("files", {}) else None

    @property
    def objects(self) -> pd.DataFrame:
        """The rows of ``clusters`` that are objects: one per frame and object."""
        return self.clusters[self.clusters.role == "object"].reset_index(drop=True)

    def approaching(self, within_s: float | None = None) -> pd.DataFrame:
        """The rows of ``objects`` that certainly approach, of state ``approaching`` or ``constant_bearing``.

        With ``within_s`` only those whose depth is zero within so many seconds (``ttc_z_s``, bounded interval).
        """
        objects = self.objects
        is_told = objects.state.isin([state.value for state in APPROACHING])
        if within_s is not None:
            is_told &= (objects.ttc_z_s <= within_s).fillna(False)
        return objects[is_told].reset_index(drop=True)

    def _table(self, name: str) -> pd.DataFrame:
        """A table as `pandas.read_parquet` gives it, whose names know all their categories even where it is empty."""
        import pandas as pd

        path = self.folder / f"{name}.parquet"
        try:
            with open_plain(path) as file:
                table = pd.read_parquet(file)
        except (OSError, pa.ArrowInvalid) as error:
            reason = " ".join(str(error).split())
            raise InputError(f"{path}: cannot be read as a table ({reason}): run 'ttcvid analyze' again") from None
        dtypes = table.dtypes
        for column in TABLES[name]:
            if column.name in dtypes and isinstance(dtypes[column.name], pd.CategoricalDtype):
                names = table[column.name].cat
                unknown = [value for value in column.values if value not in names.categories]
                table[column.name] = names.add_categories(unknown)
        return table

    def summary(self) -> str:
        """One line: what was analysed, what was found, and what to know before trusting it."""
        counts, timings = self.manifest["counts"], self.manifest["timings"]
        parts = [
            f"{self.state}, {_frames(counts)} in {timings['total_s']:.1f} s ({timings['frames_per_s']:.0f} frames/s)",
            f"{counted(counts['track_rows'], 'track row')}, {counted(counts['objects'], 'object')}, "
            f"{counted(counts['events'], 'warning')}",
        ]
        nearest = self.manifest["nearest"]
        if nearest is not None:
            parts.append(
                f"smallest time to collision {nearest['ttc_z_s']:.2f} s ({nearest['ttc_z_lo_s']:.2f} to "
                f"{nearest['ttc_z_hi_s']:.2f} s) of object {nearest['cluster_id']} at frame {nearest['frame']}"
            )
        camera = self.manifest["camera"]
        if camera["is_assumed"]:
            parts.append("focal length ASSUMED")
        elif camera.get("focal_sigma_px") is not None:
            parts.append(f"focal length FOUND in the clip: {camera['fx_px']:.0f} +- {camera['focal_sigma_px']:.0f} px")
        platform = self.manifest["platform"]
        if platform["is_told_by_clip"]:
            parts.append(f"platform {platform['value']} TOLD BY THE CLIP ({platform['reason']})")
        if self.manifest["limits"]:
            parts.append(f"limits of this clip: {', '.join(limit['name'] for limit in self.manifest['limits'])}")
        return f"{on_one_line(str(self.folder))}: {'; '.join(parts)}"

    def summary_json(self) -> str:
        """The summary as one JSON object."""
        names = ("state", "counts", "timings", "nearest", "camera", "platform", "limits", "warnings")
        content = {"folder": str(self.folder), "exit_code": self.exit_code}
        return json.dumps(content | {name: self.manifest[name] for name in names}, sort_keys=True)


def _frames(counts: dict[str, Any]) -> str:
    expected = counts["frames_expected"]
    is_short = expected is not None and counts["frames"] < expected
    return f"{counts['frames']} of {expected} frames" if is_short else counted(counts["frames"], "frame")
