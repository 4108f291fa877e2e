"""Tables of what came of runs: one model, and how its values are written.

A table is built once from a summary; `terminal.print_table`, the templates of the reports and
`as_markdown` render it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeVar

from pydantic import BaseModel
from rich.cells import cell_len, set_cell_size

from bus_schema.foreign_text import markdown_table
from deploy.judge.conditions import conditions_line

ABSENT = "–"
SOFT_HYPHEN, NO_BREAK = "\u00ad", "\u00a0"
_FAR_OUTSIDE = -1.0
"""Margin below which an error is shown as a multiple of its bound."""
_NEARLY_ALL = 0.99
_ALL_DIGITS_FROM = 999.5
_EXPONENT = re.compile(r"e-0*(\d+)")
_RAISED = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")

Value = str | float | None
"""A text, a number in the unit of its column, or nothing known."""

Status = Literal["", "good", "bad", "best"]


def number(value: float | None, factor: float = 1.0, unit: str = "") -> str:
    """A value times a factor, to three digits or to the last whole one, and its unit."""
    if value is None:
        return ABSENT
    scaled = factor * value
    shown = f"{scaled:,.0f}" if abs(scaled) >= _ALL_DIGITS_FROM else f"{scaled:.3g}"
    return _EXPONENT.sub(lambda match: f" × 10⁻{match[1].translate(_RAISED)}", shown) + unit


def percent(value: float | None) -> str:
    """A fraction as per cent; 100 % only where it is exactly that."""
    if value is None:
        return ABSENT
    return "100 %" if value == 1.0 else f"{min(100 * value, 99.999):.5g} %"


def margin_percent(margin: float | None) -> Value:
    """1 − |e| / bound in per cent; where the error was beyond twice its bound, in words.

    Per cent of a bound that was left far behind say nothing to a reader.
    """
    if margin is None or margin >= _FAR_OUTSIDE:
        return scaled(margin, 100.0)
    return f"error {number(1.0 - margin)} × bound"


def margin_text(margin: float | None) -> str:
    """A margin with its unit, as `margin_percent`; near 100 % with more digits."""
    if margin is not None and margin > _NEARLY_ALL:
        return percent(margin)
    value = margin_percent(margin)
    return (
        value if isinstance(value, str) else number(value, unit=" %" if value is not None else "")
    )


def scaled(value: float | None, factor: float) -> float | None:
    """A value in another unit, where it is known."""
    return None if value is None else factor * value


def short_names(names: Sequence[str]) -> list[str]:
    """Names without the words that all begin with, such as ``…joint_3`` for ``lbr_iiwa_joint_3``.

    What is left begins with a letter, so that it says something alone.
    """
    words = [name.split("_") for name in names]
    shared = 0
    while len(names) > 1 and all(
        rest[:1] == words[0][shared : shared + 1] and rest[1:] and rest[1][:1].isalpha()
        for rest in (each[shared:] for each in words)
    ):
        shared += 1
    return [("…" if shared else "") + "_".join(each[shared:]) for each in words]


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        heading: in a report.
        unit: of its numbers; it stands in the heading.
        brief: heading in a terminal and a paper, where there is little room; the same if empty, and
            None for a column that only reports have.
        is_text: whether it is read as text, from the left, rather than compared as numbers.
    """

    heading: str
    unit: str = ""
    brief: str | None = ""
    is_text: bool = False

    @property
    def title(self) -> str:
        """Heading with unit, on one line."""
        return f"{self.heading} ({self.unit})" if self.unit else self.heading

    @property
    def brief_title(self) -> str:
        """Short heading, where it has one, with unit, on one line."""
        return self.breakable_title.replace(SOFT_HYPHEN, "").replace(NO_BREAK, " ")

    @property
    def breakable_title(self) -> str:
        """The same, with soft hyphens where its words can break, and units that cannot."""
        broken = (self.brief or self.heading).replace("-\n", SOFT_HYPHEN).replace(".\n", ".")
        brief = " ".join(broken.split())
        return f"{brief} ({self.unit.replace(' ', NO_BREAK)})" if self.unit else brief


@dataclass(frozen=True)
class Shown(Column):
    """For `Annotated`: a number of a result is a column of its tables.

    Attributes:
        factor: from the unit of the result to that of the column.
    """

    factor: float = 1.0


def shown_in(part: type[BaseModel]) -> dict[str, Shown]:
    """Return the columns of a part of a result, by the names of its fields."""
    fields = part.model_fields.items()
    return {name: e for name, f in fields for e in f.metadata if isinstance(e, Shown)}


@dataclass(frozen=True)
class Cell:
    """A value with its judgement.

    Attributes:
        value: text, or number in the unit of the column.
        status: ``good`` and ``bad`` judge it; ``best`` sets it off from its column.
    """

    value: Value
    status: Status = ""

    @property
    def text(self) -> str:
        return self.value if isinstance(self.value, str) else number(self.value)


@dataclass(frozen=True)
class Table:
    """A table whose first column names the rows.

    Attributes:
        title: what it is about.
        columns: what stands in them.
        rows: a value or a cell for each column.
        note: what a reader must know of its numbers.
        most_printed: number of rows that a terminal shows; None for all, 0 for no table there.
    """

    title: str
    columns: Sequence[Column]
    rows: Sequence[Sequence[Cell | Value]]
    note: str = ""
    most_printed: int | None = None

    @property
    def cells(self) -> list[list[Cell]]:
        """All rows, with a cell for each column."""
        return [
            [entry if isinstance(entry, Cell) else Cell(entry) for entry in row]
            for row in self.rows
        ]


Item = TypeVar("Item")


def table_of(
    title: str,
    columns: Sequence[tuple[Column, Callable[[Item], Cell | Value]]],
    items: Iterable[Item],
    note: str = "",
    most_printed: int | None = None,
) -> Table:
    """A table with a row for each item.

    Args:
        title: what it is about.
        columns: each with what it has of an item.
        items: what the rows are of.
        note: what a reader must know of its numbers.
        most_printed: as in `Table`.
    """
    rows = [[of(item) for _, of in columns] for item in items]
    return Table(title, [column for column, _ in columns], rows, note, most_printed)


def of_columns(table: Table, chosen: Sequence[int]) -> Table:
    """Return a table with only some of its columns."""
    rows = [[row[n] for n in chosen] for row in table.rows]
    return replace(table, columns=[table.columns[n] for n in chosen], rows=rows)


def without_shared(table: Table) -> Table | None:
    """Return a table whose title has what all rows share of the first texts; None if nothing."""
    every = range(len(table.columns))
    heads = next((n for n in every if not table.columns[n].is_text), len(every))
    shared = [n for n in range(heads) if len({row[n].text for row in table.cells}) == 1]
    if not (shared := shared[: heads - 1]):  # a row has a name
        return None
    names = ", ".join(table.cells[0][n].text for n in shared)
    kept = of_columns(table, [n for n in every if n not in shared])
    return replace(kept, title=f"{table.title}: {names}")


def quotable(table: Table, conditions: Mapping[str, str]) -> str:
    """A table for documents that stands alone: what it is and its conditions are below it."""
    note = f"{table.title}. {table.note}".rstrip()
    return "\n\n".join([as_markdown(table), note, conditions_line(conditions)]) + "\n"


def as_markdown(table: Table) -> str:
    """A table for documents."""
    header = [column.title for column in table.columns]
    rows = ([cell.text for cell in row] for row in table.cells)
    return markdown_table(header, rows).rstrip("\n")


def without_middle(text: str, width: int) -> str:
    """A text in so many columns of a terminal, its middle left out where it is longer."""
    if cell_len(text) <= width:
        return text
    head = set_cell_size(text, width // 2)
    tail = set_cell_size(text[::-1], width - 1 - width // 2)[::-1]
    return f"{head}…{tail}"
