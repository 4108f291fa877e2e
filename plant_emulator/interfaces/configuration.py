"""Section ``plant.interface`` of a scenario: what a robot takes, and its own controller."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, ValidationInfo, field_validator

from bus_schema.configuration import NonNegative, Number, Positive, StrictModel, validated
from bus_schema.registry import KnownNameIn, Registry
from plant_emulator.interfaces.egm import EgmSettings
from plant_emulator.interfaces.franka import FrankaMotionSettings, FrankaVelocitySettings
from plant_emulator.interfaces.franka_torque import FrankaTorqueSettings
from plant_emulator.interfaces.interface import RobotInterface
from plant_emulator.interfaces.joint_trajectory import JointTrajectorySettings
from plant_emulator.interfaces.rsi import RsiSettings
from plant_emulator.interfaces.servo import ServoSettings
from plant_emulator.interfaces.servoj import ServoJSettings
from plant_emulator.interfaces.settings import TORQUE, InterfaceSettings, Takes
from plant_emulator.interfaces.speedj import SpeedJSettings

_MOST_PPM = 1e4
INTERFACES: Registry[type[InterfaceSettings]] = Registry(
    "interfaces",
    "plant.interface.kind",
    InterfaceSettings,
    {
        "servoj": ServoJSettings,
        "speedj": SpeedJSettings,
        "franka_position": FrankaMotionSettings,
        "franka_velocity": FrankaVelocitySettings,
        "franka_torque": FrankaTorqueSettings,
        "egm": EgmSettings,
        "rsi": RsiSettings,
        "joint_trajectory": JointTrajectorySettings,
        "servo": ServoSettings,
    },
)
"""Interfaces of robots that have a controller of their own."""


class InterfaceConfiguration(StrictModel):
    """Interface of the robot, and its own controller between the link and the joints.

    Attributes:
        kind: ``torque`` for a robot without a controller of its own, or the name of a section.
        rate_hz: cycles per second of the robot's controller; by default the usual ones of its kind.
        clock_ppm: how much faster its clock runs.
        phase_ms: its first cycle after the run begins.
        bandwidth_rad_s: of the loops that its drives close around the motion.
        own: settings of a kind that an installed package adds.
    """

    kind: Annotated[str, KnownNameIn("interfaces", (TORQUE,))] = TORQUE
    rate_hz: Annotated[Positive, Field(le=1e4)] | None = None
    clock_ppm: Annotated[Number, Field(ge=-_MOST_PPM, le=_MOST_PPM)] = 0.0
    phase_ms: NonNegative = 0.0
    bandwidth_rad_s: Positive = 150.0
    own: dict[str, Any] = Field(default_factory=dict)
    servoj: ServoJSettings = ServoJSettings()
    speedj: SpeedJSettings = SpeedJSettings()
    franka_position: FrankaMotionSettings = FrankaMotionSettings()
    franka_velocity: FrankaVelocitySettings = FrankaVelocitySettings()
    franka_torque: FrankaTorqueSettings = FrankaTorqueSettings()
    egm: EgmSettings = EgmSettings()
    rsi: RsiSettings = RsiSettings()
    joint_trajectory: JointTrajectorySettings = JointTrajectorySettings()
    servo: ServoSettings = ServoSettings()

    @field_validator("own")
    @classmethod
    def _is_of_its_kind(cls, own: dict[str, Any], info: ValidationInfo) -> dict[str, Any]:
        kind = info.data.get("kind")  # None if it has an error of its own
        if own and kind in (TORQUE, *INTERFACES.shipped):
            raise ValueError(f"left out with kind = {kind}: it is for kinds of installed packages")
        return own

    @property
    def has_controller(self) -> bool:
        """Whether the robot has a controller of its own."""
        return self.kind != TORQUE

    @property
    def takes(self) -> Takes:
        """Content that commands must have."""
        return self.settings.takes if self.has_controller else TORQUE

    @property
    def settings(self) -> InterfaceSettings:
        """The section of its kind, if it has a controller of its own.

        Raises:
            ConfigurationError: `own` has wrong keys or values, or its package cannot be loaded.
        """
        if self.kind in INTERFACES.shipped:
            section: InterfaceSettings = getattr(self, self.kind)
            return section
        return validated("plant.interface.own", INTERFACES[self.kind], self.own)

    def lag_s(self, targets_s: float) -> float | None:
        """Return the time from a target's arrival until joints that move steadily have it.

        None where that is unknown.

        Args:
            targets_s: time from one target to the next.
        """
        if not self.has_controller:
            return 0.0
        settings, period_s = self.settings, self.true_period_s
        targets_s = max(period_s, targets_s)
        lag_s = settings.lag_s(period_s, targets_s)
        held_s = 0.0 if settings.goes_on else 0.5 * (targets_s - period_s)
        return None if lag_s is None else lag_s + held_s

    @property
    def period_s(self) -> float:
        """Time between two cycles, by the robot's own clock."""
        return 1.0 / (self.rate_hz or self.settings.rate_hz)

    @property
    def true_period_s(self) -> float:
        """Time between two cycles, by the run's clock."""
        return self.period_s / (1.0 + 1e-6 * self.clock_ppm)

    def build(self) -> RobotInterface:
        """Return a new controller of the robot, if it has one."""
        return self.settings.build(self.period_s)
