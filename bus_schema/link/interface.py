"""What a loop may ask of a bus: one small interface with two sides.

Messages cross it as CDR payloads, so that what a loop sends is what a recorder writes. Whoever
implements a side completely is on the bus: nobody asks what kind of link it is.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

from bus_schema.messages.topics import Role, Topic
from bus_schema.runtime.clock import Clock


class CommandArrival(NamedTuple):
    """A command as it came off the bus, not yet looked at.

    Attributes:
        payload: CDR bytes of a JointState, or whatever was sent in its place.
        sequence: number its sender gave it, from 1; 0 where the sender gave none.
        sender: identifier of the sending session.
        arrival_ns: arrival on the plant's clock.
    """

    payload: bytes
    sequence: int
    sender: bytes
    arrival_ns: int


def never() -> bool:
    """No stop is ever requested."""
    return False


class Link(Protocol):
    """What both sides have in common."""

    def publish(self, topic: Topic, payload: bytes) -> int:
        """Send a message; for a command, its number, from 1."""

    def await_recorder(
        self, timeout_s: float, is_stop_requested: Callable[[], bool] = never
    ) -> None:
        """Wait until a recorder is on the bus, or until asked to stop.

        Raises:
            PeerSilentError: none came within `timeout_s`, wall time.
        """

    def require_same_scenario(self, role: Role, wait_s: float = 0.0) -> None:
        """Check that a process of ours runs the same scenario, as far as it has said so.

        Args:
            role: which process.
            wait_s: how long one that has announced itself may take to say it, wall time.

        Raises:
            ScenarioMismatchError: it does not.
        """

    def await_recorded(self) -> None:
        """After an `ENDED` event: wait until a recorder, if there is one, has everything."""

    def close(self) -> None:
        """Leave the bus."""


SCENARIO_WAIT_S = 1.0
"""Within which one of our own processes says which scenario it runs: before a loop starts."""


class Telemetry(Link, Protocol):
    """Where everything else goes when states and commands travel another way."""

    def sees(self, role: Role) -> bool:
        """Whether one of our own processes is on the bus."""


class PlantLink(Link, Protocol):
    """The plant's side. Some of it has defaults, for links without them."""

    def await_controller(
        self, timeout_s: float, is_stop_requested: Callable[[], bool] = never
    ) -> None:
        """Wait until somebody is there to answer, or until asked to stop.

        Raises:
            PeerSilentError: nobody came within `timeout_s`, wall time.
        """

    def send_state(self, state: bytes, status: bytes) -> None:
        """Send a joint state with the plant status that belongs to it."""

    def wait_until(self, clock: Clock, instant_ns: int) -> int:
        """Let the clock reach an instant, and do what the link has to meanwhile; lateness in ns."""
        return clock.wait_until(instant_ns)

    def await_command(self, timeout_s: float) -> bool:
        """Wait for a command that was not yet taken; whether there is one."""

    def take_commands(self) -> list[CommandArrival]:
        """All commands that arrived since the last call, in order of arrival."""

    def overflow(self) -> int:
        """How many commands were left out, because too many waited to be taken."""
        return 0

    def controller_has_left(self) -> bool:
        """Whether the controller was on the bus and is there no longer."""

    def controller_loss(self) -> str:
        """What has become of a controller that is there no longer, in a sentence."""
        return "the controller has left the bus"

    def sender_has_left(self, sender: bytes) -> bool:
        """Whether the session that sends commands as `sender` was on the bus and is gone."""

    def may_miss_states(self) -> bool:
        """Whether the controller may not hear the first states, never having said it is ready."""
        return False

    def fault(self) -> str | None:
        """Why the arm must stop now, as the bus or a drive on it reports; None if all is well."""
        return None

    def report(self) -> dict[str, Any]:
        """What the link has to add to the transport's counts."""
        return {}


StateHandler = Callable[[bytes, bytes | None], None]
"""Called with a joint state and, where its sender gave one, the plant status that belongs to it."""


class ControllerLink(Link, Protocol):
    """The controller's side.

    Attributes:
        start_ns: when the run begins, on the clock of the states' stamps; None where only the
            plant says so, with its states.
        cycle_ns: the cycle it is in, on the same clock, which may never come to a state; -1 where
            a state is all that makes a cycle.
    """

    start_ns: int | None = None
    cycle_ns: int = -1

    def serve(self, on_state: StateHandler) -> None:
        """Have `on_state` called for each joint state that arrives, one at a time."""

    def activate(self) -> None:
        """Announce that states will be answered from now on, which lets the plant start."""

    def spin(self, is_stop_requested: Callable[[], bool] = never) -> None:
        """Answer joint states to the end of the run, or until asked to stop.

        Raises:
            BusError: the plant never came or went silent, a drive failed, or the bus was lost.
            Exception: whatever the handler of states raised.
        """
