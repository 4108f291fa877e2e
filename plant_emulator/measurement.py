"""What the plant measures at a tick, in the messages that take it to the controller."""

from __future__ import annotations

from typing import NamedTuple

from bus_schema.messages import topics
from bus_schema.messages.layout import Record
from bus_schema.runtime.compiled import copying
from plant_emulator.arm.arm_plant import ArmPlant
from plant_emulator.command_path import CommandSide

_START_S, _START_NS = 0, 0
"""When a run starts on its own clock."""


class Measurement(NamedTuple):
    """A joint state with the plant status that belongs to it, on its way to the controller."""

    stamp_ns: int
    state: bytes
    status: bytes


class Instruments:
    """Encoders and torque sensors of an arm, and what the plant says of the command in force.

    Args:
        joint_names: names of the joints.
        arm: the arm; its encoders write into the message from now on.
        commands: where the command in force came from.
    """

    def __init__(self, joint_names: tuple[str, ...], arm: ArmPlant, commands: CommandSide) -> None:
        self._arm, self._commands = arm, commands
        self._state = Record(topics.layout(topics.JOINT_STATES, joint_names))
        self._status = Record(topics.layout(topics.PLANT_STATUS, joint_names))
        self._show_effort = copying(arm.torques.actuator, self._state.fields["effort"])
        arm.attach_encoders(self._state.matrix("position", "velocity"))

    def measure(self, stamp_ns: int, command_age_ns: int) -> Measurement:
        """Measure the joints.

        Args:
            stamp_ns: now.
            command_age_ns: age of the state that the command in force answers; -1 without one.
        """
        state, status, commands = self._state, self._status, self._commands
        state.stamp_ns = stamp_ns
        status.stamp[0] = state.stamp[0]
        self._arm.read_encoders(stamp_ns)
        self._show_effort()
        status.put_scalars(
            _START_S, _START_NS, self._arm.mode,
            commands.sequence, command_age_ns, commands.delay_ns,
        )  # fmt: skip
        return Measurement(stamp_ns, state.payload(), status.payload())
