"""Faults between the plant and its bus: messages are spoilt, whole processes are struck.

It stands in front of any link, so that the loop, the gate and the bus are those of every other run.
"""

from __future__ import annotations

import math
import struct
from collections import deque
from collections.abc import Callable, Iterable
from typing import NamedTuple, TypeVar

import numpy as np

from bus_schema.errors import InvalidMessageError
from bus_schema.link.interface import CommandArrival, PlantLink
from bus_schema.messages import topics
from bus_schema.messages.layout import Record
from bus_schema.messages.run_event import EventKind, RunEvent
from bus_schema.messages.topics import Role, Topic
from bus_schema.runtime.clock import Clock
from plant_emulator.channel.random_numbers import uniform_numbers
from plant_emulator.command_gate import CommandGate
from plant_emulator.fault_configuration import (
    FOREVER_NS,
    ClockStep,
    Fault,
    LinkCorrupted,
    NonFiniteCommand,
    SecondCommander,
)

SECOND_COMMANDER = b"second commander"
"""Sender id of the second commander."""
_STAMP = struct.Struct("<iI")
_STAMP_OFFSET = 4
_STREAM = 102
_F = TypeVar("_F", bound=Fault)


class Strike(NamedTuple):
    """Something done to a whole process.

    Attributes:
        at_ns: when, on the plant's clock.
        text: what is told of it.
        act: does it.
    """

    at_ns: int
    text: str
    act: Callable[[], None]


class FaultyLink:
    """A link on which the scheduled faults happen, and every fault's beginning and end is told.

    The plant waits for one answer to each state. An answer that came is one that came, whatever
    has become of it; to a state that nobody can read, none will come.

    Args:
        link: the link proper.
        clock: the plant's clock.
        gate: the gate that commands go to.
        joint_names: names of the joints.
        faults: all faults of the plant; those of other parts are told of, no more.
        strikes: what is done to processes.
        seed: the scenario's seed.
    """

    def __init__(
        self,
        link: PlantLink,
        clock: Clock,
        gate: CommandGate,
        joint_names: tuple[str, ...],
        faults: Iterable[Fault],
        strikes: Iterable[Strike],
        seed: int,
    ) -> None:
        self._link, self._clock, self._gate = link, clock, gate
        self._faults = tuple(faults)
        stream = np.random.SeedSequence(seed, spawn_key=(_STREAM,))
        self._numbers = uniform_numbers(np.random.default_rng(stream))
        self._timeline = _timeline(self._faults, strikes)
        self._layout = topics.layout(topics.JOINT_COMMANDS, joint_names)
        self._command = Record(self._layout)
        self._sent_stamp_ns = -1
        self._was_unreadable = False
        self._intruders_sequence = 0
        self.await_controller = link.await_controller
        self.controller_has_left = link.controller_has_left
        self.sender_has_left = link.sender_has_left
        self.fault, self.report, self.overflow = link.fault, link.report, link.overflow
        self.await_recorder, self.await_recorded = link.await_recorder, link.await_recorded
        self.close = link.close

    def publish(self, topic: Topic, payload: bytes) -> int:
        self._advance()
        return self._link.publish(topic, payload)

    def send_state(self, state: bytes, status: bytes) -> None:
        self._advance()
        for step in self._active(ClockStep):
            if step.side == "plant":
                state, status = _shifted(state, step.step_ns), _shifted(status, step.step_ns)
        self._sent_stamp_ns = _stamp_ns(state)
        self._was_unreadable = False
        for fault in self._active(LinkCorrupted):
            if fault.direction == "uplink" and next(self._numbers) < fault.share:
                state = self._cut_off(state)
                self._was_unreadable = True
        self._link.send_state(state, status)

    def await_command(self, timeout_s: float) -> bool:
        if self._was_unreadable:
            self._gate.awaited_ns = None
            return True
        return self._link.await_command(timeout_s)

    def take_commands(self) -> list[CommandArrival]:
        taken: list[CommandArrival] = []
        for arrival in self._link.take_commands():
            if self._gate.awaited_ns is not None and self._answers_last_state(arrival):
                self._gate.awaited_ns = None
            taken.extend(self._intruders(arrival))
            taken.append(arrival._replace(payload=self._spoilt(arrival.payload)))
        return taken

    def _answers_last_state(self, arrival: CommandArrival) -> bool:
        is_whole = len(arrival.payload) >= _STAMP_OFFSET + _STAMP.size
        return is_whole and _stamp_ns(arrival.payload) == self._sent_stamp_ns

    def _spoilt(self, command: bytes) -> bytes:
        for step in self._active(ClockStep):
            if step.side == "controller":
                command = _shifted(command, step.step_ns)
        for _ in self._active(NonFiniteCommand):
            command = self._with_torque(command, math.nan, joints=slice(1))
        for fault in self._active(LinkCorrupted):
            if fault.direction == "downlink" and next(self._numbers) < fault.share:
                command = self._cut_off(command)
        return command

    def _intruders(self, arrival: CommandArrival) -> Iterable[CommandArrival]:
        for fault in self._active(SecondCommander):
            self._intruders_sequence += 1
            yield CommandArrival(
                self._with_torque(arrival.payload, fault.torque_nm, joints=slice(None)),
                self._intruders_sequence, SECOND_COMMANDER, arrival.arrival_ns,
            )  # fmt: skip

    def _with_torque(self, command: bytes, torque_nm: float, *, joints: slice) -> bytes:
        """A command that asks for another torque; as it is where it cannot be read."""
        try:
            self._layout.decode(command, self._command)
        except InvalidMessageError:
            return command
        self._command.fields["effort"][joints] = torque_nm
        return self._command.payload()

    def _cut_off(self, payload: bytes) -> bytes:
        return payload[: int(next(self._numbers) * len(payload))]

    def _active(self, kind: type[_F]) -> list[_F]:
        now_ns = self._clock.now_ns()
        return [f for f in self._faults if isinstance(f, kind) and f.is_active(now_ns)]

    def _advance(self) -> None:
        """Do and tell what has fallen due."""
        while self._timeline and self._timeline[0].at_ns <= self._clock.now_ns():
            strike = self._timeline.popleft()
            event = RunEvent(self._clock.now_ns(), Role.PLANT, EventKind.INJECTED, strike.text)
            self._link.publish(topics.RUN_EVENTS, event.encode())
            strike.act()


def _timeline(faults: Iterable[Fault], strikes: Iterable[Strike]) -> deque[Strike]:
    entries = list(strikes)
    for fault in faults:
        entries.append(Strike(fault.start_ns, f"{fault}: begins", _nothing))
        if fault.end_ns < FOREVER_NS:
            entries.append(Strike(fault.end_ns, f"{fault}: is over", _nothing))
    return deque(sorted(entries, key=lambda entry: entry.at_ns))


def _nothing() -> None:
    """All that is left to do is to tell of it."""


def _stamp_ns(payload: bytes) -> int:
    sec, nanosec = _STAMP.unpack_from(payload, _STAMP_OFFSET)
    return int(sec * 1_000_000_000 + nanosec)


def _shifted(payload: bytes, by_ns: int) -> bytes:
    """A message with a header whose stamp is so much later, but not before 0."""
    if len(payload) < _STAMP_OFFSET + _STAMP.size:
        return payload
    word = _STAMP.pack(*divmod(max(0, _stamp_ns(payload) + by_ns), 1_000_000_000))
    return payload[:_STAMP_OFFSET] + word + payload[_STAMP_OFFSET + _STAMP.size :]
