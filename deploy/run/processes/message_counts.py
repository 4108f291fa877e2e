"""What a recorder counts of the messages that come to it, and of those that never came."""

from __future__ import annotations

from collections import Counter

from bus_schema.zenoh.bundle_order import FORGED_NUMBER

SECOND_PLANT = "second_plant"
_MOST_STREAMS = 10_000  # whoever makes up an id for each message fills no memory
_LONGEST_GAP = 1 << 24
"""Messages that a sender may have sent unheard, hours at 1 kHz; a longer gap is of no count."""
_MOST_EVENTS, _MOST_EVENT_BYTES, _MOST_EVENT_SENDERS = 5000, 1 << 20, 64
"""Of one sender, and how many of these; a process of ours sends some dozens."""


class GapCounter:
    """Counts messages that never came, by the gaps in their senders' numbers.

    Args:
        rejected: counts, by reason, messages whose numbers no sender can have come to.

    Attributes:
        missed: messages that are missing, by topic.
    """

    def __init__(self, rejected: Counter[str]) -> None:
        self._last_sequence: dict[tuple[str, bytes], int] = {}
        self.missed: Counter[str] = Counter()
        self._rejected = rejected

    def note(self, topic: str, sender: bytes, sequence: int) -> None:
        """A message came; what is missing since the last one of its sender is missed.

        Of those whose number is 0, which is none, nothing is known to be missing.
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
        """Somebody else got `count` messages, of which `came` came here too.

        How many of the others nobody had missed so far.
        """
        unknown = max(0, count - came - self.missed[topic])
        self.missed[topic] += unknown
        return unknown


class PlantSenders:
    """Counts what cannot come from the one plant of a run: by a second sender, or once more.

    Args:
        rejected: counts them, by reason.
    """

    def __init__(self, rejected: Counter[str]) -> None:
        self._rejected = rejected
        self._last: dict[str, tuple[bytes, int]] = {}

    def note(self, topic: str, sender: bytes, sequence: int) -> None:
        """A message came that is the plant's to send; one that never numbers them sends 0."""
        known, last = self._last.setdefault(topic, (sender, sequence - 1))
        if sender != known or (last > 0 and sequence <= last):
            self._rejected[SECOND_PLANT] += 1
        else:
            self._last[topic] = sender, sequence


class EventBudget:
    """How many run events are recorded: where a run is judged, all of them are held in memory."""

    def __init__(self) -> None:
        self._spent: dict[bytes, tuple[int, int]] = {}

    def admits(self, sender: bytes, size_bytes: int) -> bool:
        """Whether another event of a sender is recorded."""
        if sender not in self._spent and len(self._spent) >= _MOST_EVENT_SENDERS:
            return False
        count, spent_bytes = self._spent.get(sender, (0, 0))
        self._spent[sender] = count + 1, spent_bytes + size_bytes
        return count < _MOST_EVENTS and spent_bytes + size_bytes <= _MOST_EVENT_BYTES
