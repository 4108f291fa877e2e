"""The bundles of one sender in the order of their numbers, each once, whenever they come."""

from __future__ import annotations

from collections import Counter

from bus_schema.zenoh.bundles import MOST_AT_ONCE, MOST_KEPT, Span

FORGED_NUMBER, ALTERED_BUNDLE = "forged_number", "altered_bundle"
"""Reasons for which a bundle is rejected."""
_MOST_WAITING, _MOST_WAITING_BYTES = 256, 1 << 24
_AGAIN_S = 0.1
_LONGEST_JUMP = 200_000
"""What no sender sends between two bundles that arrive, minutes at any rate: a number is forged."""
_MOST_ASKED = 7
"""So often in vain, each time after twice as long, 13 s in all, and what is missing is lost."""


class BundleOrder:
    """What comes before what is missing waits for it, and what is missing is asked for.

    Args:
        sender: who sends them.
        rejected: counts, by reason, bundles that their sender cannot have sent: it has not come so
            far, or has sent another one of that number.
    """

    def __init__(self, sender: bytes, rejected: Counter[str]) -> None:
        self._sender, self._rejected = sender, rejected
        self._contents: dict[int, int] = {}  # hash of each that may still be sent again
        self._next = 1
        self._last = 0  # the newest that is known to have been sent
        self._waiting: dict[int, bytes] = {}
        self._asked_for = self._asked_to = self._asked = 0
        self._since_s = 0.0  # when something was asked for, or came of it

    def take_in(self, span: Span, bundle: bytes) -> list[bytes]:
        """A bundle came; those whose turn it is now.

        Args:
            span: what stood beside it: those before its first nobody has any more.
            bundle: its bytes; empty where its number is only told of.
        """
        if self._last and span.last > self._last + _LONGEST_JUMP:
            self._rejected[FORGED_NUMBER] += 1
            return []
        if span.last < self._next - _LONGEST_JUMP:  # then the first was forged
            self._rejected[FORGED_NUMBER] += 1 + len(self._waiting)
            self._waiting.clear()
            self._contents.clear()
            self._next, self._last = span.first, 0
        if bundle and self._is_genuine(span.last, bundle) and span.last >= self._next:
            self._waiting[span.last] = bundle
        self._last = max(self._last, span.last)
        waiting_bytes = sum(map(len, self._waiting.values()))
        if len(self._waiting) > _MOST_WAITING or waiting_bytes > _MOST_WAITING_BYTES:
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

    def _is_genuine(self, number: int, bundle: bytes) -> bool:
        """Whether it is what came first under its number; one with other contents is counted."""
        content = hash(bundle)
        is_genuine = self._contents.setdefault(number, content) == content
        if not is_genuine:
            self._rejected[ALTERED_BUNDLE] += 1
        if len(self._contents) > MOST_KEPT:
            del self._contents[next(iter(self._contents))]
        return is_genuine

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
