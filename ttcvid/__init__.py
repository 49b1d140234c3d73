"""Collision times, directions of motion and miss distances from one camera.

>>> import ttcvid
>>> run = ttcvid.analyze("clip.mp4")  # doctest: +SKIP
>>> run.collision_times  # doctest: +SKIP
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from ttcvid.errors import (
        CalibrationError,
        InputError,
        NotComparableError,
        OutputError,
        TtcvidError,
        UndeterminedError,
        UsageError,
    )
    from ttcvid.jobs.analyze.run_analysis import analyze
    from ttcvid.jobs.batch.results import open_batch
    from ttcvid.jobs.batch.run_batch import batch
    from ttcvid.jobs.calibrate_horizon.run_calibration import calibrate_horizon
    from ttcvid.jobs.collision_map.run_collision_map import collision_map
    from ttcvid.jobs.compare.compare_runs import compare
    from ttcvid.jobs.evaluate import evaluate
    from ttcvid.jobs.export import export
    from ttcvid.jobs.regress.run_suite import regress
    from ttcvid.jobs.report import report
    from ttcvid.jobs.runs.run import Run
    from ttcvid.jobs.sensitivity import sensitivity
    from ttcvid.jobs.simulate import simulate

__all__ = [
    "CalibrationError",
    "InputError",
    "NotComparableError",
    "OutputError",
    "Run",
    "TtcvidError",
    "UndeterminedError",
    "UsageError",
    "analyze",
    "batch",
    "calibrate_horizon",
    "collision_map",
    "compare",
    "evaluate",
    "export",
    "open_batch",
    "regress",
    "report",
    "sensitivity",
    "simulate",
]

_HOMES = {
    "CalibrationError": "ttcvid.errors",
    "InputError": "ttcvid.errors",
    "NotComparableError": "ttcvid.errors",
    "OutputError": "ttcvid.errors",
    "Run": "ttcvid.jobs.runs.run",
    "TtcvidError": "ttcvid.errors",
    "UndeterminedError": "ttcvid.errors",
    "UsageError": "ttcvid.errors",
    "analyze": "ttcvid.jobs.analyze.run_analysis",
    "batch": "ttcvid.jobs.batch.run_batch",
    "calibrate_horizon": "ttcvid.jobs.calibrate_horizon.run_calibration",
    "collision_map": "ttcvid.jobs.collision_map.run_collision_map",
    "compare": "ttcvid.jobs.compare.compare_runs",
    "evaluate": "ttcvid.jobs.evaluate",
    "export": "ttcvid.jobs.export",
    "open_batch": "ttcvid.jobs.batch.results",
    "regress": "ttcvid.jobs.regress.run_suite",
    "report": "ttcvid.jobs.report",
    "sensitivity": "ttcvid.jobs.sensitivity",
    "simulate": "ttcvid.jobs.simulate",
}


class _Interface(ModuleType):
    """The package as users see it: a public name stands for its object, also where a subpackage is called the same.

    Importing ``ttcvid.simulate.scene`` would otherwise put the subpackage in the place of the function
    ``ttcvid.simulate``; ``from ttcvid.simulate import scene`` works either way.
    """

    def __setattr__(self, name: str, value: Any) -> None:
        if name in _HOMES and isinstance(value, ModuleType):
            return
        super().__setattr__(name, value)

    def __getattr__(self, name: str) -> Any:
        if name not in _HOMES:
            raise AttributeError(f"module 'ttcvid' has no attribute {name!r}")
        value = getattr(importlib.import_module(_HOMES[name]), name)
        setattr(self, name, value)
        return value

    def __dir__(self) -> list[str]:
        """The public names: not what this file itself imports."""
        return sorted({*__all__, *(name for name in super().__dir__() if name.startswith("__"))})


sys.modules[__name__].__class__ = _Interface
