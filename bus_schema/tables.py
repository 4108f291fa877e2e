"""Reads tables: CSV or Parquet files with named columns of numbers."""

from __future__ import annotations

import gzip
import io
import re
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Vector
from bus_schema.configuration import shown
from bus_schema.errors import did_you_mean
from bus_schema.foreign_files import refuse_foreign
from bus_schema.user_files import open_parquet, read_bytes

MOST_BYTES = 500_000_000
"""Ten million samples as text take less."""
PARQUET, _GZIP = b"PAR1", b"\x1f\x8b"
"""First bytes of files of these formats."""
_UTF_16 = (b"\xff\xfe", b"\xfe\xff")
_LONGEST_LIST = 100
Names = Sequence[str]
_DELIMITERS = ",;\t"
_NUMBERS = re.compile(r"u?int\d+|halffloat|float|double|decimal.*|null")
"""Names of Arrow's types of numbers."""


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

    def place(self, row: int) -> str:
        """Return where a row (counted from 0) is in the file, as ``line 12``."""
        if not self.content:
            return f"row {row + 1}"
        return f"line {self._line(row)[0]}"

    def refusal(self, row: int, column: str, allowed: str) -> ValueError:
        """Return the error for a cell of a row (counted from 0), with line and column."""
        value = self.values[column][row]
        text = "" if np.isnan(value) else f"{value:g}"
        if self.content:
            _, delimiter, names = _header(self.content)
            text = self._line(row)[1].split(delimiter)[names.index(column)].strip()
        where = f"{self.path}, {self.place(row)}, column {column}"
        return ValueError(f"{where} = {text or 'empty'}: {allowed}")

    def _line(self, row: int) -> tuple[int, str]:
        return next(islice(_lines(self.content), row + 1, None))

    def refuse_where(self, is_wrong: NDArray[np.bool_], column: str, allowed: str) -> None:
        """Raise a `refusal` for the first wrong row, if there is one."""
        if is_wrong.any():
            raise self.refusal(int(np.argmax(is_wrong)), column, allowed)


def read_columns(path: Path, required: Names, optional: Names | None) -> Columns:
    """Read the columns of a file.

    Args:
        path: a Parquet file, or CSV whose first line has the names; lines before it may be
            comments with ``#``. Commas, semicolons or tabs separate cells.
        required: columns that must be there.
        optional: columns that may be there; others may not. None: others may, and are not read.

    Raises:
        ValueError: it cannot be read, or holds something else; the message names line and column.
    """
    content = _content(path)
    if not content.startswith(PARQUET):
        refuse_foreign(path, content)
    return (_parquet if content.startswith(PARQUET) else _csv)(path, content, required, optional)


def column_names(path: Path) -> list[str]:
    """Return the names of a file's columns; those of lists with an index, as ``action[2]``.

    Raises:
        ValueError: it cannot be read.
    """
    content = _content(path)
    if content.startswith(PARQUET):
        names: list[str] = _table(path, content).column_names
        return names
    return _header(content)[2]


def _content(path: Path) -> bytes:
    """Return what is in a file, unpacked if it is compressed by gzip."""
    try:
        content = read_bytes(path, MOST_BYTES)
        if content.startswith(_GZIP):
            with gzip.open(io.BytesIO(content)) as packed:
                content = packed.read(MOST_BYTES + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise ValueError(f"{path} cannot be read: {error}") from error
    if len(content) > MOST_BYTES:
        raise ValueError(f"{path} cannot be read: is larger than {MOST_BYTES / 1e6:g} MB unpacked")
    if content.startswith(_UTF_16):
        raise ValueError(f"{path} cannot be read as CSV: must be text in UTF-8, is in UTF-16")
    return content


def _parquet(path: Path, content: bytes, required: Names, optional: Names | None) -> Columns:
    import pyarrow as pa  # heavy, and needed by few scenarios

    try:
        file = open_parquet(pa.BufferReader(content))
        has_all = set(required) <= set(file.schema_arrow.names)  # else some are elements of lists
        table = file.schema_arrow.empty_table() if has_all else _table(path, content)
        names = _check_names(str(path), table.column_names, required, optional)
        for field in map(table.schema.field, names):
            is_flag = pa.types.is_boolean(field.type) and field.name == "lost"
            if not (is_flag or _NUMBERS.fullmatch(str(field.type))):
                what = f"column {field.name} holds values of type {field.type}"
                raise ValueError(f"{path}, {what}: must be numbers")
        table = file.read(names) if has_all else table.select(names)
        doubles = table.cast(pa.schema([(name, pa.float64()) for name in names]))
    except (pa.ArrowException, OSError) as error:
        raise ValueError(f"{path} cannot be read as Parquet: {error}") from error
    return Columns(path, _vectors(doubles))


def _table(path: Path, content: bytes) -> Any:
    """Return the table of a Parquet file; each element of lists of one length is a column."""
    import pyarrow as pa
    import pyarrow.compute as pc

    try:
        table = open_parquet(pa.BufferReader(content)).read()
        for name in table.column_names:
            kind = table.schema.field(name).type
            if not (pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind)):
                continue
            lengths = pc.unique(pc.list_value_length(table[name])).to_pylist()
            if len(lengths) == 1 and 0 < (lengths[0] or 0) <= _LONGEST_LIST:
                for index in range(lengths[0]):
                    element = pc.list_element(table[name], index)
                    table = table.append_column(f"{name}[{index}]", element)
    except (pa.ArrowException, OSError) as error:
        raise ValueError(f"{path} cannot be read as Parquet: {error}") from error
    return table


def _csv(path: Path, content: bytes, required: Names, optional: Names | None) -> Columns:
    import pyarrow as pa  # heavy, and needed by few scenarios
    from pyarrow import csv as fast_csv

    number, delimiter, names = _header(content)
    wanted = _check_names(f"{path}, line {number}", names, required, optional)
    try:
        table = fast_csv.read_csv(
            pa.BufferReader(content),
            fast_csv.ReadOptions(column_names=names, skip_rows=number),
            fast_csv.ParseOptions(delimiter=delimiter),
            fast_csv.ConvertOptions(
                include_columns=wanted,
                column_types=dict.fromkeys(wanted, pa.float64()),
                null_values=["", "nan", "NaN"],
            ),
        )
    except pa.ArrowException as error:
        _refuse_line(path, content, delimiter, names, wanted)
        raise ValueError(f"{path} cannot be read as CSV: {error}") from error
    return Columns(path, _vectors(table), content)


def _header(content: bytes) -> tuple[int, str, list[str]]:
    """Return number, delimiter and names of the first line of a CSV file."""
    number, header = next(_lines(content), (1, ""))
    delimiter = max(_DELIMITERS, key=header.count)
    return number, delimiter, [name.strip().strip('"') for name in header.split(delimiter)]


def _vectors(table: Any) -> dict[str, Vector]:
    columns = zip(table.column_names, table.columns, strict=True)
    return {name: column.to_numpy().astype(np.float64, copy=False) for name, column in columns}


def _check_names(where: str, names: Names, required: Names, optional: Names | None) -> list[str]:
    """Return the names to read; refuse missing and unknown ones, as these may be misspelt."""
    known = [*required, *(optional or ())]
    allowed = f"the columns are {', '.join(names if optional is None else required)}"
    if optional:
        allowed += f", and perhaps {', '.join(optional)}"
    for place, name in enumerate(names, start=1):
        is_unknown = name not in known and optional is not None
        if is_unknown or (name in known and names.count(name) > 1):
            problem = "is unknown" if is_unknown else "occurs twice"
            raise ValueError(f"{where}, column {place} {shown(name)} {problem}: {allowed}")
    for name in required:
        if name not in names:
            hint = did_you_mean(name, names)
            raise ValueError(f"{where}: column {name} is missing: {allowed}{hint}")
    return [name for name in names if name in known]


def _refuse_line(path: Path, content: bytes, delimiter: str, names: Names, wanted: Names) -> None:
    """Raise a ValueError that names the first line that has not a number per column."""
    for number, line in islice(_lines(content), 1, None):
        cells = line.split(delimiter)
        if len(cells) != len(names):
            what = f"has {len(cells)} cells, the first line names {len(names)} columns"
            raise ValueError(f"{path}, line {number} {what}")
        for name, cell in zip(names, cells, strict=True):
            try:
                float(cell.strip() or "nan") if name in wanted else None
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
