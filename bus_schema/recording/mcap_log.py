"""Recordings: MCAP files with profile ``ros2``, schemas in ``ros2msg`` and payloads in ``cdr``.

The payloads are those of the wire. After a kill, the file is readable up to the last chunk that
reached the disk. A file that differs from what was written is reported as damaged
(`checked_records`).
"""

from __future__ import annotations

import logging
import os
from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, cast

from mcap.records import Attachment, Channel, Message, Metadata, Schema, Statistics

from bus_schema.messages.topics import TOPICS, VIEW_TOPICS, Topic
from bus_schema.messages.types import has_todays_form, schema_text
from bus_schema.recording.atomic_files import RecordFile, complete, is_partial, new_partial
from bus_schema.recording.checked_records import CheckedRecords
from bus_schema.recording.mcap_writer import McapWriter, append_metadata

logger = logging.getLogger(__name__)

_LARGEST_CHUNK_BYTES = 256 * 1024
_RESERVE_BYTES = 64 * 1024
_SHOWN_DAMAGE = 10
_TYPES = {topic.name: topic.type_name for topic in (*TOPICS, *VIEW_TOPICS)}
_OFFERED_QOS = """- history: keep_last
  depth: {depth}
  reliability: reliable
  durability: {durability}
  deadline: {{sec: 2147483647, nsec: 4294967295}}
  lifespan: {{sec: 2147483647, nsec: 4294967295}}
  liveliness: automatic
  liveliness_lease_duration: {{sec: 2147483647, nsec: 4294967295}}
  avoid_ros_namespace_conventions: false
"""


class McapLog:
    """A recording that is being written, under its final name once complete (`atomic_files`).

    A disk failure ends only the recording: written messages stay readable, later ones are counted.

    Args:
        path: the file; an existing one is replaced.
        bytes_per_s: expected rate of the payloads: a chunk is closed about every quarter second, so
            a kill loses no more than that.

    Attributes:
        lost: messages that could not be written, by topic.
        failure: what ended the recording early, if anything did.

    Raises:
        OSError: the file cannot be created, or too little space is left for it.
    """

    def __init__(self, path: Path, bytes_per_s: float) -> None:
        self._path = path
        path.unlink(missing_ok=True)
        # Space kept free to record, when the disk is full, how much is missing.
        self._reserve = TemporaryFile(dir=path.parent)  # noqa: SIM115
        os.posix_fallocate(self._reserve.fileno(), 0, _RESERVE_BYTES)
        self._file = RecordFile(new_partial(path))
        chunk_size = int(min(max(bytes_per_s / 4, 1024), _LARGEST_CHUNK_BYTES))
        self._writer = McapWriter(cast("IO[bytes]", self._file), chunk_size)
        self._writer.start(profile="ros2", library="funnel-hil")
        self._channels: dict[str, int] = {}
        self._in_file: Counter[str] = Counter()
        self.lost: Counter[str] = Counter()
        self.failure: OSError | None = None

    @property
    def written(self) -> Counter[str]:
        """Messages in the recording, including its open chunk, by topic."""
        return self._in_file if self.failure is not None else self._in_file + self._in_open_chunk()

    @property
    def messages(self) -> int:
        """Number of messages in the recording, including its open chunk."""
        return self.written.total()

    def write(
        self, topic: Topic, sequence: int, stamp_ns: int, source_time_ns: int, payload: bytes
    ) -> None:
        """Write one message.

        Args:
            topic: its topic.
            sequence: number its sender gave it.
            stamp_ns: its stamp on the run's clock, which becomes the log time.
            source_time_ns: when it was sent, Unix time, or in virtual time on the run's clock;
                becomes the publish time.
            payload: its CDR bytes.
        """
        name = topic.name
        if name not in self._channels and self.failure is None:
            self._register(topic)
        if self.failure is not None:
            self.lost[name] += 1
            return
        channel, number = self._channels[name], sequence & 0xFFFFFFFF
        if self._writer.add_message(channel, stamp_ns, payload, source_time_ns, number):
            self._attempt(self._writer.flush, closes_chunk=True)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Attach a file."""
        self._attempt(lambda: self._writer.add_attachment(name, media_type, data))

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Add a table of metadata."""
        self._attempt(lambda: self._writer.add_metadata(name, values))

    def finish_messages(self) -> None:
        """Write all messages that are not yet in the file; after this, the counts are final."""
        if self.failure is None:
            self._attempt(self._writer.flush, closes_chunk=True)
        self._reserve.close()

    def close(self) -> None:
        """Finish the file; if that fails, it keeps its partial name."""
        self.finish_messages()
        if self.failure is None:
            self._attempt(self._writer.finish)
        self._file.close()
        if self.failure is None:
            self._attempt(lambda: complete(self._path))

    def _attempt(self, action: Callable[[], None], *, closes_chunk: bool = False) -> None:
        """Write to the disk, a whole chunk or nothing; note a failure."""
        before, in_chunk, failure = self._file.size, self._in_open_chunk(), None
        try:
            action()
        except OSError as error:
            failure = error
        if closes_chunk and self._file.size != before:
            self._in_file = self._in_file + in_chunk  # a new table: other threads may read the old
            in_chunk.clear()
        if failure is not None and self.failure is None:
            self.failure = failure
            self.lost += in_chunk
            logger.error("%s: %s: the recording ends here", self._path, failure.strerror)

    def _in_open_chunk(self) -> Counter[str]:
        """Messages in the open chunk, by topic."""
        channels = list(self._channels.items())
        return Counter({topic: self._writer.waiting(channel) for topic, channel in channels})

    def _register(self, topic: Topic) -> None:
        schema = self._writer.register_schema(
            topic.type_name, "ros2msg", schema_text(topic.type_name).encode()
        )
        self._channels[topic.name] = self._writer.register_channel(
            f"/{topic.name}", "cdr", schema, {"offered_qos_profiles": _offered_qos(topic)}
        )


def _offered_qos(topic: Topic) -> str:
    """Return the QoS of a topic in rosbag2's format for channel metadata."""
    durability = "transient_local" if topic.latched else "volatile"
    return _OFFERED_QOS.format(depth=topic.depth, durability=durability)


@dataclass
class LogContents:
    """Content of a recording that was read.

    Attributes:
        payloads: payloads by topic name (without the slash), in the order of the file.
        sequences: their sequence numbers.
        attachments: attached files by name.
        metadata: metadata tables by name.
        complete: the file was finished, and every byte of it is as it was written.
        damage: what is damaged, and how much is still readable, one sentence per problem.
        lacks_checksums: checksums cover only messages and attachments, as in recordings of older
            versions.
    """

    payloads: dict[str, list[bytes]] = field(default_factory=lambda: defaultdict(list))
    sequences: dict[str, list[int]] = field(default_factory=lambda: defaultdict(list))
    attachments: dict[str, bytes] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    complete: bool = False
    damage: list[str] = field(default_factory=list)
    lacks_checksums: bool = False


def _sort(records: CheckedRecords, contents: LogContents) -> tuple[int | None, set[str]]:
    """Sort records into the contents of a recording.

    A message whose channel was described in a damaged chunk waits for the summary, which describes
    all channels again. Messages under our topics in another format are left out.

    Returns:
        The number of messages that the file states, and a sentence for each format left out.
    """
    stated, left_out = None, set[str]()
    topics: dict[int, str] = {}
    schemas: dict[int, Schema] = {}
    waiting: list[Message] = []

    def take(message: Message) -> None:
        topic = topics[message.channel_id]
        contents.payloads[topic].append(message.data)
        contents.sequences[topic].append(message.sequence)

    for record in records:
        match record:  # nearly all are messages
            case Message() if record.channel_id in topics:
                take(record)
            case Message():
                waiting.append(record)
            case Schema():
                schemas.setdefault(record.id, record)
            case Channel() if foreign := _foreign_format(record, schemas.get(record.schema_id)):
                left_out.add(foreign)
            case Channel():
                topics.setdefault(record.id, record.topic.strip("/"))
            case Attachment():
                contents.attachments[record.name] = record.data
            case Metadata():
                contents.metadata[record.name] = record.metadata
            case Statistics():
                stated = record.message_count
    for message in waiting:
        if message.channel_id in topics:
            take(message)
    return stated, left_out


def _foreign_format(channel: Channel, schema: Schema | None) -> str:
    """Explain in a sentence why messages of a channel are not read; empty if they are.

    Channels of other topics, and those whose schema is in a damaged chunk, are not checked.
    """
    expected = _TYPES.get(channel.topic.strip("/"))
    if expected is None or schema is None:
        return ""
    found = f"{schema.name} ({schema.encoding}, {channel.message_encoding})"
    if found != f"{expected} (ros2msg, cdr)":
        return f"its messages of {channel.topic} are {found[:200]}, not {expected} (ros2msg, cdr)"
    if not has_todays_form(schema.name, schema.data):
        return (
            f"its messages of {expected} are from another version of funnel-hil; that version can"
            " read them"
        )
    return ""


def record_afterwards(path: Path, name: str, values: dict[str, str]) -> None:
    """Add a table of metadata to a recording that is finished, or whose recorder was killed.

    A damaged recording is not changed.

    Raises:
        OSError: the file does not exist, or the disk fails.
    """
    size = path.stat().st_size
    with path.open("r+b") as file:
        records = CheckedRecords(file, size)
        for _ in records:
            pass
        if not records.damage and not records.lacks_checksums:
            append_metadata(file, records.cut_off_at, name, values)


def read_log(path: Path) -> LogContents:
    """Read a recording, as far as it is readable.

    Raises:
        OSError: the file cannot be read.
    """
    contents, size = LogContents(), path.stat().st_size
    with path.open("rb") as file:
        records = CheckedRecords(file, size)
        stated, left_out = _sort(records, contents)
    damage = records.damage
    if records.cut_off_at is not None and not is_partial(path):
        damage.append(f"it cannot be read from byte {records.cut_off_at} of {size} on")
    damage += sorted(left_out)
    if damage:
        shown = damage[:_SHOWN_DAMAGE]
        if len(damage) > _SHOWN_DAMAGE:
            shown.append(f"{len(damage) - _SHOWN_DAMAGE} more places are damaged")
        of_all = "" if stated is None else f" of {stated}"
        read = sum(map(len, contents.payloads.values()))
        contents.damage = [*shown, f"{read}{of_all} messages could be read"]
    contents.complete = records.is_finished and not damage
    contents.lacks_checksums = records.lacks_checksums
    return contents
