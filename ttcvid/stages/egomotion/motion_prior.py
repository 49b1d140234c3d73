"""What is expected of own motion before a pair of frames is seen: by what carries the camera, and by the last steps."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ttcvid.geometry.estimation.relative_pose import GaussianPrior, TwoViewFit
from ttcvid.geometry.estimation.rigid_motion import RigidPaths
from ttcvid.geometry.rotation import vector_from_rotation
from ttcvid.model import Bools, Floats, Ints, Platform

# The usual direction is known after so many steps in a row: in the first frames no mover is known, and what moves may
# be one. A deviation from it, a bend or a gust, lasts for about this time, s: the steps within it tell one of them.
_LEAST_STEPS, _SWING_S = 6, 1.0
# It changes, too: a mounting gives way, an aircraft has the wind from elsewhere. By a degree a minute, rad^2/s.
_DRIFT_RAD2_S = float(np.radians(1.0)) ** 2 / 60.0
# In a bend a camera ahead of the rear axle goes aside, by the turn in the time that the vehicle takes for that distance
# (1.7 m at 3.4 m/s).
_SLIP_S = 0.5
# A vehicle does not go farther off its camera's axis, ahead or back, than so many standard deviations: 60 deg.
_MOST_OFF_AXIS_SIGMAS = 4.0

FORWARD_DIR = np.array([0.0, 0.0, -1.0])
"""``dir`` of the static scene for a camera that drives along its optical axis."""


@dataclass(frozen=True)
class MotionPrior:
    """Prior of egomotion before a pair of frames is seen (standard deviations, rad).

    ``rotation_sigma_rad`` about the previous rotation (about none for a resting camera); ``direction_sigma_rad`` about
    forward, None where any direction is equally likely; ``swing_sigma_rad`` about the usual direction, once that is
    known (`UsualDirection`); ``can_translate`` False for a resting camera.
    """

    rotation_sigma_rad: float
    direction_sigma_rad: float | None
    swing_sigma_rad: float = math.nan
    can_translate: bool = True

    @property
    def is_open(self) -> bool:
        """Whether the camera may go in any direction."""
        return self.can_translate and self.direction_sigma_rad is None

    def excludes(self, direction: Floats) -> bool:
        """Whether it cannot go in a direction ``(3,)``: a car that waits does not drift with the traffic before it."""
        most_rad = math.inf if self.direction_sigma_rad is None else _MOST_OFF_AXIS_SIGMAS * self.direction_sigma_rad
        if not most_rad < 0.5 * math.pi:
            return False
        return abs(float(direction @ FORWARD_DIR)) < math.cos(most_rad) * math.hypot(*direction)


# A car turns its rate by at most 0.3-0.5 deg from frame to frame and moves within a few degrees of where its camera
# looks, and within one or two of its mean (it slips and pitches); an aircraft also climbs and is blown sideways; a hand
# turns a camera faster than either. A camera on a mast only shakes.
MOTION_PRIORS = {
    Platform.vehicle: MotionPrior(np.radians(0.5), np.radians(15.0), np.radians(1.5)),
    Platform.aircraft: MotionPrior(np.radians(1.0), np.radians(30.0), np.radians(3.0)),
    Platform.free: MotionPrior(np.radians(2.0), None),
    Platform.static: MotionPrior(np.radians(0.1), None, can_translate=False),
}


@dataclass(frozen=True)
class SceneWindow:
    """Relative trajectory ``paths`` of the scene over the views of the frames ``frame (L,)``, one body.

    ``outside_id (K,)`` numbers the tracks that leave it, ascending.
    """

    frame: Ints
    paths: RigidPaths
    outside_id: Ints

    def leaves_out(self, track_id: Ints) -> Bools:
        """Which of N tracks leave the trajectory: (N,)."""
        return np.isin(track_id, self.outside_id)


@dataclass(frozen=True)
class UsualDirection:
    """The line along which a camera usually goes, by all steps so far: how it is mounted.

    ``direction (3,)`` is a ``dir`` in the camera's axes, ``variance`` that of each of its tangent coordinates, rad^2.
    """

    direction: Floats
    variance: float

    def after(self, direction: Floats, covariance: Floats, swing_sigma_rad: float, step_s: float) -> UsualDirection:
        """The usual direction with one step more, whose ``direction (3,)`` was estimated with this one as its prior.

        What the flow alone says of the step is what its ``covariance (3, 3)`` leaves beside that prior, in the
        coordinate that is known worst.
        """
        expected, variance = self.variance + swing_sigma_rad**2, self.variance + _DRIFT_RAD2_S * step_s
        found = float(np.linalg.eigvalsh(covariance)[-1])
        information = 1.0 / found - 1.0 / expected
        if not information > 0.0:
            return UsualDirection(self.direction, variance)
        along = math.copysign(1.0, direction @ self.direction) * direction
        by_flow = (along / found - self.direction / expected) / information
        gain = variance / (variance + (1.0 / information + swing_sigma_rad**2) * max(1.0, _SWING_S / step_s))
        mean = self.direction + gain * (by_flow - self.direction)
        return UsualDirection(mean / math.sqrt(mean @ mean), (1.0 - gain) * variance)


@dataclass(frozen=True)
class EgomotionMemory:
    """Start of the next search: the expected rotation vector (rad) and the last direction; None at first.

    ``gap_frames`` is the gap that the last flow asks for; ``window`` as in `Egomotion`, also where it does not know a
    direction and is only carried on: not ``is_window_used``. ``n_moving`` counts the last steps in a row that had a
    direction, told or not, ``n_against`` those of them in which most points went the other way; ``usual`` is the usual
    direction, None until enough steps had one; ``turn_rad_s`` how fast the camera turned in the last step.
    """

    rotation_rad: Floats | None = None
    direction: Floats | None = None
    gap_frames: int = 1
    window: SceneWindow | None = None
    is_window_used: bool = False
    n_moving: int = 0
    n_against: int = 0
    usual: UsualDirection | None = None
    turn_rad_s: float = 0.0

    @property
    def goes_on(self) -> bool:
        """Whether the camera, whose usual direction is known, moved in the last step, and may not go back yet."""
        return self.usual is not None and self.n_moving > 0 and self.n_against < _LEAST_STEPS

    def after(self, fit: TwoViewFit) -> EgomotionMemory:
        """The start of the search after a fit."""
        direction = self.direction if fit.direction is None else fit.direction
        n_against = self.n_against + 1 if fit.sense.sum() < 0.0 else 0
        return replace(
            self, rotation_rad=vector_from_rotation(fit.cam_R_prev), direction=direction, n_against=n_against
        )

    def swing_sigma_rad(self, belief: MotionPrior) -> float:
        """Standard deviation of a step's direction about the usual one: the larger, the faster the camera turns."""
        return math.hypot(belief.swing_sigma_rad, _SLIP_S * self.turn_rad_s)

    def with_direction(
        self, direction: Floats | None, covariance: Floats | None, belief: MotionPrior, step_s: float
    ) -> EgomotionMemory:
        """The memory with the direction (3,) of a step of ``step_s`` and its covariance (3, 3), None without one."""
        turn_rad_s = 0.0 if self.rotation_rad is None else float(np.linalg.norm(self.rotation_rad)) / step_s
        if direction is None or covariance is None:
            return replace(self, n_moving=0, turn_rad_s=turn_rad_s)
        memory = replace(self, direction=direction, n_moving=self.n_moving + 1, turn_rad_s=turn_rad_s)
        sigma_rad = belief.direction_sigma_rad
        if sigma_rad is None or memory.n_moving < _LEAST_STEPS:
            return memory
        usual = UsualDirection(FORWARD_DIR, sigma_rad**2) if self.usual is None else self.usual
        return replace(memory, usual=usual.after(direction, covariance, self.swing_sigma_rad(belief), step_s))

    def prior(self, belief: MotionPrior) -> GaussianPrior:
        """What is expected of the next step: it turns as the last one did, and goes where it usually goes."""
        expected = self.rotation_rad if self.rotation_rad is not None and belief.can_translate else np.zeros(3)
        if belief.direction_sigma_rad is None:
            return GaussianPrior(expected, belief.rotation_sigma_rad)
        if self.usual is None:
            return GaussianPrior(expected, belief.rotation_sigma_rad, FORWARD_DIR, belief.direction_sigma_rad)
        usual = self.usual.direction
        if self.goes_on and self.direction is not None and self.direction @ usual < 0.0:
            usual = -usual
        sigma_rad = math.hypot(math.sqrt(self.usual.variance), self.swing_sigma_rad(belief))
        return GaussianPrior(expected, belief.rotation_sigma_rad, usual, sigma_rad)
