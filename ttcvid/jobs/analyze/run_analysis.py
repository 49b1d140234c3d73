"""One analysis from clip to output folder: source, pipeline and sinks side by side."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, closing
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from ttcvid.config import HorizonCalibrationConfig
from ttcvid.jobs.analyze.beside import AHEAD_ITEMS, beside
from ttcvid.jobs.analyze.found_focal import with_found_focal
from ttcvid.jobs.analyze.found_platform import describe_platform, with_told_platform
from ttcvid.jobs.analyze.outputs import check_overlay, open_sinks
from ttcvid.jobs.clip import (
    Calibration,
    camera_warnings,
    default_folder,
    open_clip,
    read_calibration,
    refuse_folder_of_input,
)
from ttcvid.jobs.processes.compilation import compilation_complaint, load_compiled
from ttcvid.jobs.processes.side_by_side import (
    READ_AHEAD_ITEMS,
    WRITE_BEHIND_ITEMS,
    ReadAhead,
    WriteBehind,
    map_ahead,
    waiting_items,
)
from ttcvid.jobs.processes.stopping import StopSignals
from ttcvid.jobs.processes.threads import (
    one_opencv_thread,
    quick_thread_switches,
    rare_garbage_collections,
)
from ttcvid.jobs.runs.provenance import (
    Tally,
    describe_calibration,
    describe_input,
    describe_option_files,
    digest_in_background,
    versions,
)
from ttcvid.jobs.runs.run import Run
from ttcvid.jobs.settings.configuration import Configuration, configure_from_arguments
from ttcvid.model import Camera, Horizon
from ttcvid.pipeline import analyze_frames
from ttcvid.posix import give_back_large_blocks, share_freed_memory
from ttcvid.schema import TABLE_NAMES
from ttcvid.sinks.folder import OVERLAY_NAME, REPORT_NAME, OutputFolder
from ttcvid.sources import Source
from ttcvid.stages.horizon.planar_motion import centre_sigma_px
from ttcvid.stages.horizon.watch import complaint_about_movers, complaint_about_own_epipoles

_LOG = logging.getLogger(__name__)
T = TypeVar("T")
R = TypeVar("R")

PICTURE_BYTES_PER_PX = 2.5
"""Of a decoded picture: its brightness for the analysis, and all of it, as it is stored, for the overlay."""
LEAST_OFFSET_PX = 3.0
"""Epipoles may lie so far off the horizon, whatever the calibration says of itself: a road is not quite level."""

_ANALYSES = count()
"""Numbers the analyses of this process from 0."""

OnFrame = Callable[[int, int | None], None]
"""Called with the number of frames analysed and the number expected (None: unknown)."""


def analyze(
    input_: str | Path, out: str | Path | None = None, *, config: str | Path | None = None, **options: Any
) -> Run:
    """Find what moves by itself in a clip, when each object comes closest, and how far off it passes.

    Parameters
    ----------
    input_ : A video, a folder or pattern of pictures, or a table of point tracks.
    out : Output folder; default ``INPUTSTEM_ttc`` in the working folder.
    config : A TOML configuration file. ``TTCVID_*`` variables and ``./ttcvid.toml`` count as on the command line.
    **options : The options of ``ttcvid analyze`` with underscores (``focal_px=721``, ``platform="vehicle"``), and the
        parameters of stages as mappings (``tracking={"max_tracks": 800}``).

    Returns
    -------
    `Run`: the finished output folder, with its tables as data frames. ``state`` is ``truncated`` where the input
    breaks off.

    Raises
    ------
    TtcvidError
        Input, calibration, configuration or output place cannot be used.
    KeyboardInterrupt
        After Ctrl-C; what was done is kept, ``Run.open`` reads it.
    """
    configuration = configure_from_arguments(options, Path(config) if config is not None else None)
    arguments = [f"{name}={value!r}" for name, value in {"input": str(input_), **options}.items()]
    run = run_analysis(str(input_), Path(out) if out is not None else None, configuration, arguments=arguments)
    if run.state == "interrupted":
        raise KeyboardInterrupt
    return run


def run_analysis(
    input_: str,
    out: Path | None,
    configuration: Configuration,
    *,
    arguments: Sequence[str] = (),
    on_frame: OnFrame | None = None,
) -> Run:
    """Analyse a clip as configured and publish its output folder; a stop by signal gives ``state`` interrupted."""
    started_s = time.perf_counter()
    options = configuration.options
    with open_clip(input_, options) as source:
        calibration = read_calibration(options, source.info.image_size)
        as_given = configuration
        configuration, told_platform = with_told_platform(input_, calibration, configuration)
        calibration = with_found_focal(input_, calibration, configuration)
        if options.wants_auto_horizon:
            # Loaded where it is wanted: it brings matplotlib along.
            from ttcvid.jobs.analyze.found_horizon import with_found_horizon

            calibration = with_found_horizon(input_, calibration, as_given)
        option_files = describe_option_files(options)
        path = out if out is not None else default_folder(input_)
        refuse_folder_of_input(path, source)
        _log_start(source, path, configuration)
        names = [f"{name}.parquet" for name in TABLE_NAMES]
        names += [OVERLAY_NAME] * options.overlay + [REPORT_NAME] * options.report
        with StopSignals() as stop, OutputFolder.create(path, options.overwrite, names) as folder:
            digest = digest_in_background(source.files)
            tally = _analyze_into(folder.partial, source, calibration, configuration, stop, on_frame)
            state = _state(source, stop)
            analyzed_s = time.perf_counter()
            if options.overlay:
                check_overlay(folder.partial / OVERLAY_NAME, tally.n_frames)
            manifest = {
                "state": state,
                "versions": versions(),
                "arguments": list(arguments),
                "configuration": configuration.as_manifest(),
                "option_files": option_files,
                "input": describe_input(source.info, source.files, digest.result()),
                **describe_calibration(calibration),
                "platform": describe_platform(configuration, told_platform),
                "counts": tally.counts(source.info, source.report),
                "nearest": tally.nearest,
                "limits": tally.limits.limits(configuration.pipeline.egomotion.platform),
                "warnings": _warnings(source, calibration, tally, configuration.pipeline.horizon_calibration),
                "timings": _timings(started_s, analyzed_s, tally.n_frames),
            }
            if options.report:
                # Loaded where it is wanted: it brings the templates along.
                from ttcvid.jobs.report import write_report

                write_report(folder.partial, str(path), manifest, options.overlay)
                manifest["timings"] = _timings(started_s, analyzed_s, tally.n_frames)
            folder.publish(manifest)
    return Run.open(path)


def _analyze_into(
    folder: Path,
    source: Source,
    calibration: Calibration,
    configuration: Configuration,
    stop: StopSignals,
    on_frame: OnFrame | None,
) -> Tally:
    """Write tables and overlay into ``folder`` until the source ends or a stop is requested."""
    tally = Tally()
    info, pipeline = source.info, configuration.pipeline
    with ExitStack() as stack:
        is_akaze = pipeline.tracking.tracker == "akaze"
        stack.enter_context(one_opencv_thread())
        stack.enter_context(rare_garbage_collections())
        stack.enter_context(quick_thread_switches())
        write = open_sinks(stack, folder, source, calibration, configuration)
        picture_bytes = PICTURE_BYTES_PER_PX * info.image_size.width_px * info.image_size.height_px
        # where no picture may wait, who needs one makes it: the processes of the geometry still work beside
        n_behind, n_ahead = (waiting_items(picture_bytes, most) for most in (WRITE_BEHIND_ITEMS, READ_AHEAD_ITEMS))
        if n_ahead or is_akaze:
            share_freed_memory()
        else:
            give_back_large_blocks()
        put = stack.enter_context(WriteBehind(write, n_behind)).put if n_behind else write
        # a picture that nobody draws on is not kept for it
        wanted = source if configuration.options.overlay else (replace(frame, colour=None) for frame in source)
        frames = stack.enter_context(ReadAhead(wanted, n_ahead)) if n_ahead else wanted
        n_apart = max(1, waiting_items(picture_bytes, AHEAD_ITEMS))

        def run_apart(
            function: Callable[[Iterable[T]], Iterator[R]], items: Iterable[T]
        ) -> AbstractContextManager[Iterable[R]]:
            def work(wanted: Iterable[T]) -> Iterator[R]:
                load_compiled()  # while the first item is on its way
                return function(wanted)

            return beside(work, items, n_apart)

        if next(_ANALYSES) == 1:
            # There are several: each copy of this process would load from disk what the one before it has loaded.
            load_compiled()
        results = analyze_frames(
            stop.until_requested(frames),
            calibration.camera,
            pipeline,
            calibration.horizon,
            calibration.mask,
            # Only AKAZE has work that is worth threads of its own, picture by picture.
            map_ahead=map_ahead if is_akaze else map,
            run_apart=run_apart,
        )
        for frame, result in stack.enter_context(closing(results)):
            put((frame, result))
            tally.add(result)
            if on_frame is not None:
                on_frame(tally.n_frames, info.n_frames)
    if stop.is_requested and tally.n_frames == 0:
        raise KeyboardInterrupt
    return tally


def _log_start(source: Source, path: Path, configuration: Configuration) -> None:
    info = source.info
    _LOG.info(
        "%s: %s, %s, %s frames of %.4f s", info.path, info.kind, info.image_size, info.n_frames, info.nominal_dt_s
    )
    for name, origin in sorted(configuration.origins.items()):
        _LOG.info("%s is set by %s", name, origin)
    _LOG.info("writing to %s", path)
    if complaint := compilation_complaint():
        _LOG.warning("%s", complaint)


def _state(source: Source, stop: StopSignals) -> str:
    if stop.is_requested:
        return "interrupted"
    return "truncated" if source.report.is_truncated else "complete"


def _warnings(
    source: Source, calibration: Calibration, tally: Tally, horizon_errors: HorizonCalibrationConfig
) -> list[str]:
    """What to know before trusting the numbers; also logged."""
    warnings = camera_warnings(calibration.camera)
    warnings += source.report.warnings
    complaints = tally.complaint_about_times(), tally.complaint_about_sight(), tally.complaint_about_repeats()
    warnings += filter(None, complaints)
    if calibration.horizon is not None:
        warnings += _complaints_about_horizon(calibration.camera, calibration.horizon, tally, horizon_errors)
    for warning in warnings:
        _LOG.warning("%s", warning)
    return warnings


def _complaints_about_horizon(
    camera: Camera, horizon: Horizon, tally: Tally, errors: HorizonCalibrationConfig
) -> list[str]:
    """What to say where own epipoles, or those of movers, do not fit the calibration."""
    sigma_px = centre_sigma_px(camera, horizon)
    tolerance_px = max(LEAST_OFFSET_PX, 2.0 * sigma_px)
    own = complaint_about_own_epipoles(np.array(tally.own_offset_px), tolerance_px)
    sigma_rad, least_rad = sigma_px / camera.fy_px, LEAST_OFFSET_PX / camera.fy_px
    movers = complaint_about_movers(tally.mover_offsets.values(), sigma_rad, least_rad, errors)
    return [complaint for complaint in (own, movers) if complaint]


def _timings(started_s: float, analyzed_s: float, n_frames: int) -> dict[str, float]:
    return {
        "total_s": time.perf_counter() - started_s,
        "analysis_s": analyzed_s - started_s,
        "frames_per_s": n_frames / (analyzed_s - started_s),
    }
