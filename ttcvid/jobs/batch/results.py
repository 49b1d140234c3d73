"""A finished batch: its clips, and the tables of all results as one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa
import pyarrow.dataset as ds
from pyarrow import fs

from ttcvid.jobs.batch.table import FAILED, PENDING, TABLE_NAME, ClipRow, read_rows
from ttcvid.jobs.runs.run import Run
from ttcvid.schema import table_schema

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class BatchResults:
    """The folder of a batch; a table of all clips has the columns of one clip's, and ``clip`` before them.

    Nothing is read before it is asked for, and of a question that names clips (``pc.field("clip") == "monday"``) only
    the tables of these clips.
    """

    folder: Path
    rows: tuple[ClipRow, ...]

    @cached_property
    def clips(self) -> pd.DataFrame:
        """``batch.parquet``: a row a clip."""
        import pandas as pd

        return pd.read_parquet(self.folder / TABLE_NAME)

    def run(self, clip: str) -> Run:
        """The result of one clip; InputError where it has none."""
        return Run.open(self.folder / clip)

    @property
    def collision_times(self) -> ds.Dataset:
        """A row per clip, frame and live track."""
        return self._dataset("collision_times")

    @property
    def epipoles(self) -> ds.Dataset:
        """A row per clip, frame and cluster: its direction of relative motion."""
        return self._dataset("epipoles")

    @property
    def clusters(self) -> ds.Dataset:
        """A row per clip, frame and cluster: place, state and times."""
        return self._dataset("clusters")

    @property
    def frames(self) -> ds.Dataset:
        """A row for every frame of every clip."""
        return self._dataset("frames")

    @property
    def events(self) -> ds.Dataset:
        """A row per warning."""
        return self._dataset("events")

    def _dataset(self, name: str) -> ds.Dataset:
        clips = [row.clip for row in self.rows if row.state not in (FAILED, PENDING)]
        paths = [str((self.folder / clip / f"{name}.parquet").absolute()) for clip in clips]
        return _with_clip(paths, clips, table_schema(name))


def _with_clip(paths: Sequence[str], clips: Sequence[str], schema: pa.Schema) -> ds.Dataset:
    """The tables as one, each with the name of its clip, which comes from its place and not from the file."""
    partitions: Any = [ds.field("clip") == clip for clip in clips]
    return ds.FileSystemDataset.from_paths(
        list(paths),
        schema=schema.insert(0, pa.field("clip", pa.string())),
        format=ds.ParquetFileFormat(),
        filesystem=fs.LocalFileSystem(),
        partitions=partitions,
    )


def open_batch(folder: str | Path) -> BatchResults:
    """The batch in ``folder``.

    Returns
    -------
    `BatchResults`: the tables of all clips as one.

    Raises
    ------
    InputError
        There is no batch, or its table cannot be read.

    Examples
    --------
    >>> import pyarrow.compute as pc
    >>> batch = open_batch("results")  # doctest: +SKIP
    >>> near = batch.clusters.to_table(filter=pc.field("ttc_z_s") < 2.0)  # doctest: +SKIP
    """
    return BatchResults(Path(folder), read_rows(Path(folder)))
