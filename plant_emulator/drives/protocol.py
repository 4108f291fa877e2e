"""Protocols of motor drives: what each consists of, and the table of them."""

from __future__ import annotations

from abc import ABC, abstractmethod

from bus_schema.arrays import Vector
from bus_schema.can.codec import CanCodec
from bus_schema.can.frame import CanBus
from bus_schema.can.master import CanMaster
from bus_schema.configuration import ConfigurationError
from bus_schema.drive_feedback import DriveGains
from bus_schema.link.can_configuration import CanConfiguration
from bus_schema.registry import Registry
from bus_schema.robot_description import RobotDescription
from plant_emulator.drives.drive import Drive


class DriveProtocol(ABC):
    """A protocol of motor drives; section ``link.can`` of a scenario says how it is used.

    Attributes:
        title: its name in sentences.
        largest_node_id: largest address that a drive can have.
        has_fd_process_data: its cyclic frames can be those of CAN FD.
        takes_targets: its drives close loops around targets that come with the torques.
        answers_torques: its drives send their states in answer to torques, too.
        drive: emulated drives that speak it.
        drive_master: master of drives that speak it, unless `master` makes another one.
    """

    title: str
    largest_node_id = 127
    has_fd_process_data = False
    takes_targets = False
    answers_torques = False
    drive: type[Drive]
    drive_master: type[CanMaster]

    @abstractmethod
    def codec(self, can: CanConfiguration, robot: RobotDescription) -> CanCodec:
        """The frames of a control cycle.

        Raises:
            ConfigurationError: a value does not fit the robot.
        """

    def master(self, bus: CanBus, can: CanConfiguration, robot: RobotDescription) -> CanMaster:
        """A master of drives on `bus`.

        Raises:
            ConfigurationError: a value does not fit the robot.
        """
        node_ids = self.node_ids(can, robot.joints)
        return self.drive_master(bus, can, node_ids, self.codec(can, robot))

    def target_codec(
        self,
        can: CanConfiguration,
        robot: RobotDescription,
        gains: DriveGains,  # noqa: ARG002 (frames of this protocol may carry none)
    ) -> CanCodec:
        """The frames of a control cycle with targets, where `takes_targets`.

        Raises:
            ConfigurationError: a value does not fit the robot, or gains cannot be had.
        """
        return self.codec(can, robot)

    def target_master(
        self,
        bus: CanBus,
        can: CanConfiguration,
        robot: RobotDescription,
        gains: DriveGains,  # noqa: ARG002 (likewise)
    ) -> CanMaster:
        """A master that sends targets too."""
        return self.master(bus, can, robot)

    def check(self, can: CanConfiguration) -> None:  # noqa: B027 (a protocol may have none)
        """Check values that concern this protocol alone.

        Raises:
            ConfigurationError: one cannot be used.
        """

    def check_gains(self, can: CanConfiguration, gains: DriveGains) -> None:  # noqa: B027
        """Check the gains of drives that take targets.

        Raises:
            ConfigurationError: a frame cannot say them.
        """

    def oddities(
        self,
        can: CanConfiguration,  # noqa: ARG002 (most protocols have none)
        robot: RobotDescription,  # noqa: ARG002
        most_nm: Vector,  # noqa: ARG002
    ) -> list[str]:
        """A sentence for each thing that is taken, but that may not be what was meant.

        Args:
            can: section ``link.can`` of the scenario.
            robot: the robot.
            most_nm: the largest torques that drives may be told to give, N m, shape (joints,).
        """
        return []

    def own_settings(self, can: CanConfiguration, joints: int) -> tuple[object, ...]:  # noqa: ARG002
        """What drives of this protocol alone are set to, one for each joint.

        Raises:
            ConfigurationError: there are not as many values as joints.
        """
        return (None,) * joints

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


PROTOCOLS: Registry[DriveProtocol] = Registry(
    "link.can.protocol",
    {
        "cia402": "plant_emulator.drives.cia402.protocol:Cia402Protocol",
        "cansimple": "plant_emulator.drives.cansimple.protocol:CanSimpleProtocol",
        "mit": "plant_emulator.drives.mit.protocol:MitProtocol",
    },
)
