"""Untrusted files that a user names: only regular ones of limited size are read."""

from __future__ import annotations

import io
import os
from collections.abc import Collection
from itertools import islice
from pathlib import Path
from typing import Any

from bus_schema.foreign_text import shortened

MOST_BYTES = 20_000_000
_MOST_VALUES = 40_000_000
"""Ten million rows of four columns."""
ARM_FILES = (".urdf", ".xacro", ".xml")
"""Ends of names of files that may describe an arm."""
_MOST_LISTED, _MOST_LISTED_FROM = 12, 2000


class UserFileError(OSError):
    """A file cannot be read; the message says why, without its name."""


def is_file(path: Path) -> bool:
    """Whether there is a regular file; False for an impossible path."""
    try:
        return path.is_file()
    except (OSError, RuntimeError, ValueError):  # too long, circular links, or a NUL in it
        return False


def is_folder(path: Path) -> bool:
    """Whether there is a folder; False for an impossible path."""
    try:
        return path.is_dir()
    except (OSError, RuntimeError, ValueError):
        return False


def named_in_folder(path: Path, suffixes: Collection[str] = ARM_FILES) -> str:
    """Return what a folder holds that was given in place of a file; empty if it is none.

    Args:
        path: what was given.
        suffixes: of the files that could be given.
    """
    if not is_folder(path):
        return ""
    try:
        below = [*path.iterdir(), *islice(path.rglob("*"), _MOST_LISTED_FROM)]
        found = [
            each.relative_to(path) for each in below if each.suffix in suffixes and is_file(each)
        ]
    except (OSError, RuntimeError, ValueError):
        return ""
    files = sorted((each for each in set(found) if not str(each).startswith(".")),
                   key=lambda each: (len(each.parts), each))  # fmt: skip
    if not files:
        return f"is a folder without a file {', '.join(suffixes)}"
    more = f" and {len(files) - _MOST_LISTED} more" if len(files) > _MOST_LISTED else ""
    listed = ", ".join(shortened(str(each)) for each in files[:_MOST_LISTED])
    return f"is a folder: must be a file, such as {listed}{more} in it"


def read_bytes(path: Path, most_bytes: int = MOST_BYTES) -> bytes:
    """Return the content of a regular file; devices and pipes, which may never end, are not opened.

    Raises:
        OSError: it cannot be read, is not a regular file, or is too large.
    """
    try:
        path.stat()
    except (RuntimeError, ValueError) as error:
        raise UserFileError(str(error)) from error
    if not path.is_file():
        raise UserFileError("is a folder" if path.is_dir() else "is not a regular file")
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    with os.fdopen(descriptor, "rb") as file:
        content = file.read(most_bytes + 1)
    if len(content) > most_bytes:
        raise UserFileError(f"is larger than {most_bytes / 1e6:g} MB")
    return content


def read_text(path: Path, most_bytes: int = MOST_BYTES, *, newline: str | None = None) -> str:
    """Return the content of a regular file in UTF-8; `newline` as in `open`.

    Raises:
        OSError: as for `read_bytes`, or it is not in UTF-8.
    """
    content = io.BytesIO(read_bytes(path, most_bytes))
    try:
        return io.TextIOWrapper(content, encoding="utf-8", newline=newline).read()
    except UnicodeDecodeError as error:
        raise UserFileError(f"is no text in UTF-8: {error}") from error


def open_parquet(source: Any, **options: Any) -> Any:
    """Return a `pyarrow.parquet.ParquetFile` of limited size: a small file can hold gigabytes.

    Args:
        source: a path, or a file of Arrow.
        options: of `ParquetFile`.

    Raises:
        UserFileError: it has too many values, by its metadata; none has been read.
        pyarrow.ArrowException: it is no Parquet.
    """
    from pyarrow import parquet  # heavy, and needed by few commands

    file = parquet.ParquetFile(source, **options)
    about = file.metadata
    # Not by column: Arrow ends the process where the metadata of one is damaged.
    values = about.num_rows * about.num_columns
    if values > _MOST_VALUES:
        raise UserFileError(f"has {values:,} values, and at most {_MOST_VALUES:,} are read")
    return file
