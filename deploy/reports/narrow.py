"""Texts that stay on one line of a narrow terminal: what is too long loses its middle."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from rich.cells import cell_len, set_cell_size

_LEAST = 8


def without_middle(text: str, width: int) -> str:
    """A text in so many columns of a terminal, its middle left out where it is longer."""
    if cell_len(text) <= width:
        return text
    head = set_cell_size(text, width // 2)
    tail = set_cell_size(text[::-1], width - 1 - width // 2)[::-1]
    return f"{head}…{tail}"


def width_of(rows: Sequence[Sequence[str]]) -> int:
    """Columns of a terminal that the cells of a row take, where none is made narrower."""
    return sum(_widths(rows))


def fitted(
    rows: Sequence[Sequence[str]], room: int, may_shrink: Collection[int]
) -> list[list[str]]:
    """Rows of a table whose widest columns are made as narrow as they have to be.

    Args:
        rows: its headings, too.
        room: columns of the terminal for all cells of a row.
        may_shrink: numbers of the columns of the table that may.
    """
    widths = _widths(rows)
    while sum(widths) > room:
        widest = max(may_shrink, key=widths.__getitem__)
        if widths[widest] <= _LEAST:
            break
        widths[widest] -= 1
    return [
        [without_middle(text, width) for text, width in zip(row, widths, strict=True)]
        for row in rows
    ]


def _widths(rows: Sequence[Sequence[str]]) -> list[int]:
    return [max(map(cell_len, column)) for column in zip(*rows, strict=True)]
