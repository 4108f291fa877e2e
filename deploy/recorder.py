"""The recorder: a process of its own that writes every message on the bus to an MCAP file."""

from __future__ import annotations

import contextlib
import struct
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

from bus_schema import topics
from bus_schema.errors import InvalidMessageError, PeerSilentError
from bus_schema.events import EventKind, RunEvent
from bus_schema.mcap_log import McapLog
from bus_schema.rmw_wire import Attachment
from bus_schema.topics import Role, Topic
from bus_schema.zenoh_node import ZenohNode
from bus_schema.zenoh_session import Delivery
from deploy.scenario import Setup
from deploy.scenario_text import effective_scenario

SCENARIO_ATTACHMENT = "scenario.yaml"
ROBOT_ATTACHMENT = "robot.urdf"
RUN_METADATA = "run"
RECORDER_METADATA = "recorder"
_STAMP = struct.Struct("<iI")
_STAMP_OFFSET = 4
_LARGEST_BACKLOG = 200_000
_PAUSE_S = 0.02
"""Between two looks into the mailbox: waking up for each message would cost the loops time."""


def open_log(setup: Setup, path: Path, *, clock: str, link: str) -> McapLog:
    """Begin the recording of a run, with all that is needed to judge or repeat it."""
    names = setup.robot.joint_names
    tick_bytes = sum(
        topics.layout(topic, names).size
        for topic in topics.TOPICS
        if topic.rate is topics.Rate.TICK
    )
    log = McapLog(path, bytes_per_s=tick_bytes * setup.scenario.rate_hz)
    scenario = setup.scenario
    log.attach(SCENARIO_ATTACHMENT, "application/yaml", effective_scenario(setup).encode())
    log.attach(ROBOT_ATTACHMENT, "application/xml", setup.robot.resolved_urdf().encode())
    log.add_metadata(
        RUN_METADATA,
        {"scenario": scenario.name, "law": scenario.controller.law, "clock": clock, "link": link},
    )
    return log


def stamp_of(payload: bytes) -> int | None:
    """Header stamp of a CDR payload in ns; all our messages begin with a header."""
    if len(payload) < _STAMP_OFFSET + _STAMP.size:
        return None
    sec, nanosec = _STAMP.unpack_from(payload, _STAMP_OFFSET)
    stamp_ns: int = sec * 1_000_000_000 + nanosec
    return stamp_ns if stamp_ns >= 0 else None


class Recorder:
    """Writes what it hears until both sides have left.

    Attributes:
        messages: messages written.
        lost: messages that never came, by the gaps in their senders' numbers.
    """

    def __init__(self, setup: Setup, path: Path) -> None:
        self._setup = setup
        self._log = open_log(setup, path, clock=setup.scenario.clock, link=setup.scenario.link.kind)
        domain = setup.scenario.link.domain
        self._topics = {topic.key_expression(domain): topic for topic in topics.TOPICS}
        self._last_sequence: defaultdict[tuple[str, bytes], int] = defaultdict(int)
        self._last_stamp_ns = 0
        self.messages = 0
        self.lost = 0
        self._node = ZenohNode(setup.scenario.link, Role.RECORDER, lossless=True)
        self._mailbox = self._node.listen_to_all(_LARGEST_BACKLOG)
        self._node.announce()

    def run(self, is_stop_requested: Callable[[], bool]) -> None:
        """Record until both sides have left the bus, or until asked to stop.

        Raises:
            PeerSilentError: nobody came.
        """
        give_up_s = time.monotonic() + self._setup.scenario.link.connect_timeout_s
        has_heard = False
        silences = [self._node.watch_silence(role) for role in (Role.PLANT, Role.CONTROLLER)]
        while not is_stop_requested():
            somebody_is_there = self._node.sees(Role.PLANT) or self._node.sees(Role.CONTROLLER)
            time.sleep(_PAUSE_S)
            wrote = self._write_what_came()
            has_heard = has_heard or wrote
            if has_heard and not somebody_is_there and not wrote:
                return
            if not has_heard and not somebody_is_there:
                for silence in silences:
                    silence.look()
            if not has_heard and not somebody_is_there and time.monotonic() > give_up_s:
                raise PeerSilentError(
                    "plant", self._setup.scenario.link.connect_timeout_s, "message"
                )

    def close(self) -> None:
        """Write what was heard, and finish the file."""
        self._write_what_came()
        counts = {"messages": str(self.messages), "lost": str(self.lost)}
        self._log.add_metadata(RECORDER_METADATA, counts)
        self._log.close()
        self._node.close()

    def _write_what_came(self) -> bool:
        """Write what has come in and hand it to the disk; whether anything had."""
        wrote = False
        while (item := self._mailbox.take()) is not None:
            key, delivery = item
            topic = self._topics.get(key)
            if topic is not None:
                self._write(topic, delivery)
                wrote = True
        self._log.flush()
        return wrote

    def _write(self, topic: Topic, delivery: Delivery) -> None:
        attachment = Attachment.decode(delivery.attachment) or Attachment(0, 0, b"")
        if attachment.sequence:
            key = (topic.name, attachment.gid)
            self.lost += max(0, attachment.sequence - self._last_sequence[key] - 1)
            self._last_sequence[key] = max(attachment.sequence, self._last_sequence[key])
        stamp_ns = stamp_of(delivery.payload)
        self._last_stamp_ns = self._last_stamp_ns if stamp_ns is None else stamp_ns
        self._log.write(
            topic, attachment.sequence, self._last_stamp_ns, attachment.source_time_ns,
            delivery.payload,
        )  # fmt: skip
        self.messages += 1
        if topic is topics.RUN_EVENTS and attachment.gid:
            self._acknowledge(delivery.payload, attachment.gid)

    def _acknowledge(self, payload: bytes, gid: bytes) -> None:
        """Tell a process that said its last word that all of it is recorded."""
        with contextlib.suppress(InvalidMessageError):
            if RunEvent.decode(payload).kind == EventKind.ENDED:
                self._node.acknowledge(gid)
