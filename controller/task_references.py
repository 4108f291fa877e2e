"""References that are drawn: tasks of one family, of which a number names one."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from bus_schema.arrays import Matrix, Vector
from bus_schema.configuration import PerJoint, Positive, StrictModel, Whole, expand
from bus_schema.robot_description import RobotDescription
from bus_schema.runtime.compiled import compiled
from controller.reference import MinimumJerk, Reference

_LIFTED_SHARE = 0.3
"""Height of the points above start and end of a pick, as a share of the spread."""


class DrawnTask(StrictModel):
    """Settings of every family of tasks.

    Attributes:
        task: number of the task; equal numbers are equal tasks.
        centre_rad: middle of the drawn positions.
        spread_rad: drawn positions are uniform within ± this value of the centre.
        speed: factor on the speed of the motion.
    """

    task: Annotated[Whole, Field(ge=0)] = 1
    centre_rad: PerJoint
    spread_rad: PerJoint
    speed: Positive = 1.0

    @property
    def highest_hz(self) -> float:
        """Highest frequency of its sinusoids; 0 for rest-to-rest moves."""
        return 0.0

    def _drawn(self, robot: RobotDescription, count: int) -> tuple[np.random.Generator, Matrix]:
        """Return the generator of the task, and its positions, shape (count, joints)."""
        generator = np.random.default_rng([self.task, 58])
        centre = expand(self.centre_rad, robot.joints, "reference.centre_rad")
        spread = expand(self.spread_rad, robot.joints, "reference.spread_rad")
        return generator, centre + spread * generator.uniform(-1.0, 1.0, (count, robot.joints))


class ReachConfiguration(DrawnTask):
    """Reach from rest to a target that moves, and follow it.

    Attributes:
        reach_s: time until the arm is at the target.
        amplitude_rad: of the target's motion.
        frequency_rad_s: of the target's motion; each joint's is a drawn share of it from 0.5 to 1.
    """

    kind: Literal["reach"]
    reach_s: Positive = 1.5
    amplitude_rad: PerJoint = Field(default_factory=lambda: np.full(1, 0.2))
    frequency_rad_s: Positive = 1.5

    @property
    def highest_hz(self) -> float:
        return self.speed * self.frequency_rad_s / (2.0 * math.pi)

    def build(self, robot: RobotDescription) -> Reference:
        """Return the trajectory for this arm.

        Raises:
            ConfigurationError: there are as many values as suits another arm.
        """
        generator, (start, target) = self._drawn(robot, 2)
        amplitude = expand(self.amplitude_rad, robot.joints, "reference.amplitude_rad")
        share, phase = generator.uniform(0.0, 1.0, (2, robot.joints))
        frequency = self.speed * self.frequency_rad_s * (0.5 + 0.5 * share)
        motion: Matrix = np.stack([start, target, amplitude, frequency, 2.0 * math.pi * phase])
        return Reference(_reach, motion, self.reach_s / self.speed)


class PickConfiguration(DrawnTask):
    """Pick and place through points above start and end, at rest in each of them.

    Attributes:
        move_s: time from one point to the next.
    """

    kind: Literal["pick"]
    move_s: Positive = 0.8

    def build(self, robot: RobotDescription) -> Reference:
        """Return the trajectory for this arm: home, above, pick, above, above, place, above, home.

        Raises:
            ConfigurationError: there are as many values as suits another arm.
        """
        generator, (home, pick, place) = self._drawn(robot, 3)
        spread = expand(self.spread_rad, robot.joints, "reference.spread_rad")
        lift = _LIFTED_SHARE * spread * generator.uniform(-1.0, 1.0, robot.joints)
        over_pick, over_place = pick + lift, place + lift
        points = [home, over_pick, pick, over_pick, over_place, place, over_place, home]
        times_s = self.move_s / self.speed * np.arange(len(points), dtype=np.float64)
        return MinimumJerk(times_s, np.array(points))


@compiled
def _reach(
    motion: Matrix, reach_s: float,
    position: Vector, velocity: Vector, acceleration: Vector, time_s: float,
) -> None:  # fmt: skip
    # From the start to the moving target by a share of the way, of least jerk.
    x = min(max(time_s / reach_s, 0.0), 1.0)
    moving = 0.0 < x < 1.0
    way = x * x * x * (10.0 + x * (6.0 * x - 15.0))
    d_way = 30.0 * x * x * (1.0 - x) * (1.0 - x) / reach_s if moving else 0.0
    dd_way = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / (reach_s * reach_s) if moving else 0.0
    for i in range(position.size):
        start, target, amplitude = motion[0, i], motion[1, i], motion[2, i]
        frequency = motion[3, i]
        angle = frequency * time_s + motion[4, i]
        away = target + amplitude * math.sin(angle) - start
        d_away = amplitude * frequency * math.cos(angle)
        dd_away = -amplitude * frequency * frequency * math.sin(angle)
        position[i] = start + way * away
        velocity[i] = d_way * away + way * d_away
        acceleration[i] = dd_way * away + 2.0 * d_way * d_away + way * dd_away
