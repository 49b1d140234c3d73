"""A scene of the simulator through the whole pipeline as a table of tracks, set beside its truth object by object."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from ttcvid.config import PipelineConfig
from ttcvid.model import Frame, PointSet
from ttcvid.pipeline import analyze_frames
from ttcvid.simulate import TrackOptions, camera_of, load_scene, simulate_tracks

SCENES = Path(__file__).resolve().parents[2] / "sample_configs" / "scenes"
OPTIONS = TrackOptions(n_tracks=400, min_per_object=25)
N_FRAMES = {
    "resting_six_movers": 60,
    "aircraft_head_on": 105,
    "roundabout": 52,
    "parked_street": 48,
    "stopped_car_ahead": 50,
}
"""How far scenes are looked at whose rest asks nothing more; of the others all frames."""
# The nearest tenth of an object's points is what is hit first.
NEAREST_PART = 0.1
# A new object needs two frames for its first flow, and with fewer than twelve tracks one more to be confirmed.
FIRST_FRAMES = 3


@dataclass(frozen=True)
class ObjectRun:
    """One object over a run: frames in which it was seen, and of those in which it was found what was found.

    `cluster_id`, `off_deg` (direction, NaN without one) and `holds_ttc` (interval around the true ttc_z; None
    without a time), one entry a frame found.
    """

    n_visible: int
    cluster_id: list
    off_deg: np.ndarray
    holds_ttc: list

    @property
    def found_part(self):
        return len(self.cluster_id) / max(self.n_visible - FIRST_FRAMES, 1)

    @property
    def one_number_part(self):
        """Part of the frames found in which it has its most frequent number."""
        return np.unique(self.cluster_id, return_counts=True)[1].max() / len(self.cluster_id)

    @property
    def in_interval_part(self):
        return np.mean([holds for holds in self.holds_ttc if holds is not None])


@dataclass(frozen=True)
class SimulatedRun:
    """Results of a scene; `objects` by the simulator's object_id; part of the static tracks that the scene has."""

    results: list
    objects: dict
    static_in_scene: np.ndarray

    @property
    def events(self):
        """The final version of each warning."""
        return list({e.event_id: e for result in self.results for e in result.events}.values())

    @property
    def n_objects(self):
        return len({row.cluster_id for result in self.results for row in result.clusters if row.role == "object"})


@cache
def run(name):
    """The scene `name`, analysed with default parameters."""
    scene = load_scene(SCENES / f"{name}.yaml")
    n_frames = N_FRAMES.get(name, scene.camera.n_frames)
    scene = scene.model_copy(update={"camera": scene.camera.model_copy(update={"n_frames": n_frames})})
    tracks = simulate_tracks(scene, OPTIONS)
    rows = {frame: np.flatnonzero(tracks.frame == frame) for frame in np.unique(tracks.frame)}
    frames = [
        Frame(int(frame), float(tracks.t_s[at[0]]), points=PointSet(tracks.track_id[at], tracks.xy_px[at]))
        for frame, at in rows.items()
    ]
    results = [result for _, result in analyze_frames(frames, camera_of(scene), PipelineConfig())]
    numbers = np.unique(tracks.object_id[tracks.object_id > 0])
    objects = {int(number): _object_run(tracks, rows, results, number) for number in numbers}
    static = [np.mean(r.tracks.cluster_id[tracks.object_id[rows[r.frame]] == 0] == 0) for r in results]
    return SimulatedRun(results, objects, np.array(static))


def _object_run(tracks, rows, results, number):
    n_visible, cluster_id, off_deg, holds_ttc = 0, [], [], []
    for result in results:
        is_mine = tracks.object_id[rows[result.frame]] == number
        at = rows[result.frame][is_mine]
        n_visible += bool(len(at))
        names = result.tracks.cluster_id[is_mine]
        names = names[names > 0]
        if not len(names):
            continue
        row = next(row for row in result.clusters if row.cluster_id == np.bincount(names).argmax())
        velocity = tracks.velocity_m_s[at].mean(axis=0)
        cosine = np.nan if row.direction is None else row.direction @ velocity / np.linalg.norm(velocity)
        cluster_id.append(row.cluster_id)
        off_deg.append(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
        eta_hz = -velocity[2] / np.quantile(tracks.position_m[at, 2], NEAREST_PART)
        holds_ttc.append(_holds(row, eta_hz))
    return ObjectRun(n_visible, cluster_id, np.array(off_deg), holds_ttc)


def _holds(row, eta_hz):
    if row.state_abc_hz is None:
        return None
    return 1.0 / row.times.ttc_z_hi_s[0] <= eta_hz <= 1.0 / row.times.ttc_z_lo_s[0]
