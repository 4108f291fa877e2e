"""moteus controllers: their settings in a scenario, and their master."""

from __future__ import annotations

from collections.abc import Sequence

from bus_schema.arrays import Vector
from bus_schema.can.frame import CanFrame
from bus_schema.can.master import CanMaster
from bus_schema.can.moteus.codec import BROADCAST, MoteusCodec, query_frame, state_of
from bus_schema.can.protocol import DriveProtocol
from bus_schema.can.request_master import RequestMaster
from bus_schema.configuration import ConfigurationError
from bus_schema.drive_feedback import DriveGains
from bus_schema.link.can_configuration import CanConfiguration
from bus_schema.robot_description import RobotDescription


class MoteusMaster(RequestMaster):
    """The master, whose address is 0; the arguments are those of `CanMaster`.

    A stop clears the faults of a drive, and the first command starts it. Drives do not answer
    commands.
    """

    _codec: MoteusCodec

    def _stop_requests(self) -> Sequence[CanFrame]:
        return [query_frame(node_id, stops=True) for node_id in self._node_ids]

    def command(self, torque_nm: Vector) -> None:
        if self._is_stopping:
            self._send(self._codec.stop_frames())
        else:
            CanMaster.command(self, torque_nm)


class MoteusProtocol(DriveProtocol):
    """Position mode, in which torques alone are commands without gains."""

    title = "moteus"
    largest_node_id = BROADCAST - 1
    has_fd_process_data = True
    takes_targets = True
    master = MoteusMaster

    def codec(
        self, can: CanConfiguration, robot: RobotDescription, gains: DriveGains | None = None
    ) -> MoteusCodec:
        node_ids = self.node_ids(can, robot.joints)
        return MoteusCodec(node_ids, 1e-3 * can.command_timeout_ms, has_gains=gains is not None)

    def check(self, can: CanConfiguration, *, takes_targets: bool) -> None:
        super().check(can, takes_targets=takes_targets)
        if not can.fd_process_data:
            raise ConfigurationError(
                "link.can.fd_process_data", False,
                f"must be true with {self.title}, whose frames are longer than 8 bytes",
                ["link.can.protocol", "link.can.fd"],
            )  # fmt: skip

    def questions(self, can: CanConfiguration, node_id: int) -> Sequence[CanFrame]:  # noqa: ARG002
        return [query_frame(node_id)]

    def answer(self, frame: CanFrame) -> tuple[int, str, float] | None:
        state = state_of(frame)
        return None if state is None else (state.node_id, "error", float(state.error))
