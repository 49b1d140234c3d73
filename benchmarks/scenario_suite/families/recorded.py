"""Real trajectories: the labelled boxes of KITTI's tracking benchmark, with points on their faces, as track tables.

The labels are smoothed (they were drawn by hand, frame by frame) and read from the data folder; nothing of them is kept
here. They say where things are relative to a camera that drove itself, and not how. So the camera of these scenes keeps
its direction and has a speed that is drawn: the motion of the objects relative to it is real, that of the scene is not.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.random import Generator
from scipy.interpolate import BSpline, make_smoothing_spline
from scipy.spatial.transform import Rotation

from scenario_suite.families.streets import drive, km_h
from scenario_suite.scenario import Family, Recording, Values
from ttcvid.simulate import Scene, World, build_world
from ttcvid.simulate.poses import BodyPath
from ttcvid.simulate.scene import Body
from ttcvid.simulate.shapes import faces_of, parts_of
from ttcvid.simulate.world import Actor

N_SEQUENCES = 14
LABEL_RATE_HZ = 10.0
CAMERA_HEIGHT_M = 1.65
HFOV_DEG = 81.4
"""Of KITTI's left colour camera."""
CLIP_S = 4.0
SMOOTHNESS = 0.1
"""Weight of the squared second derivative (`make_smoothing_spline`): at 10 frames/s what is faster than 0.5 Hz goes."""
LEAST_LABELS = 12
"""Frames in a row that a track has to be labelled in."""
NEAR_M = (4.0, 45.0)
"""Depth of at least one object for most of the clip."""
GONE_M = -1000.0
"""Where an object is while it is not labelled: far behind us."""
_KINDS = dict.fromkeys(("Car", "Van"), "car") | dict.fromkeys(("Pedestrian", "Cyclist", "Misc"), "box")
_KINDS |= {"Truck": "lorry", "Tram": "bus"}


@dataclass(frozen=True)
class Trajectory:
    """A labelled object from ``first_s`` to ``last_s`` of its sequence.

    ``place`` gives ahead, left, up in m relative to the camera's ground point, ``heading`` rad, as splines of time.
    """

    name: str
    kind: str
    size_m: tuple[float, float, float]
    first_s: float
    last_s: float
    place: BSpline
    heading: BSpline


def recording_values(rng: Generator, collides: bool) -> Values:
    """A part of a sequence with somebody near, and a street for the background."""
    for _ in range(200):
        sequence = f"{int(rng.integers(N_SEQUENCES)):04d}"
        trajectories = trajectories_of(sequence)
        start_s = float(rng.uniform(0.0, max(one.last_s for one in trajectories) - CLIP_S))
        if _someone_is_near(trajectories, start_s):
            break
    else:
        raise RuntimeError("no part of the labels with somebody near in 200 draws")
    own = km_h(rng, 20, 60)
    reach_m = own * CLIP_S + 80.0
    ours = {"speed_m_s": own}
    values = drive(rng, ours, [], duration_s=CLIP_S, reach_m=reach_m, hfov_deg=HFOV_DEG, setting="country")
    values["camera"]["height_m"] = CAMERA_HEIGHT_M
    return {**values, "recording": Recording(sequence, round(start_s, 3))}


def recorded_world(scene: Scene, recording: Recording, t_s: np.ndarray | None = None) -> World:
    """The scene with the recorded objects in it, at its pictures' times or at those given."""
    world = build_world(scene, t_s)
    times = world.path.t_s
    actors = []
    for trajectory in trajectories_of(recording.sequence):
        at_s = recording.start_s + times
        seen = (at_s >= trajectory.first_s) & (at_s <= trajectory.last_s)
        if not seen.any():
            continue
        shape = {"kind": trajectory.kind, "size_m": trajectory.size_m}
        body = Body(name=trajectory.name, at_m=(0.0, 0.0, 0.0), is_object=True, **shape)
        parts = parts_of(body)
        path = _path(trajectory, at_s, seen, world)
        actors.append(Actor(trajectory.name, body, len(actors) + 1, True, parts, faces_of(parts), path))
    return World(scene, world.camera, world.path, (*actors, *world.actors))


@cache
def trajectories_of(sequence: str) -> tuple[Trajectory, ...]:
    """All objects of a sequence, smoothed; a track that is interrupted counts as several."""
    path = label_folder() / f"{sequence}.txt"
    rows: dict[int, list[list[str]]] = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        words = line.split()
        if words[2] in _KINDS:
            rows.setdefault(int(words[1]), []).append(words)
    result: list[Trajectory] = []
    for track, labels in sorted(rows.items()):
        frames = np.array([int(words[0]) for words in labels])
        for number, part in enumerate(np.split(np.arange(len(labels)), np.flatnonzero(np.diff(frames) != 1) + 1)):
            if len(part) >= LEAST_LABELS:
                result.append(_trajectory(f"{labels[0][2]} {track}.{number}", [labels[k] for k in part]))
    return tuple(result)


def label_folder() -> Path:
    """Folder of the labels; ends the program where they are absent."""
    repository = Path(__file__).resolve().parents[3]
    data = Path(os.environ.get("TTCVID_DATA", repository.parent / "shared" / "data"))
    folder = data / "kitti_tracking_labels"
    if not folder.is_dir():
        raise SystemExit(f"{folder}: labels not found: set TTCVID_DATA to the folder of the real data")
    return folder


def _trajectory(name: str, labels: list[list[str]]) -> Trajectory:
    number = np.array([[float(word) for word in (*words[:1], *words[10:17])] for words in labels])
    t_s, (height, width, length) = number[:, 0] / LABEL_RATE_HZ, np.median(number[:, 1:4], axis=0)
    x, y, z, turn = number[:, 4:8].T
    # Labels: x to the right, y down, z ahead, angle 0 faces to the right and grows to the right of that.
    place = np.stack([z, -x, CAMERA_HEIGHT_M - y], axis=1)
    heading = np.unwrap(-turn - np.pi / 2)
    return Trajectory(
        name,
        _KINDS[labels[0][2]],
        (float(length), float(width), float(height)),
        float(t_s[0]),
        float(t_s[-1]),
        make_smoothing_spline(t_s, place, lam=SMOOTHNESS),
        make_smoothing_spline(t_s, heading, lam=SMOOTHNESS),
    )


def _path(trajectory: Trajectory, at_s: np.ndarray, seen: np.ndarray, world: World) -> BodyPath:
    """The path over the ground of an object whose path relative to us is known."""
    inside = np.clip(at_s, trajectory.first_s, trajectory.last_s)
    ground = world.path.position_m * [1.0, 1.0, 0.0]
    position = ground + np.where(seen[:, None], trajectory.place(inside), [GONE_M, 0.0, 0.0])
    velocity = world.path.velocity_m_s + np.where(seen[:, None], trajectory.place.derivative()(inside), 0.0)
    rotation = Rotation.from_rotvec(np.multiply.outer(trajectory.heading(inside), [0.0, 0.0, 1.0])).as_matrix()
    turn = np.multiply.outer(trajectory.heading.derivative()(inside) * seen, [0.0, 0.0, 1.0])
    return BodyPath(rotation, position, velocity, turn)


def _someone_is_near(trajectories: tuple[Trajectory, ...], start_s: float) -> bool:
    times = start_s + np.linspace(0.0, CLIP_S, 21)
    for trajectory in trajectories:
        inside = (times >= trajectory.first_s) & (times <= trajectory.last_s)
        if inside.mean() > 0.6:
            depth = trajectory.place(times[inside])[:, 0]
            if np.mean((depth > NEAR_M[0]) & (depth < NEAR_M[1])) > 0.6:
                return True
    return False


FAMILIES = (
    Family(
        "KITTI-labels",
        "recorded",
        "real trajectories of cars, lorries, walkers and cyclists",
        recording_values,
        kinds=("tracks",),
        hfov_deg=(70.0, 95.0),
        collides=False,
    ),
)
