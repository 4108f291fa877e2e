"""Section ``limits`` of a scenario, and the kernel that applies it to torques on both sides."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from enum import IntFlag
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from bus_schema.arrays import Matrix, Records, Vector, records
from bus_schema.configuration import (
    Number,
    PerJointNonNegative,
    PerJointPositive,
    StrictModel,
    expand,
)
from bus_schema.robot_description import RobotDescription
from bus_schema.runtime.compiled import compiled

Reaction = Literal["count", "cut", "stop"]


class Hit(IntFlag):
    """Limits that a torque or the motion exceeded."""

    TORQUE = 1
    TORQUE_RATE = 2
    POSITION = 4
    VELOCITY = 8


class LimitsConfiguration(StrictModel):
    """Limits of the joints. The controller keeps a margin; the plant acts at the limit itself.

    Attributes:
        torque_nm: largest torque; by default the URDF's effort limits.
        torque_rate_nm_s: largest change of a torque per second; none by default.
        velocity_rad_s: largest speed; by default the URDF's velocity limits.
        position_margin_rad: distance that the controller keeps from the ends of the URDF's ranges.
        velocity_margin: share of the largest speed that the controller does not use.
        on_position: reaction at the end of a range: ``count``; also ``cut`` torques that push
            outwards; or also ``stop`` the arm safely.
        on_velocity: reaction above the largest speed, likewise; ``cut`` removes accelerating
            torques.
    """

    torque_nm: PerJointPositive | None = None
    torque_rate_nm_s: PerJointPositive | None = None
    velocity_rad_s: PerJointPositive | None = None
    position_margin_rad: PerJointNonNegative = Field(default_factory=lambda: np.zeros(1))
    velocity_margin: Annotated[Number, Field(ge=0, lt=1)] = 0.0
    on_position: Reaction = "cut"
    on_velocity: Reaction = "count"

    def of_plant(self, robot: RobotDescription) -> JointLimits:
        """Return the limits at which the plant acts.

        Raises:
            ConfigurationError: a value does not fit the arm.
        """
        return JointLimits(
            torque_nm=_chosen(self.torque_nm, robot.effort_limits_nm, "torque_nm"),
            torque_rate_nm_s=_chosen(
                self.torque_rate_nm_s, np.full(robot.joints, np.inf), "torque_rate_nm_s"
            ),
            lower_rad=robot.lower_rad,
            upper_rad=robot.upper_rad,
            velocity_rad_s=_chosen(
                self.velocity_rad_s, robot.velocity_limits_rad_s, "velocity_rad_s"
            ),
            cuts_position=self.on_position != "count",
            cuts_velocity=self.on_velocity != "count",
        )

    def of_controller(self, robot: RobotDescription, torque_rate_nm_s: Vector) -> JointLimits:
        """Return the limits that the controller keeps, with the margins subtracted.

        Args:
            robot: the arm.
            torque_rate_nm_s: the control law's own largest rate, shape (joints,).

        Raises:
            ConfigurationError: a value does not fit the arm.
        """
        plant = self.of_plant(robot)
        margin = expand(self.position_margin_rad, robot.joints, "limits.position_margin_rad")
        return replace(
            plant,
            torque_rate_nm_s=np.minimum(plant.torque_rate_nm_s, torque_rate_nm_s),
            lower_rad=plant.lower_rad + margin,
            upper_rad=plant.upper_rad - margin,
            velocity_rad_s=plant.velocity_rad_s * (1.0 - self.velocity_margin),
        )

    @property
    def stops_at(self) -> Hit:
        """Limits at which the plant stops the arm."""
        stops = Hit(0)
        if self.on_position == "stop":
            stops |= Hit.POSITION
        if self.on_velocity == "stop":
            stops |= Hit.VELOCITY
        return stops


@dataclass(frozen=True)
class JointLimits:
    """Limits of one side, shape (joints,) each; infinite where there is no limit.

    Attributes:
        cuts_position: whether torques are cut that push out of the range.
        cuts_velocity: whether torques are cut that accelerate beyond the largest speed.
    """

    torque_nm: Vector
    torque_rate_nm_s: Vector
    lower_rad: Vector
    upper_rad: Vector
    velocity_rad_s: Vector
    cuts_position: bool = True
    cuts_velocity: bool = False

    @staticmethod
    def of_torques(torque_nm: Vector, torque_rate_nm_s: Vector) -> JointLimits:
        """Return limits of torques alone."""
        none = np.full(torque_nm.size, np.inf)
        return JointLimits(torque_nm, torque_rate_nm_s, -none, none, none)

    def packed(self, step_s: float = 1.0) -> Records:
        """Return the limits for `limit_torques`: the same field names, shape (joints,).

        Args:
            step_s: time between two torques, where it is always the same.
        """
        per_step = {"torque_rate_nm_s": self.torque_rate_nm_s * step_s}
        return records(self.torque_nm.size, vars(self) | per_step)


class LimitCounts:
    """Counts of limit hits.

    Attributes:
        seen: limits that were hit at all.
    """

    def __init__(self) -> None:
        self._by_hits: Counter[int] = Counter()
        self.seen = Hit(0)

    def note(self, hits: int) -> Hit:
        """Count a torque that hit these limits; return those that were never hit before."""
        self._by_hits[hits] += 1
        new = Hit(hits & ~self.seen)
        self.seen |= new
        return new

    def summary(self) -> dict[str, int]:
        """Return the number of torques that hit each limit, by its name."""
        return {
            name_of(hit): sum(count for hits, count in self._by_hits.items() if hits & hit)
            for hit in Hit
        }


def name_of(hit: Hit) -> str:
    """Return names of limits in words, as they stand in ``summary.json``."""
    return ", ".join(str(single.name).lower() for single in hit)


_TORQUE, _TORQUE_RATE, _POSITION, _VELOCITY = (hit.value for hit in Hit)
"""Flags as integers: compiled code takes no enumerations."""


@compiled
def limit_torques(
    wanted: Vector, motion: Matrix, limits: Records, previous_and_out: Vector, step_s: float
) -> int:
    """Write torques within the limits; return which limits were hit.

    A torque that pushes out of a joint's range, or accelerates beyond its largest speed, becomes
    zero at once, even beyond the largest rate of change: the rate is a soft limit, these are hard.

    Args:
        wanted: torques asked for, N m, shape (joints,).
        motion: positions and velocities as rows, shape (2, joints).
        limits: `JointLimits.packed`.
        previous_and_out: the torques before, replaced by those to send, shape (joints,).
        step_s: time since the torques before; 0 for the first.
    """
    hits = 0
    for i in range(wanted.size):
        limit = limits[i]
        torque = min(max(wanted[i], -limit.torque_nm), limit.torque_nm)
        if torque != wanted[i]:
            hits |= _TORQUE
        if step_s > 0.0:
            change, previous = limit.torque_rate_nm_s * step_s, previous_and_out[i]
            slower = min(max(torque, previous - change), previous + change)
            if slower != torque:
                hits |= _TORQUE_RATE
            torque = slower
        position, velocity = motion[0, i], motion[1, i]
        if position > limit.upper_rad or position < limit.lower_rad:
            hits |= _POSITION
            pushes_out = torque > 0.0 if position > limit.upper_rad else torque < 0.0
            if pushes_out and limit.cuts_position:
                torque = 0.0
        if abs(velocity) > limit.velocity_rad_s:
            hits |= _VELOCITY
            if torque * velocity > 0.0 and limit.cuts_velocity:
                torque = 0.0
        previous_and_out[i] = torque
    return hits


def _chosen(given: Vector | None, otherwise: Vector, name: str) -> Vector:
    return otherwise if given is None else expand(given, otherwise.size, f"limits.{name}")
