"""Tables in a terminal."""

from __future__ import annotations

from rich import box
from rich import table as rich_table
from rich.console import Console
from rich.text import Text

from deploy.reports.narrow import without_middle
from deploy.reports.tables import Column, Status, Table
from deploy.runs.conditions import Conditions, conditions_line

STYLES: dict[Status, str] = {"": "", "good": "bold green", "bad": "bold red", "best": "bold"}
_WHOLE_LETTERS = 24
_WIDEST = 10_000


def print_table(console: Console, table: Table) -> None:
    """Print the columns of a table that have their place in a terminal.

    Where there is too little room for names, they lose their middle rather than go on below.
    """
    shown = _rendered(table)
    if _width(console, shown) > console.width:
        shown.padding, shown.show_edge = 0, False
    if console.is_terminal and _width(console, shown) > console.width:
        shown = _rendered(table, _WHOLE_LETTERS)
        shown.padding, shown.show_edge = 0, False
    console.print(Text(table.title, "table.title"))  # not as the table's, which may be narrower
    console.print(shown)
    if not shown.show_edge:  # which is a blank line, too
        console.print()


def _rendered(table: Table, longest: int | None = None) -> rich_table.Table:
    """A table as rich has it, its words of `longest` letters at most."""
    chosen = [index for index, column in enumerate(table.columns) if column.brief is not None]
    rows = [
        [Text(_told(row[index].text, longest), STYLES[row[index].status]) for index in chosen]
        for row in table.cells
    ]
    shown = rich_table.Table(box=box.SIMPLE_HEAD, padding=(0, 1))
    for place, column in enumerate(table.columns[index] for index in chosen):
        widest = max((len(row[place]) for row in rows), default=0)
        shown.add_column(
            _heading(column),
            justify="left" if column.is_text else "right",
            overflow="fold",
            no_wrap=column.is_text and widest <= _WHOLE_LETTERS,
        )
    for row in rows:
        shown.add_row(*row)
    return shown


def _told(text: str, longest: int | None) -> str:
    if longest is None:
        return text
    return " ".join(without_middle(word, longest) for word in text.split(" "))


def _width(console: Console, table: rich_table.Table) -> int:
    """How wide it would like to be."""
    return console.measure(table, options=console.options.update(width=_WIDEST)).maximum


def print_conditions(console: Console, conditions: Conditions) -> None:
    """Print what results are to be quoted with; through a pipe on one line."""
    console.print(
        conditions_line(conditions),
        markup=False,
        highlight=False,
        soft_wrap=not console.is_terminal,
        style="dim",
    )


def _heading(column: Column) -> Text:
    return Text("\n".join(filter(None, (column.brief or column.heading, column.unit))))
