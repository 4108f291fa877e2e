"""The plant's loop: exchange messages, advance the physics, publish what the joints do.

The plant owns the clock of a run. At each tick of an absolute grid it looks back: the commands that
arrived meanwhile come into force at the physics substep at which they took effect, the physics
catches up with the clock, and the joints are measured. In virtual time nothing is ever late; in
real time a late tick is skipped whole, and the physics goes through it all the same.
"""

from __future__ import annotations

import json
import logging
import time
from collections import Counter

from bus_schema.errors import PeerSilentError
from bus_schema.limits import LimitCounts, name_of
from bus_schema.link.interface import PlantLink
from bus_schema.messages.run_event import EventKind, RunEvent
from bus_schema.messages.topics import Role
from bus_schema.runtime.clock import Clock
from bus_schema.runtime.modes import COMMANDABLE, Mode, mode_event
from bus_schema.runtime.realtime import stolen_ms
from plant_emulator.arm.arm_plant import ArmPlant
from plant_emulator.channel.channel import Channel
from plant_emulator.channel.impairment import open_downlink, open_uplink
from plant_emulator.command_gate import CommandGate
from plant_emulator.command_path import CommandPath
from plant_emulator.faults.channel_faults import channel_faults
from plant_emulator.faults.faulty_link import FaultyLink
from plant_emulator.measurement import Instruments, Measurement
from plant_emulator.plant_task import PlantOutcome, PlantTask
from plant_emulator.telemetry import PlantTelemetry
from plant_emulator.watchdog import Watchdog

logger = logging.getLogger(__name__)

_POLL_S = 0.1


class PlantLoop:
    """One run of the plant.

    Attributes:
        tick: ticks that have passed.
    """

    def __init__(self, task: PlantTask, arm: ArmPlant, link: PlantLink, clock: Clock) -> None:
        names = task.robot.joint_names
        self._task, self._arm, self._link, self._clock = task, arm, link, clock
        self._grid = task.grid
        self._stages = task.grid.stages()
        self._uplink: Channel[Measurement] = open_uplink(
            task.link, task.seed, channel_faults(task.faults, "uplink")
        )
        downlink = open_downlink(task.link, task.seed, channel_faults(task.faults, "downlink"))
        self._gate = CommandGate(
            names,
            lambda sender: link.sender_has_left(sender),
            takes_targets=task.takes_targets,
        )
        if task.faults or task.process_actions:
            self._link = FaultyLink(
                link, clock, self._gate, names, task.faults, task.process_actions, task.seed
            )
        self._limits = LimitCounts()
        timeout_ns = round(task.plant.command_timeout_ms * 1e6)
        mean_ns = self._uplink.mean_delay_ns + downlink.mean_delay_ns
        round_trip_ns = max(mean_ns, task.link.playout_ns)
        self._watchdog = Watchdog(timeout_ns, timeout_ns + round_trip_ns)
        self._telemetry = PlantTelemetry(
            names, arm, task.link.deadline_ns(self._grid.period_ns, round_trip_ns)
        )
        self._commands = CommandPath(
            self._gate, downlink, self._watchdog, arm, self._telemetry, self._announce
        )
        self._instruments = Instruments(names, arm, self._commands)
        self._controller_is_lost = False
        self._second_source_is_told = False
        self._end_tick = task.ticks
        self._outcome = PlantOutcome()
        self._stop_requested = False
        self._lateness_ns = 0
        self.tick = 0
        self._tick_ns = 0
        self._command_age_ns = -1
        self._newest_state_ns = -1

    @property
    def deadline_misses(self) -> int:
        """Ticks at which the command in force was too old."""
        return self._telemetry.deadline_misses

    def warm_up(self) -> None:
        """Compile what the loop calls before time counts, and leave no trace of it."""
        # The codec of a message type is made at its first use, which takes longer than a few ticks.
        RunEvent(0, Role.PLANT, EventKind.STARTED, "").encode()

    def request_stop(self) -> None:
        """End the run cleanly at the next tick; safe from signal handlers and other threads."""
        self._stop_requested = True

    def run(self) -> PlantOutcome:
        """Run from tick 0 to the end, a fault or a request to stop."""
        started_s, stolen_before_ms = time.monotonic(), stolen_ms()
        self._clock.start()
        period_ms = self._grid.period_ns * 1e-6
        self._announce(EventKind.STARTED, f"{self._task.ticks} ticks of {period_ms:g} ms")
        self._arm.begin()
        self._announce_mode("brakes engaged until the first valid command")
        try:
            self._run_ticks()
        except Exception as error:  # noqa: BLE001 (whatever happens, the arm is stopped)
            self._stop_after_error(error)
        self._arm.end()
        self._announce_mode("brakes engaged")
        self._outcome.ticks = self.tick
        self._outcome.completed = self.tick >= self._task.ticks and not self._outcome.faults
        self._outcome.wall_s = time.monotonic() - started_s
        self._outcome.stolen_ms = stolen_ms() - stolen_before_ms
        self._report_end()
        return self._outcome

    def _run_ticks(self) -> None:
        self._telemetry.begin_cycle(0)
        self._react()
        self._note_truth(was_skipped=False)
        self._instruments.read(0)
        self._send_state()
        while self.tick < self._end_tick and not self._stop_requested:
            self._cycle()
        self._exchange_until(self._tick_ns)

    def _stop_after_error(self, error: Exception) -> None:
        """Stop the arm because the loop cannot go on."""
        reason = f"the plant cannot go on: {type(error).__name__}: {error}"
        logger.exception("the plant cannot go on", exc_info=error)
        if self._arm.mode in COMMANDABLE:
            self._stop_safely(reason)
        else:
            self._fail(reason)

    def _cycle(self) -> None:
        if self._task.lockstep:
            # Nothing is ever late, so the physics can wait until all that acts in them is there.
            self._exchange_until(self._grid.tick_ns(self.tick + 1))
            first = self.tick * self._grid.substeps
            self._advance(first, first + self._grid.substeps)
            self._instruments.read(self._grid.tick_ns(self.tick + 1))
        else:
            self._keep_pace(self._next_tick())
        self._telemetry.begin_cycle(self._lateness_ns)
        self._reach_next_tick()
        if self.tick < self._end_tick:
            self._send_state()
        self._note_truth(was_skipped=False)
        self._telemetry.end_cycle()

    def _keep_pace(self, tick: int) -> None:
        """Reach a tick in real time, with nothing left to do there but to tell."""
        before = (tick - 1) * self._grid.substeps
        for stage in self._stages:
            # What acts in a substep is known when it begins: the physics need not wait any longer.
            end = before + stage.stop
            self._exchange_until(self._grid.substep_ns(end - 1))
            self._skip_to(tick - 1)
            self._advance(before + stage.start, end)
        tick_ns = self._grid.tick_ns(tick)
        if self._clock.awake_ns:
            self._exchange_until(tick_ns - self._clock.awake_ns)
        self._instruments.read(tick_ns)  # the physics are through with what comes before the tick
        self._exchange_until(tick_ns)

    def _next_tick(self) -> int:
        """The next tick of the grid, or the one that the clock has reached if that is later."""
        tick = self.tick + 1
        reached = self._grid.tick_at_or_before(self._clock.now_ns())
        if reached > tick:
            reached = min(reached, self._end_tick)
            self._telemetry.note_skipped(reached - tick)
            tick = reached
        return tick

    def _exchange_until(self, until_ns: int) -> None:
        """Deliver the states that fall due, and take in the commands that arrive, until then."""
        while self._uplink.next_due_ns < until_ns:
            self._deliver_next()
        self._telemetry.send(self._link)
        self._lateness_ns = self._link.wait_until(self._clock, until_ns)
        self._collect_commands()
        if self._arm.mode in COMMANDABLE and (reason := self._link.fault()) is not None:
            self._begin_stop(reason)

    def _deliver_next(self) -> None:
        due_ns, measurement = self._uplink.receive()
        self._link.wait_until(self._clock, due_ns)
        self._newest_state_ns = max(self._newest_state_ns, measurement.stamp_ns)
        self._telemetry.note_delivered(self._clock.now_ns() - measurement.stamp_ns)
        self._link.send_state(measurement.state, measurement.status)
        self._telemetry.send(self._link)
        if self._task.lockstep and not self._controller_is_lost:
            self._await_reply(measurement)

    def _await_reply(self, measurement: Measurement) -> None:
        """Take the reply to one state, at once or when it comes."""
        self._gate.await_answer(measurement.stamp_ns)
        self._collect_commands()
        if self._gate.is_waiting:
            self._wait_for_reply(measurement)

    def _wait_for_reply(self, measurement: Measurement) -> None:
        """If the reply to a state stays out, go on alone until the watchdog acts."""
        timeout_s = self._task.link.reply_timeout_s
        give_up_s = time.monotonic() + timeout_s
        while self._gate.is_waiting and not self._stop_requested:
            if self._link.await_command(_POLL_S):
                self._collect_commands()
            elif self._link.controller_has_left():
                if self._link.await_command(0.0):
                    continue  # it was sent before the controller left
                self._controller_is_lost = True
                if self._arm.mode in COMMANDABLE and self._link.fault() is None:
                    self._fail(self._link.controller_loss())
                return
            elif time.monotonic() > give_up_s:
                self._controller_is_lost = True
                self._fail(str(PeerSilentError(Role.CONTROLLER, timeout_s, "reply to a state")))
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
                self._fail(f"two sources send as the one commander: {self._gate.second_source}")

    def _skip_to(self, tick: int) -> None:
        """Let the physics go through the ticks before this one, at which nothing is measured."""
        while self.tick < tick:
            first = self.tick * self._grid.substeps
            self._advance(first, first + self._grid.substeps)
            self._reach_next_tick()
            self._note_truth(was_skipped=True)

    def _advance(self, first: int, end: int) -> None:
        """Let the physics go through substeps of this tick, by their numbers in the run."""
        started_ns = time.perf_counter_ns()
        downlink, watchdog, grid = self._commands.downlink, self._watchdog, self._grid
        last_ns = grid.substep_ns(end - 1)
        while first < end:
            now_ns = grid.substep_ns(first)
            if downlink.next_due_ns <= now_ns:
                self._commands.put_into_force(now_ns)
            if watchdog.expires_ns < now_ns and self._arm.mode in COMMANDABLE:
                timeout_ms = self._task.plant.command_timeout_ms
                self._stop_safely(f"no valid command for {timeout_ms:g} ms")
            stays_so = downlink.next_due_ns > last_ns and watchdog.expires_ns >= last_ns
            # Where nothing can change in between, all substeps are one call.
            following = end if stays_so else first + 1
            self._arm.advance(first, following)
            first = following
        self._telemetry.note_physics(time.perf_counter_ns() - started_ns)

    def _reach_next_tick(self) -> None:
        self.tick += 1
        self._tick_ns = now_ns = self._grid.tick_ns(self.tick)
        if self._commands.downlink.next_due_ns <= now_ns:
            self._commands.put_into_force(now_ns)
        self._react()

    def _react(self) -> None:
        """Stop where a limit asks for it, and see how old the command in force is."""
        if self._arm.torques.limit_hits:
            self._handle_limit_hits()
        self._command_age_ns = self._commands.age_ns(self._tick_ns)

    def _handle_limit_hits(self) -> None:
        """Count the limits that were hit during a tick, and stop where that is asked for."""
        hits = self._arm.torques.take_limit_hits()
        new = self._limits.note(hits)
        if new:
            self._announce(EventKind.LIMIT, f"reached for the first time: {name_of(new)}")
        beyond = self._arm.stops_at & hits
        if beyond and self._arm.mode is Mode.TRACKING:
            self._stop_safely(f"beyond its limits: {name_of(beyond)}")

    def _stop_safely(self, reason: str) -> None:
        self._begin_stop(f"{reason}: safe stop ({self._task.plant.safe_stop})")

    def _begin_stop(self, reason: str) -> None:
        """Stop the arm, and end the run when it has had the time for it."""
        self._arm.stop()
        self._announce_mode(f"safe stop ({self._task.plant.safe_stop})")
        self._fail(reason)
        stop_ticks = round(self._task.plant.stop_duration_s * 1e9 / self._grid.period_ns)
        self._end_tick = min(self._end_tick, self.tick + 1 + stop_ticks)

    def _send_state(self) -> None:
        """Send the state that was read on its way; in real time somebody waits for it."""
        measurement = self._instruments.measure(self._tick_ns, self._command_age_ns)
        size_bytes = len(measurement.state) + len(measurement.status)
        self._uplink.send(measurement, self._tick_ns, size_bytes)
        if not self._task.lockstep:
            while self._uplink.next_due_ns <= self._tick_ns:
                self._deliver_next()

    def _note_truth(self, *, was_skipped: bool) -> None:
        self._telemetry.note_truth(
            self._tick_ns, self.tick, self._commands.sequence, self._command_age_ns,
            was_skipped=was_skipped,
        )  # fmt: skip

    def _fail(self, reason: str) -> None:
        self._outcome.faults.append(reason)
        logger.error("%s", reason)
        self._announce(EventKind.FAULT, reason)

    def _announce_mode(self, why: str) -> None:
        self._announce(EventKind.MODE, mode_event(self._arm.mode, why))

    def _announce(self, kind: EventKind, detail: str) -> None:
        self._telemetry.note_event(self._tick_ns, kind, detail)

    def _report_end(self) -> None:
        outcome = self._outcome
        counts = {
            "uplink": self._uplink.statistics().summary() | {"rejected": {}},
            "downlink": self._commands.downlink.statistics().summary()
            | {"rejected": self._commands.rejected + Counter(overflow=self._link.overflow())},
            "limits": self._limits.summary(),
        } | self._link.report()
        if self._stop_requested:
            self._announce(EventKind.STOPPED, "stopped on request")
        self._announce(EventKind.COUNTS, json.dumps(counts))
        ended = {name: value for name, value in vars(outcome).items() if name != "faults"}
        self._announce(EventKind.ENDED, json.dumps(ended))
        self._telemetry.send(self._link)
