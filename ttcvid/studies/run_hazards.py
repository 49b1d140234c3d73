"""The situation of a moment from the tables of a run: what has a scale becomes metres, what has none a family.

A run knows places and velocities in units of each thing's own depth. Four links lead to metres: own speed scales the
static scene; the road under it then tells the camera's height, or the other way round; a moving object stands on that
road, or has a known width. An object that moves with the scene (its ``motion_id`` is 0) has the scene's scale.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ttcvid.geometry.rotation import normalize
from ttcvid.model import SCENE_CLUSTER, Floats, Ints
from ttcvid.studies.contacts import AHEAD, DOWN, RIGHT
from ttcvid.studies.hazards import Hazards, OwnBody, Situation, joined, one_object
from ttcvid.studies.static_scene import StaticPoints, no_points, obstacles, remembered

_RESTING_M_S = 0.05
"""Below this own speed we rest."""
_PLACE_SIGMA = 0.2
"""Static points whose distance is known worse than this (relative) are left out."""
_GROUND_SIGMA, _MIN_GROUND_POINTS, _GROUND_SHARE = 0.1, 20, 0.3
"""The road is the commonest height under the camera: among points known to 10 %, of which this share agrees on it."""
_MAX_DEPTH_M = 2.0
"""An object is taken to be as deep as it is wide, but at most this: of a crossing car we see its length."""
_CONTACT_PX_SHARE, _CONTACT_NORM = 0.05, 0.002
"""Uncertainty of where an object stands on the road, in its tangent under the horizon: a share of it and a constant,
about a pixel: what is tracked of an object seldom reaches down to the road."""
_SPEED_SIGMA = 0.02
"""Relative uncertainty of own speed, as of a speedometer's reading that was corrected."""
_FAMILY_DISTANCES_M = (3.0, 150.0)
_MAX_MOVER_M_S = 60.0
_N_FAMILY = 9
"""An object without a link may be at any of these distances, in equal ratios, if that makes it no faster than this."""


@dataclass(frozen=True)
class SeenObjects:
    """K objects of a frame: ``cluster_id, motion_id (K,)``; rays with z = 1, in the camera.

    ``ref (K, 3)`` is the reference point, ``w (K, 3)`` its velocity V / Z in 1/s, ``cov_w (K, 3, 3)``; ``left``,
    ``right``, ``top`` and ``bottom`` ``(K, 3)`` are the middles of the sides of the box around its tracks.
    """

    cluster_id: Ints
    motion_id: Ints
    ref: Floats
    w: Floats
    cov_w: Floats
    left: Floats
    right: Floats
    top: Floats
    bottom: Floats


@dataclass(frozen=True)
class SeenFrame:
    """What a frame's tables say, in the camera.

    ``own_direction`` (3,) unit vector of own motion, NaN where we rest or it is unknown; ``down`` (3,) unit vector
    along gravity; ``turn_rad_s`` rate of turning to the right; ``point_rays (N, 3)`` with z = 1 of static points, and
    their distances ``point_range_s (N,)`` in seconds of own motion, known to ``point_sigma (N,)``, relative.
    """

    t_s: float
    own_direction: Floats
    down: Floats
    turn_rad_s: float
    point_rays: Floats
    point_range_s: Floats
    point_sigma: Floats
    objects: SeenObjects


@dataclass(frozen=True)
class Scale:
    """What gives metres: own speed, the camera's height, widths of objects by ``cluster_id`` and of all others.

    ``stands_on_road`` says whether objects that move are taken to stand on the road on which we are.
    """

    own_speed_m_s: float | None
    camera_height_m: float | None
    width_m_of: dict[int, float]
    width_m: float | None
    stands_on_road: bool


@dataclass(frozen=True)
class Memory:
    """What a frame leaves to the next one: time, static points, own velocity ``(3,)`` and turning, in level axes."""

    t_s: float
    points: StaticPoints
    own_velocity_m_s: Floats
    turn_rad_s: float


@dataclass(frozen=True)
class SeenSituation:
    """The situation; None: without any scale. ``unlinked`` are the names of objects of unknown speed.

    ``speed_by_height_m_s`` is own speed as the given camera's height over the road tells it; None: without height, road
    or motion.
    """

    situation: Situation | None
    unlinked: tuple[str, ...]
    notes: tuple[str, ...]
    memory: Memory | None
    speed_by_height_m_s: float | None = None


def situation_of(seen: SeenFrame, scale: Scale, own: OwnBody, memory: Memory | None = None) -> SeenSituation:
    """Give a frame its metres.

    Own speed and the camera's height, where only one is given, follow from each other by the road; an object's distance
    comes from its width, else from where it stands on the road, else (with the scene's motion) from own speed. An
    object that has none of these stands for all distances at which it would not be absurdly fast, each as likely.
    ``memory`` is what earlier frames have seen of the static scene.
    """
    level_R_cam = level_axes(seen)
    height_s = _camera_height_s(seen, level_R_cam)
    speed = _own_speed(scale, height_s)
    height = scale.camera_height_m
    # A speed of zero scales nothing, whatever the pictures show.
    if height is None and speed is not None and speed >= _RESTING_M_S and height_s is not None:
        height = height_s * speed
    notes = _notes(scale, speed, height)
    if speed is None:
        return SeenSituation(None, (), notes, None)
    own_velocity = _own_velocity(seen, level_R_cam, speed)
    now = Memory(seen.t_s, _points(seen, level_R_cam, speed, own_velocity, memory), own_velocity, seen.turn_rad_s)
    parts, unlinked = [obstacles(now.points, own_velocity, height if scale.stands_on_road else None)], []
    for k in range(len(seen.objects.cluster_id)):
        name = name_of(int(seen.objects.cluster_id[k]))
        distance, sigma, how = _object_depth_m(seen, k, scale, level_R_cam, speed, height)
        if distance is None:
            unlinked.append(name)
            notes = (*notes, f"{name}: neither width nor road tells its distance: drawn for each speed it can have.")
            parts.append(_family(seen, k, level_R_cam, own_velocity))
        else:
            notes = (*notes, f"{name}: {distance:.0f} m away by {how}.")
            parts.append(_object_hazard(seen, k, level_R_cam, distance, sigma))
    situation = Situation(joined(parts), own, own_velocity, seen.turn_rad_s)
    return SeenSituation(situation, tuple(unlinked), notes, now, _speed_by_height(scale, height_s))


def _points(
    seen: SeenFrame, level_R_cam: Floats, speed_m_s: float, own_velocity_m_s: Floats, memory: Memory | None
) -> StaticPoints:
    """The static points known after this frame; at rest none, because then they have no scale."""
    if not own_velocity_m_s.any():
        return no_points() if memory is None else memory.points
    points = static_points(seen, level_R_cam, speed_m_s)
    if memory is None:
        return remembered(no_points(), points, np.zeros(3), 0.0)
    gap_s = seen.t_s - memory.t_s
    return remembered(memory.points, points, gap_s * memory.own_velocity_m_s, gap_s * memory.turn_rad_s)


def name_of(cluster_id: int) -> str:
    """What an object is called in pictures and tables."""
    return f"object {cluster_id}"


def level_axes(seen: SeenFrame) -> Floats:
    """``level_R_cam (3, 3)``: right, down and ahead in the camera; ahead is own motion, else where the camera looks."""
    ahead = seen.own_direction if np.isfinite(seen.own_direction).all() else np.array([0.0, 0.0, 1.0])
    # Own motion over the road lies in the road: what of it is not is an error of the horizon, such as pitching.
    if np.isfinite(seen.own_direction).all():
        down = normalize((seen.down - (seen.down @ ahead) * ahead)[None])[0]
    else:
        down = seen.down
        ahead = normalize((ahead - (ahead @ down) * down)[None])[0]
    return np.stack([np.cross(down, ahead), down, ahead])


def _own_speed(scale: Scale, height_s: float | None) -> float | None:
    return _speed_by_height(scale, height_s) if scale.own_speed_m_s is None else scale.own_speed_m_s


def _speed_by_height(scale: Scale, height_s: float | None) -> float | None:
    return None if scale.camera_height_m is None or height_s is None else scale.camera_height_m / height_s


def _own_velocity(seen: SeenFrame, level_R_cam: Floats, speed_m_s: float) -> Floats:
    if speed_m_s < _RESTING_M_S or not np.isfinite(seen.own_direction).all():
        return np.zeros(3)
    return np.asarray(speed_m_s * level_R_cam @ seen.own_direction)


def _camera_height_s(seen: SeenFrame, level_R_cam: Floats) -> float | None:
    """Height of the camera over the road in seconds of own motion: the commonest one of well-known points below us."""
    below = (seen.point_range_s * (normalize(seen.point_rays) @ level_R_cam[DOWN]))[seen.point_sigma < _GROUND_SIGMA]
    below = np.sort(below[below > 0.0])
    if len(below) < _MIN_GROUND_POINTS:
        return None
    mode = _half_sample_mode(below)
    share = float((np.abs(below / mode - 1.0) < _GROUND_SIGMA).mean())
    return mode if share >= _GROUND_SHARE else None


def _half_sample_mode(values: Floats) -> float:
    """The mode of sorted values: the densest half, again and again. Bickel and Fruehwirth, 2006."""
    while len(values) > 2:
        half = (len(values) + 1) // 2
        first = int((values[half - 1 :] - values[: len(values) - half + 1]).argmin())
        values = values[first : first + half]
    return float(values.mean())


def static_points(seen: SeenFrame, level_R_cam: Floats, speed_m_s: float) -> StaticPoints:
    """The static points of a frame in metres."""
    known = (seen.point_sigma < _PLACE_SIGMA) & np.isfinite(seen.point_range_s)
    place = (seen.point_range_s[:, None] * normalize(seen.point_rays))[known] @ level_R_cam.T * speed_m_s
    sigma = np.hypot(seen.point_sigma[known], _SPEED_SIGMA)
    return StaticPoints(place, sigma[:, None] * place, np.ones(len(place), np.int64))


def _object_depth_m(
    seen: SeenFrame, k: int, scale: Scale, level_R_cam: Floats, speed_m_s: float, height_m: float | None
) -> tuple[float | None, float, str]:
    """Depth of an object's reference point, its relative standard deviation, and the link that it comes from."""
    objects = seen.objects
    width = scale.width_m_of.get(int(objects.cluster_id[k]), scale.width_m)
    if width is not None:
        return width / float(np.linalg.norm(objects.right[k] - objects.left[k])), 0.1, "its width"
    if scale.stands_on_road and height_m is not None:
        ray = objects.bottom[k]
        under = float(level_R_cam[DOWN] @ ray) / float(np.hypot(*(level_R_cam[[RIGHT, AHEAD]] @ ray)))
        sigma = float(np.hypot(_CONTACT_PX_SHARE, _CONTACT_NORM / under)) if under > 0.0 else np.inf
        if sigma < _PLACE_SIGMA:
            # The ray meets the road at Z = height / (down part of a ray with z = 1).
            return height_m / float(level_R_cam[DOWN] @ ray), sigma, "where it stands on the road"
    if int(objects.motion_id[k]) == SCENE_CLUSTER and speed_m_s > _RESTING_M_S:
        rate = float(np.linalg.norm(objects.w[k]))
        sigma = float(np.sqrt(np.trace(objects.cov_w[k]))) / rate if rate > 0.0 else np.inf
        if sigma < _PLACE_SIGMA:
            return speed_m_s / rate, sigma, "own speed, as a thing at rest"
    return None, np.inf, ""


def _object_hazard(seen: SeenFrame, k: int, level_R_cam: Floats, depth_m: float, sigma: float) -> Hazards:
    """An object at a known depth: a box as wide and high as it is seen."""
    objects = seen.objects
    ref, w = level_R_cam @ objects.ref[k], level_R_cam @ objects.w[k]
    left, right, top, bottom = (level_R_cam @ v[k] for v in (objects.left, objects.right, objects.top, objects.bottom))
    width, height = (float(np.linalg.norm(v)) * depth_m for v in (right - left, bottom - top))
    deep = min(width, _MAX_DEPTH_M)
    place = 0.5 * depth_m * (left + right)
    place[DOWN] = 0.5 * depth_m * (top + bottom)[DOWN]
    place[AHEAD] += 0.5 * deep
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = (sigma * depth_m) ** 2 * np.outer(ref, ref)
    covariance[3:, :3] = (sigma * depth_m) ** 2 * np.outer(w, ref)
    covariance[:3, 3:] = covariance[3:, :3].T
    covariance[3:, 3:] = (sigma * depth_m) ** 2 * np.outer(w, w)
    covariance[3:, 3:] += depth_m**2 * level_R_cam @ objects.cov_w[k] @ level_R_cam.T
    cluster_id = int(objects.cluster_id[k])
    half = 0.5 * np.array([[width, height, deep]])
    return one_object(
        name_of(cluster_id), cluster_id, place[None], depth_m * w[None], half, covariance=covariance[None]
    )


def _family(seen: SeenFrame, k: int, level_R_cam: Floats, own_velocity_m_s: Floats) -> Hazards:
    """An object at each of the distances that it can have, as alternatives of equal weight."""
    w = level_R_cam @ seen.objects.w[k]
    depths = np.geomspace(*_FAMILY_DISTANCES_M, 4 * _N_FAMILY)
    over_ground = np.linalg.norm(depths[:, None] * w + own_velocity_m_s, axis=1)
    possible = depths[over_ground <= _MAX_MOVER_M_S]
    if len(possible) == 0:
        possible = depths[:1]
    depths = np.geomspace(possible[0], possible[-1], _N_FAMILY)
    members = [_object_hazard(seen, k, level_R_cam, float(depth), 0.1) for depth in depths]
    together = joined(members)
    return replace(
        together,
        object_index=np.zeros(_N_FAMILY, np.int64),
        alternative=np.arange(_N_FAMILY),
        weight=np.full(_N_FAMILY, 1.0 / _N_FAMILY),
        names=members[0].names,
        cluster_ids=members[0].cluster_ids,
    )


def _notes(scale: Scale, speed_m_s: float | None, height_m: float | None) -> tuple[str, ...]:
    """What the metres rest on."""
    if speed_m_s is None:
        return ("No scale: neither own speed nor a road under a camera of known height.",)
    speed = f"own speed {3.6 * speed_m_s:.0f} km/h"
    speed += " as given" if scale.own_speed_m_s is not None else " by the camera's height over the road"
    if height_m is None:
        return (f"Scale: {speed}; no road found, so nothing stands on it.",)
    height = f"camera {height_m:.2f} m over the road"
    height += " as given" if scale.camera_height_m is not None else " by own speed"
    return (f"Scale: {speed}, {height}.",)
