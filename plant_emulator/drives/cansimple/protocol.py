"""ODrive's CANSimple, as one of the protocols of motor drives."""

from __future__ import annotations

from bus_schema.can.cansimple_codec import CanSimpleCodec
from bus_schema.can.cansimple_master import CanSimpleMaster
from bus_schema.link.can_configuration import CanConfiguration
from bus_schema.robot_description import RobotDescription
from plant_emulator.drives.cansimple.cansimple_drive import CanSimpleDrive
from plant_emulator.drives.protocol import DriveProtocol


class CanSimpleProtocol(DriveProtocol):
    """CANSimple."""

    title = "CANSimple"
    largest_node_id = 63
    drive = CanSimpleDrive
    drive_master = CanSimpleMaster

    def codec(self, can: CanConfiguration, robot: RobotDescription) -> CanSimpleCodec:
        return CanSimpleCodec(self.node_ids(can, robot.joints))
