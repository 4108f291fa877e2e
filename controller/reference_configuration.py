"""Section ``reference`` of a scenario, and the trajectories built from it."""

from __future__ import annotations

import itertools
import math
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, field_validator

from bus_schema.configuration import (
    NonNegative,
    Number,
    PerJoint,
    Positive,
    StrictModel,
    expand,
)
from bus_schema.robot_description import RobotDescription
from controller.manipulator_model import ManipulatorModel
from controller.reference import (
    CartesianPath,
    JointSinusoids,
    MinimumJerk,
    Reference,
    ThroughRows,
)
from controller.reference_file import read_rows
from controller.task_references import PickConfiguration, ReachConfiguration


class _Timed(StrictModel):
    """Settings of every kind of reference.

    Attributes:
        speed: factor on the speed of the motion, q_d(speed t). Accelerations grow with its square.
    """

    speed: Positive = 1.0

    @property
    def highest_hz(self) -> float:
        """Highest frequency of its sinusoids; 0 for rest-to-rest moves, infinite if unknown."""
        return 0.0


def _highest_hz(frequency_rad_s: ArrayLike, amplitude: ArrayLike) -> float:
    moves = np.not_equal(amplitude, 0.0)
    return float(np.max(np.abs(frequency_rad_s) * moves)) / (2.0 * math.pi)


class AxisConfiguration(StrictModel):
    """One Cartesian axis: offset + velocity t + amplitude sin(frequency t + phase)."""

    offset_m: Number
    velocity_m_s: Number = 0.0
    amplitude_m: Number = 0.0
    frequency_rad_s: Number = 0.0
    phase_rad: Number = 0.0

    def at_speed(self, speed: float) -> list[float]:
        """Return offset, velocity, amplitude, frequency and phase at another speed."""
        velocity, frequency = speed * self.velocity_m_s, speed * self.frequency_rad_s
        return [self.offset_m, velocity, self.amplitude_m, frequency, self.phase_rad]


class CartesianPathConfiguration(_Timed):
    """A path of the tool of a yaw-pitch-pitch arm in the base frame."""

    kind: Literal["cartesian_path"]
    x: AxisConfiguration
    y: AxisConfiguration
    z: AxisConfiguration

    @property
    def highest_hz(self) -> float:
        axes = (self.x, self.y, self.z)
        return self.speed * max(_highest_hz(a.frequency_rad_s, a.amplitude_m) for a in axes)

    def build(self, robot: RobotDescription) -> Reference:
        """Return the path on this arm.

        Raises:
            ConfigurationError: the arm is no yaw-pitch-pitch arm.
        """
        axes = np.array([axis.at_speed(self.speed) for axis in (self.x, self.y, self.z)])
        return CartesianPath(axes, *ManipulatorModel(robot).yaw_pitch_pitch_lengths())


class SinusoidConfiguration(StrictModel):
    """One sinusoid for every joint."""

    amplitude_rad: PerJoint
    frequency_rad_s: PerJoint
    phase_rad: PerJoint = Field(default_factory=lambda: np.zeros(1))


class JointSinusoidsConfiguration(_Timed):
    """A sum of sinusoids about a centre, for any arm."""

    kind: Literal["joint_sinusoids"]
    centre_rad: PerJoint
    terms: Annotated[list[SinusoidConfiguration], Field(min_length=1)]

    @property
    def highest_hz(self) -> float:
        return self.speed * max(_highest_hz(t.frequency_rad_s, t.amplitude_rad) for t in self.terms)

    def build(self, robot: RobotDescription) -> Reference:
        """Return the trajectory for this arm.

        Raises:
            ConfigurationError: there are as many values as suits another arm.
        """
        terms = []
        for index, term in enumerate(self.terms):
            key = f"reference.terms.{index}"
            amplitude, frequency, phase = (
                expand(value, robot.joints, f"{key}.{name}") for name, value in term
            )
            terms.append(np.stack([amplitude, self.speed * frequency, phase], axis=-1))
        centre = expand(self.centre_rad, robot.joints, "reference.centre_rad")
        return JointSinusoids(centre, np.array(terms))


class WaypointConfiguration(StrictModel):
    """A position in which the arm rests at a given time."""

    time_s: NonNegative
    position_rad: PerJoint


class MinimumJerkConfiguration(_Timed):
    """Moves from rest to rest through waypoints, for any arm."""

    kind: Literal["minimum_jerk"]
    waypoints: Annotated[list[WaypointConfiguration], Field(min_length=1)]

    @field_validator("waypoints")
    @classmethod
    def _in_order(cls, waypoints: list[WaypointConfiguration]) -> list[WaypointConfiguration]:
        times = [waypoint.time_s for waypoint in waypoints]
        if any(b <= a for a, b in itertools.pairwise(times)):
            raise ValueError("waypoints with increasing time_s")
        return waypoints

    def build(self, robot: RobotDescription) -> Reference:
        """Return the trajectory for this arm.

        Raises:
            ConfigurationError: there are as many values as suits another arm.
        """
        positions = [
            expand(waypoint.position_rad, robot.joints, f"reference.waypoints.{i}.position_rad")
            for i, waypoint in enumerate(self.waypoints)
        ]
        times = np.array([waypoint.time_s for waypoint in self.waypoints]) / self.speed
        return MinimumJerk(times, np.array(positions))


class CsvConfiguration(_Timed):
    """A trajectory from a file as ``funnel-hil reference --csv`` writes it, or of positions alone.

    Attributes:
        file: a path relative to the scenario file, or else to the current folder.
        beyond: outside the times of the file: ``refuse`` the run, or ``hold`` the position of the
            first or last row.
    """

    kind: Literal["csv"]
    file: Annotated[str, Field(min_length=1, max_length=1000)]
    beyond: Literal["refuse", "hold"] = "refuse"

    @property
    def highest_hz(self) -> float:
        return math.inf

    def build(self, robot: RobotDescription) -> Reference:
        """Return the trajectory for this arm.

        Raises:
            ConfigurationError: the file contains none.
        """
        found = read_rows(self.file, robot)
        powers = np.array([1.0, self.speed, self.speed * self.speed])
        times, rows = found.times_s / self.speed, found.motion * powers[:, np.newaxis]
        warnings = found.warnings(robot, self.speed)
        if self.beyond == "refuse":
            return ThroughRows(times, rows, warnings=warnings, known_s=(times[0], times[-1]))
        if found.moves_at_an_end():
            warnings += (
                f"{self.file}: has a velocity in its first or last row, but the arm rests there",
            )
        return ThroughRows(times, rows, warnings=warnings)


ReferenceConfiguration = Annotated[
    CartesianPathConfiguration
    | JointSinusoidsConfiguration
    | MinimumJerkConfiguration
    | CsvConfiguration
    | ReachConfiguration
    | PickConfiguration,
    Field(discriminator="kind"),
]
