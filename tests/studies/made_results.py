"""Results with every column filled, made without any analysis: what comparisons are tested on."""

import numpy as np
import pandas as pd

from ttcvid.jobs.compare.result_tables import in_ordinary_types
from ttcvid.schema import TABLES
from ttcvid.studies.compare.results import Results, compare_results
from ttcvid.studies.compare.tolerance import (
    Tolerance,
)

N_FRAMES, N_TRACKS, DT_S = 60, 40, 0.1
FACTS = {"camera.fx_px": 500.0, "camera.fy_px": 500.0}


def whole_result(seed: int = 0, name: str = "one") -> Results:
    """A result with every column filled by numbers of ordinary size; object 3 lives in all frames, object 7 late."""
    rng = np.random.default_rng(seed)
    frame = np.arange(N_FRAMES)
    frames = filled("frames", pd.DataFrame({"frame": frame, "t_s": frame * DT_S}), rng)
    life = pd.DataFrame({"frame": np.concatenate([frame, frame, frame[40:]])})
    life["cluster_id"] = np.repeat([0, 3, 7], [N_FRAMES, N_FRAMES, N_FRAMES - 40])
    life = life.sort_values(["frame", "cluster_id"]).reset_index(drop=True)
    life["t_s"] = life.frame * DT_S
    x_px = 100.0 * life.cluster_id + life.frame
    box = {"x0_px": x_px, "y0_px": 50.0 + life.frame, "x1_px": x_px + 60, "y1_px": 90.0 + life.frame}
    clusters = filled("clusters", life.assign(**box, n_tracks=20), rng)
    tracks = pd.DataFrame({"frame": np.repeat(frame, N_TRACKS), "track_id": np.tile(np.arange(N_TRACKS), N_FRAMES)})
    places = rng.uniform(0, 600, (N_TRACKS, 2))
    tracks["t_s"], tracks["cluster_id"] = tracks.frame * DT_S, np.where(tracks.track_id < 5, 3, 0)
    tracks["x_px"] = places[tracks.track_id, 0] + 2.0 * tracks.frame
    tracks["y_px"] = places[tracks.track_id, 1] + 1.0 * tracks.frame
    events = pd.DataFrame({"event_id": [1], "kind": "collision_course", "cluster_id": [3], "start_frame": [10]})
    events = events.assign(end_frame=30, start_s=1.0, end_s=3.0)
    tables = {
        "frames": frames,
        "epipoles": filled("epipoles", life, rng),
        "clusters": clusters,
        "collision_times": filled("collision_times", tracks, rng),
        "events": filled("events", events, rng),
    }
    return Results(name, tables, FACTS, frames)


def filled(name: str, given: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
    """The table with the columns of the schema; what is not given is random, all of one sign."""
    columns = {}
    for column in TABLES[name]:
        if column.name in given:
            columns[column.name] = given[column.name].to_numpy()
        elif column.values:
            columns[column.name] = np.full(len(given), column.values[0])
        elif column.unit == "":
            columns[column.name] = np.full(len(given), "name")
        elif column.name.startswith("cov_"):
            columns[column.name] = rng.uniform(1.0, 2.0, len(given)) * 1e-6
        elif column.name == "rot_sigma_rad":
            columns[column.name] = np.full(len(given), 1e-5)
        elif column.name.startswith("rot_"):
            columns[column.name] = rng.uniform(0.01, 0.02, len(given))
        elif str(column.type).startswith("int"):
            columns[column.name] = rng.integers(50, 60, len(given))
        else:
            low = {"_lo_s": 2.0, "_hi_s": 4.0}.get(column.name[-5:], 3.0)
            columns[column.name] = low + rng.uniform(0.0, 0.1, len(given))
    return in_ordinary_types(pd.DataFrame(columns), name)


def with_table(results: Results, name: str, table: pd.DataFrame) -> Results:
    clock = table if name == "frames" else results.clock
    return Results("other", {**results.tables, name: table}, results.facts, clock, results.is_thinned)


def different(baseline: Results, run: Results, tolerance: Tolerance | None = None) -> tuple[list[str], list[str]]:
    """Names of the columns that differ, and all other complaints."""
    comparison = compare_results(baseline, run, tolerance or Tolerance())
    complaints = [text for part in comparison.parts for text in part.complaints]
    return [column.name for column in comparison.columns if not column.is_same], complaints
