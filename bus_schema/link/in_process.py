"""Both sides of a bus inside one process: a message is a function call.

It models no transport: nothing is delayed, lost or reordered here. A state is answered, on the
plant's thread, before `send_state` returns.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from itertools import count

from bus_schema.errors import PeerSilentError
from bus_schema.link.interface import (
    CommandArrival,
    CommandSessions,
    ControllerLink,
    PlantLink,
    StateHandler,
    never,
)
from bus_schema.messages.topics import JOINT_COMMANDS, JOINT_STATES, PLANT_STATUS, Role, Topic
from bus_schema.runtime.clock import Clock

_POLL_S = 1.0
"""Period of the check for stop requests; each check makes the plant's thread wait."""


class InProcessBus:
    """A bus with one plant and one controller, which records all messages.

    It holds what both sides share; `InProcessPlantLink` and `InProcessControllerLink` use it.

    Attributes:
        clock: the plant's clock, which stamps commands as they arrive.
        topics: topic of each message that was on the bus, in order.
        payloads: its payload. Two flat lists: with no container per message, Python's garbage
            collector finds nothing to do while a loop runs.
        commands: commands that the plant has not taken yet.
        numbers: sequence numbers of future commands, from 1.
        on_state: the controller's handler; None before it joined and after it left or failed.
        failure: the exception that ended the controller's service of states, if any.
        controller_loss: how an injected fault ended the controller, a sentence; empty without one.
        has_left: by role, set once that side has left.
        is_over: set once the controller has no more states to answer.
    """

    def __init__(self, plant_clock: Clock) -> None:
        self.clock = plant_clock
        self.topics: list[Topic] = []
        self.payloads: list[bytes] = []
        self.commands: list[CommandArrival] = []
        self.numbers = count(1)
        self.on_state: StateHandler | None = None
        self.failure: Exception | None = None
        self.controller_loss = ""
        self.has_left = {role: threading.Event() for role in Role}
        self.is_over = threading.Event()

    def leave(self, role: Role) -> None:
        """Remove one side; without its controller, states are no longer answered."""
        if role is Role.CONTROLLER:
            self.on_state = None
        self.has_left[role].set()
        if role is Role.PLANT:
            self.is_over.set()


class InProcessNode:
    """One side of an `InProcessBus`; by itself, telemetry of loops with another link for states."""

    def __init__(self, bus: InProcessBus, role: Role) -> None:
        self._bus, self._role = bus, role

    def publish(self, topic: Topic, payload: bytes) -> int:
        """Put a message on the bus; return its number if it is a command (others have none)."""
        bus = self._bus
        bus.topics.append(topic)
        bus.payloads.append(payload)
        if topic is not JOINT_COMMANDS:
            return 0
        sequence = next(bus.numbers)
        bus.commands.append(CommandArrival(payload, sequence, b"", bus.clock.now_ns()))
        return sequence

    def sees(self, role: Role) -> bool:
        return not self._bus.has_left[role].is_set()

    def require_same_scenario(self, role: Role, wait_s: float = 0.0) -> None:
        """Do nothing: one process has only one scenario."""

    def await_recorder(
        self, timeout_s: float, is_stop_requested: Callable[[], bool] = never
    ) -> None:
        """Do nothing: the bus itself records everything."""

    def await_recorded(self) -> None:
        """Do nothing: the bus itself records everything."""

    def close(self) -> None:
        self._bus.leave(self._role)


class InProcessPlantLink(InProcessNode, PlantLink, CommandSessions):
    """The plant's side of an `InProcessBus`."""

    def __init__(self, bus: InProcessBus) -> None:
        super().__init__(bus, Role.PLANT)

    @property
    def sessions(self) -> CommandSessions:
        return self

    def await_controller(
        self,
        timeout_s: float,
        is_stop_requested: Callable[[], bool] = never,  # noqa: ARG002 (the interface)
    ) -> None:
        if self._bus.on_state is None:
            raise PeerSilentError("controller", timeout_s, "handler of joint states")

    def send_state(self, state: bytes, status: bytes) -> None:
        bus = self._bus
        bus.topics.extend((PLANT_STATUS, JOINT_STATES))
        bus.payloads.extend((status, state))
        if bus.on_state is None:
            return
        try:
            bus.on_state(state, status)
        except Exception as error:  # noqa: BLE001 (as on any bus, it ends the controller alone)
            bus.on_state, bus.failure = None, error
            bus.is_over.set()

    def await_command(self, timeout_s: float) -> bool:  # noqa: ARG002 (the interface)
        return bool(self._bus.commands)

    def take_commands(self) -> list[CommandArrival]:
        commands = self._bus.commands
        if not commands:
            return []
        taken = commands.copy()
        del commands[: len(taken)]  # a command that arrives meanwhile is kept
        return taken

    def controller_has_left(self) -> bool:
        # States are answered at once: a controller that has not answered by now never will.
        return not self._bus.commands

    def controller_loss(self) -> str:
        return self._bus.controller_loss or super().controller_loss()

    def sender_has_left(self, sender: bytes) -> bool:  # noqa: ARG002 (the interface)
        return self._bus.on_state is None


class InProcessControllerLink(InProcessNode, ControllerLink):
    """The controller's side of an `InProcessBus`."""

    def __init__(self, bus: InProcessBus) -> None:
        super().__init__(bus, Role.CONTROLLER)

    def serve(self, on_state: StateHandler) -> None:
        self._bus.on_state = on_state

    def activate(self) -> None:
        """Do nothing: no one waits for an announcement."""

    def spin(self, is_stop_requested: Callable[[], bool] = never) -> None:
        """Wait until the plant has left; the plant's thread calls the handler of states."""
        while not self._bus.is_over.wait(_POLL_S):
            if is_stop_requested():
                break
        if self._bus.failure is not None:
            raise self._bus.failure
