"""The plant's side of commands: from the bus, through gate and downlink, into force."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable

from bus_schema.link.interface import CommandArrival
from bus_schema.messages.run_event import EventKind
from bus_schema.runtime.modes import COMMANDABLE, mode_event
from plant_emulator.arm_plant import ArmPlant
from plant_emulator.channel.channel import Channel
from plant_emulator.channel.playout import PlayoutBuffer
from plant_emulator.command_gate import Command, CommandGate
from plant_emulator.telemetry import PlantTelemetry


class Watchdog:
    """Knows when the arm must stop: some time after the last valid command took effect.

    `PlantLoop` looks at it before each physics substep.

    Args:
        timeout_ns: longest silence during a run.
        first_command_ns: instant by which the first command must have taken effect.

    Attributes:
        expires_ns: the arm must stop after this instant, unless a command comes before.
    """

    def __init__(self, timeout_ns: int, first_command_ns: int) -> None:
        self._timeout_ns = timeout_ns
        self.expires_ns = first_command_ns

    def feed(self, now_ns: int) -> None:
        """A valid command took effect."""
        self.expires_ns = now_ns + self._timeout_ns


class CommandPath:
    """Takes commands in as they arrive, and puts each into force when it takes effect.

    Args:
        gate: what every command has to pass.
        downlink: the way of commands to the joints.
        watchdog: fed with what comes into force.
        arm: what is commanded.
        telemetry: where round trips are noted.
        announce: called with events: a new commander, the arm's release.

    Attributes:
        downlink: commands on their way.
        sequence: number of the command in force; 0 before the first.
        delay_ns: age of the state that the command in force answers, when it came into force; -1
            before the first.
    """

    def __init__(
        self,
        gate: CommandGate,
        downlink: Channel[Command] | PlayoutBuffer,
        watchdog: Watchdog,
        arm: ArmPlant,
        telemetry: PlantTelemetry,
        announce: Callable[[EventKind, str], None],
    ) -> None:
        self._gate, self.downlink, self._watchdog = gate, downlink, watchdog
        self._arm, self._telemetry, self._announce = arm, telemetry, announce
        self._unused: Counter[str] = Counter()
        self._stamp_ns = -1
        self.sequence = 0
        self.delay_ns = -1

    @property
    def rejected(self) -> Counter[str]:
        """How many commands changed nothing, by reason."""
        return self._gate.rejections.counts + self._unused

    def age_ns(self, now_ns: int) -> int:
        """Age of the state that the command in force answers; -1 before the first."""
        return now_ns - self._stamp_ns if self._stamp_ns >= 0 else -1

    def take_in(self, arrivals: Iterable[CommandArrival], newest_state_ns: int) -> None:
        """Send what passes the gate on its way to the joints.

        Args:
            arrivals: what came off the bus.
            newest_state_ns: stamp of the newest state that was delivered, and so can be answered.
        """
        for arrival in arrivals:
            former = self._gate.commander
            command = self._gate.admit(arrival, newest_state_ns)
            if command is not None:
                if arrival.sender != former:
                    self._announce(EventKind.COMMANDER, _commander(arrival.sender, former))
                self.downlink.send(command, arrival.arrival_ns, len(arrival.payload))

    def reject(self, arrivals: list[CommandArrival]) -> None:
        """Count what comes from a controller that is taken for lost."""
        self._unused["after_loss"] += len(arrivals)

    def put_into_force(self, now_ns: int) -> None:
        """Let the newest of the commands that have come through act."""
        for effective_ns, command in self.downlink.take_due(now_ns):
            if command.stamp_ns <= self._stamp_ns:
                self._unused["overtaken"] += 1
                continue
            mode = self._arm.mode
            if mode not in COMMANDABLE:
                self._unused["after_stop"] += 1
                continue
            self._watchdog.feed(effective_ns)
            self._telemetry.note_round_trip(effective_ns - command.stamp_ns)
            self._stamp_ns, self.sequence = command.stamp_ns, command.sequence
            self.delay_ns = now_ns - command.stamp_ns
            self._arm.command(command.torque_nm, command.target, command.stamp_ns)
            if self._arm.mode is not mode:
                why = "first valid command, brakes released"
                self._announce(EventKind.MODE, mode_event(self._arm.mode, why))


def _commander(sender: bytes, former: bytes | None) -> str:
    """Who commands from now on, in words."""
    name = f"session {sender.hex()}" if sender else "a controller without an id"
    if former is None:
        return f"commanded by {name}"
    return f"commanded by {name}, after {former.hex() or 'one without an id'} left"
