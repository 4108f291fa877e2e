"""Untrusted files that a user names: only regular ones of limited size are read."""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import Any

MOST_BYTES = 20_000_000
_MOST_VALUES = 40_000_000
"""Ten million rows of four columns."""


class UserFileError(OSError):
    """A file cannot be read; the message says why, without its name."""


def is_file(path: Path) -> bool:
    """Whether there is a regular file; False for an impossible path."""
    try:
        return path.is_file()
    except (OSError, RuntimeError, ValueError):  # too long, circular links, or a NUL in it
        return False


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
