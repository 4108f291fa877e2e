"""The plant's loop: exchange messages, advance the physics, publish the joints' motion.

The plant owns the clock of a run. At each tick of an absolute grid, commands that arrived since the
last one come into force at the physics substep of their arrival, the physics catches up with the
clock, and the joints are measured. In virtual time nothing is ever late; in real time a late tick
is skipped whole, but the physics still computes it.
"""

from __future__ import annotations

import json
import time
from collections import Counter
from typing import cast

from bus_schema.link.interface import PlantLink
from bus_schema.messages.run_event import EventKind, RunEvent
from bus_schema.messages.topics import Role
from bus_schema.runtime.clock import Clock, own_kernel
from bus_schema.runtime.modes import COMMANDABLE
from bus_schema.runtime.randomness import is_seed_used
from bus_schema.runtime.realtime import stolen_ms
from plant_emulator.arm_plant import ArmPlant
from plant_emulator.channel.channel import Channel
from plant_emulator.channel.opening import open_downlink, open_uplink
from plant_emulator.channel.playout import PlayoutBuffer
from plant_emulator.command_gate import CommandGate
from plant_emulator.commands import ArmCommands, Watchdog
from plant_emulator.faults.faulty_link import FaultyLink
from plant_emulator.faults.message_faults import channel_faults
from plant_emulator.measurement import Instruments, Measurement
from plant_emulator.plant_task import PlantOutcome, PlantTask
from plant_emulator.supervisor import Supervisor
from plant_emulator.telemetry import PlantTelemetry
from plant_emulator.uplink import Uplink

_ENDED = ("ticks", "completed", "wall_s", "stolen_ms")
"""Keys of the outcome in the last event."""


class PlantLoop:
    """One run of the plant.

    Attributes:
        tick: ticks that have passed.
        ended_early: it ended because the arm was lost, see `end_after_loss`.
    """

    def __init__(self, task: PlantTask, arm: ArmPlant, link: PlantLink, clock: Clock) -> None:
        names = task.robot.joint_names
        self._task, self._arm, self._clock, self._grid = task, arm, clock, task.grid
        self._stages = task.grid.stages()
        states: Channel[Measurement] = open_uplink(
            task.link, task.seed, channel_faults(task.faults, "uplink")
        )
        self._downlink = open_downlink(
            task.link, task.seed, channel_faults(task.faults, "downlink")
        )
        downlink = self._downlink
        self._playout = downlink if isinstance(downlink, PlayoutBuffer) else None
        gate = CommandGate(
            names, link.sessions.sender_has_left,
            takes_targets=task.takes_targets, takes_acting_time=task.link.plays_automatically,
        )  # fmt: skip
        self._link = _with_faults(task, link, clock, gate)
        timeout_ns = round(task.plant.command_timeout_ms * 1e6)
        mean_ns = states.mean_delay_ns + downlink.mean_delay_ns
        round_trip_ns = max(mean_ns, task.link.playout_ns)
        self._watchdog = Watchdog(timeout_ns, timeout_ns + max(round_trip_ns, task.expected_ns))
        answered_ns = task.answer_every * self._grid.period_ns
        self._telemetry = PlantTelemetry(
            names, arm, task.link.deadline_ns(answered_ns, round_trip_ns),
            None if task.link.deadline_ms is not None else answered_ns,
        )  # fmt: skip
        self._supervisor = Supervisor(arm, self._telemetry, task.plant, task.grid, task.ticks)
        self._instruments = Instruments(names, arm)
        self._commands = ArmCommands(
            self._link, gate, downlink, self._watchdog, arm, self._telemetry, self._supervisor,
            self._grid.period_ns,
        )  # fmt: skip
        self._uplink = Uplink(
            self._link, clock, states, self._telemetry, self._commands,
            task.link.reply_timeout_s if task.lockstep else None, answered_ns,
        )  # fmt: skip
        self._watch = None if task.watch is None else task.watch(arm.motion[0])
        self.tick = 0
        self.ended_early = False
        self._ticks_after_loss: int | None = None
        self._tick_ns = 0
        self._command_age_ns = -1

    @property
    def late_ticks(self) -> int:
        """Number of ticks at which the command in force was too old, or that were skipped."""
        return self._telemetry.late_ticks

    def warm_up(self) -> None:
        """Compile the loop's functions before the run, without a trace in the state."""
        # A message type's codec is created at its first use, which takes longer than a few ticks.
        RunEvent(0, Role.PLANT, EventKind.STARTED, "").encode()

    def request_stop(self) -> None:
        """End the run cleanly at the next tick; safe from signal handlers and other threads."""
        self._supervisor.stop_requested = True

    def end_after_loss(self, after_s: float) -> None:
        """End the run this long after its watch finds the arm lost and a command has acted."""
        self._ticks_after_loss = round(1e9 * after_s / self._grid.period_ns)

    def run(self) -> PlantOutcome:
        """Run from tick 0 to the end, a fault or a request to stop."""
        started_s, stolen_before_ms = time.monotonic(), stolen_ms()
        self._clock.start()
        supervisor, period_ms = self._supervisor, self._grid.period_ns * 1e-6
        supervisor.announce(EventKind.STARTED, f"{self._task.ticks} ticks of {period_ms:g} ms")
        self._arm.begin()
        supervisor.announce_mode("brakes engaged until the first valid command")
        try:
            self._run_ticks()
        except Exception as error:  # noqa: BLE001 (the arm is stopped after any error)
            supervisor.stop_after_error(error)
        self._arm.end()
        supervisor.announce_mode("brakes engaged")
        outcome = PlantOutcome(
            ticks=self.tick,
            completed=self.tick >= self._task.ticks and not supervisor.faults,
            faults=supervisor.faults,
            awaited=supervisor.awaited,
            wall_s=time.monotonic() - started_s,
            stolen_ms=stolen_ms() - stolen_before_ms,
        )
        self._report_end(outcome)
        return outcome

    def _run_ticks(self) -> None:
        self._telemetry.begin_cycle(0)
        self._react()
        self._note_truth(was_skipped=False)
        self._instruments.read(0)
        self._send_state()
        supervisor = self._supervisor
        while self.tick < supervisor.end_tick and not supervisor.stop_requested:
            self._cycle()
        self._run_until(self._tick_ns)

    def _cycle(self) -> None:
        lateness_ns = self._go_to_next_tick() if self._task.lockstep else self._keep_pace()
        self._telemetry.begin_cycle(lateness_ns)
        self._reach_next_tick()
        if self.tick < self._supervisor.end_tick:
            self._send_state()
        self._note_truth(was_skipped=False)
        self._telemetry.end_cycle()

    def _send_state(self) -> None:
        sequence, delay_ns = self._commands.sequence, self._commands.delay_ns
        measure = self._instruments.measure
        playout = self._playout
        arrival_ns = -1 if playout is None else playout.take_longest_arrival()
        self._uplink.send(
            measure(self._tick_ns, sequence, self._command_age_ns, delay_ns, arrival_ns)
        )

    def _go_to_next_tick(self) -> int:
        """Advance to the next tick in virtual time; return the lateness in ns."""
        # Nothing is ever late, so the physics can wait until all commands are known.
        tick_ns = self._grid.tick_ns(self.tick + 1)
        lateness_ns = self._run_until(tick_ns)
        first = self.tick * self._grid.substeps
        self._advance(first, first + self._grid.substeps)
        self._instruments.read(tick_ns)
        return lateness_ns

    def _keep_pace(self) -> int:
        """Compute the physics up to the next tick in real time; return the lateness in ns."""
        tick = self._next_tick()
        before = (tick - 1) * self._grid.substeps
        for stage in self._stages:
            # All commands of a substep are known when it begins: the physics need not wait longer.
            end = before + stage.stop
            self._run_until(self._grid.substep_ns(end - 1))
            self._skip_to(tick - 1)
            self._advance(before + stage.start, end)
        tick_ns = self._grid.tick_ns(tick)
        if self._clock.awake_ns:
            self._run_until(tick_ns - self._clock.awake_ns)
        self._instruments.read(tick_ns)  # the physics has computed everything before the tick
        return self._run_until(tick_ns)

    def _run_until(self, until_ns: int) -> int:
        """Deliver due states and receive arriving commands until this instant.

        Returns:
            The lateness in ns.
        """
        lateness_ns = self._uplink.deliver_until(until_ns)
        self._commands.collect()
        if self._arm.mode in COMMANDABLE and (reason := self._link.fault()) is not None:
            self._supervisor.stop(reason)
        return lateness_ns

    def _next_tick(self) -> int:
        """Return the next tick of the grid, or the current one if the clock is already later."""
        tick = self.tick + 1
        reached = self._grid.tick_at_or_before(self._clock.now_ns())
        if reached > tick:
            reached = min(reached, self._supervisor.end_tick)
            self._telemetry.skipped += reached - tick
            tick = reached
        return tick

    def _skip_to(self, tick: int) -> None:
        """Advance the physics through skipped ticks, at which nothing is measured."""
        while self.tick < tick:
            first = self.tick * self._grid.substeps
            self._advance(first, first + self._grid.substeps)
            self._reach_next_tick()
            self._note_truth(was_skipped=True)

    def _advance(self, first: int, end: int) -> None:
        """Advance the physics through substeps of this tick, given by their numbers in the run."""
        started_ns = time.perf_counter_ns()
        downlink, watchdog, grid = self._downlink, self._watchdog, self._grid
        last_ns = grid.substep_ns(end - 1)
        while first < end:
            now_ns = grid.substep_ns(first)
            if downlink.next_due_ns <= now_ns:
                self._commands.put_into_force(now_ns)
            if watchdog.expires_ns < now_ns and self._arm.mode in COMMANDABLE:
                timeout_ms = self._task.plant.command_timeout_ms
                limit = f"{timeout_ms:g} ms (plant.command_timeout_ms)"
                self._supervisor.stop_safely(f"no valid command for {limit}")
            # As long as nothing can change in between, one call computes all substeps.
            changes_ns = min(downlink.next_due_ns, watchdog.expires_ns + 1)
            following = end if changes_ns > last_ns else first + 1
            while following < end and grid.substep_ns(following) < changes_ns:
                following += 1
            self._arm.advance(first, following)
            first = following
        self._telemetry.physics_ns += time.perf_counter_ns() - started_ns

    def _reach_next_tick(self) -> None:
        self.tick = self._supervisor.tick = self.tick + 1
        self._tick_ns = now_ns = self._grid.tick_ns(self.tick)
        if self._task.lockstep and self.tick < self._supervisor.end_tick:
            # A command that acts at this very tick is in force when the joints are measured,
            # however its round trip is split between the two directions.
            self._uplink.deliver_due(now_ns)
        if self._downlink.next_due_ns <= now_ns:
            self._commands.put_into_force(now_ns)
        self._commands.play_row(now_ns)
        self._react()

    def _react(self) -> None:
        """Stop if a limit or the robot requires it, and check the command's age."""
        if self._arm.reflex is not None:
            self._supervisor.handle_reflex(self._arm.reflex)
        if self._arm.torques.limit_hits:
            self._supervisor.handle_limit_hits()
        self._command_age_ns = self._commands.age_ns(self._tick_ns)

    def _note_truth(self, *, was_skipped: bool) -> None:
        if self._watch is not None and self._watch.look(self._tick_ns):
            self._note_loss()
        self._telemetry.note_truth(
            self._tick_ns, self.tick, self._commands.sequence, self._command_age_ns,
            was_skipped=was_skipped,
        )  # fmt: skip

    def _note_loss(self) -> None:
        """Set the end of the run at the first tick with a loss and an acting command."""
        if self._ticks_after_loss is None or self._command_age_ns < 0:
            return
        end_tick = self.tick + self._ticks_after_loss
        if end_tick < self._supervisor.end_tick:
            self._supervisor.end_tick, self.ended_early = end_tick, True
        self._ticks_after_loss = None

    def _report_end(self, outcome: PlantOutcome) -> None:
        supervisor, downlink = self._supervisor, self._downlink
        rejected = self._commands.rejected + Counter(overflow=self._link.sessions.overflow())
        counts = {
            "uplink": self._uplink.channel.statistics().summary() | {"rejected": {}},
            "downlink": downlink.statistics().summary() | {"rejected": rejected},
            **({} if self._playout is None else {"playout": self._playout.report()}),
            "limits": supervisor.limits.summary(),
            **({"reflexes": supervisor.reflexes} if supervisor.reflexes else {}),
        } | self._link.report()
        if supervisor.stop_requested:
            supervisor.announce(EventKind.STOPPED, "stopped on request")
        supervisor.announce(EventKind.COUNTS, json.dumps(counts))
        ended = {
            **{name: getattr(outcome, name) for name in _ENDED},
            "physics": self._arm.physics, "kernel": own_kernel(), "seed_used": is_seed_used(),
            "start_s": 1e-9 * (time.monotonic_ns() - self._clock.now_ns()),
        }  # fmt: skip
        if self._watch is not None:
            ended["bounds"] = self._watch.counts()
        supervisor.announce(EventKind.ENDED, json.dumps(ended))
        self._telemetry.send(self._link)


def _with_faults(task: PlantTask, link: PlantLink, clock: Clock, gate: CommandGate) -> PlantLink:
    """Return the link, wrapped with the task's faults."""
    if not task.faults and not task.process_actions:
        return link
    faulty = FaultyLink(link, clock, gate, task.faults, task.process_actions, task.seed)
    return cast(PlantLink, faulty)
