"""Recordings: MCAP files with profile ``ros2``, schemas in ``ros2msg`` and payloads in ``cdr``.

What is written is what was on the wire. What a kill left behind can be read up to the last chunk
that reached the disk.
"""

from __future__ import annotations

import struct
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path

from mcap.exceptions import McapError
from mcap.records import Attachment, Channel, Footer, Message, Metadata
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer
from zstandard import ZstdError

from bus_schema.message_types import schema_text
from bus_schema.topics import Topic

_LARGEST_CHUNK_BYTES = 256 * 1024
_TORN = (McapError, EOFError, ValueError, LookupError, struct.error, ZstdError)
"""What reading a torn file ends in, depending on where it was torn."""


class McapLog:
    """A recording being written.

    Args:
        path: the file; an existing one is replaced.
        bytes_per_s: expected rate of the payloads: a chunk is closed about every quarter second,
            so that a kill costs no more than that.
    """

    def __init__(self, path: Path, bytes_per_s: float) -> None:
        self._file = path.open("wb")
        chunk_size = int(min(max(bytes_per_s / 4, 1024), _LARGEST_CHUNK_BYTES))
        self._writer = Writer(self._file, chunk_size=chunk_size, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library="funnel-hil")
        self._channels: dict[str, int] = {}
        self.messages = 0

    def write(
        self, topic: Topic, sequence: int, stamp_ns: int, source_time_ns: int, payload: bytes
    ) -> None:
        """Write one message.

        Args:
            topic: its topic.
            sequence: number its sender gave it.
            stamp_ns: its stamp on the run's clock, which becomes the log time.
            source_time_ns: when it was sent, Unix time; becomes the publish time.
            payload: its CDR bytes.
        """
        channel = self._channels.get(topic.name)
        if channel is None:
            channel = self._register(topic)
        self._writer.add_message(
            channel, stamp_ns, payload, publish_time=source_time_ns, sequence=sequence & 0xFFFFFFFF
        )
        self.messages += 1

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Attach a file."""
        self._writer.add_attachment(0, 0, name, media_type, data)

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Add a table of metadata."""
        self._writer.add_metadata(name, values)

    def flush(self) -> None:
        """Hand all closed chunks to the operating system."""
        self._file.flush()

    def close(self) -> None:
        """Finish the file."""
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._file.close()

    def _register(self, topic: Topic) -> int:
        schema = self._writer.register_schema(
            topic.type_name, "ros2msg", schema_text(topic.type_name).encode()
        )
        channel = self._writer.register_channel(f"/{topic.name}", "cdr", schema)
        self._channels[topic.name] = channel
        return channel


@dataclass
class LogContents:
    """A recording as read back.

    Attributes:
        payloads: payloads by topic name (without the slash), in the order of the file.
        sequences: their sequence numbers.
        attachments: attached files by name.
        metadata: metadata tables by name.
        complete: the file was finished; otherwise its end is missing.
    """

    payloads: dict[str, list[bytes]] = field(default_factory=lambda: defaultdict(list))
    sequences: dict[str, list[int]] = field(default_factory=lambda: defaultdict(list))
    attachments: dict[str, bytes] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    complete: bool = False


def read_log(path: Path) -> LogContents:
    """Read a recording, or what there is of it.

    Raises:
        OSError: the file cannot be opened.
    """
    contents = LogContents()
    topics: dict[int, str] = {}
    with path.open("rb") as file:
        try:
            for record in StreamReader(file).records:
                match record:
                    case Channel():
                        topics[record.id] = record.topic.strip("/")
                    case Message():
                        contents.payloads[topics[record.channel_id]].append(record.data)
                        contents.sequences[topics[record.channel_id]].append(record.sequence)
                    case Attachment():
                        contents.attachments[record.name] = record.data
                    case Metadata():
                        contents.metadata[record.name] = record.metadata
                    case Footer():
                        contents.complete = True
        except _TORN:
            contents.complete = False
    return contents
