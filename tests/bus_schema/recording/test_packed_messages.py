"""Messages of many ticks that are written at once are in the file as those written one by one."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from bus_schema.messages.topics import CONTROL_STATUS, JOINT_STATES, PLANT_TRUTH, RUN_EVENTS
from bus_schema.recording.atomic_files import RecordFile, partial_path
from bus_schema.recording.mcap_log import McapLog, read_log

TICKS = (PLANT_TRUTH, JOINT_STATES, CONTROL_STATUS)
SIZES = (33, 0, 250)
SEQUENCE, STAMP_NS = 2**32 - 20, 2**62


class Batch:
    """Ticks of random messages, and the pieces in which they are written."""

    def __init__(self, seed: int, count: int) -> None:
        random = np.random.default_rng(seed)
        shape = count, len(TICKS)
        self.sequences = SEQUENCE + np.arange(count)[:, None] + np.zeros(shape, np.int64)
        self.stamps_ns = random.integers(STAMP_NS, size=shape)
        self.sent_ns = random.integers(STAMP_NS, size=shape)
        self.payloads = [random.integers(256, size=(count, s), dtype=np.uint8) for s in SIZES]
        total = self.sequences.size
        self.pieces = [0, *np.sort(random.integers(total + 1, size=4)).tolist(), total]

    def write_at_once(self, log: McapLog) -> bool:
        """Whether that was possible."""
        numbers = self.sequences, self.stamps_ns, self.sent_ns
        packed = log.packed(TICKS, *numbers, self.payloads)
        if packed is None:
            return False
        for first, end in zip(self.pieces, self.pieces[1:], strict=False):
            log.write_packed(packed, first, end)
            log.write(RUN_EVENTS, end, 1, 2, b"between two pieces")
        return True

    def write_one_by_one(self, log: McapLog) -> None:
        messages = list(self._messages())
        for first, end in zip(self.pieces, self.pieces[1:], strict=False):
            for message in messages[first:end]:
                log.write(*message)
            log.write(RUN_EVENTS, end, 1, 2, b"between two pieces")

    def _messages(self) -> Iterator[tuple]:
        for tick in range(len(self.sequences)):
            for place, topic in enumerate(TICKS):
                yield (
                    topic, int(self.sequences[tick, place]), int(self.stamps_ns[tick, place]),
                    int(self.sent_ns[tick, place]), self.payloads[place][tick].tobytes(),
                )  # fmt: skip


def recorded(path: Path, bytes_per_s: float, *, at_once: bool) -> McapLog:
    """A finished recording of 30 batches; the first of them makes the topics known."""
    log = McapLog(path, bytes_per_s)
    for seed in range(30):
        batch = Batch(seed, count=1 + seed)
        if not at_once or not batch.write_at_once(log):
            batch.write_one_by_one(log)
    log.close()
    return log


@pytest.mark.parametrize("bytes_per_s", [0, 20_000, 1e6])
def test_the_file_is_the_same_byte_for_byte(tmp_path: Path, bytes_per_s: float) -> None:
    """Chunks of a few messages, and of more than there are."""
    at_once = recorded(tmp_path / "at_once.mcap", bytes_per_s, at_once=True)
    one_by_one = recorded(tmp_path / "one_by_one.mcap", bytes_per_s, at_once=False)
    whole = (tmp_path / "at_once.mcap").read_bytes()
    assert whole == (tmp_path / "one_by_one.mcap").read_bytes()
    assert at_once.written == one_by_one.written
    assert read_log(tmp_path / "at_once.mcap").complete


def test_topics_are_made_known_by_messages_alone(tmp_path: Path) -> None:
    log = McapLog(tmp_path / "run.mcap", bytes_per_s=0)
    assert not Batch(0, count=5).write_at_once(log)
    for topic in TICKS[:-1]:
        log.write(topic, 1, 0, 0, b"")
    assert not Batch(0, count=5).write_at_once(log)
    log.write(TICKS[-1], 1, 0, 0, b"")
    assert Batch(0, count=5).write_at_once(log)
    assert log.messages == 3 + 15 + 5
    log.close()


@pytest.mark.parametrize("room", [3_000, 20_000, 60_000, 90_000])
def test_what_a_full_disk_does_not_take_is_counted_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, room: int
) -> None:
    write = RecordFile.write

    def write_as_far_as_there_is_room(file: RecordFile, data: bytes) -> int:
        if file.size + len(data) > room:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(file, data)

    monkeypatch.setattr(RecordFile, "write", write_as_far_as_there_is_room)
    at_once = recorded(tmp_path / "at_once.mcap", 20_000, at_once=True)
    one_by_one = recorded(tmp_path / "one_by_one.mcap", 20_000, at_once=False)
    assert at_once.failure is not None
    assert at_once.lost == one_by_one.lost
    assert at_once.written == one_by_one.written
    assert min(at_once.lost.values()) > 0
    files = [partial_path(tmp_path / f"{name}.mcap") for name in ("at_once", "one_by_one")]
    assert files[0].read_bytes() == files[1].read_bytes()
