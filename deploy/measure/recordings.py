"""Reads messages of recordings that others made: MCAP files, and bags of rosbag2 with SQLite.

The size of every message and chunk is checked before it is read, and the reader's memory is
limited, because a length in such a file may be anything.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from mcap.records import Channel, Message, Schema

from bus_schema.errors import InputError
from bus_schema.recording.checked_records import CheckedRecords, check_sizes
from bus_schema.runtime.limited_process import limited_memory

MOST_MESSAGE_BYTES = 64_000_000
MOST_MESSAGES = 5_000_000
"""Of the topics that are read: more than an hour at 1 kHz."""
MOST_MEMORY_BYTES = 2_000_000_000
_DATABASE, _MCAP = ".db3", ".mcap"
_TOPICS = "SELECT id, name, type FROM topics"
_LARGEST = "SELECT MAX(LENGTH(data)) FROM messages WHERE topic_id = ?"
"""Without sorting, which would load the data."""


@dataclass
class RecordedMessage:
    """A message of a recording.

    Attributes:
        topic: its name.
        logged_ns: time at which it was recorded.
        data: its bytes in CDR.
        decode: returns the fields of these bytes.
    """

    topic: str
    logged_ns: int
    data: bytes
    decode: Callable[[bytes], Any]

    @cached_property
    def content(self) -> Any:
        """Its fields."""
        return self.decode(self.data)


@contextmanager
def opened(
    path: Path, most_bytes: int = MOST_MESSAGE_BYTES, most_memory_bytes: int = MOST_MEMORY_BYTES
) -> Iterator[Recording]:
    """Open a recording; the memory for reading it, and for what becomes of it here, is limited.

    Args:
        path: a ``.db3`` file, a bag's folder, or an MCAP file with definitions of its messages.
        most_bytes: largest size of a message that is read.
        most_memory_bytes: memory that the body of the ``with`` statement may take.

    Raises:
        InputError: the body takes more memory.
    """
    try:
        with limited_memory(most_memory_bytes):
            yield Recording(path, most_bytes)
    except MemoryError as error:
        allowed = f"more than the {most_memory_bytes / 1e6:g} MB that are allowed"
        raise InputError(f"{path}: takes {allowed} of memory to read") from error


class Recording:
    """A recording, made by `opened`.

    Attributes:
        topics: names of all topics, known once messages were read.
    """

    def __init__(self, path: Path, most_bytes: int) -> None:
        self._path, self._most_bytes = path, most_bytes
        self.topics: set[str] = set()

    def messages(self, topic: str, other: str | None = None) -> Iterator[RecordedMessage]:
        """Yield the messages of one or two topics, or of all topics of a type, in any order.

        Raises:
            InputError: the file cannot be read, has too many of them, or one is too large.
        """
        wanted = {topic, other or topic}
        is_bag = self._path.is_dir() or self._path.suffix == _DATABASE
        read = self._of_bag if is_bag else self._of_mcap
        try:
            for number, message in enumerate(read(wanted)):
                if number == MOST_MESSAGES:
                    what = f"more than {MOST_MESSAGES:,} messages on {', '.join(wanted)}"
                    raise self._refusal(f"has {what}, and at most these are read")
                if (size := len(message.data)) > self._most_bytes:
                    raise self._too_large(message.topic, size)
                yield message
        except (InputError, MemoryError):
            raise
        except Exception as error:  # mcap and rosbags raise many kinds of errors
            reason = str(error) or type(error).__name__
            raise self._refusal(f"cannot be read as a recording: {reason}") from error

    def _of_mcap(self, wanted: set[str]) -> Iterator[RecordedMessage]:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        types, known = get_typestore(Stores.EMPTY), set[str]()
        schemas, channels = dict[int, Schema](), dict[int, Channel]()

        def decode(schema: Schema, data: bytes) -> Any:
            if schema.name not in known:
                types.register(get_types_from_msg(schema.data.decode(), schema.name))
                known.add(schema.name)
            return types.deserialize_cdr(data, schema.name)

        with self._path.open("rb") as file:
            records = CheckedRecords(file, self._path.stat().st_size)
            for record in records:
                match record:
                    case Schema():
                        schemas[record.id] = record
                    case Channel():
                        channels[record.id] = record
                        self.topics.add(record.topic)
                    case Message():
                        channel = channels[record.channel_id]
                        schema = schemas.get(channel.schema_id, Schema(0, b"", "", ""))
                        if wanted & {channel.topic, schema.name}:
                            yield RecordedMessage(
                                channel.topic, record.log_time, record.data,
                                partial(decode, schema),
                            )  # fmt: skip
        if records.damage or records.cut_off_at is not None:
            cut = f"it cannot be read from byte {records.cut_off_at} on"
            raise self._refusal(f"cannot be read as MCAP: {[*records.damage, cut][0]}")

    def _of_bag(self, wanted: set[str]) -> Iterator[RecordedMessage]:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore

        self._check_files(wanted)
        jazzy = get_typestore(Stores.ROS2_JAZZY)  # for bags without definitions
        with AnyReader([self._path], default_typestore=jazzy) as bag:
            self.topics = {each.topic for each in bag.connections}
            chosen = [each for each in bag.connections if wanted & {each.topic, each.msgtype}]
            types = bag.typestore
            for connection, logged_ns, data in bag.messages(chosen) if chosen else ():
                decode = partial(types.deserialize_cdr, typename=connection.msgtype)
                yield RecordedMessage(connection.topic, logged_ns, data, decode)

    def _check_files(self, wanted: set[str]) -> None:
        """Refuse a bag with too large messages or chunks, before rosbags unpacks or sorts them."""
        for file in sorted(self._path.iterdir()) if self._path.is_dir() else [self._path]:
            if file.suffix == _DATABASE:
                self._check_database(file, wanted)
            elif file.suffix == _MCAP:
                with file.open("rb") as content:
                    check_sizes(content, file.stat().st_size)

    def _check_database(self, file: Path, wanted: set[str]) -> None:
        """Refuse a database with too large messages, which SQLite would load several times."""
        place = f"{file.resolve().as_uri()}?mode=ro&immutable=1"
        with closing(sqlite3.connect(place, uri=True)) as database:
            for number, topic, kind in database.execute(_TOPICS):
                if wanted & {topic, kind}:
                    (size,) = database.execute(_LARGEST, (number,)).fetchone()
                    if size is not None and size > self._most_bytes:
                        raise self._too_large(topic, size)

    def _too_large(self, topic: str, size: int) -> InputError:
        return self._refusal(
            f"has a message of {size / 1e6:.6g} MB on {topic}, and messages of at most"
            f" {self._most_bytes / 1e6:g} MB are read"
        )

    def _refusal(self, what: str) -> InputError:
        return InputError(f"{self._path}: {what}")
