"""Where the tests take place: streets, avenues, country roads and motorways with what stands beside them.

Road frame: x along our lane, y to the left, the middle of our lane at y = 0. Traffic keeps to the right; a third of all
scenes are mirrored afterwards.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.random import Generator

from scenario_suite.scenario import Values

KM_H = 1 / 3.6
OWN_RADIUS_M = 1.0
"""Half our width with a hand's breadth: what comes nearer to the camera than this touches us."""
FRAME_RATE_HZ = 20.0
LANE_M = 3.6
SHOULDER_M = 3.2
_SHOULDER_SHARE = 0.4
COLOURS = (
    [170, 40, 40], [190, 190, 195], [40, 60, 170], [70, 110, 160], [210, 170, 60], [50, 90, 60], [60, 55, 50],
    [225, 225, 225], [30, 30, 34], [150, 80, 30],
)  # fmt: skip
SIZES_M = {
    "car": (4.3, 1.8, 1.45),
    "lorry": (9.0, 2.5, 3.6),
    "bus": (11.5, 2.55, 3.1),
    "motorcycle": (2.1, 0.8, 1.6),
    "cyclist": (1.8, 0.6, 1.8),
    "walker": (0.0, 0.6, 1.75),
}
"""Length, width, height of those we meet."""
MIRRORED_SHARE = 1 / 3
"""Share of scenes with traffic on the left."""


def km_h(rng: Generator, low: float, high: float) -> float:
    """A speed between two of the trade's, in m/s."""
    return float(rng.uniform(low, high)) * KM_H


def side(rng: Generator) -> float:
    """Left (1) or right (-1)."""
    return float(rng.choice([-1.0, 1.0]))


def colour(rng: Generator) -> list[int]:
    """The colour of a body."""
    return list(COLOURS[int(rng.integers(len(COLOURS)))])


def thing(rng: Generator, name: str, kind: str, at_m: tuple[float, float], **values: Any) -> Values:
    """A body on the road."""
    body = {"name": name, "kind": kind, "at_m": [*at_m, 0.0], "colour_rgb": colour(rng), **values}
    if kind in SIZES_M and "size_m" not in body:
        length, width, height = SIZES_M[kind]
        grown = rng.uniform(0.93, 1.08)
        body["size_m"] = [max(length, 0.1) * grown, width, height * grown]
    return body


def row(
    name: str, kind: str, at_m: list[float], size_m: list[float] | None = None, count: int = 1, step_m: float = 0.0
) -> Values:
    """A static body, or several along the road."""
    body: Values = {"name": name, "kind": kind, "at_m": at_m}
    if size_m is not None:
        body["size_m"] = size_m
    return body if count == 1 else {**body, "repeat": {"count": count, "step_m": [step_m, 0.0, 0.0]}}


def drive(
    rng: Generator,
    own: Values,
    things: list[Values],
    *,
    duration_s: float,
    reach_m: float,
    setting: str | None = None,
    n_lanes: int = 2,
    gaps_m: tuple[tuple[float, float, float], ...] = (),
    hfov_deg: float | None = None,
    side_road_m: float | None = None,
    shoulder_m: float | None = None,
) -> Values:
    """The values of a drive past what stands beside the road.

    ``own`` is our motion, ``reach_m`` how far ahead the scenery goes, ``gaps_m`` (x from, x to, side) what has to stay
    open beside the road; the first lane on the left is for oncoming traffic. ``side_road_m`` is where another road
    crosses; ``shoulder_m`` widens the road on our side (default: by chance).
    """
    things = list(things)
    if side_road_m is not None:
        gaps_m = (*gaps_m, *((side_road_m - 5.5, side_road_m + 5.5, at_side) for at_side in (-1.0, 1.0)))
        slab = row("side road", "slab", [side_road_m, 0.0, 0.0], [7.0, 140.0, 0.02])
        things.append({**slab, "colour_rgb": [92, 94, 96]})
        for at_side in (-1.0, 1.0):
            things.append(row(f"house up the side road {at_side:+.0f}", "house", [side_road_m, at_side * 85.0, 0.0]))
    setting = setting or str(rng.choice(["town", "avenue", "country"]))
    if shoulder_m is None:
        shoulder_m = SHOULDER_M if rng.random() < _SHOULDER_SHARE else 0.0
    right_m, left_m = -LANE_M / 2 - 0.3 - shoulder_m, LANE_M * (n_lanes - 0.5) + 0.3
    bodies = [*things, *_roadside(rng, setting, right_m, left_m, reach_m, gaps_m)]
    values: Values = {
        "camera": {
            "image_size": [640, 360],
            "hfov_deg": hfov_deg or float(rng.uniform(48.0, 75.0)),
            "height_m": float(rng.uniform(1.2, 1.55)),
            "pitch_deg": float(rng.uniform(-1.0, 5.0)),
            "roll_deg": float(rng.uniform(-1.0, 1.0)),
            "fps": FRAME_RATE_HZ,
            "n_frames": max(12, math.floor(duration_s * FRAME_RATE_HZ) + 1),
        },
        "own_motion": {"pitch_jitter_deg": 0.04, "radius_m": OWN_RADIUS_M, **own},
        "ground": {
            "kind": "street",
            "road_width_m": left_m - right_m,
            "road_offset_m": (left_m + right_m) / 2,
            "pavement_width_m": 2.5 if setting == "town" else 0.5,
        },
        "picture": {"sky": str(rng.choice(["clear", "clouds"]))},
        "bodies": bodies,
    }
    return mirrored(values) if rng.random() < MIRRORED_SHARE else values


def _roadside(
    rng: Generator,
    setting: str,
    right_m: float,
    left_m: float,
    reach_m: float,
    gaps_m: tuple[tuple[float, float, float], ...],
) -> list[Values]:
    """Rows along both sides of the road, each body by itself where a gap has to stay open."""
    bodies: list[Values] = []
    for at_side, edge_m in ((-1.0, right_m), (1.0, left_m)):
        rows = _ROWS[setting](rng, at_side, edge_m, reach_m)
        open_m = [(low, high) for low, high, gap_side in gaps_m if gap_side == at_side]
        bodies += [part for body in rows for part in _with_gaps(body, open_m)]
    across = [9.0, 70.0, float(rng.uniform(8.0, 13.0))]
    kind = "wall" if setting == "motorway" else "house"
    bodies.append(row("end of the road", kind, [reach_m + 25.0, (left_m + right_m) / 2, 0.0], across))
    if setting == "motorway" or rng.random() < 0.15:
        x = float(rng.uniform(0.35, 0.8)) * reach_m
        bodies.append(row("bridge", "wall", [x, (left_m + right_m) / 2, 5.0], [6.0, 60.0, 1.3]))
        for at_side, edge_m in ((-1.0, right_m), (1.0, left_m)):
            bodies.append(row(f"pillar {at_side:+.0f}", "wall", [x, edge_m + 2.2 * at_side, 0.0], [5.0, 0.8, 5.0]))
    return bodies


def _town(rng: Generator, at_side: float, edge_m: float, reach_m: float) -> list[Values]:
    step = float(rng.uniform(13.0, 17.0))
    n = _count(reach_m, step)
    away = float(rng.uniform(3.5, 6.0)) + 4.5
    name = f"{at_side:+.0f}"
    size = [float(rng.uniform(10.0, 12.5)), 9.0, float(rng.uniform(6.0, 11.0))]
    bodies = [row(f"house {name}", "house", [rng.uniform(3.0, 9.0), edge_m + at_side * away, 0.0], size, n, step)]
    post = [0.16, 0.16, float(rng.uniform(1.0, 5.0))]
    place = [float(rng.uniform(6.0, 12.0)), edge_m + at_side * rng.uniform(0.5, 1.2), 0.0]
    bodies.append(row(f"post {name}", "post", place, post, n, step + 1.0))
    if rng.random() < 0.5:
        place = [float(rng.uniform(9.0, 18.0)), edge_m + at_side * 2.2, 0.0]
        bodies.append(row(f"tree {name}", "tree", place, None, n, step + 3.0))
    if rng.random() < 0.5:
        place = [float(rng.uniform(10.0, 20.0)), edge_m + at_side * 1.1, 0.0]
        bodies.append(row(f"parked car {name}", "car", place, None, n, float(rng.uniform(6.5, 14.0))))
    return bodies


def _avenue(rng: Generator, at_side: float, edge_m: float, reach_m: float) -> list[Values]:
    step, size = float(rng.uniform(7.0, 12.0)), float(rng.uniform(5.0, 9.0))
    n = _count(reach_m, step, most=16)
    place = [float(rng.uniform(5.0, 10.0)), edge_m + at_side * rng.uniform(1.6, 2.8), 0.0]
    trees = row(f"tree {at_side:+.0f}", "tree", place, [0.5 * size, 0.5 * size, size], n, max(step, reach_m / n))
    hedge = [reach_m / 2, edge_m + at_side * rng.uniform(6.0, 9.0), 0.0]
    return [trees, row(f"hedge {at_side:+.0f}", "island", hedge, [reach_m, 1.0, float(rng.uniform(1.0, 2.5))])]


def _country(rng: Generator, at_side: float, edge_m: float, reach_m: float) -> list[Values]:
    name, step = f"{at_side:+.0f}", float(rng.uniform(18.0, 30.0))
    n = _count(reach_m, step)
    place = [float(rng.uniform(8.0, 14.0)), edge_m + at_side * 0.8, 0.0]
    bodies = [row(f"marker post {name}", "post", place, [0.12, 0.12, 1.0], n, step)]
    if rng.random() < 0.5:
        bodies.append(row(f"rail {name}", "wall", [reach_m / 2, edge_m + at_side, 0.35], [reach_m, 0.08, 0.4]))
    place = [float(rng.uniform(10.0, 20.0)), edge_m + at_side * rng.uniform(4.0, 9.0), 0.0]
    size = float(rng.uniform(5.0, 9.0))
    bodies.append(row(f"tree {name}", "tree", place, [0.6 * size, 0.6 * size, size], n, step * 1.1))
    farm = [float(rng.uniform(25.0, 50.0)), edge_m + at_side * rng.uniform(18.0, 30.0), 0.0]
    bodies.append(row(f"farm {name}", "house", farm, [14.0, 10.0, 8.0], max(1, n // 2), 2.3 * step))
    return bodies


def _motorway(rng: Generator, at_side: float, edge_m: float, reach_m: float) -> list[Values]:
    name = f"{at_side:+.0f}"
    rail = [reach_m / 2, edge_m + at_side * 0.6, 0.35]
    bodies = [row(f"rail {name}", "wall", rail, [reach_m, 0.08, 0.4])]
    step = float(rng.uniform(20.0, 28.0))
    n = _count(reach_m, step)
    bodies.append(row(f"rail post {name}", "post", [10.0, edge_m + at_side * 0.7, 0.0], [0.12, 0.12, 0.9], n, step))
    if rng.random() < 0.4:
        barrier = [reach_m / 2, edge_m + at_side * 4.0, 0.0]
        bodies.append(row(f"noise barrier {name}", "wall", barrier, [reach_m, 0.3, float(rng.uniform(2.0, 4.0))]))
    else:
        place = [float(rng.uniform(10.0, 20.0)), edge_m + at_side * rng.uniform(6.0, 10.0), 0.0]
        bodies.append(row(f"tree {name}", "tree", place, [5.0, 5.0, 8.0], n, step))
    return bodies


_ROWS = {"town": _town, "avenue": _avenue, "country": _country, "motorway": _motorway}


def _count(reach_m: float, step_m: float, most: int = 14) -> int:
    return int(np.clip(reach_m / step_m, 2, most))


def _with_gaps(body: Values, open_m: list[tuple[float, float]]) -> list[Values]:
    """A row without those of its bodies that reach into what has to stay open; a long one is cut."""
    if not open_m:
        return [body]
    count, step = 1, 0.0
    if "repeat" in body:
        count, step = body["repeat"]["count"], body["repeat"]["step_m"][0]
    half = body.get("size_m", [3.0])[0] / 2
    spans = [(body["at_m"][0] + k * step - half, body["at_m"][0] + k * step + half) for k in range(count)]
    for low, high in open_m:
        spans = [part for start, end in spans for part in ((start, min(end, low)), (max(start, high), end))]
        spans = [(start, end) for start, end in dict.fromkeys(spans) if end - start > 0.05]
    parts = []
    for number, (start, end) in enumerate(spans):
        part = {key: value for key, value in body.items() if key != "repeat"}
        part["name"] = f"{body['name']} {number + 1}"
        part["at_m"] = [(start + end) / 2, *body["at_m"][1:]]
        if "size_m" in body:
            part["size_m"] = [end - start, *body["size_m"][1:]]
        if end - start > 0.6 * 2 * half or 2 * half > 20.0:
            parts.append(part)
    return parts


_MIRRORED = {
    "heading_deg", "yaw_rate_deg_s", "roll_deg", "bank_deg", "road_offset_m", "lane_change_m",
}  # fmt: skip
_MIRRORED_VECTORS = {"at_m", "velocity_m_s", "step_m"}


def mirrored(values: Any) -> Any:
    """The same scene with left and right exchanged."""
    if isinstance(values, list):
        return [mirrored(value) for value in values]
    if not isinstance(values, dict):
        return values
    result: Values = {}
    for key, value in values.items():
        if key in _MIRRORED:
            result[key] = -value
        elif key in _MIRRORED_VECTORS:
            result[key] = [value[0], -value[1], value[2]]
        elif key == "centre_m":
            result[key] = [value[0], -value[1]]
        else:
            result[key] = mirrored(value)
    return result
