"""``franka_position`` and ``franka_velocity``: targets at 1 kHz, with limits and reflexes.

After libfranka (its documentation and headers): without a new target the robot goes on with
constant acceleration; 20 lost in a row stop it. Limits are checked on backward differences of the
targets after extrapolation; the reflex of a too large acceleration is called velocity
discontinuity, that of a too large jerk acceleration discontinuity. Filter and rate limiter work on
the robot's own last target. The limiter (libfranka's ``rate_limiting.h``) does not plan: after a
jump of positions, it overshoots.
"""

from __future__ import annotations

import math
from typing import ClassVar, NamedTuple

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.configuration import Positive
from plant_emulator.interfaces.interface import LostCount, Motion, Stoppable
from plant_emulator.interfaces.settings import InterfaceSettings, Takes, low_pass_lag_s

MOST_LOST = 20
LOST = "communication_constraints_violation"
_PREFIX = "joint_motion_generator_"
_TOO_FAST = f"{_PREFIX}velocity_limits_violation"
_ACCELERATION = f"{_PREFIX}velocity_discontinuity"
_JERK = f"{_PREFIX}acceleration_discontinuity"
_ROUNDING = 1.0 + 1e-6


class MotionLimits(NamedTuple):
    """Largest velocity, acceleration and jerk of a joint, rad/s, rad/s², rad/s³."""

    velocity_rad_s: float
    acceleration_rad_s2: float
    jerk_rad_s3: float


def low_pass_share(period_s: float, filter_hz: float) -> float:
    """Return the share of a new value that libfranka's low pass takes; 1 for inf Hz."""
    return period_s / (period_s + low_pass_lag_s(filter_hz))


class FrankaMotion(Stoppable):
    """Positions or velocities of a Franka arm.

    Args:
        period_s: of a cycle.
        limits: of the joints.
        takes_velocities: targets are velocities.
        limiter: targets are changed to stay within the limits.
        filter_hz: of the low pass; inf for none.
    """

    def __init__(
        self, period_s: float, limits: MotionLimits, *, takes_velocities: bool, limiter: bool,
        filter_hz: float,
    ) -> None:  # fmt: skip
        self._period_s, self._limits = period_s, limits
        self._takes_velocities, self._limiter = takes_velocities, limiter
        self._share = low_pass_share(period_s, filter_hz)
        self._lost = LostCount(MOST_LOST)

    def start(self, position_rad: Vector) -> None:
        self._position = position_rad.copy()
        self._velocity, self._acceleration = np.zeros((2, position_rad.size))
        self._lost.start()

    def step(self, target: Matrix | None, measured: Matrix) -> Motion:  # noqa: ARG002
        period_s = self._period_s
        velocity = self._velocity + period_s * self._acceleration
        if self._lost.is_over(arrived=target is not None):
            self.stop(LOST, -1, f"{MOST_LOST} targets in a row were late or lost")
        if target is not None:
            velocity = self._wanted(target)
        acceleration = (velocity - self._velocity) / period_s
        self._check(velocity, acceleration)
        if self.reflex is None:
            self._position = self._position + period_s * velocity
            self._velocity, self._acceleration = velocity, acceleration
        return Motion(self._position.copy(), self._velocity.copy(), self._acceleration.copy())

    def _wanted(self, target: Matrix) -> Vector:
        """Return the velocity of a target after filter and limiter."""
        if self._takes_velocities:
            velocity = self._velocity + self._share * (target[1] - self._velocity)
        else:
            velocity = self._share * (target[0] - self._position) / self._period_s
        if not self._limiter:
            return np.asarray(velocity)
        period_s, (fastest, most, jerk) = self._period_s, self._limits
        wanted, step = (velocity - self._velocity) / period_s, jerk * period_s
        wanted = np.clip(wanted, self._acceleration - step, self._acceleration + step)
        # The acceleration vanishes as the velocity comes near its limit.
        up, down = (np.minimum(most, jerk / most * (fastest - way * self._velocity))
                    for way in (1.0, -1.0))  # fmt: skip
        return np.asarray(self._velocity + period_s * np.clip(wanted, -down, up))

    def _check(self, velocity: Vector, acceleration: Vector) -> None:
        """Note a reflex if a limit is passed."""
        jerk = (acceleration - self._acceleration) / self._period_s
        fastest, most, jerkiest = self._limits
        for kind, values, limit, unit in (
            (_TOO_FAST, velocity, fastest, "rad/s"),
            (_ACCELERATION, acceleration, most, "rad/s²"),
            (_JERK, jerk, jerkiest, "rad/s³"),
        ):
            joint = int(np.abs(values).argmax())
            if abs(values[joint]) > limit * _ROUNDING:
                words = f"{abs(values[joint]):.3g} of at most {limit:g} {unit}"
                self.stop(kind, joint, words)


class FrankaMotionSettings(InterfaceSettings):
    """Targets at 1 kHz, with the limits of an FR3.

    Attributes:
        velocity_rad_s: largest velocity of a joint; the robot's own depend on the position.
        acceleration_rad_s2: largest acceleration.
        jerk_rad_s3: largest jerk.
        limiter: targets are changed to stay within the limits.
        filter_hz: of the low pass; null for none.
    """

    rate_hz: ClassVar[float] = 1000.0
    goes_on: ClassVar[bool] = True
    velocity_rad_s: Positive = 2.62
    acceleration_rad_s2: Positive = 10.0
    jerk_rad_s3: Positive = 5000.0
    limiter: bool = False
    filter_hz: Positive | None = None

    def lag_s(self, period_s: float, targets_s: float) -> float:  # noqa: ARG002
        return 0.0 if self.filter_hz is None else low_pass_lag_s(self.filter_hz)

    def build(self, period_s: float) -> FrankaMotion:
        limits = MotionLimits(self.velocity_rad_s, self.acceleration_rad_s2, self.jerk_rad_s3)
        return FrankaMotion(
            period_s, limits, takes_velocities=self.takes == "velocity", limiter=self.limiter,
            filter_hz=self.filter_hz or math.inf,
        )  # fmt: skip


class FrankaVelocitySettings(FrankaMotionSettings):
    """The same, for velocities."""

    @property
    def takes(self) -> Takes:
        return "velocity"
