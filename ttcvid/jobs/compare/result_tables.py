"""A finished run, or a baseline file, as one side of a comparison; refused with the reason where it is not whole."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from ttcvid.errors import InputError, NotComparableError
from ttcvid.jobs.runs.run import Run
from ttcvid.model import NO_CLUSTER
from ttcvid.plain_files import open_plain
from ttcvid.schema import SCHEMA_VERSION, TABLES, VERSION_KEY
from ttcvid.studies.compare.results import Results

REMEDY = "analyse again with this version of ttcvid"


def read_run(run: str | Path | Run) -> Results:
    """One side of a comparison; NotComparableError with the reason where it cannot be one."""
    try:
        opened = run if isinstance(run, Run) else Run.open(run)
    except InputError as error:
        raise NotComparableError(str(error)) from None
    _require_tables(opened)
    tables = {name: read_table(opened.folder / f"{name}.parquet", name) for name in TABLES}
    return Results(str(opened.folder), tables, facts_of(opened.manifest), tables["frames"])


def _require_tables(run: Run) -> None:
    for name in TABLES:
        if not (run.folder / f"{name}.parquet").is_file():
            raise NotComparableError(f"{run.folder / name}.parquet: not found, so the result is not whole: {REMEDY}")


def read_table(path: Path, name: str) -> pd.DataFrame:
    """A table of a run in ordinary types: null is NaN, ``NO_CLUSTER`` in ``cluster_id``; names are categories."""
    try:
        with open_plain(path) as file:
            table = pq.read_table(file)
    except (OSError, pa.ArrowException) as error:
        reason = " ".join(str(error).split())
        raise NotComparableError(f"{path}: cannot be read as a table ({reason}): {REMEDY}") from None
    metadata = table.schema.metadata or {}
    version = metadata.get(VERSION_KEY.encode(), b"none").decode()
    if version != SCHEMA_VERSION:
        raise NotComparableError(f"{path}: schema version {version}, expected {SCHEMA_VERSION}: {REMEDY}")
    for column in TABLES[name]:
        if column.name not in table.column_names:
            raise NotComparableError(f"{path}: column {column.name!r} is missing: {REMEDY}")
        found = table.schema.field(column.name).type
        if found != column.type and not (column.values and pa.types.is_string(found)):
            raise NotComparableError(f"{path}: column {column.name!r} is {found}, expected {column.type}: {REMEDY}")
    return in_ordinary_types(table.to_pandas(ignore_metadata=True), name)


def in_ordinary_types(table: pd.DataFrame, name: str) -> pd.DataFrame:
    """Names as categories in the schema's order, and ``NO_CLUSTER`` for a null ``cluster_id``."""
    columns = {column.name: column for column in TABLES[name] if column.name in table}
    changed: dict[str, Any] = {
        column.name: pd.Categorical(table[column.name], categories=list(column.values))
        for column in columns.values()
        if column.values
    }
    if "cluster_id" in columns and columns["cluster_id"].nullable:
        changed["cluster_id"] = table.cluster_id.fillna(NO_CLUSTER).astype("int64")
    return table.assign(**changed)


def facts_of(manifest: Mapping[str, Any]) -> dict[str, object]:
    """How a run was made, as far as the numbers can depend on it, by dotted names."""
    facts: dict[str, object] = {"state": manifest["state"]}
    for group in ("versions", "input", "camera", "horizon", "image_size"):
        facts |= _flat(group, manifest.get(group))
    for section, keys in sorted(_mapping(manifest.get("configuration")).items()):
        for key, entry in sorted(_mapping(keys).items()):
            if (section, key) not in _NOT_FACTS and section != "overlay":
                facts[f"configuration.{section}.{key}"] = _mapping(entry).get("value")
    return {name: fact for name, fact in facts.items() if fact is not None}


_NOT_FACTS = {("analyze", name) for name in ("overlay", "report", "overwrite", "camera", "horizon", "max_image_mpx")}
"""Settings that say where files are or what is drawn; what a camera or horizon file holds is a fact of its own."""


def _flat(name: str, value: Any) -> dict[str, object]:
    if isinstance(value, Mapping):
        return {key: fact for inner, v in sorted(value.items()) for key, fact in _flat(f"{name}.{inner}", v).items()}
    return {} if name in ("input.path", "camera.origin", "horizon.origin") else {name: value}


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}
