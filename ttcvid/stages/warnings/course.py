"""Which objects are on collision course: short time, small miss distance, sufficient confidence."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import ndtr, ndtri

from ttcvid.config import EventsConfig
from ttcvid.geometry.along_bend import BEND_ENDS, straightened
from ttcvid.geometry.camera.pinhole import rays_from_pixels
from ttcvid.geometry.estimation.closing import Closing
from ttcvid.geometry.rotation import tangent_basis
from ttcvid.model import APPROACHING, SCENE_MOTION, Camera, ClusterRow, Floats, MotionState
from ttcvid.stages.segmentation.own_turn import OwnBend

ClosingOf = Callable[[int], Closing | None]
"""From a ``cluster_id`` to how the depth of the object changes; None where that is not known."""

# Hysteresis: an active warning goes on up to these multiples of the thresholds.
_KEEP_TTC, _KEEP_MISS = 1.25, 1.5
# Of an object's visible width its component across the direction of motion counts, 1.5 times for our own width, and
# at least this share of the width: no object is a line.
_WITH_OURS, _LEAST_ACROSS = 1.5, 0.1
# Braking is significant at 99 % (one side), beyond what the search for its beginning adds to the statistic
# (`geometry.estimation.closing.fit_braking`); it is extrapolated for this long, s.
_SIGMAS_99, _SIGMAS_OF_CHOICE, _LASTING_S = 2.326, 0.35, 1.0
# The time left under braking has to be short by one standard deviation: braking may stop, so that this time need not
# run down.
_SOON_SIGMAS = 1.0
# Half of our own width, without and with clearance, in heights of the camera above the road: alike for cars, vans and
# lorries.
_HALF_HEIGHTS, _ROOM_HEIGHTS = 0.6, 1.0
# A smaller turn until the closest approach counts as straight, rad.
_LEAST_TURN_RAD = 0.01
# Divisors are at least this; a shorter miss vector, in units of depth, has no direction.
_TINY = 1e-9


@dataclass(frozen=True)
class Course:
    """The course of an object that may be on collision course.

    Attributes
    ----------
    is_sure : whether it is on collision course at the configured confidence; else that is open.
    sigmas : by how many standard deviations, where it is sure.
    miss_widths : best estimate of the vector from the camera to the closest approach, camera frame, in widths of the
        object; NaN where it is open.
    """

    is_sure: bool
    sigmas: float = 0.0
    miss_widths: tuple[float, float, float] = (math.nan, math.nan, math.nan)


OPEN = Course(is_sure=False)


def unknown_closing(_: int) -> None:
    """The `ClosingOf` that knows of no cluster."""


@dataclass(frozen=True)
class Viewpoint:
    """What courses are judged from: the camera and what is known of its own motion.

    Attributes
    ----------
    on_ground : we are a road vehicle. It has the usual width and reaches from the camera down to the road: an object
        that passes below the camera hits it, and a lorry need not pass at a distance of its length.
    bend : our own turn; None: we go straight. Objects on our road turn with it.
    closing_of : how the depth of a cluster changes. It is slow, and called only where the result depends on it.
    """

    camera: Camera
    on_ground: bool = False
    bend: OwnBend | None = None
    closing_of: ClosingOf = unknown_closing


def course_of(
    row: ClusterRow, view: Viewpoint, config: EventsConfig, *, is_warned: bool = False, is_watched: bool = False
) -> Course | None:
    """Whether an object is on collision course; None where it is not, as far as is known.

    It is where it approaches, and its time of closest approach and its miss distance are below the limits, each at the
    configured one-sided confidence. The miss distance is judged in widths of the object: a fixed ``miss_s`` would mean
    6 m at 20 m/s and 0.6 m at 2 m/s. An object that brakes hard (`_brakes_sigmas`) counts by the time under braking.

    Only for a braking object ``Course.sigmas`` may exceed the confidence asked for: its braking is seen over the whole
    window. Any other state holds for one moment, in which a bus on a bend may head at us with great certainty.

    Parameters
    ----------
    row : the object, with state and covariance.
    is_warned : the object has an active warning: both limits are looser.
    is_watched : the condition of the watch: only the limit of the time is looser.
    """
    cov = row.state_cov
    if row.state_abc_hz is None or cov is None or row.motion_state == MotionState.unknown:
        return OPEN
    if row.motion_state not in APPROACHING or not row.times.tcpa_s[0] > 0.0:
        return None
    is_standing, is_road_found = row.motion_id == SCENE_MOTION, view.bend is not None and view.bend.road_hz is not None
    if is_standing and view.on_ground and not is_road_found and not is_warned:
        # Without a ground plane, a bridge, roadside trees or road markings look like a wall ahead.
        return OPEN
    asked = _sigmas_of(config.confidence)
    max_miss_widths = config.max_miss_widths * (_KEEP_MISS if is_warned else 1.0)
    *off_widths, sigma_widths = _miss_widths(row, row.state_abc_hz, cov, view).tolist()
    at_best = math.hypot(*off_widths)
    at_asked = at_best + asked * sigma_widths
    if min(at_best, at_asked) > max_miss_widths:
        return None
    is_sure = at_asked <= max_miss_widths and surety(row.state_abc_hz, cov) > config.confidence
    if row.times.tcpa_s[0] <= config.max_ttc_s * (_KEEP_TTC if is_warned or is_watched else 1.0):
        return Course(True, asked, tuple(off_widths)) if is_sure else OPEN
    closing = view.closing_of(row.cluster_id) if is_sure else None
    brakes_sigmas = _brakes_sigmas(closing, config.max_ttc_s * (_KEEP_TTC if is_warned else 1.0))
    if brakes_sigmas is None:
        return None
    nearer_sigmas = -float(row.state_abc_hz[2]) / max(math.sqrt(cov[2, 2]), _TINY)
    # The miss distance is this many standard deviations below its limit.
    straight_sigmas = (max_miss_widths - at_best) / max(sigma_widths, _TINY)
    return Course(True, max(min(nearer_sigmas, straight_sigmas, brakes_sigmas), asked), tuple(off_widths))


@lru_cache(maxsize=8)
def _sigmas_of(confidence: float) -> float:
    """Standard deviations of a one-sided confidence."""
    return float(ndtri(confidence))


def _brakes_sigmas(closing: Closing | None, max_ttc_s: float) -> float | None:
    """Significance of an object's braking, if that makes its time shorter than ``max_ttc_s``; else None.

    At constant velocity, an object that has just begun to brake seems to have much time left.
    """
    if closing is None:
        return None
    sigmas = -closing.acceleration_hz2 / closing.acceleration_sigma_hz2 - _SIGMAS_OF_CHOICE
    left, left_sigma = closing.left_after(max_ttc_s, _LASTING_S)
    return sigmas if sigmas > _SIGMAS_99 and left + _SOON_SIGMAS * left_sigma <= 0.0 else None


def surety(abc_hz: Floats | None, cov: Floats | None) -> float:
    """Probability that the depth of an object decreases, by its state ``(3,)`` and covariance (3, 3); 0 without."""
    if abc_hz is None or cov is None:
        return 0.0
    sigma_hz = max(math.sqrt(cov[2, 2]), _TINY)
    return float(ndtr(-float(abc_hz[2]) / sigma_hz))


def _miss_widths(row: ClusterRow, abc_hz: Floats, cov: Floats, view: Viewpoint) -> Floats:
    """Miss vector of an object in widths, and the standard deviation of its length: ``(4,)``, vector first.

    Speed cancels: both are lengths in units of depth, over the width. The sides are taken at the height of the
    reference point, which may itself be at one side (the nearer end of a crossing lorry). On the road only the front
    face counts: the rest follows it.
    """
    assert row.ref_px is not None
    bend, on_ground = view.bend, view.on_ground
    box_px = row.front_px if on_ground and row.front_px is not None else row.box_px
    (x0_px, top_px, x1_px, bottom_px), y_px = box_px, row.ref_px[1]
    x_px = 0.5 * (x0_px + x1_px)
    outline_px = ((x_px, y_px), (x0_px, y_px), (x1_px, y_px), (x_px, top_px), (x_px, bottom_px))
    rays = rays_from_pixels(view.camera, np.array(outline_px))
    straight_on = _missing(rays, abc_hz, cov, on_ground, view.camera)
    if bend is None or not on_ground or not abs(bend.turn_rad_s) * float(row.times.tcpa_s[0]) > _LEAST_TURN_RAD:
        return straight_on
    # Objects of the scene's motion stand still on the ground.
    speed_hz = float(np.linalg.norm(abc_hz)) if row.motion_id == SCENE_MOTION else bend.speed_hz(rays[4, :2])
    if speed_hz is None:
        return straight_on
    along = _along_bend(rays, abc_hz, cov, bend, speed_hz, view.camera)
    unsure = BEND_ENDS * (along[:3] - straight_on[:3])
    along[3] = math.sqrt(along[3] ** 2 + float(unsure @ unsure))
    return along


def _along_bend(rays: Floats, abc_hz: Floats, cov: Floats, bend: OwnBend, speed_hz: float, camera: Camera) -> Floats:
    """As `_missing`, in coordinates along our bend; ``speed_hz`` is our speed over the depth of the object."""
    found = straightened(rays[0], abc_hz, bend.heading, speed_hz, bend.turn_rad_s)
    depth = float(found.place[2])
    if not depth > _TINY:
        return _missing(rays, abc_hz, cov, True, camera)
    place = np.column_stack([found.place[0] + rays[:, 0] - rays[0, 0], rays[:, 1], np.full(len(rays), depth)]) / depth
    cov = found.jacobian @ cov @ found.jacobian.T / depth**2
    return _missing(place, found.velocity / depth, cov, True, camera)


def _missing(rays: Floats, abc_hz: Floats, cov: Floats, on_ground: bool, camera: Camera) -> Floats:
    """As `_miss_widths`, from the ``rays (5, 3)`` of its box: middle, left, right, top, bottom.

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
    if on_ground and off[1] > 0.0 and down2 >= _TINY:
        # Our own body reaches from the camera down to the road.
        off -= down @ off / down2 * down
    miss = float(np.linalg.norm(off))
    sides = off[None] / miss if miss > _TINY else tangent_basis(way).T
    sigma = math.sqrt(max(float(np.max(np.einsum("si,ij,sj->s", sides, cov, sides))), 0.0))
    width = _width(way, left, right, bottom, on_ground, camera)
    return np.append(off, abs(ahead) / speed * sigma) / width


def _width(way: Floats, left: float, right: float, bottom: float, on_ground: bool, camera: Camera) -> float:
    """Width of an object with direction of motion ``way (3,)``, in units of depth, with our own share of it."""
    # Across the direction of motion, with our own share: a crossing bus shows its length.
    along, level = abs(float(way[2])), math.hypot(way[0], way[2])
    across = min(_WITH_OURS * along / level + _LEAST_ACROSS, 1.0) if level > 0.0 else 1.0
    seen = (right if math.isfinite(right) else math.inf) - (left if math.isfinite(left) else -math.inf)
    width = across * max(seen, 1.0 / camera.fx_px)
    # Height of the camera above the object's foot, in units of depth, for a horizontal motion.
    height = bottom - way[1] / way[2] if on_ground and along >= _TINY else math.nan
    if not math.isfinite(height):
        return width
    height = max(height, 0.0)
    # A pedestrian is narrower than half of our car, whose front hits him: its width counts by its component across the
    # relative motion, which is zero where we stand.
    front = _HALF_HEIGHTS * height * along / level
    return min(max(width, 0.5 * width + front), 0.5 * width + _ROOM_HEIGHTS * height)
