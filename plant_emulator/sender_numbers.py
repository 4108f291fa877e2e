"""The numbers under which one sender sends: what was sent before, and what another one sends."""

from __future__ import annotations

from collections import OrderedDict

_REMEMBERED = 1000
"""Messages; a link that changes their order does so by far less."""


class SenderNumbers:
    """Knows messages that came before, and finds out that two send under one sender's name.

    A sender counts its messages. One number with two contents, or one that is far behind another,
    is no work of a link. Whoever takes the place of a sender that has fallen silent, and counts on
    where it stopped, is not found out.

    Attributes:
        second_source: what shows that somebody else sends under this name; None for nothing.
    """

    def __init__(self) -> None:
        self._contents: OrderedDict[int, int] = OrderedDict()  # hash by number, oldest first
        self._highest = 0
        self.second_source: str | None = None

    def is_new(self, number: int, payload: bytes) -> bool:
        """Whether no message of this number came lately; from now on one has.

        Args:
            number: what the sender says.
            payload: its contents.
        """
        contents = hash(payload)
        known = self._contents.get(number)
        if known is not None:
            if known != contents:
                self.second_source = f"its number {number} came with two contents"
            return False
        if number < self._highest - _REMEMBERED:
            self.second_source = f"its number {number} came after {self._highest}"
        self._highest = max(number, self._highest)
        self._contents[number] = contents
        if len(self._contents) > _REMEMBERED:
            self._contents.popitem(last=False)
        return True
