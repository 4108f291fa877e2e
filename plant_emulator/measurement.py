"""What the plant measures at a tick, in the messages that take it to the controller."""

from __future__ import annotations

from typing import NamedTuple

from bus_schema.messages import topics
from bus_schema.messages.layout import Record
from bus_schema.runtime.compiled import copying
from plant_emulator.arm_plant import ArmPlant


class Measurement(NamedTuple):
    """A joint state with the plant status that belongs to it, on its way to the controller."""

    stamp_ns: int
    state: bytes
    status: bytes


class Instruments:
    """Encoders and torque sensors of an arm, and what the plant says of the command in force.

    Args:
        joint_names: names of the joints.
        arm: the arm.
    """

    def __init__(self, joint_names: tuple[str, ...], arm: ArmPlant) -> None:
        self._arm = arm
        self._state = Record(topics.layout(topics.JOINT_STATES, joint_names))
        self._status = Record(topics.layout(topics.PLANT_STATUS, joint_names))
        # A third of what NumPy's copies would take, at every tick.
        self._take_motion = copying(arm.measured, self._state.rows("position", "velocity"))
        self._take_effort = copying(arm.torques.actuator, self._state.fields["effort"])
        self._payload = b""

    def read(self, stamp_ns: int) -> None:
        """Read encoders and torque sensors, as they are at an instant."""
        self._state.stamp_ns = stamp_ns
        self._arm.read_encoders(stamp_ns)
        self._take_motion()
        self._take_effort()
        self._payload = self._state.payload()

    def measure(
        self, stamp_ns: int, command_sequence: int, command_age_ns: int, command_delay_ns: int
    ) -> Measurement:
        """What was read last, with what is in force now.

        Args:
            stamp_ns: instant that was read for.
            command_sequence: number of the command in force, 0 without one.
            command_age_ns: age of the state that it answers; -1 without one.
            command_delay_ns: the same when it came into force.
        """
        status = self._status
        status.stamp[:] = self._state.stamp
        scalars = status.scalars  # the run starts at 0 on its own clock
        scalars.mode = self._arm.mode
        scalars.command_sequence = command_sequence
        scalars.command_age_ns = command_age_ns
        scalars.command_delay_ns = command_delay_ns
        return Measurement(stamp_ns, self._payload, status.payload())
