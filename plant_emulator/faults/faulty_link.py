"""A link with scheduled faults.

It wraps any link, so loop, gate and bus are the same as in any other run.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from bus_schema.link.interface import CommandArrival, CommandSessions, PlantLink
from bus_schema.messages import topics
from bus_schema.messages.run_event import EventKind, RunEvent
from bus_schema.messages.topics import Role, Topic
from bus_schema.messages.types import stamp_of
from bus_schema.runtime.clock import Clock
from bus_schema.runtime.randomness import generator
from plant_emulator.channel.jitter import endless
from plant_emulator.command_gate import CommandGate
from plant_emulator.faults.fault import FOREVER_NS, Fault, FaultScheduler, ScheduledAction
from plant_emulator.faults.message_faults import (
    SECOND_COMMANDER,
    Direction,
    MessageEditor,
    MessageFault,
    SecondCommander,
)

_STREAM = 102


class FaultyLink:
    """A `PlantLink` with scheduled faults; it announces the start and end of each.

    The plant waits for one answer to each state. An answer counts as received even if a fault
    spoiled it; an unreadable state gets none. Everything else is passed to the wrapped link.

    Args:
        link: the wrapped link.
        clock: the plant's clock.
        gate: the gate that checks commands.
        faults: all faults of the plant; those of other parts are only announced.
        process_actions: actions requested from the process that started the run.
        seed: the scenario's seed.
    """

    def __init__(
        self,
        link: PlantLink,
        clock: Clock,
        gate: CommandGate,
        faults: Sequence[Fault],
        process_actions: Iterable[ScheduledAction],
        seed: int,
    ) -> None:
        self._link, self._clock, self._gate = link, clock, gate
        self.sessions = _RealSessions(link.sessions)
        message_faults = [fault for fault in faults if isinstance(fault, MessageFault)]
        # The sender's faults are applied before the link's.
        self._message_faults = sorted(message_faults, key=lambda fault: fault.happens_on_the_way)
        self._commanders = [fault for fault in faults if isinstance(fault, SecondCommander)]
        stream = np.random.SeedSequence(seed, spawn_key=(_STREAM,))
        self._editor = MessageEditor(gate.layout, endless(generator(stream).random))
        self._schedule = FaultScheduler([*process_actions, *_announcements(faults)])
        self._sent_stamp_ns: int | None = None
        self._was_unreadable = False
        self._added_commands = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._link, name)

    def publish(self, topic: Topic, payload: bytes) -> int:
        self._run_schedule()
        return self._link.publish(topic, payload)

    def send_state(self, state: bytes, status: bytes) -> None:
        self._run_schedule()
        sent, sent_status = self._changed((state, status), "uplink")
        self._was_unreadable = len(sent) != len(state)
        self._sent_stamp_ns = stamp_of(sent)
        self._link.send_state(sent, sent_status)

    def await_command(self, timeout_s: float) -> bool:
        if self._was_unreadable:
            self._gate.stop_waiting()
            return True
        return self._link.await_command(timeout_s)

    def take_commands(self) -> list[CommandArrival]:
        taken: list[CommandArrival] = []
        for arrival in self._link.take_commands():
            answered_ns = stamp_of(arrival.payload)
            if answered_ns is not None and answered_ns == self._sent_stamp_ns:
                self._gate.stop_waiting()
            taken.extend(self._added(arrival))
            (payload,) = self._changed((arrival.payload,), "downlink")
            taken.append(arrival._replace(payload=payload))
        return taken

    def _changed(self, messages: tuple[bytes, ...], direction: Direction) -> tuple[bytes, ...]:
        now_ns = self._clock.now_ns()
        for fault in self._message_faults:
            if fault.is_active(now_ns):
                messages = fault.changed(direction, messages, self._editor)
        return messages

    def _added(self, arrival: CommandArrival) -> Iterable[CommandArrival]:
        now_ns = self._clock.now_ns()
        for fault in self._commanders:
            if fault.is_active(now_ns):
                self._added_commands += 1
                command = fault.added_command(arrival, self._editor)
                yield command._replace(sequence=self._added_commands)

    def _run_schedule(self) -> None:
        self._schedule.run_due(self._clock.now_ns(), self._announce)

    def _announce(self, text: str) -> None:
        event = RunEvent(self._clock.now_ns(), Role.PLANT, EventKind.INJECTED, text)
        self._link.publish(topics.RUN_EVENTS, event.encode())


class _RealSessions:
    """The sessions of the wrapped link, without the second commander, which sends no messages."""

    def __init__(self, sessions: CommandSessions) -> None:
        self._sessions = sessions

    def __getattr__(self, name: str) -> Any:
        return getattr(self._sessions, name)

    def note_commander(self, sender: bytes) -> None:
        if sender != SECOND_COMMANDER:
            self._sessions.note_commander(sender)


def _announcements(faults: Iterable[Fault]) -> Iterable[ScheduledAction]:
    for fault in faults:
        yield ScheduledAction(fault.start_ns, f"{fault}: begins")
        if fault.end_ns < FOREVER_NS:
            yield ScheduledAction(fault.end_ns, f"{fault}: is over")
