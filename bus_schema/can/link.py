"""The controller's side of the link over CAN: a master that runs the control cycle.

SYNC (or its like) is the clock: each one is a tick, and the stamp of a state is the number of ticks
since the start of the run times the period. In lockstep the next tick comes when the cycle is done;
in real time, on an absolute grid, and a tick that is missed is skipped whole.

In every case, the link brings enabled drives to rest before it ends.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass

import numpy as np

from bus_schema.can.frame import CanBus
from bus_schema.can.master import CanMaster, DriveError
from bus_schema.drive_feedback import DriveGains
from bus_schema.link.configuration import LinkConfiguration
from bus_schema.link.interface import ControllerLink, StateHandler, Telemetry, never
from bus_schema.messages import topics
from bus_schema.messages.record import Record
from bus_schema.messages.run_event import EventKind, RunEvent
from bus_schema.messages.topics import Role, Topic
from bus_schema.runtime.clock import Clock, HostLateness, TickGrid

logger = logging.getLogger(__name__)

_POLL_S = 0.05
_LONGEST_STOP_S = 1.0
_REALTIME_PATIENCE = 0.8
"""Share of the period within which states must be there; a torque needs the rest."""


@dataclass(frozen=True)
class CanRun:
    """Settings of a run over CAN, for both of its sides.

    Attributes:
        joint_names: names of the joints, in the order of the drives.
        link: section ``link`` of the scenario.
        grid: its ticks.
        ticks: how many there are.
        lockstep: virtual time, made by the cycles themselves.
        gains: of the loops that drives close around targets; None where they take torques alone.
    """

    joint_names: tuple[str, ...]
    link: LinkConfiguration
    grid: TickGrid
    ticks: int
    lockstep: bool
    gains: DriveGains | None = None


def _on_this_thread(turns: Iterator[None]) -> None:
    for _ in turns:
        pass


class CanControllerLink(ControllerLink):
    """The controller's side.

    Args:
        run: the run.
        master: master of the drives.
        bus: the bus it is on, which the link closes.
        clock: time of the run.
        telemetry: carries all messages but states and torques.
        take_turns: runs the steps of `spin`, each of which ends where drives have to answer.
    """

    start_ns = 0  # a stamp is the time since then, also where the first ticks had no state in time

    def __init__(
        self,
        run: CanRun,
        master: CanMaster,
        bus: CanBus,
        clock: Clock,
        telemetry: Telemetry,
        take_turns: Callable[[Iterator[None]], None] = _on_this_thread,
    ) -> None:
        self._take_turns = take_turns
        self._run, self._master, self._bus = run, master, bus
        self._clock, self._telemetry = clock, telemetry
        self._state = Record(topics.layout(topics.JOINT_STATES, run.joint_names))
        self._command_layout = topics.layout(
            topics.JOINT_COMMANDS, run.joint_names, has_targets=run.gains is not None
        )
        self._command = Record(self._command_layout)
        self._torque = np.zeros(len(run.joint_names))
        self._commands = 0
        self._on_state: StateHandler | None = None
        self._is_answered = False
        self._lateness = HostLateness()

    def publish(self, topic: Topic, payload: bytes) -> int:
        """Send torques to the drives, and everything else by telemetry."""
        if topic is not topics.JOINT_COMMANDS:
            return self._telemetry.publish(topic, payload)
        self._command_layout.decode(payload, self._command)
        fields = self._command.fields
        self._torque[:] = fields["effort"]
        if self._run.gains is not None:
            target = np.array([fields["position"], fields["velocity"]])
            # A drive holds a target still: it is sent as of when it gets there.
            target[0] += 1e-9 * self._run.link.emulated_round_trip_ns * target[1]
            self._master.aim(target)
        self._is_answered = True
        self._commands += 1
        return self._commands

    def serve(self, on_state: StateHandler) -> None:
        self._on_state = on_state

    def activate(self) -> None:
        """The first frames to the drives announce it, once it spins."""

    def spin(self, is_stop_requested: Callable[[], bool] = never) -> None:
        """Enable the drives, run all cycles, and bring the drives to rest.

        Raises:
            DriveError: a drive did not answer, failed, or fell silent.
            BusError: the bus itself was lost.
            Exception: any error of the handler of states.
        """
        self._take_turns(self._turns(is_stop_requested))

    def await_recorder(
        self, timeout_s: float, is_stop_requested: Callable[[], bool] = never
    ) -> None:
        self._telemetry.await_recorder(timeout_s, is_stop_requested)

    def require_same_scenario(self, role: Role, wait_s: float = 0.0) -> None:
        self._telemetry.require_same_scenario(role, wait_s)

    def await_recorded(self) -> None:
        self._telemetry.await_recorded()

    def close(self) -> None:
        """Leave the buses."""
        self._bus.close()
        self._telemetry.close()

    def _turns(self, is_stop_requested: Callable[[], bool]) -> Iterator[None]:
        tick = 0
        try:
            if not self._master.enable(self._run.link.connect_timeout_s, is_stop_requested):
                return
            self._telemetry.require_same_scenario(Role.PLANT)
            self._clock.start()
            while tick < self._run.ticks and not is_stop_requested():
                yield from self._cycle(tick, is_stop_requested)
                tick = self._next(tick)
        except DriveError as error:
            late = "" if self._run.lockstep else self._lateness.in_words(self._clock.now_ns())
            causes = [each for each in (self._master.strangers(), late) if each]
            if not causes:
                raise
            raise type(error)("; ".join([str(error), *causes])) from error
        finally:
            yield from self._bring_to_rest(tick, is_stop_requested)

    def _cycle(self, tick: int, is_stop_requested: Callable[[], bool]) -> Iterator[None]:
        self.cycle_ns = self._run.grid.tick_ns(tick)
        self._sample(tick)
        is_complete = yield from self._read(tick, is_stop_requested)
        while self._master.emergencies:
            text = self._master.emergencies.pop(0)
            event = RunEvent(self.cycle_ns, Role.CONTROLLER, EventKind.FAULT, text)
            self._telemetry.publish(topics.RUN_EVENTS, event.encode())
        if not is_complete:
            return
        self._state.stamp_ns = self.cycle_ns
        self._state.fields["effort"][:] = self._torque
        self._is_answered = False
        if self._on_state is not None:
            self._on_state(self._state.payload(), None)
        if self._is_answered:
            self._master.command(self._torque)

    def _sample(self, tick: int) -> None:
        if not self._run.lockstep:  # where every answer is waited for, none is late
            self._master.skip_late()
        self._master.sample(self._run.grid.tick_ns(tick))

    def _read(
        self, tick: int, is_stop_requested: Callable[[], bool], *, stopping: bool = False
    ) -> Generator[None, None, bool]:
        """Read the answers of all drives; return false if this tick has not all of them.

        In lockstep a missing answer ends the run; while drives are `stopping`, the master gives up
        the drive. It waits for several polls, else it would leave a drive that moves. In real time
        it never waits beyond the tick: the other drives need their torques.
        """
        position, velocity = self._state.fields["position"], self._state.fields["velocity"]
        yield
        if not self._run.lockstep:
            return self._master.read(self._patience_s(tick), position, velocity)
        waited_s, longest_s = 0.0, self._run.link.can.answer_timeout_s
        while not self._master.read(_POLL_S, position, velocity):
            waited_s += _POLL_S
            if stopping and self._master.is_stopped():
                return False
            if is_stop_requested():
                if not stopping:
                    return False
                longest_s = min(longest_s, _LONGEST_STOP_S)  # perhaps no drive is left
            if waited_s >= longest_s:
                nodes = self._master.missing()
                self._master.give_up()
                if not stopping:
                    raise DriveError(f"no answer from drive {nodes} within {waited_s:g} s")
            yield
        return True

    def _patience_s(self, tick: int) -> float:
        """Return the longest wait for the states of this tick in real time."""
        grid = self._run.grid
        due_ns = grid.tick_ns(tick) + int(_REALTIME_PATIENCE * grid.period_ns)
        return max(0.0, (due_ns - self._clock.now_ns()) * 1e-9)

    def _next(self, tick: int) -> int:
        following = tick + 1
        if not self._run.lockstep:
            following = max(following, self._run.grid.tick_at_or_before(self._clock.now_ns()))
        late_ns = self._clock.now_ns() - self._run.grid.tick_ns(tick + 1)
        late_ns = max(late_ns, self._clock.wait_until(self._run.grid.tick_ns(following)))
        self._lateness.note(late_ns, self._run.grid.tick_ns(following))
        return following

    def _bring_to_rest(self, tick: int, is_stop_requested: Callable[[], bool]) -> Iterator[None]:
        """Continue the cycle until the drives have stopped: in lockstep, it makes the time."""
        try:
            self._master.begin_stop()
            self._torque[:] = 0.0
            last = tick + max(1, int(_LONGEST_STOP_S * 1e9 / self._run.grid.period_ns))
            # The pending answers of the last tick.
            yield from self._read(tick, is_stop_requested, stopping=True)
            while not self._master.is_stopped() and tick < last:
                self._master.command(self._torque)
                tick = self._next(tick)
                self._sample(tick)
                yield from self._read(tick, is_stop_requested, stopping=True)
            self._master.leave()
        except Exception as error:  # noqa: BLE001 (what led here matters more)
            logger.error("the drives may not have been commanded to stop: %s", error)
