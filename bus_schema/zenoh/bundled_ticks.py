"""What a recorder reads from a bundle: message by message, or all ticks of it at once.

Loops say the same at every tick, in messages of the same sizes: such a bundle is a table with a row
for each tick, in which numpy looks at all ticks as fast as at one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from bus_schema.messages.header import ENCAPSULATION_BYTES, NANOSEC, SEC, stamps_ns
from bus_schema.messages.topics import Rate, Topic
from bus_schema.zenoh.bundles import HEAD, Received, unbundled
from bus_schema.zenoh.ros_graph import ATTACHMENT, GID_BYTES

_FEWEST_TICKS = 4  # fewer are read as fast one by one
_MOST_MESSAGES = 16  # of a tick
_NUMBERS = np.dtype(("<i8", 2))  # sequence and source time, with which attachments begin
_STAMP = np.dtype([(SEC, "<i4"), (NANOSEC, "<u4")])
_Head = tuple[bytes, int, int, bool]
"""Topic, bytes of attachment and payload, and whether we want to know of it."""


@dataclass(frozen=True, eq=False)
class Ticks:
    """Messages of some ticks: the same topics and sizes at each, no number missing between two.

    Attributes:
        topics: of a tick's messages in turn, all different, and none of them of events.
        gids: ids of their senders.
        sequences: their numbers, shape (ticks, topics).
        source_times_ns: when they were sent, Unix time; same shape.
        stamps_ns: their stamps; same shape.
        payloads: of each topic, shape (ticks, bytes).
    """

    topics: tuple[Topic, ...]
    gids: tuple[bytes, ...]
    sequences: NDArray[np.int64]
    source_times_ns: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]
    payloads: tuple[NDArray[np.uint8], ...]

    def __len__(self) -> int:
        """Messages, of all ticks."""
        return self.sequences.size

    def __iter__(self) -> Iterator[Received]:
        """Each message, in order."""
        numbers = zip(self.sequences.tolist(), self.source_times_ns.tolist(), strict=True)
        for tick, (sequences, times_ns) in enumerate(numbers):
            payloads = (table[tick].tobytes() for table in self.payloads)
            yield from zip(self.topics, payloads, sequences, times_ns, self.gids, strict=True)


Messages = list[Received] | Ticks


def parts_of(bundle: bytes, topics: Mapping[bytes, Topic]) -> list[Messages]:
    """The messages in a bundle as `unbundled` has them, but ticks at once where that can be."""
    found = ticks_of(bundle, topics)
    if found is None:
        return [unbundled(bundle, topics)]
    ticks, size = found
    return [ticks, unbundled(bundle[size:], topics)]


def ticks_of(bundle: bytes, topics: Mapping[bytes, Topic]) -> tuple[Ticks, int] | None:
    """The ticks that a bundle begins with, and how many of its bytes these are.

    None where it does not repeat itself, or anything is odd about it: a number that is missing or
    comes twice, a message without a number or stamp, two senders. `unbundled` reads what is so.
    """
    heads = _first_tick(bundle, topics)
    layout = None if heads is None else _layout(heads)
    if layout is None or (count := len(bundle) // layout.size) < _FEWEST_TICKS:
        return None
    size = count * layout.size
    table = np.frombuffer(bundle, np.uint8, size).reshape(count, layout.size)
    looked_at = table.take(layout.columns, axis=1)
    fixed = looked_at[:, layout.fixed_from :]
    stamps = stamps_ns(looked_at[:, layout.stamps_from : layout.fixed_from].view(_STAMP))
    numbers = looked_at[:, : layout.stamps_from].view("<i8").reshape(count, -1, 2)
    sequences = numbers[:, :, 0]
    if (
        any(topics[name].rate is Rate.EVENT for name in layout.names)
        or fixed.tobytes() != fixed[0].tobytes() * count
        or any(bundle[gid.start - 1] != GID_BYTES for gid in layout.gids)
        or min(numbers.min(), stamps.min()) < 0
        or (sequences - sequences[0] != np.arange(count)[:, None]).any()
    ):
        return None
    ticks = Ticks(
        tuple(topics[name] for name in layout.names),
        tuple(bundle[gid] for gid in layout.gids),
        sequences,
        numbers[:, :, 1],
        stamps,
        tuple(table[:, payload] for payload in layout.payloads),
    )
    return ticks, size


def _first_tick(bundle: bytes, topics: Mapping[bytes, Topic]) -> tuple[_Head, ...] | None:
    """Heads of the messages before the first comes again; None if it does not."""
    heads: list[_Head] = []
    at, end, head_bytes = 0, len(bundle), HEAD.size
    while at + head_bytes <= end and len(heads) <= _MOST_MESSAGES:
        name_bytes, attachment_bytes, payload_bytes = HEAD.unpack_from(bundle, at)
        at += head_bytes + name_bytes
        name = bundle[at - name_bytes : at]
        head = name, attachment_bytes, payload_bytes, name in topics
        if heads and head == heads[0]:
            return tuple(heads)
        heads.append(head)
        at += attachment_bytes + payload_bytes
    return None


@dataclass(frozen=True)
class _Layout:
    """Where in the bytes of a tick is what.

    Attributes:
        size: bytes of a tick.
        names: of the topics that we want to know of.
        gids: places of the ids of their senders.
        payloads: places of their payloads.
        columns: places of all numbers, of all stamps, and of all that has to be the same at each
            tick.
        stamps_from: where the stamps begin among these.
        fixed_from: where begins what is the same.
    """

    size: int
    names: tuple[bytes, ...]
    gids: tuple[slice, ...]
    payloads: tuple[slice, ...]
    columns: NDArray[np.intp]
    stamps_from: int
    fixed_from: int


@lru_cache(maxsize=64)
def _layout(heads: tuple[_Head, ...]) -> _Layout | None:
    """The layout of ticks with these messages; None if one of them is for `unbundled`."""
    at = 0
    names, gids, payloads = [], [], []
    numbers: list[int] = []
    stamps: list[int] = []
    fixed: list[int] = []
    for name, attachment_bytes, payload_bytes, is_wanted in heads:
        attachment_at = at + HEAD.size + len(name)
        fixed += range(at, attachment_at)
        at = attachment_at + attachment_bytes + payload_bytes
        if not is_wanted:
            continue
        payload_at, gid_at = at - payload_bytes, attachment_at + ATTACHMENT.size - GID_BYTES
        stamp_at = payload_at + ENCAPSULATION_BYTES
        if attachment_bytes < ATTACHMENT.size or stamp_at + _STAMP.itemsize > at:
            return None
        names.append(name)
        gids.append(slice(gid_at, gid_at + GID_BYTES))
        payloads.append(slice(payload_at, at))
        numbers += range(attachment_at, attachment_at + _NUMBERS.itemsize)
        stamps += range(stamp_at, stamp_at + _STAMP.itemsize)
        fixed += range(gid_at - 1, gid_at + GID_BYTES)  # and how many bytes it has
    if not names or len(set(names)) < len(names):
        return None
    columns = np.array([*numbers, *stamps, *fixed])
    stamps_from, fixed_from = len(numbers), len(numbers) + len(stamps)
    return _Layout(at, tuple(names), tuple(gids), tuple(payloads), columns, stamps_from, fixed_from)
