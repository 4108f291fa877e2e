"""An ODrive axis with the CANSimple protocol, from ODrive's public description.

CANSimple has no SYNC: estimates go out every 10 ms as a factory-fresh axis sends them, and at
once whenever they are asked for by a remote frame, which is how a controller samples an axis.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import cantools
from cantools.database.can import Database, Message
from cantools.database.errors import Error as CantoolsError

from bus_schema.can.cansimple.codec import COMMAND_BITS, identifier
from bus_schema.can.frame import CanFrame
from bus_schema.errors import InvalidMessageError
from bus_schema.link.can_configuration import CANSIMPLE_DBC, CanSimpleConfiguration
from plant_emulator.drives.cansimple.axis import Axis, AxisError
from plant_emulator.drives.drive import Cycle, DriveSettings, Send

HEARTBEAT_MS, ESTIMATES_MS = 100, 10
_MS = 1_000_000
_COMMANDS = (1 << COMMAND_BITS) - 1
_AXIS = "Axis"


@cache
def load_database() -> Database:
    """The messages, for node 0."""
    database = cantools.database.load_file(CANSIMPLE_DBC)
    assert isinstance(database, Database)  # a DBC describes a CAN bus
    return database


@cache
def _messages() -> dict[int, Message]:
    return {message.frame_id: message for message in load_database().messages}


class CanSimpleDrive(Axis):
    """An axis with its bus side: messages in and out."""

    def __init__(self, settings: DriveSettings[CanSimpleConfiguration], send: Send) -> None:
        super().__init__(settings, send)
        self._node_id = settings.node_id
        self.identifiers = range(identifier(self._node_id, 0), identifier(self._node_id + 1, 0))
        self._heartbeats = Cycle(HEARTBEAT_MS * _MS)
        self._unasked_estimates = Cycle(0 if settings.is_polled else ESTIMATES_MS * _MS)
        scales = settings.own
        # The DBC has the feed-forwards in thousandths, as an axis is delivered.
        steps_s, steps_nm = 1e3 / scales.input_vel_scale, 1e3 / scales.input_torque_scale
        # Each takes the signals of its message in the order of the DBC.
        self._takers: dict[str, Callable[..., None]] = {
            "Estop": lambda: self._disarm(AxisError.ESTOP_REQUESTED),
            "Set_Axis_State": self.request,
            "Set_Controller_Mode": self.set_mode,
            "Set_Input_Pos": lambda turns, turns_s, torque_nm: self.set_input(
                torque_nm * steps_nm, turns_s * steps_s, turns
            ),
            "Set_Input_Vel": lambda turns_s, torque_nm: self.set_input(torque_nm, turns_s),
            "Set_Input_Torque": self.set_input,
            "Set_Pos_Gain": self.set_position_gain,
            "Set_Vel_Gains": self.set_velocity_gains,
            "Set_Limits": self.set_limits,
            "Set_Absolute_Position": self.set_absolute_position,
            "Reboot": self.reboot,
            "Clear_Errors": lambda _identify: self.clear_errors(),
        }

    def receive(self, frame: CanFrame, now_ns: int) -> bool:
        if self._is_off_bus or frame.identifier >> COMMAND_BITS != self._node_id:
            return False
        message = _messages().get(frame.identifier & _COMMANDS)
        if message is None:
            raise InvalidMessageError("unknown_command", f"CANSimple has no such command: {frame}")
        if message.name not in self.reports and message.name not in self._takers:
            raise InvalidMessageError("not_there", f"this axis has no use for {message.name}")
        if _AXIS in message.senders:
            self._answer(message, frame)
        else:
            self._take(message, frame)
        self._fed_ns = now_ns
        return True

    def advance(self, now_ns: int) -> None:
        super().advance(now_ns)
        if self._heartbeats.is_due(now_ns):
            self._report("Heartbeat")
        if self._unasked_estimates.is_due(now_ns):
            self._report("Get_Encoder_Estimates")

    def describe(self, frame: CanFrame) -> str | None:
        if frame.identifier >> COMMAND_BITS != self._node_id:
            return None
        message = _messages().get(frame.identifier & _COMMANDS)
        if message is None:
            return None
        text = f"axis {self._node_id} {message.name}"
        if frame.is_remote:
            return f"{text} asked for"
        try:
            values = _decode(message, frame.data)
        except InvalidMessageError as error:
            return f"{text} ({error})"
        return ", ".join([text, *(f"{name} {value}" for name, value in values.items())])

    def _answer(self, message: Message, frame: CanFrame) -> None:
        """Answer a request for a report: a remote frame, or one without data."""
        if frame.data:
            raise InvalidMessageError("not_a_command", f"only an axis sends {message.name}")
        self._report(message.name)
        if message.name == "Get_Encoder_Estimates":
            self.samplings += 1

    def _take(self, message: Message, frame: CanFrame) -> None:
        if frame.is_remote:
            raise InvalidMessageError("not_readable", f"{message.name} cannot be asked for")
        self._takers[message.name](*_decode(message, frame.data).values())

    def _report(self, name: str) -> None:
        message = load_database().get_message_by_name(name)
        data = message.encode(self.reports[name]())
        self._transmit(CanFrame(identifier(self._node_id, message.frame_id), data))


def _decode(message: Message, data: bytes) -> dict[str, Any]:
    """Signals of a message, enumerated ones as numbers; bytes beyond it are padding.

    Raises:
        InvalidMessageError: it is too short, or a number in it is not finite.
    """
    try:
        values: dict[str, Any] = message.decode(  # type: ignore[assignment]
            data[: message.length], decode_choices=False
        )
    except CantoolsError as error:
        raise InvalidMessageError("too_short", f"{message.name}: {error}") from error
    if not all(math.isfinite(value) for value in values.values()):
        raise InvalidMessageError("not_finite", f"{message.name}: {values}")
    return values
