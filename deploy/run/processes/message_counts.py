"""Counts of a recorder's messages, and of missing ones."""

from __future__ import annotations

from collections import Counter

from bus_schema.zenoh.bundle_order import FORGED_NUMBER

SECOND_PLANT = "second_plant"
_MOST_STREAMS = 10_000  # forged ids, one per message, must not fill the memory
_LONGEST_GAP = 1 << 24
"""Longest gap counted, hours at 1 kHz; a longer one shows no number of messages."""
_MOST_EVENTS, _MOST_EVENT_BYTES, _MOST_EVENT_SENDERS = 5000, 1 << 20, 64
"""Limits on events per sender, their bytes, and senders; our processes send some dozens."""


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

    def note(self, topic: str, sender: bytes, sequence: int) -> None:
        """Note a message, and count those missing since its sender's last one.

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
            if sequence > last + 1:
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
