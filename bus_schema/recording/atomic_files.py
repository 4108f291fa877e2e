"""Files that are whole or not there, and records that are, however full the disk is.

A file appears under its name only when it is complete. Until then it goes by another: what was to
become ``run.mcap`` is ``run.partial.mcap``.
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
    """Where a file is written until it is complete: beside its place, for a rename to do."""
    return path.with_name(f"{path.stem}.partial{path.suffix}")


def new_partial(path: Path) -> Path:
    """`partial_path` as a new, empty file; a link of that name is replaced, and not followed."""
    partial = partial_path(path)
    partial.unlink(missing_ok=True)
    os.close(os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
    return partial


def is_partial(path: Path) -> bool:
    """Whether a file has the name of one that is not complete."""
    return path.stem.endswith(".partial")


def complete(path: Path) -> None:
    """Give a file that is written its name, once it is safe on the disk.

    Raises:
        OSError: it cannot be brought to the disk; the file is named.
    """
    with naming_file(path):
        with partial_path(path).open("rb") as file:
            os.fsync(file.fileno())
        partial_path(path).replace(path)


@contextlib.contextmanager
def naming_file(path: Path) -> Iterator[None]:
    """What the disk does not take is told with the file's name, which writing leaves out.

    Raises:
        OSError: as within, with a file name.
    """
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise OSError(error.errno or errno.EIO, reason, str(path)) from error


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file, text in UTF-8; whatever happens, there is all of it or none.

    Raises:
        OSError: it cannot be written; the file is named.
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
    """Write values as JSON; whatever happens, there is all of the file or none.

    JSON has no number that is infinite, or not a number: null stands in its place.

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
    """A file of records that never ends in half of one.

    It is unbuffered: what `write` returned from is with the operating system.

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
            OSError: the disk does not take them; what it took is cut off again.
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
