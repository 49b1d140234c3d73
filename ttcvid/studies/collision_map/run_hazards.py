"""The situation of a moment from the tables of a run: what has a scale becomes metres, what has none a family.

A run knows places and velocities in units of each object's own depth. Four links lead to metres: own speed scales the
static scene; the road under it then tells the camera's height, or the other way round; a moving object stands on that
road, or has a known width. An object that moves with the scene (its ``motion_id`` is 0) has the scene's scale.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ttcvid.geometry.rotation import normalize
from ttcvid.model import SCENE_MOTION, Bools, Floats, Ints
from ttcvid.studies.collision_map.contacts import AHEAD, DOWN, RIGHT
from ttcvid.studies.collision_map.hazards import Hazards, OwnBody, Situation, joined, one_object
from ttcvid.studies.collision_map.static_scene import (
    BORDER_SHARE,
    StaticPoints,
    carried,
    no_points,
    obstacles,
    remembered,
    seen_now,
)

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
_REST_SIGMA = 0.1
"""Relative error of distance up to which an object at rest, of several tracks, has a depth by own speed."""
_LINKS_AGREE_SIGMAS = 2.0
"""Two links of one object that differ by more contradict each other."""
_SPEED_SIGMA = 0.02
"""Relative uncertainty of own speed, as of a speedometer's reading that was corrected."""
_FAMILY_DISTANCES_M = (3.0, 150.0)
_MAX_MOVER_M_S = 60.0
_N_FAMILY = 9
"""An object without a link may be at any of these distances, in equal ratios, if that makes it no faster than this."""
_VIEW_SHARE = 0.9
"""At the border of the picture, points come and go: what lies in this share of it, from the middle on, is in view."""
_N_HEIGHTS = 50
"""A camera keeps its height: by own speed it is the median of the last ones that the road told."""
_WATCHED_S, _LONGEST_GAP_S = 0.5, 1.0
"""After this time the static scene is known as far as it will be; over a longer gap all of it is forgotten."""


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
    along gravity; ``turn_rad_s`` rate of turning to the right; ``point_id (N,)`` tracks of static points,
    ``point_rays (N, 3)`` with z = 1, and their distances ``point_range_s (N,)`` in seconds of own motion, known to
    ``point_sigma (N,)``, relative; ``view (2, 2)`` the picture's lowest and highest x and y of rays with z = 1.
    """

    t_s: float
    own_direction: Floats
    down: Floats
    turn_rad_s: float
    point_id: Ints
    point_rays: Floats
    point_range_s: Floats
    point_sigma: Floats
    objects: SeenObjects
    view: Floats


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
    """What a frame leaves to the next one: time, static points, own velocity ``(3,)`` and turning, in level axes.

    The static scene has been watched for ``watched_s``; ``heights_m`` are the camera's last ones by own speed.
    """

    t_s: float
    points: StaticPoints
    own_velocity_m_s: Floats
    turn_rad_s: float
    watched_s: float
    heights_m: tuple[float, ...]


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
    is_scene_known: bool = False
    """Whether the static scene has been watched for long enough, over a road where objects stand on one."""
    course_rad: tuple[float, float] = (-np.pi, np.pi)
    """Which courses lie in view, from ahead to the right."""


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
    heights = () if memory is None else memory.heights_m
    # A speed of zero scales nothing, whatever the pictures show.
    if speed is not None and speed >= _RESTING_M_S and height_s is not None:
        heights = (*heights, height_s * speed)[-_N_HEIGHTS:]
    height = scale.camera_height_m
    if height is None and heights:
        height = float(np.median(heights))
    notes = _notes(scale, speed, height)
    if speed is None:
        return SeenSituation(None, (), notes, None)
    own_velocity = _own_velocity(seen, level_R_cam, speed)
    points, watched_s = _points(seen, level_R_cam, speed, own_velocity, memory)
    now = Memory(seen.t_s, points, own_velocity, seen.turn_rad_s, watched_s, heights)
    road_m = height if scale.stands_on_road else None
    outline = own if road_m is None or own.is_round else own.standing_on_road(road_m)
    # Without its road, nobody knows which points stand on it, and which are the road itself.
    is_known = watched_s >= _WATCHED_S and (road_m is not None or not scale.stands_on_road)
    parts, unlinked = [obstacles(points, outline, own_velocity, road_m)] if is_known else [], []
    for k in range(len(seen.objects.cluster_id)):
        name = name_of(int(seen.objects.cluster_id[k]))
        distance, sigma, how = _object_depth_m(seen, k, scale, level_R_cam, speed, height)
        if distance is None:
            unlinked.append(name)
            notes = (*notes, f"{name}: neither width nor road tells its distance: drawn for each speed it can have.")
            parts.append(_family(seen, k, level_R_cam, own_velocity))
        else:
            notes = (*notes, f"{name}: {distance:.0f} m away by {how}.")
            hazard = _object_hazard(seen, k, level_R_cam, distance, sigma)
            is_at_rest = int(seen.objects.motion_id[k]) == SCENE_MOTION
            parts.append(_within_border(hazard, own) if is_at_rest else hazard)
    situation = Situation(joined(parts), outline, own_velocity, seen.turn_rad_s)
    speed_by_height = _speed_by_height(scale, height_s)
    course_rad = _courses_in_view(seen, level_R_cam)
    return SeenSituation(situation, tuple(unlinked), notes, now, speed_by_height, is_known, course_rad)


def _points(
    seen: SeenFrame, level_R_cam: Floats, speed_m_s: float, own_velocity_m_s: Floats, memory: Memory | None
) -> tuple[StaticPoints, float]:
    """The static points known after this frame, and for how long they have been watched.

    At rest nothing new is known, because then points have no scale.
    """
    before, watched_s = no_points(), 0.0
    gap_s = np.inf if memory is None else seen.t_s - memory.t_s
    if memory is not None and gap_s <= _LONGEST_GAP_S:
        before = carried(memory.points, gap_s * memory.own_velocity_m_s, gap_s * memory.turn_rad_s, gap_s)
        watched_s = memory.watched_s + gap_s
    if not own_velocity_m_s.any():
        return before, watched_s

    def is_in_view(place_m: Floats) -> Bools:
        return _in_view(seen, place_m @ level_R_cam)

    return remembered(before, static_points(seen, level_R_cam, speed_m_s), is_in_view), watched_s


def _in_view(seen: SeenFrame, place_cam_m: Floats) -> Bools:
    """Which places ``(M, 3)`` in the camera lie in the picture, but for its border."""
    low, high = _view(seen)
    with np.errstate(divide="ignore", invalid="ignore"):
        xy = place_cam_m[:, :2] / place_cam_m[:, 2:]
    return np.asarray((place_cam_m[:, 2] > 0.0) & ((xy > low) & (xy < high)).all(axis=1))


def _view(seen: SeenFrame) -> tuple[Floats, Floats]:
    """The lowest and highest x and y ``(2,)`` of rays that are in view."""
    middle, half = seen.view.mean(axis=0), 0.5 * np.ptp(seen.view, axis=0)
    return middle - _VIEW_SHARE * half, middle + _VIEW_SHARE * half


def _courses_in_view(seen: SeenFrame, level_R_cam: Floats) -> tuple[float, float]:
    """The courses over the ground along which the camera looks, from ahead to the right, in rad."""
    low, high = seen.view
    sides = (
        np.array([[low[0], 0.5 * (low[1] + high[1]), 1.0], [high[0], 0.5 * (low[1] + high[1]), 1.0]]) @ level_R_cam.T
    )
    left, right = np.arctan2(sides[:, RIGHT], sides[:, AHEAD])
    return float(left), float(right)


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
    return seen_now(seen.point_id[known], place, sigma[:, None] * place)


def _object_depth_m(
    seen: SeenFrame, k: int, scale: Scale, level_R_cam: Floats, speed_m_s: float, height_m: float | None
) -> tuple[float | None, float, str]:
    """Depth of an object's reference point, its relative standard deviation, and the link that it comes from.

    The motion of an object at rest has to be known as well as that of the static scene. Own speed and the road give it
    the same distance; otherwise it is not at rest, or does not stand there, and neither distance is used.
    """
    objects = seen.objects
    width = scale.width_m_of.get(int(objects.cluster_id[k]), scale.width_m)
    if width is not None:
        return width / float(np.linalg.norm(objects.right[k] - objects.left[k])), 0.1, "its width"
    by_road = None
    if scale.stands_on_road and height_m is not None:
        by_road = _depth_by_road(seen, k, level_R_cam, height_m)
    if int(objects.motion_id[k]) == SCENE_MOTION and speed_m_s > _RESTING_M_S:
        depth, sigma = _depth_by_speed(seen, k, speed_m_s)
        if sigma >= _REST_SIGMA:
            return None, np.inf, ""
        if by_road is None:
            return depth, sigma, "own speed, as a thing at rest"
        if abs(np.log(depth / by_road[0])) > _LINKS_AGREE_SIGMAS * np.hypot(sigma, by_road[1]):
            return None, np.inf, ""
    if by_road is not None:
        return *by_road, "where it stands on the road"
    return None, np.inf, ""


def _depth_by_road(seen: SeenFrame, k: int, level_R_cam: Floats, height_m: float) -> tuple[float, float] | None:
    """Depth of where the ray under an object meets the road, and its relative standard deviation."""
    ray = seen.objects.bottom[k]
    under = float(level_R_cam[DOWN] @ ray) / float(np.hypot(*(level_R_cam[[RIGHT, AHEAD]] @ ray)))
    sigma = float(np.hypot(_CONTACT_PX_SHARE, _CONTACT_NORM / under)) if under > 0.0 else np.inf
    # The ray meets the road at Z = height / (down part of a ray with z = 1).
    return (height_m / float(level_R_cam[DOWN] @ ray), sigma) if sigma < _PLACE_SIGMA else None


def _depth_by_speed(seen: SeenFrame, k: int, speed_m_s: float) -> tuple[float, float]:
    """Depth of an object at rest, and its relative standard deviation."""
    rate = float(np.linalg.norm(seen.objects.w[k]))
    if rate == 0.0:
        return np.inf, np.inf
    return speed_m_s / rate, float(np.sqrt(np.trace(seen.objects.cov_w[k]))) / rate


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


def _within_border(hazard: Hazards, own: OwnBody) -> Hazards:
    """What stands at the border of our way is no obstacle, as it is none in the static scene."""
    half = hazard.half_size_m - [BORDER_SHARE * own.width_m, 0.0, 0.0]
    return replace(hazard, half_size_m=half)


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
