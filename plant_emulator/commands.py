"""The plant's side for commands: they are collected, pass the gate and come into force."""

from __future__ import annotations

import time
from collections import Counter

from bus_schema.errors import PeerSilentError
from bus_schema.link.interface import PlantLink
from bus_schema.messages.run_event import EventKind
from bus_schema.messages.topics import Role
from bus_schema.runtime.modes import COMMANDABLE
from plant_emulator.arm_plant import ArmPlant
from plant_emulator.channel.channel import Channel
from plant_emulator.channel.playout import PlayoutBuffer
from plant_emulator.command_gate import Command, CommandGate
from plant_emulator.measurement import Measurement
from plant_emulator.supervisor import Supervisor
from plant_emulator.telemetry import PlantTelemetry

_POLL_S = 0.1


class Watchdog:
    """Watchdog that stops the arm a given time after the last valid command took effect.

    `PlantLoop` checks it before each physics substep.

    Args:
        timeout_ns: longest silence during a run.
        first_command_ns: instant by which the first command must have taken effect.

    Attributes:
        expires_ns: the arm must stop after this instant unless a command arrives before.
    """

    def __init__(self, timeout_ns: int, first_command_ns: int) -> None:
        self._timeout_ns = timeout_ns
        self.expires_ns = first_command_ns

    def await_first(self, acts_ns: int) -> None:
        """Note when the first command says that it will take effect; until then, brakes hold."""
        self.expires_ns = max(self.expires_ns, acts_ns + self._timeout_ns)

    def feed(self, now_ns: int) -> None:
        """Note that a valid command took effect."""
        self.expires_ns = now_ns + self._timeout_ns


class ArmCommands:
    """Takes commands off the bus, and applies them to the joints when they are due.

    Args:
        link: the bus.
        gate: check of all commands.
        downlink: commands on their way to the joints.
        watchdog: fed when a command comes into force.
        arm: receives commands.
        telemetry: notes round trips.
        supervisor: receives events and faults.
        period_ns: length of a tick.

    Attributes:
        newest_state_ns: stamp of the newest state that was sent; -1 before the first.
        controller_is_lost: nothing answers any more.
        sequence: number of the command in force; 0 before the first.
        delay_ns: age of the state that the command in force answers, when it came into force; -1
            before the first.
    """

    def __init__(
        self,
        link: PlantLink,
        gate: CommandGate,
        downlink: Channel[Command] | PlayoutBuffer,
        watchdog: Watchdog,
        arm: ArmPlant,
        telemetry: PlantTelemetry,
        supervisor: Supervisor,
        period_ns: int,
    ) -> None:
        self._link, self._gate, self._downlink = link, gate, downlink
        self._watchdog, self._arm, self._period_ns = watchdog, arm, period_ns
        self._telemetry, self._supervisor = telemetry, supervisor
        self._with_rows: Command | None = None
        self._second_source_is_told = False
        self._unused: Counter[str] = Counter()
        self._stamp_ns = -1
        self.newest_state_ns = self.delay_ns = -1
        self.controller_is_lost = False
        self.sequence = 0

    @property
    def rejected(self) -> Counter[str]:
        """Number of rejected commands, by reason."""
        return self._gate.rejections.counts + self._unused

    def age_ns(self, now_ns: int) -> int:
        """Age of the state that the command in force answers; -1 before the first."""
        return now_ns - self._stamp_ns if self._stamp_ns >= 0 else -1

    def collect(self) -> None:
        """Send commands that pass the gate on their way to the joints."""
        arrivals = self._link.take_commands()
        if self.controller_is_lost:
            self._unused["after_loss"] += len(arrivals)
            return
        for arrival in arrivals:
            former = self._gate.commander
            command = self._gate.admit(arrival, self.newest_state_ns)
            if command is not None:
                if former is None:
                    self._watchdog.await_first(command.stamp_ns + command.acts_after_ns)
                    self._telemetry.allow(command.acts_after_ns)
                if arrival.sender != former:
                    words = _commander(arrival.sender, former)
                    self._supervisor.announce(EventKind.COMMANDER, words)
                    self._link.sessions.note_commander(arrival.sender)
                self._downlink.send(command, arrival.arrival_ns, len(arrival.payload))
        if arrivals and not self._second_source_is_told and (source := self._gate.second_source):
            self._second_source_is_told = True
            self._supervisor.fail(f"two senders use the commander's id: {source}")

    def await_reply(self, state: Measurement, timeout_s: float) -> None:
        """Receive the reply to one state; without one, continue alone until the watchdog acts."""
        self._gate.await_answer(state.stamp_ns)
        self.collect()
        give_up_s = time.monotonic() + timeout_s
        while self._gate.is_waiting and not self._supervisor.stop_requested:
            if self._link.await_command(_POLL_S):
                self.collect()
            elif self._link.controller_has_left():
                if self._link.await_command(0.0):
                    continue  # sent before the controller left
                self.controller_is_lost = True
                if self._arm.mode in COMMANDABLE and self._link.fault() is None:
                    self._supervisor.fail(self._link.controller_loss())
                return
            elif time.monotonic() > give_up_s:
                self.controller_is_lost = True
                silence = PeerSilentError(Role.CONTROLLER, timeout_s, "reply to a state")
                self._supervisor.fail(str(silence), silence.peer)
                return
            elif self._may_have_missed_state():
                self._link.send_state(state.state, state.status)

    def put_into_force(self, now_ns: int) -> None:
        """Apply the newest command that has arrived at the joints."""
        for effective_ns, command in self._downlink.take_due(now_ns):
            if command.stamp_ns <= self._stamp_ns:
                self._unused["overtaken"] += 1
                continue
            mode = self._arm.mode
            if mode not in COMMANDABLE:
                self._unused["after_stop"] += 1
                continue
            self._watchdog.feed(effective_ns)
            self._telemetry.round_trip_ns = effective_ns - command.stamp_ns
            self._telemetry.allow(command.acts_after_ns)
            self._stamp_ns, self.sequence = command.stamp_ns, command.sequence
            self.delay_ns = now_ns - command.stamp_ns
            self._arm.command(command.torque_nm, command.target, command.stamp_ns)
            self._with_rows = command if command.rows is not None else None
            self.play_row(now_ns)
            if self._arm.mode is not mode:
                self._supervisor.announce_mode("first valid command, brakes released")

    def play_row(self, now_ns: int) -> None:
        """Apply the row for this tick, if the command in force has several; then hold the last."""
        command = self._with_rows
        if command is None or command.rows is None:
            return
        since_ns = now_ns - command.stamp_ns - command.acts_after_ns
        tick = min(since_ns // self._period_ns, command.rows.last_tick)
        if tick > 0:
            stamp_ns = command.stamp_ns + tick * self._period_ns
            self._arm.command(*command.rows.at(tick), stamp_ns)

    def _may_have_missed_state(self) -> bool:
        """Whether the controller may have missed the state, as the first one or a replacement."""
        if self._gate.commander is None:
            return self._link.sessions.may_miss_states()
        return self._gate.lacks_commander()


def _commander(sender: bytes, former: bytes | None) -> str:
    """Describe the new commander."""
    name = f"session {sender.hex()}" if sender else "a controller without an id"
    if former is None:
        return f"commanded by {name}"
    return f"commanded by {name}, after {former.hex() or 'one without an id'} left"
