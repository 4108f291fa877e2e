"""The bundles of one sender in the order of their numbers, each once, whenever they come."""

from __future__ import annotations

from bus_schema.zenoh.bundles import MOST_AT_ONCE, Span

_MOST_WAITING = 256
_AGAIN_S = 0.1
_LONGEST_JUMP = 200_000
"""What no sender sends between two bundles that arrive, minutes at any rate: a number is forged."""
_MOST_ASKED = 7
"""So often in vain, each time after twice as long, 13 s in all, and what is missing is lost."""


class BundleOrder:
    """What comes before what is missing waits for it, and what is missing is asked for.

    Args:
        sender: who sends them.

    Attributes:
        disbelieved: bundles that were left out, as their sender cannot have come so far.
    """

    def __init__(self, sender: bytes) -> None:
        self._sender = sender
        self._next = 1
        self._last = 0  # the newest that is known to have been sent
        self._waiting: dict[int, bytes] = {}
        self.disbelieved = 0
        self._asked_for = self._asked_to = self._asked = 0
        self._since_s = 0.0  # when something was asked for, or came of it

    def take_in(self, span: Span, bundle: bytes) -> list[bytes]:
        """A bundle came; those whose turn it is now.

        Args:
            span: what stood beside it: those before its first nobody has any more.
            bundle: its bytes; empty where its number is only told of.
        """
        if self._last and span.last > self._last + _LONGEST_JUMP:
            self.disbelieved += 1
            return []
        if span.last < self._next - _LONGEST_JUMP:  # then the first was forged
            self.disbelieved += 1 + len(self._waiting)
            self._waiting.clear()
            self._next, self._last = span.first, 0
        if bundle and span.last >= self._next:
            self._waiting[span.last] = bundle
        self._last = max(self._last, span.last)
        if len(self._waiting) > _MOST_WAITING:
            return self._from(self._first_waiting())
        return self._from(span.first)

    def missed(self, now_s: float) -> Span | None:
        """What to ask the sender for at this time; None for nothing, or not yet.

        As little at a time as he sends at once, and no more while that is on its way: a slow
        connection would be full of what was asked for again.
        """
        if self._next > self._last:
            return None
        if self._asked_for != self._next:
            self._asked_for, self._asked = self._next, 0
            if self._next <= self._asked_to:
                self._since_s = now_s
                return None
        elif now_s - self._since_s < _AGAIN_S * 2**self._asked:
            return None
        self._asked += 1
        self._since_s = now_s
        self._asked_to = min(self._next + MOST_AT_ONCE, self._first_waiting()) - 1
        return Span(self._next, self._asked_to, self._sender)

    def overdue(self) -> list[bytes]:
        """Those that have waited for long enough for what is asked for in vain."""
        is_in_vain = self._asked_for == self._next and self._asked >= _MOST_ASKED
        return self._from(self._first_waiting()) if is_in_vain else []

    def rest(self) -> list[bytes]:
        """All that wait, whatever is missing."""
        return self._from(self._last + 1)

    def _first_waiting(self) -> int:
        return min(self._waiting, default=self._last + 1)

    def _from(self, first: int) -> list[bytes]:
        """Those before the `first` as they are, and from there on those that follow one another."""
        before = sorted(number for number in self._waiting if number < first)
        ready = [self._waiting.pop(number) for number in before]
        self._next = max(self._next, first)
        while (bundle := self._waiting.pop(self._next, None)) is not None:
            ready.append(bundle)
            self._next += 1
        return ready
