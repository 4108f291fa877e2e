"""Section ``plant.interface`` of a scenario: what a robot takes, and its own controller."""

from __future__ import annotations

import math
from typing import Annotated, Literal, NamedTuple, Protocol

from pydantic import Field, field_validator

from bus_schema.configuration import NonNegative, Number, Positive, StrictModel
from bus_schema.errors import did_you_mean
from plant_emulator.interfaces.interface import RobotInterface
from plant_emulator.interfaces.speedj import SpeedJ

TORQUE = "torque"
Takes = Literal["torque", "position", "velocity"]
_DEFAULT_HZ = 500.0


class InterfaceSection(Protocol):
    """Settings of one kind of interface.

    Attributes:
        lag_s: of joints that move steadily behind their targets, without waiting for a cycle.
    """

    @property
    def lag_s(self) -> float: ...

    def build(self, interface: InterfaceConfiguration) -> RobotInterface:
        """Return a new controller of the robot."""


class SpeedJConfiguration(StrictModel):
    """Joint velocities.

    Attributes:
        acceleration_rad_s2: largest acceleration of a joint.
        ideal: the joints follow velocities at once.
    """

    acceleration_rad_s2: Positive = 40.0
    ideal: bool = False

    @property
    def lag_s(self) -> float:
        """None: velocities come into force at once, up to the limit."""
        return 0.0

    def build(self, interface: InterfaceConfiguration) -> RobotInterface:
        """Return the robot's controller."""
        most = math.inf if self.ideal else self.acceleration_rad_s2
        return SpeedJ(interface.period_s, most, 1e-3 * interface.timeout_ms, interface.stop_rad_s2)


class InterfaceKind(NamedTuple):
    """An interface.

    Attributes:
        takes: what its targets are.
        rate_hz: usual rate of the robot's controller.
    """

    takes: Takes
    rate_hz: float = _DEFAULT_HZ


KINDS = {
    "speedj": InterfaceKind("velocity"),
}
"""Interfaces by name; each has a section of its name in `InterfaceConfiguration`."""


class InterfaceConfiguration(StrictModel):
    """Interface of the robot, and its own controller between the link and the joints.

    Attributes:
        kind: ``torque``, or what the robot takes.
        rate_hz: cycles per second of the robot's own controller; by default the usual ones of its
            kind.
        clock_ppm: how much faster its clock runs.
        phase_ms: its first cycle after the run begins.
        bandwidth_rad_s: of the loops that its drives close around the motion.
        timeout_ms: time without a target after which the robot stops.
        stop_rad_s2: deceleration of that stop.
    """

    kind: str = TORQUE
    rate_hz: Annotated[Positive, Field(le=1e4)] | None = None
    clock_ppm: Annotated[Number, Field(ge=-1e4, le=1e4)] = 0.0
    phase_ms: NonNegative = 0.0
    bandwidth_rad_s: Positive = 150.0
    timeout_ms: Annotated[Positive, Field(le=200)] = 20.0
    stop_rad_s2: Positive = 4.0
    speedj: SpeedJConfiguration = SpeedJConfiguration()

    @field_validator("kind")
    @classmethod
    def _is_known(cls, kind: str) -> str:
        if kind not in (TORQUE, *KINDS):
            raise ValueError(f"one of {', '.join((TORQUE, *KINDS))}{did_you_mean(kind, KINDS)}")
        return kind

    @property
    def lag_s(self) -> float:
        """Time from a target's arrival until the joints have it, while they move steadily."""
        return 0.5 * self.true_period_s + self._section.lag_s

    @property
    def takes(self) -> Takes:
        """What commands have to contain."""
        return KINDS[self.kind].takes if self.kind != TORQUE else TORQUE

    @property
    def period_s(self) -> float:
        """Time between two cycles, by the robot's own clock."""
        return 1.0 / (self.rate_hz or KINDS[self.kind].rate_hz)

    @property
    def true_period_s(self) -> float:
        """Time between two cycles, by the run's clock."""
        return self.period_s / (1.0 + 1e-6 * self.clock_ppm)

    def build(self) -> RobotInterface:
        """Return a new controller of the robot; not for ``torque``."""
        return self._section.build(self)

    @property
    def _section(self) -> InterfaceSection:
        section: InterfaceSection = getattr(self, self.kind)
        return section
