"""The plant's side for states: they are sent on their way, and delivered to the controller."""

from __future__ import annotations

from bus_schema.link.interface import PlantLink
from bus_schema.runtime.clock import Clock
from plant_emulator.channel.channel import Channel
from plant_emulator.commands import ArmCommands
from plant_emulator.measurement import Measurement
from plant_emulator.telemetry import PlantTelemetry


class Uplink:
    """Delivers states to a controller when they are due.

    Args:
        link: the bus.
        clock: the clock of the run, which the plant owns.
        channel: states on their way.
        telemetry: sent when there is time.
        commands: in lockstep, receives the replies.
        reply_timeout_s: in lockstep, longest wall time to wait for the reply to a state; None for
            no waiting.
        answered_ns: in lockstep, wait for the replies to states at multiples of this time.

    Attributes:
        channel: states on their way.
    """

    def __init__(
        self,
        link: PlantLink,
        clock: Clock,
        channel: Channel[Measurement],
        telemetry: PlantTelemetry,
        commands: ArmCommands,
        reply_timeout_s: float | None,
        answered_ns: int,
    ) -> None:
        self._link, self._clock, self.channel = link, clock, channel
        self._telemetry, self._commands = telemetry, commands
        self._reply_timeout_s, self._answered_ns = reply_timeout_s, answered_ns

    def send(self, measurement: Measurement) -> None:
        """Send a state to the controller, which waits for it in real time."""
        now_ns, channel = measurement.stamp_ns, self.channel
        channel.send(measurement, now_ns, len(measurement.state) + len(measurement.status))
        if self._reply_timeout_s is None:
            self.deliver_due(now_ns)

    def deliver_until(self, until_ns: int) -> int:
        """Deliver states that are due before this instant, then wait for it.

        Returns:
            The lateness in ns.
        """
        while self.channel.is_due_before(until_ns):
            self._deliver_next()
        self._telemetry.send(self._link)
        return self._link.wait_until(self._clock, until_ns)

    def deliver_due(self, now_ns: int) -> None:
        """Deliver states that are due, also those that are due just now."""
        while self.channel.is_due_before(now_ns + 1):
            self._deliver_next()

    def _deliver_next(self) -> None:
        due_ns, measurement = self.channel.receive()
        self._link.wait_until(self._clock, due_ns)
        stamp_ns, commands = measurement.stamp_ns, self._commands
        commands.newest_state_ns = max(commands.newest_state_ns, stamp_ns)
        self._telemetry.state_age_ns = self._clock.now_ns() - stamp_ns
        self._link.send_state(measurement.state, measurement.status)
        self._telemetry.send(self._link)
        is_answered = stamp_ns % self._answered_ns == 0
        if self._reply_timeout_s is not None and is_answered and not commands.controller_is_lost:
            commands.await_reply(measurement, self._reply_timeout_s)
