"""The recorder: a separate process that writes every message on the bus to an MCAP file.

It also counts messages, and missing ones.
"""

from __future__ import annotations

import contextlib
import logging
import time
from collections import Counter
from collections.abc import Callable
from itertools import chain
from pathlib import Path

from bus_schema.errors import InvalidMessageError, PeerSilentError
from bus_schema.messages import topics
from bus_schema.messages.run_event import COMMANDS_RECEIVED, EventKind, RunEvent
from bus_schema.messages.topics import Role, Topic
from bus_schema.messages.types import stamp_of
from bus_schema.zenoh.bundle_order import FORGED_NUMBER
from bus_schema.zenoh.bundles import Received
from bus_schema.zenoh.node import ZenohNode
from deploy.run.network.live_feed import LiveFeed
from deploy.run.network.snapshot import Message
from deploy.run.recording import SECOND_PLANT, LoggedView, close_log, open_log
from deploy.scenario.effective import agreement_of
from deploy.scenario.setup import Setup

logger = logging.getLogger(__name__)

_LARGEST_BACKLOG_BYTES = 1 << 27
"""A minute or more of both loops' messages at 1 kHz."""
_AT_ONCE = 10_000
_CLOSE_TIMEOUT_S = 2.0
"""Time for which the recorder still writes its backlog after a stop request."""
_MOST_COMMANDS = 1 << 40
_FROZEN_S, _RETURN_S = 2.0, 12.0
"""A recorder that stood still for this long gives its peers time to connect again."""
_PAUSE_S = 0.02
"""Time between two checks of the mailbox: waking up for each message would cost the loops time."""
_MOST_STREAMS = 10_000  # forged ids, one per message, must not fill the memory
_LONGEST_GAP = 1 << 24
"""Longest gap counted, hours at 1 kHz; a longer one shows no number of messages."""
_MOST_EVENTS, _MOST_EVENT_BYTES, _MOST_EVENT_SENDERS = 5000, 1 << 20, 64
"""Limits on events per sender, their bytes, and senders; our processes send some dozens."""


class Recorder:
    """Writes every message on the bus until both sides have left.

    Its backlog is bounded. In real time, if the disk is too slow, the oldest messages are dropped,
    so that no sender ever waits; in lockstep senders wait, and nothing is lost. A disk failure ends
    the recording but not the run: later messages are counted.

    Args:
        setup: the scenario.
        path: file of the recording.
        feed: takes all messages, for a live view.
        run_key: key of the run; empty if this recorder was started on its own.

    Raises:
        OSError: the recording cannot be begun.
    """

    def __init__(
        self, setup: Setup, path: Path, feed: LiveFeed | None = None, run_key: str = ""
    ) -> None:
        self._setup, self._feed = setup, feed
        self._log = open_log(setup, path, clock=setup.scenario.clock, link=setup.link_kind.name)
        self._progress: dict[bytes, int] = {}
        self._commands_received = 0
        self._last_stamp_ns = 0
        lossless = self._is_virtual = setup.scenario.clock == "lockstep"
        self._pacing = {topic.name for topic in topics.TOPICS if lossless and topic.paces}
        agreement = agreement_of(setup, run_key)
        self._node = ZenohNode(
            setup.scenario.link, Role.RECORDER, lossless=lossless, agreement=agreement
        )
        self._mailbox = self._node.listen_to_all(_LARGEST_BACKLOG_BYTES, lossless=lossless)
        rejected = self._mailbox.rejected
        self._gaps, self._events = GapCounter(rejected), EventBudget()
        self._plants = PlantSenders(rejected)
        for topic in topics.VIEW_TOPICS:
            self._node.advertise(topic)
        sent_ns = 0 if self._is_virtual else time.time_ns()
        self._view = LoggedView(self._log, setup.robot, self._node.publish, sent_ns)
        self._node.announce()

    @property
    def messages(self) -> int:
        """Number of messages in the recording."""
        return self._log.messages

    @property
    def lost(self) -> Counter[str]:
        """Number of lost messages by topic: gaps in their senders' numbers, and disk failures."""
        return self._gaps.missed + self._log.lost

    @property
    def rejected(self) -> Counter[str]:
        """Number of messages forged in the name of a process of this run, by reason."""
        return self._mailbox.rejected

    @property
    def failure(self) -> OSError | None:
        """Reason why the recording ended early; None if it did not."""
        return self._log.failure

    def run(self, is_stop_requested: Callable[[], bool]) -> None:
        """Record until both sides have left the bus, or until asked to stop.

        Raises:
            PeerSilentError: no process joined.
            ScenarioMismatchError: a process runs another scenario, and would be judged by this one.
        """
        give_up_s = time.monotonic() + self._setup.scenario.link.connect_timeout_s
        has_received = False
        looked_s = stay_until_s = time.monotonic()
        silences = [self._node.watch_silence(role) for role in (Role.PLANT, Role.CONTROLLER)]
        while not is_stop_requested():
            if time.monotonic() > looked_s + _FROZEN_S:
                stay_until_s = time.monotonic() + _RETURN_S
            looked_s = time.monotonic()
            a_peer_is_there = self._node.sees(Role.PLANT) or self._node.sees(Role.CONTROLLER)
            for role in (Role.PLANT, Role.CONTROLLER):
                if not has_received or not self._node.says_its_scenario(role):
                    self._node.require_same_scenario(role)
            time.sleep(_PAUSE_S)
            has_written = self._write_what_came()
            has_received = has_received or has_written
            if a_peer_is_there or has_written:
                continue
            if has_received:
                if looked_s > stay_until_s:
                    return
                continue
            for silence in silences:
                silence.look()
            if time.monotonic() > give_up_s:
                raise PeerSilentError(
                    "plant", self._setup.scenario.link.connect_timeout_s, "message"
                )

    def close(self) -> None:
        """Write the received messages, as far as there is time, and finish the file."""
        give_up_s = time.monotonic() + _CLOSE_TIMEOUT_S
        while time.monotonic() < give_up_s and self._write_what_came():
            pass
        self._write(self._mailbox.let_go())
        for topic, _, sequence, _, gid in chain.from_iterable(iter(self._mailbox.take, None)):
            self._note_number(topic, gid, sequence)
            self._gaps.missed[topic.name] += 1
        self._compare_with_the_plant()
        if self.rejected:
            logger.warning(
                "another sender on the bus uses the name of a process of this run (%s);"
                " link.security prevents this",
                ", ".join(f"{reason}: {count}" for reason, count in self.rejected.items()),
            )  # fmt: skip
        if self._mailbox.dropped:
            logger.warning(
                "messages arrived faster than they could be written: %d deliveries were"
                " dropped", self._mailbox.dropped
            )  # fmt: skip
        close_log(self._log, self._gaps.missed, self.rejected)
        self._node.close()

    def _write_what_came(self) -> bool:
        """Write all waiting messages, or many of them; return whether there were any."""
        taken = written = 0
        while taken < _AT_ONCE and (messages := self._mailbox.take()) is not None:
            self._write(messages)
            written += len(messages)
            taken += 1 + len(messages)  # foreign messages take time too
        for gid, sequence in self._progress.items():
            self._node.tell_progress(gid, sequence)
        self._progress.clear()
        if self._feed is not None:
            self._feed.send()
        return written > 0

    def _write(self, messages: list[Received]) -> None:
        """Write messages: the recorder's main work."""
        stamp_ns = self._last_stamp_ns
        feed = self._feed if self._feed is not None and self._feed.is_watched else None
        for topic, payload, sequence, source_time_ns, gid in messages:
            self._note_number(topic, gid, sequence)
            if topic.sender is Role.PLANT:
                self._plants.note(topic.name, gid, sequence)
            if topic is topics.RUN_EVENTS and not self._events.admits(gid, len(payload)):
                self._gaps.missed[topic.name] += 1
                continue
            told_ns = stamp_of(payload)
            if told_ns is not None:
                stamp_ns = told_ns
            # In virtual time, the wall time of sending is irrelevant to the run.
            sent_ns = stamp_ns if self._is_virtual else source_time_ns
            self._log.write(topic, sequence, stamp_ns, sent_ns, payload)
            if topic is topics.JOINT_STATES:
                self._view.show(payload, stamp_ns, sent_ns)
            elif topic is topics.RUN_EVENTS:
                self._read_event(payload, gid, sequence)
            elif topic.name in self._pacing and gid:
                self._progress[gid] = sequence
            if feed is not None:
                feed.take(Message(topic, stamp_ns, payload))
        self._last_stamp_ns = stamp_ns

    def _note_number(self, topic: Topic, gid: bytes, sequence: int) -> None:
        """Count missing messages by their numbers; a rejected sender may become the commander."""
        is_rejected = topic is topics.REJECTED_COMMANDS
        name = topics.JOINT_COMMANDS.name if is_rejected else topic.name
        self._gaps.note(name, gid, sequence, counts=not is_rejected)

    def _read_event(self, payload: bytes, gid: bytes, sequence: int) -> None:
        """Acknowledge to a process, at its last message, that all its messages are recorded."""
        with contextlib.suppress(InvalidMessageError):
            event = RunEvent.decode(payload)
            if event.source == Role.PLANT:
                self._plants.note(topics.RUN_EVENTS.name, gid, sequence)
            if event.kind == EventKind.ENDED and gid:
                self._node.acknowledge(gid)
            if event.kind == EventKind.COUNTS and event.source == Role.PLANT:
                count = event.values().get(COMMANDS_RECEIVED)
                if isinstance(count, int) and 0 <= count < _MOST_COMMANDS:
                    self._commands_received = count

    def _compare_with_the_plant(self) -> None:
        """Count commands that the plant received and that never arrived here."""
        name, rejected = topics.JOINT_COMMANDS.name, topics.REJECTED_COMMANDS.name
        came = sum(each[name] + each[rejected] for each in (self._log.written, self._log.lost))
        missing = self._gaps.expect(name, self._commands_received, came)
        if missing:
            logger.warning(
                "the plant received %d commands that the recorder did not: a controller must"
                " listen at link.controller_endpoint (%s), where recorders connect, or be a"
                " Zenoh client of the plant",
                missing, self._setup.scenario.link.controller_endpoint,
            )  # fmt: skip


class GapCounter:
    """Counts missing messages by the gaps in their senders' numbers.

    Args:
        rejected: counts, by reason, messages with impossible numbers.

    Attributes:
        missed: messages that are missing, by topic.
    """

    def __init__(self, rejected: Counter[str]) -> None:
        self._last_sequence: dict[tuple[str, bytes], int] = {}
        self.missed: Counter[str] = Counter()
        self._rejected = rejected

    def note(self, topic: str, sender: bytes, sequence: int, *, counts: bool = True) -> None:
        """Note a message and, if it `counts`, those missing since its sender's last one.

        Messages without a number (0) show no gaps.
        """
        stream = topic, sender
        last = self._last_sequence.get(stream, 0)
        if not last and len(self._last_sequence) >= _MOST_STREAMS:
            return
        if sequence > last + _LONGEST_GAP:
            self._rejected[FORGED_NUMBER] += 1
            if not last:  # a sender that began long ago
                self._last_sequence[stream] = sequence
        elif sequence > last:
            self._last_sequence[stream] = sequence
            if counts and sequence > last + 1:
                self.missed[topic] += sequence - last - 1

    def expect(self, topic: str, count: int, came: int) -> int:
        """Compare with another receiver: it got `count` messages, of which `came` arrived here too.

        Return how many of the rest were not yet counted as missing.
        """
        unknown = max(0, count - came - self.missed[topic])
        self.missed[topic] += unknown
        return unknown


class PlantSenders:
    """Counts messages that a run's only plant cannot have sent: by a second sender, or repeated.

    Args:
        rejected: counts them, by reason.
    """

    def __init__(self, rejected: Counter[str]) -> None:
        self._rejected = rejected
        self._last: dict[str, tuple[bytes, int]] = {}

    def note(self, topic: str, sender: bytes, sequence: int) -> None:
        """Note a message of the plant's topics; its number is 0 if its sender gives none."""
        known, last = self._last.setdefault(topic, (sender, sequence - 1))
        if sender != known or (last > 0 and sequence <= last):
            self._rejected[SECOND_PLANT] += 1
        else:
            self._last[topic] = sender, sequence


class EventBudget:
    """Limit on recorded run events: the judge of a run keeps all of them in memory."""

    def __init__(self) -> None:
        self._spent: dict[bytes, tuple[int, int]] = {}

    def admits(self, sender: bytes, size_bytes: int) -> bool:
        """Whether another event of a sender is recorded."""
        if sender not in self._spent and len(self._spent) >= _MOST_EVENT_SENDERS:
            return False
        count, spent_bytes = self._spent.get(sender, (0, 0))
        self._spent[sender] = count + 1, spent_bytes + size_bytes
        return count < _MOST_EVENTS and spent_bytes + size_bytes <= _MOST_EVENT_BYTES
