"""Ticks of a bundle that are read at once are those that its messages tell one by one."""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace

import numpy as np
import pytest

from bus_schema.messages import topics
from bus_schema.zenoh.bundled_ticks import Ticks, parts_of, ticks_of
from bus_schema.zenoh.bundles import HEAD, Received, unbundled
from bus_schema.zenoh.ros_graph import Attachment

NAMES = {topic.name.encode(): topic for topic in topics.TOPICS}
PLANT, OTHER = b"p" * 16, b"o" * 16
SIZES = {b"joint_commands": 60, b"joint_states": 90, b"plant_status": 12, b"plant_truth": 33}


@dataclass(frozen=True)
class Said:
    """A message as it is put into a bundle."""

    name: bytes
    attachment: bytes
    payload: bytes

    def encode(self) -> bytes:
        head = HEAD.pack(len(self.name), len(self.attachment), len(self.payload))
        return head + self.name + self.attachment + self.payload


def said(name: bytes, number: int, gid: bytes = PLANT, size: int | None = None) -> Said:
    noise = np.random.default_rng(number).bytes(SIZES.get(name, 20) if size is None else size)
    payload = b"\0\1\0\0" + struct.pack("<iI", number, 7 * number) + noise
    return Said(name, Attachment(number, 1000 + number, gid).encode(), payload)


def ticks(count: int, first: int = 1) -> list[Said]:
    return [said(name, number) for number in range(first, first + count) for name in SIZES]


def joined(messages: list[Said]) -> bytes:
    return b"".join(message.encode() for message in messages)


def read(bundle: bytes) -> list[Received]:
    """As a recorder does."""
    parts = parts_of(bundle, NAMES)
    assert all(len(part) == len(list(part)) for part in parts)
    return [message for part in parts for message in part]


@pytest.mark.parametrize("first", [1, 5, 2**29])
@pytest.mark.parametrize("behind", [[], [said(b"joint_commands", 40)], [said(b"run_events", 3)]])
def test_ticks_are_read_at_once(first: int, behind: list[Said]) -> None:
    regular = ticks(20, first)
    bundle = joined(regular + behind)
    found = ticks_of(bundle, NAMES)
    assert found is not None
    at_once, size = found
    assert size == len(joined(regular))
    assert len(at_once) == len(regular)
    assert [topic.name.encode() for topic in at_once.topics] == list(SIZES)
    assert at_once.stamps_ns[:, 1].tolist() == [
        number * 1_000_000_007 for number in range(first, first + 20)
    ]
    assert read(bundle) == unbundled(bundle, NAMES)


def test_topics_that_nobody_asked_for_are_left_out() -> None:
    regular = [
        said(name, number) for number in range(1, 9) for name in (b"clock", b"plant_truth", b"x")
    ]
    found = ticks_of(joined(regular), NAMES)
    assert found is not None
    assert found[0].topics == (topics.PLANT_TRUTH,)
    assert read(joined(regular)) == unbundled(joined(regular), NAMES)


def changed(place: int, **values: bytes) -> list[Said]:
    messages = ticks(20)
    messages[place] = replace(messages[place], **values)
    return messages


IRREGULAR = {
    "a gap": ticks(5) + ticks(10, first=7),
    "a repetition": ticks(5) + ticks(10, first=5),
    "backwards": ticks(20)[::-1],
    "one message missing": ticks(20)[:41] + ticks(20)[42:],
    "one message more": [*ticks(10), said(b"run_events", 1), *ticks(10, first=11)],
    "an event at every tick": [
        said(name, number) for number in range(1, 9) for name in (b"plant_truth", b"run_events")
    ],
    "a topic twice at every tick": [
        said(b"plant_truth", number, gid)
        for number in range(1, 9)
        for gid in (PLANT, OTHER, PLANT[:8])
    ],
    "another size": changed(30, payload=said(b"plant_status", 8, size=13).payload),
    "another sender": changed(30, attachment=Attachment(8, 1, OTHER).encode()),
    "an unknown topic": changed(30, name=b"plant_statue"),
    "no attachment": changed(30, attachment=b""),
    "no number": changed(30, attachment=bytes(33)),
    "a negative number": changed(30, attachment=Attachment(-1, 0, PLANT).encode()),
    "a negative time": changed(30, attachment=Attachment(8, -1, PLANT).encode()),
    "no attachments": [replace(message, attachment=b"") for message in ticks(20)],
    "short attachments": [replace(each, attachment=each.attachment[:-1]) for each in ticks(20)],
    "identifiers of another length": [
        replace(each, attachment=each.attachment[:16] + b"\x0f" + each.attachment[17:])
        for each in ticks(20)
    ],
    "a stamp before the start": changed(30, payload=b"\x80" * len(ticks(8)[30].payload)),
    "no stamps": [replace(each, payload=each.payload[:11]) for each in ticks(20)],
    "few ticks": ticks(3),
    "garbage": [Said(b"", b"", b"")] * 30,
}


@pytest.mark.parametrize("messages", IRREGULAR.values(), ids=IRREGULAR.keys())
def test_whatever_is_odd_is_read_one_by_one(messages: list[Said]) -> None:
    bundle = joined(messages)
    assert ticks_of(bundle, NAMES) is None
    assert read(bundle) == unbundled(bundle, NAMES)


def test_longer_attachments_are_as_good() -> None:
    longer = [replace(each, attachment=each.attachment + b"more") for each in ticks(20)]
    assert ticks_of(joined(longer), NAMES) is not None
    assert read(joined(longer)) == unbundled(joined(longer), NAMES)


def test_damaged_bundles_are_read_as_ever() -> None:
    """Bytes that are wrong, missing or too many, anywhere."""
    random, whole = np.random.default_rng(0), joined(ticks(12))
    at_once = 0
    for _ in range(1500):
        bundle = bytearray(whole)
        for _ in range(random.integers(3)):
            bundle[random.integers(len(bundle))] = random.choice([0, 1, 16, 255])
        cut = random.integers(len(bundle)) if random.random() < 0.5 else 0
        damaged = bytes(bundle[cut:] if random.random() < 0.3 else bundle[: len(bundle) - cut])
        at_once += ticks_of(damaged, NAMES) is not None
        assert read(damaged) == unbundled(damaged, NAMES)
    assert at_once > 100


def test_a_tick_of_very_many_messages_is_read_one_by_one() -> None:
    many = [said(b"topic %d" % place, 1) for place in range(500)] * 10
    assert ticks_of(joined(many), NAMES) is None


def test_iterating_twice_tells_the_same() -> None:
    found = ticks_of(joined(ticks(6)), NAMES)
    assert found is not None
    assert isinstance(found[0], Ticks)
    assert list(found[0]) == list(found[0])
