"""Two results, read and held against each other: finished runs, or a baseline that lives in a file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ttcvid.jobs.compare.baseline import read_baseline
from ttcvid.jobs.compare.result_tables import read_run
from ttcvid.jobs.runs.run import Run
from ttcvid.jobs.settings.yaml_file import read_yaml
from ttcvid.sinks.failures import output_errors
from ttcvid.sinks.whole_text import write_whole
from ttcvid.studies.compare.results import Comparison, Results, compare_results
from ttcvid.studies.compare.tolerance import Tolerance, tolerance_from
from ttcvid.studies.regression.junit import Suite, junit_xml


def compare(
    baseline: str | Path | Run,
    run: str | Path | Run,
    tolerance: str | Path | None = None,
    warn_s: float | None = None,
) -> Comparison:
    """Hold a run against a baseline: join their rows and judge every difference.

    Parameters
    ----------
    baseline, run : Output folders of ``ttcvid analyze``, what ``ttcvid.analyze`` returned, or files that ``ttcvid
        regress`` wrote.
    tolerance : A YAML file of tolerances, laid over the defaults.
    warn_s : An object that certainly approaches and is nearer in time than this always counts, however few its tracks;
        default: that of the tolerances.

    Returns
    -------
    `Comparison`: ``is_same``, and every difference with its worst rows.

    Raises
    ------
    NotComparableError
        One of the two cannot be read whole, or has other tables than this version writes.
    UsageError
        The file of tolerances cannot be used.
    """
    limits = Tolerance() if tolerance is None else read_tolerance(Path(tolerance))
    if warn_s is not None:
        limits = limits.model_copy(update={"objects": limits.objects.model_copy(update={"warn_s": warn_s})})
    return compare_results(read_results(baseline), read_results(run), limits)


def read_results(place: str | Path | Run) -> Results:
    """One side of a comparison: the folder of a run, a run, or a baseline file."""
    return read_baseline(Path(place)) if not isinstance(place, Run) and Path(place).is_file() else read_run(place)


def read_tolerance(path: Path) -> Tolerance:
    """The tolerances of a YAML file, laid over the defaults."""
    return tolerance_from(read_yaml(path), str(path))


def write_junit(path: Path, suites: Sequence[Suite]) -> None:
    """Write a JUnit file; OutputError where that cannot be done."""
    with output_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, junit_xml(suites))
