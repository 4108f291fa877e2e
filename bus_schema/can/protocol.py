"""Protocols of motor drives as the bus sees them, and the table of them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import BaseModel

from bus_schema.arrays import Vector
from bus_schema.can.codec import CanCodec
from bus_schema.can.frame import CanFrame
from bus_schema.can.master import CanMaster
from bus_schema.configuration import ConfigurationError, validated
from bus_schema.drive_feedback import DriveGains
from bus_schema.link.can_configuration import CanConfiguration
from bus_schema.registry import Registry
from bus_schema.robot_description import RobotDescription


class DriveProtocol(ABC):
    """A protocol of motor drives; section ``link.can`` of a scenario says how it is used.

    Attributes:
        title: its name in sentences.
        largest_node_id: largest address that a drive can have.
        has_fd_process_data: its cyclic frames can be those of CAN FD.
        takes_targets: its drives close loops around targets that come with the torques.
        answers_torques: its drives send their states in answer to torques, too.
        settings_type: keys of ``link.can.settings``, for protocols of packages; None for no keys.
        master: master of drives that speak it; the arguments are those of `CanMaster`.
    """

    title: str
    largest_node_id = 127
    has_fd_process_data = False
    takes_targets = False
    answers_torques = False
    settings_type: type[BaseModel] | None = None
    master: type[CanMaster]

    @abstractmethod
    def codec(
        self, can: CanConfiguration, robot: RobotDescription, gains: DriveGains | None = None
    ) -> CanCodec:
        """The frames of a control cycle, in the mode that the master of these drives uses.

        Args:
            can: section ``link.can`` of the scenario.
            robot: the robot.
            gains: of the loops that the drives close, where `takes_targets`; None for torques.

        Raises:
            ConfigurationError: a value does not fit the robot, or drives cannot have such gains.
        """

    def check(self, can: CanConfiguration, *, takes_targets: bool) -> None:  # noqa: ARG002
        """Check the description of the drives.

        Args:
            can: section ``link.can`` of the scenario.
            takes_targets: whether targets come with the torques.

        Raises:
            ConfigurationError: it cannot be used.
        """
        if can.eds is not None:
            raise ConfigurationError(
                "link.can.eds", can.eds, f"must be left out with {self.title}, which has no EDS",
                ["link.can.protocol"],
            )  # fmt: skip

    def settings(self, can: CanConfiguration) -> Any:
        """Return the section ``link.can.settings`` as `settings_type`; None where that is None.

        Raises:
            ConfigurationError: it has wrong keys or values.
        """
        key = "link.can.settings"
        if self.settings_type is None and can.settings is not None:
            allowed = f"must be left out with {self.title}, which has no such settings"
            raise ConfigurationError(key, can.settings, allowed, ["link.can.protocol"])
        if self.settings_type is None:
            return None
        return validated(key, self.settings_type, can.settings or {})

    def questions(self, can: CanConfiguration, node_id: int) -> Sequence[CanFrame]:  # noqa: ARG002
        """Frames that a drive answers and that change nothing; none if there are no such frames."""
        return ()

    def answer(self, frame: CanFrame) -> tuple[int, str, float] | None:  # noqa: ARG002
        """Return the answer to a question: address, name and value; None if it is no answer."""
        return None

    def expected_answers(
        self,
        can: CanConfiguration,  # noqa: ARG002 (most protocols have none)
        robot: RobotDescription,
    ) -> Sequence[Mapping[str, float]]:
        """Return the answers required of each joint's drive, as far as the scenario gives them."""
        return [{}] * robot.joints

    def warnings(
        self,
        can: CanConfiguration,  # noqa: ARG002 (most protocols have none)
        robot: RobotDescription,  # noqa: ARG002
        most_nm: Vector,  # noqa: ARG002
    ) -> list[str]:
        """Warnings for accepted but suspicious settings.

        Args:
            can: section ``link.can`` of the scenario.
            robot: the robot.
            most_nm: the largest torques that drives may be commanded, N m, shape (joints,).
        """
        return []

    def largest_torques_nm(
        self,
        can: CanConfiguration,  # noqa: ARG002 (for protocols whose numbers depend on it)
        robot: RobotDescription,
    ) -> Vector:
        """Return the largest torque of each joint's drive, N m, shape (joints,).

        Raises:
            ConfigurationError: a value does not fit the robot.
        """
        return robot.effort_limits_nm

    def own_settings(
        self,
        can: CanConfiguration,  # noqa: ARG002 (most protocols have none)
        robot: RobotDescription,
    ) -> tuple[Any, ...]:
        """Return the settings of this protocol alone, for the drive of each joint.

        Raises:
            ConfigurationError: their number differs from that of the joints.
        """
        return (None,) * robot.joints

    def node_ids(self, can: CanConfiguration, joints: int) -> tuple[int, ...]:
        """One address per joint.

        Raises:
            ConfigurationError: there are not as many as joints, or too large ones.
        """
        node_ids = can.node_ids_of(joints)
        if max(node_ids) > self.largest_node_id:
            raise ConfigurationError(
                "link.can.node_ids", list(node_ids),
                f"must be at most {self.largest_node_id} with {self.title}",
            )  # fmt: skip
        return node_ids


PROTOCOLS: Registry[type[DriveProtocol]] = Registry(
    "drive_protocols",
    "link.can.protocol",
    DriveProtocol,
    {
        "cia402": "bus_schema.can.cia402.protocol:Cia402Protocol",
        "cansimple": "bus_schema.can.cansimple.protocol:CanSimpleProtocol",
        "mit": "bus_schema.can.mit.protocol:MitProtocol",
        "damiao": "bus_schema.can.damiao.protocol:DamiaoProtocol",
        "moteus": "bus_schema.can.moteus.protocol:MoteusProtocol",
    },
)
"""The drives of each are in `plant_emulator.drives.commissioning.DRIVES`."""
