"""The output folder of a run: created, filled out of sight, published at once.

While a run works, its files lie in ``OUT/.ttcvid-partial/``, next to a lock file that the running process holds and
that lists the names it may publish. Publishing removes the former manifest first, moves the files, and writes the new
manifest last. So whenever the process dies, ``OUT/manifest.json`` either is absent or describes what lies beside it:

==========================================  ============  ======================================================
killed                                      manifest      in the folder
==========================================  ============  ======================================================
while analysing                             former, none  the former result untouched; the partial folder
while publishing                            none          some files, the partial folder that lists their names
after the manifest                          new           the new result; at most an emptied partial folder
==========================================  ============  ======================================================

What may be replaced with ``overwrite``: an empty folder, a folder with a manifest of ours, and a folder that a killed
run left (it holds the partial folder). Only files that such a manifest or lock file lists are ever removed; a file of
another origin stays, and one that bears a name which this run needs is an error, found before the analysis starts.
So is what ttcvid never makes: a link, pipe or folder in the place of one of its files. OUT itself may be a link.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self

from filelock import lock_descriptor

from ttcvid.errors import InputError, OutputError
from ttcvid.plain_files import kind_of, open_own, open_plain, read_plain
from ttcvid.posix import sync_folder
from ttcvid.schema import TABLE_NAMES
from ttcvid.sinks.failures import output_errors
from ttcvid.sinks.manifest import MANIFEST_NAME, read_manifest, write_manifest

PARTIAL_NAME = ".ttcvid-partial"
LOCK_NAME = ".lock"
OVERLAY_NAME, REPORT_NAME = "overlay.mp4", "report.html"
MAX_LOCK_BYTES = 1_000_000
RESULT_NAMES = (*(f"{name}.parquet" for name in TABLE_NAMES), OVERLAY_NAME, REPORT_NAME)


class OutputFolder:
    """The folder of one run: write files into ``partial``, then `publish` or `abandon`.

    As a context manager it abandons what was not published. Made by `create`.
    """

    def __init__(self, path: Path, lock: BinaryIO, names: frozenset[str], former: frozenset[str], is_new: bool) -> None:
        self.path = path
        self.partial = path / PARTIAL_NAME
        self._lock = lock
        self._names = names
        self._former = former
        self._is_new = is_new
        self._moved: list[str] = []

    @classmethod
    def create(cls, path: Path, overwrite: bool = False, names: Iterable[str] = RESULT_NAMES) -> OutputFolder:
        """Make ``path`` (and its parents) ready for a run that will publish files called ``names``.

        Raises
        ------
        OutputError
            Where ``path`` exists and ``overwrite`` is not given, is a file, is not writable, holds something other
            than a result of ours or a link in the place of one of our files, or is being written by another run.
        """
        wanted = frozenset(names)
        with output_errors(path):
            is_new = _make_folder(path, overwrite)
            former = frozenset() if is_new else _former_names(path)
            for name in sorted(wanted | former):
                kind = kind_of(path / name)
                if kind != "nothing" and (kind != "file" or name not in former):
                    raise _not_ours(path / name)
        try:
            with output_errors(path):
                lock = _prepare_partial(path, wanted, former)
        except OutputError:
            if is_new:
                shutil.rmtree(path / PARTIAL_NAME, ignore_errors=True)
                _remove_if_empty(path)
            raise
        return cls(path, lock, wanted, former, is_new)

    def publish(self, manifest: dict[str, Any]) -> Path:
        """Make the files of ``partial`` the result, described by ``manifest``; returns the manifest's path.

        Adds ``files`` to the manifest: the size in bytes of each file.

        Raises
        ------
        OutputError
            Where it cannot be done; there is no manifest then.
        ValueError
            Where ``partial`` holds a file that `create` was not told of.
        """
        files = {file.name: file for file in sorted(self.partial.iterdir()) if file.name != LOCK_NAME}
        unexpected = sorted(files.keys() - self._names)
        if unexpected:
            raise ValueError(f"{self.partial}: {unexpected} were not among the names that this run announced")
        sizes = {name: file.stat().st_size for name, file in files.items()}
        target = self.path / MANIFEST_NAME
        # All that needs space on the disk comes first: from here on there are renames only.
        write_manifest(self.partial / MANIFEST_NAME, {**manifest, "files": sizes})
        with output_errors(self.path):
            for file in files.values():
                _sync_file(file)
            target.unlink(missing_ok=True)
            sync_folder(self.path)
            _remove(self.path, self._former)
            for name, file in files.items():
                self._moved.append(name)
                file.replace(self.path / name)
            sync_folder(self.path)
            (self.partial / MANIFEST_NAME).replace(target)
            sync_folder(self.path)
        self._release()
        return target

    def abandon(self) -> None:
        """Remove what was written and not published, and the folder if this run made it. Further calls do nothing."""
        if self._lock.closed:
            return
        # Files move only while there is no manifest: if there is one, either nothing moved or all is published.
        if not (self.path / MANIFEST_NAME).exists():
            _remove(self.path, self._moved)
        self._release()
        if self._is_new:
            _remove_if_empty(self.path)

    def _release(self) -> None:
        # A partial folder that cannot be removed does no harm: the next run clears it.
        shutil.rmtree(self.partial, ignore_errors=True)
        self._lock.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self.abandon()


def _make_folder(path: Path, overwrite: bool) -> bool:
    """Make the folder; True where it is new. Only one of two runs that start at once makes it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        path.mkdir()
    except FileExistsError as error:
        if not path.is_dir():
            raise OutputError(f"{path}: is not a folder: choose another output folder with -o") from error
        _refuse_what_is_not_ours(path)
        if not overwrite:
            _refuse_where_busy(path)
            raise OutputError(
                f"{path}: {_what_it_holds(path)} exists already: give --overwrite to replace it, or use -o"
            ) from error
        return False
    return True


def _refuse_what_is_not_ours(path: Path) -> None:
    """OutputError where something stands in the place of the partial folder, lock or manifest that we never put there.

    Through a link we would empty a folder, or overwrite a file, of somebody else; at a pipe we would wait for ever.
    """
    ours = {PARTIAL_NAME: "folder", f"{PARTIAL_NAME}/{LOCK_NAME}": "file", MANIFEST_NAME: "file"}
    for name, expected in ours.items():
        if kind_of(path / name) not in ("nothing", expected):
            raise _not_ours(path / name)


def _not_ours(path: Path) -> OutputError:
    return OutputError(f"{path}: not a file of a former run, so it is kept: move it away, or use -o")


def _what_it_holds(path: Path) -> str:
    if (path / PARTIAL_NAME).exists() and not (path / MANIFEST_NAME).exists():
        return "an unfinished run"
    return "the output folder"


def _former_names(path: Path) -> frozenset[str]:
    """Names of the files that former runs left in a folder, all of which may be removed."""
    if (path / MANIFEST_NAME).exists():
        try:
            names = read_manifest(path).get("files", {})
        except InputError as error:
            raise OutputError(
                f"{path}: holds a manifest.json that is not ttcvid's: choose another folder with -o"
            ) from error
    elif (path / PARTIAL_NAME).is_dir():
        names = _read_names(path / PARTIAL_NAME / LOCK_NAME)
    elif any(path.iterdir()):
        raise OutputError(f"{path}: holds files but no result of ttcvid, so it is kept: choose another folder with -o")
    else:
        names = ()
    return frozenset(name for name in names if _is_plain(name))


def _is_plain(name: object) -> bool:
    """Whether a name stays inside its folder: manifests can be edited, so what they list is not trusted."""
    return isinstance(name, str) and Path(name).name == name and name not in ("", ".", "..", PARTIAL_NAME)


def _prepare_partial(path: Path, wanted: frozenset[str], former: frozenset[str]) -> BinaryIO:
    """An empty partial folder with a lock that is ours; what a killed publication left is removed."""
    lock = _lock_partial(path)
    try:
        if not (path / MANIFEST_NAME).exists():
            _remove(path, former)
        _clear_partial(path / PARTIAL_NAME)
        _write_names(lock, wanted | former)
    except OSError:
        lock.close()
        raise
    return lock


def _lock_partial(path: Path) -> BinaryIO:
    """Take the lock of the partial folder; the system gives it back when the process ends, however it ends."""
    partial = path / PARTIAL_NAME
    partial.mkdir(exist_ok=True)
    lock = open_own(partial / LOCK_NAME)
    if not lock_descriptor(lock.fileno(), blocking=False):
        lock.close()
        raise _busy(path)
    return lock


def _refuse_where_busy(path: Path) -> None:
    """OutputError where a run that is alive writes into the folder; nothing is made or changed."""
    try:
        with open_plain(path / PARTIAL_NAME / LOCK_NAME) as lock:
            is_free = lock_descriptor(lock.fileno(), blocking=False)
    except FileNotFoundError:
        return
    if not is_free:
        raise _busy(path)


def _busy(path: Path) -> OutputError:
    return OutputError(f"{path}: another run is writing there: wait for it, or choose another folder with -o")


def _write_names(lock: BinaryIO, names: frozenset[str]) -> None:
    lock.truncate(0)
    lock.write(json.dumps(sorted(names)).encode())
    lock.flush()
    os.fsync(lock.fileno())


def _read_names(lock_path: Path) -> list[str]:
    """The names in a lock file; none where it was never filled, because then nothing was published either."""
    try:
        names = json.loads(read_plain(lock_path, MAX_LOCK_BYTES))
    except (FileNotFoundError, ValueError, RecursionError):
        return []
    return names if isinstance(names, list) else []


def _clear_partial(partial: Path) -> None:
    for entry in partial.iterdir():
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry)
        elif entry.name != LOCK_NAME:
            entry.unlink()


def _remove(path: Path, names: Iterable[str]) -> None:
    for name in names:
        (path / name).unlink(missing_ok=True)


def _remove_if_empty(folder: Path) -> None:
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()


def _sync_file(path: Path) -> None:
    with path.open("rb") as file:
        os.fsync(file.fileno())
