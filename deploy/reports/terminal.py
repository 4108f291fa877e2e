"""Pages and tables in a terminal."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from rich import box
from rich import table as rich_table
from rich.cells import cell_len
from rich.console import Console
from rich.segment import Segment
from rich.text import Text

from bus_schema.foreign_text import shortened
from deploy.judge.conditions import EFFORT, conditions_line
from deploy.reports.page import Level, Page, ReportHead
from deploy.reports.tables import (
    Column,
    Status,
    Table,
    of_columns,
    without_middle,
    without_shared,
)

STYLES: dict[Status | Level, str] = {
    "": "", "best": "bold", "mixed": "bold",
    "good": "bold green", "bad": "bold red", "broken": "bold red",
}  # fmt: skip
"""Styles of cells and verdicts."""
_WHOLE_LETTERS = 24
_PART_OF_NAME = re.compile(r"[^\s_]*(?:_+|\s+|$)")
_WIDEST = 10_000
_LEAST = 8
_MAIN = ("version", "scenario", "law", "physics", "duration", "seeds", EFFORT, "set")
_LONGEST = 80
"""Conditions that a terminal shows, and of how many letters at most."""


def print_page(console: Console, page: Page[Any]) -> None:
    """Print verdict, open tables and the main conditions of a page."""
    if page.heading:
        console.print(page.heading, markup=False, style="bold")
    _print_head(console, page.verdict)
    hidden = 0
    for table in page.open_tables:
        if table.most_printed != 0:
            print_table(console, replace(table, rows=table.rows[: table.most_printed]))
            hidden += len(table.rows[table.most_printed :]) if table.most_printed else 0
    for line in page.lines:
        console.print(line, markup=False, highlight=False, soft_wrap=True)
    if hidden:
        console.print(f"{hidden} more rows are in the report")
    print_conditions(console, page.conditions)


def _print_head(console: Console, head: ReportHead) -> None:
    if head.faults:
        first, *others = head.faults
        console.print(Text.assemble(("fault", STYLES["broken"]), f"  {first}"), soft_wrap=True)
        if others:
            console.print(f"{len(others)} more that followed are in the report", style="dim")
    headline = f"{head.headline[:1].lower()}{head.headline[1:]}"
    console.print(headline, style=STYLES[head.level], markup=False, highlight=False)
    for reason in head.reasons if head.printed is None else head.printed:
        has_command = ": funnel-hil " in reason  # to be copied, so on one line
        console.print(reason, markup=False, highlight=False, soft_wrap=has_command)


def print_table(console: Console, table: Table) -> None:
    """Print the columns of a table that have their place in a terminal.

    Where there is too little room for names, they lose their middle rather than go on below. What
    all rows share moves to the title then; other columns that find no room follow below.
    """
    for part in _parts(console, table):
        _print_part(console, part)


def _print_part(console: Console, table: Table) -> None:
    shown = _rendered(table)
    if _width(console, shown) > console.width:
        shown.padding, shown.show_edge = 0, False
    if _width(console, shown) > console.width:
        shown = _narrow(console, table)
    console.print(Text(table.title, "table.title"))  # not as the table's, which may be narrower
    console.print(shown, crop=False)  # a number without its end would be another one
    if not shown.show_edge:  # which is a blank line, too
        console.print()


def _narrow(console: Console, table: Table) -> rich_table.Table:
    longest = _WHOLE_LETTERS if console.is_terminal else None
    shown = _rendered(table, longest, is_narrow=True)
    shown.padding, shown.show_edge = 0, False
    return shown


def _parts(console: Console, table: Table) -> list[Table]:
    """Return a table in parts that are no wider than the terminal, as far as that is possible."""
    table = of_columns(table, [n for n, each in enumerate(table.columns) if each.brief is not None])
    if _fits(console, table):
        return [table]
    every = range(len(table.columns))
    heads = next((n for n in every if not table.columns[n].is_text), len(every))
    if fewer := without_shared(table):
        return _parts(console, fewer)
    for last in range(len(every) - 1, heads, -1):
        first = of_columns(table, every[:last])
        if _fits(console, first):
            return [first, *_parts(console, of_columns(table, [*every[:heads], *every[last:]]))]
    return [table]


def _fits(console: Console, table: Table) -> bool:
    lines = Segment.split_lines(console.render(_narrow(console, table)))
    return all(Segment.get_line_length(line) <= console.width for line in lines)


def open_table(
    title: str | None, headings: Sequence[str], rows: Iterable[Sequence[str | Text]], gap: int = 2
) -> rich_table.Table:
    """Return a table without lines, whose cells go on below where they are too long."""
    shown = rich_table.Table(
        title=title, title_justify="left", box=None, pad_edge=False, padding=(0, gap, 0, 0)
    )
    for heading in headings:
        shown.add_column(heading, overflow="fold")
    for row in rows:
        shown.add_row(*row)
    return shown


def _rendered(
    table: Table, longest: int | None = None, *, is_narrow: bool = False
) -> rich_table.Table:
    """A table as rich has it, its words of `longest` letters at most.

    Headings break between words; in a narrow table, names in them after a _, too.
    """
    chosen = [index for index, column in enumerate(table.columns) if column.brief is not None]
    rows = [
        [Text(_shortened(row[index].text, longest), STYLES[row[index].status]) for index in chosen]
        for row in table.cells
    ]
    shown = rich_table.Table(box=box.SIMPLE_HEAD, padding=(0, 1))
    for place, column in enumerate(table.columns[index] for index in chosen):
        heading = _heading(column)
        cells = [row[place].plain for row in rows]
        words = [word for cell in cells for word in cell.split()]
        is_name = len(words) <= len(rows) and max(map(len, cells), default=0) <= _WHOLE_LETTERS
        if is_narrow:
            heading = _with_breaks(heading, max(map(cell_len, words), default=0))
        words += heading.split()
        shown.add_column(
            Text(heading),
            justify="left" if column.is_text else "right",
            overflow="fold",
            no_wrap=column.is_text and is_name,
            min_width=max(map(cell_len, words), default=0),
        )
    for row in rows:
        shown.add_row(*row)
    return shown


def _shortened(text: str, longest: int | None) -> str:
    if longest is None:
        return text
    return " ".join(without_middle(word, longest) for word in text.split(" "))


def _width(console: Console, table: rich_table.Table) -> int:
    """Return the preferred width."""
    return console.measure(table, options=console.options.update(width=_WIDEST)).maximum


def print_conditions(console: Console, conditions: Mapping[str, str]) -> None:
    """Print the main conditions on one line; results are to be quoted with all of them."""
    main = {name: shortened(conditions[name], _LONGEST) for name in _MAIN if conditions.get(name)}
    if not main:
        return
    console.print(
        f"{conditions_line(main)} The report has all conditions.",
        markup=False,
        highlight=False,
        soft_wrap=not console.is_terminal,
        style="dim",
    )


def _heading(column: Column) -> str:
    return "\n".join(filter(None, (column.brief or column.heading, column.unit)))


def _with_breaks(heading: str, width: int) -> str:
    """Return a heading whose names go on below after a _, in as many letters as its parts need."""
    parts = _PART_OF_NAME.findall(heading)
    width = max(width, *(cell_len(part.rstrip()) for part in parts), 0)
    lines = [""]
    for part in parts:
        if lines[-1].endswith("_") and cell_len(lines[-1].split()[-1] + part.rstrip()) > width:
            lines.append("")
        lines[-1] += part
    return "\n".join(lines)


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
