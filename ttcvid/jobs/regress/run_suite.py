"""A regression suite: every clip analysed again, held against its baseline and what is expected of it."""

from __future__ import annotations

import difflib
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from ttcvid.errors import NotComparableError, TtcvidError, UsageError, counted
from ttcvid.jobs.compare.baseline import baseline_text, read_baseline, write_baseline
from ttcvid.jobs.compare.compare_runs import write_junit
from ttcvid.jobs.compare.result_tables import read_run
from ttcvid.jobs.processes.compilation import compile_missing
from ttcvid.jobs.processes.crew import Attempt, Call, Crew
from ttcvid.jobs.processes.stopping import StopSignals
from ttcvid.jobs.processes.workers import LocalWorker
from ttcvid.jobs.regress.clip import ClipRun, ClipTask, render_scene, run_clip
from ttcvid.jobs.regress.suite import Suite, SuiteClip, read_suite, resolved
from ttcvid.sources.images import is_pattern
from ttcvid.studies.compare.results import Comparison, Results, compare_results
from ttcvid.studies.compare.thinned import thinned
from ttcvid.studies.compare.wording import comparison_cases, describe_changes, describe_differences, reasons
from ttcvid.studies.regression.expectations import Expectation, Observed
from ttcvid.studies.regression.junit import Suite as JUnitSuite

JUNIT_NAME, CAMERA_NAME = "junit.xml", "camera.yaml"
PASSED, FAILED, SKIPPED, ERROR = "passed", "failed", "skipped", "error"
EXIT_FAILED, EXIT_MISSING = 1, 3
N_TRIES = 2
"""Memory and disks recover: a clip that could not be checked is checked once more, after all others."""


@dataclass(frozen=True)
class ClipOutcome:
    """What became of one clip.

    ``status`` is ``passed``, ``failed`` (a check did), ``skipped`` or ``error`` (it could not be checked), with the
    ``reason``. ``comparison`` is with the baseline as it was before, None where there is none. ``complaints`` has each
    expectation and what is wrong with it (empty: it is met). ``update`` says what became of the baseline, where asked
    for. ``exit_code`` is 0, 1 for a failed check, else that of the error.
    """

    name: str
    status: str
    reason: str = ""
    exit_code: int = 0
    run: ClipRun | None = None
    comparison: Comparison | None = None
    complaints: tuple[tuple[str, str], ...] = ()
    update: str = ""
    time_s: float = 0.0

    def line(self) -> str:
        """One line: the verdict, what was analysed, and what is wrong."""
        head = f"{self.status:<7}  {self.name}"
        if self.run is None:
            return f"{head}: {self.reason}"
        n_met = sum(not complaint for _, complaint in self.complaints)
        parts = [
            f"{head}: {counted(self.run.n_frames, 'frame')}, {counted(self.run.n_objects, 'object')}, "
            f"{counted(self.run.n_events, 'warning')}",
            f"{n_met} of {len(self.complaints)} expectations met",
            f"{self.time_s:.1f} s, {self.run.max_rss_mb:.0f} MB",
            self.update,
            *(complaint for _, complaint in self.complaints),
        ]
        if self.comparison is not None and not self.comparison.is_same:
            parts.append(f"not as in the baseline: {reasons(self.comparison)}")
        return "; ".join(part for part in parts if part)

    def details(self) -> list[str]:
        """What is different from the baseline and what changed in the making; nothing where all is the same."""
        if self.comparison is None or self.comparison.is_same:
            return []
        return [*describe_changes(self.comparison), *describe_differences(self.comparison)]


@dataclass(frozen=True)
class Regression:
    """The outcomes of a suite, in its order, and where runs and JUnit file are."""

    suite: Path
    folder: Path
    junit: Path
    outcomes: tuple[ClipOutcome, ...]

    @property
    def exit_code(self) -> int:
        """0: all passed or were skipped; that of the first error; 1: a check failed."""
        errors = [outcome.exit_code for outcome in self.outcomes if outcome.status == ERROR]
        return errors[0] if errors else max((outcome.exit_code for outcome in self.outcomes), default=0)

    def summary(self) -> str:
        """One line: how many passed, failed, were skipped or could not be checked."""
        counts = {status: sum(o.status == status for o in self.outcomes) for status in (PASSED, FAILED, ERROR, SKIPPED)}
        names = {PASSED: "passed", FAILED: "failed", ERROR: "could not be checked", SKIPPED: "skipped"}
        parts = [f"{count} {names[status]}" for status, count in counts.items() if count or status == PASSED]
        return f"{self.suite}: {len(self.outcomes)} clips: {', '.join(parts)}; {self.junit}"


def regress(
    suite: str | Path,
    *,
    update: bool = False,
    only: Sequence[str] = (),
    jobs: int = 1,
    out: str | Path | None = None,
    junit: str | Path | None = None,
    on_clip: Callable[[ClipOutcome], None] | None = None,
) -> Regression:
    """Analyse every clip of a suite and hold the results against baselines and expectations.

    Parameters
    ----------
    suite : The YAML file of the suite.
    update : Rewrite the baselines from these runs; each outcome lists what changed.
    only : Names of clips; none: all.
    jobs : Clips at a time, each in processes of its own.
    out : Folder for runs, rendered scenes, details and the JUnit file; default ``SUITESTEM_regress``.
    junit : The JUnit file; default ``junit.xml`` in ``out``.
    on_clip : Called with the outcome of each clip, in the order of the suite.

    Returns
    -------
    `Regression`: the outcome of each clip.

    Raises
    ------
    UsageError
        The suite cannot be used; clips that cannot be checked are outcomes.
    OutputError
        The JUnit file or a baseline cannot be written.
    KeyboardInterrupt
        After Ctrl-C or SIGTERM, within two seconds; after a second one at once.
    """
    if jobs < 1:
        raise UsageError(f"jobs = {jobs}: expected at least 1")
    read = read_suite(Path(suite))
    folder = Path(f"{Path(suite).stem}_regress") if out is None else Path(out)
    clips = read.chosen(only)
    # Else time and memory of the first clip on a machine would be those of the compiler.
    compile_missing()
    outcomes = []
    with closing(_outcomes(read, clips, folder, update, jobs)) as found:
        for outcome in found:
            outcomes.append(outcome)
            if on_clip is not None:
                on_clip(outcome)
    target = folder / JUNIT_NAME if junit is None else Path(junit)
    write_junit(target, [_as_junit(outcome) for outcome in outcomes])
    return Regression(Path(suite), folder, target, tuple(outcomes))


def _outcomes(
    suite: Suite, clips: Sequence[SuiteClip], folder: Path, update: bool, jobs: int
) -> Generator[ClipOutcome, None, None]:
    """The outcome of each clip, in the order of the clips, as soon as all before it are there."""

    def check(call: Call, clip: SuiteClip) -> ClipOutcome:
        return _checked(suite, clip, folder, update, call)

    # A new process for each call: the memory that one needs is not to be counted for the next.
    workers = [LocalWorker(is_fresh_each_call=True) for _ in range(min(jobs, len(clips)))]
    waiting: dict[str, ClipOutcome] = {}
    names = iter([clip.name for clip in clips])
    name = next(names, None)
    with StopSignals("stopping: no verdict is written") as stop, Crew(workers, check, N_TRIES) as crew:
        for attempt in crew.attempts(clips):
            if stop.is_requested:
                raise KeyboardInterrupt
            if attempt is not None and attempt.is_last:
                waiting[attempt.item.name] = _outcome_of(attempt)
            while name in waiting:
                yield waiting.pop(name)
                name = next(names, None)


def _outcome_of(attempt: Attempt[SuiteClip, ClipOutcome]) -> ClipOutcome:
    """A failure that a user can mend is an outcome, too."""
    if attempt.value is not None:
        return attempt.value
    if not isinstance(attempt.error, TtcvidError):
        raise attempt.error or AssertionError
    error = attempt.error
    return ClipOutcome(attempt.item.name, ERROR, str(error), error.exit_code, time_s=attempt.time_s)


def _checked(suite: Suite, clip: SuiteClip, folder: Path, update: bool, call: Call) -> ClipOutcome:
    """One clip from analysis to verdict."""
    started_s = time.monotonic()
    missing = _missing(suite, clip)
    if missing:
        return ClipOutcome(
            clip.name, SKIPPED if clip.optional else ERROR, missing, 0 if clip.optional else EXIT_MISSING
        )
    path, tolerance = suite.baseline(clip), suite.tolerance(clip)
    former = _former(path, update) if clip.baseline else None
    task = _task(suite, clip, folder, call)
    run = call(run_clip, task)
    results = read_run(run.folder)
    complaints = _complaints(suite.expectations[clip.name], run, results)
    comparison = compare_results(former, results, tolerance) if former is not None else None
    is_written = update and clip.baseline
    changed = _updated(path, baseline_text(thinned(results, tolerance.objects))) if is_written else ""
    is_right = not any(complaint for _, complaint in complaints)
    is_same = update or comparison is None or comparison.is_same
    return ClipOutcome(
        name=clip.name,
        status=PASSED if is_right and is_same else FAILED,
        exit_code=0 if is_right and is_same else EXIT_FAILED,
        run=run,
        comparison=comparison,
        complaints=complaints,
        update=changed,
        time_s=time.monotonic() - started_s,
    )


def _former(path: Path, update: bool) -> Results | None:
    """The baseline as it is; one that cannot be read is no hindrance where it is to be rewritten."""
    try:
        return read_baseline(path)
    except NotComparableError:
        if update:
            return None
        raise


def _missing(suite: Suite, clip: SuiteClip) -> str:
    """What to say of a clip that is not there; a pattern has to fit a file."""
    if clip.clip is None:
        return ""
    path = suite.root / clip.clip
    if path.exists() or (is_pattern(clip.clip) and path.parent.is_dir()):
        return ""
    return f"{path}: no such clip"


def _task(suite: Suite, clip: SuiteClip, folder: Path, call: Call) -> ClipTask:
    """What is to be done with a clip; a scene is rendered first, and brings its camera and its truth with it."""
    out, options = folder / clip.name, suite.options(clip)
    expectations = suite.expectations[clip.name]
    truth = suite.root / clip.truth if clip.truth is not None else None
    if clip.scene is not None:
        scene = folder / f"{clip.name}_scene"
        input_ = call(render_scene, suite.path.parent / clip.scene, scene, clip.frames)
        if not {"camera", "focal_px", "hfov"} & options.keys():
            options["camera"] = CAMERA_NAME
        root, truth = scene, scene if truth is None else truth
    else:
        input_, root = suite.root / str(clip.clip), suite.root
    needs_metrics = any(expectation.needs_metrics for expectation in expectations)
    needs_horizon = any(expectation.needs_horizon for expectation in expectations)
    return ClipTask(input_, out, resolved(options, root), truth if needs_metrics else None, needs_horizon)


def _complaints(expectations: Sequence[Expectation], run: ClipRun, results: Results) -> tuple[tuple[str, str], ...]:
    observed = Observed(
        results.tables, run.horizon_y_px, run.horizon_reason, run.max_rss_mb, run.fps_ratio, run.metrics
    )
    return tuple((expectation.text, expectation.complaint(observed)) for expectation in expectations)


def _updated(path: Path, text: str) -> str:
    """Write a baseline and say what that did."""
    before = path.read_text(encoding="utf-8") if path.exists() else None
    if before == text:
        return "baseline unchanged"
    write_baseline(path, text)
    if before is None:
        return f"baseline written to {path}"
    lines = difflib.unified_diff(before.splitlines(), text.splitlines(), n=0, lineterm="")
    n_lines = sum(line.startswith("+") and not line.startswith("+++") for line in lines)
    return f"baseline changed in {n_lines} lines"


def _as_junit(outcome: ClipOutcome) -> JUnitSuite:
    cases = [(text, [complaint] if complaint else []) for text, complaint in outcome.complaints]
    if outcome.comparison is not None:
        cases += [(f"baseline: {name}", failures) for name, failures in comparison_cases(outcome.comparison)]
    skipped, error = (outcome.reason if outcome.status == status else "" for status in (SKIPPED, ERROR))
    return JUnitSuite(outcome.name, cases, outcome.time_s, skipped, error)
