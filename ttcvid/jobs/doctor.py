"""What ttcvid stands on in this installation, and what is broken in it.

Every library is imported inside a function: a doctor has to answer where an import fails.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import os
import platform
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import ttcvid
from ttcvid.posix import usable_cores

LIBRARIES = {
    "numpy": "numpy",
    "scipy": "scipy",
    "numba": "numba",
    "opencv": "cv2",
    "av": "av",
    "pyarrow": "pyarrow",
    "pandas": "pandas",
    "pydantic": "pydantic",
    "PyYAML": "yaml",
    "click": "click",
    "jinja2": "jinja2",
    "rich": "rich",
    "matplotlib": "matplotlib",
    "pillow": "PIL",
    "filelock": "filelock",
    "psutil": "psutil",
    "imagesize": "imagesize",
}
"""Names that users know, and the modules behind them."""

OPENCV_WHEELS = (
    "opencv-python",
    "opencv-python-headless",
    "opencv-contrib-python",
    "opencv-contrib-python-headless",
)
"""All four put their files into the same folder ``cv2``: with two of them, either can be the one that loads."""

OLDEST_PYTHON = (3, 11)


@dataclass(frozen=True)
class Diagnosis:
    """Versions, facts of the machine, and one line with its remedy for everything broken."""

    versions: dict[str, str]
    machine: dict[str, Any]
    problems: tuple[str, ...]

    @property
    def exit_code(self) -> int:
        """0 where nothing is broken, else 1."""
        return 1 if self.problems else 0


def examine() -> Diagnosis:
    """Look at this installation."""
    versions = {"ttcvid": ttcvid.__version__, "python": platform.python_version()}
    problems = []
    for name, module in LIBRARIES.items():
        try:
            versions[name] = _version(importlib.import_module(module), name)
        except Exception as error:  # whatever a broken library raises is the finding
            reason = " ".join(str(error).split())
            problems.append(f"{name}: cannot be imported ({reason}): pip install --force-reinstall it")
    for check in CHECKS:
        problem = check()
        if problem is not None:
            problems.append(problem)
    return Diagnosis(versions, _machine(), tuple(problems))


def _version(module: Any, name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return str(module.__version__)  # cv2, which comes in wheels of four names


def installed_opencv_wheels() -> list[str]:
    """The OpenCV distributions that are installed here, with their versions."""
    found = []
    for name in OPENCV_WHEELS:
        try:
            found.append(f"{name} {importlib.metadata.version(name)}")
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def _several_opencv_wheels() -> str | None:
    wheels = installed_opencv_wheels()
    if len(wheels) <= 1:
        return None
    return (
        f"opencv: {' and '.join(wheels)} are installed over each other: pip uninstall all of them, "
        "then pip install 'opencv-python-headless>=4.10,<5'"
    )


def _opencv_without_akaze() -> str | None:
    try:
        import cv2
    except Exception:
        return None  # reported as an import that fails
    if hasattr(cv2, "AKAZE_create"):
        return None
    return (
        f"opencv: {cv2.__version__} has no AKAZE, so --tracker akaze cannot work: "
        "pip install 'opencv-python-headless>=4.10,<5'"
    )


def _av_without_h264() -> str | None:
    try:
        import av
    except Exception:
        return None  # reported as an import that fails
    try:
        av.codec.Codec("libx264", "w")
    except ValueError:
        return f"av: {av.__version__} has no libx264, so no overlay can be written: pip install --force-reinstall av"
    return None


def _old_python() -> str | None:
    if sys.version_info >= OLDEST_PYTHON:
        return None
    oldest = ".".join(map(str, OLDEST_PYTHON))
    return f"python: {platform.python_version()} is too old: expected {oldest} or later, install one"


def _nowhere_to_keep_compiled_code() -> str | None:
    try:
        importlib.import_module("ttcvid.pipeline")
        from ttcvid.jobs.processes.compilation import compilation_complaint
    except Exception:
        return None  # reported as an import that fails
    complaint = compilation_complaint()
    return complaint and f"numba: {complaint}"


def _damaged_compiled_code() -> str | None:
    try:
        importlib.import_module("ttcvid.pipeline")
        from ttcvid.jobs.processes.compilation import damage_complaint
    except Exception:
        return None  # reported as an import that fails
    complaint = damage_complaint()
    return complaint and f"numba: {complaint}"


CHECKS: tuple[Callable[[], str | None], ...] = (
    _old_python,
    _several_opencv_wheels,
    _opencv_without_akaze,
    _av_without_h264,
    _nowhere_to_keep_compiled_code,
    _damaged_compiled_code,
)


def _machine() -> dict[str, Any]:
    return {
        "system": platform.platform(),
        "cores": usable_cores(),
        "blas": _blas_name(),
        "blas_threads": os.environ.get("OPENBLAS_NUM_THREADS") or os.environ.get("OMP_NUM_THREADS") or "not limited",
        "opencv_threads": _opencv_threads(),
    }


def _blas_name() -> str | None:
    try:
        import numpy as np

        blas = np.show_config(mode="dicts")["Build Dependencies"]["blas"]  # type: ignore[index, call-overload, unused-ignore]
        return f"{blas['name']} {blas['version']}"
    except Exception:
        return None  # a fact that not every build of numpy tells


def _opencv_threads() -> int | None:
    try:
        import cv2
    except Exception:
        return None  # reported as an import that fails
    return int(cv2.getNumThreads())
