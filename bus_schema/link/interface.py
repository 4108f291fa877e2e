"""The interface between a loop and a bus, with two sides.

Messages cross it as CDR payloads, so a recorder writes exactly the bytes that a loop sends. A class
that implements a side completely can serve as a link; no code asks for its type.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

from bus_schema.messages.topics import Role, Topic
from bus_schema.runtime.clock import Clock


class CommandArrival(NamedTuple):
    """A command as it came off the bus, not yet decoded.

    Attributes:
        payload: CDR bytes of a JointState, or anything else that was sent on its topic.
        sequence: number its sender gave it, from 1; 0 where the sender gave none.
        sender: identifier of the sending session.
        arrival_ns: arrival on the plant's clock.
        attachment: attachment of the message, as it was received.
    """

    payload: bytes
    sequence: int
    sender: bytes
    arrival_ns: int
    attachment: bytes = b""


def never() -> bool:
    """Never request a stop."""
    return False


class Link(Protocol):
    """Methods common to both sides."""

    def publish(self, topic: Topic, payload: bytes) -> int:
        """Send a message; return a command's number, from 1."""

    def await_recorder(
        self, timeout_s: float, is_stop_requested: Callable[[], bool] = never
    ) -> None:
        """Wait until a recorder is on the bus, or until asked to stop.

        Raises:
            PeerSilentError: none joined within `timeout_s`, wall time.
        """

    def require_same_scenario(self, role: Role, wait_s: float = 0.0) -> None:
        """Check that our own process of this role runs the same scenario, if it has announced one.

        Args:
            role: which process.
            wait_s: wall time that an announced process has to announce its scenario.

        Raises:
            ScenarioMismatchError: it runs another one.
        """

    def await_recorded(self) -> None:
        """Wait, after an `ENDED` event, until the recorder, if any, has everything."""

    def close(self) -> None:
        """Leave the bus."""


SCENARIO_WAIT_S = 1.0
"""Time in which one of our own processes announces its scenario, before a loop starts."""


class Telemetry(Link, Protocol):
    """Sends a loop's other messages when states and commands travel another way."""

    def sees(self, role: Role) -> bool:
        """Whether one of our own processes is on the bus."""


class CommandSessions:
    """Facts about the sessions that send commands; these are the facts of a bus without any."""

    def note_commander(self, sender: bytes) -> None:
        """Note that the plant accepts commands of this sender from now on, and of no other."""
        del sender

    def overflow(self) -> int:
        """Return the number of commands dropped because too many waited to be taken."""
        return 0

    def sender_has_left(self, sender: bytes) -> bool:  # noqa: ARG002 (it is no session)
        """Whether the session that sends commands as `sender` was on the bus and has left."""
        return False

    def may_miss_states(self) -> bool:
        """Whether the controller may miss the first states, having never announced itself ready."""
        return False


_NO_SESSIONS = CommandSessions()


class PlantLink(Link, Protocol):
    """The plant's side. Some methods have defaults, for links that do not need them."""

    @property
    def sessions(self) -> CommandSessions:
        """The sessions that send commands; a bus whose frames name no sender has none."""
        return _NO_SESSIONS

    def await_controller(
        self, timeout_s: float, is_stop_requested: Callable[[], bool] = never
    ) -> None:
        """Wait until a controller is ready to answer, or until asked to stop.

        Raises:
            PeerSilentError: none joined within `timeout_s`, wall time.
        """

    def send_state(self, state: bytes, status: bytes) -> None:
        """Send a joint state with the plant status that belongs to it."""

    def wait_until(self, clock: Clock, instant_ns: int) -> int:
        """Wait until an instant while doing the link's own work; return the lateness in ns."""
        return clock.wait_until(instant_ns)

    def await_command(self, timeout_s: float) -> bool:
        """Wait for a command that is not yet taken; return whether there is one."""

    def take_commands(self) -> list[CommandArrival]:
        """Return all commands that arrived since the last call, in order of arrival."""

    def controller_has_left(self) -> bool:
        """Whether the controller was on the bus and has left."""

    def controller_loss(self) -> str:
        """Explain in a sentence why the controller has left."""
        return "the controller has left the bus"

    def fault(self) -> str | None:
        """Reason why the arm must stop now, reported by the bus or a drive; None if all is well."""
        return None

    def report(self) -> dict[str, Any]:
        """Return the link's own counts for the report of the transport."""
        return {}


StateHandler = Callable[[bytes, bytes | None], None]
"""Called with a joint state and, if its sender added it, the plant status that belongs to it."""


class ControllerLink(Link, Protocol):
    """The controller's side.

    Attributes:
        start_ns: when the run begins, on the clock of the states' stamps; None if only the plant's
            states report it.
        cycle_ns: the current cycle, on the same clock, even if no state arrives in it; -1 where
            only states define cycles.
    """

    start_ns: int | None = None
    cycle_ns: int = -1

    def serve(self, on_state: StateHandler) -> None:
        """Set `on_state` as the handler of joint states; it is called for one state at a time."""

    def activate(self) -> None:
        """Announce that the controller answers states from now on, which lets the plant start."""

    def spin(self, is_stop_requested: Callable[[], bool] = never) -> None:
        """Answer joint states until the run ends or a stop is requested.

        Raises:
            BusError: the plant never joined or went silent, a drive failed, or the bus was lost.
            Exception: any error of the handler of states.
        """
