"""Mutated payloads, attachments and keys through all that decodes what comes off the bus."""

from __future__ import annotations

import contextlib
import logging
import struct
from collections import Counter
from functools import cache
from pathlib import Path

import numpy as np
from mutation import Mutator

from bus_schema.errors import InvalidMessageError
from bus_schema.link.in_process import InProcessBus, InProcessControllerLink
from bus_schema.messages import topics
from bus_schema.messages.record import Record
from bus_schema.messages.run_event import EventKind, RunEvent
from bus_schema.messages.topics import Role
from bus_schema.messages.types import JOINT_STATE, TYPESTORE, stamp_of
from bus_schema.recording.mcap_log import McapLog
from bus_schema.runtime.clock import VirtualClock
from bus_schema.runtime.modes import Mode
from bus_schema.zenoh.arrivals import arrival_of
from bus_schema.zenoh.ros_graph import Attachment, Entity, EntityKind, endpoint_token
from controller.control_loop import ControlLoop
from controller.torque_guard import ControllerError
from deploy.scenario.scenario import load_setup
from plant_emulator.command_gate import Command, CommandGate

NEWEST_NS = 10**15
COMMANDER = b"commander_123456"
_NS = 1_000_000_000
_SHOTS_PER_GATE = 5
_KINDS = ("command", "state", "status", "layout", "event", "attachment", "key")
_layout = cache(topics.layout)


class Target:
    """Everything that decodes, and what it must never do.

    Attributes:
        accepted: mutations that came through as commands, each of them checked.
        stops: mutated states on which the law failed, and the controller stopped in order.
        kinds: mutations by what was mutated.
    """

    def __init__(self, seed: int, folder: Path) -> None:
        logging.disable(logging.ERROR)  # a rejection is logged; a hundred thousand are noise
        self._setup = load_setup("paper_arm", ["controller.law=pid", "duration_s=1"])
        self._names = self._setup.robot.joint_names
        self._mutator = Mutator(seed)
        self._gate = CommandGate(self._names)
        self._bus = InProcessBus(VirtualClock())
        self._loop = self._controller()
        self._log = McapLog(folder / "fuzz.mcap", bytes_per_s=1e6)
        self._payloads = {topic: self._payload(topic) for topic in topics.TOPICS}
        self._fixed = [topic for topic in self._payloads if topic is not topics.RUN_EVENTS]
        self._sequence = 0
        self._stamp_ns = 0
        self._shots = 0
        self.accepted = 0
        self.stops = 0
        self.kinds: Counter[str] = Counter()

    def close(self) -> None:
        self._log.close()
        logging.disable(logging.NOTSET)
        assert self._log.failure is None

    @property
    def rejected(self) -> Counter[str]:
        return self._gate.rejections.counts

    def attack(self) -> None:
        """Mutate one thing and have it decoded."""
        kind = self._mutator.choose(_KINDS)
        self.kinds[kind] += 1
        getattr(self, f"_attack_{kind}")()
        self._bus.topics.clear()
        self._bus.payloads.clear()
        self._bus.commands.clear()

    def _attack_command(self) -> None:
        payload = self._mutator.bytes(self._command())
        self._admit(payload, self._attachment())

    def _attack_attachment(self) -> None:
        attachment = self._mutator.bytes(self._attachment())
        self._admit(self._command(), attachment)
        decoded = Attachment.decode(attachment) or Attachment(0, 0, b"")
        payload = self._payloads[topics.JOINT_STATES]
        self._log.write(
            topics.JOINT_STATES, decoded.sequence, stamp_of(payload) or 0,
            decoded.source_time_ns, payload,
        )  # fmt: skip

    def _attack_state(self) -> None:
        payload = self._mutator.bytes(self._payloads[topics.JOINT_STATES])
        stamp_of(payload)
        before = self._loop.stamp_ns
        try:
            self._loop.cycle(payload, self._payloads[topics.PLANT_STATUS])
        except ControllerError:  # of absurd but finite numbers a law may make what is no torque
            self._check_stop()
            return
        assert self._loop.stamp_ns >= before
        for command in self._bus.commands:
            assert np.isfinite(self._effort(command.payload)).all()
        self._loop.stamp_ns = -1  # a state of the far future would make all others late

    def _check_stop(self) -> None:
        """The controller stopped in order, and its last torque is zero."""
        assert self._loop.mode is Mode.FAULT
        assert self._effort(self._bus.commands[-1].payload).tolist() == [0.0, 0.0, 0.0]
        self.stops += 1
        self._loop = self._controller()

    def _controller(self) -> ControlLoop:
        return ControlLoop(self._setup.control_task(), InProcessControllerLink(self._bus))

    def _attack_status(self) -> None:
        payload = self._mutator.bytes(self._payloads[topics.PLANT_STATUS])
        try:
            self._loop.cycle(self._payloads[topics.JOINT_STATES], payload)
        except ControllerError:  # it says when the run began, and so what the reference is
            self._check_stop()

    def _attack_layout(self) -> None:
        """A message of any layout is read, or rejected with a reason."""
        topic = self._mutator.choose(self._fixed)
        layout = _layout(topic, self._names)
        record = Record(layout)
        try:
            layout.decode(self._mutator.bytes(self._payloads[topic]), record)
        except InvalidMessageError as error:
            assert error.reason.isidentifier()
            return
        assert len(record.payload()) == layout.size

    def _attack_event(self) -> None:
        payload = self._mutator.bytes(self._payloads[topics.RUN_EVENTS])
        with contextlib.suppress(InvalidMessageError):
            RunEvent.decode(payload).values()

    def _attack_key(self) -> None:
        token = endpoint_token(0, "abc", "node", 1, EntityKind.PUBLISHER, topics.JOINT_COMMANDS)
        Entity.from_token(self._mutator.text(token))

    def _admit(self, payload: bytes, attachment: bytes) -> None:
        self._shots += 1
        if self._shots % _SHOTS_PER_GATE == 0:  # a forged number or stamp would shut it for good
            self._gate = _like(self._gate, self._names)
        fence = self._gate.newest_ns
        command = self._gate.admit(arrival_of(payload, attachment, 0), NEWEST_NS)
        if command is None:
            return
        self.accepted += 1
        self._check(command, payload, fence)

    def _check(self, command: Command, payload: bytes, fence_ns: int) -> None:
        """What came through says, by the reference decoder too, what is put into force."""
        message = TYPESTORE.deserialize_cdr(payload, JOINT_STATE)
        text = dict(zip(message.name, message.effort.tolist(), strict=True))
        assert [text[name] for name in self._names] == command.torque_nm.tolist()
        assert np.isfinite(command.torque_nm).all()
        stamp = message.header.stamp
        assert command.stamp_ns == stamp.sec * _NS + stamp.nanosec
        assert fence_ns < command.stamp_ns <= NEWEST_NS

    def _command(self) -> bytes:
        self._stamp_ns += 1000
        return self._payload(topics.JOINT_COMMANDS, self._stamp_ns)

    def _attachment(self) -> bytes:
        self._sequence += 1
        return Attachment(self._sequence, 5, COMMANDER).encode()

    def _payload(self, topic: topics.Topic, stamp_ns: int = 0) -> bytes:
        if topic is topics.RUN_EVENTS:
            return RunEvent(0, Role.PLANT, EventKind.COUNTS, '{"a": [1, {"b": 2}]}').encode()
        record = Record(_layout(topic, self._names))
        record.stamp_ns = stamp_ns
        if topic is topics.JOINT_COMMANDS:
            record.fields["effort"][:] = (1.5, -2.5, 3.5)
        return record.payload()

    def _effort(self, payload: bytes) -> np.ndarray:
        return np.array(struct.unpack("<3d", payload[-24:]))


def _like(gate: CommandGate, names: tuple[str, ...]) -> CommandGate:
    """A fresh gate that goes on counting where another left off."""
    fresh = CommandGate(names)
    fresh.rejections = gate.rejections
    return fresh
