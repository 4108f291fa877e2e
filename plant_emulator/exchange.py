"""The plant's exchange with a controller: states that fall due go out, commands are taken in."""

from __future__ import annotations

import time

from bus_schema.errors import PeerSilentError
from bus_schema.link.interface import PlantLink
from bus_schema.messages.topics import Role
from bus_schema.runtime.clock import Clock
from bus_schema.runtime.modes import COMMANDABLE
from plant_emulator.arm_plant import ArmPlant
from plant_emulator.channel.channel import Channel
from plant_emulator.command_gate import CommandGate
from plant_emulator.command_path import CommandPath
from plant_emulator.measurement import Measurement
from plant_emulator.supervisor import Supervisor
from plant_emulator.telemetry import PlantTelemetry

_POLL_S = 0.1


class Exchange:
    """Delivers states to a controller and takes its commands in, while time passes.

    Args:
        link: the bus.
        clock: the clock of the run, which the plant owns.
        uplink: states on their way.
        gate: what commands have to pass.
        commands: where commands go.
        arm: what is stopped where the link says so.
        telemetry: sent where there is time for it.
        supervisor: told of what goes wrong.
        reply_timeout_s: in lockstep, how long to wait for the reply to a state, wall time; None
            where nobody waits.
    """

    def __init__(
        self,
        link: PlantLink,
        clock: Clock,
        uplink: Channel[Measurement],
        gate: CommandGate,
        commands: CommandPath,
        arm: ArmPlant,
        telemetry: PlantTelemetry,
        supervisor: Supervisor,
        reply_timeout_s: float | None,
    ) -> None:
        self._link, self._clock, self._uplink = link, clock, uplink
        self._gate, self._commands, self._arm = gate, commands, arm
        self._telemetry, self._supervisor = telemetry, supervisor
        self._reply_timeout_s = reply_timeout_s
        self._controller_is_lost = False
        self._second_source_is_told = False
        self._newest_state_ns = -1

    def run_until(self, until_ns: int) -> int:
        """Deliver the states that fall due, and take in the commands that arrive, until then.

        Returns:
            How late it is, in ns.
        """
        while self._uplink.next_due_ns < until_ns:
            self._deliver_next()
        self._telemetry.send(self._link)
        lateness_ns = self._link.wait_until(self._clock, until_ns)
        self._collect_commands()
        if self._arm.mode in COMMANDABLE and (reason := self._link.fault()) is not None:
            self._supervisor.stop(reason)
        return lateness_ns

    def send(self, measurement: Measurement) -> None:
        """Send a state on its way; in real time somebody waits for it."""
        now_ns, uplink = measurement.stamp_ns, self._uplink
        uplink.send(measurement, now_ns, len(measurement.state) + len(measurement.status))
        if self._reply_timeout_s is None:
            while uplink.next_due_ns <= now_ns:
                self._deliver_next()

    def _deliver_next(self) -> None:
        due_ns, measurement = self._uplink.receive()
        self._link.wait_until(self._clock, due_ns)
        self._newest_state_ns = max(self._newest_state_ns, measurement.stamp_ns)
        self._telemetry.note_delivered(self._clock.now_ns() - measurement.stamp_ns)
        self._link.send_state(measurement.state, measurement.status)
        self._telemetry.send(self._link)
        if self._reply_timeout_s is not None and not self._controller_is_lost:
            self._await_reply(measurement, self._reply_timeout_s)

    def _await_reply(self, measurement: Measurement, timeout_s: float) -> None:
        """Take the reply to one state, at once or when it comes."""
        self._gate.await_answer(measurement.stamp_ns)
        self._collect_commands()
        if self._gate.is_waiting:
            self._wait_for_reply(measurement, timeout_s)

    def _wait_for_reply(self, measurement: Measurement, timeout_s: float) -> None:
        """If the reply to a state stays out, go on alone until the watchdog acts."""
        give_up_s = time.monotonic() + timeout_s
        while self._gate.is_waiting and not self._supervisor.stop_requested:
            if self._link.await_command(_POLL_S):
                self._collect_commands()
            elif self._link.controller_has_left():
                if self._link.await_command(0.0):
                    continue  # it was sent before the controller left
                self._controller_is_lost = True
                if self._arm.mode in COMMANDABLE and self._link.fault() is None:
                    self._supervisor.fail(self._link.controller_loss())
                return
            elif time.monotonic() > give_up_s:
                self._controller_is_lost = True
                silence = PeerSilentError(Role.CONTROLLER, timeout_s, "reply to a state")
                self._supervisor.fail(str(silence))
                return
            elif self._may_not_have_been_asked():
                self._link.send_state(measurement.state, measurement.status)

    def _may_not_have_been_asked(self) -> bool:
        """Whoever comes first may hear nothing yet; whoever comes next was not heard."""
        if self._gate.commander is None:
            return self._link.may_miss_states()
        return self._gate.lacks_commander()

    def _collect_commands(self) -> None:
        arrivals = self._link.take_commands()
        if self._controller_is_lost:
            self._commands.reject(arrivals)
        elif arrivals:
            self._commands.take_in(arrivals, self._newest_state_ns)
            if self._gate.second_source is not None and not self._second_source_is_told:
                self._second_source_is_told = True
                source = self._gate.second_source
                self._supervisor.fail(f"two sources send as the one commander: {source}")
