"""What could be hit, in metres and in level axes: upright boxes with places, velocities and their uncertainty.

Level axes: right, down (along gravity), ahead (the horizontal direction of own motion): the camera's axes x, y, z for a
camera that looks where it goes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise

import numpy as np

from ttcvid.model import Bools, Floats, Ints
from ttcvid.studies.collision_map.contacts import AHEAD, DOWN, RIGHT


@dataclass(frozen=True)
class Hazards:
    """N boxes, the parts of objects.

    Attributes
    ----------
    position_m, velocity_m_s : ``(N, 3)`` centre P of each box and its velocity V relative to us, now.
    half_size_m : ``(N, 3)`` half the box's width, height and length, along its own right, down and ahead.
    yaw_rad : ``(N,)`` turn of the box about down, from ahead towards the right.
    covariance : ``(N, 6, 6)`` of (P, V) in m and m/s; zeros: known exactly.
    turn_rad_s : ``(N,)`` how fast its course over the ground turns to the right, and the box with it.
    acceleration_m_s2 : ``(N,)`` of its speed over the ground, which does not fall below zero.
    object_index : ``(N,)`` ascending; which of ``names`` a box belongs to.
    alternative : ``(N,)`` ascending within an object. Boxes of one alternative exist together; alternatives exclude
        each other.
    weight : ``(N,)`` probability of the box's alternative; those of an object's alternatives add up to 1.
    names : Of the objects, as pictures and tables show them.
    cluster_ids : Of the objects; 0 is the static scene.
    """

    position_m: Floats
    velocity_m_s: Floats
    half_size_m: Floats
    yaw_rad: Floats
    covariance: Floats
    turn_rad_s: Floats
    acceleration_m_s2: Floats
    object_index: Ints
    alternative: Ints
    weight: Floats
    names: tuple[str, ...]
    cluster_ids: tuple[int, ...]

    def __len__(self) -> int:
        return len(self.yaw_rad)

    def __post_init__(self) -> None:
        n = len(self.yaw_rad)
        shapes = {"position_m": (n, 3), "velocity_m_s": (n, 3), "half_size_m": (n, 3), "covariance": (n, 6, 6)}
        shapes |= dict.fromkeys(("turn_rad_s", "acceleration_m_s2", "object_index", "alternative", "weight"), (n,))
        for name, shape in shapes.items():
            actual = getattr(self, name).shape
            if actual != shape:
                raise ValueError(f"{name}: expected shape {shape}, got {actual}")

    @property
    def is_exact(self) -> bool:
        """Whether places and velocities are all known exactly."""
        return not self.covariance.any()

    @property
    def is_straight(self) -> bool:
        """Whether all keep their velocities."""
        return not (self.turn_rad_s.any() or self.acceleration_m_s2.any())

    def within_reach(self, own_reach_m: float, fastest_change_m_s: float, horizon_s: float) -> Hazards:
        """Only the boxes that can come within ``own_reach_m`` of us until ``horizon_s``, with three sigmas to spare."""
        variance = self.covariance[:, :3, :3] + horizon_s**2 * self.covariance[:, 3:, 3:]
        spare_m = 3.0 * np.sqrt(np.trace(variance, axis1=1, axis2=2))
        reach_m = own_reach_m + np.linalg.norm(self.half_size_m, axis=1) + spare_m
        travel_m = (np.linalg.norm(self.velocity_m_s, axis=1) + fastest_change_m_s) * horizon_s
        travel_m += 0.5 * np.abs(self.acceleration_m_s2) * horizon_s**2
        return self.take(np.linalg.norm(self.position_m, axis=1) <= reach_m + travel_m)

    def without(self, names: Sequence[str]) -> Hazards:
        """The boxes of all other objects; the list of objects stays."""
        return self.take(~np.isin(self.object_index, [self.names.index(name) for name in names]))

    def take(self, mask: Bools) -> Hazards:
        """Some of the boxes; the list of objects stays."""
        return replace(self, **{name: getattr(self, name)[mask] for name in _ARRAYS})

    def along(self, times_s: Floats, own_velocity_m_s: Floats) -> Iterator[Hazards]:
        """For each pair of neighbouring times, the boxes at its start, with their mean velocities until its end.

        Places and velocities stay relative to one who keeps ``own_velocity_m_s (3,)``, from which the velocities over
        the ground follow.
        """
        ground = self.velocity_m_s + own_velocity_m_s
        speed = np.hypot(ground[:, RIGHT], ground[:, AHEAD])
        position = self.position_m
        for start_s, end_s in pairwise(times_s.tolist()):
            way_m = _way_m(end_s, speed, self.acceleration_m_s2) - _way_m(start_s, speed, self.acceleration_m_s2)
            change = np.divide(way_m, speed * (end_s - start_s), out=np.ones_like(speed), where=speed > 0.0)
            turn_rad = 0.5 * self.turn_rad_s * (start_s + end_s)
            velocity = turned_right(change[:, None] * ground, turn_rad) - own_velocity_m_s
            yield replace(self, position_m=position, velocity_m_s=velocity, yaw_rad=self.yaw_rad + turn_rad)
            position = position + (end_s - start_s) * velocity


_ARRAYS = tuple(field.name for field in fields(Hazards) if field.name not in ("names", "cluster_ids"))


@dataclass(frozen=True)
class OwnBody:
    """Our own outline around the camera: an upright box or, with ``is_round``, an ellipsoid.

    ``below_m`` is how far its middle lies below the camera: a car stands on the road, wherever its camera looks from.
    """

    width_m: float
    length_m: float
    height_m: float
    is_round: bool = False
    below_m: float = 0.0

    @property
    def reach_m(self) -> float:
        """Distance within which its farthest point is from the camera."""
        return 0.5 * float(np.linalg.norm([self.width_m, self.length_m, self.height_m])) + abs(self.below_m)

    @property
    def half_m(self) -> Floats:
        """Half its width, height and length ``(3,)``, in level axes."""
        return 0.5 * np.array([self.width_m, self.height_m, self.length_m])

    @property
    def middle_m(self) -> Floats:
        """Its middle ``(3,)``, in level axes."""
        return np.array([0.0, self.below_m, 0.0])

    def standing_on_road(self, camera_height_m: float) -> OwnBody:
        """The same outline with its lower side on a road this far under the camera."""
        return replace(self, below_m=camera_height_m - 0.5 * self.height_m)


@dataclass(frozen=True)
class Situation:
    """A moment: what could be hit, our outline, our velocity ``(3,)`` in level axes, and how fast we turn to the right.

    What turns is assumed to go on turning.
    """

    hazards: Hazards
    own: OwnBody
    own_velocity_m_s: Floats
    own_turn_rad_s: float = 0.0

    @property
    def own_speed_m_s(self) -> float:
        """Our speed over the ground."""
        return float(np.hypot(self.own_velocity_m_s[RIGHT], self.own_velocity_m_s[AHEAD]))


def one_object(
    name: str,
    cluster_id: int,
    position_m: Floats,
    velocity_m_s: Floats,
    half_size_m: Floats,
    yaw_rad: float = 0.0,
    covariance: Floats | None = None,
) -> Hazards:
    """An object of N boxes ``(N, 3)``, all turned alike and all there together, on a straight steady way.

    Without a ``covariance (N, 6, 6)`` it is exact.
    """
    n = len(position_m)
    return Hazards(
        position_m,
        velocity_m_s,
        half_size_m,
        np.full(n, yaw_rad),
        np.zeros((n, 6, 6)) if covariance is None else covariance,
        np.zeros(n),
        np.zeros(n),
        np.zeros(n, np.int64),
        np.zeros(n, np.int64),
        np.ones(n),
        (name,),
        (cluster_id,),
    )


def turned_right(vectors: Floats, angle_rad: Floats | float) -> Floats:
    """Vectors ``(N, 3)`` in level axes, turned about down, from ahead towards the right."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    right, ahead = vectors[:, RIGHT], vectors[:, AHEAD]
    return np.stack([c * right + s * ahead, vectors[:, DOWN], c * ahead - s * right], axis=1)


def joined(parts: Sequence[Hazards]) -> Hazards:
    """Several sets of hazards as one; their objects stay apart."""
    if not parts:
        return no_hazards()
    first = np.cumsum([0, *(len(part.names) for part in parts)])[:-1]
    together = {name: np.concatenate([getattr(part, name) for part in parts]) for name in _ARRAYS}
    together["object_index"] = np.concatenate([part.object_index + k for part, k in zip(parts, first, strict=True)])
    return Hazards(
        **together,
        names=tuple(name for part in parts for name in part.names),
        cluster_ids=tuple(number for part in parts for number in part.cluster_ids),
    )


def no_hazards() -> Hazards:
    """An empty world."""
    vectors, numbers, counts = np.empty((0, 3)), np.empty(0), np.empty(0, np.int64)
    return Hazards(
        vectors, vectors, vectors, numbers, np.empty((0, 6, 6)), numbers, numbers, counts, counts, numbers, (), ()
    )


def _way_m(t_s: float, speed_m_s: Floats, acceleration_m_s2: Floats) -> Floats:
    """How far a speed that changes at a constant rate, down to standstill, has brought us by ``t_s``."""
    stop_s = np.divide(-speed_m_s, acceleration_m_s2, out=np.full_like(speed_m_s, np.inf), where=acceleration_m_s2 < 0)
    t = np.minimum(t_s, stop_s)
    return speed_m_s * t + 0.5 * acceleration_m_s2 * t * t
