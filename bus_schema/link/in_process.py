"""Both sides of a bus inside one process and one thread: a message is a function call.

It models no transport: nothing is delayed, lost or reordered here. A state is answered before
`send_state` returns.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from bus_schema.errors import PeerSilentError
from bus_schema.link.interface import CommandArrival, StateHandler, never
from bus_schema.messages.topics import JOINT_COMMANDS, JOINT_STATES, PLANT_STATUS, Role, Topic
from bus_schema.runtime.clock import Clock


class InProcessBus:
    """A bus with one plant and one controller, which remembers everything.

    Attributes:
        topics: topic of each message that was on the bus, in order.
        payloads: its payload. Two flat lists: with no container per message, Python's garbage
            collector finds nothing to do while a loop runs.
        on_state: the controller; None before it came and after it failed.
        failure: the exception that ended the controller's service of states, if any.
        commands_sent: number of the newest command.
        commands: commands that the plant has not taken yet.
    """

    def __init__(self, plant_clock: Clock) -> None:
        self._clock = plant_clock
        self.commands_sent = 0
        self.topics: list[Topic] = []
        self.payloads: list[bytes] = []
        self.on_state: StateHandler | None = None
        self.failure: Exception | None = None
        self.commands: list[CommandArrival] = []

    def publish(self, topic: Topic, payload: bytes) -> int:
        """Put a message on the bus; its number if it is a command, which alone are counted here."""
        self.topics.append(topic)
        self.payloads.append(payload)
        if topic is not JOINT_COMMANDS:
            return 0
        self.commands_sent = sequence = self.commands_sent + 1
        self.commands.append(CommandArrival(payload, sequence, b"", self._clock.now_ns()))
        return sequence


class InProcessPlantLink:
    """The plant's side of an `InProcessBus`."""

    def __init__(self, bus: InProcessBus) -> None:
        self._bus = bus
        self.publish = bus.publish

    def await_controller(
        self,
        timeout_s: float,
        is_stop_requested: Callable[[], bool] = never,  # noqa: ARG002 (the interface)
    ) -> None:
        if self._bus.on_state is None:
            raise PeerSilentError("controller", timeout_s, "handler of joint states")

    def send_state(self, state: bytes, status: bytes) -> None:
        bus = self._bus
        bus.topics += PLANT_STATUS, JOINT_STATES
        bus.payloads += status, state
        if bus.on_state is None:
            return
        try:
            bus.on_state(state, status)
        except Exception as error:  # noqa: BLE001 (as on any bus, it ends the controller alone)
            bus.on_state, bus.failure = None, error

    def await_command(self, timeout_s: float) -> bool:  # noqa: ARG002 (the interface)
        return bool(self._bus.commands)

    def controller_has_left(self) -> bool:
        # A controller that has not answered by now never will: there is no other thread.
        return not self._bus.commands

    def sender_has_left(self, sender: bytes) -> bool:  # noqa: ARG002 (the interface)
        return self._bus.on_state is None

    def take_commands(self) -> list[CommandArrival]:
        taken = self._bus.commands
        if taken:
            self._bus.commands = []
        return taken

    def overflow(self) -> int:
        return 0

    def fault(self) -> str | None:
        return None

    def report(self) -> dict[str, Any]:
        return {}

    def close(self) -> None:
        """Nothing to close."""


class InProcessControllerLink:
    """The controller's side of an `InProcessBus`."""

    def __init__(self, bus: InProcessBus) -> None:
        self._bus = bus
        self.publish = bus.publish

    def serve(self, on_state: StateHandler) -> None:
        self._bus.on_state = on_state

    def close(self) -> None:
        self._bus.on_state = None


class InProcessTelemetry:
    """Telemetry of loops whose states and torques go over CAN: to an `InProcessBus`.

    Attributes:
        controller_is_there: whether the controller is still at work.
    """

    def __init__(self, bus: InProcessBus) -> None:
        self.publish = bus.publish
        self.controller_is_there = True

    def sees(self, role: Role) -> bool:
        return role is not Role.CONTROLLER or self.controller_is_there

    def await_recorder(self, timeout_s: float, is_stop_requested: Callable[[], bool]) -> None:
        """There is nobody to wait for."""

    def await_recorded(self) -> None:
        """There is nobody to wait for."""

    def close(self) -> None:
        """Nothing to close."""
