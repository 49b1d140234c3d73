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
    """The direction in which a camera usually goes, by all steps so far: how it is mounted.

    ``direction (3,)`` is a ``dir`` in the camera's axes, ``variance`` that of each of its tangent coordinates, rad^2.
    """

    direction: Floats
    variance: float

    def after(self, direction: Floats, covariance: Floats, swing_sigma_rad: float, step_s: float) -> UsualDirection:
        """The usual direction with one step more, whose ``direction (3,)`` was estimated with this one as its prior.

        What the flow alone says of the step is what its ``covariance`` (3, 3) leaves beside that prior.
        """
        expected = self.variance + swing_sigma_rad**2
        found = 0.5 * float(np.trace(covariance))
        information = 1.0 / found - 1.0 / expected
        if not (information > 0.0 and direction @ self.direction > 0.0):
            return self
        by_flow = (direction / found - self.direction / expected) / information
        off = (1.0 / information + swing_sigma_rad**2) * max(1.0, _SWING_S / step_s)
        gain = self.variance / (self.variance + off)
        mean = self.direction + gain * (by_flow - self.direction)
        return UsualDirection(mean / math.sqrt(mean @ mean), (1.0 - gain) * self.variance)


@dataclass(frozen=True)
class EgomotionMemory:
    """Start of the next search: the expected rotation vector (rad) and the last direction; None at first.

    ``gap_frames`` is the gap that the last flow asks for; ``window`` as in `Egomotion`, also where it does not know a
    direction and is only carried on: not ``is_window_used``. ``n_moving`` counts the last steps in a row that had a
    direction; ``usual`` is the usual one, None until enough of them had; ``spread_ratio`` that of the last fit.
    """

    rotation_rad: Floats | None = None
    direction: Floats | None = None
    gap_frames: int = 1
    window: SceneWindow | None = None
    is_window_used: bool = False
    n_moving: int = 0
    usual: UsualDirection | None = None
    spread_ratio: float = 1.0

    @property
    def goes_on(self) -> bool:
        """Whether the camera, whose usual direction is known, moved in the last step."""
        return self.usual is not None and self.n_moving > 0

    def after(self, fit: TwoViewFit) -> EgomotionMemory:
        """The start of the search after a fit."""
        memory = replace(self, rotation_rad=vector_from_rotation(fit.cam_R_prev))
        if fit.direction is None:
            return memory
        return replace(memory, direction=fit.direction, spread_ratio=fit.spread_ratio)

    def with_direction(
        self, direction: Floats | None, covariance: Floats | None, belief: MotionPrior, step_s: float
    ) -> EgomotionMemory:
        """The memory with the direction (3,) of a step of ``step_s`` and its covariance (3, 3), None without one."""
        if direction is None or covariance is None:
            return replace(self, n_moving=0)
        memory, sigma_rad = replace(self, direction=direction, n_moving=self.n_moving + 1), belief.direction_sigma_rad
        if sigma_rad is None or memory.n_moving < _LEAST_STEPS:
            return memory
        usual = UsualDirection(FORWARD_DIR, sigma_rad**2) if self.usual is None else self.usual
        return replace(memory, usual=usual.after(direction, covariance, belief.swing_sigma_rad, step_s))

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
        # Neighbouring points err together: else as many of them would outweigh what is known.
        variance = (self.usual.variance + belief.swing_sigma_rad**2) / self.spread_ratio
        return GaussianPrior(expected, belief.rotation_sigma_rad, usual, math.sqrt(variance))
