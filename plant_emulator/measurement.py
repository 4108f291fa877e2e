"""The plant's measurements at a tick, as messages for the controller."""

from __future__ import annotations

from typing import NamedTuple

from bus_schema.messages import topics
from bus_schema.messages.record import Record
from bus_schema.runtime.compiled import copying
from plant_emulator.arm_plant import ArmPlant


class Measurement(NamedTuple):
    """A joint state and its plant status, on their way to the controller."""

    stamp_ns: int
    state: bytes
    status: bytes


class Instruments:
    """Encoders and torque sensors of an arm, and the plant's report of the current command.

    Args:
        joint_names: names of the joints.
        arm: the arm.
    """

    def __init__(self, joint_names: tuple[str, ...], arm: ArmPlant) -> None:
        self._arm = arm
        self._state = Record(topics.layout(topics.JOINT_STATES, joint_names))
        self._status = Record(topics.layout(topics.PLANT_STATUS, joint_names))
        # Views take a third of the time of NumPy's copies, at every tick.
        self._take_motion = copying(arm.measured, self._state.rows("position", "velocity"))
        self._take_effort = copying(arm.torques.actuator, self._state.fields["effort"])
        self._payload = b""

    def read(self, stamp_ns: int) -> None:
        """Read encoders and torque sensors at an instant."""
        self._state.stamp_ns = stamp_ns
        self._arm.read_encoders(stamp_ns)
        self._take_motion()
        self._take_effort()
        self._payload = self._state.payload()

    def measure(
        self,
        stamp_ns: int,
        command_sequence: int,
        command_age_ns: int,
        command_delay_ns: int,
        arrival_delay_ns: int,
    ) -> Measurement:
        """Return the latest reading, with the current command.

        Args:
            stamp_ns: instant of the reading.
            command_sequence: number of the command in force, 0 without one.
            command_age_ns: age of the state that it answers; -1 without one.
            command_delay_ns: that age when the command came into force.
            arrival_delay_ns: largest such age of the commands since the last state, at arrival.
        """
        status = self._status
        status.stamp[:] = self._state.stamp
        scalars = status.scalars  # the run starts at 0 on the plant's clock
        scalars.mode = self._arm.mode
        scalars.command_sequence = command_sequence
        scalars.command_age_ns = command_age_ns
        scalars.command_delay_ns = command_delay_ns
        scalars.arrival_delay_ns = arrival_delay_ns
        return Measurement(stamp_ns, self._payload, status.payload())
