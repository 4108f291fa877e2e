"""The console of all commands: what others wrote is shown as text."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rich import console
from rich.segment import Segment

from bus_schema.foreign_text import printable


class Console(console.Console):
    """A console that reads no markup, and removes escape sequences and control characters.

    Names, tags, events and recordings may contain them. Use `rich.text.Text` and `style` instead.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(**{"markup": False, "emoji": False, **options})

    def render(self, *renderable: Any, **options: Any) -> Iterable[Segment]:
        for segment in super().render(*renderable, **options):
            is_control = segment.control is not None
            yield segment if is_control else Segment(printable(segment.text), segment.style)
