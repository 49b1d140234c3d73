"""How likely objects are on collision course, by one frame each: a short time and a small miss distance."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from ttcvid.config import EventsConfig
from ttcvid.geometry.along_bend import BEND_ENDS, straightened
from ttcvid.geometry.camera.pinhole import rays_from_pixels
from ttcvid.geometry.rotation import tangent_basis
from ttcvid.model import APPROACHING, SCENE_MOTION, Camera, ClusterRow, Floats, MotionState
from ttcvid.stages.segmentation.own_turn import OwnBend
from ttcvid.stages.segmentation.road import OWN_HALF_WIDTH

# The time to closest approach counts up to this multiple of its limit: evidence is gathered while that time runs down.
_WATCHED_TTC = 1.5
# Off the road an object's width counts by its component across the direction of motion, 1.5 times for our own width; at
# least this share of it counts everywhere: no object is a line.
_WITH_OURS, _LEAST_ACROSS = 1.5, 0.1
# We reach as far before the lens as beside it, so that our part of the miss distance is whole up to 60 deg off our way.
_FULL_UNTIL = 2.0
# A driver steers by about this acceleration, heights of the camera / s^2 (0.2 m/s^2): four seconds ahead nobody knows
# whether the road turns before what stands there. Whoever drives before us follows the road as we do.
_STEERING_HZ2 = 0.15
# A smaller turn until the closest approach counts as straight, rad.
_LEAST_TURN_RAD = 0.01
# Divisors are at least this; a shorter miss vector, in units of depth, has no direction.
_TINY = 1e-9


@dataclass(frozen=True)
class Course:
    """The course of an object, from one frame.

    probability : that it is a collision course: the object approaches, reaches us within `_WATCHED_TTC` times the limit
        and passes nearer than the limit of the miss distance.
    is_soon : whether it is reached within the limit itself.
    """

    probability: float
    is_soon: bool = False


@dataclass(frozen=True)
class Viewpoint:
    """What courses are judged from: the camera and what is known of its own motion.

    on_ground : we are a road vehicle. It has the usual width and reaches from the camera down to the road: an object
        that passes below the camera hits it, and a lorry need not pass at a distance of its length.
    at_rest : the camera is mounted somewhere: it is a point, that only an object itself can hit.
    bend : our own turn; None: we go straight. Objects on our road turn with it.
    """

    camera: Camera
    on_ground: bool = False
    at_rest: bool = False
    bend: OwnBend | None = None


def has_course(row: ClusterRow) -> bool:
    """Whether it is known where an object goes."""
    has_state = row.state_abc_hz is not None and row.state_cov is not None
    return has_state and row.motion_state != MotionState.unknown


def course_of(row: ClusterRow, view: Viewpoint, config: EventsConfig) -> Course | None:
    """Whether an object is on collision course; None where that is open, or no road tells whether it is in our way.

    The miss distance is judged in widths of the object: a fixed ``miss_s`` would mean 6 m at 20 m/s and 0.6 m at 2 m/s.
    """
    abc_hz, cov = row.state_abc_hz, row.state_cov
    if not has_course(row):
        return None
    assert abc_hz is not None
    assert cov is not None
    tcpa_s = float(row.times.tcpa_s[0])
    if row.motion_state not in APPROACHING or not tcpa_s > 0.0:
        return Course(0.0)
    is_standing, is_road_found = row.motion_id == SCENE_MOTION, view.bend is not None and view.bend.road is not None
    if view.on_ground and is_standing and not is_road_found:
        # Without a road, a bridge or trees look like a wall ahead.
        return None
    *off_widths, sigma_widths = _miss_widths(row, abc_hz, cov, view).tolist()
    miss_widths, sigma_widths = math.hypot(*off_widths), max(sigma_widths, _TINY)
    sides = (config.max_miss_widths - miss_widths, -config.max_miss_widths - miss_widths)
    hits = float(ndtr(sides[0] / sigma_widths) - ndtr(sides[1] / sigma_widths))
    later_hz = 1.0 / tcpa_s - 1.0 / (_WATCHED_TTC * config.max_ttc_s)
    in_time = float(ndtr(later_hz / max(math.sqrt(cov[2, 2]), _TINY)))
    is_soon = tcpa_s <= config.max_ttc_s
    return Course(approach_probability(abc_hz, cov) * hits * in_time, is_soon)


def approach_probability(abc_hz: Floats | None, cov: Floats | None) -> float:
    """Probability that the depth of an object decreases, by its state ``(3,)`` and covariance (3, 3); 0 without."""
    if abc_hz is None or cov is None:
        return 0.0
    return float(ndtr(-float(abc_hz[2]) / max(math.sqrt(cov[2, 2]), _TINY)))


def _miss_widths(row: ClusterRow, abc_hz: Floats, cov: Floats, view: Viewpoint) -> Floats:
    """Miss vector of an object in widths, and the standard deviation of its length: ``(4,)``, vector first.

    Speed cancels: both are lengths in units of depth, over the width. The sides are taken at the height of the
    reference point, which may itself be at one side (the nearer end of a crossing lorry). On the road only the front
    face counts: the rest follows it.
    """
    assert row.ref_px is not None
    bend, on_ground, tcpa_s = view.bend, view.on_ground, float(row.times.tcpa_s[0])
    is_standing = row.motion_id == SCENE_MOTION
    box_px = row.front_px if on_ground and row.front_px is not None else row.box_px
    (x0_px, top_px, x1_px, bottom_px), y_px = box_px, row.ref_px[1]
    x_px = 0.5 * (x0_px + x1_px)
    outline_px = ((x_px, y_px), (x0_px, y_px), (x1_px, y_px), (x_px, top_px), (x_px, bottom_px))
    rays = rays_from_pixels(view.camera, np.array(outline_px))
    steered = 0.5 * _STEERING_HZ2 * tcpa_s**2 if on_ground and is_standing else 0.0
    straight_on = _missing(rays, abc_hz, cov, view, steered)
    if bend is None or not on_ground or not abs(bend.turn_rad_s) * tcpa_s > _LEAST_TURN_RAD:
        return straight_on
    # Objects of the scene's motion stand still on the ground.
    speed_hz = float(np.linalg.norm(abc_hz)) if is_standing else bend.speed_hz(rays[4, :2])
    if speed_hz is None:
        return straight_on
    along = _along_bend(rays, abc_hz, cov, bend, speed_hz, view, steered)
    unsure = BEND_ENDS * (along[:3] - straight_on[:3])
    along[3] = math.sqrt(along[3] ** 2 + float(unsure @ unsure))
    return along


def _along_bend(
    rays: Floats, abc_hz: Floats, cov: Floats, bend: OwnBend, speed_hz: float, view: Viewpoint, steered: float
) -> Floats:
    """As `_missing`, in coordinates along our bend; ``speed_hz`` is our speed over the depth of the object."""
    found = straightened(rays[0], abc_hz, bend.heading, speed_hz, bend.turn_rad_s)
    depth = float(found.place[2])
    if not depth > _TINY:
        return _missing(rays, abc_hz, cov, view, steered)
    place = np.column_stack([found.place[0] + rays[:, 0] - rays[0, 0], rays[:, 1], np.full(len(rays), depth)]) / depth
    cov = found.jacobian @ cov @ found.jacobian.T / depth**2
    return _missing(place, found.velocity / depth, cov, view, steered)


def _missing(rays: Floats, abc_hz: Floats, cov: Floats, view: Viewpoint, steered: float) -> Floats:
    """As `_miss_widths`, from the ``rays (5, 3)`` of its box: middle, left, right, top, bottom.

    ``steered`` is how far we may get aside by steering, as a standard deviation in heights of the camera.

    The closest point within the height of the box counts: a pedestrian's feet pass below the camera by three times his
    width. A side at 90 deg or more off the axis (fisheye) does not meet the plane z = 1: it is infinitely far.
    """
    speed = float(np.linalg.norm(abc_hz))
    way, place = abc_hz / speed, rays[0].copy()
    left, right, top, bottom = float(rays[1, 0]), float(rays[2, 0]), float(rays[3, 1]), float(rays[4, 1])
    # Down, normal to the direction of motion; zero for vertical motion.
    down = np.array([0.0, 1.0, 0.0]) - way[1] * way
    down2 = float(down @ down)
    if down2 >= _TINY and np.isfinite(top) and np.isfinite(bottom):
        # The height within the box at which it passes nearest.
        nearest = place[1] - down @ place / down2
        place[1] = min(max(nearest, min(top, place[1])), max(bottom, place[1]))
    ahead = float(way @ place)
    off = place - ahead * way
    if view.on_ground and off[1] > 0.0 and down2 >= _TINY:
        # Our own body reaches from the camera down to the road.
        off -= down @ off / down2 * down
    miss = float(np.linalg.norm(off))
    sides = off[None] / miss if miss > _TINY else tangent_basis(way).T
    sigma = math.sqrt(max(float(np.max(np.einsum("si,ij,sj->s", sides, cov, sides))), 0.0))
    width = _width(way, left, right, bottom, view)
    height = _height_of_camera(way, bottom)
    aside = steered * height if math.isfinite(height) and height > 0.0 else 0.0
    return np.append(off, math.hypot(abs(ahead) / speed * sigma, aside)) / width


def _width(way: Floats, left: float, right: float, bottom: float, view: Viewpoint) -> float:
    """Miss distance up to which an object with direction of motion ``way (3,)`` hits us, in units of depth.

    That is half of its width and half of ours: on the road known by the height of the camera, elsewhere as wide as its
    own, and none of a camera at rest. A width counts by its component across the direction of motion: a crossing bus
    shows its length, and our front meets nobody while we stand.
    """
    along, level = abs(float(way[2])), math.hypot(way[0], way[2])
    ahead = along / level if level > 0.0 else 1.0
    seen = (right if math.isfinite(right) else math.inf) - (left if math.isfinite(left) else -math.inf)
    seen = max(seen, 1.0 / view.camera.fx_px)
    height = _height_of_camera(way, bottom) if view.on_ground else math.nan
    half = 0.5 * min(ahead + _LEAST_ACROSS, 1.0) * seen
    if view.at_rest:
        return half
    if not math.isfinite(height):
        return min(_WITH_OURS * ahead + _LEAST_ACROSS, 1.0) * seen
    return half + OWN_HALF_WIDTH * max(height, 0.0) * min(_FULL_UNTIL * ahead, 1.0)


def _height_of_camera(way: Floats, bottom: float) -> float:
    """Height of the camera above the foot of an object at ``bottom``, in units of its depth; it moves on the level.

    NaN where its depth does not change.
    """
    return bottom - float(way[1]) / float(way[2]) if abs(way[2]) >= _TINY else math.nan
