"""Which objects are on collision course: near, soon, and surely."""

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
"""From the number of a cluster to how its depth changes; None where that is not known."""

# A warning that stands goes on up to these multiples of the thresholds.
_KEEP_TTC, _KEEP_MISS = 1.25, 1.5
# What is seen of a thing counts by its part across the way that it goes, and half as much again for our own width; and
# by this part in any case, since nothing is a line.
_WITH_OURS, _LEAST_ACROSS = 1.5, 0.1
# What closes in ever faster is told at 99 % (one side), beyond what looking for when that began adds
# (`geometry.estimation.closing.fit_braking`); who brakes goes on with it for about so long, s.
_SIGMAS_99, _SIGMAS_OF_CHOICE, _LASTING_S = 2.326, 0.35, 1.0
# The time that this leaves has to be short by its best estimate and a standard deviation: it does not run down as other
# times do, since brakes are let go.
_SOON_SIGMAS = 1.0
# Half of our own width, and that with some room beside it, in heights of the camera above the road: cars, vans and
# lorries alike.
_HALF_HEIGHTS, _ROOM_HEIGHTS = 0.6, 1.0
# A bend that turns us by less than this until the closest approach is none, rad.
_LEAST_TURN_RAD = 0.01
# A miss distance, in units of depth, without a side.
_TINY = 1e-9


@dataclass(frozen=True)
class Course:
    """What may be on collision course: surely, and then by how many ``sigmas``; or that is open.

    ``miss_widths`` is the best estimate of where it passes us, as seen from the camera: in widths, as the limit is.
    """

    is_sure: bool
    sigmas: float = 0.0
    miss_widths: tuple[float, float, float] = (math.nan, math.nan, math.nan)


OPEN = Course(is_sure=False)


def unknown_closing(_: int) -> None:
    """Nothing is known of how the depth of any cluster changes."""


@dataclass(frozen=True)
class Viewpoint:
    """From where the objects of a frame are seen, and what else is known of them.

    ``on_ground``: we drive on a road. What is on it is met by a vehicle of usual width that reaches from the camera
    down to the road: what passes below the camera hits it, and a long lorry need not pass as far off as it is long.
    ``bend``: how we drive, if we turn: who goes along our road turns as it does. ``closing_of`` tells how the depth of
    a cluster changes; asked where all depends on that, since it takes its time.
    """

    camera: Camera
    on_ground: bool = False
    bend: OwnBend | None = None
    closing_of: ClosingOf = unknown_closing


def course_of(
    row: ClusterRow, view: Viewpoint, config: EventsConfig, *, is_warned: bool = False, is_watched: bool = False
) -> Course | None:
    """Whether an object comes close, soon and surely; None where it does not, as far as is known.

    Surely is at the configured confidence, one side each. The miss distance is judged in widths of the object from the
    same state: a fixed ``miss_s`` would mean 6 m at 20 m/s and 0.6 m at 2 m/s. A car that brakes hard has no sure time,
    but comes nearer surely, and straight at us.

    Only of such a car, more sigmas than asked for are told: its sizes over all the time that is looked at say that it
    brakes. The state of anything else is of one moment, in which a bus on a bend heads at us as surely as can be.

    Parameters
    ----------
    is_warned, is_watched : warned of, it may come a little later and miss by a little more; to be watched, only later.
    """
    cov = row.state_cov
    if row.state_abc_hz is None or cov is None or row.motion_state == MotionState.unknown:
        return OPEN
    if row.motion_state not in APPROACHING or not row.times.tcpa_s[0] > 0.0:
        return None
    is_standing, is_road_found = row.motion_id == SCENE_MOTION, view.bend is not None and view.bend.road_hz is not None
    if is_standing and view.on_ground and not is_road_found and not is_warned:
        # A bridge, trees beside the road or paint on it look like a wall as long as nobody knows where the road is.
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
    # The miss distance is as many standard deviations below the limit.
    straight_sigmas = (max_miss_widths - at_best) / max(sigma_widths, _TINY)
    return Course(True, max(min(nearer_sigmas, straight_sigmas, brakes_sigmas), asked), tuple(off_widths))


@lru_cache(maxsize=8)
def _sigmas_of(confidence: float) -> float:
    """Standard deviations of a one-sided confidence."""
    return float(ndtri(confidence))


def _brakes_sigmas(closing: Closing | None, max_ttc_s: float) -> float | None:
    """By how many standard deviations a thing closes in ever faster that is reached so soon; None for anything else.

    At constant velocity a car that has just begun to brake seems far away for long.
    """
    if closing is None:
        return None
    sigmas = -closing.acceleration_hz2 / closing.acceleration_sigma_hz2 - _SIGMAS_OF_CHOICE
    left, left_sigma = closing.left_after(max_ttc_s, _LASTING_S)
    return sigmas if sigmas > _SIGMAS_99 and left + _SOON_SIGMAS * left_sigma <= 0.0 else None


def surety(abc_hz: Floats | None, cov: Floats | None) -> float:
    """Probability that an object comes nearer in depth, by its state now; 0 without one."""
    if abc_hz is None or cov is None:
        return 0.0
    sigma_hz = max(math.sqrt(cov[2, 2]), _TINY)
    return float(ndtr(-float(abc_hz[2]) / sigma_hz))


def _miss_widths(row: ClusterRow, abc_hz: Floats, cov: Floats, view: Viewpoint) -> Floats:
    """Where an object passes us, over its width: (4,), best estimate (3,) and standard deviation of its length.

    Both in units of depth: how fast the object comes has no part in it, only where to. Where its sides are is seen at
    the height of the reference point, which itself may be at either side: of a lorry that crosses, the end that is
    nearer. On the road, what lies behind its front follows that.
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
    # What moves as the scene does stands still.
    speed_hz = float(np.linalg.norm(abc_hz)) if row.motion_id == SCENE_MOTION else bend.speed_hz(rays[4, :2])
    if speed_hz is None:
        return straight_on
    along = _along_bend(rays, abc_hz, cov, bend, speed_hz, view.camera)
    unsure = BEND_ENDS * (along[:3] - straight_on[:3])
    along[3] = math.sqrt(along[3] ** 2 + float(unsure @ unsure))
    return along


def _along_bend(rays: Floats, abc_hz: Floats, cov: Floats, bend: OwnBend, speed_hz: float, camera: Camera) -> Floats:
    """The same in coordinates along our bend, by our speed over the depth of the object."""
    found = straightened(rays[0], abc_hz, bend.heading, speed_hz, bend.turn_rad_s)
    depth = float(found.place[2])
    if not depth > _TINY:
        return _missing(rays, abc_hz, cov, True, camera)
    place = np.column_stack([found.place[0] + rays[:, 0] - rays[0, 0], rays[:, 1], np.full(len(rays), depth)]) / depth
    cov = found.jacobian @ cov @ found.jacobian.T / depth**2
    return _missing(place, found.velocity / depth, cov, True, camera)


def _missing(rays: Floats, abc_hz: Floats, cov: Floats, on_ground: bool, camera: Camera) -> Floats:
    """Where an object passes us, over its width, and the standard deviation of that: (4,).

    By the rays (5, 3) of its box: middle, left, right, top, bottom. A thing is as high as it is seen: of somebody who
    walks before a car the feet pass below the camera by three times the width. A side at 90 deg or more off the axis
    (of a fisheye) is nowhere in the plane z = 1: infinitely far.
    """
    speed = float(np.linalg.norm(abc_hz))
    way, place = abc_hz / speed, rays[0].copy()
    left, right, top, bottom = float(rays[1, 0]), float(rays[2, 0]), float(rays[3, 1]), float(rays[4, 1])
    # Down across the way that it goes; not that of what goes straight down.
    down = np.array([0.0, 1.0, 0.0]) - way[1] * way
    down2 = float(down @ down)
    if down2 >= _TINY and np.isfinite(top) and np.isfinite(bottom):
        # Where the thing passes nearest, up or down within the box.
        nearest = place[1] - down @ place / down2
        place[1] = min(max(nearest, min(top, place[1])), max(bottom, place[1]))
    ahead = float(way @ place)
    off = place - ahead * way
    if on_ground and off[1] > 0.0 and down2 >= _TINY:
        # Our own car is below the camera.
        off -= down @ off / down2 * down
    miss = float(np.linalg.norm(off))
    sides = off[None] / miss if miss > _TINY else tangent_basis(way).T
    sigma = math.sqrt(max(float(np.max(np.einsum("si,ij,sj->s", sides, cov, sides))), 0.0))
    width = _width(way, left, right, bottom, on_ground, camera)
    return np.append(off, abs(ahead) / speed * sigma) / width


def _width(way: Floats, left: float, right: float, bottom: float, on_ground: bool, camera: Camera) -> float:
    """Width of an object that goes a ``way (3,)``, in units of depth, with what of our own counts beside it."""
    # Across its way, with some of our own: a bus that crosses shows its length.
    along, level = abs(float(way[2])), math.hypot(way[0], way[2])
    across = min(_WITH_OURS * along / level + _LEAST_ACROSS, 1.0) if level > 0.0 else 1.0
    seen = (right if math.isfinite(right) else math.inf) - (left if math.isfinite(left) else -math.inf)
    width = across * max(seen, 1.0 / camera.fx_px)
    # The height of the camera above the foot of what moves level to us, in units of its depth.
    height = bottom - way[1] / way[2] if on_ground and along >= _TINY else math.nan
    if not math.isfinite(height):
        return width
    height = max(height, 0.0)
    # Somebody who walks is narrower than half of our car, which hits him all the same: with its front, of which less
    # lies across the way of who crosses it, and nothing where we stand.
    front = _HALF_HEIGHTS * height * along / level
    return min(max(width, 0.5 * width + front), 0.5 * width + _ROOM_HEIGHTS * height)
