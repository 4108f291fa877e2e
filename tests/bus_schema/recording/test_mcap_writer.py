import io

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from bus_schema.recording.mcap_writer import McapWriter

CHUNK_BYTES = 2000


def by_mcap(stream):
    return Writer(
        stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD, enable_data_crcs=True
    )


def by_us(stream):
    return McapWriter(stream, CHUNK_BYTES)


def written(open_writer, messages, files):
    stream = io.BytesIO()
    writer = open_writer(stream)
    writer.start(profile="ros2", library="funnel-hil")
    for name, data in files:
        stamps = (0, 0) if isinstance(writer, Writer) else ()
        writer.add_attachment(*stamps, name, "text/plain", data)
    for number in (1, 2):
        schema = writer.register_schema(f"pkg/msg/Type{number}", "ros2msg", b"float64 x")
        writer.register_channel(f"/topic_{number}", "cdr", schema, {"qos": "ü"})
    for message in messages:
        if writer.add_message(*message):  # mcap's own ends a full chunk itself
            writer.flush()
    writer.add_metadata("run", {"law": "pid", "empty": ""})
    writer.flush()
    writer.finish()
    return stream.getvalue()


@pytest.mark.parametrize("count", [0, 1, 2, 500])
@pytest.mark.parametrize("files", [[], [("a.yaml", b"name: x\n"), ("empty", b"")]])
def test_the_file_is_byte_for_byte_what_mcap_writes(count, files):
    """Times that go back, channels in any order, payloads of any size: none, or a chunk's."""
    random = np.random.default_rng(count)
    sizes = random.choice([0, 1, 96, CHUNK_BYTES], count)
    messages = [
        (
            int(random.integers(1, 3)), int(random.integers(1, 2**62)), random.bytes(size),
            int(random.integers(2**62)), int(random.integers(2**32)),
        )
        for size in sizes
    ]  # fmt: skip
    assert written(by_us, messages, files) == written(by_mcap, messages, files)
