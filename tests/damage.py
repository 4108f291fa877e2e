"""Damage to recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap.writer import Writer


def damage_at(file: Path, time_ns: int) -> None:
    """Make the chunk with the messages of an instant unreadable.

    The first bytes of compressed data tell their kind; without them, nothing can be read. A change
    elsewhere may change values alone.
    """
    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    (chunk,) = [
        each
        for each in summary.chunk_indexes
        if each.message_start_time < time_ns < each.message_end_time
    ]
    changed = bytearray(file.read_bytes())
    changed[chunk.chunk_start_offset + chunk.chunk_length - chunk.compressed_size] ^= 16
    file.write_bytes(changed)


def rewrite(source, target, *, copies=lambda _: 1, schemas=None, metadata=None, times=1):
    """Write a recording again, as other programs do: valid in itself, with right checksums.

    Args:
        source: the recording.
        target: the new file.
        copies: how often each message of a topic is written.
        schemas: other types of topics, name and text.
        metadata: more tables of metadata.
        times: how often the whole is written, one after the other.
    """
    with target.open("wb") as out, source.open("rb") as stream:
        reader, writer, channels = make_reader(stream), Writer(out), dict[str, Any]()
        writer.start(profile="ros2", library="another")
        for each in reader.iter_attachments():
            writer.add_attachment(
                each.create_time, each.log_time, each.name, each.media_type, each.data
            )
        for table in reader.iter_metadata():
            writer.add_metadata(table.name, dict(table.metadata))
        for name, values in (metadata or {}).items():
            writer.add_metadata(name, values)
        for schema, channel, message in [*reader.iter_messages(log_time_order=False)] * times:
            assert schema is not None
            topic = channel.topic
            if topic not in channels:
                name, text = (schemas or {}).get(topic, (schema.name, schema.data))
                number = writer.register_schema(name, schema.encoding, text)
                channels[topic] = writer.register_channel(topic, channel.message_encoding, number)
            for _ in range(copies(topic)):
                writer.add_message(
                    channels[topic], message.log_time, message.data, message.publish_time,
                    message.sequence,
                )  # fmt: skip
        writer.finish()
