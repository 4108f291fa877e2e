"""Both sides of a bus inside one process and one thread: a message is a function call.

It models no transport: nothing is delayed, lost or reordered here. A state is answered before
`send_state` returns.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from bus_schema.clock import Clock
from bus_schema.errors import PeerSilentError
from bus_schema.link import CommandArrival, StateHandler, never
from bus_schema.topics import JOINT_COMMANDS, JOINT_STATES, PLANT_STATUS, Topic

Tap = Callable[[Topic, int, bytes], None]
"""Called with every message on the bus: topic, sequence number, payload."""


class InProcessBus:
    """A bus with one plant, one controller and an optional listener to everything."""

    def __init__(self, plant_clock: Clock, tap: Tap | None = None) -> None:
        self._clock = plant_clock
        self._tap = tap
        self._counts: Counter[str] = Counter()
        self.on_state: StateHandler | None = None
        self.commands: list[CommandArrival] = []

    def publish(self, topic: Topic, payload: bytes) -> int:
        name = topic.name
        self._counts[name] = sequence = self._counts[name] + 1
        if self._tap is not None:
            self._tap(topic, sequence, payload)
        if topic is JOINT_COMMANDS:
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
        self.publish(PLANT_STATUS, status)
        self.publish(JOINT_STATES, state)
        if self._bus.on_state is not None:
            self._bus.on_state(state, status)

    def await_command(self, timeout_s: float) -> bool:  # noqa: ARG002 (the interface)
        return bool(self._bus.commands)

    def controller_has_left(self) -> bool:
        # A controller that has not answered by now never will: there is no other thread.
        return not self._bus.commands

    def take_commands(self) -> list[CommandArrival]:
        taken, self._bus.commands = self._bus.commands, []
        return taken

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
