"""Files and records that are written whole or not at all, even if the disk is full.

A file gets its name only when it is complete. Until then it has another: ``run.partial.mcap``
becomes ``run.mcap``.
"""

from __future__ import annotations

import contextlib
import errno
import json
import math
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any


def partial_path(path: Path) -> Path:
    """Return the path of an incomplete file: in the same folder, so that a rename completes it."""
    return path.with_name(f"{path.stem}.partial{path.suffix}")


def new_partial(path: Path) -> Path:
    """Create `partial_path` as an empty file; replace a link of that name, do not follow it."""
    partial = partial_path(path)
    partial.unlink(missing_ok=True)
    os.close(os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
    return partial


def is_partial(path: Path) -> bool:
    """Whether a file's name marks it as incomplete."""
    return path.stem.endswith(".partial")


def complete(path: Path) -> None:
    """Sync a written file to the disk, then give it its final name.

    Raises:
        OSError: it cannot be synced to the disk; the message names the file.
    """
    with naming_file(path):
        with partial_path(path).open("rb") as file:
            os.fsync(file.fileno())
        partial_path(path).replace(path)


@contextlib.contextmanager
def naming_file(path: Path) -> Iterator[None]:
    """Add the file's name to errors of the disk, which `write` leaves out.

    Raises:
        OSError: the original error, with a file name.
    """
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise OSError(error.errno or errno.EIO, reason, str(path)) from error


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file, text in UTF-8, as a whole or not at all.

    Raises:
        OSError: it cannot be written; the message names the file.
    """
    partial = partial_path(path)
    try:
        with naming_file(path):
            new_partial(path).write_bytes(
                content if isinstance(content, bytes) else content.encode()
            )
        complete(path)
    except OSError:
        partial.unlink(missing_ok=True)
        raise


def write_json(path: Path, values: Mapping[str, Any]) -> None:
    """Write values as a JSON file, whole or not at all.

    JSON has no infinity and no NaN: null replaces them.

    Raises:
        OSError: it cannot be written.
    """
    write_whole(path, json.dumps(_finite(values), indent=2, allow_nan=False) + "\n")


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: _finite(each) for key, each in value.items()}
    return [_finite(each) for each in value] if isinstance(value, (list, tuple)) else value


class RecordFile:
    """File of records that never ends in the middle of a record.

    It is unbuffered: when `write` returns, the operating system has the data.

    Args:
        path: the file; an existing one is replaced.

    Attributes:
        size: bytes written.
    """

    def __init__(self, path: Path) -> None:
        self._raw = path.open("wb", buffering=0)
        self.size = 0

    def write(self, data: bytes) -> int:
        """Write all of these bytes, or none.

        Raises:
            OSError: the disk fails; the part written is cut off again.
        """
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[self._raw.write(rest) :]
        except OSError:
            with contextlib.suppress(OSError):
                self._raw.seek(self.size)
                self._raw.truncate()
            raise
        self.size += len(data)
        return len(data)

    def tell(self) -> int:
        return self.size

    def close(self) -> None:
        self._raw.close()
