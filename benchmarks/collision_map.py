"""How right collision maps and their advices are: against brute force, in drives that follow them, and how fast.

python benchmarks/collision_map.py [--scenes DIR] [--runs DIR] [--write-docs] [--check]

Six parts: (1) a map of 61 x 61 cells with 20 objects, timed; (2) maps from the truth of every sample scene, cell by
cell against every changed velocity driven in the simulator; (3) the same maps from analysed clips of the scenes on a
road, own speed given; (4) drives that follow the advice; (5) scenes without a collision; (6) real drives, whose drivers
do nothing most of the time. ``--scenes`` and ``--runs`` keep rendered scenes and runs of real clips for the next time.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from advised_drive import drive
from brute_force import contact_times_s, is_inner
from report import REPOSITORY, Bar, Report
from runs import TTCVID, analyze_command, data_folder, shown, timed

import ttcvid
from ttcvid.config import CollisionMapConfig
from ttcvid.jobs.collision_map.run_collision_map import open_clip_of
from ttcvid.jobs.collision_map.true_hazards import level_axes, own_body_of, true_situation
from ttcvid.simulate import Scene, World, build_world, encounters, load_scene
from ttcvid.studies.collision_map.evasion import EvasionLimits, EvasionStatus, evade
from ttcvid.studies.collision_map.hazards import OwnBody, Situation, joined, one_object
from ttcvid.studies.collision_map.velocity_map import LIKELY, map_of_changes

SCENES = REPOSITORY / "sample_configs" / "scenes"
LOOK_AHEAD_S = 5.0
N_CELLS = 61
TIMED_MAPS = 40
ON_ROAD = ("crossing_clear", "crossing_collision", "demo", "oncoming", "parked_street")
"""Scenes at constant own speed in which everything stands on the road."""
FIRST_RUN_FRAME, RUN_FRAME_STEP = 20, 12
BRAKES_M_S2 = 0.3
KITTI = ["--camera", "DATA/kitti_sfnd_ttc/calib.txt", "--platform", "vehicle"]
REAL_DRIVES: dict[str, tuple[str, list[str], dict[str, Any]]] = {
    "kitti_sfnd_ttc": ("kitti_sfnd_ttc/image_02", [*KITTI, "--fps", "9.6525"], {"camera_height_m": 1.65}),
    "kitti_speed_300": ("driving_clips/kitti_speed_300.mp4", KITTI, {"camera_height_m": 1.65}),
    "solidWhiteRight": ("driving_clips/solidWhiteRight.mp4", ["--platform", "vehicle"], {"ego_speed": "100km/h"}),
    "davis_car_shadow": ("davis_car_shadow/JPEGImages/480p/car-shadow", ["--fps", "24"], {"ego_speed": "4km/h"}),
}
"""Clip, options of its analysis and scale of its map. The second one goes back and forth: backwards, we do not look."""
COURSE_CHANGES = {
    "lead_car_brakes": "the lead car begins to brake at 0.8 s, which nobody can know before",
    "swinging_drive": "our own direction swings by 10 deg: to keep the present one would end in a tree or a parked car",
    "roundabout": "we brake all the time: to keep the present speed would end in the bus",
    "stop_at_crossing": "we brake to a stop: to keep the speed would end in the cars that cross 18 m ahead",
}
"""Scenes in which keeping the present velocity is not what happens."""


def main() -> int:
    """Run all parts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=Path, metavar="DIR", help="keep rendered scenes and their runs here")
    parser.add_argument("--runs", type=Path, metavar="DIR", help="keep runs of real clips here")
    parser.add_argument("--write-docs", action="store_true", help="write docs/collision_map.md")
    parser.add_argument("--check", action="store_true", help="exit 1 when a bar is missed")
    arguments = parser.parse_args()
    report = Report()
    report.say(
        "[What a map says](evasion.md); what was measured of it is here. "
        "A cell is away from the border when all its eight neighbours fare as it does in the simulator."
    )
    time_maps(report)
    maps_from_truth(report)
    with tempfile.TemporaryDirectory() as temporary:
        maps_from_runs(report, arguments.scenes or Path(temporary))
    advised_drives(report)
    quiet_scenes(report)
    with tempfile.TemporaryDirectory() as temporary:
        real_drives(report, arguments.runs or Path(temporary))
    if arguments.write_docs:
        report.write_docs("collision_map.md", "Collision maps, measured")
    return report.exit_code(arguments.check)


def time_maps(report: Report) -> None:
    """Part 1: the best of many, because the machine may have other things to do."""
    report.heading("Speed: 61 x 61 cells, 20 objects")
    rng = np.random.default_rng(0)
    changes = np.linspace(-10.0, 10.0, N_CELLS)
    for words, variance in (("known exactly", 0.0), ("uncertain", 1.0)):
        covariance = variance * np.diag([0.3, 0.1, 2.0, 0.3, 0.1, 1.0])
        cars = [
            one_object(
                f"car {k}",
                k + 1,
                np.array([[rng.uniform(-20, 20), 0.3, rng.uniform(5, 60)]]),
                np.array([[rng.uniform(-8, 8), 0.0, rng.uniform(-15, 0)]]),
                np.array([[0.9, 0.7, 2.1]]),
                float(rng.uniform(-3, 3)),
                covariance[None],
            )
            for k in range(20)
        ]
        for outline, is_round in (("box", False), ("round", True)):
            situation = Situation(joined(cars), OwnBody(1.8, 4.5, 1.5, is_round), np.array([0.0, 0.0, 10.0]))
            map_of_changes(situation, changes, changes, LOOK_AHEAD_S)
            best_s = min(_timed_map(situation, changes) for _ in range(TIMED_MAPS))
            report.figure(f"{words}, own outline {outline}", 1e3 * best_s, "ms", Bar(50.0))


def _timed_map(situation: Situation, changes: np.ndarray) -> float:
    start_s = time.perf_counter()
    map_of_changes(situation, changes, changes, LOOK_AHEAD_S)
    return time.perf_counter() - start_s


def maps_from_truth(report: Report) -> None:
    """Part 2."""
    report.heading("Maps from truth")
    report.say("Every changed velocity driven in the simulator, at a quarter, half and three quarters of each scene.")
    rows, shares = [], []
    for path in sorted(SCENES.glob("*.yaml")):
        scene = load_scene(path)
        world = build_world(scene)
        for frame in (world.n_frames // 4, world.n_frames // 2, 3 * world.n_frames // 4):
            situation = true_situation(world, frame, own_body_of(world))
            forward, right = _changes(situation)
            made = map_of_changes(situation, forward, right, LOOK_AHEAD_S)
            contact = brute_force_map(scene, world, frame, situation, forward, right)
            is_hit, is_likely = np.isfinite(contact), made.probability >= LIKELY
            inner = is_inner(is_hit)
            share = 100.0 * float((is_hit == is_likely)[inner].mean())
            late_s = np.abs(made.time_s - contact)[is_hit & is_likely & inner]
            shares.append(share)
            late = f"{1e3 * np.median(late_s):.0f}" if len(late_s) else "-"
            note = COURSE_CHANGES.get(scene.name, "") if share < 99.0 else ""
            row = [scene.name, str(frame), f"{100 * is_hit.mean():.0f}", f"{share:.2f}", late, note]
            rows.append(row)
            print("  ".join(row), flush=True)
    report.table(
        ["scene", "frame", "collide, %", "right away from the border, %", "median difference in time, ms", ""], rows
    )
    report.figure("cells away from the border that agree, mean of all maps", float(np.mean(shares)), "%", _at_least(99))
    report.figure("maps with at least 99 %", 100 * float(np.mean(np.array(shares) >= 99.0)), "%")


def maps_from_runs(report: Report, folder: Path) -> None:
    """Part 3."""
    report.heading("Maps from analysed clips")
    report.say(
        "Clips of scenes on a road, analysed with camera and horizon; of the map's input only own speed is given. "
        "Frames 20, 32, ... of each."
    )
    rows, shares = [], []
    for name in ON_ROAD:
        scene, run = _analyzed(report, folder, name)
        world = build_world(scene)
        size_m = 2.0 * scene.own_motion.radius_m
        config = CollisionMapConfig(
            ego_speed=str(scene.own_motion.speed_m_s), width_m=size_m, length_m=size_m, height_m=size_m
        )
        clip = open_clip_of(run, config)
        of_scene = []
        for frame in range(FIRST_RUN_FRAME, world.n_frames, RUN_FRAME_STEP):
            situation = clip.moment(frame).situation
            if situation is None:
                of_scene.append((0.0, 0.0, 0.0))
                continue
            forward, right = _changes(true_situation(world, frame, own_body_of(world)))
            made = map_of_changes(situation, forward, right, LOOK_AHEAD_S)
            truth = true_situation(world, frame, own_body_of(world))
            is_hit = np.isfinite(brute_force_map(scene, world, frame, truth, forward, right))
            is_likely, inner = made.probability >= LIKELY, is_inner(is_hit)
            wrong = is_hit[inner].astype(int) - is_likely[inner]
            of_scene.append((float((wrong == 0).mean()), float((wrong > 0).mean()), float((wrong < 0).mean())))
        right_share, missed, false = 100.0 * np.mean(of_scene, axis=0)
        shares.append(right_share)
        row = [name, str(len(of_scene)), f"{right_share:.1f}", f"{missed:.1f}", f"{false:.1f}"]
        rows.append(row)
        print("  ".join(row), flush=True)
    header = ["scene", "maps", "right, %", "free, but collides, %", "collides, but free, %"]
    report.table(header, rows)
    report.figure(
        "cells away from the border that agree, mean of the scenes", float(np.mean(shares)), "%", _at_least(90)
    )


def advised_drives(report: Report) -> None:
    """Part 4."""
    report.heading("Drives that follow the advice")
    report.say(
        "Every scene with a collision, driven to 4 s after it; an advice each 0.1 s, followed from the first on."
    )
    rows, n_hit = [], 0
    for path in sorted(SCENES.glob("*.yaml")):
        scene = load_scene(path)
        hits = [one for one in encounters(scene) if one.is_collision]
        if not hits:
            continue
        contact_s = min(one.t_contact_s for one in hits)
        done = drive(scene, contact_s + 4.0, 0.1)
        is_hit = np.isfinite(done.contact_s)
        n_hit += is_hit
        outcome = f"TOUCHES {done.touched} at {done.contact_s:.2f} s" if is_hit else f"{done.nearest_m:.2f} m"
        row = [
            scene.name,
            f"{hits[0].name}, {contact_s:.2f} s",
            f"{done.first_advice_s:.1f} s",
            outcome,
            f"{scene.own_motion.radius_m:g} m",
            f"{3.6 * scene.own_motion.speed_m_s:.0f} to {3.6 * done.end_speed_m_s:.0f} km/h",
        ]
        rows.append(row)
        print("  ".join(row), flush=True)
    report.table(["scene", "without advice", "first advice", "nearest, followed", "own radius", "speed"], rows)
    report.figure("collisions though the advice was followed", float(n_hit), "", Bar(0.0))


def quiet_scenes(report: Report) -> None:
    """Part 5: frames with an advice where the scene has no collision."""
    report.heading("Scenes without a collision")
    rows, n_false = [], 0
    for path in sorted(SCENES.glob("*.yaml")):
        scene = load_scene(path)
        if any(one.is_collision for one in encounters(scene)):
            continue
        world = build_world(scene)
        advices = [
            evade(true_situation(world, frame, own_body_of(world)), EvasionLimits()) for frame in range(world.n_frames)
        ]
        n = sum(advice.status is not EvasionStatus.no_danger for advice in advices)
        note = COURSE_CHANGES.get(scene.name, "")
        n_false += 0 if note else n
        rows.append([scene.name, f"{n} of {world.n_frames}", note])
        print("  ".join(rows[-1]), flush=True)
    report.table(["scene", "frames with an advice", ""], rows)
    report.figure("frames with an advice, in scenes where keeping the present velocity is safe", n_false, "", Bar(0.0))


def real_drives(report: Report, folder: Path) -> None:
    """Part 6: what is advised in real clips in which nothing comes near a collision."""
    report.heading("Real drives")
    report.say(
        "Nothing in these clips comes near a collision. A driver does nothing where own speed, as the camera's height "
        f"tells it, falls by less than {BRAKES_M_S2:g} m/s^2; with a speed that is given once, all the time."
    )
    rows, n_false, n_no_escape = [], 0, 0
    for name, (clip, options, scale) in REAL_DRIVES.items():
        run = _analyzed_clip(report, folder, name, clip, options)
        table = pd.read_parquet(_map_of(run, folder / f"{name}_map", scale) / "evasion.parquet")
        counts = table.status.value_counts()
        is_idle = ~is_braking(table.t_s.to_numpy(), table.own_speed_m_s.to_numpy(float))
        n_idle = int((is_idle & (table.status == "advice")).sum())
        n_false, n_no_escape = n_false + n_idle, n_no_escape + int(counts["no_escape"])
        n_told = int(counts[["no_danger", "advice", "no_escape"]].sum())
        row = [name, " ".join(f"{key} {value}" for key, value in scale.items()), str(len(table)), str(n_told)]
        row += [str(counts["advice"]), str(n_idle), str(counts["no_escape"])]
        rows.append(row)
        print("  ".join(row), flush=True)
    header = ["clip", "scale", "frames", "with a map that tells", "advice", "of those, driver idle", "no escape"]
    report.table(header, rows)
    report.figure("frames with an advice though the driver does nothing", float(n_false), "", Bar(0.0))
    report.figure("frames without a way out", float(n_no_escape), "", Bar(0.0))


def is_braking(t_s: np.ndarray, speed_m_s: np.ndarray) -> np.ndarray:
    """In which frames own speed falls, by a straight line through what is known of it half a second about each."""
    braking = np.zeros(len(t_s), bool)
    for n, now_s in enumerate(t_s):
        near = (np.abs(t_s - now_s) <= 0.5) & np.isfinite(speed_m_s)
        if near.sum() >= 3:
            braking[n] = np.polyfit(t_s[near], speed_m_s[near], 1)[0] <= -BRAKES_M_S2
    return braking


def _analyzed_clip(report: Report, folder: Path, name: str, clip: str, options: list[str]) -> Path:
    """The run of a real clip, as it was kept or new."""
    folder.mkdir(parents=True, exist_ok=True)
    run = folder / name
    if not run.exists():
        data = data_folder()
        placed = [str(data / word.removeprefix("DATA/")) if word.startswith("DATA/") else word for word in options]
        words = analyze_command(data / clip, Path(name), [*placed, "--no-overlay"])
        timed(words, folder)
        report.command(shown(words))
    return run


def _map_of(run: Path, out: Path, scale: dict[str, Any]) -> Path:
    """The folder with the map of a run."""
    ttcvid.collision_map(run, out, overwrite=True, **scale)
    return out


def brute_force_map(
    scene: Scene, world: World, frame: int, situation: Situation, forward: np.ndarray, right: np.ndarray
) -> np.ndarray:
    """Times of contact ``(F, R)`` of all changed velocities in the simulator."""
    ahead, aside = np.meshgrid(forward, right, indexing="ij")
    change = np.stack([aside.ravel(), np.zeros(aside.size), ahead.ravel()], axis=1)
    level_R_road = level_axes(world.path.velocity_m_s[frame], world.path.cam_R_road[frame].T)
    velocities = world.path.velocity_m_s[frame] + change @ level_R_road
    start_s = float(world.path.t_s[frame])
    contact = contact_times_s(scene, start_s, velocities, -situation.own_turn_rad_s, LOOK_AHEAD_S)
    return contact.reshape(ahead.shape)


def _changes(situation: Situation) -> tuple[np.ndarray, np.ndarray]:
    """The changes that the command's own map has: as far as own speed forward, half of it sideways."""
    reach = float(np.clip(np.hypot(*situation.own_velocity_m_s[[0, 2]]), 3.0, 15.0))
    changes = np.linspace(-reach, reach, N_CELLS)
    return changes, 0.5 * changes


def _analyzed(report: Report, folder: Path, name: str) -> tuple[Scene, Path]:
    """A scene and the run of its clip."""
    folder.mkdir(parents=True, exist_ok=True)
    simulated, run = folder / name, folder / f"{name}_run"
    if not simulated.exists():
        timed([str(TTCVID), "simulate", str(SCENES / f"{name}.yaml"), "-o", str(simulated), "-q"], folder)
    options = ["--camera", f"{name}/camera.yaml", "--horizon", f"{name}/horizon.yaml"]
    options += ["--platform", "vehicle", "--no-overlay", "--overwrite"]
    words = analyze_command(Path(name) / "clip.mp4", Path(f"{name}_run"), options)
    timed(words, folder)
    if name == ON_ROAD[0]:
        report.command(["ttcvid", *words[1:]])
    return load_scene(simulated / "scene.yaml"), run


def _at_least(limit: float) -> Bar:
    return Bar(limit, at_least=True)


if __name__ == "__main__":
    sys.exit(main())
