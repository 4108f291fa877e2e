"""Reads network measurements: CSV or Parquet files with named columns of numbers."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Vector
from bus_schema.configuration import shown
from bus_schema.user_files import read_bytes

MOST_BYTES = 500_000_000
"""Ten million samples as text take less."""
PARQUET = b"PAR1"
"""How files of that format begin."""
_DELIMITERS = ",;\t"


@dataclass(frozen=True)
class Columns:
    """The columns of a file.

    Attributes:
        path: the file.
        values: numbers by column, NaN where a cell is empty; each of shape (rows,).
        content: the file as text; empty for Parquet.
    """

    path: Path
    values: dict[str, Vector]
    content: bytes = b""

    @property
    def rows(self) -> int:
        return len(next(iter(self.values.values())))

    def refusal(self, row: int, column: str, allowed: str) -> ValueError:
        """Return the error for a cell of a row (counted from 0), with line and column."""
        where = f"row {row + 1}"
        if self.content:
            where = f"line {next(islice(_lines(self.content), row + 1, None))[0]}"
        value = self.values[column][row]
        text = "empty" if np.isnan(value) else f"{value:g}"
        return ValueError(f"{self.path}, {where}, column {column} = {text}: {allowed}")

    def refuse_where(self, is_wrong: NDArray[np.bool_], column: str, allowed: str) -> None:
        """Raise a `refusal` for the first wrong row, if there is one."""
        if is_wrong.any():
            raise self.refusal(int(np.argmax(is_wrong)), column, allowed)


def read_columns(path: Path, required: Sequence[str], optional: Sequence[str]) -> Columns:
    """Read the columns of a file.

    Args:
        path: a Parquet file, or CSV whose first line has the names; lines before it may be
            comments with ``#``. Commas, semicolons or tabs separate cells.
        required: columns that must be there.
        optional: columns that may be there; others may not.

    Raises:
        ValueError: it cannot be read, or holds something else; the message names line and column.
    """
    try:
        content = read_bytes(path, MOST_BYTES)
    except OSError as error:
        raise ValueError(f"{path} cannot be read: {error}") from error
    return (_parquet if content.startswith(PARQUET) else _csv)(path, content, required, optional)


def _parquet(
    path: Path, content: bytes, required: Sequence[str], optional: Sequence[str]
) -> Columns:
    import pyarrow as pa  # heavy, and needed by few scenarios
    from pyarrow import parquet

    try:
        table = parquet.read_table(pa.BufferReader(content))
        _check_names(path, "", table.column_names, required, optional)
        doubles = table.cast(pa.schema([(name, pa.float64()) for name in table.column_names]))
    except pa.ArrowException as error:
        raise ValueError(f"{path} cannot be read as Parquet: {error}") from error
    return Columns(path, _vectors(doubles))


def _csv(path: Path, content: bytes, required: Sequence[str], optional: Sequence[str]) -> Columns:
    import pyarrow as pa  # heavy, and needed by few scenarios
    from pyarrow import csv as fast_csv

    number, header = next(_lines(content), (1, ""))
    delimiter = max(_DELIMITERS, key=header.count)
    names = [name.strip().strip('"') for name in header.split(delimiter)]
    _check_names(path, f", line {number}", names, required, optional)
    try:
        table = fast_csv.read_csv(
            pa.BufferReader(content),
            fast_csv.ReadOptions(column_names=names, skip_rows=number),
            fast_csv.ParseOptions(delimiter=delimiter),
            fast_csv.ConvertOptions(
                column_types=dict.fromkeys(names, pa.float64()), null_values=["", "nan", "NaN"]
            ),
        )
    except pa.ArrowException as error:
        _refuse_line(path, content, delimiter, names)
        raise ValueError(f"{path} cannot be read as CSV: {error}") from error
    return Columns(path, _vectors(table), content)


def _vectors(table: Any) -> dict[str, Vector]:
    columns = zip(table.column_names, table.columns, strict=True)
    return {name: column.to_numpy().astype(np.float64, copy=False) for name, column in columns}


def _check_names(
    path: Path, where: str, names: Sequence[str], required: Sequence[str], optional: Sequence[str]
) -> None:
    """Refuse missing and unknown columns: an unknown one may be a misspelt one."""
    known = [*required, *optional]
    allowed = f"the columns are {', '.join(required)}"
    if optional:
        allowed += f", and perhaps {', '.join(optional)}"
    for place, name in enumerate(names, start=1):
        if name not in known or names.count(name) > 1:
            said = "occurs twice" if name in known else "is unknown"
            raise ValueError(f"{path}{where}, column {place} {shown(name)} {said}: {allowed}")
    for name in required:
        if name not in names:
            raise ValueError(f"{path}{where}: column {name} is missing: {allowed}")


def _refuse_line(path: Path, content: bytes, delimiter: str, names: Sequence[str]) -> None:
    """Raise a ValueError that names the first line that has not a number per column."""
    for number, line in islice(_lines(content), 1, None):
        cells = line.split(delimiter)
        if len(cells) != len(names):
            what = f"has {len(cells)} cells, the first line names {len(names)} columns"
            raise ValueError(f"{path}, line {number} {what}")
        for name, cell in zip(names, cells, strict=True):
            try:
                float(cell.strip() or "nan")
            except ValueError:
                what = f"column {name} = {shown(cell.strip())}: is not a number"
                raise ValueError(f"{path}, line {number}, {what}") from None


def _lines(content: bytes) -> Iterator[tuple[int, str]]:
    """Return the header and all non-empty lines after it, with their numbers from 1."""
    lines = io.TextIOWrapper(io.BytesIO(content), encoding="utf-8-sig", errors="replace")
    is_header = True
    for number, line in enumerate(lines, start=1):
        if line.strip() and not (is_header and line.startswith("#")):
            is_header = False
            yield number, line.rstrip("\n")
