"""Order of one sender's bundles by their numbers, each once, even if they arrive out of order."""

from __future__ import annotations

from collections import Counter

from bus_schema.zenoh.bundles import MOST_AT_ONCE, MOST_KEPT, Span

FORGED_NUMBER, ALTERED_BUNDLE = "forged_number", "altered_bundle"
"""Reasons for the rejection of a bundle."""
_MOST_WAITING, _MOST_WAITING_BYTES = 256, 1 << 24
_AGAIN_S = 0.1
_LONGEST_JUMP = 200_000
"""More than a sender sends in minutes: a larger jump between two numbers shows a forgery."""
_MOST_ASKED = 7
"""Requests in vain, each after twice the time (13 s in all), until a bundle counts as lost."""


class BundleOrder:
    """Holds bundles back until the missing ones before them have been requested and received.

    Args:
        sender: the sender's identifier.
        rejected: counts, by reason, bundles that their sender cannot have sent: their number is too
            high, or their content differs from the one sent under that number.
    """

    def __init__(self, sender: bytes, rejected: Counter[str]) -> None:
        self._sender, self._rejected = sender, rejected
        self._contents: dict[int, int] = {}  # hash of each bundle that may still be sent again
        self._next = 1
        self._last = 0  # newest number known to be sent
        self._waiting: dict[int, bytes] = {}
        self._asked_for = self._asked_to = self._asked = 0
        self._since_s = 0.0  # time of the last request, or of its answer

    def take_in(self, span: Span, bundle: bytes) -> list[bytes]:
        """Take in a bundle; return the bundles whose turn it is now.

        Args:
            span: range of numbers sent with it; bundles before its first are no longer available.
            bundle: its bytes; empty where only its number is reported.
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
        """Return the range to request from the sender at this time; None for nothing, or not yet.

        A request covers no more than the sender sends at once, and waits for the last one's answer:
        repeated bundles would fill a slow connection.
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
        """Return the bundles that have waited long enough for one requested in vain."""
        is_in_vain = self._asked_for == self._next and self._asked >= _MOST_ASKED
        return self._from(self._first_waiting()) if is_in_vain else []

    def rest(self) -> list[bytes]:
        """Return all waiting bundles, even if some before them are missing."""
        return self._from(self._last + 1)

    def _is_genuine(self, number: int, bundle: bytes) -> bool:
        """Whether a bundle equals the first one of its number; a different one is counted."""
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
        """Return all bundles before `first`, and from there on as long as none is missing."""
        before = sorted(number for number in self._waiting if number < first)
        ready = [self._waiting.pop(number) for number in before]
        self._next = max(self._next, first)
        while (bundle := self._waiting.pop(self._next, None)) is not None:
            ready.append(bundle)
            self._next += 1
        return ready
